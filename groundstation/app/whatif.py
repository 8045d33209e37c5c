"""What if: a recorded flight's own poses, and what other gains, limits or avoidance would have said to them.

Nobody flies what is said here: at every tick both missions see the poses that were recorded, so that what differs is
the law's answer and nothing else. How the flight would have gone on is a question for the emulator.
"""

from __future__ import annotations

import copy
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from groundstation.app.again import Again, mission_of
from groundstation.core.errors import CheckFailed, UserError
from groundstation.core.frames import enu_from_ned
from groundstation.core.types import FloatArray, IntArray
from groundstation.mission.plan.overrides import override_value
from groundstation.mission.plan.own_code import CodeSource
from groundstation.mission.plan.reading import plan_from_record
from groundstation.mission.runner import AIRBORNE_PHASES
from groundstation.records.tlog import read_tlog

_DIFFERS_M_S = 1e-9
_RECORDED = "formation", "shapes", "vehicles", "rate_hz"


@dataclass(frozen=True)
class WhatIf:
    """Setpoints as they were, and as they would have been; k ticks, n vehicles.

    Attributes:
        changes: what was other.
        ids: system ids, shape (n,).
        t_ns: times of the ticks, shape (k,).
        was_enu_m_s: shape (k, n, 3); NaN while the team is not in the air.
        would_be_enu_m_s: the same.
        note: where the two missions no longer do the same: when, and what each does; "" where they always do.
    """

    changes: tuple[str, ...]
    ids: IntArray
    t_ns: IntArray
    was_enu_m_s: FloatArray
    would_be_enu_m_s: FloatArray
    note: str

    @property
    def apart_m_s(self) -> FloatArray:
        """How far the two are apart, shape (k, n)."""
        return np.asarray(np.linalg.norm(self.would_be_enu_m_s - self.was_enu_m_s, axis=2))

    def figures(self) -> dict[str, float | int | str | None]:
        """What it comes to, by name."""
        apart, known = self.apart_m_s, np.isfinite(self.apart_m_s)
        if not known.any():
            return {"whatif_ticks": 0, "whatif_note": self.note}
        row, vehicle = np.unravel_index(int(np.argmax(np.where(known, apart, -1.0))), apart.shape)
        return {
            "whatif_ticks": int(known.any(axis=1).sum()),
            "whatif_differ": int((apart[known] > _DIFFERS_M_S).sum()),
            "whatif_max_m_s": float(apart[row, vehicle]),
            "whatif_max_at_s": float(self.t_ns[row] - self.t_ns[0]) / 1e9,
            "whatif_max_vehicle": int(self.ids[vehicle]),
            "whatif_rms_m_s": float(np.sqrt(np.mean(apart[known] ** 2))),
            "whatif_note": self.note,
        }


def what_if(
    log: Path,
    changes: Sequence[str],
    gains: Path | None = None,
    code: CodeSource | None = None,
    stop: Callable[[], bool] = lambda: False,
) -> WhatIf:
    """Asks a recorded flight what something else would have said.

    Args:
        log: of `gs fly`, with its manifest.
        changes: ``key.path=value`` of the mission, as for ``--set``.
        gains: other gains for the mission's formation; None for its own.
        code: where a law or avoidance that is not ours is looked for.
        stop: asked now and then; True ends it with what is there.

    Raises:
        UserError: no manifest, or what is asked for does not go together.
        CheckFailed: there is no tick in it.
    """
    manifest, own_gains = mission_of(log)
    mission = copy.deepcopy(dict(manifest.mission))
    for change in changes:
        if change.partition("=")[0].split(".")[0] in _RECORDED:
            raise UserError(f"what if {change}: {', '.join(_RECORDED)} are the log's own; fly it with gs fly --dry-run")
        override_value(mission, change)
    try:
        other_gains = own_gains if gains is None else gains.read_bytes()
    except OSError as error:
        raise UserError(f"{gains}: {error.strerror or error}; name a gains file of `gs design`") from None
    was = plan_from_record(manifest.mission, own_gains, f"manifest of {log}", code)
    would_be = plan_from_record(mission, other_gains, f"what if, on the manifest of {log}", code)
    if would_be.links != was.links:
        raise UserError(f"what if {', '.join(changes)}: links are those that were recorded")
    both = [Again(plan, take_over=manifest.take_over) for plan in (was, would_be)]
    times: list[int] = []
    said: list[list[FloatArray]] = [[], []]
    note = ""
    for record in read_tlog(log, manifest.epoch_unix_us):
        ticked = [again.take(record) is not None for again in both]
        if not ticked[0]:
            continue
        if len(times) % 100 == 0 and stop():
            break
        times.append(record.t_ns)
        phases = [again.runner.phase for again in both]
        if phases[0] is not phases[1] and not note:
            seconds = (times[-1] - times[0]) / 1e9
            note = f"after {seconds:.2f} s it is in {phases[0].value}, and would be in {phases[1].value}"
        for again, phase, lines in zip(both, phases, said, strict=True):
            velocity = enu_from_ned(again.runner.sent_ned_m_s)
            lines.append(velocity if phase in AIRBORNE_PHASES else np.full_like(velocity, np.nan))
    if not times:
        raise CheckFailed(f"{log}: no tick in it; there is nothing to compare")
    first, second = (np.array(lines) for lines in said)
    ids = np.array([vehicle.id for vehicle in was.spec.vehicles], dtype=np.int64)
    return WhatIf(tuple(changes), ids, np.array(times, dtype=np.int64), first, second, note)
