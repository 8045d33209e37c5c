"""The programming interface: ``import groundstation as gs``. What ``__all__`` names here keeps its name and meaning.

Everything is loaded when it is first used. Positions are ENU, metres, in the mission's team frame, times are seconds
since the flight began. What is wrong with a file, a value or a request is a ``UserError``, whose text is the one that
the command line prints; whatever else is raised is a fault of ours.

Example:
    >>> import groundstation as gs
    >>> formation = gs.load_formation("pair2")
    >>> formation.size
    2
    >>> mission = gs.load_mission("hello1", {"steps": [{"hover": {"seconds": 2}}]})
    >>> flown = gs.simulate(mission, seed=1, log="hello.tlog")
    >>> flown.outcome
    'completed'
    >>> gs.verify(flown.log).mismatches
    0
    >>> log = gs.read_log(flown.log)
    >>> sorted(log.positions())
    ['t_s', 'vehicle', 'x_enu_m', 'y_enu_m', 'z_enu_m']
"""

from __future__ import annotations

import json
import math
import threading
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from groundstation.app.comparing import Comparison
from groundstation.app.log_tables import Log
from groundstation.app.output import Output
from groundstation.app.resources import find_config, find_log
from groundstation.app.verify import VerifyResult, verify_log
from groundstation.core import frames
from groundstation.core.errors import UserError
from groundstation.core.formation import Formation, Gains
from groundstation.core.law import Answer, Seen
from groundstation.core.types import FloatArray, IntArray
from groundstation.design import store
from groundstation.design.designer import DesignResult, design
from groundstation.mission.plan.own_code import AVOIDANCE, LAW, CodeSource, name_of
from groundstation.mission.plan.plan import MissionPlan as Mission
from groundstation.mission.plan.reading import load_mission as read_mission
from groundstation.mission.runner import FORMATION_PHASES
from groundstation.records.manifest import Values
from groundstation.records.replay import load_flight

if TYPE_CHECKING:
    from groundstation.app.session import Session
    from sitl.world import World

__all__ = [
    "Comparison", "DesignResult", "Flown", "Formation", "Gains", "Log", "Mission", "Seen", "Tick", "UserError",
    "VerifyResult", "compare", "design", "fly", "load_formation", "load_mission", "read_log", "report",
    "save_gains", "simulate", "verify",
]  # fmt: skip

Changes = Mapping[str, object] | Sequence[str]
"""What differs from a mission file: ``{"steps.1.hold.seconds": 2}``, or as on the command line ``["gain=0.5"]``."""


@dataclass(frozen=True)
class Tick:
    """One tick of a simulated flight.

    Attributes:
        t_s: time.
        phase: connect, arm, takeoff, form, hold, move, return, land, ...
        pos_enu_m: where everybody truly is, shape (n, 3).
        vel_enu_m_s: how everybody truly moves, shape (n, 3).
        setpoint_enu_m_s: velocities that were sent in this tick, shape (n, 3).
        roles: role of each vehicle, from 0, shape (n,).
        formation_error_m: largest true |d_ij - d*_ij| of the formation under way; NaN while none is.
    """

    t_s: float
    phase: str
    pos_enu_m: FloatArray
    vel_enu_m_s: FloatArray
    setpoint_enu_m_s: FloatArray
    roles: IntArray
    formation_error_m: float


@dataclass(frozen=True)
class Flown:
    """What came of a flight: the figures of ``gs fly --json``.

    Attributes:
        mission: its name.
        outcome: completed or aborted.
        reason: why it was aborted.
        refused: preflight refused, nothing was armed.
        converged: the formation was formed, and held.
        time_to_form_s: NaN where it was not formed.
        formation_error_m: largest distance error while holding; the true one in a simulation.
        min_distance_m: smallest distance in the air; the true one in a simulation.
        duration_s: time in the air.
        log: the .tlog file; None where none was written.
        figures: all figures by their names.
    """

    mission: str
    outcome: str
    reason: str
    refused: bool
    converged: bool
    time_to_form_s: float
    formation_error_m: float
    min_distance_m: float
    duration_s: float
    log: Path | None
    figures: Values


def load_formation(name: str | Path) -> Formation:
    """Reads a formation file, or one that comes along.

    Args:
        name: file, as given or among those that come along; the suffix may be left out.

    Raises:
        UserError: there is none, or it is wrong.

    Example:
        >>> load_formation("cube8").points_enu_m.shape
        (8, 3)
    """
    return store.load_formation(find_config(Path(name), "formations"))


