"""The formations of a mission, one after the other, and whether there is room for each.

A mission names one formation at its top; a ``form`` step may name another, or another size or law. A stage is a
formation with its gains and its law; ``move`` steps change its size and place. Everything that can be known before the
flight is judged here: shortest distances at every size, speed, and the fence as far as the pads tell where the team
will be. Refuses to read files; ``plan`` does.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from groundstation.core.assignment import assign_roles
from groundstation.core.control import ScaleFunction, fitting_scale_gain
from groundstation.core.errors import UserError
from groundstation.core.formation import Formation, Gains
from groundstation.core.metrics import near_pairs
from groundstation.core.motion import MovePlan
from groundstation.core.regions import SafetyRegion
from groundstation.core.types import FloatArray, IntArray
from groundstation.mission.plan.positioning import all_offsets, check_radius
from groundstation.mission.plan.profiles import VehicleProfile, bearable_gain
from groundstation.mission.plan.schema import MissionSpec, ScaleSpec
from groundstation.mission.plan.timed import timed


@dataclass(frozen=True)
class Shape:
    """A formation with its gains, as read.

    Attributes:
        formation: points and sensing graph, ENU, at the size to be flown.
        gains: checked against it.
        gains_npz: the gains file that they came from, for the record.
    """

    formation: Formation
    gains: Gains
    gains_npz: bytes

    @property
    def formed(self) -> bool:
        """Whether it is a formation at all; False for a mission without one."""
        return bool(self.gains_npz)


def no_formation(spec: MissionSpec) -> Shape:
    """Stands where a mission names no formation: everybody's pad, and nobody sees anybody."""
    points = np.array([vehicle.pad_m for vehicle in spec.vehicles], dtype=np.float64) * [1.0, 1.0, 0.0]
    n = len(points)
    nothing = Gains(xy=np.zeros((n, n), dtype=np.complex128), z=np.zeros((n, n)))
    return Shape(Formation(name="none", points_enu_m=points, edges=()), nothing, b"")


@dataclass(frozen=True)
class Stage:
    """A formation of a mission and how it is formed.

    Attributes:
        key: where the mission names it, for messages.
        shape: points, graph, gains.
        control_gain: k that multiplies (14).
        scale: f of (14).
        upright_1_s: weight of the term that keeps the formation right side up.
        assignment: auto or fixed.
        swaps: vehicles that lock each other in may exchange their roles.
    """

    key: str
    shape: Shape
    control_gain: float
    scale: ScaleFunction
    upright_1_s: float
    assignment: str
    swaps: bool

    @property
    def formation(self) -> Formation:
        """Points and sensing graph."""
        return self.shape.formation


@dataclass(frozen=True)
class FormationPlan:
    """The formations of a mission and its moves.

    Attributes:
        stages: the formations with their gains and laws, the one at the top of the mission first.
        stage_of_step: stage under way in each step.
        moves: ``move`` steps by their number.
        places_enu_m: where the middle of the team goes in steps that fly to places, by their number, shape (k, 3).
        room_m: what the formations leave between two safety regions at least, at any size they are given.
    """

    stages: tuple[Stage, ...]
    stage_of_step: tuple[int, ...]
    moves: Mapping[int, MovePlan]
    places_enu_m: Mapping[int, FloatArray]
    room_m: float

    @property
    def formation(self) -> Formation:
        """The formation at the top of the mission: points and sensing graph, ENU."""
        return self.stages[0].formation

    @property
    def gains(self) -> Gains:
        """Its gains."""
        return self.stages[0].shape.gains

    @property
    def gains_npz(self) -> bytes:
        """The gains file that they came from, for the record."""
        return self.stages[0].shape.gains_npz

    @property
    def control_gain(self) -> float:
        """What multiplies (14) for it: k."""
        return self.stages[0].control_gain

    @property
    def scale(self) -> ScaleFunction:
        """The map f of (14) for it."""
        return self.stages[0].scale

    @property
    def upright_1_s(self) -> float:
        """Weight of the term that keeps it right side up, see ``formation_control``."""
        return self.stages[0].upright_1_s


