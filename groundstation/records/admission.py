"""What a flight's own rule lets through of a log: positions, places on earth, origins, and restarts.

There is one rule of who is believed, and it is the one that flew: frames of a log go through the same ``Fleet``, in the
same order and with the same arrivals, and what it takes is what is counted here. A companion computer, another system,
another link, a second sender under a vehicle's id and positions that are old or no numbers count for nobody.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from groundstation.core.quick import norms
from groundstation.core.types import BoolArray, FloatArray, IntArray
from groundstation.mavlink.addresses import mavlink_url
from groundstation.mavlink.blocks import Block
from groundstation.mavlink.codec import Batch, columns
from groundstation.mavlink.vehicle import AUTOPILOT_COMPID, Fleet, ReceivedFrame, received_frames
from groundstation.mocap.bodies import RoomConfig, room_config
from groundstation.mocap.room import Seen
from groundstation.records.manifest import Values, system_ids
from groundstation.records.notes import PHASE_PREFIX, Event, Received

_BEFORE_FLIGHT = frozenset({"connect", "take-over"})  # vehicles may start anew, and frames begin wherever they like
_ARM = "arm"
_CHUNK = 2_048
_BACK_MS = 1_000  # reordering on a link is quicker than this
_ORIGIN_SAME = 50  # of 1e-7 degrees, 0.5 m, or of millimetres: less is a correction, not another origin
_ROTATION_OFF = 0.05  # of 1 that a quaternion's length may be off, as in flight
_TOLD_LATE_NS = 1_000_000_000


@dataclass(frozen=True)
class Reports:
    """Positions of one kind that were let in, in the order of their arrival.

    Attributes:
        t_ns: arrivals, shape (k,).
        vehicle: rows of the team, shape (k,).
        boot_ms: the vehicles' own times, shape (k,).
        position: north, east, down in metres from each vehicle's own origin; or latitude and longitude in degrees and
            height above sea level in metres; shape (k, 3).
        vel_ned_m_s: velocity of the same message, shape (k, 3).
    """

    t_ns: IntArray
    vehicle: IntArray
    boot_ms: IntArray
    position: FloatArray
    vel_ned_m_s: FloatArray

    def where(self, chosen: BoolArray) -> Reports:
        """Those that are chosen, shape (k,)."""
        return Reports(
            self.t_ns[chosen], self.vehicle[chosen], self.boot_ms[chosen], self.position[chosen],
            self.vel_ned_m_s[chosen],
        )  # fmt: skip

    def of(self, vehicle: int) -> Reports:
        """Those of one vehicle."""
        return self.where(self.vehicle == vehicle)


@dataclass(frozen=True)
class Attitudes:
    """Attitudes that were let in, in the order of their arrival.

    Attributes:
        t_ns: arrivals, shape (k,).
        vehicle: rows of the team, shape (k,).
        rpy_ned_rad: roll, pitch and yaw, shape (k, 3).
    """

    t_ns: IntArray
    vehicle: IntArray
    rpy_ned_rad: FloatArray

    def of(self, vehicle: int) -> Attitudes:
        """Those of one vehicle."""
        own = self.vehicle == vehicle
        return Attitudes(self.t_ns[own], self.vehicle[own], self.rpy_ned_rad[own])


class Admission:
    """Lets in what a flight with these vehicles would have let in.

    Args:
        sysids: the vehicles, shape (n,).
        links: number of each vehicle's link; None where it is not known: the first one that it is heard on.
        signed: links on which everything is signed.
        components: of vehicles whose autopilot has another component id than flights ask for, in logs of others.
        velocity_needed: whether a position without a velocity is none, as in flight; False for imported flights.
        room: of motion capture, whose positions counted in place of the vehicles' own; None without.

    Attributes:
        settled_ns: from when on frames have to stay where they are; None before.
        armed_ns: the same of a flight that began on the ground; None of one that took over, whose frames were settled
            before its log began.
        lost_ns: by vehicle, from when on its local positions count from elsewhere: it started anew, or its origin was
            moved.
    """

    def __init__(
        self,
        sysids: Sequence[int],
        links: Sequence[int | None],
        *,
        signed: Sequence[int] = (),
        components: Mapping[int, int] | None = None,
        velocity_needed: bool = True,
        room: RoomConfig | None = None,
    ) -> None:
        self.settled_ns: int | None = None
        self.armed_ns: int | None = None
        self.lost_ns: dict[int, int] = {}
        self._fleet = Fleet(sysids, [-1 if link is None else link for link in links], room)
        self._fleet.watch, self._fleet.watch_room = self._look, self._look_into_room
        self._room_link = None if room is None else room.link
        self._known = frozenset(sysids)
        numbered = enumerate(zip(sysids, links, strict=True))
        self._unlinked = {sysid: row for row, (sysid, link) in numbered if link is None}
        self._signed = tuple(signed)
        self._components = dict(components or {})
        self._velocity_needed = velocity_needed
        self._waiting: list[ReceivedFrame] = []
        self._restarts = self._fleet.restarts.copy()
        self._boot_ms: IntArray = np.full(len(sysids), -1, dtype=np.int64)
        self._origin: dict[int, tuple[int, int, int]] = {}
        self._local: list[Reports] = []
        self._places: list[Reports] = []
        self._quaternions: list[Attitudes] = []
        self._angles: list[Attitudes] = []

    def take(self, record: Received) -> None:
        """Takes a frame that arrived; frames in the order of the log."""
        frame = record.frame
        if record.link == self._room_link:
            self._wait(ReceivedFrame(frame, record.link, record.peer, record.t_ns))
            return
        if frame.sysid not in self._known:
            return
        own = self._components.get(frame.sysid, AUTOPILOT_COMPID)
        if own != AUTOPILOT_COMPID:
            if frame.compid != own:
                return
            frame = frame._replace(compid=AUTOPILOT_COMPID)
        if frame.sysid in self._unlinked and frame.compid == AUTOPILOT_COMPID:
            self._fleet.expect_on(self._unlinked.pop(frame.sysid), record.link)
        self._wait(ReceivedFrame(frame, record.link, record.peer, record.t_ns))

    def take_block(self, block: Block) -> None:
        """The same for many, as columns where nothing about them is unusual."""
        if self._room_link is not None or self._unlinked or self._components:
            for item in received_frames(block):
                self.take(Received(item.t_rx_ns, item.link, item.peer, item.frame))
            return
        self._ingest()
        self._fleet.ingest_block(block)
        self._drop_the_rest()

    def _wait(self, item: ReceivedFrame) -> None:
        self._waiting.append(item)
        if len(self._waiting) >= _CHUNK:
            self._ingest()

    def event(self, event: Event) -> None:
        """Takes an event of the log: from the first phase of the flight itself on, addresses and frames are fixed."""
        if self.settled_ns is not None or not event.text.startswith(PHASE_PREFIX):
            return
        phase = event.text.removeprefix(PHASE_PREFIX).strip()
        if phase not in _BEFORE_FLIGHT:
            self._ingest()
            self._fleet.hold_addresses(self._signed)
            self.settled_ns = event.t_ns
            self.armed_ns = event.t_ns if phase == _ARM else None

    @property
    def addresses(self) -> list[tuple[int, int]]:
        """Link and system id of each vehicle."""
        return list(zip(self._fleet.link.tolist(), self._fleet.sysid.tolist(), strict=True))

    def local(self) -> Reports:
        """LOCAL_POSITION_NED so far."""
        self._ingest()
        return _joined(self._local)

    def places(self) -> Reports:
        """GLOBAL_POSITION_INT so far."""
        self._ingest()
        return _joined(self._places)

    def attitudes(self) -> Attitudes:
        """ATTITUDE_QUATERNION so far, and ATTITUDE of those who send no quaternions, as in flight."""
        self._ingest()
        told = {row for part in self._quaternions for row in part.vehicle.tolist()}
        parts = list(self._quaternions)
        for part in self._angles:
            alone = ~np.isin(part.vehicle, list(told))
            parts.append(Attitudes(part.t_ns[alone], part.vehicle[alone], part.rpy_ned_rad[alone]))
        whole = np.zeros(0, dtype=np.int64)
        parts.append(Attitudes(whole, whole, np.zeros((0, 3))))
        return Attitudes(
            np.concatenate([item.t_ns for item in parts]),
            np.concatenate([item.vehicle for item in parts]),
            np.concatenate([item.rpy_ned_rad for item in parts]),
        )

    def _ingest(self) -> None:
        waiting, self._waiting = self._waiting, []
        if waiting:
            self._fleet.ingest(waiting)
            self._drop_the_rest()

    def _drop_the_rest(self) -> None:
        fleet = self._fleet
        for take in (fleet.take_acks, fleet.take_texts, fleet.take_param_values, fleet.take_timesync_requests):
            take()  # of no use here, and not to be kept

    def _look(self, batch: Batch, vehicle: IntArray, t_ns: IntArray, news: BoolArray) -> None:
        self._look_for_restarts(batch, vehicle, t_ns)
        values = batch.values
        if batch.name == "LOCAL_POSITION_NED":
            position, velocity = (
                np.stack([values[name] for name in names], axis=1).astype(np.float64)
                for names in (("x", "y", "z"), ("vx", "vy", "vz"))
            )
            taken = news if self._velocity_needed else np.asarray(np.isfinite(position).all(axis=1))
            whole = Reports(t_ns, vehicle, values["time_boot_ms"].astype(np.int64), position, velocity)
            self._local.append(whole.where(taken))
        elif batch.name == "GLOBAL_POSITION_INT":
            place = np.stack([values["lat"] * 1e-7, values["lon"] * 1e-7, values["alt"] * 1e-3], axis=1)
            velocity = np.stack([values["vx"], values["vy"], values["vz"]], axis=1) * 0.01
            whole = Reports(t_ns, vehicle, values["time_boot_ms"].astype(np.int64), place, velocity)
            self._places.append(whole.where(news))
        elif batch.name == "ATTITUDE_QUATERNION":
            quat = columns(values, "q1", 4).astype(np.float64)
            norm = norms(quat)
            good: BoolArray = np.asarray(np.isfinite(norm) & (np.abs(norm - 1.0) < _ROTATION_OFF))
            self._quaternions.append(Attitudes(t_ns[good], vehicle[good], _rpy_ned_rad(quat[good])))
        elif batch.name == "ATTITUDE":
            angles = np.stack([values[name] for name in ("roll", "pitch", "yaw")], axis=1).astype(np.float64)
            good = np.asarray(np.isfinite(angles).all(axis=1))
            self._angles.append(Attitudes(t_ns[good], vehicle[good], angles[good]))
        elif batch.name == "GPS_GLOBAL_ORIGIN":
            for row, t, item in zip(vehicle[news].tolist(), t_ns[news].tolist(), values[news], strict=True):
                self._look_at_origin(row, t, (int(item["latitude"]), int(item["longitude"]), int(item["altitude"])))

    def _look_into_room(self, seen: Seen) -> None:
        k = len(seen.row)
        t_ns = np.full(k, seen.t_rx_ns, dtype=np.int64)
        boot_ms = np.full(k, max(0, seen.measured_ns) // 1_000_000, dtype=np.int64)
        self._local.append(Reports(t_ns, seen.row, boot_ms, seen.pos_ned_m, seen.vel_ned_m_s))

    def _look_for_restarts(self, batch: Batch, vehicle: IntArray, t_ns: IntArray) -> None:
        restarted = np.flatnonzero(self._fleet.restarts > self._restarts)
        self._restarts = self._fleet.restarts.copy()
        names = batch.values.dtype.names or ()
        boot_ms = batch.values["time_boot_ms"].astype(np.int64) if "time_boot_ms" in names else None
        for row in restarted.tolist():
            own = vehicle == row
            first_ns = int(t_ns[own][0])
            if boot_ms is not None:
                before = np.maximum.accumulate(np.append(self._boot_ms[row], boot_ms[own]))[:-1]
                back = np.flatnonzero(boot_ms[own] < before - _BACK_MS)
                first_ns = int(t_ns[own][back[0]]) if len(back) else first_ns
                self._boot_ms[row] = -1
            if self.settled_ns is not None:
                self.lost_ns[row] = min(first_ns, self.lost_ns.get(row, first_ns))
        if batch.name == "LOCAL_POSITION_NED" and boot_ms is not None:
            np.maximum.at(self._boot_ms, vehicle, boot_ms)

    def _look_at_origin(self, row: int, t_ns: int, place: tuple[int, int, int]) -> None:
        apart = max(abs(a - b) for a, b in zip(place, self._origin.get(row, place), strict=True))
        if self.settled_ns is not None and apart > _ORIGIN_SAME:
            told_ns = t_ns - _TOLD_LATE_NS  # it is told after it was moved
            self.lost_ns[row] = min(told_ns, self.lost_ns.get(row, told_ns))
        self._origin[row] = place


def of_mission(mission: Values) -> Admission:
    """The rule of a flight, as the manifest tells its mission; see ``Admission``.

    Args:
        mission: with ``vehicles``, each with a usable ``id``.
    """
    vehicles = mission.get("vehicles") or ()
    gateway = mission.get("gateway")
    behind = gateway.get("link") if isinstance(gateway, Mapping) else None
    given = [vehicle["link"] if isinstance(vehicle.get("link"), str) else None for vehicle in vehicles]
    urls = [None if url is None else mavlink_url(url, behind) for url in given]
    numbers = {url: number for number, url in enumerate(dict.fromkeys(urls))}
    signing = mission.get("signing")
    own = signing.get("links") if isinstance(signing, Mapping) else None
    signed = []
    for url, number in numbers.items():
        how = own[url] if isinstance(own, Mapping) and url in own else signing
        if isinstance(how, Mapping) and how.get("key_file"):
            signed.append(number)
    return Admission(
        system_ids(mission),
        [None if url is None else numbers[url] for url in urls],
        signed=signed,
        velocity_needed="source" not in mission,
        room=room_config(mission, None, len(numbers)),
    )


def _rpy_ned_rad(quat_ned_from_frd: FloatArray) -> FloatArray:
    """Roll, pitch and yaw, shape (k, 3), of quaternions, scalar first, shape (k, 4), of any length."""
    w, x, y, z = (quat_ned_from_frd / norms(quat_ned_from_frd)[:, None]).T
    roll = np.arctan2(2.0 * (w * x + y * z), 1.0 - 2.0 * (x * x + y * y))
    pitch = np.arcsin(np.clip(2.0 * (w * y - z * x), -1.0, 1.0))
    yaw = np.arctan2(2.0 * (w * z + x * y), 1.0 - 2.0 * (y * y + z * z))
    return np.stack([roll, pitch, yaw], axis=1)


def _joined(parts: Sequence[Reports]) -> Reports:
    whole, vectors = np.zeros(0, dtype=np.int64), np.zeros((0, 3))
    none = Reports(whole, whole, whole, vectors, vectors)
    every = (none, *parts)
    return Reports(
        np.concatenate([item.t_ns for item in every]),
        np.concatenate([item.vehicle for item in every]),
        np.concatenate([item.boot_ms for item in every]),
        np.concatenate([item.position for item in every]),
        np.concatenate([item.vel_ned_m_s for item in every]),
    )
