"""Opens a flight: the one place where a plan, a purpose, links, a log and a clock become a session.

``gs fly`` and ``gs check``, dry runs, campaigns, benches and the replay all come here.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from contextlib import ExitStack, closing
from dataclasses import dataclass
from pathlib import Path
from typing import Generic, TypeVar

from groundstation.app.loop import FlightClock
from groundstation.app.session import Session
from groundstation.app.signing import FlightGate, open_gate
from groundstation.core.errors import UserError
from groundstation.links.link import LONGEST_OF_A_ROOM, LONGEST_OF_STRANGERS, Link
from groundstation.links.opening import open_link
from groundstation.mission.plan.plan import MissionPlan
from groundstation.mission.purpose import Purpose
from groundstation.mission.runner import Runner
from groundstation.records.log_file import LogFile, Sink
from groundstation.records.manifest import DRY_RUN_EPOCH_UNIX_US, Manifest, Values
from groundstation.records.recording import recording
from groundstation.records.tlog import TlogWriter

AnySession = TypeVar("AnySession", bound=Session)
MakeSession = Callable[[Runner, TlogWriter | None, FlightGate | None], AnySession]


@dataclass(frozen=True)
class LogPlan:
    """How a flight is recorded.

    Attributes:
        path: the .tlog file, judged by ``claim_log`` before.
        versions: program name to version, for the manifest.
        seed: of the emulator's noise; None for vehicles.
        dry_run: in virtual time.
        replace: a log that is there is replaced.
        through: what the log is written through.
        faults: timetable of the emulator's faults, for the manifest.
    """

    path: Path
    versions: dict[str, str]
    seed: int | None = None
    dry_run: bool = False
    replace: bool = False
    through: Callable[[LogFile], Sink] = lambda file: file
    faults: Sequence[Values] = ()


@dataclass(frozen=True)
class Flight(Generic[AnySession]):
    """A flight that has been opened.

    Attributes:
        session: steps it.
        gate: checks and makes signatures; None where no link is signed.
        links: open ones, in the order of the plan's, the room's last; empty in virtual time.
        clock: the flight's time; None in virtual time.
        log: None where nothing is recorded.
        manifest: as it is at the start; None where nothing is to be recorded.
        unlogged: why it flies without the log that was wanted, "" otherwise.
    """

    session: AnySession
    gate: FlightGate | None
    links: Sequence[Link]
    clock: FlightClock | None
    log: TlogWriter | None
    manifest: Manifest | None
    unlogged: str = ""


def open_flight(
    stack: ExitStack,
    plan: MissionPlan,
    purpose: Purpose = Purpose.FLY,
    *,
    real: bool = False,
    sign: bool = True,
    keep_times: bool = False,
    log: LogPlan | None = None,
    make: MakeSession[AnySession],
) -> Flight[AnySession]:
    """Opens a flight.

    Args:
        stack: closes what was opened.
        plan: what to fly.
        purpose: what for.
        real: over the plan's links, on the wall clock; otherwise in virtual time from 0 on.
        sign: links are signed where the mission says so; whoever flies a log again needs no key.
        keep_times: go on from the signatures' times of earlier flights and keep those of this one.
        log: how to record; None for not at all.
        make: makes the session, ``Session`` itself or a kind of it.

    Raises:
        UserError: a link, a key file or the log cannot be opened; vehicles in the air wait for no disk.
    """
    longest = [LONGEST_OF_STRANGERS] * len(plan.links) + [LONGEST_OF_A_ROOM]
    urls = list(zip(plan.all_links, longest, strict=False)) if real else []
    links = [stack.enter_context(closing(open_link(*item))) for item in urls]
    clock = FlightClock() if real else None
    epoch_unix_us = clock.epoch_unix_us if clock is not None else DRY_RUN_EPOCH_UNIX_US
    gate = open_gate(plan, epoch_unix_us, keep_times=keep_times) if sign else None
    if gate is not None:
        stack.callback(gate.close)
    writer, manifest, unlogged = None, None, ""
    if log is not None:
        manifest = Manifest(
            mission=plan.record(),
            epoch_unix_us=epoch_unix_us,
            versions=log.versions,
            seed=log.seed,
            dry_run=log.dry_run,
            take_over=purpose.in_the_air,
            gains_npz=plan.gains_npz,
            faults=log.faults,
        )
        try:
            writer = stack.enter_context(recording(log.path, manifest, replace=log.replace, through=log.through))
        except UserError as error:
            if not purpose.in_the_air:
                raise
            unlogged = str(error)
    return Flight(make(Runner(plan, 0, purpose), writer, gate), gate, links, clock, writer, manifest, unlogged)
