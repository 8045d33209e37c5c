"""Gives the autopilots the fence of a mission that asks for it, before anything is armed."""

from __future__ import annotations

from rich.text import Text

from groundstation.app.fence_talk import FenceTalk
from groundstation.app.output import Output
from groundstation.app.param_keeping import converse, lines_of
from groundstation.mission.plan.plan import MissionPlan

_SECONDS, _SECONDS_EACH = 15.0, 2.0


def give_fence(out: Output, plan: MissionPlan, *, may_set: bool) -> list[str]:
    """Looks whether the vehicles hold the mission's fence, and gives it to those that do not.

    Args:
        out: where to tell what was uploaded.
        plan: of the mission; nothing is done where it does not ask for it.
        may_set: else nothing is sent, and what is not as it should be is a problem.

    Returns:
        What is not as it should be, a line each; empty when all is well.

    Raises:
        UserError: a link or key file cannot be opened.
    """
    if not plan.spec.fence.upload:
        return []
    conversation = FenceTalk(plan, may_set=may_set)
    with lines_of(plan) as lines:
        converse(conversation, lines, _SECONDS + _SECONDS_EACH * plan.size)
    for line in conversation.uploaded():
        out.console.print(Text(line))
    return conversation.troubles()
