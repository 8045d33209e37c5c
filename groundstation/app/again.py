"""A recorded flight through the object that flew it, once more: as it was flown, or with something else about it."""

from __future__ import annotations

from contextlib import ExitStack
from pathlib import Path

from groundstation.app.opening import open_flight
from groundstation.app.session import Session
from groundstation.core.errors import UserError
from groundstation.mavlink.blocks import Arrivals
from groundstation.mavlink.station import Outgoing
from groundstation.mission.plan.plan import MissionPlan
from groundstation.mission.purpose import Purpose
from groundstation.records.manifest import Manifest, manifest_beside
from groundstation.records.notes import Noise, Operator, Received, Record, Tick


def mission_of(log: Path) -> tuple[Manifest, bytes]:
    """The manifest of a log that can be flown again, and its gains file.

    Raises:
        UserError: there is none, or no gains in it.
    """
    manifest = manifest_beside(log)
    if manifest is None or manifest.gains_npz is None:
        raise UserError(
            f"{log}: no manifest with a mission and gains beside it; only logs of `gs fly` can be verified,"
            " keep the .manifest.json together with the .tlog"
        )
    return manifest, manifest.gains_npz


class Again:
    """One mission that is given what was recorded, in the order of the log.

    Args:
        plan: what is flown.
        take_over: whether vehicles that were in the air were taken over.

    Attributes:
        runner: flies it.
    """

    def __init__(self, plan: MissionPlan, *, take_over: bool) -> None:
        purpose = Purpose.TAKE_OVER if take_over else Purpose.FLY
        self.runner = open_flight(ExitStack(), plan, purpose, sign=False, make=Session).session.runner
        self._arrivals = Arrivals()

    def take(self, record: Record) -> list[Outgoing] | None:
        """Takes a record; returns what a tick sends, None for whatever is no tick."""
        if isinstance(record, Received):
            self._arrivals.add(record.link, record.peer, record.frame.raw, record.t_ns)
            return None
        if len(self._arrivals):
            self.runner.take_block(self._arrivals.block())
        if isinstance(record, Tick):
            return self.runner.step(record.t_ns)
        if isinstance(record, Noise):
            self.runner.take(record.link, record.peer, (record.data,), record.t_ns)
        elif isinstance(record, Operator):
            self.runner.operator(record.text)
        return None
