"""A recording of real firmware, with the simulator's own truth beside it, and what our program believes of it.

``listen`` feeds what was received through station, vehicles, preflight and monitors, in the order and at the times of
the recording, and keeps what was believed after every tick. Truth comes from the simulators by another way (a port of
their own), so that no sign and no frame of ours is in it. Nothing is sent: what was sent is read off the recording.
"""

from __future__ import annotations

import csv
import io
import lzma
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from groundstation.core.types import BoolArray, FloatArray, IntArray
from groundstation.mavlink.autopilot import CMD_COMPONENT_ARM_DISARM, CMD_DO_SET_MODE, CMD_NAV_LAND, CMD_NAV_TAKEOFF
from groundstation.mavlink.codec import Frame, decode, message_id
from groundstation.mavlink.station import Station
from groundstation.mavlink.vehicle import LANDED_ON_GROUND, Fleet
from groundstation.mission.flight.poses import Poses
from groundstation.mission.flight.team_frame import TeamFrame
from groundstation.mission.ground.preflight import Preflight
from groundstation.mission.monitors.board import Board
from groundstation.mission.monitors.findings import Sight
from groundstation.mission.plan.plan import MissionPlan
from groundstation.mission.plan.reading import plan_from_record
from groundstation.records.manifest import Manifest, read_manifest
from groundstation.records.notes import Event, Received, Record, Sent, Tick
from groundstation.records.tlog import read_tlog

REAL = Path(__file__).parents[3] / "shared" / "data" / "real"
"""Recordings that are too large for the repository; each test that needs them says so when they are not there."""

OURS = Path(__file__).parent / "data"
_ACCEPTED = 0
_LAND_MODE = 9.0  # ArduCopter


@dataclass(frozen=True)
class Truth:
    """Where the vehicles really were.

    Attributes:
        t_ns: instants per vehicle, on the recording's clock, shape (k,) each.
        pos_enu_m: shape (k, 3) each; pads at the mission's places, heights from the pads.
        vel_ned_m_s: shape (k, 3) each.
    """

    t_ns: tuple[IntArray, ...]
    pos_enu_m: tuple[FloatArray, ...]
    vel_ned_m_s: tuple[FloatArray, ...]

    def at(self, vehicle: int, t_ns: IntArray) -> tuple[FloatArray, FloatArray]:
        """Position (ENU) and velocity (NED) of one vehicle at instants, shape (k, 3) each; NaN where it is not told."""
        times = self.t_ns[vehicle]
        inside = (t_ns >= times[0]) & (t_ns <= times[-1])
        columns = np.concatenate([self.pos_enu_m[vehicle], self.vel_ned_m_s[vehicle]], axis=1)
        values = np.stack([np.interp(t_ns, times, column) for column in columns.T], axis=1)
        values[~inside] = np.nan
        return values[:, :3], values[:, 3:]


@dataclass(frozen=True)
class Recording:
    """One recorded flight.

    Attributes:
        name: of its folder.
        plan: the mission that was flown.
        manifest: beside the log.
        truth: from the simulators.
        records: everything received and sent, in order.
    """

    name: str
    plan: MissionPlan
    manifest: Manifest
    truth: Truth
    records: tuple[Record, ...]

    def until(self, text: str) -> int:
        """Time of the first event with a text."""
        return next(item.t_ns for item in self.records if isinstance(item, Event) and item.text == text)


@dataclass
class Belief:
    """What the program believed, a row for each tick.

    Attributes:
        t_ns: times of the ticks, shape (t,).
        pos_enu_m, vel_ned_m_s: at the tick, in the team frame, shape (t, n, 3).
        steady_ned_m_s: velocities that are steered by, shape (t, n, 3).
        told_error_m_s: what is said of the error of the reported ones, all axes, shape (t, n); 0 until it is known.
        reported_ns: when the newest position was measured, shape (t, n).
        armed, landed: as believed, shape (t, n).
        ready_ns: from when on preflight had nothing against a vehicle, without a break until arming; shape (n,).
        armed_ns: when the real vehicle accepted the command that arms, shape (n,); its own word that it was ready.
        problems: what preflight said at the tick before arming.
        waited: everything that preflight waited for, each text once with its first time.
        alarms: what the monitors told, with the time.
        counts: events that the fleet counted.
    """

    t_ns: IntArray
    pos_enu_m: FloatArray
    vel_ned_m_s: FloatArray
    steady_ned_m_s: FloatArray
    told_error_m_s: FloatArray
    reported_ns: IntArray
    armed: BoolArray
    landed: BoolArray
    ready_ns: IntArray
    armed_ns: IntArray
    problems: list[str]
    waited: dict[str, int]
    alarms: list[tuple[int, str]]
    restarts: IntArray
    clock_known: BoolArray


def unpacked(path: Path) -> bytes:
    """Contents of a file, which may lie there with .xz behind its name."""
    packed = path.with_name(path.name + ".xz")
    return lzma.decompress(packed.read_bytes()) if packed.exists() else path.read_bytes()


