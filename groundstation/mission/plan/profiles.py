"""What a kind of vehicle can do, as far as the control law has to know it.

The figures are step responses seen on real firmware; they set the control gain and the avoidance. A mission may
name another profile for each of its vehicles, and the slowest one counts for the team.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, fields, replace

from groundstation.core.compensation import AxisResponse, Response
from groundstation.core.control import (
    ScaleFunction,
    auto_control_gain,
    most_for_tilted_views,
    rate_for_auto_gain_1_s,
)
from groundstation.core.formation import Formation, Gains
from groundstation.core.wind import Airframe
from groundstation.mission.plan.schema import MissionSpec


@dataclass(frozen=True)
class VehicleProfile:
    """How a vehicle follows a velocity setpoint.

    Attributes:
        name: as missions call it.
        lag_s: time constant tau of its velocity loop (t63 less the delay), of the slower axis.
        lag_up_s: the same upward and downward.
        delay_s: from the telemetry's instant to the setpoint taking effect.
        acceleration_max_m_s2: what it reaches horizontally while holding height.
        position_error_m: standard deviation of its position estimate against the others', one axis.
        endurance_s: hovering time on a full battery.
        climb_m_s: what it climbs and sinks at least when it returns by itself.
        cruise_m_s: its speed at least when it returns by itself.
        half_height_m: how far above and below it downwash is felt; for safety regions that are no spheres.
        airframe: how it takes the wind.
        wind_mean_m_s, wind_gust_m_s: mean wind, and standard deviation of the gusts on one axis, that it is flown in.
        response: how its velocity loop answers, for compensated commands; None where that is not known.
    """

    name: str
    lag_s: float
    lag_up_s: float
    delay_s: float
    acceleration_max_m_s2: float
    position_error_m: float
    endurance_s: float
    climb_m_s: float
    cruise_m_s: float
    half_height_m: float
    airframe: Airframe
    wind_mean_m_s: float
    wind_gust_m_s: float
    response: Response | None = None


# PX4's gains MPC_XY_VEL_* and MPC_Z_VEL_*, and the drag of its built-in simulator. Of the others none is given: a
# Crazyflie is quick already (0.12 s in place of 0.2 saved 0.1 s of 4.2 in races), and what ArduCopter does to a
# setpoint before its velocity loop takes two more orders to invert.
_PX4_RESPONSE = Response(AxisResponse(1.8, 0.5, 1.35), AxisResponse(4.0, 2.0, 1.35), lag_s=1.0)

_CRAZYFLIE_HALF_HEIGHT_M = 0.75
"""Twice the 0.375 m that Crazyswarm takes for each of two Crazyflies (docs/avoidance.md)."""
_HALF_METRE_HALF_HEIGHT_M = 4.0
"""The same for multirotors of 0.5 m and propellers of 0.25 m: downwash grows with the size of the vehicle."""

# Upward lags limit the law's lead. PX4 answers upward in 0.3 s too, but is flown with the whole lead, in the emulator
# and on real firmware, and came to rest; where its setpoints are shaped, all axes answer alike.

# How a vehicle takes the wind. Rotor drag and body drag of half a metre: ArduPilot's own model of a multicopter
# (momentum drag of 0.2, 45 degrees at 15 m/s); of a Crazyflie: as identified by Foerster (2015). drag_1_s of px4_quad
# is that of PX4's built-in simulator. push_lag_s and settle_s follow from the gains of the velocity loops:
# MPC_XY_VEL_P_ACC 1.8 and I_ACC 0.5; PSC_VELXY_P 2 and I 1; 4.3 and 0.17 of the Crazyflie's firmware.

PROFILES: dict[str, VehicleProfile] = {
    profile.name: profile
    for profile in (
        VehicleProfile(
            "crazyflie", lag_s=0.2, lag_up_s=0.2, delay_s=0.05, acceleration_max_m_s2=4.0, position_error_m=0.01,
            endurance_s=360.0, climb_m_s=0.8, cruise_m_s=1.0, half_height_m=_CRAZYFLIE_HALF_HEIGHT_M,
            airframe=Airframe(air_1_s=0.3, air_1_m=0.05, drag_1_s=0.25, push_lag_s=0.22, settle_s=24.0),
            wind_mean_m_s=1.0, wind_gust_m_s=0.2,
        ),
        VehicleProfile(
            "px4_quad", lag_s=1.0, lag_up_s=1.0, delay_s=0.1, acceleration_max_m_s2=3.0, position_error_m=0.02,
            endurance_s=1200.0, climb_m_s=1.4, cruise_m_s=3.0, half_height_m=_HALF_METRE_HALF_HEIGHT_M,
            airframe=Airframe(air_1_s=0.25, air_1_m=0.027, drag_1_s=1.35, push_lag_s=0.49, settle_s=4.1),
            wind_mean_m_s=8.0, wind_gust_m_s=1.0, response=_PX4_RESPONSE,
        ),
        VehicleProfile(
            "arducopter", lag_s=0.6, lag_up_s=0.2, delay_s=0.1, acceleration_max_m_s2=2.5, position_error_m=0.02,
            endurance_s=1200.0, climb_m_s=1.4, cruise_m_s=3.0, half_height_m=_HALF_METRE_HALF_HEIGHT_M,
            airframe=Airframe(air_1_s=0.25, air_1_m=0.027, drag_1_s=0.25, push_lag_s=0.5, settle_s=2.0),
            wind_mean_m_s=8.0, wind_gust_m_s=1.0,
        ),
    )
}  # fmt: skip


_SLOPES = 1.5
_NOISE_MOST = 3.0
_LATE_BESIDE_S = 0.1
COMPENSATED_S = 0.3
"""What `compensate_s: auto` makes of the lag at best: less asks for larger commands, and passes on more noise."""


def approach_rate_1_s(profile: VehicleProfile, lead_s: float) -> float:
    """How quickly a point can be approached, critically damped.

    Where a vehicle would come to rest obeys p' = u, as far as the lag is what it is taken for (a quarter of what is
    made up for is not trusted, as in ``auto_control_gain``): a point is approached that much faster.

    Args:
        profile: lag and delay.
        lead_s: what of the lag is made up for.
    """
    return 0.25 / (profile.lag_s - 0.75 * min(lead_s, profile.lag_s) + profile.delay_s)


def compensated_lag_s(spec: MissionSpec, profiles: Sequence[VehicleProfile]) -> float | None:
    """The lag that compensated vehicles are to answer with; None where nobody's commands are shaped.

    No less than 1.5 times what the speed limit takes at the acceleration limit: a setpoint that may not change any
    faster lags behind what is wished, however quick the vehicle. A gain and a lead for less make a team swing without
    end: at 0.6 times always, at once that time with velocity loops that are 30 % quicker than known. And no less than
    ``quiet_lag_s``.
    """
    if not spec.compensate_s:
        return None
    reached_m_s2 = min(profile.acceleration_max_m_s2 for profile in profiles)
    sloped_s = _SLOPES * spec.speed_limit_m_s / min(spec.acceleration_limit_m_s2 or reached_m_s2, reached_m_s2)
    least_s = max(sloped_s, quiet_lag_s(profiles))
    if spec.compensate_s == "auto":
        # In a mixed team nobody is to stop much sooner than those who follow it.
        others_s = [profile.lag_s for profile in profiles if profile.response is None]
        return max(COMPENSATED_S, least_s, *others_s)
    return max(spec.compensate_s, least_s)


def quiet_lag_s(profiles: Sequence[VehicleProfile]) -> float:
    """The least lag with which compensation passes noise on no more than ``_NOISE_MOST`` times; 0 without responses.

    G^-1(s) / (tau s + 1) comes to 1 / (p tau) for what changes from tick to tick.
    """
    gains = [
        axis.p_1_s for item in profiles if item.response for axis in (item.response.horizontal, item.response.vertical)
    ]
    return 1.0 / (_NOISE_MOST * min(gains)) if gains else 0.0


def compensated(profile: VehicleProfile, lag_s: float | None) -> VehicleProfile:
    """The profile as everything that steers has to know it when commands are shaped so that it answers with ``lag_s``.

    Without a response that is known, with a lag that is none, and with None its commands go as they are, and it has no
    response.
    """
    if lag_s is None or profile.response is None or lag_s >= profile.lag_s:
        return replace(profile, response=None)
    return replace(profile, lag_s=lag_s, lag_up_s=lag_s)


def lead_s_for(spec: MissionSpec, team: VehicleProfile) -> float:
    """How far ahead the law looks: ``lead_s``, or the lag of the team, as far as its quickest axis bears it.

    One lead counts on all axes. An axis with a lag tau_z that is less answers with k lambda L / (tau_z s) to what
    changes quickly, and with what is late beside (delay, tick, attitude) a team swings for good once it has begun to:
    ArduCopter, 0.2 s upward, at k lambda L / tau_z of 4.9 and 6.1 1/s; at 3.3 it all but rests. Here it is 0.6 over
    what is late beside, 2.7 1/s for a delay of 0.1 s.

    Args:
        spec: the mission.
        team: the slowest of its vehicles, as ``compensated`` gives them, with the delay of the links.
    """
    if spec.lead_s != "auto":
        return spec.lead_s
    if team.lag_up_s >= team.lag_s:
        return team.lag_s
    late_s = team.delay_s + 1.0 / spec.rate_hz
    return min(team.lag_s, (team.lag_s + late_s) / (0.75 + (late_s + _LATE_BESIDE_S) / team.lag_up_s))


def slowest(profiles: Iterable[VehicleProfile]) -> VehicleProfile:
    """The profile that every vehicle of a mixed team can keep: the worst of each figure."""
    items = list(profiles)
    return VehicleProfile(
        name="+".join(sorted({item.name for item in items})),
        lag_s=max(item.lag_s for item in items),
        lag_up_s=min(item.lag_up_s for item in items),
        delay_s=max(item.delay_s for item in items),
        acceleration_max_m_s2=min(item.acceleration_max_m_s2 for item in items),
        position_error_m=max(item.position_error_m for item in items),
        endurance_s=min(item.endurance_s for item in items),
        climb_m_s=min(item.climb_m_s for item in items),
        cruise_m_s=min(item.cruise_m_s for item in items),
        half_height_m=max(item.half_height_m for item in items),
        airframe=_worst([item.airframe for item in items]),
        wind_mean_m_s=min(item.wind_mean_m_s for item in items),
        wind_gust_m_s=min(item.wind_gust_m_s for item in items),
    )


def _worst(frames: Sequence[Airframe]) -> Airframe:
    """The worst of each figure."""
    return Airframe(*(max(getattr(frame, field.name) for frame in frames) for field in fields(Airframe)))


def bearable_gain(
    formation: Formation,
    gains: Gains,
    scale: ScaleFunction,
    upright_1_s: float,
    *,
    profile: VehicleProfile,
    rate_hz: float,
    lead_s: float,
) -> float:
    """The control gain that a team bears: by its lag, delay and tick, and by views that tilt with its vehicles.

    Args:
        formation: points and graph, by role.
        gains: by role.
        scale: f of (14).
        upright_1_s: weight of the upright term.
        profile: of the slowest vehicle.
        rate_hz: ticks a second.
        lead_s: how far ahead motion counts in the law.

    Raises:
        ValueError: nothing pulls the vehicles.
    """
    rate_1_s = rate_for_auto_gain_1_s(formation, gains, scale, upright_1_s)
    by_lag = auto_control_gain(rate_1_s, profile.lag_s, profile.delay_s + 1.0 / rate_hz, lead_s)
    return min(by_lag, most_for_tilted_views(formation, gains, profile.lag_s))
