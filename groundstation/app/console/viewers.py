"""The flight's end of the one-way stream: sends snapshots to whoever looks, and never waits for anybody.

A console listens at a socket of its own, ``PID-CONSOLE.view``, in the folder that only the user can open; the
flight looks for such sockets once a second. Nobody there: nothing is built. One that does not read, or has gone, misses
snapshots. Nothing is ever read here. Whatever goes wrong costs the picture and no tick.
"""

from __future__ import annotations

import contextlib
import math
import os
import socket
from collections import deque
from collections.abc import Callable, Mapping, Sequence
from contextlib import ExitStack
from pathlib import Path
from types import TracebackType

import numpy as np

from groundstation.app.check_screen import cells_of
from groundstation.app.console.link_loss import LinkLoss
from groundstation.app.console.snapshot import (
    AIRBORNE,
    ARMED,
    AVOIDS,
    BLOCKED,
    BYTES_MAX,
    FIGURES,
    FOREIGN,
    HELD,
    LOST,
    NOTES_MAX,
    Snapshot,
    Words,
    encode,
)
from groundstation.app.order_client import runtime_folder
from groundstation.app.session import Session
from groundstation.app.tick_times import TickTimes
from groundstation.core import frames
from groundstation.core.phases import Phase
from groundstation.mavlink.vehicle import UNKNOWN
from groundstation.mission.operator import Order
from groundstation.mission.plan.plan import MissionPlan
from groundstation.mission.roster import Duty
from groundstation.mission.timing import SECOND_NS
from groundstation.mission.told import Told

EVERY_NS = SECOND_NS // 20
"""Between two snapshots, at least."""
_SEARCH_NS = SECOND_NS
_ENDLESS_S = 1e9
_LAST_S = 1.0
_TEXT_MAX = 300
_PROBLEMS_MAX = 30


