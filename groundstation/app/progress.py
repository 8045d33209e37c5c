"""What a flight shows while it lasts: one live line of state, and a line for each thing that happens."""

from __future__ import annotations

from collections.abc import Sequence
from types import TracebackType

from rich.console import Console
from rich.live import Live
from rich.text import Text

from groundstation.app.session import Session
from groundstation.links.link import Link
from groundstation.mission.plan import MissionPlan
from groundstation.mission.runner import Phase

_REFRESH_NS = 200_000_000
_WAITING_NS = 5_000_000_000
_STYLES = {"alarm": "bold red", "phase": "bold", "info": "dim", "roles": "dim"}


def link_troubles(links: Sequence[Link]) -> list[str]:
    """What is wrong with the links themselves, a line for each that does not work."""
    return [f"link {link.url}: {link.state}" for link in links if link.state]


class FlightDisplay:
    """Shows a flight on a console; used as a watcher of the loop.

    Args:
        console: where to.
        plan: the mission, for its name.
        links: whose troubles are shown as they come and go.
    """

    def __init__(self, console: Console, plan: MissionPlan, links: Sequence[Link] = ()) -> None:
        self._console = console
        self._plan = plan
        self._links = links
        self._states = [""] * len(links)
        self._live = Live(console=console, refresh_per_second=5, transient=True)
        self._next_ns = 0
        self._next_waiting_ns = _WAITING_NS

    def __enter__(self) -> FlightDisplay:
        """Begins to show."""
        if self._console.is_terminal:
            self._live.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """Ends the live line."""
        self._live.stop()

    def __call__(self, session: Session, now_ns: int) -> None:
        """Shows what has changed."""
        for note in session.take_notes():
            self._console.print(Text(f"{now_ns / 1e9:8.2f} s  {note.kind:5}  {note.text}", style=_STYLES[note.kind]))
        if now_ns < self._next_ns:
            return
        self._next_ns = now_ns + _REFRESH_NS
        self._tell_links(now_ns)
        runner = session.runner
        if self._console.is_terminal:
            self._live.update(self._line(session, now_ns))
        elif runner.phase is Phase.CONNECT and now_ns >= self._next_waiting_ns:
            # Where nothing can be drawn over, what is waited for is told now and then: an estimator takes a minute.
            self._next_waiting_ns = now_ns + _WAITING_NS
            for problem in [*link_troubles(self._links), *runner.problems]:
                self._console.print(Text(f"{now_ns / 1e9:8.2f} s  waiting: {problem}", style="yellow"))

    def _tell_links(self, now_ns: int) -> None:
        """A line for each link whose trouble is new, another, or over."""
        for number, link in enumerate(self._links):
            state = link.state
            if state != self._states[number]:
                self._states[number] = state
                words = f"{link.url}: {state or 'works'}"
                style = _STYLES["alarm" if state else "phase"]
                self._console.print(Text(f"{now_ns / 1e9:8.2f} s  link   {words}", style=style))

    def _line(self, session: Session, now_ns: int) -> Text:
        runner = session.runner
        text = Text(f"{self._plan.spec.name}  {now_ns / 1e9:6.1f} s  {runner.phase.value}", style="bold cyan")
        if runner.phase is Phase.CONNECT:
            for problem in [*link_troubles(self._links), *runner.problems]:
                text.append(f"\n  waiting: {problem}", style="yellow")
        else:
            airborne = int(runner.airborne.sum())
            text.append(f"  in the air: {airborne} of {self._plan.size}", style="default")
            text.append(f"  smallest distance {runner.figures.min_distance_m:.2f} m", style="default")
        return text
