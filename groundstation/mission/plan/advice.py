"""What people should know of a mission's design and tuning before it flies: it may fly, but not well."""

from __future__ import annotations

import numpy as np

from groundstation.core.control import ScaleFunction, fitting_scale_gain, rate_for_auto_gain_1_s
from groundstation.mission.plan.plan import MissionPlan
from groundstation.mission.plan.profiles import bearable_gain
from groundstation.mission.plan.stages import Stage

_ZERO_1_S = 5e-6  # a design whose slowest mode is not above 1e-5 is refused
_SETTLED = 3.0  # time constants until a twentieth of an error is left
_MUCH = 2.0
_HALF_AROUND_DEG = 180.0


def advice(plan: MissionPlan) -> list[str]:
    """A line for each formation that is weakly held or badly tuned, with what to change; empty where all is well.

    Args:
        plan: a mission that has passed its checks.
    """
    lines: list[str] = []
    for number, stage in enumerate(plan.stages):
        if stage.shape.formed:
            timeouts = [
                step.form.timeout_s
                for step, of in zip(plan.spec.steps, plan.stage_of_step, strict=True)
                if step.form is not None and of == number
            ]
            lines += [*_weak(stage, min(timeouts, default=np.inf)), *_tuned(plan, stage), *_unseen(plan, stage)]
    return [f"{plan.source}: {line}" for line in dict.fromkeys(lines)]


def slowest_mode_1_s(stage: Stage) -> float:
    """The slowest of the motions that die out under the gains alone, 1/s; infinite where there is none."""
    slowest = np.inf
    for block in (stage.shape.gains.xy, stage.shape.gains.z):
        off = np.where(np.eye(len(block), dtype=np.bool_), 0.0, block)
        rates = np.abs(np.linalg.eigvalsh(off - np.diag(off.sum(axis=1))))
        slowest = min(slowest, float(rates[rates > _ZERO_1_S].min(initial=np.inf)))
    return slowest


def _weak(stage: Stage, timeout_s: float) -> list[str]:
    mode_1_s = slowest_mode_1_s(stage)
    needs_s = _SETTLED / (stage.control_gain * mode_1_s)
    if needs_s <= timeout_s:
        return []
    return [
        f"{stage.key}: {stage.formation.name} is held weakly, its slowest mode is {mode_1_s:.2g} 1/s: with k ="
        f" {stage.control_gain:.2g} a twentieth of an error is left after {needs_s:.3g} s, timeout_s is {timeout_s:g}"
        " s; give it more edges (gs design --suggest-graph balanced)"
    ]


def _unseen(plan: MissionPlan, stage: Stage) -> list[str]:
    """Neighbours that would lose each other in the very formation."""
    sensing, shape = plan.spec.sensing, stage.formation
    if sensing is None or not shape.edges:
        return []
    lines = []
    longest_m = max(float(shape.distances_m[i, j]) for i, j in shape.edges)
    if sensing.range_m is not None and sensing.range_m < longest_m:
        lines.append(
            f"sensing.range_m: {sensing.range_m:g} m is less than the longest edge of {shape.name}, {longest_m:.2f} m:"
            " its ends lose each other in the formation; see farther, or design the formation with shorter edges"
        )
    if sensing.field_of_view_deg <= _HALF_AROUND_DEG and sensing.share == "both":
        lines.append(
            f"sensing.field_of_view_deg: with {sensing.field_of_view_deg:g} and share: both two vehicles that face"
            " one way never see each other; write share: either, or see more"
        )
    return lines


def _tuned(plan: MissionPlan, stage: Stage) -> list[str]:
    shape, profile, spec = stage.shape, plan.profile, plan.spec

    def rate_1_s(scale: ScaleFunction) -> float:
        return rate_for_auto_gain_1_s(shape.formation, shape.gains, scale, stage.upright_1_s)

    def gain(scale: ScaleFunction) -> float:
        formation, gains, upright_1_s = shape.formation, shape.gains, stage.upright_1_s
        return bearable_gain(
            formation, gains, scale, upright_1_s, profile=profile, rate_hz=spec.rate_hz, lead_s=plan.lead_s
        )

    with_f, without = rate_1_s(stage.scale), rate_1_s(ScaleFunction("free"))
    if spec.gain != "auto":
        fits = gain(stage.scale)
        if spec.gain <= _MUCH * fits:
            return []
        return [
            f"gain: {spec.gain:g} is {spec.gain / fits:.1f} times what lag and delay of {profile.name} allow"
            f" ({fits:.2g}): the team may swing; leave it out, or make it smaller"
        ]
    if stage.scale.kind == "free" or without <= 0.0 or with_f <= _MUCH * without:
        return []
    before = gain(ScaleFunction("free"))
    better = fitting_scale_gain(shape.formation, shape.gains, stage.scale.kind, stage.upright_1_s)
    return [
        f"{stage.key}: f of (14) with scale.gain {stage.scale.gain:g} is too strong for the distances of"
        f" {stage.formation.name}: k falls from {before:.2g} to {gain(stage.scale):.2g} and the team forms that much"
        f" later; leave scale.gain out, it is then {better:.2g}"
    ]
