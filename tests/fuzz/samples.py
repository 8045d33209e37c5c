"""Real input that the fuzzer bends: frames of every kind, logs, manifests, configuration, gains."""

from __future__ import annotations

import json
from functools import cache
from pathlib import Path
from random import Random
from tempfile import TemporaryDirectory

from pymavlink.dialects.v20 import ardupilotmega as dialect

from groundstation.app.resources import packaged_configs
from groundstation.mavlink.codec import Encoder, Frame, Splitters, layout, message_name
from groundstation.mavlink.signing import SecretKey, Signing
from groundstation.records.manifest import Manifest
from groundstation.records.tlog import TlogWriter

SECRET = bytes(range(32))
EPOCH_US = 1_577_836_800_000_000


def random_frame(random: Random, sysid: int, msgid: int) -> bytes:
    """A whole frame with a right checksum and random content."""
    shape = layout(message_name(msgid) or "HEARTBEAT")
    return Encoder(sysid, random.choice((1, 1, 1, 68, 190))).frame(shape, random.randbytes(shape.size))


@cache
def frames(sysid: int = 1) -> tuple[bytes, ...]:
    """Frames of every message that the dialect knows, some signed, some MAVLink 1."""
    random = Random(1)
    made = []
    signing = Signing(SecretKey(SECRET))
    for msgid in dialect.mavlink_map:
        raw = random_frame(random, sysid, msgid)
        made += [raw, signing.sign(raw, 0, 1000)]
        if msgid < 256:
            made.append(Encoder(sysid, 1, version=1).encode(message_name(msgid) or "HEARTBEAT"))
    return tuple(made)


@cache
def datagrams(sysid: int = 1) -> tuple[bytes, ...]:
    """Several frames each."""
    random = Random(2)
    return tuple(b"".join(random.choices(frames(sysid), k=random.randrange(1, 8))) for _ in range(400))


@cache
def logs() -> tuple[bytes, ...]:
    """Native and foreign logs, small enough to be read by the thousand."""
    random = Random(3)
    made = []
    with TemporaryDirectory() as folder:
        for number in range(12):
            path = Path(folder) / f"{number}.tlog"
            with TlogWriter(path, EPOCH_US) as log:
                splitters = Splitters()
                for tick in range(1, 9):
                    t_ns = tick * 20_000_000
                    link, peer, data = tick % 2, f"10.0.0.{tick % 3}:14580", random.choice(datagrams(tick % 3))
                    log.took(link, peer, splitters.feed((link, peer), data, stream=link == 1), t_ns)
                    log.received(0, "noise", random.randbytes(random.randrange(200)), t_ns)
                    log.tick(t_ns, tick)
                    for raw in random.choices(frames(255), k=2):
                        log.sent(raw, t_ns)
                    log.event(f"phase: {'form' if tick % 2 else 'hold'}", t_ns)
                    log.roles([None, 1, 0], t_ns)
                log.operator("return", t_ns)
                for piece in Splitters().feed("x", random.choice(datagrams(2)), stream=False):
                    if isinstance(piece, Frame):
                        log.refused(0, "stranger", piece, 1, t_ns)
            made.append(path.read_bytes())
    for raws in zip(*[iter(frames(1))] * 12, strict=False):
        made.append(b"".join((EPOCH_US + k * 1000).to_bytes(8, "big") + raw for k, raw in enumerate(raws)))
    return tuple(made)


def formation_text() -> bytes:
    """A formation of four."""
    points = b"points:\n  - [0, 0, 1]\n  - [1, 0, 1]\n  - [1, 1, 1]\n  - [0, 1, 1.5]\n"
    return b"name: square\nscale: 1.0\n" + points + b"edges: complete\n"


def mission_text() -> bytes:
    """A mission for them, with every key."""
    return b"""name: square
formation: square.yaml
gains: square.npz
rate_hz: 50
speed_limit_m_s: 0.5
gain: auto
scale: {kind: arctan, gain: 2.5}
avoidance: {radius_m: 0.4, activation_m: 0.5, shape: sphere}
takeoff: {height_m: 1.0, stagger_m: 0.1}
steps: [form: {tolerance_m: 0.05, timeout_s: 60}, hold: {seconds: 5}]
land: {at: pads}
fence: {min_m: [-5, -5, 0], max_m: [5, 5, 5]}
limits: &limits {pose_age_s: 0.5, battery_min: 0.2}
anchor: {lat_deg: 47.0, lon_deg: 8.0, alt_m: 400}
signing: {key_file: team.key, link_id: 3}
positioning: mocap
link_bytes_per_s: {"udpin://127.0.0.1:14540": 10000}
vehicles:
  - &first {id: 1, link: "udpin://127.0.0.1:14540", autopilot: px4, profile: crazyflie, pad_m: [0, 0, 0]}
  - {id: 2, link: "udpin://127.0.0.1:14540", autopilot: px4, profile: crazyflie, pad_m: [1, 0, 0], origin: team}
  - {<<: *first, id: 3, pad_m: [1, 1, 0]}
  - {id: 4, link: "udpin://127.0.0.1:14540", pad_m: [0, 1, 0], origin: declared, origin_m: [0, 0, 0]}
"""


@cache
def missions() -> tuple[bytes, ...]:
    """Missions, our own and those that come along."""
    packaged = sorted((packaged_configs() / "missions").glob("*.yaml"))
    return (mission_text(), *(path.read_bytes() for path in packaged))


@cache
def formations() -> tuple[bytes, ...]:
    """Formations, our own and those that come along."""
    packaged = sorted((packaged_configs() / "formations").glob("*.yaml"))
    return (formation_text(), *(path.read_bytes() for path in packaged if path.stat().st_size < 20_000))


def faults_text() -> bytes:
    """A timetable of faults."""
    return b"""faults:
  - {kind: loss, at_s: 1, for_s: 2, vehicles: [1], probability: 0.5, direction: down}
  - {kind: blackout, at_s: 3}
  - {kind: position_jump, at_s: 2, east_m: 1.0, north_m: -1e3, up_m: 0x10}
  - {kind: clock_jump, seconds: 3600}
"""


@cache
def manifests(gains: bytes) -> tuple[bytes, ...]:
    """Manifests with everything that is read from them."""
    mission = {
        "name": "square",
        "vehicles": [{"id": k, "pad_m": [k, 0, 0], "origin": "pad"} for k in (0, 1, 2)],
        "formation": {"name": "square", "scale": 2.0, "points": [[0, 0, 1], [1, 0, 1], [0, 1, 1]], "edges": [[1, 2]]},
        "avoidance": {"radius_m": 0.4},
    }
    plain = Manifest(mission=mission, epoch_unix_us=EPOCH_US, versions={"gs": "1"}, seed=1, dry_run=True)
    ended = plain.finished({"ticks": 8, "local_origins_enu_m": [[0, 0, 0], [None] * 3, [1, 1, 1]], "counts": {"a": 1}})
    small = json.dumps(json.loads(ended.to_json()), separators=(",", ":"))
    with_gains = Manifest(mission=mission, epoch_unix_us=EPOCH_US, gains_npz=gains[:90])
    return (ended.to_json().encode(), small.encode(), with_gains.to_json().encode())
