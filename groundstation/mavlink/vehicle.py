"""What the ground station knows of its vehicles: one struct of arrays, row i = vehicle i.

Takes frames with the time of their arrival and keeps the newest value of everything, with its age. Frames of
systems that are not on the list change nothing and are counted. Decides nothing: monitors and autopilot classes
read this state.

Times are integers in ns on the clock that the caller passes in; those of poses are when the vehicle measured them,
as far as its clock is known (``clocks``). Unknown is NaN, ``NEVER`` or ``UNKNOWN``, not 0.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from groundstation.core import frames
from groundstation.core.quick import every, finite_rows, norms, some
from groundstation.core.types import BoolArray, FloatArray, IntArray
from groundstation.mavlink.blocks import Block
from groundstation.mavlink.clocks import BootTimes, Clocks
from groundstation.mavlink.codec import Batch, Frame, columns, decode, layout, message_id, message_name
from groundstation.mavlink.kinds import TYPE_GCS, Kind, kind_of
from groundstation.mavlink.mocap_frames import room_frames, room_words
from groundstation.mavlink.params import ParamValue
from groundstation.mavlink.senders import Senders
from groundstation.mavlink.texts import Text, Texts
from groundstation.mavlink.traffic import Traffic
from groundstation.mocap.bodies import RoomConfig
from groundstation.mocap.room import Room, Seen

NEVER = np.iinfo(np.int64).min // 2
"""Time of something that has not happened; far enough back that every age limit is passed."""
UNKNOWN = -1
AUTOPILOT_COMPID = 1
ARMED_FLAG = 0x80  # MAV_MODE_FLAG_SAFETY_ARMED
_PREARM_BIT = 0x10000000  # MAV_SYS_STATUS_PREARM_CHECK
_VOLTAGE_UNKNOWN = 65_535
_HEARTBEAT = message_id("HEARTBEAT")
_TYPE_AT, _AUTOPILOT_AT = (layout("HEARTBEAT").place_of(name) for name in ("type", "autopilot"))
_KIND_BYTES = max(_TYPE_AT, _AUTOPILOT_AT) + 1
_PEER_SILENT_NS = 1_500_000_000  # only then may a vehicle's datagrams come from another address
_RIVAL_NS = 5_000_000_000
_QUATERNION_OLD_NS = 500_000_000  # only then is the attitude taken from Euler angles
_ORIGIN_SAME_M = 0.05
_ORIGIN_FAR_M = 3_000.0  # and twice the local position, for what the curved earth makes of one that is far
_ORIGINS_NS = 10_000_000_000
_ELSEWHERE_MAX = 2_000
_METRES_PER_DEGREE = 111_320.0
_ABOVE_FRESH_NS = 500_000_000  # a vehicle whose motors stop at 3 m is down after 0.8 s
_LANDED_FRESH_NS = 3_000_000_000  # so long a landed state speaks against a heartbeat
_TWO_PLACES_M = 1.0
_STILL_M_S = 0.25  # whoever comes down is faster
_FRESH_NS = 500_000_000
_OWN_VELOCITY_NS = 300_000_000
COUNTED = ("LOCAL_POSITION_NED", "GLOBAL_POSITION_INT", "ATTITUDE_QUATERNION", "ATTITUDE")
"""Message types whose rate is looked after."""

HEARTBEAT_PATIENCE = 3.0
"""How many times longer a heartbeat may be missing than everything."""
LANDED_ON_GROUND, LANDED_IN_AIR, LANDED_TAKEOFF, LANDED_LANDING = 1, 2, 3, 4  # MAV_LANDED_STATE
LINK_HEARD, LINK_TRIP = "link_heard", "link_trip"
"""Names under which a gateway tells of a vehicle's radio link (NAMED_VALUE_FLOAT): a share, seconds."""
_OFF_THE_GROUND = (LANDED_IN_AIR, LANDED_TAKEOFF, LANDED_LANDING)


class ReceivedFrame(NamedTuple):
    """A frame, where it came from and when."""

    frame: Frame
    link: int
    peer: str
    t_rx_ns: int


def received_frames(block: Block) -> list[ReceivedFrame]:
    """The frames of a block one by one."""
    return [
        ReceivedFrame(piece, link, peer, t_rx_ns)
        for link, peer, pieces, t_rx_ns in block.pieces()
        for piece in pieces
        if isinstance(piece, Frame)
    ]


@dataclass(frozen=True)
class Ack:
    """COMMAND_ACK of one vehicle: ``result`` is a MAV_RESULT."""

    vehicle: int
    command: int
    result: int
    t_rx_ns: int


@dataclass(frozen=True)
class TimesyncRequest:
    """TIMESYNC with tc1 = 0: the vehicle asks for our clock; ``ts1_ns`` is to be sent back."""

    vehicle: int
    ts1_ns: int
    t_rx_ns: int


Watch = Callable[[Batch, IntArray, IntArray, BoolArray], None]
"""Is shown a batch of admitted frames, their vehicles, their arrivals and which of them were news, shape (k,) each."""


