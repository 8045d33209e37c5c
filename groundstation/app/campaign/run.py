"""Flies one case on the emulator in virtual time and says in one row what came of it.

Whatever goes wrong in a run becomes a row with the reason; nothing of it reaches the other runs. Reads no clock: the
same case gives the same row anywhere.
"""

from __future__ import annotations

import math
import tempfile
import traceback
from collections.abc import Mapping, Sequence
from contextlib import ExitStack
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from groundstation.app.campaign.cases import Case
from groundstation.app.campaign.kinematic import kinematic_time_to_form_s
from groundstation.app.campaign.plot import Plot
from groundstation.app.campaign.words import NOTHING_FOUND, TOUCHDOWN_MAX_M_S, Witness
from groundstation.app.emulator import TruthMeter, world_config
from groundstation.app.loop import Interrupts, fly_virtual
from groundstation.app.mocap.emulated import emulated_team
from groundstation.app.opening import LogPlan, open_flight
from groundstation.app.session import Session
from groundstation.app.verify import verify_log
from groundstation.core import frames
from groundstation.core.errors import UserError
from groundstation.core.metrics import min_clearance
from groundstation.core.types import BoolArray, FloatArray, IntArray
from groundstation.mission.plan.plan import MissionPlan
from groundstation.mission.runner import Phase
from groundstation.mission.timing import SECOND_NS
from groundstation.mission.told import Told
from groundstation.records.manifest import (
    manifest_path,
    versions,
    write_manifest,
)
from sitl.faults import Fault, FaultError
from sitl.world import World, WorldConfig

Row = dict[str, Any]
_SETTLE_STEP_NS = SECOND_NS // 2
_GROUND = frozenset({Phase.CONNECT, Phase.ARM})
_ON_PADS = frozenset({Phase.CONNECT, Phase.ARM, Phase.TAKEOFF, Phase.LAND, Phase.SILENT, Phase.DONE})
_WORDS_MAX = 2_000
_HEARS_AGAIN_NS = 5 * SECOND_NS  # after the end of a blackout; by then the ground station has found it again
_FOR_GOOD_NS = np.iinfo(np.int64).max
_OWN_FAULT = "fault in the ground station"
DISOBEDIENT = frozenset(
    {"blackout", "position_frozen", "position_nan", "position_jump", "position_drift"}
    | {"gps_lost", "motor_failure", "reboot"}
)
"""Faults after which a vehicle cannot be steered to keep clear: it does not hear, does not know its place, or falls."""


class _TooLongError(Exception):
    """The mission did not end in its time."""


def fly_case(case: Case, log: Path | None = None) -> Row:
    """Flies a case.

    Args:
        case: what to fly.
        log: where to record, with its manifest; None for nowhere.

    Returns:
        One row: the columns of ``table.SCHEMA``.
    """
    row = _nothing_yet(case)
    try:
        row |= _Flown(case).fly(log)
        if not row["faults"] and not row["events"] and case.setting.adversary is None:
            row["kinematic_time_to_form_s"] = kinematic_time_to_form_s(case)
    except UserError as error:
        row["error"] = str(error)
    except Exception as error:
        row["tracebacks"] += 1
        place = traceback.extract_tb(error.__traceback__)[-1]
        row["error"] = f"{type(error).__name__}: {error} ({Path(place.filename).name}, line {place.lineno})"
    return row


def _nothing_yet(case: Case) -> Row:
    nan = math.nan
    return {
        "run": case.run,
        "seed": case.seed,
        "cell": case.cell,
        "drawn": case.drawn,
        "error": "",
        "vehicles": 0,
        "safety_radius_m": nan,
        "outcome": "",
        "reason": "",
        "success": False,
        "formed": False,
        "safe": False,
        "time_to_form_s": nan,
        "kinematic_time_to_form_s": nan,
        "formation_error_m": nan,
        "hold_speed_m_s": nan,
        "min_distance_m": nan,
        "nearest_pair": "",
        "min_obedient_m": nan,
        "min_clearance": nan,
        "start_distance_m": nan,
        "gridlocks": 0,
        "role_swaps": 0,
        "detours": 0,
        "setpoints": 0,
        "ticks": 0,
        "duration_s": nan,
        "phases": "",
        "end": "",
        "ended_safely": False,
        "alarms": "",
        "told": False,
        "faults": "",
        "fault_phase": "",
        "fault_vehicle": 0,
        "fault_at_s": nan,
        "log_mismatches": -1,
        "log_complete": False,
        "events": "",
        "tracebacks": 0,
        **NOTHING_FOUND.columns(),
    }


