"""Finds what is on links: which vehicles, under which autopilots, where; bytes and times in, bytes out.

Says hello, listens, asks for a position, and writes the ``vehicles:`` block of a mission. Arms nothing, reads no clock.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
import pymap3d
import yaml
from rich.table import Table
from rich.text import Text

from groundstation.app.output import Output
from groundstation.mavlink.addresses import LinkAddress
from groundstation.mavlink.autopilot import Autopilot
from groundstation.mavlink.autopilots import AUTOPILOTS
from groundstation.mavlink.clocks import BootTimes
from groundstation.mavlink.codec import Encoder, Frame, Splitters, decode
from groundstation.mavlink.kinds import kind_of, type_words, unflown_words
from groundstation.mavlink.station import (
    GROUND_STATION_COMPID,
    GROUND_STATION_SYSID,
    Outgoing,
    ground_station_heartbeat,
)
from groundstation.mavlink.vehicle import ARMED_FLAG, AUTOPILOT_COMPID
from groundstation.mission.plan.vehicle_spec import SYSTEM_IDS

_HELLO_NS = 500_000_000
_STALE_NS = 3_000_000_000
_FOUND_MAX = 1_000
_PEERS_MAX = 16


@dataclass
class Found:
    """One vehicle.

    Attributes:
        link: index of the link.
        sysid: its system id.
        autopilot: None for one that we do not know.
        mav_autopilot: as its heartbeat says.
        mav_type: the same.
        mode: its mode word.
        armed: from the heartbeat.
        heard_ns: last heartbeat by address, so that two under one id show.
        place_deg_m: latitude, longitude, height; None before.
        version: of the firmware, "" before.
        boot_times: order of the times since start-up by address and message; two vehicles behind one address alternate.
    """

    link: int
    sysid: int
    autopilot: Autopilot | None
    mav_autopilot: int
    mav_type: int
    mode: int = 0
    armed: bool = False
    heard_ns: dict[str, int] = field(default_factory=dict)
    place_deg_m: tuple[float, float, float] | None = None
    version: str = ""
    boot_times: dict[tuple[str, str], BootTimes] = field(default_factory=dict)

    @property
    def mode_name(self) -> str:
        """Its mode for people."""
        return self.autopilot.mode_name(self.mode) if self.autopilot else f"mode {self.mode}"

    @property
    def type_name(self) -> str:
        """Its type for people."""
        return type_words(self.mav_type)

    @property
    def why_not(self) -> str:
        """Why no mission takes it, "" where one does."""
        if self.sysid not in SYSTEM_IDS:
            low, high = SYSTEM_IDS[0], SYSTEM_IDS[-1]
            return f"missions take ids {low} to {high}; give it one (MAV_SYS_ID, MAV_SYSID, SYSID_THISMAV)"
        if (unflown := unflown_words(self.mav_type)) is not None:
            return unflown
        return "" if self.autopilot else f"its autopilot, MAV_AUTOPILOT {self.mav_autopilot}, is not flown by gs"

    def addresses(self, now_ns: int) -> list[str]:
        """Where it was heard in the last seconds; more than one means two vehicles."""
        return sorted(peer for peer, t_ns in self.heard_ns.items() if now_ns - t_ns < _STALE_NS)

    def take_boot_time(self, peer: str, message: str, boot_ms: int, now_ns: int) -> None:
        """Takes a time since start-up."""
        times = self.boot_times.setdefault((peer, message), BootTimes(1))
        times.take(np.zeros(1, dtype=np.int64), np.array([boot_ms]), np.array([now_ns]))

    def twins_at(self, now_ns: int) -> list[str]:
        """Addresses behind which two vehicles speak under this one's id."""
        return sorted({peer for (peer, _), times in self.boot_times.items() if times.two_at_once(0, now_ns)})


