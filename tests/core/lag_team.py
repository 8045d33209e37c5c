"""A team of vehicles that lag, for the tests of the control chain; independent of the emulator.

Each vehicle is a first-order velocity lag with an acceleration limit and a command delay, tilted by what it
accelerates; positions and velocities are measured with noise. Times in seconds, positions NED in metres.
"""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass, field

import numpy as np
from scipy.spatial.transform import Rotation

from groundstation.core import avoidance, control, damper, frames, gridlock, limits, metrics, places, regions
from groundstation.core.assignment import assign_roles
from groundstation.core.formation import Formation, Gains
from groundstation.core.types import BoolArray, FloatArray, IntArray
from groundstation.core.views import LocalViews, local_views

GRAVITY_M_S2 = 9.81


def cube(side_m: float = 1.0) -> Formation:
    """Cube with its own 12 edges, roles 0..3 around the bottom, 4..7 above them."""
    square = [(0, 0), (1, 0), (1, 1), (0, 1)]
    points = np.array([[x, y, z] for z in (0, 1) for x, y in square], dtype=np.float64) * side_m
    ring = [(0, 1), (1, 2), (2, 3), (0, 3)]
    edges = ring + [(i + 4, j + 4) for i, j in ring] + [(i, i + 4) for i in range(4)]
    return Formation("cube", points, tuple(sorted(edges)))


def cube_gains() -> Gains:
    """Gains of the cube with nonzero eigenvalues in [-10, -5], in closed form.

    A ring of four with weight w = d (1 - i) / 2 has the kernel {1, x + iy} of a square and twice the eigenvalue -2d;
    verticals of weight v add 0 or -2v. In z a ring of weight e has eigenvalues 0, -2e, -2e, -4e. d = v = e = 2.5.
    """
    shift = np.roll(np.eye(4), 1, axis=1)
    weight = 1.25 - 1.25j
    ring_xy = weight * shift + np.conj(weight) * shift.T - 2.5 * np.eye(4)
    ring_z = 2.5 * (shift + shift.T) - 5.0 * np.eye(4)
    upright = 2.5 * (np.array([[0.0, 1.0], [1.0, 0.0]]) - np.eye(2))
    return Gains(
        xy=np.kron(np.eye(2), ring_xy) + np.kron(upright, np.eye(4)),
        z=np.asarray(np.kron(np.eye(2), ring_z), dtype=np.float64),
    )


def random_start(
    rng: np.random.Generator, n: int, room_m: float, apart_m: float, *, planar: bool, size: int = 3
) -> FloatArray:
    """Positions NED at random, at least ``apart_m`` from each other, at height 0.5 m or anywhere in the room."""
    while True:
        chosen: list[FloatArray] = []
        for _ in range(2000):
            point = rng.uniform(-room_m / 2, room_m / 2, size)
            point[2] = -0.5 if planar else -0.3 - (point[2] + room_m / 2)
            if all(np.linalg.norm(point - other) >= apart_m for other in chosen):
                chosen.append(point)
            if len(chosen) == n:
                return np.array(chosen)


@dataclass(frozen=True)
class Profile:
    """What a kind of vehicle does. ``delay_s`` is all between measurement and effect."""

    tau_s: float
    delay_s: float
    accel_m_s2: float
    pos_noise_m: float = 0.01
    vel_noise_m_s: float = 0.02
    bias_m: float = 0.0  # slowly wandering position error, on top
    bias_tau_s: float = 2.0  # how long that lasts
    loss: float = 0.0  # share of reports, and of commands, that are lost
    tilt_lag_s: float = 0.0  # the acceleration itself follows with this lag (the attitude loop)


CRAZYFLIE = Profile(tau_s=0.2, delay_s=0.05, accel_m_s2=4.0)
PX4_QUAD = Profile(tau_s=1.0, delay_s=0.1, accel_m_s2=3.0)
KINEMATIC = Profile(tau_s=0.0, delay_s=0.0, accel_m_s2=np.inf, pos_noise_m=0.0, vel_noise_m_s=0.0)