class _Flown:
    """One run under way: watches, lets faults strike, measures the truth."""

    def __init__(self, case: Case) -> None:
        self._case = case
        self._plan = case.plan()
        self._world = World(emulated(case, self._plan), case.seed)
        self._alarms: list[str] = []
        self._phases: list[str] = []
        self._phase: Phase | None = None
        faults = case.setting.faults
        self._due_ns: int | None = None  # when the fault strikes, None until its phase has been entered
        self._struck_ns: int | None = None
        self._waiting = bool(faults.what)
        self._unsteered: BoolArray = np.zeros(self._plan.size, dtype=np.bool_)
        self._deaf_until_ns: IntArray = np.zeros(self._plan.size, dtype=np.int64)  # those that cannot be steered
        self._struck: list[str] = []  # kinds
        self._planned = [fault.kind for fault in (*faults.scheduled(), *faults.faults())]
        self._begun = sorted(faults.scheduled(), key=lambda fault: fault.at_s)
        self._min_m = self._min_obedient_m = self._min_clearance = math.inf
        self._upright = not self._plan.region.by_distance
        self._pair_m = np.full((self._plan.size, self._plan.size), math.inf)
        self._witness = Witness(self._plan, self._world)
        self._interrupts = Interrupts()
        self._plot = Plot(
            self._plan, case.events, self._interrupts, strike=self._inject, kill=self._give_up_on, radio=self._hears
        )

    def fly(self, log: Path | None) -> Row:
        """Flies to the end, lets the world come to rest, and reads off what came of it."""
        case, plan, setting = self._case, self._plan, self._case.setting
        meter = TruthMeter(self._world)
        values: Row = {"safety_radius_m": plan.spec.avoidance.radius_m, "vehicles": plan.size}
        late = False
        with ExitStack() as stack:
            if setting.verify and log is None:
                log = Path(stack.enter_context(tempfile.TemporaryDirectory())) / "run.tlog"
            recorded = None if log is None else LogPlan(log, versions(), case.seed, dry_run=True, replace=True)
            flight = open_flight(stack, plan, log=recorded, make=Session)
            runner = flight.session.runner
            try:
                fly_virtual(
                    flight.session,
                    emulated_team(plan, self._world, case.seed),
                    period_ns=round(SECOND_NS / plan.spec.rate_hz),
                    watchers=(self._watch, meter),
                    interrupts=self._interrupts,
                )
            except _TooLongError:
                late = True
            values |= self._figures(runner, meter, late=late)
            if flight.log is not None and flight.manifest is not None and log is not None:
                flight.log.close()
                write_manifest(manifest_path(log), flight.manifest.finished(values))
            if setting.verify and log is not None:
                verified = verify_log(log)
                values |= {"log_mismatches": verified.mismatches, "log_complete": verified.complete}
        return values

    def _watch(self, session: Session, now_ns: int) -> None:
        runner = session.runner
        for note in session.take_notes():
            if note.kind == "alarm":
                self._alarms.append(f"{now_ns / SECOND_NS:.2f} s: {note.text}")
                self._witness.hear(now_ns, note.text)
        if runner.phase is not self._phase:
            self._phase = runner.phase
            self._phases.append(runner.phase.value)
            self._world.dynamics.ground.posts_up = runner.phase in _ON_PADS  # nobody shall land on one while it flies
        if self._upright:
            self._take_clearance()
        self._witness.look(now_ns, self._pairs_so_far)
        self._plot.step(session, now_ns)
        if self._waiting:
            self._strike(runner.phase, now_ns)
        while self._begun and self._begun[0].at_s * SECOND_NS <= now_ns:
            self._spoil(self._begun.pop(0), now_ns)
        self._take_empty()
        self._take_back(now_ns)
        if now_ns >= self._case.setting.limit_s * SECOND_NS:
            raise _TooLongError

    def _strike(self, phase: Phase, now_ns: int) -> None:
        """Lets the fault strike once its phase has been entered and its delay is over."""
        faults = self._case.setting.faults
        if self._due_ns is None:
            if phase in _GROUND if faults.phase == "ground" else phase.value == faults.phase:
                self._due_ns = now_ns + round(self._case.delay_s * SECOND_NS)
            else:
                return
        if now_ns < self._due_ns:
            return
        self._waiting = False
        self._struck_ns = now_ns
        victims = list(range(self._plan.size)) if faults.who == "all" else [self._case.victim]
        sysids = tuple(self._plan.spec.vehicles[i].id for i in victims)
        for fault in faults.faults():
            self._inject(replace(fault, vehicles=sysids))

    def _inject(self, fault: Fault) -> None:
        """Lets a fault strike now."""
        self._spoil(fault, self._world.now_ns)
        self._struck.append(fault.kind)
        self._world.inject(fault)

    def _rows(self, sysids: Sequence[int]) -> list[int]:
        return [row for row, vehicle in enumerate(self._plan.spec.vehicles) if not sysids or vehicle.id in sysids]

    def _spoil(self, fault: Fault, now_ns: int) -> None:
        vehicles = self._rows(fault.vehicles)
        self._witness.upset(vehicles)
        if fault.kind not in DISOBEDIENT:
            return
        passes = fault.kind == "blackout" and fault.for_s is not None
        self._give_up_on(vehicles, now_ns + round((fault.for_s or 0.0) * SECOND_NS) if passes else _FOR_GOOD_NS)

    def _take_empty(self) -> None:
        """Whose battery is empty has no power for its motors, as after a motor failure: nobody can steer it."""
        empty = [row for row, pilot in enumerate(self._world.autopilots) if pilot.battery.left <= 0.0]
        if empty and not self._unsteered[empty].all():
            self._give_up_on(empty)

    def _take_back(self, now_ns: int) -> None:
        """Whoever hears and is heard again for a while, and stands or does as it is told, keeps its distance again."""
        back = self._unsteered & (now_ns - self._deaf_until_ns >= _HEARS_AGAIN_NS)
        if not back.any():
            return
        motion, pilots = self._world.dynamics.motion, self._world.autopilots
        acts_alone = np.array([pilot.acts_alone() for pilot in pilots])
        back &= ~motion.crashed & (motion.on_ground | ~acts_alone)
        if back.any():
            self._take_distances()
            self._unsteered &= ~back

    def _give_up_on(self, vehicles: Sequence[int], until_ns: int = _FOR_GOOD_NS) -> None:
        """From now on these are not counted among those that have to keep their distance; until they hear again."""
        self._take_distances()
        self._witness.upset(vehicles)
        rows = list(vehicles)
        self._unsteered[rows] = True
        self._deaf_until_ns[rows] = np.maximum(self._deaf_until_ns[rows], until_ns)

    def _pairs_so_far(self) -> FloatArray:
        """Smallest distance of each pair up to now."""
        return np.asarray(np.minimum(self._pair_m, self._world.min_distance_airborne_of_pairs_m()))

    def _take_distances(self) -> None:
        pairs = self._world.min_distance_airborne_of_pairs_m()
        self._world.reset_min_distance()
        np.minimum(self._pair_m, pairs, out=self._pair_m)
        obedient = ~self._unsteered
        self._min_m = min(self._min_m, float(pairs.min()))
        self._min_obedient_m = min(self._min_obedient_m, float(pairs[np.ix_(obedient, obedient)].min(initial=math.inf)))

    def _take_clearance(self) -> None:
        """Regions that are no spheres: in their norm, at every tick."""
        truth = self._world.truth
        pos_ned_m = frames.ned_from_enu(truth.pos_enu_m)
        clearance = min_clearance(pos_ned_m, self._plan.region, ~self._unsteered, flying=truth.airborne)
        self._min_clearance = min(self._min_clearance, clearance)

    def _figures(self, runner: Told, meter: TruthMeter, *, late: bool) -> Row:
        plan, figures, setting = self._plan, runner.figures, self._case.setting
        radius_m = plan.spec.avoidance.radius_m
        self._witness.ended(self._world.now_ns)
        self._plot.end()
        self._settle(round(setting.settle_s * SECOND_NS))
        self._take_distances()
        states = [self._state(i) for i in range(plan.size)]
        ended_safely = not late and all(state in ("down", "crashed", "failsafe") for state in states)
        fell = self._world.dynamics.motion.crashed | (self._world.dynamics.motion.touchdown_m_s > TOUCHDOWN_MAX_M_S)
        unhurt = not bool((fell & ~self._unsteered).any())
        reason = f"not over after {setting.limit_s:g} s, in phase {runner.phase.value}" if late else runner.reason
        outcome = "late" if late else str(runner.outcome)
        if not self._upright:
            self._min_clearance = self._min_obedient_m / radius_m
        clear = self._min_clearance >= 1.0
        clear_of_all = clear if self._upright else self._min_m >= radius_m
        formed = bool(figures.converged)
        first, second = np.unravel_index(int(np.argmin(self._pair_m)), self._pair_m.shape)
        ids = [plan.spec.vehicles[int(i)].id for i in (first, second)]
        pads = np.linalg.norm(plan.pads_enu_m[:, None] - plan.pads_enu_m[None], axis=-1)
        struck = self._struck_ns is not None
        faults = setting.faults
        verdict = self._witness.verdict(outcome, reason, self._pair_m)
        return {
            "outcome": outcome,
            "reason": reason[:_WORDS_MAX],
            "success": formed and outcome == "completed" and clear_of_all and set(states) == {"down"},
            "formed": formed,
            "safe": ended_safely and clear and unhurt,
            "time_to_form_s": float(figures.time_to_form_s),
            "formation_error_m": float(meter.formation_error_m),
            "hold_speed_m_s": math.nan if struck or self._case.events or self._planned else meter.hold_speed_m_s,
            "min_distance_m": _finite(self._min_m),
            "nearest_pair": f"{ids[0]}-{ids[1]}" if math.isfinite(self._min_m) else "",
            "min_obedient_m": _finite(self._min_obedient_m),
            "min_clearance": _finite(self._min_clearance),
            "start_distance_m": _finite(float(pads[np.triu_indices(plan.size, 1)].min(initial=math.inf))),
            "gridlocks": int(figures.gridlocks),
            "role_swaps": int(figures.role_swaps),
            "detours": int(figures.detours),
            "setpoints": int(runner.setpoints_sent),
            "ticks": int(figures.ticks),
            "duration_s": float(figures.flight_time_s),
            "phases": " ".join(self._phases),
            "end": _counted(states),
            "ended_safely": ended_safely,
            "alarms": "\n".join(self._alarms)[:_WORDS_MAX],
            "told": bool(self._alarms or reason) and not verdict.untold,
            "faults": " ".join(self._struck if self._case.events else self._planned),
            "fault_phase": faults.phase or "",
            "fault_vehicle": plan.spec.vehicles[self._case.victim].id if struck and faults.who == "one" else 0,
            "fault_at_s": math.nan if self._struck_ns is None else self._struck_ns / SECOND_NS,
            "events": "\n".join(self._plot.happened),
            "tracebacks": sum(_OWN_FAULT in alarm for alarm in self._alarms),
            **verdict.columns(),
        }

    def _hears(self, row: int, frame: bytes) -> None:
        """A vehicle hears somebody else than the ground station."""
        self._world.receive(row, frame, self._world.now_ns, "pilot")

    def _settle(self, most_ns: int) -> None:
        """Lets time pass with nobody at the ground station, until everybody is down or time is over."""
        world, end_ns = self._world, self._world.now_ns + most_ns
        while world.now_ns < end_ns and any(self._state(i) not in ("down", "crashed") for i in range(world.n)):
            world.advance(world.now_ns + _SETTLE_STEP_NS)

    def _state(self, i: int) -> str:
        """How a vehicle ended, by the truth: down, crashed, failsafe, armed on the ground, or in the air."""
        world, pilot = self._world, self._world.autopilots[i]
        if world.dynamics.motion.crashed[i]:
            return "crashed"
        on_ground = bool(world.dynamics.motion.on_ground[i])
        if on_ground and (not pilot.armed or pilot.stands_ready):
            return "down"
        if pilot.acts_alone():
            return "failsafe"
        return "armed on the ground" if on_ground else "in the air"