def make_stage(
    spec: MissionSpec,
    shape: Shape,
    profile: VehicleProfile,
    lead_s: float,
    *,
    source: str,
    key: str = "formation",
    scale: ScaleSpec | None = None,
    assignment: str | None = None,
) -> Stage:
    """Puts a stage together; ``scale`` and ``assignment`` are the mission's own where not given.

    Raises:
        UserError: nothing would pull the vehicles; names ``source``, the mission's file, and the key.
    """
    law = scale or spec.scale
    if not shape.formed:
        return Stage(key, shape, 1.0, ScaleFunction(), 0.0, assignment="fixed", swaps=False)
    # The upright term fixes the vertical scale, which a free scale leaves to the start.
    upright_1_s = 0.0 if law.kind == "free" else spec.upright_1_s
    gain = law.gain
    if gain == "auto":
        gain = fitting_scale_gain(shape.formation, shape.gains, law.kind, upright_1_s)
    function = ScaleFunction(kind=law.kind, gain=gain)
    try:
        automatic = bearable_gain(
            shape.formation,
            shape.gains,
            function,
            upright_1_s,
            profile=profile,
            rate_hz=spec.rate_hz,
            lead_s=lead_s,
        )
    except ValueError as error:
        at = "" if key == "formation" or scale is None else f"{key}."
        strength = "" if law.kind == "free" else f", gain {gain:g}"
        raise UserError(
            f"{source}: {at}scale: kind {law.kind}{strength} with formation {shape.formation.name} of"
            f" {shape.formation.size}: {error}; use kind: arctan with its own gain (auto)"
        ) from None
    chosen = assignment or spec.assignment
    return Stage(
        key=key,
        shape=shape,
        control_gain=automatic if spec.gain == "auto" else spec.gain,
        scale=function,
        upright_1_s=upright_1_s,
        assignment=chosen,
        swaps=chosen == "auto" if spec.role_swaps == "auto" else spec.role_swaps,
    )


def make_stages(
    spec: MissionSpec,
    first: Shape,
    others: Mapping[int, Shape],
    profile: VehicleProfile,
    lead_s: float,
    *,
    source: str,
) -> tuple[tuple[Stage, ...], tuple[int, ...]]:
    """Puts all stages together.

    Args:
        spec: the mission.
        first: the formation named at its top.
        others: formations of ``form`` steps that name their own, by number of the step.
        profile: the slowest vehicle.
        lead_s: how far ahead motion counts.
        source: the mission's file, for messages.

    Returns:
        The stages, that of the top first, and the stage under way in each step.
    """
    stages = [make_stage(spec, first, profile, lead_s, source=source)]
    of_step, current = [], 0
    for number, step in enumerate(spec.steps):
        form = step.form
        if form is not None:
            current = 0
            if number in others or form.scale is not None or form.assignment is not None:
                current = len(stages)
                stages.append(
                    make_stage(
                        spec,
                        others.get(number, first),
                        profile,
                        lead_s,
                        source=source,
                        key=f"steps[{number}].{step.kind}",
                        scale=form.scale,
                        assignment=form.assignment,
                    )
                )
        of_step.append(current)
    return tuple(stages), tuple(of_step)


def check_order(spec: MissionSpec, source: str) -> None:
    """Refuses steps that have nothing to go on from.

    Raises:
        UserError: with the step.
    """
    formed = led = False
    for number, step in enumerate(spec.steps):
        key = f"{source}: steps[{number}]"
        if step.form is not None:
            formed, led = True, False
            if spec.formation is None:
                raise UserError(f"{source}: formation: is missing, give it a value: steps[{number}] forms one")
        elif not step.formed:
            formed = False
        elif not formed and number == 0:
            raise UserError(
                f"{key}: the first step has to be `form`, or to fly to places; there is nothing to {step.kind}"
            )
        elif not formed:
            raise UserError(
                f"{key}: {step.kind} is of a formation, and steps[{number - 1}] leaves it; put a `form` step before it,"
                " or hover"
            )
        elif step.lead is not None:
            led = True
        elif step.move is not None and led:
            raise UserError(
                f"{key}: nobody knows before the flight where and how large the operator leaves the formation; put a"
                " `form` step before it"
            )


def shortest_m(formation: Formation) -> float:
    """Shortest distance between two points of a formation."""
    first, second = np.triu_indices(formation.size, 1)
    points = formation.points_enu_m
    return float(np.linalg.norm(points[first] - points[second], axis=1).min())


def roles_for(stage: Stage, pos_enu_m: FloatArray) -> IntArray:
    """Role per vehicle, shape (n,), for vehicles that stand or fly at given places, shape (n, 3)."""
    formation = stage.formation
    if stage.assignment != "auto":
        return np.arange(formation.size)
    if stage.scale.kind == "free":
        sizes = [float(np.linalg.norm(item - item.mean(axis=0))) for item in (pos_enu_m, formation.points_enu_m)]
        formation = replace(formation, points_enu_m=formation.points_enu_m * sizes[0] / max(sizes[1], 1e-9))
    return assign_roles(pos_enu_m, formation).role_of_agent