class Fleet:
    """State of n vehicles as their telemetry tells it.

    Attributes:
        ids: by which the team and its messages name the vehicles, shape (n,).
        sysid: MAVLink system ids on their links, shape (n,); the same one may stand on two links.
        link: index of the link each vehicle is expected on, shape (n,); changed by ``expect_on`` alone.
        peer: address that each vehicle was last heard from on its link; None before.
        heard_ns: arrival of the last frame of any kind, shape (n,).
        heartbeat_ns: arrival of the last HEARTBEAT, shape (n,).
        autopilot: MAV_AUTOPILOT, UNKNOWN before the first heartbeat, shape (n,).
        mav_type: MAV_TYPE of the same, shape (n,).
        custom_mode: autopilot's own mode word, UNKNOWN before, shape (n,).
        armed: from the heartbeat, shape (n,). "Disarmed" is not believed of one that was armed while its landed state
            says that it is in the air, or while it is seen high above the ground: autopilots stand on the ground by
            their own report as soon as they disarm, and fall where they do so in the air.
        disarm_doubted: such a heartbeat was the last one, shape (n,).
        disarm_expected: its motors were told to stop: then that word is believed, whatever else it says, shape (n,).
        above_ns: when it was last seen high above the ground, by whoever knows where that is, shape (n,).
        ground_doubted: reports to stand on the ground and is seen above it, shape (n,); whoever sees that tells it.
        system_status: MAV_STATE, UNKNOWN before, shape (n,).
        pos_local_ned_m: newest valid LOCAL_POSITION_NED, in each vehicle's own origin, NaN before, shape (n, 3).
        vel_ned_m_s: velocity of the same message, shape (n, 3).
        pose_ns: when that was measured, shape (n,).
        place_deg_m: latitude, longitude (degrees) and height above sea level of the newest GLOBAL_POSITION_INT,
            NaN before, shape (n, 3).
        place_vel_ned_m_s: velocity of the same message, shape (n, 3).
        place_ns: when that was measured, shape (n,).
        origin_deg_m: the estimator's origin as the newest GPS_GLOBAL_ORIGIN tells it, NaN before, shape (n, 3).
        origin_ns: its arrival, shape (n,).
        home_deg_m: where the vehicle took off, on earth, as HOME_POSITION tells it, NaN before, shape (n, 3).
        home_local_ned_m: the same in its own frame, shape (n, 3); zeros from autopilots that leave it out.
        origin_moved_ns: arrival of the last origin that differed from the one before, shape (n,).
        origin_moved_m: by how much, shape (n,).
        quat_ned_from_frd: newest valid attitude, w x y z, w >= 0, NaN before, shape (n, 4).
        attitude_ns: when that was measured, shape (n,).
        seen: messages so far by type, of those in ``COUNTED``, shape (n,) each.
        clocks: the vehicles' clocks on ours.
        senders: who else speaks under the vehicles' ids.
        restarts: times that a vehicle was seen to start anew, shape (n,).
        traffic: aircraft that are none of the team, as vehicles pass on what is told of them.
        landed_state: MAV_LANDED_STATE, 0 (undefined) before, shape (n,).
        landed_ns: arrival of the last EXTENDED_SYS_STATE, shape (n,).
        prearm_ok: the autopilot's own arming checks pass, shape (n,).
        status_ns: arrival of the last SYS_STATUS, shape (n,).
        battery_remaining: 0 to 1, NaN when not reported, shape (n,).
        battery_v: voltage of the pack, NaN when not reported, shape (n,).
        sensors_enabled: MAV_SYS_STATUS_SENSOR bits in use, shape (n,).
        sensors_healthy: those of them that are well, shape (n,).
        estimator_flags: ESTIMATOR_STATUS_FLAGS or EKF_STATUS_FLAGS, read by the autopilot classes; UNKNOWN before,
            shape (n,).
        estimator_ns: their arrival, shape (n,).
        gps_fix: GPS_FIX_TYPE of a first and a second receiver (GPS_RAW_INT, GPS2_RAW), UNKNOWN before, shape (2, n).
        gps_fix_ns: their arrival, shape (2, n).
        velocity_ratio: how far measured velocities are off the estimated one, in shares of what the estimator takes
            for possible, from the same messages, NaN before, shape (n,).
        link_heard: share of what a vehicle's radio sends that comes, 0 to 1, as its gateway measures it; NaN where
            nobody does, shape (n,).
        link_trip_s: how long a packet takes there and back, the same, shape (n,).
        firmware: flight_sw_version of AUTOPILOT_VERSION: major, minor, patch, type, a byte each; UNKNOWN before,
            shape (n,).
        counts: events that are counted rather than raised, for example ``"unknown system"``.
        watch: looks on at what is let in, so that whoever reads a log counts what the flight counted; None for nobody.
        room: follows the bodies of a motion capture system, whose positions then count in place of the vehicles' own;
            None without.
        watch_room: the same as ``watch`` for those; None for nobody.
    """

    def __init__(
        self,
        sysids: Sequence[int],
        links: Sequence[int],
        room: RoomConfig | None = None,
        ids: Sequence[int] | None = None,
    ) -> None:
        """Knows nothing yet of n vehicles.

        Args:
            sysids: MAVLink system ids, each once on its link.
            links: index of each vehicle's link, -1 where it is not known yet.
            room: of a motion capture system.
            ids: by which the team names them; their system ids when None.
        """
        n = len(sysids)
        self.sysid: IntArray = np.array(sysids, dtype=np.int64)
        self.ids: IntArray = self.sysid.copy() if ids is None else np.array(ids, dtype=np.int64)
        self.link: IntArray = np.array(links, dtype=np.int64)
        self.peer: list[str | None] = [None] * n
        self.heard_ns = _times(n)
        self.heartbeat_ns = _times(n)
        self.autopilot = _unknowns(n)
        self.mav_type = _unknowns(n)
        self.custom_mode = _unknowns(n)
        self.armed: BoolArray = np.zeros(n, dtype=np.bool_)
        self.disarm_doubted: BoolArray = np.zeros(n, dtype=np.bool_)
        self.disarm_expected: BoolArray = np.zeros(n, dtype=np.bool_)
        self.ground_doubted: BoolArray = np.zeros(n, dtype=np.bool_)
        self.above_ns: IntArray = np.full(n, NEVER, dtype=np.int64)
        self.system_status = _unknowns(n)
        self.pos_local_ned_m: FloatArray = np.full((n, 3), np.nan)
        self.vel_ned_m_s: FloatArray = np.full((n, 3), np.nan)
        self.pose_ns = _times(n)
        self.place_deg_m: FloatArray = np.full((n, 3), np.nan)
        self.place_vel_ned_m_s: FloatArray = np.full((n, 3), np.nan)
        self.place_ns = _times(n)
        self.origin_deg_m: FloatArray = np.full((n, 3), np.nan)
        self.origin_ns = _times(n)
        self.home_deg_m: FloatArray = np.full((n, 3), np.nan)
        self.home_local_ned_m: FloatArray = np.full((n, 3), np.nan)
        self.origin_moved_ns = _times(n)
        self.origin_moved_m: FloatArray = np.zeros(n)
        self.quat_ned_from_frd: FloatArray = np.full((n, 4), np.nan)
        self.attitude_ns = _times(n)
        self.landed_state: IntArray = np.zeros(n, dtype=np.int64)
        self.landed_ns = _times(n)
        self.prearm_ok: BoolArray = np.zeros(n, dtype=np.bool_)
        self.status_ns = _times(n)
        self.battery_remaining: FloatArray = np.full(n, np.nan)
        self.battery_v: FloatArray = np.full(n, np.nan)
        self.sensors_enabled: IntArray = np.zeros(n, dtype=np.int64)
        self.sensors_healthy: IntArray = np.zeros(n, dtype=np.int64)
        self.estimator_flags = _unknowns(n)
        self.estimator_ns = _times(n)
        self.gps_fix: IntArray = np.full((2, n), UNKNOWN, dtype=np.int64)
        self.gps_fix_ns: IntArray = np.full((2, n), NEVER, dtype=np.int64)
        self.velocity_ratio = np.full(n, np.nan)
        self.link_heard: FloatArray = np.full(n, np.nan)
        self.link_trip_s: FloatArray = np.full(n, np.nan)
        self.firmware = _unknowns(n)
        self.seen = {name: np.zeros(n, dtype=np.int64) for name in COUNTED}
        self.clocks = Clocks(n)
        self.restarts: IntArray = np.zeros(n, dtype=np.int64)
        self.traffic = Traffic()
        self.counts: Counter[str] = Counter()
        self.watch: Watch | None = None
        self.room = None if room is None else Room(room)
        self.watch_room: Callable[[Seen], None] | None = None
        self._own_velocity_ns = _times(n)
        self._row_of_id = {int(own): row for row, own in enumerate(self.ids)}
        self._index()
        self._source_of_row: IntArray = np.full(n, -1, dtype=np.int64)
        self._source_seen: tuple[tuple[tuple[int, str], ...], list[str | None]] = ((), [])
        self._acks: list[Ack] = []
        self._texts: list[Text] = []
        self._params: list[ParamValue] = []
        self._timesync: list[TimesyncRequest] = []
        self._quaternion_ns = _times(n)
        self._position_times, self._place_times, self._attitude_times = BootTimes(n), BootTimes(n), BootTimes(n)
        self._under_way = Texts()
        self._told: list[tuple[int, int, int] | None] = [None] * n
        self.senders = Senders(n)
        self._rivals: list[tuple[str, int] | None] = [None] * n
        self._elsewhere: dict[tuple[int, int], int] = {}
        self._held = False
        self._signed: frozenset[int] = frozenset()
        self._room_peer: str | None = None
        self._room_heard_ns = 0

    def __len__(self) -> int:
        """Number of vehicles, n."""
        return len(self.sysid)

    def _index(self) -> None:
        """Who is behind a link and a system id: row 0 of the table is for links that nobody is expected on."""
        self._row_of = {at: row for row, at in enumerate(zip(self.link.tolist(), self.sysid.tolist(), strict=True))}
        self._row_table: IntArray = np.full((int(self.link.max(initial=0)) + 2, 256), -1, dtype=np.int64)
        self._row_table[self.link + 1, self.sysid] = np.arange(len(self))
        self._row_table[0] = -1
        self._is_known: BoolArray = np.zeros(256, dtype=np.bool_)
        self._is_known[self.sysid] = True

    def expect_on(self, vehicle: int, link: int) -> None:
        """From now on a vehicle is expected on another link."""
        self.link[vehicle] = link
        self._index()

    def expect_disarm(self, vehicle: int) -> None:
        """Its motors are told to stop: a heartbeat that says disarmed is believed, whatever else the vehicle says."""
        self.disarm_expected[vehicle] = True

    def see_above(self, rows: BoolArray, now_ns: int) -> None:
        """These are seen high above the ground now, shape (n,)."""
        self.above_ns[rows] = now_ns

    def doubt_the_ground(self, rows: BoolArray) -> None:
        """These are seen above the ground, shape (n,), whatever they report; of the others it is believed again."""
        self.ground_doubted = rows.copy()

    def ingest(self, received: Sequence[ReceivedFrame]) -> None:
        """Takes frames in the order of their arrival.

        Args:
            received: anything that was well formed; from unknown systems, other components or the wrong link too.
        """
        if self.room is not None:
            received = self._without_the_room(self.room, received)
        accepted: list[ReceivedFrame] = []
        rows: list[int] = []
        for item in received:
            row = self._row_of.get((item.link, item.frame.sysid))
            if message_name(item.frame.msgid) is None:  # its checksum cannot be known: it may be noise
                self.counts["unknown message"] += 1
            elif not self._is_known[item.frame.sysid]:
                self.counts["unknown system"] += 1
                if item.frame.compid == AUTOPILOT_COMPID and len(self._elsewhere) < _ELSEWHERE_MAX:
                    self._elsewhere[item.frame.sysid, item.link] = item.t_rx_ns
            elif item.frame.compid != AUTOPILOT_COMPID:
                self.counts["other component"] += 1
                kind = kind_of(item.frame)
                if kind is not None and kind.is_autopilot and row is not None:
                    self.senders.other_component(row, item.frame.compid, item.t_rx_ns)
            elif row is None:
                self.counts["wrong link"] += 1
                self._elsewhere[item.frame.sysid, item.link] = item.t_rx_ns
            elif not self._is_of_its_kind(row, item):
                pass
            elif not self._from_its_address(row, item):
                self.counts["second sender under a vehicle's id"] += 1
            else:
                accepted.append(item)
                rows.append(row)
        if not accepted:
            return
        row_of_frame = np.array(rows, dtype=np.int64)
        time_of_frame = np.array([item.t_rx_ns for item in accepted], dtype=np.int64)
        self._handle(decode([item.frame for item in accepted]), row_of_frame, time_of_frame)

    def ingest_block(self, block: Block) -> None:
        """The same for a block of datagrams, without a step in Python for each frame as long as nothing is unusual."""
        if self.room is not None:
            self.ingest(received_frames(block))
            return
        row, system = self._rows(block)
        known, autopilot = block.known, block.compid == AUTOPILOT_COMPID
        right: BoolArray = known & (row >= 0) & autopilot
        right &= block.datagrams.source[block.datagram] == self._sources(block)[row]
        among = None
        system = known & system
        # A vehicle from elsewhere, or a heartbeat of another kind: who it is, is judged one by one.
        if not every(right[system & autopilot]) or not self._heartbeats_as_ever(block, row):
            self.ingest(received_frames(block))
            return
        if not every(right):
            self._count("unknown message", int((~known).sum()))
            self._count("unknown system", int((known & ~system).sum()))
            self._count("other component", int((system & ~autopilot).sum()))
            strangers = known & ~system & autopilot
            where = block.datagram[strangers]
            links, times = block.datagrams.link[where].tolist(), block.datagrams.t_rx_ns[where].tolist()
            for sysid, link, t_ns in zip(block.sysid[strangers].tolist(), links, times, strict=True):
                if len(self._elsewhere) < _ELSEWHERE_MAX:
                    self._elsewhere[sysid, link] = t_ns
            among = right.nonzero()[0]
            if not len(among):
                return
        time_of_frame = block.datagrams.t_rx_ns[block.datagram]
        self.heard_ns[row if among is None else row[among]] = time_of_frame if among is None else time_of_frame[among]
        self._handle(block.decode(_HANDLED_IDS, among), row, time_of_frame)

    def _rows(self, block: Block) -> tuple[IntArray, BoolArray]:
        """Vehicle that each frame's link and system id stand for, -1 for none, and whose id is any vehicle's."""
        where, table = block.datagrams, self._row_table
        place = np.where((where.link >= 0) & (where.link < len(table) - 1), where.link + 1, 0)[block.datagram]
        return table[place, block.sysid], self._is_known[block.sysid]

    def _without_the_room(self, room: Room, received: Sequence[ReceivedFrame]) -> list[ReceivedFrame]:
        """Takes what the motion capture tells; returns the rest."""
        link = room.config.link
        told = [item for item in received if item.link == link]
        if not told:
            return list(received)
        if self._room_peer is None or not self._held:
            self._room_peer = told[-1].peer
        self._follow_the_room(told)
        here = [(item.frame, item.t_rx_ns) for item in told if self._same_host(self._room_peer, item.peer)]
        self._count("motion capture: frames of a second sender", len(told) - len(here))
        for text in room_words(here):
            room.say(text)
        for frame in room_frames(here, self._row_of_id):
            seen = room.take(frame)
            if seen is not None:
                self._see(seen)
        return [item for item in received if item.link != link]

    def _follow_the_room(self, told: Sequence[ReceivedFrame]) -> None:
        """What reads the motion capture may have been begun anew, at another port of its host."""
        for item in told:
            if item.peer != self._room_peer:
                silent = item.t_rx_ns - self._room_heard_ns >= _PEER_SILENT_NS
                if not silent or not self._same_host(self._room_peer, item.peer):
                    continue
                self._room_peer = item.peer
            self._room_heard_ns = item.t_rx_ns

    def heard_at(self) -> list[tuple[int, str]]:
        """Link and address of all that are heard: vehicles, and what reads the motion capture."""
        at = zip(self.link.tolist(), self.peer, strict=True)
        room = () if self.room is None or self._room_peer is None else ((self.room.config.link, self._room_peer),)
        return [*((link, peer) for link, peer in at if peer is not None), *room]

    def _see(self, seen: Seen) -> None:
        """Takes positions of the room; velocities too, of those whose own estimate is not there or old."""
        row = seen.row
        self.pos_local_ned_m[row] = seen.pos_ned_m
        self.pose_ns[row] = seen.measured_ns
        old = seen.measured_ns - self._own_velocity_ns[row] > _OWN_VELOCITY_NS
        self.vel_ned_m_s[row[old]] = seen.vel_ned_m_s[old]
        if self.watch_room is not None:
            self.watch_room(seen)

    @staticmethod
    def _same_host(known: str | None, peer: str) -> bool:
        return known is None or known.rpartition(":")[0] == peer.rpartition(":")[0]

    def _heartbeats_as_ever(self, block: Block, row: IntArray) -> bool:
        """Whether all heartbeats under the vehicles' ids are of the autopilots that were heard there before."""
        beats = ((block.msgid == _HEARTBEAT) & (row >= 0)).nonzero()[0]
        if not len(beats):
            return True
        if not every(block.compid[beats] == AUTOPILOT_COMPID) or int(block.payload_size[beats].min()) < _KIND_BYTES:
            return False
        octets, payload, vehicle = np.frombuffer(block.data, dtype=np.uint8), block.payload[beats], row[beats]
        same_type = octets[payload + _TYPE_AT] == self.mav_type[vehicle]
        return every(same_type & (octets[payload + _AUTOPILOT_AT] == self.autopilot[vehicle]))

    def _sources(self, block: Block) -> IntArray:
        """Which of the block's sources each vehicle is heard from, -1 for none of them, shape (n,)."""
        if self._source_seen[0] is not block.datagrams.sources or self._source_seen[1] != self.peer:
            self._source_seen = (block.datagrams.sources, list(self.peer))
            number = {source: k for k, source in enumerate(block.datagrams.sources)}
            at = zip(self.link.tolist(), self.peer, strict=True)
            self._source_of_row[:] = [-1 if peer is None else number.get((link, peer), -1) for link, peer in at]
        return self._source_of_row

    def _handle(self, batches: Sequence[Batch], row_of_frame: IntArray, time_of_frame: IntArray) -> None:
        for batch in batches:
            handler = _HANDLERS.get(batch.name)
            if handler is not None:
                vehicle, t_ns = row_of_frame[batch.index], time_of_frame[batch.index]
                news = handler(self, batch, vehicle, t_ns)
                if self.watch is not None:
                    self.watch(batch, vehicle, t_ns, np.ones(len(batch), dtype=np.bool_) if news is None else news)

    def _is_of_its_kind(self, row: int, item: ReceivedFrame) -> bool:
        """Whether a frame is no heartbeat of somebody who is not the vehicle's autopilot: those count for nothing."""
        kind = kind_of(item.frame)
        if kind is None:
            return True
        if not kind.is_autopilot:
            who = "a ground station" if kind.mav_type == TYPE_GCS else "what is no autopilot"
            self.counts[f"heartbeat of {who} under a vehicle's id"] += 1
            self.senders.other_part(row, kind, item.t_rx_ns)
            return False
        known = Kind(int(self.mav_type[row]), int(self.autopilot[row]))
        if self._held and known.mav_type != UNKNOWN and kind != known:
            self.counts["heartbeat of another kind of vehicle under a vehicle's id"] += 1
            if item.peer == self.peer[row]:  # from elsewhere it can do no harm
                self.senders.other_kind(row, kind, item.t_rx_ns)
            return False
        return True

    def _from_its_address(self, row: int, item: ReceivedFrame) -> bool:
        """Whether a frame comes from where the vehicle is; that may move after a silence only, in the air not far."""
        known = self.peer[row]
        if known != item.peer:
            silent = item.t_rx_ns - int(self.heard_ns[row]) >= _PEER_SILENT_NS
            if known is not None and not (silent and self._may_move(row, known, item.peer)):
                if item.frame.msgid == _HEARTBEAT:
                    self._rivals[row] = (item.peer, item.t_rx_ns)
                return False
            self.peer[row] = item.peer
        self.heard_ns[row] = item.t_rx_ns
        return True

    def hold_addresses(self, signed: Collection[int] = ()) -> None:
        """From now on vehicles stay where they are: nobody else takes over the name of one that fell silent.

        Another port of the same host is let in still (a router that started anew), and anybody on links on which only
        those who have the key are heard at all.

        Args:
            signed: links that are signed.
        """
        self._held = True
        self._signed = frozenset(signed)
        if self.room is not None:
            self.room.hold()

    def _may_move(self, row: int, known: str, peer: str) -> bool:
        if not self._held or int(self.link[row]) in self._signed:
            return True
        return known.rpartition(":")[0] == peer.rpartition(":")[0]

    def twin(self, vehicle: int, now_ns: int) -> str | None:
        """Tells of a second vehicle that speaks under this one's system id; None when there is none."""
        rival = self._rivals[vehicle]
        if rival is not None and now_ns - rival[1] < _RIVAL_NS:
            return f"two vehicles say that they are {self.ids[vehicle]}, at {self.peer[vehicle]} and {rival[0]}"
        return self.twin_behind_one_address(vehicle, now_ns)

    def twin_behind_one_address(self, vehicle: int, now_ns: int) -> str | None:
        """The same of one whose frames cannot be told from the vehicle's own: they come from the same address."""
        if self._all_quiet():
            return None
        alternating = self.senders.alternating(vehicle, now_ns)
        if alternating is not None:
            return f"two senders say that they are {self.ids[vehicle]}, both at {self.peer[vehicle]}: {alternating}"
        times = (self._position_times, self._place_times, self._attitude_times)
        if any(item.two_at_once(vehicle, now_ns) for item in times):
            return (
                f"two vehicles say that they are {self.ids[vehicle]}, both at {self.peer[vehicle]}: their times"
                " since start-up alternate"
            )
        return None

    def _all_quiet(self) -> bool:
        """Whether nothing of any vehicle has ever gone to and fro."""
        times = self._position_times.quiet and self._place_times.quiet and self._attitude_times.quiet
        return times and self.senders.quiet

    def twins_behind_one_address(self, now_ns: int) -> dict[int, str]:
        """The same of everybody: words by row, of those that are two."""
        if self._all_quiet():
            return {}
        found = ((row, self.twin_behind_one_address(row, now_ns)) for row in range(len(self)))
        return {row: words for row, words in found if words is not None}

    def strangers(self, link: int, now_ns: int) -> list[int]:
        """System ids heard on a link in the last seconds that are not expected there."""
        ids = (sysid for (sysid, where), t_ns in self._elsewhere.items() if where == link and now_ns - t_ns < _RIVAL_NS)
        return sorted(ids)

    def links_of(self, sysid: int, now_ns: int) -> list[int]:
        """Links on which a system id was heard in the last seconds without being expected there."""
        return sorted(
            where for (name, where), t_ns in self._elsewhere.items() if name == sysid and now_ns - t_ns < _RIVAL_NS
        )

    def silent(self, now_ns: int, limit_s: float) -> BoolArray:
        """Vehicles of which nothing at all was heard for longer than a time, shape (n,)."""
        return np.asarray(now_ns - self.heard_ns > limit_s * 1e9)

    def heartbeat_stale(self, now_ns: int, limit_s: float) -> BoolArray:
        """Vehicles whose mode and arming are no longer known, shape (n,).

        Heartbeats come once a second, and a poor link loses four in a row now and then: as long as anything else
        arrives, they may be missing for three times the limit.
        """
        quiet = now_ns - self.heartbeat_ns > HEARTBEAT_PATIENCE * limit_s * 1e9
        return np.asarray(quiet | self.silent(now_ns, limit_s))

    def stands(self, now_ns: int, limit_s: FloatArray) -> BoolArray:
        """Vehicles that report to stand on the ground, and have done so lately, shape (n,).

        Args:
            now_ns: time of the tick.
            limit_s: age from which on that report says nothing of now, shape (n,).
        """
        told = (self.landed_state == LANDED_ON_GROUND) & (now_ns - self.landed_ns <= limit_s * 1e9)
        return np.asarray(told & ~self.ground_doubted)

    def _count(self, event: str, times: int) -> None:
        if times:
            self.counts[event] += times

    def take_acks(self) -> list[Ack]:
        """Hands out the command acknowledgements since the last call."""
        acks, self._acks = self._acks, []
        return acks

    def take_texts(self, now_ns: int = NEVER) -> list[Text]:
        """Hands out the vehicles' own words since the last call.

        Args:
            now_ns: time, by which pieces of a text that do not come are waited for no longer; without it they are.
        """
        self._texts.extend(self._under_way.late(now_ns))
        texts, self._texts = self._texts, []
        return texts

    def take_param_values(self) -> list[ParamValue]:
        """Hands out the parameters told since the last call."""
        values, self._params = self._params, []
        return values

    def take_timesync_requests(self) -> list[TimesyncRequest]:
        """Hands out the questions for our clock since the last call."""
        requests, self._timesync = self._timesync, []
        return requests

    def _heartbeat(self, batch: Batch, row: IntArray, t_ns: IntArray) -> None:
        values = batch.values
        armed = values["base_mode"] & ARMED_FLAG != 0
        mode = values["custom_mode"].astype(np.int64)
        self.autopilot[row], self.mav_type[row] = values["autopilot"], values["type"]
        kinds = values["type"].astype(np.int64) << 8 | values["autopilot"]
        self.senders.heartbeat(row, kinds, armed, mode, t_ns)
        flies = np.isin(self.landed_state[row], _OFF_THE_GROUND) & (t_ns - self.landed_ns[row] < _LANDED_FRESH_NS)
        above = self._is_above(row, t_ns)
        doubted = ~armed & self.armed[row] & (flies | above) & ~self.disarm_expected[row]
        if doubted.any():
            # Some firmware says "landing" for ever: one that stands still then has landed, unless two speak for it.
            moves = self._moves(row, t_ns) | self.senders.in_doubt(int(t_ns[-1]))[row]
            doubted &= (self.landed_state[row] != LANDED_LANDING) | moves | above
        for k in doubted.nonzero()[0].tolist():
            told = (int(t_ns[k]), int(mode[k]), int(values["system_status"][k]))
            self._told[int(row[k])] = told
        self.disarm_doubted[row] = doubted
        if some(doubted):
            self.counts["heartbeat that says disarmed of one that flies"] += int(doubted.sum())
            row, t_ns, armed, mode, values = (item[~doubted] for item in (row, t_ns, armed, mode, values))
        self.heartbeat_ns[row] = t_ns
        self.custom_mode[row] = mode
        self.armed[row] = armed
        self.system_status[row] = values["system_status"]

    def _is_above(self, row: IntArray, t_ns: IntArray) -> BoolArray:
        """Whether vehicles were seen high above the ground just now, shape (k,)."""
        above_ns = self.above_ns[row]
        return np.asarray((above_ns != NEVER) & (t_ns - above_ns < _ABOVE_FRESH_NS))

    def _moves(self, row: IntArray, t_ns: IntArray) -> BoolArray:
        """Whether vehicles move by either of their velocities, shape (k,); unknown counts as moving."""
        speeds = []
        for velocity, measured_ns in ((self.vel_ned_m_s, self.pose_ns), (self.place_vel_ned_m_s, self.place_ns)):
            speed = norms(velocity[row])
            speeds.append(np.where(t_ns - measured_ns[row] < _LANDED_FRESH_NS, speed, np.nan))
        known = np.isfinite(speeds)
        fastest = np.where(known, speeds, -1.0).max(axis=0)
        return np.asarray((fastest > _STILL_M_S) | ~known.any(axis=0))

    def _believe_disarmed(self, vehicle: int) -> None:
        """Takes the heartbeat that was doubted: the vehicle says that it is on the ground, too."""
        told = self._told[vehicle]
        if told is not None:
            self.heartbeat_ns[vehicle], self.custom_mode[vehicle], self.system_status[vehicle] = told
            self.armed[vehicle] = self.disarm_doubted[vehicle] = False
            self._told[vehicle] = None

    def _when(self, times: BootTimes, batch: Batch, row: IntArray, t_ns: IntArray) -> tuple[BoolArray, IntArray]:
        """Which rows of a batch are news, and when all of them were measured."""
        boot_ms = batch.values["time_boot_ms"].astype(np.int64)
        fresh, restarted = times.take(row, boot_ms, t_ns)
        for vehicle in restarted:
            self._start_anew(vehicle)
        if not every(fresh):
            self.counts["older than what was there"] += int((~fresh).sum())
        return fresh, self.clocks.measured_ns(row, boot_ms, t_ns)

    def _start_anew(self, vehicle: int) -> None:
        """Forgets what a vehicle that has started anew no longer stands for."""
        self.restarts[vehicle] += 1
        self.senders.forget_board(vehicle)
        self.clocks.forget(vehicle)
        self.origin_deg_m[vehicle] = np.nan
        self.origin_ns[vehicle] = NEVER
        self.home_deg_m[vehicle] = self.home_local_ned_m[vehicle] = np.nan
        self.prearm_ok[vehicle] = False

    def _local_position(self, batch: Batch, row: IntArray, t_ns: IntArray) -> BoolArray:
        self.seen["LOCAL_POSITION_NED"] += np.bincount(row, minlength=len(self))
        both = columns(batch.values, "x", 6).astype(np.float64)
        position, velocity, number = both[:, :3], both[:, 3:], finite_rows(both)
        fresh, measured_ns = self._when(self._position_times, batch, row, t_ns)
        valid: BoolArray = number & fresh
        if self.room is not None:
            self.vel_ned_m_s[row[valid]], self._own_velocity_ns[row[valid]] = velocity[valid], measured_ns[valid]
            return np.zeros(len(row), dtype=np.bool_)  # of a position that does not count there is no news
        self._compare_places(both, row, t_ns, number, valid)
        if not every(valid):
            self._count("position that is not a number", int((~number).sum()))
            position, velocity, row, measured_ns = position[valid], velocity[valid], row[valid], measured_ns[valid]
        self.pos_local_ned_m[row] = position
        self.vel_ned_m_s[row] = velocity
        self.pose_ns[row] = measured_ns
        return valid

    def _compare_places(
        self, both: FloatArray, row: IntArray, t_ns: IntArray, number: BoolArray, valid: BoolArray
    ) -> None:
        """Looks for positions that are not on the way of the one before: those of one vehicle are, late ones too.

        Many of one vehicle may come at once: each is compared with the last before it, since one jump is one.
        """
        if not some(norms(both[:, :3] - self.pos_local_ned_m[row]) > _TWO_PLACES_M):
            return
        before = np.hstack([self.pos_local_ned_m[row], self.vel_ned_m_s[row]])
        last: dict[int, tuple[FloatArray, int]] = {}
        for k in number.nonzero()[0].tolist():
            vehicle, here, now_ns = int(row[k]), both[k], int(t_ns[k])
            there, there_ns = last.get(vehicle, (before[k], int(self.pose_ns[vehicle])))
            away, speed = norms(here[:3] - there[:3]), norms(here[3:]) + norms(there[3:])
            if now_ns - there_ns < _FRESH_NS and away > _TWO_PLACES_M + speed:
                self.senders.other_place(vehicle, now_ns)
            if valid[k]:
                last[vehicle] = (here, now_ns)

    def _global_position(self, batch: Batch, row: IntArray, t_ns: IntArray) -> BoolArray:
        values = batch.values
        self.seen["GLOBAL_POSITION_INT"] += np.bincount(row, minlength=len(self))
        fresh, measured_ns = self._when(self._place_times, batch, row, t_ns)
        valid: BoolArray = fresh & _on_earth(values["lat"], values["lon"])
        place = _place(values["lat"], values["lon"], values["alt"])
        velocity = columns(values, "vx", 3).astype(np.float64) * 0.01
        self.place_deg_m[row[valid]] = place[valid]
        self.place_vel_ned_m_s[row[valid]] = velocity[valid]
        self.place_ns[row[valid]] = measured_ns[valid]
        return valid

    def _aircraft(self, batch: Batch, row: IntArray, t_ns: IntArray) -> None:
        self.traffic.take(batch, t_ns)

    def _origin(self, batch: Batch, row: IntArray, t_ns: IntArray) -> None:
        values = batch.values
        places = _place(values["latitude"], values["longitude"], values["altitude"])
        known = _on_earth(values["latitude"], values["longitude"])
        self._count("origin that is no place on earth", int((~known).sum()))
        far = known & self._elsewhere_on_earth(places, row, t_ns)
        self._count("origin that neither position agrees with", int(far.sum()))
        for vehicle in row[far].tolist():  # one that came before there were positions is no better
            if self._elsewhere_on_earth(self.origin_deg_m[[vehicle]], np.array([vehicle]), t_ns[-1:]).any():
                self.origin_deg_m[vehicle], self.origin_ns[vehicle] = np.nan, NEVER
        known &= ~far
        for vehicle, place, t in zip(row[known].tolist(), places[known], t_ns[known].tolist(), strict=True):
            north_m, east_m = (place[:2] - self.origin_deg_m[vehicle, :2]) * _METRES_PER_DEGREE
            east_m *= np.cos(np.radians(place[0]))
            moved_m = float(np.sqrt(north_m**2 + east_m**2 + (place[2] - self.origin_deg_m[vehicle, 2]) ** 2))
            if moved_m > _ORIGIN_SAME_M:  # not with NaN, that is: not the first time
                self.origin_moved_ns[vehicle], self.origin_moved_m[vehicle] = t, moved_m
            self.origin_deg_m[vehicle] = place
            self.origin_ns[vehicle] = t

    def _elsewhere_on_earth(self, places: FloatArray, row: IntArray, t_ns: IntArray) -> BoolArray:
        """Which origins or homes are kilometres from where both positions of their vehicle say, shape (k,)."""
        north_east = (places[:, :2] - self.place_deg_m[row, :2]) * _METRES_PER_DEGREE
        north_east[:, 1] *= np.cos(np.radians(places[:, 0]))
        local_m = np.linalg.norm(self.pos_local_ned_m[row], axis=1)
        far = np.linalg.norm(north_east, axis=1) > _ORIGIN_FAR_M + 2.0 * local_m  # NaN is not
        far &= (t_ns - self.place_ns[row] < _LANDED_FRESH_NS) & (t_ns - self.pose_ns[row] < _LANDED_FRESH_NS)
        return np.asarray(far)

    def _home(self, batch: Batch, row: IntArray, t_ns: IntArray) -> None:
        values = batch.values
        places = _place(values["latitude"], values["longitude"], values["altitude"])
        far = self._elsewhere_on_earth(places, row, t_ns)
        self._count("home that neither position agrees with", int(far.sum()))
        for vehicle in row[far].tolist():
            if self._elsewhere_on_earth(self.home_deg_m[[vehicle]], np.array([vehicle]), t_ns[-1:]).any():
                self.home_deg_m[vehicle] = self.home_local_ned_m[vehicle] = np.nan
        known = _on_earth(values["latitude"], values["longitude"]) & ~far
        self.home_deg_m[row[known]] = places[known]
        local = np.stack([values["x"], values["y"], values["z"]], axis=1).astype(np.float64)
        number = np.isfinite(local).all(axis=1) & ~far
        self.home_local_ned_m[row[number]] = local[number]

    def origin_unsteady(self, vehicle: int, now_ns: int) -> bool:
        """Whether the vehicle's origin has moved in the last ten seconds."""
        return now_ns - int(self.origin_moved_ns[vehicle]) < _ORIGINS_NS

    def _attitude_quaternion(self, batch: Batch, row: IntArray, t_ns: IntArray) -> None:
        self.seen["ATTITUDE_QUATERNION"] += np.bincount(row, minlength=len(self))
        quat = columns(batch.values, "q1", 4).astype(np.float64)
        norm = norms(quat)
        rotation = np.isfinite(norm) & (np.abs(norm - 1.0) < 0.05)
        fresh, measured_ns = self._when(self._attitude_times, batch, row, t_ns)
        valid = rotation & fresh
        if not every(valid):
            self._count("attitude that is no rotation", int((~rotation).sum()))
            quat, norm, row = quat[valid], norm[valid], row[valid]
            measured_ns, t_ns = measured_ns[valid], t_ns[valid]
        quat /= norm[:, None]
        self.quat_ned_from_frd[row] = np.where(quat[:, :1] < 0, -quat, quat)
        self.attitude_ns[row] = measured_ns
        self._quaternion_ns[row] = t_ns

    def _attitude_euler(self, batch: Batch, row: IntArray, t_ns: IntArray) -> None:
        """Takes attitudes from those who send no quaternions."""
        values = batch.values
        self.seen["ATTITUDE"] += np.bincount(row, minlength=len(self))
        needed = t_ns - self._quaternion_ns[row] > _QUATERNION_OLD_NS
        if not some(needed):
            return
        euler = np.stack([values["roll"], values["pitch"], values["yaw"]]).astype(np.float64)
        measured_ns = self.clocks.measured_ns(row, values["time_boot_ms"].astype(np.int64), t_ns)
        valid = needed & np.isfinite(euler).all(axis=0) & (measured_ns >= self.attitude_ns[row])
        self.quat_ned_from_frd[row[valid]] = frames.quat_ned_from_frd_of_euler(*euler[:, valid])
        self.attitude_ns[row[valid]] = measured_ns[valid]

    def _sys_status(self, batch: Batch, row: IntArray, t_ns: IntArray) -> None:
        values = batch.values
        self.prearm_ok[row] = values["onboard_control_sensors_health"] & _PREARM_BIT != 0
        percent = values["battery_remaining"].astype(np.float64)
        self.battery_remaining[row] = np.where((percent < 0.0) | (percent > 100.0), np.nan, percent / 100.0)
        self.senders.battery(row, values["battery_remaining"].astype(np.int64), t_ns)
        millivolts = values["voltage_battery"].astype(np.float64)
        self.battery_v[row] = np.where((millivolts == 0) | (millivolts == _VOLTAGE_UNKNOWN), np.nan, millivolts * 1e-3)
        self.sensors_enabled[row] = values["onboard_control_sensors_enabled"]
        self.sensors_healthy[row] = values["onboard_control_sensors_health"]
        self.status_ns[row] = t_ns

    def _estimator(self, batch: Batch, row: IntArray, t_ns: IntArray) -> None:
        self.estimator_flags[row] = batch.values["flags"]
        told = batch.values["vel_ratio" if "vel_ratio" in (batch.values.dtype.names or ()) else "velocity_variance"]
        self.velocity_ratio[row] = told
        self.estimator_ns[row] = t_ns

    def _first_gps(self, batch: Batch, row: IntArray, t_ns: IntArray) -> None:
        self.gps_fix[0, row], self.gps_fix_ns[0, row] = batch.values["fix_type"], t_ns

    def _second_gps(self, batch: Batch, row: IntArray, t_ns: IntArray) -> None:
        self.gps_fix[1, row], self.gps_fix_ns[1, row] = batch.values["fix_type"], t_ns

    def _named_value(self, batch: Batch, row: IntArray, _t_ns: IntArray) -> None:
        for name, told in ((LINK_HEARD, self.link_heard), (LINK_TRIP, self.link_trip_s)):
            mine = batch.values["name"] == name.encode()
            told[row[mine]] = batch.values["value"][mine]

    def _version(self, batch: Batch, row: IntArray, t_ns: IntArray) -> None:
        self.firmware[row] = batch.values["flight_sw_version"]
        for values, vehicle, t in zip(batch.values, row.tolist(), t_ns.tolist(), strict=True):
            uid = int(values["uid"]).to_bytes(8, "little") + bytes(values["uid2"])
            self.senders.board(vehicle, uid, t)

    def _param_value(self, batch: Batch, row: IntArray, t_ns: IntArray) -> None:
        bits = np.ascontiguousarray(batch.values["param_value"]).view(np.uint32)  # never by way of another float
        for values, value_bits, vehicle, t in zip(
            batch.values, bits.tolist(), row.tolist(), t_ns.tolist(), strict=True
        ):
            name = bytes(values["param_id"]).decode("ascii", "replace")
            self._params.append(ParamValue(vehicle, name, value_bits, int(values["param_type"]), t))

    def _extended_state(self, batch: Batch, row: IntArray, t_ns: IntArray) -> None:
        landed = batch.values["landed_state"].astype(np.int64)
        self.landed_state[row] = landed
        self.landed_ns[row] = t_ns
        above = self._is_above(row, t_ns)
        self.senders.landed(row, landed, t_ns, self.armed[row] & ~above)
        if some(self.disarm_doubted):
            said = self.disarm_doubted[row] & ~np.isin(landed, _OFF_THE_GROUND)
            for vehicle in row[said & ~above].tolist():
                self._believe_disarmed(vehicle)

    def _command_ack(self, batch: Batch, row: IntArray, t_ns: IntArray) -> None:
        for values, vehicle, t in zip(batch.values, row, t_ns, strict=True):
            self._acks.append(Ack(int(vehicle), int(values["command"]), int(values["result"]), int(t)))

    def _statustext(self, batch: Batch, row: IntArray, t_ns: IntArray) -> None:
        for values, vehicle, t in zip(batch.values, row.tolist(), t_ns.tolist(), strict=True):
            severity, data = int(values["severity"]), bytes(values["text"])
            number, piece = int(values["id"]), int(values["chunk_seq"])
            self._texts.extend(self._under_way.take(vehicle, severity, data, t, number=number, piece=piece))

    def _timesync_message(self, batch: Batch, row: IntArray, t_ns: IntArray) -> None:
        for values, vehicle, t in zip(batch.values, row, t_ns, strict=True):
            if int(values["tc1"]) == 0:
                self._timesync.append(TimesyncRequest(int(vehicle), int(values["ts1"]), int(t)))
            elif self.clocks.answered(int(vehicle), int(values["tc1"]), int(values["ts1"]), int(t)):
                self._start_anew(int(vehicle))


