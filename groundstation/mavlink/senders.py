"""Who else speaks under a vehicle's system id: parts of it, another kind of vehicle, a second one of the same kind.

What can be told from a heartbeat's own words, from the component it comes from, and from values that go to and fro as
no single vehicle's do. Decides nothing; preflight and monitors ask. Reads no clock.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from groundstation.core.types import BoolArray, IntArray
from groundstation.mavlink.alternation import Alternation
from groundstation.mavlink.kinds import Kind

_TOLD_NS = 10_000_000_000
_COMPONENT_NS = 5_000_000_000
_BOARDS_MAX, _BOARDS_NS = 8, 60_000_000_000
_BATTERY_STEP = 15  # points by which no pack changes between two reports
_LANDED_WORDS = {1: "on the ground", 2: "in the air", 3: "taking off", 4: "landing"}


class Senders:
    """What is suspicious about the senders behind n vehicles.

    Args:
        n: number of vehicles.
    """

    def __init__(self, n: int) -> None:
        self._arming, self._mode, self._landed = Alternation(n), Alternation(n), Alternation(n)
        self._kind, self._battery, self._place = Alternation(n), Alternation(n, _BATTERY_STEP), Alternation(n)
        self._words: tuple[tuple[Alternation, Callable[[int, int], str]], ...] = (
            (self._kind, lambda one, other: f"their kinds alternate ({_kind(one)}; {_kind(other)})"),
            (self._arming, lambda _one, _other: "their heartbeats say armed and disarmed in turns"),
            (self._mode, lambda one, other: f"their modes alternate ({one} and {other})"),
            (self._landed, lambda one, other: f"their landed states alternate ({_landed(one)}, {_landed(other)})"),
            (self._battery, lambda one, other: f"their batteries alternate ({one} % and {other} %)"),
            (self._place, lambda _one, _other: "their positions alternate"),
        )
        self._parts: dict[int, tuple[Kind, int]] = {}
        self._strange: dict[int, tuple[Kind, int]] = {}
        self._components: dict[int, tuple[int, int]] = {}
        self._boards: dict[int, dict[bytes, int]] = {}
        self._two_boards = False

    # What is heard

    def heartbeat(self, row: IntArray, kind: IntArray, armed: BoolArray, mode: IntArray, t_rx_ns: IntArray) -> None:
        """Takes heartbeats that count, in the order of their arrival, shape (k,) each; ``kind`` as ``Kind.number``."""
        self._kind.take(row, kind, t_rx_ns)
        self._arming.take(row, armed.astype(np.int64), t_rx_ns)
        self._mode.take(row, mode, t_rx_ns)

    def landed(self, row: IntArray, landed_state: IntArray, t_rx_ns: IntArray, hops: BoolArray) -> None:
        """Takes landed states; ``hops``: runs its motors just above the ground, where one vehicle goes to and fro."""
        self._landed.take(row, landed_state, t_rx_ns, ~hops)

    def battery(self, row: IntArray, percent: IntArray, t_rx_ns: IntArray) -> None:
        """Takes what is left in batteries, -1 where it is not known."""
        self._battery.take(row, percent, t_rx_ns)

    def other_place(self, vehicle: int, t_rx_ns: int) -> None:
        """Takes note of a position that is not on the way of the others."""
        self._place.mark(vehicle, t_rx_ns)

    def other_part(self, vehicle: int, kind: Kind, t_rx_ns: int) -> None:
        """Takes note of a heartbeat of what is no autopilot, under the autopilot's component."""
        self._parts[vehicle] = (kind, t_rx_ns)

    def other_kind(self, vehicle: int, kind: Kind, t_rx_ns: int) -> None:
        """Takes note of a heartbeat of a kind that the vehicle is not."""
        self._strange[vehicle] = (kind, t_rx_ns)

    def other_component(self, vehicle: int, compid: int, t_rx_ns: int) -> None:
        """Takes note of an autopilot's heartbeat from another component."""
        self._components[vehicle] = (compid, t_rx_ns)

    def board(self, vehicle: int, uid: bytes, t_rx_ns: int) -> None:
        """Takes the number of the board that answered; one of zeros is none."""
        boards = self._boards.setdefault(vehicle, {})
        if uid.strip(b"\0") and (uid in boards or len(boards) < _BOARDS_MAX):
            boards[uid] = t_rx_ns
        self._two_boards |= len(boards) > 1

    def forget_board(self, vehicle: int) -> None:
        """The vehicle has started anew: it may be another one."""
        self._boards.pop(vehicle, None)
        self._two_boards = any(len(boards) > 1 for boards in self._boards.values())

    # What follows from it

    @property
    def quiet(self) -> bool:
        """Nothing has ever been suspicious that ``alternating`` would tell of."""
        told = self._kind.quiet and self._arming.quiet and self._mode.quiet
        return told and self._landed.quiet and self._battery.quiet and self._place.quiet and not self._two_boards

    @property
    def all_alike(self) -> bool:
        """No heartbeat was ever of a kind that the vehicle is not."""
        return not self._strange

    def part(self, vehicle: int, now_ns: int) -> Kind | None:
        """What else has been speaking as the autopilot of late, without being one."""
        kind, t_ns = self._parts.get(vehicle, (None, 0))
        return kind if kind is not None and now_ns - t_ns < _TOLD_NS else None

    def strange_kind(self, vehicle: int, now_ns: int) -> Kind | None:
        """Another kind of vehicle that has been speaking under this one's id of late, since ids are held."""
        kind, t_ns = self._strange.get(vehicle, (None, 0))
        return kind if kind is not None and now_ns - t_ns < _TOLD_NS else None

    def component(self, vehicle: int, now_ns: int) -> int | None:
        """Component under which an autopilot of this vehicle's id is heard, where it is not the one that counts."""
        compid, t_ns = self._components.get(vehicle, (None, 0))
        return compid if compid is not None and now_ns - t_ns < _COMPONENT_NS else None

    def in_doubt(self, now_ns: int) -> BoolArray:
        """Vehicles whose arming or mode has begun to go to and fro, shape (n,): nothing is decided by it yet."""
        return self._arming.in_doubt(now_ns) | self._mode.in_doubt(now_ns)

    def alternating(self, vehicle: int, now_ns: int) -> str | None:
        """Words for what two senders say in turns; None where there is nothing of the kind."""
        if sum(now_ns - t_ns < _BOARDS_NS for t_ns in self._boards.get(vehicle, {}).values()) > 1:
            return "two boards answer to its id (AUTOPILOT_VERSION)"
        for alternation, words in self._words:
            if alternation.two_at_once(vehicle, now_ns):
                return words(*alternation.values(vehicle))
        return None


def _kind(number: int) -> str:
    return Kind.of_number(number).words


def _landed(landed_state: int) -> str:
    return _LANDED_WORDS.get(landed_state, f"landed state {landed_state}")