def save_gains(result: DesignResult, path: str | Path) -> None:
    """Writes designed gains to a file that a mission can name.

    Args:
        result: of ``design``.
        path: ends in .npz; is written over.

    Raises:
        UserError: there are no gains, or the file cannot be written.
    """
    if result.gains is None or result.certificate is None:
        raise UserError(f"{path}: there are no gains to write: {result.reason}")
    store.save_gains(Path(path), result.formation, result.gains, result.certificate, result.method)


def load_mission(
    name: str | Path, changes: Changes = (), *, law: Answer | None = None, avoidance: Answer | None = None
) -> Mission:
    """Reads a mission with its formations and gains, and judges it.

    Args:
        name: file, as given or among those that come along; the suffix may be left out.
        changes: what differs from the file.
        law: a class or function that flies the formation in place of the paper's law, see docs/own-laws.md.
        avoidance: the same for avoidance.

    Raises:
        UserError: there is none, or something in it is wrong: file, key, value, limit and remedy.

    Example:
        >>> load_mission("first_flight2", {"speed_limit_m_s": 0.4}).spec.speed_limit_m_s
        0.4
    """
    path = find_config(Path(name), "missions")
    given = {key: code for key, code in ((LAW, law), (AVOIDANCE, avoidance)) if code is not None}
    named = {f"{key}.use": name_of(code) for key, code in given.items()}
    return read_mission(path, [*_as_words(changes), *_as_words(named)], CodeSource((path.parent, Path()), given))


def simulate(
    mission: Mission | str | Path,
    *,
    seed: int = 0,
    on_tick: Callable[[Tick], str | None] | None = None,
    faults: str | Path | None = None,
    log: str | Path | None = None,
    force: bool = False,
) -> Flown:
    """Flies a mission on the emulator, in virtual time: the same code that flies vehicles.

    Args:
        mission: as read, or its name.
        seed: of the emulator's noise; the same seed gives the same flight, to the bit.
        on_tick: called after every tick; what it returns is an order of the operator, for example ``"land all"`` or
            ``"hold"``, and None is none. What it raises ends the simulation.
        faults: timetable of faults.
        log: where to record (.tlog); the log of the same mission with the same seed is replaced. Nowhere when None.
        force: replace another log too, unless vehicles flew it.

    Raises:
        UserError: the mission, the faults, an order or the log's place is wrong.

    Example:
        >>> heights = []
        >>> mission = load_mission("hello1", {"steps": [{"hover": {"seconds": 1}}], "takeoff.height_m": 2.0})
        >>> flown = simulate(mission, on_tick=lambda tick: heights.append(tick.pos_enu_m[:, 2].max()))
        >>> bool(1.5 < max(heights) < 2.5)
        True
    """
    from groundstation.app.emulator import read_faults
    from groundstation.app.flying import fly_dry, log_path_of

    plan = mission if isinstance(mission, Mission) else load_mission(mission)
    path = None if log is None else log_path_of(plan, Path(log), dry_run=True, seed=seed, force=force)[0]
    timetable = read_faults(None if faults is None else Path(faults), plan)
    values = fly_dry(_quiet(), plan, path, timetable, seed=seed, realtime=False, watch=_looking(on_tick))
    return _flown(values)


def fly(
    mission: Mission | str | Path, *, log: str | Path | None = None, take_over: bool = False, show: bool = True
) -> Flown:
    """Flies a mission on the vehicles at the other end of its links, as ``gs fly`` does. People stand beside them.

    Returns when everybody has landed. Nothing of the caller runs in the meantime: what steers vehicles does nothing
    else. Ctrl-C brings everybody back, twice ends the setpoints; ``gs command`` in a terminal gives orders.

    Args:
        mission: as read, or its name.
        log: where to record (.tlog); a new file in flights/ when None.
        take_over: bring home vehicles that a ground station left in the air.
        show: print what happens.

    Raises:
        UserError: the mission, a link or the log's place is wrong, or this is not the program's main thread, in which
            alone Ctrl-C is heard.
    """
    from groundstation.app.flying import fly_vehicles, log_path_of

    if threading.current_thread() is not threading.main_thread():
        raise UserError("fly: Ctrl-C, which brings everybody back, is heard in the main thread alone; fly from there")
    plan = mission if isinstance(mission, Mission) else load_mission(mission)
    path, _ = log_path_of(plan, None if log is None else Path(log), dry_run=False, seed=0)
    out = Output(as_json=False) if show else _quiet()
    return _flown(fly_vehicles(out, plan, path, (), emulated_seed=None, take_over=take_over))


