"""Where each vehicle of a log was, in one frame where there is one, out of the reports that its flight let in."""

from __future__ import annotations

import reprlib
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pymap3d

from groundstation.core.errors import UserError
from groundstation.core.types import BoolArray, FloatArray, IntArray
from groundstation.mavlink.codec import Batch, decode, message_id
from groundstation.records.admission import Admission, Reports
from groundstation.records.manifest import Values
from groundstation.records.notes import Sent
from groundstation.records.spans import Span

_SETPOINT = message_id("SET_POSITION_TARGET_LOCAL_NED")
_CHUNK = 2_048
_IGNORE_VELOCITY = 0x0038  # bits of SET_POSITION_TARGET_LOCAL_NED.type_mask


@dataclass(frozen=True)
class VehicleTrack:
    """What the log says of one vehicle.

    Attributes:
        id: by which the mission names the vehicle; its system id without a mission.
        sysid: MAVLink system id on its link.
        link: number of that link; -1 where nothing was heard of it.
        t_ns: times of the reported positions, shape (k,), not decreasing.
        pos_team_enu_m: reported positions, shape (k, 3); in the vehicle's own frame when ``in_team_frame`` is False.
        vel_enu_m_s: velocities of the same reports, shape (k, 3); NaN where they told none.
        attitude_t_ns: times of the reported attitudes, shape (a,), not decreasing.
        rpy_ned_rad: roll, pitch and yaw of those attitudes, shape (a, 3).
        in_team_frame: whether the place of its origin in the team's frame is known.
        setpoint_t_ns: times of the velocity setpoints sent to it, shape (m,).
        setpoint_vel_enu_m_s: those setpoints, shape (m, 3).
    """

    id: int
    sysid: int
    link: int
    t_ns: IntArray
    pos_team_enu_m: FloatArray
    vel_enu_m_s: FloatArray
    attitude_t_ns: IntArray
    rpy_ned_rad: FloatArray
    in_team_frame: bool
    setpoint_t_ns: IntArray
    setpoint_vel_enu_m_s: FloatArray


def tracks_of(
    path: Path,
    mission: Values,
    result: Values,
    *,
    ids: Sequence[int],
    admission: Admission,
    setpoints: SetpointColumns,
    start_ns: int,
) -> tuple[tuple[VehicleTrack, ...], bool]:
    """Puts the tracks of a flight together.

    Local positions count from where the flight or the mission says that they begin. Vehicles that are flown by their
    places on earth, and all vehicles of a log without a mission whose places on earth are known, are set in one frame
    by those.

    Args:
        path: of the log, for messages.
        mission: of the manifest; empty without one.
        result: of the manifest; empty without one.
        ids: of the vehicles, in the order of the rows of ``admission``.
        admission: has taken the whole log.
        setpoints: that were sent.
        start_ns: time of the first record.

    Returns:
        The tracks, and whether they are by places on earth.

    Raises:
        UserError: the manifest is damaged.
    """
    offsets = offsets_of(path, mission, result)
    local, places = admission.local(), admission.places()
    vehicles = mission.get("vehicles") or ()
    by_place = bool(vehicles) and all(item.get("position") == "global" for item in vehicles)
    if not vehicles:
        placed = set(np.unique(places.vehicle).tolist())
        named = placed | set(np.unique(local.vehicle).tolist())
        by_place = bool(placed) and (len(named) > 1 or not len(local.t_ns)) and placed == named
    if by_place:
        local = _from_places(places, admission.settled_ns, mission)
    moved = _moved(mission, result)
    settled_ns = start_ns if admission.armed_ns is None else admission.armed_ns
    attitudes = admission.attitudes()
    tracks = []
    for row, (own_id, (link, sysid)) in enumerate(zip(ids, admission.addresses, strict=True)):
        own = local.of(row)
        lost_ns = None if by_place else admission.lost_ns.get(row)
        keep = np.ones(len(own.t_ns), dtype=np.bool_) if lost_ns is None else own.t_ns < lost_ns
        if own_id in moved and not by_place:
            keep &= own.t_ns >= settled_ns
        offset = np.zeros(3) if by_place else offsets.get(own_id)
        north, east, down = own.position[keep].T
        order = np.argsort(own.t_ns[keep], kind="stable")
        vel_north, vel_east, vel_down = own.vel_ned_m_s[keep][order].T
        leant, target = attitudes.of(row), setpoints.to(link, sysid)
        in_time = np.argsort(leant.t_ns, kind="stable")
        tracks.append(
            VehicleTrack(
                id=own_id,
                sysid=sysid,
                link=link,
                t_ns=own.t_ns[keep][order],
                pos_team_enu_m=(np.stack([east, north, -down], axis=-1) + (0.0 if offset is None else offset))[order],
                vel_enu_m_s=np.stack([vel_east, vel_north, -vel_down], axis=-1),
                attitude_t_ns=leant.t_ns[in_time],
                rpy_ned_rad=leant.rpy_ned_rad[in_time],
                in_team_frame=offset is not None,
                setpoint_t_ns=setpoints.t_ns[target],
                setpoint_vel_enu_m_s=setpoints.vel_enu_m_s[target],
            )
        )
    return tuple(tracks), by_place