@dataclass(frozen=True)
class Chain:
    """The control chain under test."""

    formation: Formation
    gains: Gains
    control_gain: float
    radius_m: float = 0.45
    activation_m: float = 0.5
    speed_m_s: float = 0.5
    accel_m_s2: float = 4.0
    tick_s: float = 0.02
    lead_s: float = 0.0
    upright_1_s: float = 0.0
    scale: control.ScaleFunction = field(default_factory=control.ScaleFunction)
    rotate: bool = True
    damper: damper.DamperParams | None = None
    swaps: bool = False
    detours: bool = False
    tolerance_m: float = 0.05
    shape: str = "sphere"
    half_height_m: float = 0.45
    widen: bool = False
    filter_s: float = 0.0  # positions are carried on by velocities and follow reports with this time constant

    @property
    def region(self) -> regions.SafetyRegion:
        return regions.build_region(
            self.shape, self.radius_m, max(self.activation_m, self.radius_m), self.half_height_m
        )


@dataclass(frozen=True)
class Flight:
    """What came out. ``formed_s`` is when all distances got within 5 cm to stay so for a second; NaN if never.

    ``min_clearance`` is the smallest one in the norm of the safety region.
    """

    formed_s: float
    min_distance_m: float
    error_m: float
    pos_ned_m: FloatArray
    roles: IntArray
    blocked_ticks: int
    infeasible_ticks: int
    min_clearance: float
    gridlocks: int = 0
    swaps: tuple[tuple[float, int, int], ...] = ()
    detours: int = 0


def damper_for(profile: Profile, chain: Chain, margin_m: float) -> damper.DamperParams:
    return damper.DamperParams(
        radius_m=chain.radius_m,
        margin_m=margin_m,
        lag_s=profile.tau_s,
        delay_s=profile.delay_s,
        tick_s=chain.tick_s,
        speed_limit_m_s=chain.speed_m_s,
        accel_limit_m_s2=profile.accel_m_s2,
        region=chain.region,
    )


def with_damper(profile: Profile, chain: Chain, margin_m: float) -> Chain:
    return dataclasses.replace(chain, damper=damper_for(profile, chain, margin_m))


class WayOut:
    """Gridlocks resolved as `mission.formation_flight` does it."""

    def __init__(self, chain: Chain, profile: Profile) -> None:
        margin_m = 0.0 if chain.damper is None else chain.damper.margin_m
        params = gridlock.GridlockParams(
            chain.speed_m_s, chain.radius_m + margin_m, chain.tick_s, profile.tau_s + profile.delay_s
        )
        self.locks = gridlock.Gridlocks(chain.formation.size, params)
        self.count, self.sent = 0, 0
        self.swaps: list[tuple[float, int, int]] = []
        self._chain = chain

    def wish(self, views: LocalViews, quat: FloatArray, wish_flu_m_s: FloatArray) -> FloatArray:
        rot = frames.rot_ned_from_flu(quat)
        detour = self.locks.wishes(frames.enu_from_ned(frames.rotate(rot, views.vel_flu_m_s)))
        turned = frames.rotate_back(rot, frames.ned_from_enu(detour))
        return np.where(np.isfinite(turned), turned, wish_flu_m_s)

    def roles(
        self,
        *,
        now_s: float,
        views: LocalViews,
        quat: FloatArray,
        wish_flu_m_s: FloatArray,
        in_the_way: BoolArray,
        roles: IntArray,
    ) -> IntArray:
        """The roles from now on."""
        rot, n = frames.rot_ned_from_flu(quat), len(roles)
        sensed = gridlock.Sensed(
            rel_m=frames.enu_from_ned(frames.rotate(rot[:, None], views.rel_pos_flu_m)),
            visible=views.visible,
            vel_m_s=frames.enu_from_ned(frames.rotate(rot, views.vel_flu_m_s)),
            wish_m_s=frames.enu_from_ned(frames.rotate(rot, wish_flu_m_s)),
            in_the_way=in_the_way,
            low_m=np.full((n, 3), -10.0),
            high_m=np.full((n, 3), 10.0),
        )
        nobody = np.zeros(n, dtype=np.bool_)
        self.locks.sense(sensed, nobody)
        self.count += int(self.locks.begun.sum())
        if not self.locks.locked.any():
            return roles
        own = places.own_places(sensed.rel_m, sensed.visible, self._chain.formation.points_enu_m[roles])
        pairs = self.locks.swaps(sensed, own, ~nobody) if self._chain.swaps else []
        roles = roles.copy()
        for i, j in pairs:
            roles[[i, j]] = roles[[j, i]]
            self.swaps.append((now_s, i, j))
        if self._chain.detours and not pairs:
            sent = self.locks.begin_detours(sensed, own.to_own_m, nobody, self.locks.params.detour_s, rarer=True)
            self.sent += len(sent)
        return roles


