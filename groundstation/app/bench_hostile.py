"""What bytes cost that somebody made up to cost much: time for each byte against that of ordinary telemetry.

Splitting alone: datagrams of one size that are read as blocks, as in flight, and the same bytes as a stream. Some
inputs are what did cost seconds once, the rest is drawn at random out of headers that promise much.
"""

from __future__ import annotations

import random
import statistics
import time
from collections.abc import Sequence

from groundstation.app.output import Output
from groundstation.mavlink.blocks import Arrivals
from groundstation.mavlink.codec import Encoder, FrameSplitter, message_name

_DATAGRAM = 1_400
_BIG = 60_000
_BLOCK = 16_384
_BYTES = 120_000
_ROUNDS = 5
_DRAWN = 30


def run(out: Output) -> dict[str, float | int | str]:
    """Measures and returns the figures; medians over several rounds. About half a minute."""
    del out
    ordinary = _seconds_per_byte(ordinary_traffic(), _DATAGRAM)
    ordinary_stream = _seconds_per_byte(ordinary_traffic(), _DATAGRAM, datagrams=False)
    values: dict[str, float | int | str] = {
        "ordinary_ns_per_byte": 1e9 * ordinary,
        "ordinary_stream_ns_per_byte": 1e9 * ordinary_stream,
    }
    worst = 0.0
    for name, unit in hostile_units().items():
        for size in (_DATAGRAM, _BIG):
            ratio = _seconds_per_byte(unit, size) / ordinary
            values[f"{name}_{size}_over_ordinary"] = ratio
            worst = max(worst, ratio)
        ratio = _seconds_per_byte(unit, _DATAGRAM, datagrams=False) / ordinary_stream
        values[f"{name}_stream_over_ordinary"] = ratio
        worst = max(worst, ratio)
    draw = random.Random(1)  # noqa: S311 - inputs of a measurement
    drawn = [_seconds_per_byte(_draw(draw), _DATAGRAM, rounds=1) / ordinary for _ in range(_DRAWN)]
    values["drawn_at_random"] = _DRAWN
    values["worst_drawn_over_ordinary"] = max(drawn)
    values["worst_over_ordinary"] = max(worst, *drawn)
    return values


def ordinary_traffic() -> bytes:
    """Telemetry of one vehicle, some frames of each kind."""
    encoder = Encoder(1)
    return b"".join(
        encoder.encode(name, **fields)
        for k in range(4)
        for name, fields in (
            ("LOCAL_POSITION_NED", {"time_boot_ms": k, "x": 1.5, "y": -2.0, "z": -3.0, "vz": 0.1}),
            ("ATTITUDE_QUATERNION", {"time_boot_ms": k, "q1": 1.0, "q4": 0.1, "yawspeed": 0.2}),
            ("HEARTBEAT", {"type": 2, "autopilot": 12, "system_status": 4}),
        )
    )


def hostile_units() -> dict[str, bytes]:
    """Runs of bytes to be repeated, by name."""
    unknown = next(number for number in range(256) if message_name(number) is None)
    over_each_other = bytes((0xFE, 254, 0xFE, 0xFE, 0xFE, unknown))
    good = Encoder(250).encode("HEARTBEAT", type=2, mavlink_version=3)
    return {
        "windows": over_each_other * 39 + good,
        "unknown": over_each_other,
        "magics_v1": b"\xfe",
        "magics_v2": b"\xfd",
        "known": bytes((0xFE, 255, 0xFE, 255, 0xFE, 0)),
    }


def _draw(draw: random.Random) -> bytes:
    good = Encoder(250).encode("HEARTBEAT", type=2)
    parts = []
    for _ in range(draw.randrange(1, 40)):
        length, msgid = draw.choice((0, 3, 60, 200, 254, 255)), draw.choice((0, 3, 30, 0xFD, 0xFE))
        v1 = bytes((0xFE, length, draw.choice((0, 0xFD, 0xFE)), 0xFE, 1, msgid))
        v2 = bytes((0xFD, length, draw.choice((0, 1)), 0, 0xFE, 1, 1, msgid, 0, draw.choice((0, 0, 255))))
        parts.append(draw.choice((v1, v1, v2, v2, good, b"\xfe", b"\xfd", draw.randbytes(3))))
    return b"".join(parts)


def _seconds_per_byte(unit: bytes, size: int, *, datagrams: bool = True, rounds: int = _ROUNDS) -> float:
    data = unit * (_BYTES // len(unit) + 1)
    pieces: Sequence[bytes] = [data[start : start + size] for start in range(0, _BYTES, size)]
    taken = []
    for _ in range(rounds):
        splitter, arrivals = FrameSplitter(datagrams=False), Arrivals()
        start_s = time.process_time()
        for piece in pieces:
            if not datagrams:
                splitter.feed(piece)
                continue
            arrivals.add(0, "peer", piece, 0)
            if arrivals.size >= _BLOCK:
                arrivals.block()
        taken.append(time.process_time() - start_s)
    return statistics.median(taken) / sum(map(len, pieces))
