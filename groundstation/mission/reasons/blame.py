"""Why a mission ended early, in words that stay readable: whom to name in full, whom by number, who still flies.

Values only; judges nothing and decides nothing.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence

import numpy as np

from groundstation.core.types import BoolArray
from groundstation.mavlink.vehicle import Fleet
from groundstation.mission.plan.plan import MissionPlan

_IN_FULL = 4  # of one flight; the alarms have everybody's words
HELP_IN_THE_AIR = "take it over (gs fly --take-over) or fly it down"
HELP_ALL_IN_THE_AIR = "take them over (gs fly --take-over) or fly them down"


class Blame:
    """Reasons of the monitors: the first one of each vehicle.

    What is found of a vehicle later follows from that, and only alarms.

    Attributes:
        outdated: words told before that those of the last call take the place of, "" mostly.
    """

    def __init__(self) -> None:
        self._named: set[str] = set()
        self._in_full = 0
        self._rest: list[str] = []
        self._more = self.outdated = ""

    def of(self, aborts: Mapping[str, str], reason: str) -> str:
        """What one tick adds to the reason of the result.

        Args:
            aborts: sentences by their subject, ``vehicle 3`` or another.
            reason: what is in the result already.

        Returns:
            The first few sentences in full, the others by number; "" when every subject has its reason.
        """
        parts = reason.split("; ")
        new = [
            subject
            for subject in aborts
            if subject not in self._named and not any(part.startswith(f"{subject}:") for part in parts)
        ]
        self._named.update(new)
        told = new[: max(_IN_FULL - self._in_full, 0)]
        self._in_full += len(told)
        lines, rest = [aborts[subject] for subject in told], new[len(told) :]
        self.outdated = ""
        if rest:
            self._rest += rest
            self.outdated, self._more = self._more, _more_words(self._rest)
            lines.append(self._more)
        return "; ".join(lines)


def _more_words(subjects: Sequence[str]) -> str:
    """Vehicles by their numbers, other findings by how many they are."""
    numbers = [subject.removeprefix("vehicle ") for subject in subjects if subject.startswith("vehicle ")]
    others = len(subjects) - len(numbers)
    more = [f"vehicle{'s' * (len(numbers) > 1)} {', '.join(numbers)}"] if numbers else []
    more += [f"{others} more finding{'s' * (others > 1)}"] if others else []
    return f"{' and '.join(more)} too, see the alarms"


def still_flying(fleet: Fleet, plan: MissionPlan, flying: BoolArray, now_ns: int) -> Iterator[str]:
    """Words for vehicles that fly on when the mission has ended.

    Args:
        fleet: what the vehicles report.
        plan: names of modes, limits.
        flying: armed and not reported to stand on the ground, shape (n,).
        now_ns: time of the tick.
    """
    stale = fleet.heartbeat_stale(now_ns, plan.spec.limits.heartbeat_age_s)
    alike: dict[tuple[str, bool], list[str]] = {}
    for vehicle in np.flatnonzero(flying).tolist():
        mode = plan.autopilots[vehicle].mode_name(int(fleet.custom_mode[vehicle]))
        known = not stale[vehicle] and fleet.landed_state[vehicle] != 0
        alike.setdefault((mode, bool(known)), []).append(str(fleet.ids[vehicle]))
    for (mode, known), names in alike.items():
        if len(names) <= _IN_FULL:
            words = "is still in the air, in {}" if known else "may still be in the air, in {} when last told"
            yield from (f"vehicle {name} {words.format(mode)}; {HELP_IN_THE_AIR}" for name in names)
        else:
            words = "are still in the air, in {}" if known else "may still be in the air, in {} when last told"
            yield f"vehicles {', '.join(names)} {words.format(mode)}; {HELP_ALL_IN_THE_AIR}"