def fly(
    chain: Chain,
    profile: Profile,
    start_ned_m: FloatArray,
    rng: np.random.Generator,
    *,
    seconds: float = 60.0,
    frame_tilt_rad: float = 0.0,
    tilt_with_speed: bool = False,
    output_turn_rad: float = 0.0,
    roles: IntArray | None = None,
    stop_when_formed: bool = True,
) -> Flight:
    """Flies one team from hovering at the start; stops early a second after it has formed.

    ``frame_tilt_rad`` leans every body by that much at most, each another way, always or in proportion to its commanded
    speed; ``output_turn_rad`` turns every velocity by that angle about an axis of its own (R_i of Theorem 2).
    """
    n = len(start_ned_m)
    if roles is None:
        roles = assign_roles(frames.enu_from_ned(start_ned_m), chain.formation).role_of_agent
    task = control.task_for_roles(chain.formation, chain.gains, roles)
    # As the guidance does: what positions may be off widens what is steered around, too.
    region = chain.region.grown(chain.damper.margin_m) if chain.widen and chain.damper else chain.region
    sensed = np.ones((n, n), dtype=np.bool_)
    wanted = chain.formation.distances_m[np.ix_(roles, roles)]
    upper = np.triu_indices(n, 1)
    yaw = rng.uniform(-np.pi, np.pi, n)
    lean = rng.uniform(-1.0, 1.0, (2, n)) * frame_tilt_rad / np.sqrt(2.0)
    axes = rng.normal(size=(n, 3))
    turns = Rotation.from_rotvec(output_turn_rad * axes / np.linalg.norm(axes, axis=1, keepdims=True))
    steps = 1 if profile.tau_s == 0.0 else 5
    dt = chain.tick_s / steps
    queue = [np.zeros((n, 3))] * (round(profile.delay_s / dt) + 1)
    pos, vel, accel = start_ned_m.copy(), np.zeros((n, 3)), np.zeros((n, 3))
    bias = rng.normal(0.0, profile.bias_m, (n, 3)) if profile.bias_m else np.zeros((n, 3))
    sent = np.zeros((n, 3))
    seen_pos, seen_vel, kept_pos, last_out = pos.copy(), vel.copy(), pos.copy(), np.zeros((n, 3))
    clearance = np.inf
    smallest, formed_s, blocked, infeasible, error = np.inf, np.nan, 0, 0, np.inf
    way_out = WayOut(chain, profile) if chain.swaps or chain.detours else None
    for tick in range(round(seconds / chain.tick_s)):
        if profile.bias_m:  # wanders on
            keep = np.exp(-chain.tick_s / profile.bias_tau_s)
            bias = keep * bias + rng.normal(0.0, profile.bias_m * np.sqrt(1 - keep**2), (n, 3))
        new_pos = pos + bias + (rng.normal(0.0, profile.pos_noise_m, (n, 3)) if profile.pos_noise_m else 0.0)
        new_vel = vel + (rng.normal(0.0, profile.vel_noise_m_s, (n, 3)) if profile.vel_noise_m_s else 0.0)
        lost = rng.random((n, 1)) < profile.loss if profile.loss and tick else np.zeros((n, 1), dtype=np.bool_)
        seen_pos = np.where(lost, seen_pos + chain.tick_s * seen_vel, new_pos)  # carried on, as the ground station does
        seen_vel = np.where(lost, seen_vel, new_vel)
        if chain.filter_s:
            carried = seen_pos if tick == 0 else kept_pos + chain.tick_s * seen_vel
            kept_pos = carried + (seen_pos - carried) * chain.tick_s / chain.filter_s
        believed_pos = kept_pos if chain.filter_s else seen_pos
        forward, right = np.cos(yaw), np.sin(yaw)
        ahead = accel[:, 0] * forward + accel[:, 1] * right
        aside = -accel[:, 0] * right + accel[:, 1] * forward
        tilt = lean * np.minimum(np.linalg.norm(sent, axis=1) / chain.speed_m_s, 1.0) if tilt_with_speed else lean
        quat = frames.quat_ned_from_frd_of_euler(
            tilt[0] + np.arctan(aside / GRAVITY_M_S2), tilt[1] - np.arctan(ahead / GRAVITY_M_S2), yaw
        )
        views = local_views(believed_pos, seen_vel, quat, sensed)
        want = control.formation_control(
            views, task, chain.scale, chain.control_gain, lead_s=chain.lead_s, upright_1_s=chain.upright_1_s
        )
        want = control.saturate(want, chain.speed_m_s)
        if way_out is not None:
            want = way_out.wish(views, quat, want)
        wish, in_the_way = want, np.zeros((n, n), dtype=np.bool_)
        if chain.rotate:
            avoided = avoidance.avoid(views, want, region)
            want, blocked = avoided.vel_flu_m_s, blocked + int(avoided.blocked.sum())
            in_the_way = in_the_way | avoided.in_the_way
        if chain.damper is not None:
            damped = damper.damp(views, want, chain.damper)
            want, infeasible = damped.vel_flu_m_s, infeasible + int(damped.infeasible.sum())
            in_the_way = in_the_way | damped.in_the_way
        if way_out is not None:
            given = way_out.roles(
                now_s=tick * chain.tick_s,
                views=views,
                quat=quat,
                wish_flu_m_s=wish,
                in_the_way=in_the_way,
                roles=roles,
            )
            if not np.array_equal(given, roles):
                roles = given
                task = control.task_for_roles(chain.formation, chain.gains, roles)
                wanted = chain.formation.distances_m[np.ix_(roles, roles)]
        out = frames.rotate(frames.rot_ned_from_flu(quat), want)
        if output_turn_rad:
            out = turns.apply(out)
        sent = limits.apply_limits(
            out,
            sent,
            seen_pos,
            speed_max_m_s=chain.speed_m_s,
            accel_max_m_s2=np.inf if profile.tau_s == 0.0 else chain.accel_m_s2,
            period_s=chain.tick_s,
            fence=None,
            fence_rate_1_s=1.0,
        )
        last_out = np.where(rng.random((n, 1)) < profile.loss, last_out, sent) if profile.loss else sent
        for _ in range(steps):
            queue.append(last_out)
            command = queue.pop(0)
            if profile.tau_s == 0.0:
                vel = last_out
            else:
                wished = (command - vel) / profile.tau_s
                size = np.linalg.norm(wished, axis=1, keepdims=True)
                wished = wished * np.minimum(1.0, profile.accel_m_s2 / np.maximum(size, 1e-12))
                accel = accel + (wished - accel) * (dt / (dt + profile.tilt_lag_s))
                vel = vel + accel * dt
            pos = pos + vel * dt
            distances = metrics.pair_distances_m(pos)[upper]
            smallest = min(smallest, float(distances.min()))
            if chain.shape != "sphere":
                offsets = pos[upper[1]] - pos[upper[0]]
                clearance = min(clearance, float(chain.region.clearance(offsets).min()))
        error = float(np.abs(distances - wanted[upper]).max())
        now = (tick + 1) * chain.tick_s
        if error > chain.tolerance_m:
            formed_s = np.nan
        elif np.isnan(formed_s):
            formed_s = now
        elif stop_when_formed and now - formed_s >= 1.0:
            break
    flight = Flight(
        formed_s,
        smallest,
        error,
        pos,
        roles,
        blocked,
        infeasible,
        clearance if chain.shape != "sphere" else smallest / chain.radius_m,
    )
    if way_out is None:
        return flight
    return dataclasses.replace(flight, gridlocks=way_out.count, swaps=tuple(way_out.swaps), detours=way_out.sent)
