"""How fast frames are read and written beside pymavlink, in one run: batches of a thousand, small ticks, lone frames.

Processor time, best of some rounds by turns, so that load from elsewhere weighs on neither. What comes in are positions
and attitudes with numbers in all fields; what goes out are setpoints. pymavlink's message objects are its columns.
"""

from __future__ import annotations

import time
from collections.abc import Callable

import numpy as np
from pymavlink.dialects.v20 import ardupilotmega as dialect

from groundstation.app.output import Output
from groundstation.mavlink.blocks import Datagrams, split
from groundstation.mavlink.codec import Encoder, FrameSplitter, blank, decode, encode_batch

_FRAMES = 1_000
_ROUNDS = 20
_TURN_S = 0.01
_LONE = 200
_SETPOINT = "SET_POSITION_TARGET_LOCAL_NED"


def run(out: Output) -> dict[str, float | int]:
    """Measures and returns the figures. About ten seconds."""
    del out
    values: dict[str, float | int] = {"frames": _FRAMES, "rounds": _ROUNDS}
    frames = _telemetry()
    for together, count in ((1, _FRAMES), (8, _FRAMES), (3, 60)):
        datagrams = [b"".join(frames[k : k + together]) for k in range(0, count, together)]
        theirs, ours = _both(lambda data=datagrams: _read_theirs(data), _reading(datagrams), count)  # type: ignore[misc]
        name = f"decode_{count}_by_{together}"
        values |= {f"{name}_us": ours, f"{name}_pymavlink_us": theirs, f"{name}_times_faster": theirs / ours}
    for count in (_FRAMES, 8):
        theirs, ours = _both(*_writing(count), count)
        name = f"encode_{count}"
        values |= {f"{name}_us": ours, f"{name}_pymavlink_us": theirs, f"{name}_times_faster": theirs / ours}
    parser = dialect.MAVLink(None)
    splitter = FrameSplitter()
    theirs, ours = _both(
        lambda: [parser.parse_buffer(frames[0]) for _ in range(_LONE)],
        lambda: [decode(splitter.feed(frames[0])) for _ in range(_LONE)],  # type: ignore[arg-type]
        _LONE,
    )
    values |= {"lone_us": ours, "lone_pymavlink_us": theirs, "lone_times_faster": theirs / ours}
    return values


def _telemetry() -> list[bytes]:
    rng = np.random.default_rng(1)
    kinds = [("LOCAL_POSITION_NED", Encoder(1)), ("ATTITUDE_QUATERNION", Encoder(2))]
    columns = []
    for name, encoder in kinds:
        values = blank(name, _FRAMES // 2)
        for field in values.dtype.names or ():
            if field != "repr_offset_q":  # an extension that is not sent
                values[field] = rng.uniform(0.1, 9.0, len(values)) * (1_000 if field == "time_boot_ms" else 1)
        columns.append(encode_batch(name, values, [encoder] * len(values)))
    return [frame for pair in zip(*columns, strict=True) for frame in pair]


def _read_theirs(datagrams: list[bytes]) -> None:
    parser = dialect.MAVLink(None)
    for datagram in datagrams:
        parser.parse_buffer(datagram)


def _reading(datagrams: list[bytes]) -> Callable[[], object]:
    """Ours, from a buffer with offsets, as a tick has it."""
    offsets = np.cumsum([0, *map(len, datagrams)])
    zeros = np.zeros(len(datagrams), dtype=np.int64)
    data, where = b"".join(datagrams), Datagrams(offsets, zeros, zeros, zeros, ((0, "peer"),))
    return lambda: split(data, where).decode()


def _writing(count: int) -> tuple[Callable[[], object], Callable[[], object]]:
    rng = np.random.default_rng(2)
    vel = rng.normal(size=(count, 3))
    yaw = rng.normal(size=count)
    listed = list(zip(*vel.T.tolist(), yaw.tolist(), strict=True))
    peer, encoder = dialect.MAVLink(None, srcSystem=255, srcComponent=190), Encoder(255, 190)

    def theirs() -> list[bytes]:
        raws = []
        for vx, vy, vz, angle in listed:
            message = dialect.MAVLink_set_position_target_local_ned_message(
                12_345, 1, 1, 1, 0x9C7, 0.0, 0.0, 0.0, vx, vy, vz, 0.0, 0.0, 0.0, angle, 0.0
            )
            raws.append(message.pack(peer))
            peer.seq = (peer.seq + 1) % 256
        return raws

    def ours() -> list[bytes]:
        values = blank(_SETPOINT, count)
        values["time_boot_ms"], values["target_system"], values["target_component"] = 12_345, 1, 1
        values["coordinate_frame"], values["type_mask"] = 1, 0x9C7
        values["vx"], values["vy"], values["vz"] = vel.T
        values["yaw"] = yaw
        return encode_batch(_SETPOINT, values, [encoder] * count)

    if theirs() != ours():
        raise AssertionError("pymavlink writes other bytes")
    return theirs, ours


def _both(theirs: Callable[[], object], ours: Callable[[], object], count: int) -> tuple[float, float]:
    """Microseconds for each frame, by turns that take about as long on both sides; best of the rounds."""
    times = [max(1, round(_TURN_S / _seconds(act, 1))) for act in (theirs, ours)]
    best = [float("inf"), float("inf")]
    for _ in range(_ROUNDS):
        for number, act in enumerate((theirs, ours)):
            best[number] = min(best[number], _seconds(act, times[number]))
    return best[0] / count * 1e6, best[1] / count * 1e6


def _seconds(act: Callable[[], object], times: int) -> float:
    act()  # whatever the other one has pushed out of the caches is there again
    start_s = time.process_time()
    for _ in range(times):
        act()
    return (time.process_time() - start_s) / times