def check_clearance(
    region: SafetyRegion, points_m: FloatArray, names: tuple[str, str], remedy: str, source: str
) -> None:
    """Refuses points inside of each other's upright region; where distance alone counts, that is judged elsewhere.

    Args:
        region: the safety region.
        points_m: shape (n, 3).
        names: of the later and the earlier of two points, with a place for their number.
        remedy: what can be done, besides a smaller region.
        source: the mission's name, and the key.

    Raises:
        UserError: with the two points.
    """
    if region.by_distance:
        return
    for i, j in np.transpose(near_pairs(points_m, 1.01 * region.reach_m(0.0))).tolist():
        offset = points_m[j] - points_m[i]
        if region.clearance(offset) <= 1.0:
            raise UserError(
                f"{source}: {names[0].format(j)}: {math.hypot(*offset[:2]):.3g} m beside and {abs(offset[2]):.3g} m"
                f" above or below {names[1].format(i)}, inside of the {region.name} of"
                f" {region.size_words()}; {remedy} or make the region smaller"
            )


def check_shape(
    spec: MissionSpec, formation: Formation, region: SafetyRegion, *, floor_m: float, source: str, key: str
) -> None:
    """Refuses a formation of the wrong size, too dense for r, or too large for the fence.

    Raises:
        UserError: with key, value, limit and remedy.
    """
    at = "" if key == "formation" else f"{key}: "
    if len(spec.vehicles) != formation.size:
        raise UserError(
            f"{source}: {at}vehicles: {len(spec.vehicles)} listed, formation {formation.name} has {formation.size}"
            " points; list one vehicle for each point"
        )
    names = "formation.points[{}]", "points[{}]"
    check_clearance(region, formation.points_enu_m, names, "scale the formation up", f"{source}: {at}".rstrip(": "))
    radius = spec.avoidance.radius_m
    for i, j in np.transpose(near_pairs(formation.points_enu_m, 1.01 * radius)).tolist():
        distance = float(np.linalg.norm(formation.points_enu_m[i] - formation.points_enu_m[j]))
        if distance <= radius:
            raise UserError(
                f"{source}: {at}formation.points[{j}]: {distance:.3g} m from points[{i}], minimum is more than"
                f" {radius:g} m (avoidance.radius_m); scale the formation up or lower the radius"
            )
    low, high = np.array(spec.fence.min_m), np.array(spec.fence.max_m)
    for axis, letter in enumerate("xyz"):
        extent = float(np.ptp(formation.points_enu_m[:, axis])) if axis == 2 else _widest(formation)
        room = float(high[axis] - (max(low[axis], floor_m) if axis == 2 else low[axis]))
        if extent > room:
            raise UserError(
                f"{source}: {at}fence: {room:.3g} m of room along {letter}, formation {formation.name} needs"
                f" {extent:.3g} m; enlarge the fence or scale the formation down"
            )


def _widest(formation: Formation) -> float:
    horizontal = formation.points_enu_m[:, :2]
    return float(np.linalg.norm(horizontal[:, None] - horizontal[None, :], axis=-1).max())