def load(folder: Path, scratch: Path, name: str = "flight") -> Recording:
    """Reads a recording.

    Args:
        folder: with NAME.tlog.xz, NAME.manifest.json and truth.csv.xz.
        scratch: empty folder to unpack in.
        name: of the log.
    """
    log = scratch / f"{name}.tlog"
    log.write_bytes(unpacked(folder / f"{name}.tlog"))
    manifest = read_manifest(folder / f"{name}.manifest.json")
    assert manifest.gains_npz is not None
    plan = plan_from_record(manifest.mission, manifest.gains_npz, folder.name)
    records = tuple(read_tlog(log, manifest.epoch_unix_us))
    return Recording(folder.name, plan, manifest, _truth(folder, plan, manifest.epoch_unix_us), records)


def _truth(folder: Path, plan: MissionPlan, epoch_unix_us: int) -> Truth:
    rows: dict[int, list[list[float]]] = {vehicle.id: [] for vehicle in plan.spec.vehicles}
    for row in csv.reader(io.StringIO(unpacked(folder / "truth.csv").decode())):
        rows[int(row[1])].append([float(value) for value in (row[0], *row[2:8])])
    times, places, speeds = [], [], []
    for index, vehicle in enumerate(plan.spec.vehicles):
        table = np.array(rows[vehicle.id])
        table = table[np.concatenate([[True], np.diff(table[:, 0]) > 0])]
        times.append(np.rint((table[:, 0] * 1e6 - epoch_unix_us) * 1e3).astype(np.int64))
        # Heights count from where the simulator stood it; pads fall on its grid of places
        ground = np.median(table[:20, 1:4], axis=0) - plan.pads_enu_m[index]
        places.append(table[:, 1:4] - [0.0, 0.0, ground[2]])
        speeds.append(table[:, 4:7])
    return Truth(tuple(times), tuple(places), tuple(speeds))


@dataclass
class _Sent:
    """What was asked of the vehicles so far, read off the recording."""

    vel_ned_m_s: FloatArray
    landing: BoolArray
    climbing: BoolArray
    armed_ns: IntArray
    row_of: dict[int, int] = field(default_factory=dict)

    def take(self, frame: Frame, t_ns: int, fleet: Fleet) -> None:
        """Takes a frame that was sent."""
        if frame.msgid == _SETPOINT:
            (batch,) = decode([frame])
            values = batch.values[0]
            row = self.row_of[int(values["target_system"])]
            self.vel_ned_m_s[row] = [values["vx"], values["vy"], values["vz"]]
            self.climbing[row] = False
        elif frame.msgid == _TIMESYNC:
            (batch,) = decode([frame])
            if int(batch.values[0]["tc1"]) == 0:
                for row in range(len(fleet)):
                    fleet.clocks.asked(row, int(batch.values[0]["ts1"]))
        elif frame.msgid == _COMMAND:
            (batch,) = decode([frame])
            values = batch.values[0]
            row, command = self.row_of[int(values["target_system"])], int(values["command"])
            to_land = command == CMD_DO_SET_MODE and values["param2"] == _LAND_MODE
            self.landing[row] |= command == CMD_NAV_LAND or to_land
            self.climbing[row] |= command == CMD_NAV_TAKEOFF


_SETPOINT = message_id("SET_POSITION_TARGET_LOCAL_NED")
_TIMESYNC, _COMMAND, _ACK = message_id("TIMESYNC"), message_id("COMMAND_LONG"), message_id("COMMAND_ACK")