_HANDLERS: dict[str, Callable[[Fleet, Batch, IntArray, IntArray], BoolArray | None]] = {
    "HEARTBEAT": Fleet._heartbeat,
    "LOCAL_POSITION_NED": Fleet._local_position,
    "GLOBAL_POSITION_INT": Fleet._global_position,
    "GPS_GLOBAL_ORIGIN": Fleet._origin,
    "HOME_POSITION": Fleet._home,
    "ATTITUDE_QUATERNION": Fleet._attitude_quaternion,
    "ATTITUDE": Fleet._attitude_euler,
    "SYS_STATUS": Fleet._sys_status,
    "EXTENDED_SYS_STATE": Fleet._extended_state,
    "ESTIMATOR_STATUS": Fleet._estimator,
    "EKF_STATUS_REPORT": Fleet._estimator,
    "GPS_RAW_INT": Fleet._first_gps,
    "GPS2_RAW": Fleet._second_gps,
    "AUTOPILOT_VERSION": Fleet._version,
    "NAMED_VALUE_FLOAT": Fleet._named_value,
    "PARAM_VALUE": Fleet._param_value,
    "COMMAND_ACK": Fleet._command_ack,
    "STATUSTEXT": Fleet._statustext,
    "TIMESYNC": Fleet._timesync_message,
    "ADSB_VEHICLE": Fleet._aircraft,
}


_HANDLED_IDS = frozenset(message_id(name) for name in _HANDLERS)


def _place(lat_e7: NDArray[np.int32], lon_e7: NDArray[np.int32], alt_mm: NDArray[np.int32]) -> FloatArray:
    """Latitude and longitude in degrees and height in metres, shape (k, 3)."""
    place: FloatArray = np.empty((len(lat_e7), 3))
    place[:, 0], place[:, 1], place[:, 2] = lat_e7 * 1e-7, lon_e7 * 1e-7, alt_mm * 1e-3
    return place


def _on_earth(lat_e7: NDArray[np.int32], lon_e7: NDArray[np.int32]) -> BoolArray:
    """Which are places on earth, shape (k,): autopilots send zeros, and some the largest number, before they know."""
    inside = (np.abs(lat_e7.astype(np.int64)) <= 900_000_000) & (np.abs(lon_e7.astype(np.int64)) <= 1_800_000_000)
    return np.asarray(((lat_e7 != 0) | (lon_e7 != 0)) & inside)


def _times(n: int) -> NDArray[np.int64]:
    return np.full(n, NEVER, dtype=np.int64)


def _unknowns(n: int) -> NDArray[np.int64]:
    return np.full(n, UNKNOWN, dtype=np.int64)