def plan_moves(
    spec: MissionSpec,
    stages: Sequence[Stage],
    stage_of_step: Sequence[int],
    *,
    region: SafetyRegion,
    pads_enu_m: FloatArray,
    floor_m: float,
    acceleration_limit_m_s2: float,
    position_error_m: float,
    positioning: str,
    source: str,
) -> tuple[dict[int, MovePlan], dict[int, FloatArray], float]:
    """Judges every ``move`` step, gives those without a duration the shortest one, and judges places flown to.

    The centre of the team is taken to stay where the takeoff leaves it, above the middle of the pads, and as high as
    the floor demands; the law does not move it. In flight every move is judged again by where the team is.

    Returns:
        The moves and the places by number of their step, and what the formations leave between two safety regions.

    Raises:
        UserError: with key, value, limit and remedy.
    """
    moves: dict[int, MovePlan] = {}
    flown_to: dict[int, FloatArray] = {}
    together, turned = pads_enu_m - pads_enu_m.mean(axis=0), False  # how everybody is around the middle
    places = _places(spec, stages, stage_of_step) | {"pads": pads_enu_m}
    size, least = 1.0, min(region.room_m(all_offsets(stage.formation.points_enu_m)) for stage in stages)
    centre = pads_enu_m.mean(axis=0) + np.array([0.0, 0.0, spec.takeoff.height_m])
    for number, step in enumerate(spec.steps):
        stage = stages[stage_of_step[number]]
        points = stage.formation.points_enu_m - stage.formation.points_enu_m.mean(axis=0)
        if step.form is not None:
            size = 1.0
            centre[2] = max(centre[2], floor_m - float(points[:, 2].min()))
            together, turned = points, True
        elif step.move is not None:
            key = f"{source}: steps[{number}].{step.kind}"
            move = timed(step.move, size * points, spec.speed_limit_m_s, acceleration_limit_m_s2, key)
            moves[number] = move
            size *= move.scale
            if stage.scale.kind != "free":
                least = min(least, region.room_m(all_offsets(size * points)))
                _check_smallest(spec, size * shortest_m(stage.formation), move.scale, f"{key}.scale")
                check_radius(
                    f"{key}.scale",
                    {f"formation {stage.formation.name}": size * points},
                    region=region,
                    position_error_m=position_error_m,
                    positioning=positioning,
                    others=places,
                )
            centre = centre + move.by_enu_m
            _check_fence(spec, size * points, centre, floor_m, key)
            together = size * points
        elif step.lead is not None:
            together = step.lead.largest * points
            if stage.scale.kind != "free":
                key = f"{source}: steps[{number}].{step.kind}.smallest"
                smallest = step.lead.smallest * points
                least = min(least, region.room_m(all_offsets(smallest)))
                _check_smallest(spec, step.lead.smallest * shortest_m(stage.formation), step.lead.smallest, key)
                check_radius(
                    key,
                    {f"formation {stage.formation.name}": smallest},
                    region=region,
                    position_error_m=position_error_m,
                    positioning=positioning,
                    others=places,
                )
        elif not step.formed:
            flown_to[number] = np.array(step.places_m(), dtype=np.float64).reshape(-1, 3)
            for place_m in flown_to[number]:
                key = f"{source}: steps[{number}].{step.kind}"
                _check_fence(spec, together, place_m, floor_m, key, told=True, turned=turned)
                centre = place_m.copy()
    return moves, flown_to, least


def _places(spec: MissionSpec, stages: Sequence[Stage], stage_of_step: Sequence[int]) -> dict[str, FloatArray]:
    """Points of the formations in every size that the moves give them, by number of the step."""
    places: dict[str, FloatArray] = {}
    size = 1.0
    for number, step in enumerate(spec.steps):
        stage = stages[stage_of_step[number]]
        size = 1.0 if step.form is not None else size * (step.move.scale if step.move is not None else 1.0)
        if stage.scale.kind != "free" or step.form is not None:
            smallest = size if step.lead is None else step.lead.smallest
            places[f"steps[{number}]"] = smallest * stage.formation.points_enu_m
    return places


def _check_smallest(spec: MissionSpec, shortest: float, scale: float, key: str) -> None:
    """Refuses a size at which two points come within r."""
    radius = spec.avoidance.radius_m
    if shortest <= radius:
        raise UserError(
            f"{key}: {scale:g} brings two points to {shortest:.3g} m, minimum is more than"
            f" {radius:g} m (avoidance.radius_m); scale by more, or lower the radius"
        )


def _check_fence(
    spec: MissionSpec,
    points_m: FloatArray,
    centre_m: FloatArray,
    floor_m: float,
    key: str,
    *,
    told: bool = False,
    turned: bool = True,
) -> None:
    """Refuses a move that ends outside the fence.

    Args:
        spec: with the fence.
        points_m: everybody from the middle, shape (n, 3).
        centre_m: where the middle ends.
        floor_m: lowest height.
        key: for messages.
        told: its end is a place, and no way from where the team is expected.
        turned: the team may have any heading.

    Raises:
        UserError: with axis and wall.
    """
    guess = "" if told else " (the team is expected above the middle of its pads)"
    low, high = np.array(spec.fence.min_m), np.array(spec.fence.max_m)
    low[2] = max(low[2], floor_m)
    reach_low, reach_high = -points_m.min(axis=0), points_m.max(axis=0)
    if turned:
        reach_low[:2] = reach_high[:2] = np.linalg.norm(points_m[:, :2], axis=1).max()
    for axis, letter in enumerate("xyz"):
        for value, wall, sign in (
            (centre_m[axis] - reach_low[axis], low[axis], -1.0),
            (centre_m[axis] + reach_high[axis], high[axis], 1.0),
        ):
            if sign * (value - wall) > 1e-6:
                name = "min_altitude_m or fence.min_m" if axis == 2 and sign < 0.0 else "fence"
                raise UserError(
                    f"{key}: takes the team to {letter} = {value:.3g} m{guess},"
                    f" {name} ends at {wall:g} m; stay further inside, or enlarge the fence"
                )