def verify(
    log: str | Path, *, law: Answer | None = None, avoidance: Answer | None = None, laws: Sequence[str | Path] = ()
) -> VerifyResult:
    """Flies a log again from its bytes and compares everything that was sent, bit by bit.

    Args:
        log: of ``gs fly`` or ``simulate``, with its manifest.
        law: the law that it was flown with, where it was not the paper's and is not installed.
        avoidance: the same for avoidance.
        laws: folders in which such code is looked for.

    Raises:
        UserError: the log cannot be verified, or the code is not what was flown.
    """
    given = {key: code for key, code in ((LAW, law), (AVOIDANCE, avoidance)) if code is not None}
    return verify_log(find_log(Path(log)), CodeSource(tuple(map(Path, laws)), given))


def read_log(log: str | Path) -> Log:
    """Reads a log: of ``gs``, or a .tlog of QGroundControl, MAVProxy or mavutil.

    Raises:
        UserError: it cannot be used.
    """
    path = find_log(Path(log))
    return Log(path, load_flight(path))


def compare(logs: Sequence[str | Path]) -> Comparison:
    """Compares flights: time to form, distances, effort, and how far they deviate from each other.

    Args:
        logs: their files, two or more.

    Raises:
        UserError: one cannot be read, or holds nothing.
    """
    from groundstation.app.comparing import compare_logs

    return compare_logs([find_log(Path(log)) for log in logs])


def report(log: Log | str | Path | Sequence[str | Path], folder: str | Path, *, force: bool = False) -> list[Path]:
    """Draws the pictures of a log and writes a page with them.

    Args:
        log: as read, or its file; of several files a comparison, with a report of each below it.
        folder: made when missing; an earlier report in it is replaced.
        force: replace files of these names whatever they are.

    Returns:
        The files written, ``index.html`` first.

    Raises:
        UserError: nothing can be drawn of it, or the folder cannot be written.
    """
    from groundstation.app.comparing import write_comparison
    from groundstation.app.report import claim_report, write_report

    if not isinstance(log, Log | str | Path):
        logs = [find_log(Path(item)) for item in log]
        return write_comparison(compare(logs), Path(folder), logs=logs, force=force)
    read = log if isinstance(log, Log) else read_log(log)
    if not read.flight.useful:
        raise UserError(f"{read.path}: holds no position and no setpoint; there is nothing to draw")
    claim_report(Path(folder), force=force)
    return write_report(read.flight, Path(folder), log=read.path)


def _as_words(changes: Changes) -> list[str]:
    """Changes as the command line has them."""
    if isinstance(changes, Mapping):
        return [f"{key}={json.dumps(value)}" for key, value in changes.items()]
    return list(changes)


def _quiet() -> Output:
    """Prints nothing."""
    out = Output(as_json=False)
    out.console.quiet = True
    return out


def _looking(on_tick: Callable[[Tick], str | None] | None) -> Callable[[Session, int, World], None]:
    """Shows each tick to somebody else's function, and takes its order."""

    def look(session: Session, now_ns: int, world: World) -> None:
        if on_tick is None:
            return
        runner, truth = session.runner, world.truth
        formed = runner.phase in FORMATION_PHASES
        tick = Tick(
            t_s=now_ns / 1e9,
            phase=runner.phase.value,
            pos_enu_m=truth.pos_enu_m.copy(),
            vel_enu_m_s=truth.vel_enu_m_s.copy(),
            setpoint_enu_m_s=frames.enu_from_ned(runner.sent_ned_m_s),
            roles=runner.role_of_agent.copy(),
            formation_error_m=runner.formation_error_m(truth.pos_enu_m) if formed else math.nan,
        )
        order = on_tick(tick)
        if isinstance(order, str):
            try:
                session.operator(order, now_ns)
            except ValueError as error:
                raise UserError(f"on_tick: {order!r} is no order: {error}") from None

    return look


def _flown(values: Values) -> Flown:
    figures = {key: value for key, value in values.items() if key != "beside"} | dict(values["beside"])
    log = figures["log"]
    return Flown(
        mission=str(figures["mission"]),
        outcome=str(figures["outcome"]),
        reason=str(figures["reason"]),
        refused=bool(figures["refused"]),
        converged=bool(figures["converged"]),
        time_to_form_s=float(figures["time_to_form_s"]),
        formation_error_m=float(figures["formation_error_m"]),
        min_distance_m=float(figures["min_distance_m"]),
        duration_s=float(figures["duration_s"]),
        log=None if log is None else Path(log),
        figures=figures,
    )