def emulated(case: Case, plan: MissionPlan) -> WorldConfig:
    """The world of a case.

    Raises:
        UserError: the mission asks for what the emulator does not do, or a fault for a vehicle that is not there.
    """
    setting = case.setting
    emulator = setting.emulator
    posts = setting.starts.kind == "volume" or (setting.adversary is not None and bool(plan.pads_enu_m[:, 2].any()))
    config = world_config(plan, case.seed)
    vehicles = tuple(
        replace(
            vehicle,
            noise=emulator.noise.apply(vehicle.noise),
            streams="quiet" if emulator.streams == "quiet" else vehicle.streams,
        )
        for vehicle in config.vehicles
    )
    config = replace(
        config,
        vehicles=vehicles,
        wind=emulator.wind(),
        downwash=emulator.downwash,
        own_frames=emulator.own_frames.config(),
        floor_m=0.0 if posts else None,
        faults=setting.faults.scheduled(),
    )
    link = emulator.link.config()
    if link != config.uplink:
        config = replace(config, uplink=link, downlink=link)
    if config.faults:
        try:
            World(config, case.seed)
        except FaultError as error:
            raise UserError(str(error)) from None
    return config


def _counted(states: list[str]) -> str:
    """How many ended how, in words."""
    counts: Mapping[str, int] = {state: states.count(state) for state in sorted(set(states))}
    return ", ".join(f"{count} {state}" for state, count in counts.items())


def _finite(value: float) -> float:
    return value if math.isfinite(value) else math.nan
