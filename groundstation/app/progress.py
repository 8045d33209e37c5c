"""What a flight shows while it lasts: a live line and a table of the team, and a line for each thing that happens.

The tick only says what is to be shown; a thread of its own shows it. A terminal that is stopped, slow, closed or full,
and memory that has run out while drawing, cost the picture and nothing else.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable, Sequence
from threading import Event, Thread
from types import TracebackType

from rich.console import Console, Group, RenderableType
from rich.live import Live
from rich.text import Text

from groundstation.app.keyboard import HELP
from groundstation.app.session import Session
from groundstation.app.team_table import ROWS_MIN, LastAlarms, team_table
from groundstation.links.link import Link
from groundstation.mission.plan.plan import MissionPlan
from groundstation.mission.runner import FORMATION_PHASES, Note, Phase
from groundstation.mission.told import Look

_REFRESH_NS = 200_000_000
_WAITING_NS = 5_000_000_000
_LINES_MAX = 5_000  # that wait for a terminal that takes none; the oldest are left out, the log has them all
_LAST_LINES_S = 5.0
_WAITING_PHASES = (Phase.CONNECT, Phase.TAKEOVER)
_OTHER_LINES = 6  # of the terminal: state, head of the table, prompt, and some of what has happened
_STYLES = {"alarm": "bold red", "phase": "bold", "info": "dim", "roles": "dim"}


def link_troubles(links: Sequence[Link]) -> list[str]:
    """What is wrong with the links themselves, a line for each that does not work, or has left something out."""
    broken = [f"link {link.url}: {link.state}" for link in links if link.state]
    return broken + [f"link {link.url}: left out: {link.left_out}" for link in links if link.left_out]


class Screen:
    """Prints lines and a live state from a thread of its own.

    Args:
        console: where to.

    Attributes:
        problem: why nothing is shown any more, None while all is well.
    """

    def __init__(self, console: Console) -> None:
        self.problem: str | None = None
        self._console = console
        self._lines: deque[Text] = deque(maxlen=_LINES_MAX)
        self._state: RenderableType | None = None
        self._news = Event()
        self._end = False
        self._thread = Thread(target=self._run, name="screen", daemon=True)

    def start(self) -> None:
        """Begins to show."""
        self._thread.start()

    def line(self, text: Text) -> None:
        """Takes a line to be printed."""
        self._lines.append(text)
        self._news.set()

    def state(self, picture: RenderableType) -> None:
        """Takes the state to be shown below the lines, in place of the one before."""
        self._state = picture
        self._news.set()

    def stop(self) -> None:
        """Shows what is left, as far as the terminal takes it, and ends."""
        self._end = True
        self._news.set()
        if self._thread.is_alive():
            self._thread.join(_LAST_LINES_S)

    def _run(self) -> None:
        try:
            if not self._console.is_terminal:
                self._show(None)
                return
            with Live(
                console=self._console,
                auto_refresh=False,
                transient=True,
                redirect_stdout=False,
                redirect_stderr=False,
            ) as live:
                self._show(live)
        except BaseException as error:  # whatever it was, the flight goes on
            self.problem = f"{type(error).__name__}: {error}"
            self._lines = deque(maxlen=1)

    def _show(self, live: Live | None) -> None:
        ended = False
        while not ended:
            self._news.wait()
            self._news.clear()
            ended = self._end
            while self._lines:
                self._console.print(self._lines.popleft())
            state, self._state = self._state, None
            if live is not None and state is not None:
                live.update(state, refresh=True)


class FlightDisplay:
    """Shows a flight on a console; used as a watcher of the loop. Never raises into it.

    Args:
        console: where to.
        plan: the mission, for its name.
        links: whose troubles are shown as they come and go.
        prompt: the line for the operator's keys, "" for none.
    """

    def __init__(
        self,
        console: Console,
        plan: MissionPlan,
        links: Sequence[Link] = (),
        prompt: Callable[[], str] | None = None,
    ) -> None:
        self.screen = Screen(console)
        self._console = console
        self._alarms = LastAlarms([vehicle.id for vehicle in plan.spec.vehicles])
        self._plan = plan
        self._links = links
        self._states = [""] * len(links)
        self._prompt = prompt
        self._prompted = ""
        self._next_ns = 0
        self._next_waiting_ns = _WAITING_NS

    def __enter__(self) -> FlightDisplay:
        """Begins to show."""
        self.screen.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """Ends the live line."""
        self.screen.stop()

    def __call__(self, session: Session, now_ns: int) -> None:
        """Shows what has changed."""
        notes = session.take_notes()
        if self.screen.problem is not None:
            return
        try:
            self._look(session, now_ns, notes)
        except Exception as error:  # memory may have run out
            self.screen.problem = f"{type(error).__name__}: {error}"

    def _look(self, session: Session, now_ns: int, notes: list[Note]) -> None:
        for note in notes:
            if note.kind == "alarm":
                self._alarms.take(note.text, now_ns)
            self.screen.line(Text(f"{now_ns / 1e9:8.2f} s  {note.kind:5}  {note.text}", style=_STYLES[note.kind]))
        prompt = self._prompt() if self._prompt is not None else ""
        if now_ns < self._next_ns and prompt == self._prompted:
            return
        self._next_ns, self._prompted = now_ns + _REFRESH_NS, prompt
        self._tell_links(now_ns)
        runner = session.runner
        if self._console.is_terminal:
            self.screen.state(self._picture(session, now_ns, prompt))
        elif runner.phase in _WAITING_PHASES and now_ns >= self._next_waiting_ns:
            # Where nothing can be drawn over, what is waited for is told now and then: an estimator takes a minute.
            self._next_waiting_ns = now_ns + _WAITING_NS
            for problem in [*link_troubles(self._links), *runner.problems]:
                self.screen.line(Text(f"{now_ns / 1e9:8.2f} s  waiting: {problem}", style="yellow"))

    def _tell_links(self, now_ns: int) -> None:
        """A line for each link whose trouble is new, another, or over."""
        for number, link in enumerate(self._links):
            state = link.state
            if state != self._states[number]:
                self._states[number] = state
                words = f"{link.url}: {state or 'works'}"
                style = _STYLES["alarm" if state else "phase"]
                self.screen.line(Text(f"{now_ns / 1e9:8.2f} s  link   {words}", style=style))

    def _picture(self, session: Session, now_ns: int, prompt: str) -> Group:
        """The state, the team where there is one to be seen, and what the keys do."""
        look = None if session.runner.phase in _WAITING_PHASES else session.runner.look(now_ns)
        parts: list[RenderableType] = [self._line(session, now_ns, look)]
        if look is not None:
            lines = max(ROWS_MIN, self._console.height - _OTHER_LINES)
            parts.append(team_table(session, look, self._alarms, now_ns, lines))
        if prompt:
            parts.append(Text(prompt, style="dim" if prompt == HELP else "bold yellow"))
        return Group(*parts)

    def _line(self, session: Session, now_ns: int, look: Look | None = None) -> Text:
        runner = session.runner
        text = Text(f"{self._plan.spec.name}  {now_ns / 1e9:6.1f} s  {runner.phase.value}", style="bold cyan")
        if runner.phase in _WAITING_PHASES:
            for problem in [*link_troubles(self._links), *runner.problems]:
                text.append(f"\n  waiting: {problem}", style="yellow")
            return text
        if look is not None and runner.phase in FORMATION_PHASES:
            error_m = runner.formation_error_m(look.poses.pos_team_ned_m)
            text.append(f"  step {runner.step_number} of {len(self._plan.spec.steps)}", style="default")
            if math.isfinite(error_m):
                text.append(f"  formation {error_m:.2f} m off", style="default")
        text.append(f"  in the air: {int(runner.airborne.sum())} of {self._plan.size}", style="default")
        if math.isfinite(runner.figures.min_distance_m):  # not before two of them are in the air
            least = f"  smallest distance {runner.figures.min_distance_m:.2f} m"
            text.append(f"{least} (r {self._plan.spec.avoidance.radius_m:g})", style="default")
        return text