class Discovery:
    """A look around on some links.

    Args:
        addresses: of the links, in the order of their numbers.

    Attributes:
        found: by link and system id.
    """

    def __init__(self, addresses: Sequence[LinkAddress]) -> None:
        self._addresses = addresses
        self._encoder = Encoder(GROUND_STATION_SYSID, GROUND_STATION_COMPID)
        self._splitters = Splitters()
        self._next_hello_ns = 0
        self._components: dict[tuple[int, int], int] = {}
        self.found: dict[tuple[int, int], Found] = {}

    def receive(self, link: int, peer: str, data: bytes, now_ns: int) -> None:
        """Takes what came over a link."""
        for piece in self._splitters.feed((link, peer), data, stream=self._addresses[link].is_stream):
            if not isinstance(piece, Frame) or len(self.found) >= _FOUND_MAX:
                continue
            if piece.compid == AUTOPILOT_COMPID:
                self._take(link, peer, piece, now_ns)
            elif (kind := kind_of(piece)) is not None and kind.is_autopilot and len(self._components) < _FOUND_MAX:
                self._components[link, piece.sysid] = piece.compid

    def _take(self, link: int, peer: str, frame: Frame, now_ns: int) -> None:
        found, sender = self.found.get((link, frame.sysid)), kind_of(frame)
        for batch in decode([frame]):
            values = batch.values[0]
            if found is not None and "time_boot_ms" in (batch.values.dtype.names or ()):
                found.take_boot_time(peer, batch.name, int(values["time_boot_ms"]), now_ns)
            if sender is not None:
                if not sender.is_autopilot:
                    continue
                number = sender.mav_autopilot
                kind = next((item for item in AUTOPILOTS.values() if item.mav_autopilot == number), None)
                if found is None:
                    found = self.found[link, frame.sysid] = Found(link, frame.sysid, kind, number, sender.mav_type)
                # ArduPilot's helicopters begin as quadrotors: the newest word counts.
                found.autopilot, found.mav_autopilot, found.mav_type = kind, number, sender.mav_type
                found.mode, found.armed = int(values["custom_mode"]), bool(values["base_mode"] & ARMED_FLAG)
                if peer in found.heard_ns or len(found.heard_ns) < _PEERS_MAX:
                    found.heard_ns[peer] = now_ns
            elif batch.name == "GLOBAL_POSITION_INT" and found is not None and (values["lat"] or values["lon"]):
                found.place_deg_m = (values["lat"] * 1e-7, values["lon"] * 1e-7, values["alt"] * 1e-3)
            elif batch.name == "AUTOPILOT_VERSION" and found is not None:
                number = int(values["flight_sw_version"])
                found.version = f"{number >> 24}.{number >> 16 & 0xFF}.{number >> 8 & 0xFF}"

    def outgoing(self, now_ns: int) -> list[Outgoing]:
        """What is to be sent now: a heartbeat to everybody, the question where they are, and that for their version.

        The place is asked for again and again: if two answer under one id, their times tell.
        """
        if now_ns < self._next_hello_ns:
            return []
        self._next_hello_ns = now_ns + _HELLO_NS
        hello = ground_station_heartbeat(self._encoder)
        greeted = {(link, address.peer) for link, address in enumerate(self._addresses) if address.peer}
        greeted |= {(found.link, peer) for found in self.found.values() for peer in found.heard_ns}
        sent = [Outgoing(link, peer, (hello,)) for link, peer in sorted(greeted)]
        for found in self.found.values():
            for message, known in (("GLOBAL_POSITION_INT", False), ("AUTOPILOT_VERSION", found.version)):
                if found.autopilot is not None and not known:
                    command = found.autopilot.once(message)
                    params = {f"param{k}": value for k, value in enumerate(command.padded(), start=1)}
                    raw = self._encoder.encode(
                        "COMMAND_LONG",
                        target_system=found.sysid,
                        target_component=AUTOPILOT_COMPID,
                        command=command.command,
                        **params,
                    )
                    sent += [Outgoing(found.link, peer, (raw,)) for peer in found.heard_ns]
        return sent

    def vehicles(self) -> list[Found]:
        """What was found, by system id."""
        return sorted(self.found.values(), key=lambda item: (item.sysid, item.link))

    def doubles(self, now_ns: int) -> list[str]:
        """Words for system ids that more than one vehicle bears."""
        return [
            f"system {sysid} is heard {where}; give each vehicle its own id (MAV_SYS_ID, MAV_SYSID, SYSID_THISMAV), or"
            " open only one of its links"
            for sysid, where in self._doubled(now_ns).items()
        ]

    def unflown(self) -> list[str]:
        """Words for what is there and taken by no mission."""
        lines = [f"system {found.sysid}: {found.why_not}" for found in self.vehicles() if found.why_not]
        return lines + [
            f"system {sysid}: heard as component {compid} on {self._addresses[link].url}, and an autopilot has to be"
            f" component {AUTOPILOT_COMPID}; correct MAV_COMP_ID"
            for (link, sysid), compid in sorted(self._components.items())
            if (link, sysid) not in self.found
        ]

    def _doubled(self, now_ns: int) -> dict[int, str]:
        """Where each system id that more than one vehicle bears is heard."""
        places: dict[int, list[str]] = {}
        twins: dict[int, list[str]] = {}
        for found in self.vehicles():
            url = self._addresses[found.link].url
            places.setdefault(found.sysid, []).extend(f"{peer} on {url}" for peer in found.addresses(now_ns))
            twins.setdefault(found.sysid, []).extend(f"{peer} on {url}" for peer in found.twins_at(now_ns))
        doubled = {
            sysid: f"twice at {' and '.join(where)}: two times since start-up alternate"
            for sysid, where in twins.items()
            if where
        }
        return doubled | {sysid: f"at {' and '.join(where)}" for sysid, where in places.items() if len(where) > 1}

    def block(self, now_ns: int) -> str:
        """The ``vehicles:`` block of a mission: pads from the places where the vehicles stand, the first at 0, 0.

        Who bears a system id with another one, or is taken by no mission, is left out with a comment that says so.
        """
        doubled = self._doubled(now_ns)
        known = [found for found in self.vehicles() if not found.why_not and found.sysid not in doubled]
        first = next((found.place_deg_m for found in known if found.place_deg_m is not None), None)
        entries = []
        for found in known:
            pad = [0.0, 0.0, 0.0]
            if first is not None and found.place_deg_m is not None:
                east, north, _ = pymap3d.geodetic2enu(*found.place_deg_m, *first)
                pad = [round(float(np.asarray(east)), 1) + 0.0, round(float(np.asarray(north)), 1) + 0.0, 0.0]
            in_a_room = found.autopilot is not None and found.autopilot.behind_a_gateway
            origin = "team" if in_a_room else "gps" if found.place_deg_m is not None else "pad"
            entries.append(
                {
                    "id": found.sysid,
                    "link": self._addresses[found.link].url,
                    "autopilot": found.autopilot.name if found.autopilot else "",
                    "profile": found.autopilot.profile if found.autopilot else "px4_quad",
                    "pad_m": pad,
                    "origin": origin,
                }
            )
        lines = [yaml.safe_dump(entry, default_flow_style=True, sort_keys=False, width=10_000) for entry in entries]
        left_out = "".join(f"  # system {sysid} is left out: more than one vehicle bears it\n" for sysid in doubled)
        left_out += "".join(
            f"  # system {found.sysid} is left out: {found.why_not}\n"
            for found in self.vehicles()
            if found.why_not and found.sysid not in doubled
        )
        return "vehicles:\n" + left_out + "".join(f"  - {line}" for line in lines)


def show_found(out: Output, discovery: Discovery, problems: list[str], now_ns: int) -> None:
    """Prints who was found, what is wrong, and the block for a mission file."""
    table = Table("id", "autopilot", "type", "version", "mode", "armed", "place")
    for item in discovery.vehicles():
        name = item.autopilot.name if item.autopilot else f"MAV_AUTOPILOT {item.mav_autopilot}, not flown by gs"
        place = item.place_deg_m
        where = f"{place[0]:.6f} {place[1]:.6f} {place[2]:.1f} m" if place else "-"
        kind = item.type_name if unflown_words(item.mav_type) is None else f"{item.type_name}, not flown by gs"
        sysid = str(item.sysid) if item.sysid in SYSTEM_IDS else f"{item.sysid}, no vehicle's"
        armed = "yes" if item.armed else "no"
        table.add_row(sysid, name, kind, item.version or "-", item.mode_name, armed, where)
    out.console.print(table)
    for problem in problems:
        out.console.print(Text(problem, style="bold red"))
    if discovery.found:
        out.console.print(Text(discovery.block(now_ns)))