class Viewers:
    """Whoever looks on; a watcher of the loop that never raises into it.

    Args:
        folder: where the consoles' sockets are.
        plan: the mission.
        measured: figures that stand in place of what the vehicles report: the emulator's truth, as in the answer of
            ``gs fly --json``.
        tick_ms: longest tick since it was last asked; see ``TickTimes.take_worst_ms``.

    Attributes:
        sent: snapshots that were taken.
        lost: snapshots that were not.
        problem: why nothing is sent any more, "" while all is well.
    """

    def __init__(
        self,
        folder: Path,
        plan: MissionPlan,
        measured: Callable[[], Mapping[str, float]] = dict,
        tick_ms: Callable[[], float] = lambda: math.nan,
    ) -> None:
        self.sent = self.lost = 0
        self.problem = ""
        self._folder, self._plan, self._measured, self._tick_ms = folder, plan, measured, tick_ms
        self._found: list[Path] = []
        self._next_ns = self._search_ns = self._checks_ns = 0
        self._notes: deque[tuple[float, str, str]] = deque(maxlen=NOTES_MAX)
        self._said = [""] * plan.size
        self._loss = LinkLoss()
        self._lost_share = np.full(plan.size, np.nan)
        self._listens = False
        self._socket: socket.socket | None = None

    def __enter__(self) -> Viewers:
        """Opens the socket that is only written to."""
        with contextlib.suppress(OSError):  # without it nobody is shown anything
            self._socket = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)
            self._socket.setblocking(False)
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """Closes it."""
        if self._socket is not None:
            self._socket.close()

    def __call__(self, session: Session, now_ns: int) -> None:
        """Sends a snapshot when one is due and somebody looks."""
        if self.problem:
            return
        try:
            for note in session.said:
                if note.kind != "roles":
                    self._keep(note.kind, note.text, now_ns)
            over = session.runner.done
            if now_ns >= self._search_ns:
                self._search_ns = now_ns + _SEARCH_NS
                self._found = sorted(self._folder.glob(f"{os.getpid()}-*.view"))
                self._listen(session)
            if self._found and (now_ns >= self._next_ns or over):
                self._next_ns = now_ns + EVERY_NS
                if over and self._socket is not None:  # nobody is steered any more: the last one may wait for room
                    self._socket.settimeout(_LAST_S)
                self._send(encode(self.snapshot(session, now_ns)))
        except Exception as error:
            self.problem = f"{type(error).__name__}: {error}"

    def _listen(self, session: Session) -> None:
        """Counts what is lost on the links from when somebody looks on; once a second it is told."""
        if self._listens:
            self._lost_share = self._loss.take_shares(self._plan.sysids)
        elif self._found:
            self._listens, before = True, session.onward

            def take(data: bytes) -> None:
                self._loss.take(data)
                if before is not None:
                    before(data)

            session.onward = take

    def _keep(self, kind: str, text: str, now_ns: int) -> None:
        self._notes.append((now_ns / SECOND_NS, kind, text[:_TEXT_MAX]))
        who, says, words = text.partition(" says: ")
        if says:
            for row, vehicle in enumerate(self._plan.spec.vehicles):
                if who == f"vehicle {vehicle.id}":
                    self._said[row] = words[:_TEXT_MAX]

    def _checks(self, runner: Told, now_ns: int) -> tuple[tuple[str, ...], ...]:
        """Preflight's table, once a second: it is longer than all the rest."""
        if runner.phase is not Phase.CONNECT or now_ns < self._checks_ns:
            return ()
        self._checks_ns = now_ns + SECOND_NS
        return tuple((*cells_of(row), "; ".join(row.problems)[:_TEXT_MAX]) for row in runner.check_rows())

    def _send(self, data: bytes) -> None:
        for path in self._found:
            try:
                if self._socket is None or len(data) > BYTES_MAX:
                    raise OSError("no socket, or too much")
                self._socket.sendto(data, str(path))
                self.sent += 1
            except OSError:
                self.lost += 1

    def snapshot(self, session: Session, now_ns: int) -> Snapshot:
        """The flight as it is now."""
        runner, plan = session.runner, self._plan
        fleet, figures, look = runner.fleet, runner.figures, runner.look(now_ns)
        role = runner.role_of_agent
        bits = (
            (look.held, HELD),
            (look.lost, LOST),
            (look.foreign & (look.duty < Duty.LANDS), FOREIGN),  # who was told to land lands by its own mode
            (runner.airborne, AIRBORNE),
            (look.avoids, AVOIDS),
            (look.blocked, BLOCKED),
        )
        state = fleet.armed * ARMED + sum(mask * bit for mask, bit in bits)
        known = {"setpoints": runner.setpoints_sent, **self._measured()}
        row_of_role = np.argsort(role)
        edges = np.array(look.formation.edges, dtype=np.int64).reshape(-1, 2)
        fence = plan.spec.fence
        return Snapshot(
            words=Words(
                mission=plan.spec.name,
                phase=runner.phase.value,
                outcome=runner.outcome or "",
                reason=runner.reason[:_TEXT_MAX],
                modes=tuple(
                    plan.autopilots[row].mode_name(mode) if mode != UNKNOWN else ""
                    for row, mode in enumerate(fleet.custom_mode.tolist())
                ),
                said=tuple(self._said),
                notes=tuple(self._notes),
                radius_m=plan.spec.avoidance.radius_m,
                problems=_first(runner.problems) if runner.phase is Phase.CONNECT else (),
                checks=self._checks(runner, now_ns),
                refused={order.value: why for order in Order if (why := runner.refusal(order))},
            ),
            t_s=now_ns / SECOND_NS,
            ids=fleet.ids,
            role=role,
            duty=look.duty,
            state=np.asarray(state, dtype=np.int64),
            pos_team_enu_m=frames.enu_from_ned(look.poses.pos_team_ned_m),
            quat_ned_from_frd=look.poses.quat_ned_from_frd,
            setpoint_enu_m_s=frames.enu_from_ned(runner.sent_ned_m_s),
            battery=fleet.battery_remaining,
            pose_age_s=_age_s(now_ns - look.pose_ns),
            silent_s=_age_s(now_ns - fleet.heard_ns),
            lost_share=self._lost_share,
            link_heard=fleet.link_heard,
            link_trip_s=fleet.link_trip_s,
            extra_radius_m=look.poses.extra_radius_m,
            pads_enu_m=plan.pads_enu_m,
            goal_enu_m=look.formation.points_enu_m[role],
            fence_enu_m=np.array([fence.min_m, fence.max_m], dtype=np.float64),
            edges=row_of_role[edges],
            figures=np.array([known.get(name, getattr(figures, name, np.nan)) for name in FIGURES], dtype=np.float64),
            anchor_deg_m=look.anchor_deg_m,
            tick_ms=self._tick_ms(),
        )


def _first(problems: Sequence[str]) -> tuple[str, ...]:
    """As many as a page has room for, and how many there are beside."""
    more = len(problems) - _PROBLEMS_MAX
    kept = [text[:_TEXT_MAX] for text in problems[:_PROBLEMS_MAX]]
    return (*kept, f"and {more} more") if more > 0 else tuple(kept)


def shown(
    stack: ExitStack,
    plan: MissionPlan,
    measured: Callable[[], Mapping[str, float]],
    times: TickTimes | None = None,
    *,
    console: bool,
) -> tuple[Viewers, ...]:
    """What shows a flight to consoles, where that is wished; open until the stack ends.

    Args:
        stack: of the flight.
        plan: the mission.
        measured: see ``Viewers``.
        times: of the ticks; None in virtual time.
        console: whether it is wished.
    """
    if not console:
        return ()
    folder = runtime_folder(os.environ, Path.home())
    tick_ms = (TickTimes() if times is None else times).take_worst_ms
    return (stack.enter_context(Viewers(folder, plan, measured, tick_ms)),)


def _age_s(
    age_ns: np.ndarray[tuple[int, ...], np.dtype[np.int64]],
) -> np.ndarray[tuple[int, ...], np.dtype[np.float64]]:
    """Seconds since something; NaN where it has not happened."""
    age_s = age_ns / SECOND_NS
    return np.where(age_s < _ENDLESS_S, age_s, np.nan)
