"""What ``gs params`` does, and what becomes of parameters that a preflight has set: kept beside the log, given back."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import ExitStack, closing, contextmanager, nullcontext
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import Protocol

from rich.table import Table
from rich.text import Text

from groundstation.app.loop import FlightClock, Interrupts, talk
from groundstation.app.output import Output
from groundstation.app.param_talk import ParamTalk
from groundstation.app.session import Session
from groundstation.app.signing import open_gate
from groundstation.core.errors import MissionFailed, UserError
from groundstation.links.link import Link
from groundstation.links.opening import open_link
from groundstation.mavlink.gate import Gate
from groundstation.mavlink.station import Outgoing
from groundstation.mission.plan.plan import MissionPlan
from groundstation.records.param_file import Param, Team, claim_params, read_params, write_params

_SHOWN = 40


def before_path(log: Path) -> Path:
    """Where parameters are kept as they were before a flight: ``flight.tlog`` -> ``flight.before.params``."""
    return log.with_suffix(".before.params")


def kept_path(plan: MissionPlan) -> Path:
    """Where ``gs params save`` keeps the parameters of a mission if nothing else is wished."""
    return Path(f"{plan.spec.name}.params")


def local_time(path: Path) -> str:
    """When a file was written, for people."""
    return f"{datetime.fromtimestamp(path.stat().st_mtime, tz=UTC).astimezone():%Y-%m-%d %H:%M:%S}"


class BeforeKeeper:
    """Keeps what a preflight has set as it was before, in a file, as soon as anything is set.

    Args:
        path: the file.

    Attributes:
        kept: how many parameters are in it.
    """

    def __init__(self, path: Path) -> None:
        self.path, self.kept = path, 0
        self._told = False

    def __call__(self, session: Session, now_ns: int) -> None:
        """Looks after a tick; vehicles stand on the ground whenever there is anything to write."""
        before = session.runner.parameters_before
        count = sum(map(len, before.values()))
        if count <= self.kept:
            return
        self.kept = count
        team = {sysid: {name: Param(*value) for name, value in of.items()} for sysid, of in before.items()}
        words = f"parameters of mission {session.runner.plan.spec.name}, as they were before its preflight set them"
        try:
            write_params(self.path, team, words)
        except UserError as error:
            if not self._told:
                self._told = True
                session.remark("alarm", f"{error}; what was set is in the log only", now_ns)


@dataclass(frozen=True)
class Lines:
    """Open links of a mission.

    Attributes:
        links: in the order of the plan's.
        clock: their time.
        gate: checks and makes signatures; None where no link is signed.
    """

    links: Sequence[Link]
    clock: FlightClock
    gate: Gate | None


@contextmanager
def lines_of(plan: MissionPlan) -> Iterator[Lines]:
    """Opens the links of a mission.

    Raises:
        UserError: a link or key file cannot be opened.
    """
    clock = FlightClock()
    with ExitStack() as stack:
        links = [stack.enter_context(closing(open_link(url))) for url in plan.links]
        gate = open_gate(plan, clock.epoch_unix_us, keep_times=True)
        if gate is not None:
            stack.callback(gate.close)
        yield Lines(links, clock, gate)


class Conversation(Protocol):
    """What is said on links before or after a flight; see ``ParamTalk``."""

    def receive(self, link: int, peer: str, data: bytes, now_ns: int) -> None:
        """Takes what came over a link."""

    def outgoing(self, now_ns: int) -> list[Outgoing]:
        """What is to be sent now."""

    @property
    def done(self) -> bool:
        """Whether there is nothing left to say."""


def converse(conversation: Conversation, lines: Lines, seconds: float) -> None:
    """Lets a conversation go on until it is done, at most for some seconds; Ctrl-C ends it."""
    gate, interrupts = lines.gate, Interrupts()

    def receive(link: int, peer: str, data: bytes, now_ns: int) -> None:
        for piece in (data,) if gate is None else gate.let_in(link, peer, data, now_ns):
            conversation.receive(link, peer, piece, now_ns)

    def outgoing(now_ns: int) -> list[Outgoing]:
        sent = conversation.outgoing(now_ns)
        return sent if gate is None else gate.sign(sent, now_ns) + gate.greetings(now_ns)

    with interrupts.listening():
        talk(
            lines.links,
            lines.clock,
            lines.clock.now_ns() / 1e9 + seconds,
            receive=receive,
            outgoing=outgoing,
            interrupts=interrupts,
            done=lambda: conversation.done,
        )


def save(out: Output, plan: MissionPlan, path: Path, seconds: float, *, force: bool) -> None:
    """Reads all parameters of a mission's vehicles and keeps them in a file.

    Raises:
        UserError: a link, or the file.
        MissionFailed: a vehicle has not told all of them; what was told is kept.
    """
    claim_params(path, force=force)  # before vehicles are asked, which takes a while
    conversation = ParamTalk(plan)
    with lines_of(plan) as lines:
        converse(conversation, lines, seconds)
    team = conversation.team()
    if team:
        if write_params(path, team, f"all parameters of mission {plan.spec.name}", force=force):
            out.console.print(Text(f"replaces {path}"))
        counts = ", ".join(f"vehicle {sysid}: {len(params)}" for sysid, params in sorted(team.items()))
        out.console.print(Text(f"kept in {path}: {counts}"))
    troubles = conversation.troubles()
    counted = {str(sysid): len(params) for sysid, params in team.items()}
    out.result({"file": str(path) if team else None, "vehicles": counted, "problems": troubles})
    _fail(troubles)


def diff(out: Output, plan: MissionPlan, path: Path, seconds: float) -> None:
    """Tells which parameters of a file are different in the vehicles.

    Raises:
        UserError: a link, or the file.
        MissionFailed: some are, or could not be read.
    """
    team = _of_mission(plan, path)
    conversation = ParamTalk(plan, names={sysid: list(params) for sysid, params in team.items()})
    with lines_of(plan) as lines:
        converse(conversation, lines, seconds)
    now = conversation.team()
    rows = [
        (sysid, name, param, now[sysid][name])
        for sysid, params in sorted(team.items())
        for name, param in sorted(params.items())
        if name in now.get(sysid, {}) and not now[sysid][name].same(param)
    ]
    _show(out, ("vehicle", "parameter", "in the file", "in the vehicle"), rows)
    troubles = conversation.troubles()
    out.result({"file": str(path), "differences": _plain(rows), "problems": troubles})
    count = f"{len(rows)} parameter{' differs' if len(rows) == 1 else 's differ'}"
    differ = [f"{count}; gs params restore --file {path} gives back what the file has"] if rows else []
    _fail([*differ, *troubles])


def restore(out: Output, plan: MissionPlan, path: Path, seconds: float, *, open_lines: Lines | None = None) -> None:
    """Gives vehicles the parameters of a file, and reads back what was set; nothing in one that is armed.

    Args:
        out: where to tell.
        plan: of the mission.
        path: the file.
        seconds: how long to try.
        open_lines: of a flight that has just ended, which answers in JSON itself; opened here when None.

    Raises:
        UserError: a link, or the file.
        MissionFailed: something could not be set.
    """
    conversation = ParamTalk(plan, wanted=_of_mission(plan, path))
    with nullcontext(open_lines) if open_lines is not None else lines_of(plan) as lines:
        converse(conversation, lines, seconds)
    rows = [
        (sysid, name, before, after)
        for sysid, params in sorted(conversation.changed().items())
        for name, (before, after) in sorted(params.items())
    ]
    _show(out, ("vehicle", "parameter", "was", "is"), rows)
    troubles = conversation.troubles()
    if not rows and not troubles:
        out.console.print(Text(f"nothing to give back: the vehicles are as {path} says"))
    if open_lines is None:
        out.result({"file": str(path), "set": _plain(rows), "problems": troubles})
    _fail(troubles)


def offer_back(
    out: Output, plan: MissionPlan, keeper: BeforeKeeper, lines: Lines | None = None, seconds: float = 30.0
) -> list[str]:
    """After a flight or a check: gives back what its preflight has set, or says how that is done.

    Args:
        out: where to tell.
        plan: of the mission.
        keeper: what is kept.
        lines: give it back at once, over these; say how it is done when None.
        seconds: how long to try.

    Returns:
        What could not be given back, a line each.
    """
    if not keeper.kept:
        return []
    if lines is not None:
        try:
            restore(out, plan, keeper.path, seconds, open_lines=lines)
        except UserError as error:
            return [f"parameters were not all given back: {error}"]
        return []
    out.console.print(
        Text(
            f"{keeper.kept} parameters were set; as they were before: {keeper.path}. Give them back with:"
            f" gs params restore --mission {plan.source} --file {keeper.path}"
        )
    )
    return []


def _of_mission(plan: MissionPlan, path: Path) -> Team:
    """A file's parameters, as far as they are of this mission's vehicles.

    Raises:
        UserError: none of them is.
    """
    team = read_params(path)
    ids = [vehicle.id for vehicle in plan.spec.vehicles]
    ours = {sysid: params for sysid, params in team.items() if sysid in ids}
    if not ours:
        raise UserError(
            f"{path}: is of vehicles {', '.join(map(str, sorted(team)))}, the mission has {', '.join(map(str, ids))};"
            " name another file"
        )
    return ours


def _show(out: Output, heads: tuple[str, ...], rows: list[tuple[int, str, Param, Param]]) -> None:
    table = Table(*heads)
    for sysid, name, first, second in rows[:_SHOWN]:
        table.add_row(str(sysid), name, first.text(), second.text())
    if rows:
        out.console.print(table)
    if len(rows) > _SHOWN:
        out.console.print(Text(f"and {len(rows) - _SHOWN} more; --json tells all"))


def _plain(rows: list[tuple[int, str, Param, Param]]) -> list[dict[str, object]]:
    return [
        {"vehicle": sysid, "parameter": name, "first": first.value, "second": second.value}
        for sysid, name, first, second in rows
    ]


def _fail(lines: list[str]) -> None:
    if lines:
        raise MissionFailed("\n".join(lines))
