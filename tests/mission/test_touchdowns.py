"""How vehicles come to the ground, by what they report of it: against the emulator's own physics."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache

import numpy as np
import pytest
from hypothesis import assume, example, given, settings
from hypothesis import strategies as st

from groundstation.app.campaign.words import TOUCHDOWN_MAX_M_S
from groundstation.app.resources import packaged_configs
from groundstation.mavlink.vehicle import LANDED_IN_AIR, LANDED_ON_GROUND, Fleet
from groundstation.mission.monitors.findings import Finding, Reaction, Sight
from groundstation.mission.monitors.touchdowns import HARD_M_S, LEANS_DEG, Touchdowns
from groundstation.mission.plan.plan import MissionPlan
from groundstation.mission.plan.reading import load_mission
from sitl.dynamics import Dynamics
from sitl.estimator import NOISELESS, Estimator
from sitl.personalities import PROFILES

SECOND_NS = 1_000_000_000
STEP_NS = 4_000_000
START_NS = 100 * SECOND_NS
_SOFT_M_S = 1.0  # the fastest of the recorded landings of real firmware


@cache
def _plan() -> MissionPlan:
    return load_mission(packaged_configs() / "missions" / "first_flight2.yaml")


@dataclass
class Flight:
    """One vehicle that comes down, a motor of which fails at a height; what it reports, and what is told of it.

    Attributes:
        findings: what was told.
        dynamics: the truth.
        early: of what was told, what was told before it had come to the ground.
        seen_m_s: the fastest that it reported itself to sink.
    """

    findings: list[Finding]
    dynamics: Dynamics
    early: list[Finding]
    seen_m_s: float

    @property
    def hit_m_s(self) -> float:
        """How fast it truly came to the ground at worst."""
        return float(self.dynamics.motion.touchdown_m_s[0])


def _comes_down(
    *,
    height_m: float,
    share: float,
    pose_hz: float,
    sinks_m_s: float = 0.5,
    fails_s: float = 4.0,
    tumbles: bool = True,
    phase: float = 0.0,
    seed: int = 0,
    name: str = "crazyflie",
    noise_m_s: float = 0.01,
    noise_m: float = 0.002,
    tells_after_s: float | None = 1.0,
    ours: bool = True,
    excused: bool = True,
    wind_deg: float = 0.0,
) -> Flight:
    """Lets it come down from 0.6 m above the height at which its motor fails, 5 s in all.

    Args:
        height_m: at which the motor fails.
        share: of the thrust that is left.
        pose_hz: how often it reports.
        sinks_m_s: as fast as it was told to come down.
        fails_s: for how long.
        tumbles: whether attitude control is lost as well.
        phase: of the reports against the ticks.
        seed: of the reports' noise.
        name: of the profile.
        noise_m_s, noise_m: of the reports.
        tells_after_s: after standing for so long it reports it; None for never.
        ours, excused: as in ``Sight``.
        wind_deg: leans as much against a wind, until it stands, besides.
    """
    plan, rng = _plan(), np.random.default_rng(seed)
    pads = np.zeros((3, 1))
    estimator = Estimator([NOISELESS], STEP_NS / SECOND_NS, rng)
    dynamics = Dynamics(
        [PROFILES[name]], pos_enu_m=pads, yaw_enu_rad=np.zeros(1), estimator=estimator, step_s=STEP_NS / SECOND_NS
    )
    motion, commands = dynamics.motion, dynamics.commands
    motion.on_ground = np.zeros(1, dtype=np.bool_)
    motion.any_on_ground = motion.all_on_ground = False
    motion.pos_enu_m[2] = height_m + 0.6
    motion.vel_enu_m_s[2] = -sinks_m_s
    motion.thrust_m_s2[:] = 9.81
    commands.flying[:] = True
    commands.vel_sp_enu_m_s[2] = -sinks_m_s
    fleet = Fleet([vehicle.id for vehicle in plan.spec.vehicles], plan.link_of_vehicle)
    fleet.armed[:] = [True, False]
    fleet.landed_state[:] = [LANDED_IN_AIR, LANDED_ON_GROUND]
    fleet.quat_ned_from_frd[:] = [1.0, 0.0, 0.0, 0.0]
    fleet.pos_local_ned_m[:] = fleet.vel_ned_m_s[:] = 0.0
    watch, findings, early = Touchdowns(plan), list[Finding](), list[Finding]()
    now_ns, told_ns, failed_ns = START_NS, START_NS + round(phase / pose_hz * SECOND_NS), 0
    stood_ns, seen_m_s = 0, 0.0
    while now_ns < START_NS + 5 * SECOND_NS:
        dynamics.step()
        now_ns += STEP_NS
        if not failed_ns and motion.pos_enu_m[2, 0] <= height_m:
            failed_ns = now_ns
        broken = bool(failed_ns) and now_ns - failed_ns < fails_s * SECOND_NS
        dynamics.health.power(0, share if broken else 1.0)
        if bool(dynamics.health.tumbling[0]) != (broken and tumbles):
            dynamics.health.tumble(0, broken and tumbles)
        stood_ns = stood_ns + STEP_NS if motion.on_ground[0] else 0
        stands = tells_after_s is not None and stood_ns > tells_after_s * SECOND_NS
        commands.flying[:] = not stands
        if now_ns >= told_ns:
            told_ns += round(SECOND_NS / pose_hz)
            east, north, up = motion.pos_enu_m[:, 0] + noise_m * rng.standard_normal(3)
            fleet.pos_local_ned_m[0] = [north, east, -up]
            east, north, up = motion.vel_enu_m_s[:, 0] + noise_m_s * rng.standard_normal(3)
            fleet.vel_ned_m_s[0] = [north, east, -up]
            seen_m_s = max(seen_m_s, -float(up))
            half = 0.5 * np.arccos(np.clip(motion.up_enu[2, 0], -1.0, 1.0))
            half += 0.0 if motion.on_ground[0] else 0.5 * np.radians(wind_deg)
            fleet.quat_ned_from_frd[0] = [np.cos(half), np.sin(half), 0.0, 0.0]
            fleet.pose_ns[0] = now_ns
        if (now_ns - START_NS) % (5 * STEP_NS) == 0:
            fleet.landed_state[0] = LANDED_ON_GROUND if stands else LANDED_IN_AIR
            told = list(watch.look(_sight(plan, fleet, now_ns, ours=ours, excused=excused), np.array([ours, True])))
            findings += told
            if motion.touchdown_m_s[0] == 0.0:
                early += told
    return Flight(findings, dynamics, early, seen_m_s)


def _sight(plan: MissionPlan, fleet: Fleet, now_ns: int, *, ours: bool, excused: bool) -> Sight:
    n = len(fleet)
    no = np.zeros(n, dtype=np.bool_)
    age_s = ((now_ns - fleet.pose_ns) / SECOND_NS)[:, None]
    pads_ned_m = plan.pads_enu_m[:, [1, 0, 2]] * [1.0, 1.0, -1.0]
    return Sight(
        fleet=fleet, now_ns=now_ns, pos_team_ned_m=pads_ned_m + fleet.pos_local_ned_m + fleet.vel_ned_m_s * age_s,
        vel_ned_m_s=fleet.vel_ned_m_s, pose_ns=fleet.pose_ns, drift_m=np.full(n, np.nan), sent_ned_m_s=np.zeros((n, 3)),
        ours=np.array([ours, True]), steered=no, lands_here=no, excused=np.array([excused, False]), blind=no,
        airborne=fleet.armed & (fleet.landed_state != LANDED_ON_GROUND),
    )  # fmt: skip


@settings(max_examples=60, deadline=None)
@example(height_m=0.35, share=0.515, pose_hz=20.0, phase=0.5, seed=1, tumbles=True, fails_s=3.0, tells_after_s=1.0)
@example(height_m=0.21875, share=0.375, pose_hz=10.0, phase=0.5, seed=0, tumbles=True, fails_s=1.0, tells_after_s=None)
@example(height_m=0.25, share=0.3, pose_hz=10.0, phase=0.9, seed=2, tumbles=False, fails_s=3.0, tells_after_s=1.0)
@example(height_m=0.3, share=0.3, pose_hz=20.0, phase=0.2, seed=3, tumbles=False, fails_s=0.28, tells_after_s=None)
@example(height_m=0.6, share=0.9, pose_hz=50.0, phase=0.2, seed=4, tumbles=True, fails_s=4.0, tells_after_s=1.0)
@example(height_m=0.5, share=0.76, pose_hz=20.0, phase=0.2, seed=5, tumbles=True, fails_s=4.0, tells_after_s=1.0)
@given(
    height_m=st.floats(0.2, 3.0),
    share=st.floats(0.3, 0.95),
    pose_hz=st.floats(10.0, 50.0),
    phase=st.floats(0.0, 1.0),
    seed=st.integers(0, 99),
    tumbles=st.booleans(),
    fails_s=st.floats(0.2, 4.0),
    tells_after_s=st.sampled_from([0.1, 1.0, 2.0, None]),
)
def test_a_touchdown_harder_than_a_landing_is_told_and_no_other(
    *,
    height_m: float,
    share: float,
    pose_hz: float,
    phase: float,
    seed: int,
    tumbles: bool,
    fails_s: float,
    tells_after_s: float | None,
) -> None:
    flight = _comes_down(
        height_m=height_m, share=share, pose_hz=pose_hz, phase=phase, seed=seed, tumbles=tumbles, fails_s=fails_s,
        tells_after_s=tells_after_s,
    )  # fmt: skip
    motion = flight.dynamics.motion
    assume(motion.on_ground[0])
    # What falls between two reports and never tells that it stands shows in its attitude alone, which others watch.
    stops_m_s = 12.0 / pose_hz + 0.1  # what rotors could have taken away between two reports
    shown = tells_after_s is not None or flight.seen_m_s > max(TOUCHDOWN_MAX_M_S / 2, stops_m_s)
    if shown and (flight.hit_m_s > TOUCHDOWN_MAX_M_S or (motion.crashed[0] and tells_after_s is not None)):
        assert flight.findings, flight.hit_m_s
    elif flight.hit_m_s < _SOFT_M_S and not tumbles:
        assert flight.findings == []
    assert len(flight.findings) <= 1
    assert flight.early == []  # one that tumbles beside the ground gets faster as hard as the ground stops it


@pytest.mark.parametrize("pose_hz", [2.0, 10.0, 20.0, 50.0])
@pytest.mark.parametrize("sinks_m_s", [0.3, 0.7, 1.0])
def test_a_landing_as_real_firmware_lands_is_left_alone(pose_hz: float, sinks_m_s: float) -> None:
    for seed in range(3):
        flight = _comes_down(
            height_m=-1.0, share=1.0, pose_hz=pose_hz, sinks_m_s=sinks_m_s, seed=seed, phase=0.3 * seed, noise_m=0.01
        )
        assert flight.hit_m_s < _SOFT_M_S + 0.1
        assert flight.findings == []


@pytest.mark.parametrize(
    ("ours", "excused", "reaction"),
    [(True, True, Reaction.FAILED), (True, False, Reaction.LAND), (False, False, Reaction.SAY)],
)
def test_it_is_told_with_speed_what_is_normal_and_the_remedy_whoever_it_is(
    ours: bool, excused: bool, reaction: Reaction
) -> None:
    flight = _comes_down(height_m=0.4, share=0.3, pose_hz=20.0, tumbles=False, ours=ours, excused=excused)
    (finding,) = flight.findings
    assert finding.vehicles == (0,)
    assert finding.reaction is reaction
    told_m_s = float(finding.what.split("at ")[1].split(" m/s")[0])
    assert told_m_s == pytest.approx(flight.hit_m_s, abs=0.4)
    assert told_m_s > HARD_M_S
    assert f"a landing ends below {HARD_M_S:g} m/s; look at its legs and propellers before it flies again" in (
        finding.what
    )


@pytest.mark.parametrize("wind_deg", [20.0, 30.0])
def test_one_that_leans_against_the_wind_all_the_time_is_left_alone(wind_deg: float) -> None:
    assert _comes_down(height_m=-1.0, share=1.0, pose_hz=20.0, wind_deg=wind_deg).findings == []
    flight = _comes_down(height_m=0.06, share=0.9, pose_hz=50.0, sinks_m_s=0.4, noise_m_s=0.0, wind_deg=wind_deg)
    assert len(flight.findings) == 1


def test_one_that_comes_down_slowly_and_leaning_is_told_too() -> None:
    flight = _comes_down(height_m=0.06, share=0.9, pose_hz=50.0, sinks_m_s=0.4, noise_m_s=0.0)
    assert flight.hit_m_s < HARD_M_S
    (finding,) = flight.findings
    assert "more than before" in finding.what
    assert f"a landing by less than {LEANS_DEG:g}; look at its legs" in finding.what
