"""The ground station's end of the MAVLink conversation: bytes in, bytes out, no sockets.

Splits what arrives into frames, keeps the fleet's state, answers time synchronisation, repeats commands, sends its
own heartbeat and encodes velocity setpoints. Whoever calls it says when, so that the setpoints and the heartbeat
stop when the controller stops. Decides nothing about the mission.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np

from groundstation.core.quick import every, some
from groundstation.core.types import BoolArray, FloatArray
from groundstation.mavlink.autopilot import FRAME_LOCAL_NED, MASK_VELOCITY_AND_YAW
from groundstation.mavlink.blocks import Block, merge
from groundstation.mavlink.codec import Encoder, Frame, FrameSplitter, Piece, blank, encode_batch
from groundstation.mavlink.commands import CommandQueue
from groundstation.mavlink.mocap_frames import own_pose, packed_poses
from groundstation.mavlink.params import ParamDesk, ParamQuestion
from groundstation.mavlink.vehicle import AUTOPILOT_COMPID, Fleet, ReceivedFrame, received_frames

GROUND_STATION_SYSID = 255
GROUND_STATION_COMPID = 190  # MAV_COMP_ID_MISSIONPLANNER, what ground stations use
_HEARTBEAT_NS = 1_000_000_000
_TYPE_GCS, _AUTOPILOT_INVALID, _STATE_ACTIVE, _MAVLINK_VERSION = 6, 8, 4, 3
_TIMESYNC_EAGER_NS, _TIMESYNC_NS = 200_000_000, 2_000_000_000
_POSE_ERROR_M = 0.005  # of one axis, for the vehicles' estimators
_TIMESYNC_ENOUGH = 10  # round trips after which there is no hurry


class Outgoing(NamedTuple):
    """A datagram to be sent: frames for one peer of one link."""

    link: int
    peer: str
    frames: tuple[bytes, ...]


def ground_station_heartbeat(encoder: Encoder) -> bytes:
    """A ground station's HEARTBEAT, numbered by its sender's encoder."""
    return encoder.encode(
        "HEARTBEAT",
        type=_TYPE_GCS,
        autopilot=_AUTOPILOT_INVALID,
        system_status=_STATE_ACTIVE,
        mavlink_version=_MAVLINK_VERSION,
    )


class Station:
    """One end of all links.

    Args:
        fleet: state to be kept up to date.
        start_ns: time that goes out as "since boot", taken as zero.
        greeted: (link, peer) of those that wait to be spoken to; they get heartbeats until somebody is heard there.
        behind_a_gateway: rows of vehicles whose poses are told to a gateway, of all behind it together.

    Attributes:
        bytes_received: by link, whoever sent them.
    """

    def __init__(
        self,
        fleet: Fleet,
        start_ns: int,
        *,
        greeted: Sequence[tuple[int, str]] = (),
        behind_a_gateway: Sequence[int] = (),
    ) -> None:
        self.fleet = fleet
        self.commands = CommandQueue(len(fleet))
        self.parameters = ParamDesk(len(fleet))
        self.setpoints_sent = 0
        self.bytes_received: Counter[int] = Counter()
        self._start_ns = start_ns
        self._encoder = Encoder(GROUND_STATION_SYSID, GROUND_STATION_COMPID)
        self._received: list[ReceivedFrame | Block] = []
        self._next_heartbeat_ns = start_ns
        self._next_timesync_ns = self._last_timesync_ns = start_ns
        self._greeted = tuple(greeted)
        self._extra: list[tuple[int, bytes]] = []
        self._behind_a_gateway = frozenset(behind_a_gateway)
        self._posed_ns = fleet.pose_ns.copy()

    def receive(self, link: int, peer: str, data: bytes, t_rx_ns: int) -> None:
        """Takes one datagram; nothing is acted upon before ``ingest``.

        Args:
            link: which link it came in on.
            peer: sender's address on that link.
            data: as received, with no frame cut in two.
            t_rx_ns: when.
        """
        self.take(link, peer, FrameSplitter().feed(data), t_rx_ns)

    def take(self, link: int, peer: str, pieces: Sequence[Piece], t_rx_ns: int) -> None:
        """The same for what was split before: by whoever read the link, once for all who want to know."""
        for piece in pieces:
            if isinstance(piece, Frame):
                self.bytes_received[link] += len(piece.raw)
                self._received.append(ReceivedFrame(piece, link, peer, t_rx_ns))
            else:
                self.bytes_received[link] += len(piece)
                self.fleet.counts["bytes that were no frame"] += len(piece)

    def take_block(self, block: Block) -> None:
        """The same for many datagrams."""
        where = block.datagrams
        links = np.bincount(where.link).nonzero()[0].tolist()
        sizes = np.diff(where.offsets) if len(links) > 1 else None
        for link in links:
            size = where.offsets[-1] if sizes is None else sizes[where.link == link].sum()
            self.bytes_received[link] += int(size)
        noise = block.noise
        if noise:
            self.fleet.counts["bytes that were no frame"] += noise
        if len(block):
            self._received.append(block)

    def ingest(self) -> None:
        """Brings the fleet's state up to all that was received, all at once, in whatever pieces it came."""
        received, self._received = self._received, []
        blocks = [item for item in received if isinstance(item, Block)]
        if blocks and len(blocks) == len(received):
            self.fleet.ingest_block(merge(blocks))
        elif received:
            frames: list[ReceivedFrame] = []
            for item in received:
                if isinstance(item, Block):
                    frames += received_frames(item)
                else:
                    frames.append(item)
            self.fleet.ingest(frames)
        for ack in self.fleet.take_acks():
            self.commands.acknowledge(ack)
        for value in self.fleet.take_param_values():
            self.parameters.take(value)

    def send(self, vehicle: int, message: str, **fields: Any) -> None:
        """Puts one message, fields in wire units, into the next ``transmit``."""
        self._extra.append((vehicle, self._encoder.encode(message, **fields)))

    def transmit(
        self, now_ns: int, vel_ned_m_s: FloatArray, yaw_ned_rad: FloatArray, streaming: BoolArray
    ) -> list[Outgoing]:
        """Encodes all that is due: setpoints, commands, answers and the heartbeat.

        Args:
            now_ns: time of this tick.
            vel_ned_m_s: velocity setpoints, shape (n, 3), local NED axes.
            yaw_ned_rad: yaw setpoints, shape (n,).
            streaming: which vehicles get a setpoint, shape (n,).

        Returns:
            At most one datagram per vehicle; vehicles never heard from get nothing but a greeting, where one is due.
        """
        fleet = self.fleet
        frames: list[list[bytes]] = [[] for _ in range(len(fleet))]
        rows = streaming.nonzero()[0]
        for row, raw in zip(rows, self._setpoints(now_ns, vel_ned_m_s, yaw_ned_rad, rows), strict=True):
            frames[row].append(raw)
        for vehicle, raw in self._own_poses():
            frames[vehicle].append(raw)
        requests = fleet.take_timesync_requests()
        answers = self._timesyncs([request.t_rx_ns for request in requests], [request.ts1_ns for request in requests])
        for request, raw in zip(requests, answers, strict=True):
            frames[request.vehicle].append(raw)
        for sending in self.commands.due(now_ns):
            params = {f"param{k}": value for k, value in enumerate(sending.command.padded(), start=1)}
            frames[sending.vehicle].append(
                self._encoder.encode(
                    "COMMAND_LONG",
                    target_system=int(fleet.sysid[sending.vehicle]),
                    target_component=AUTOPILOT_COMPID,
                    command=sending.command.command,
                    confirmation=sending.confirmation,
                    **params,
                )
            )
        for question in self.parameters.due(now_ns):
            frames[question.vehicle].append(self._question(question))
        for vehicle, raw in self._extra:
            frames[vehicle].append(raw)
        self._extra.clear()
        outgoing = []
        self._synchronise(now_ns, frames)
        if now_ns >= self._next_heartbeat_ns:
            self._next_heartbeat_ns = now_ns + _HEARTBEAT_NS
            for vehicle in self._one_per_peer():
                frames[vehicle].append(ground_station_heartbeat(self._encoder))
            at = zip(fleet.link.tolist(), fleet.peer, strict=True) if self._greeted else ()
            heard = {link for link, peer in at if peer is not None}
            for link, peer in self._greeted:
                if link not in heard:
                    outgoing.append(Outgoing(link, peer, (ground_station_heartbeat(self._encoder),)))
        outgoing += [
            Outgoing(link, peer, tuple(made))
            for link, peer, made in zip(fleet.link.tolist(), fleet.peer, frames, strict=True)
            if made and peer is not None
        ]
        return outgoing

    def transmit_poses(self) -> list[Outgoing]:
        """Only what vehicles are told of their own places, where they come from a motion capture system."""
        fleet = self.fleet
        return [
            Outgoing(int(fleet.link[row]), peer, (raw,))
            for row, raw in self._own_poses()
            if (peer := fleet.peer[row]) is not None
        ]

    def _own_poses(self) -> list[tuple[int, bytes]]:
        """Newest place of each vehicle that a motion capture system sees, once each."""
        room = self.fleet.room
        if room is None:
            return []
        rows = (room.measured_ns > self._posed_ns).nonzero()[0].tolist()
        self._posed_ns = room.measured_ns.copy()
        told: list[tuple[int, bytes]] = []
        behind: dict[tuple[int, str], list[int]] = {}
        for row in rows:
            peer = self.fleet.peer[row]
            if peer is None:
                continue
            if row in self._behind_a_gateway:
                behind.setdefault((int(self.fleet.link[row]), peer), []).append(row)
            elif every(np.isfinite(room.quat_ned_from_frd[row])):  # their estimators take no place without a heading
                fields = own_pose(room, row, _POSE_ERROR_M)
                told.append((row, self._encoder.encode("VISION_POSITION_ESTIMATE", **fields)))
        for several in behind.values():
            told += [(several[0], self._encoder.encode("TUNNEL", **fields)) for fields in packed_poses(room, several)]
        return told

    def _question(self, question: ParamQuestion) -> bytes:
        target = {
            "target_system": int(self.fleet.sysid[question.vehicle]),
            "target_component": AUTOPILOT_COMPID,
            "param_id": question.name,
        }
        if question.bits is None:
            return self._encoder.encode("PARAM_REQUEST_READ", **target, param_index=-1)
        return self._encoder.encode("PARAM_SET", **target, param_value=question.as_float, param_type=question.kind)

    def _one_per_peer(self) -> list[int]:
        """The first vehicle of every address that was heard from."""
        first: dict[tuple[int, str], int] = {}
        for vehicle, (link, peer) in enumerate(zip(self.fleet.link.tolist(), self.fleet.peer, strict=True)):
            if peer is not None:
                first.setdefault((link, peer), vehicle)
        return list(first.values())

    def _timesyncs(self, tc1_ns: list[int], ts1_ns: list[int]) -> list[bytes]:
        """TIMESYNC frames, in this order."""
        if not ts1_ns:
            return []
        values = blank("TIMESYNC", len(ts1_ns))
        values["tc1"], values["ts1"] = tc1_ns, ts1_ns
        return encode_batch("TIMESYNC", values, [self._encoder] * len(ts1_ns))

    def _synchronise(self, now_ns: int, frames: list[list[bytes]]) -> None:
        """Asks for the vehicles' time, once for all behind one address: all of them answer."""
        clocks = self.fleet.clocks
        if some(clocks.doubtful()):
            self._next_timesync_ns = min(self._next_timesync_ns, self._last_timesync_ns + _TIMESYNC_EAGER_NS)
        if now_ns < self._next_timesync_ns:
            return
        self._last_timesync_ns = now_ns
        peers = self.fleet.peer
        hurry = any(peer is not None and clocks.samples[i] < _TIMESYNC_ENOUGH for i, peer in enumerate(peers))
        self._next_timesync_ns = now_ns + (_TIMESYNC_EAGER_NS if hurry else _TIMESYNC_NS)
        asked = self._one_per_peer()
        for vehicle, raw in zip(asked, self._timesyncs([0] * len(asked), [now_ns] * len(asked)), strict=True):
            frames[vehicle].append(raw)
        for vehicle, peer in enumerate(peers):
            if peer is not None:
                clocks.asked(vehicle, now_ns)

    def _setpoints(
        self, now_ns: int, vel_ned_m_s: FloatArray, yaw_ned_rad: FloatArray, rows: Sequence[int] | np.ndarray
    ) -> list[bytes]:
        if not every(np.isfinite(vel_ned_m_s[rows])) or not every(np.isfinite(yaw_ned_rad[rows])):
            raise ValueError("a setpoint is not a finite number")
        values = blank("SET_POSITION_TARGET_LOCAL_NED", len(rows))
        values["time_boot_ms"] = ((now_ns - self._start_ns) // 1_000_000) & 0xFFFFFFFF
        values["target_system"] = self.fleet.sysid[rows]
        values["target_component"] = AUTOPILOT_COMPID
        values["coordinate_frame"] = FRAME_LOCAL_NED
        values["type_mask"] = MASK_VELOCITY_AND_YAW
        values["vx"], values["vy"], values["vz"] = vel_ned_m_s[rows].T
        values["yaw"] = yaw_ned_rad[rows]
        self.setpoints_sent += len(rows)
        return encode_batch("SET_POSITION_TARGET_LOCAL_NED", values, [self._encoder] * len(rows))