def _from_places(places: Reports, settled_ns: int | None, mission: Values) -> Reports:
    """Places on earth as metres north, east and down of one place on earth.

    The frame hangs on the first vehicle, as in flight: where it stood when the flight began is its pad. Without a
    mission, where it was first is the origin.
    """
    if not len(places.t_ns):
        return places
    first = places.of(int(places.vehicle.min()))
    before = np.flatnonzero(first.t_ns <= (settled_ns if settled_ns is not None else first.t_ns[0]))
    anchor = first.position[before[-1] if len(before) else 0]
    north, east, down = pymap3d.geodetic2ned(*places.position.T, *anchor)
    position = np.stack([north, east, down], axis=-1)
    vehicles = mission.get("vehicles") or ()
    if vehicles:
        east_m, north_m, up_m = np.array(vehicles[0].get("pad_m") or (0.0, 0.0, 0.0), dtype=np.float64)
        position += [north_m, east_m, -up_m]
    return Reports(places.t_ns, places.vehicle, places.boot_ms, position, places.vel_ned_m_s)


def anchor_of(path: Path, mission: Values, tracks: Sequence[VehicleTrack], places: Reports) -> FloatArray | None:
    """Where on earth the frame of the tracks begins.

    The mission says it, or a vehicle whose place in that frame is known says where on earth it was at the same moment.
    A team that is not flown by GPS has no such place, whatever its vehicles may believe.

    Args:
        path: of the log, for messages.
        mission: of the manifest; empty without one.
        tracks: of the vehicles.
        places: GLOBAL_POSITION_INT, by row of ``tracks``.

    Returns:
        Latitude and longitude in degrees, height in metres, shape (3,); None where that is not known.

    Raises:
        UserError: the manifest is damaged.
    """
    vehicles = mission.get("vehicles") or ()
    outdoors = [item.get("position") == "global" or item.get("origin") == "gps" for item in vehicles]
    if vehicles and not any(outdoors):
        return None
    if isinstance(given := mission.get("anchor"), dict):
        told = [given.get(name) for name in ("lat_deg", "lon_deg", "alt_m")]
        return vectors(f"{path}: manifest: mission.anchor", told, (3,))
    for row, track in enumerate(tracks):
        seen = places.of(row)
        usable = (track.in_team_frame or len(tracks) == 1) and (not vehicles or outdoors[row])
        if not usable or not len(seen.t_ns) or not len(track.t_ns):
            continue
        # The first moment at which it told both: it stood on the ground.
        at = int(np.searchsorted(seen.t_ns, track.t_ns[0]))
        at = min(at, len(seen.t_ns) - 1)
        beside = max(0, int(np.searchsorted(track.t_ns, seen.t_ns[at], side="right")) - 1)
        east, north, up = track.pos_team_enu_m[beside]
        return np.array(pymap3d.enu2geodetic(-east, -north, -up, *seen.position[at]), dtype=np.float64)
    return None


def _moved(mission: Values, result: Values) -> set[int]:
    """Vehicles by GPS, which may have moved their origins until the frames were settled, just before arming."""
    if not result.get("local_origins_enu_m"):
        return set()
    return {v["id"] for v in mission.get("vehicles") or () if v.get("origin", "pad") not in ("pad", "team")}