def listen(recording: Recording) -> Belief:
    """Listens to a recording from its beginning to its end."""
    plan = recording.plan
    n = plan.size
    ids = [vehicle.id for vehicle in plan.spec.vehicles]
    fleet = Fleet(ids, plan.link_of_vehicle)
    station = Station(fleet, 0)
    frame, monitor = TeamFrame(plan), Board(plan)
    preflight = Preflight(plan, station, frame, look_only=True)
    never = np.full(n, -1, dtype=np.int64)
    ours, nobody = np.ones(n, dtype=np.bool_), np.zeros(n, dtype=np.bool_)
    sent = _Sent(
        np.zeros((n, 3)), np.zeros(n, dtype=np.bool_), np.zeros(n, dtype=np.bool_), never.copy(),
        {sysid: row for row, sysid in enumerate(ids)},
    )  # fmt: skip
    belief = Belief(
        *(np.zeros(0, dtype=np.int64), np.zeros(0), np.zeros(0), np.zeros(0), np.zeros(0)),
        np.zeros(0, dtype=np.int64),
        *(np.zeros(0, dtype=np.bool_), np.zeros(0, dtype=np.bool_)),
        ready_ns=never.copy(), armed_ns=sent.armed_ns, problems=[], waited={}, alarms=[],
        restarts=fleet.restarts, clock_known=fleet.clocks.known,
    )  # fmt: skip
    rows: list[tuple[int, FloatArray, FloatArray, FloatArray, FloatArray, IntArray, BoolArray, BoolArray]] = []
    phase = "connect"
    for record in recording.records:
        if isinstance(record, Received):
            station.receive(record.link, record.peer, record.frame.raw, record.t_ns)
            _hear_arming(record, sent)
        elif isinstance(record, Sent):
            sent.take(record.frame, record.t_ns, fleet)
        elif isinstance(record, Event):
            before, phase = phase, _phase(record, phase)
            if before == "connect" and phase == "arm":
                frame.settle(fleet, record.t_ns)
                monitor.begin(fleet)
        elif isinstance(record, Tick):
            now_ns = record.t_ns
            station.ingest()
            fleet.take_texts()
            if phase == "connect":
                frame.placement.look(fleet, now_ns)
            poses = frame.poses(fleet, now_ns)
            steady_ned_m_s, told_error_m_s = poses.vel_ned_m_s, np.zeros(n)
            if phase == "connect":
                _on_the_ground(preflight, station, poses, belief, now_ns)
            elif phase not in ("arm", "done"):
                airborne: BoolArray = fleet.armed & (fleet.landed_state != LANDED_ON_GROUND)
                pose_ns = frame.pose_ns(fleet)
                poses = monitor.trusted(poses, pose_ns, airborne, now_ns)
                sight = Sight(
                    fleet=fleet, now_ns=now_ns, pos_team_ned_m=poses.pos_team_ned_m, vel_ned_m_s=poses.vel_ned_m_s,
                    pose_ns=pose_ns, drift_m=frame.drift_m(fleet, now_ns), sent_ned_m_s=sent.vel_ned_m_s,
                    ours=ours.copy(), steered=~(sent.climbing | monitor.hold), lands_here=nobody, excused=sent.landing,
                    blind=monitor.blind, airborne=airborne, vel_error_ned_m_s=monitor.speeds.known_error_ned_m_s,
                )  # fmt: skip
                findings = monitor.look(sight)
                ours[findings.release] = False
                belief.alarms += [(now_ns, alarm) for alarm in findings.alarms]
                steady_ned_m_s = monitor.steady(poses).vel_ned_m_s
                told_error_m_s = monitor.speeds.told_error_m_s
            north, east, down = poses.pos_team_ned_m.T
            rows.append(
                (
                    now_ns,
                    np.stack([east, north, -down], axis=1),  # not by the function that is judged
                    poses.vel_ned_m_s.copy(),
                    steady_ned_m_s.copy(),
                    told_error_m_s.copy(),
                    fleet.pose_ns.copy(),
                    fleet.armed.copy(),
                    fleet.landed_state == LANDED_ON_GROUND,
                )
            )
    columns = list(zip(*rows, strict=True))
    belief.t_ns = np.array(columns[0], dtype=np.int64)
    belief.pos_enu_m, belief.vel_ned_m_s, belief.steady_ned_m_s, belief.told_error_m_s = (
        np.stack(column) for column in columns[1:5]
    )
    belief.reported_ns, belief.armed, belief.landed = (np.stack(column) for column in columns[5:])
    return belief


def _phase(event: Event, phase: str) -> str:
    kind, _, name = event.text.partition(": ")
    return name if kind == "phase" else phase


def _hear_arming(record: Received, sent: _Sent) -> None:
    if record.frame.msgid != _ACK:
        return
    (batch,) = decode([record.frame])
    values = batch.values[0]
    if int(values["command"]) == CMD_COMPONENT_ARM_DISARM and int(values["result"]) == _ACCEPTED:
        row = sent.row_of[record.frame.sysid]
        if sent.armed_ns[row] < 0:
            sent.armed_ns[row] = record.t_ns


def _on_the_ground(preflight: Preflight, station: Station, poses: Poses, belief: Belief, now_ns: int) -> None:
    """Lets preflight look; what it would send goes nowhere."""
    state = preflight.step(now_ns, {}, poses.pos_team_ned_m)
    ids = station.fleet.sysid.tolist()
    for row in range(len(ids)):
        station.commands.clear(row)
    station.parameters.due(now_ns)  # what is not told has been asked for often enough some day
    belief.problems = state.fatal + state.waiting
    for text in belief.problems:
        belief.waited.setdefault(text, now_ns)
    for row, sysid in enumerate(ids):
        clear = not any(text.startswith(f"vehicle {sysid}:") for text in belief.problems)
        if not clear:
            belief.ready_ns[row] = -1
        elif belief.ready_ns[row] < 0:
            belief.ready_ns[row] = now_ns


def chosen(names: Sequence[str]) -> list[Path]:
    """Recordings whose names contain one of ``names``, or all: ours, then the larger ones beside them."""
    ours = sorted(path for path in OURS.iterdir() if path.is_dir()) if OURS.is_dir() else []
    return [path for path in (*ours, *folders()) if not names or any(name in path.name for name in names)]


def folders() -> Iterator[Path]:
    """Recordings that are at hand beside the repository."""
    if REAL.is_dir():
        yield from sorted(path for path in REAL.iterdir() if path.is_dir())