@dataclass(frozen=True)
class SetpointColumns:
    """Velocity setpoints of a log, in order of time; those that are no numbers are left out.

    Attributes:
        t_ns: when they were sent, shape (k,).
        link: over which link, -1 where the log does not tell, shape (k,).
        sysid: to which system, shape (k,).
        vel_enu_m_s: shape (k, 3).
    """

    t_ns: IntArray
    link: IntArray
    sysid: IntArray
    vel_enu_m_s: FloatArray

    @classmethod
    def of(cls, batch: Batch, t_ns: IntArray, link: IntArray) -> SetpointColumns:
        """Unpacks SET_POSITION_TARGET_LOCAL_NED, in order of time.

        Args:
            batch: k of them.
            t_ns: when each was sent, shape (k,).
            link: over which link, -1 where nobody tells, shape (k,).
        """
        values = batch.values
        north, east, down = (values[name].astype(np.float64) for name in ("vx", "vy", "vz"))
        vectors = np.stack([east, north, -down], axis=-1)
        good = np.all(np.isfinite(vectors), axis=-1) & ((values["type_mask"] & _IGNORE_VELOCITY) == 0)
        order = np.flatnonzero(good)[np.argsort(t_ns[good], kind="stable")]
        return cls(t_ns[order], link[order], values["target_system"][order].astype(np.int64), vectors[order])

    def to(self, link: int, sysid: int) -> BoolArray:
        """Which of them went to a vehicle, shape (k,)."""
        return np.asarray((self.sysid == sysid) & ((self.link < 0) | (self.link == link)))


class Setpoints:
    """Collects the velocity setpoints of a log; a thousand vehicles are sent 50,000 in a second."""

    def __init__(self) -> None:
        none = np.zeros(0, dtype=np.int64)
        self._parts = [SetpointColumns(none, none, none, np.zeros((0, 3)))]
        self._waiting: list[Sent] = []

    def take(self, sent: Sent) -> None:
        """Takes what was sent; all but setpoints is passed over."""
        if sent.frame.msgid == _SETPOINT:
            self._waiting.append(sent)
            if len(self._waiting) >= _CHUNK:
                self._unpack()

    def take_span(self, span: Span) -> None:
        """Takes all that was sent in a span."""
        self._unpack()
        for batch in span.sent.decode((_SETPOINT,)):
            datagram = span.sent.datagram[batch.index]
            t_ns = span.sent.datagrams.t_rx_ns[datagram]
            self._parts.append(SetpointColumns.of(batch, t_ns, span.sent_link[batch.index]))

    def columns(self) -> SetpointColumns:
        """All so far, in order of time."""
        self._unpack()
        t_ns = np.concatenate([part.t_ns for part in self._parts])
        order = np.argsort(t_ns, kind="stable")
        return SetpointColumns(
            t_ns[order],
            np.concatenate([part.link for part in self._parts])[order],
            np.concatenate([part.sysid for part in self._parts])[order],
            np.concatenate([part.vel_enu_m_s for part in self._parts])[order],
        )

    def _unpack(self) -> None:
        sent, self._waiting = self._waiting, []
        for batch in decode([item.frame for item in sent]):
            t_ns = np.array([item.t_ns for item in sent], dtype=np.int64)
            link = np.array([-1 if item.link is None else item.link for item in sent], dtype=np.int64)
            self._parts.append(SetpointColumns.of(batch, t_ns, link))


def offsets_of(path: Path, mission: Values, result: Values) -> dict[int, FloatArray | None]:
    """Where each vehicle's own origin lies in the team's frame; None where that is not known.

    What the flight found out (``local_origins_enu_m`` of its result) comes before what the mission says.
    """
    offsets: dict[int, FloatArray | None] = {}
    found = result.get("local_origins_enu_m") or ()
    for index, vehicle in enumerate(mission.get("vehicles") or ()):
        where = f"{path}: manifest: mission.vehicles[{index}]"
        try:
            own_id, origin = int(vehicle["id"]), vehicle.get("origin", "pad")
        except (KeyError, TypeError, ValueError, AttributeError) as error:
            raise UserError(f"{where}: no usable id; the manifest is damaged") from error
        told = found[index] if index < len(found) else None
        if told is not None and None not in told:
            offsets[own_id] = vectors(f"{path}: manifest: result.local_origins_enu_m[{index}]", told, (3,))
        elif origin == "team":
            offsets[own_id] = np.zeros(3)
        elif origin == "pad":
            offsets[own_id] = vectors(f"{where}.pad_m", vehicle.get("pad_m"), (3,))
        else:
            offsets[own_id] = None
    return offsets


def vectors(where: str, value: object, shape: tuple[int, ...]) -> FloatArray:
    """Numbers out of a manifest in a shape.

    Raises:
        UserError: they are none, or too many or few.
    """
    try:
        array = np.array(value, dtype=np.float64).reshape(shape)
    except (TypeError, ValueError) as error:
        raise UserError(
            f"{where}: {reprlib.repr(value)} are not the numbers expected; the manifest is damaged"
        ) from error
    if not np.all(np.isfinite(array)):
        raise UserError(f"{where}: {reprlib.repr(value)}: expected finite numbers; the manifest is damaged")
    return array
