"""The end: landing with the team, or waiting for those that the autopilots' own failsafe brings down."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from groundstation.core.phases import Phase
from groundstation.core.types import BoolArray
from groundstation.mission.flight.poses import Poses
from groundstation.mission.ground.arming import Arming
from groundstation.mission.phases.on_the_ground import ArmPhase
from groundstation.mission.phases.state import Entry, PhaseState, Step
from groundstation.mission.phases.table import Event
from groundstation.mission.reasons.blame import HELP_IN_THE_AIR, still_flying
from groundstation.mission.team import Team
from groundstation.mission.timing import SECOND_NS, Held, vehicle_list

_DISARMED_NS = 5 * SECOND_NS // 2  # two heartbeats that say so
_LOW_M, _LOW_WITHIN_M = 1.0, 0.3  # heights by GPS and barometer are off by half a metre
_SINKS_MAX_NS = 15 * SECOND_NS  # 5 m at 0.5 m/s, and coming to rest
_DOWN_MAX_NS = 120 * SECOND_NS  # nobody is waited for longer than this while the team comes down
_STILL_M_S, _PAD_M = 0.1, 0.5  # who moves less, and is no farther above its pad, stands on it by what it reports
_KEEP_CLEAR = "keep clear of it, stop it by remote control"


class _ComingDown(PhaseState):
    """Ends the mission when everybody is down, or when nobody who is left can be waited for."""

    def __init__(self, team: Team, entry: Entry) -> None:
        super().__init__(team, entry)
        self._down = Held()

    def _down_max_ns(self) -> int:
        return _DOWN_MAX_NS

    def _over(self, now_ns: int, poses: Poses) -> bool:
        """Whether it is over; then everything that has to be told of who is left is told.

        Of one that is not ours nothing is told but what was done, and whether that came to its end.
        """
        team = self._team
        unheard = team.killing.unheard(now_ns)
        lost = team.landing.lost(now_ns)
        unsure = team.landing.unsure(now_ns, lost)
        up = team.landing.still_up(self.since_ns, lost | unsure) | (team.killing.not_shown(now_ns) & ~unheard)
        late = now_ns - self.since_ns >= self._down_max_ns()
        down = self._down(late or not up.any(), now_ns, _DISARMED_NS)
        if not late and not down:
            return False
        abort = team.verdict.abort
        names = self._names(lost)
        if names:
            abort(
                f"{names}: not heard from any more, whether it has landed is not known; if it flies, {HELP_IN_THE_AIR}"
            )
        for vehicle in np.flatnonzero(unsure).tolist():
            abort(team.landing.words_of_unsure(vehicle, now_ns))
        names = self._names(unheard)
        if names:
            abort(f"{names}: told to stop its motors, and nothing shows that it did; {_KEEP_CLEAR}")
        if up.any():
            self._tell_late(up, poses)
        flying = team.standing.airborne(now_ns) & ~lost & ~team.roster.killed & ~up
        for text in still_flying(team.fleet, team.plan, flying, now_ns):
            abort(text)
        self._tell_astray(lost)
        team.verdict.complete()
        return True

    def _tell_astray(self, lost: BoolArray) -> None:
        """Says how far from their pads those may stand whose positions have gone astray."""
        team = self._team
        for vehicle in np.flatnonzero(team.roster.ours & ~lost).tolist():
            astray = team.board.may_stand_off_m(vehicle)
            if astray is None:
                continue
            off_m, gone_m = astray
            team.verdict.abort(
                f"{team.name(vehicle)}: may stand up to {np.ceil(10.0 * off_m) / 10.0:.1f} m from its pad: its position"
                f" has gone {gone_m:.1f} m that its velocity knows nothing of; look where it stands, and restart it on"
                " its pad"
            )

    def _tell_late(self, up: BoolArray, poses: Poses) -> None:
        """Says of those that are still up when nobody waits any longer what is left to do."""
        team, waited_s = self._team, self._down_max_ns() // SECOND_NS
        killed, alone = team.roster.killed, team.preflight.checks.failsafe.left_alone
        height_m = team.height_m(poses.pos_team_ned_m)
        for vehicle in np.flatnonzero(up & killed).tolist():
            team.verdict.abort(
                f"{team.name(vehicle)}: told to stop its motors, and still armed by its own report"
                f" after {waited_s:g} s; {_KEEP_CLEAR}"
            )
        for vehicle in np.flatnonzero(up & ~killed).tolist():
            if team.fleet.disarm_doubted[vehicle]:
                speed_m_s = float(np.linalg.norm(poses.vel_ned_m_s[vehicle]))
                words = self._words_of_doubted(vehicle, float(height_m[vehicle]), speed_m_s, waited_s)
            else:
                words = team.landing.words_of_late(vehicle, float(height_m[vehicle]), waited_s, alone)
            team.verdict.abort(words)

    def _words_of_doubted(self, vehicle: int, height_m: float, speed_m_s: float, waited_s: float) -> str:
        """Says of one that contradicts itself what its position shows; it is not called landed for that."""
        plan = self._team.plan
        told = f"after {waited_s:g} s of landing its heartbeats say disarmed, its landed state that it flies"
        seen = f"its position stands {height_m:.1f} m above its pad"
        if speed_m_s > _STILL_M_S:
            seen = f"its position moves at {speed_m_s:.1f} m/s, {height_m:.1f} m above its pad"
        low = abs(height_m) <= max(_PAD_M, 2.0 * plan.margin_m) and speed_m_s <= _STILL_M_S  # NaN is not
        most = "it has landed, most likely" if low else "it counts as flying"
        return (
            f"{self._team.name(vehicle)}: {told}, {seen}: {most}; setpoints stop now; keep away, look whether it stands"
            f" with its motors off, and {'take its battery out' if low else 'else take it over by remote control'}"
        )

    def _names(self, who: BoolArray) -> str:
        return vehicle_list(self._team.fleet.ids[who].tolist())


class LandPhase(_ComingDown):
    """Everybody lands, each when nobody is below; before takeoff everybody is disarmed.

    An autopilot lands by its own velocity, and where that is poor it strays on its way down: PX4's simulator as it
    comes by 0.1 to 2.0 m from a height of 6 m. Led down by velocities that are mended a team stays on its places, and
    from 1 m on it strays by 0.1 to 0.8 m.
    """

    phase = Phase.LAND
    steers = streams = True

    def __init__(self, team: Team, entry: Entry) -> None:
        super().__init__(team, entry)
        self._low = self._led = False
        self._arming: Arming | None = entry.before.arming if isinstance(entry.before, ArmPhase) else None

    def step(self, now_ns: int, poses: Poses) -> Step:
        """Lets those land that are where they should."""
        team = self._team
        if not team.stance.flies:
            anew = self._arming.started_anew() if self._arming is not None else None
            if anew is not None:  # a vehicle tells it seconds after it has fallen silent
                team.verdict.abort(anew)
            team.landing.disarm_on_the_ground(now_ns)
        else:
            was_led, self._low = self._led, self._low or self._is_low(now_ns, poses)
            self._led = not self._low
            if self._low:
                team.landing.want(range(team.plan.size), now_ns)
            elif not was_led:
                team.verdict.note("info", f"velocities are poor: all are led down to {_LOW_M:g} m, and land from there")
        event = Event.DOWN if self._over(now_ns, poses) else None
        if not team.steerable.any():
            return Step(event=event)  # the autopilots land by themselves, nobody is left to be steered
        places_ned_m = team.places_ned_m(team.formation.gather_ned_m)
        if not self._low:
            above_m = np.minimum(team.height_m(places_ned_m), _LOW_M)
            places_ned_m = places_ned_m + [0.0, 0.0, 1.0] * (team.height_m(places_ned_m) - above_m)[:, None]
        if team.roster.elsewhere.any():  # some have a way to go, and others may be in it
            return Step(team.formation.fly_home(poses, team.absent(), places_ned_m), event)
        return Step(team.helm.to_targets(poses, places_ned_m).vel_ned_m_s, event)

    def _is_low(self, now_ns: int, poses: Poses) -> bool:
        """Whether everybody may be told to land: nobody's velocity is poor, or all are low already."""
        team = self._team
        led = team.steerable & ~team.roster.lands
        poor = led & (team.board.speeds.rms_m_s > 0.0)
        if not poor.any() or team.roster.elsewhere.any() or now_ns - self.since_ns >= _SINKS_MAX_NS:
            return True
        return bool((team.height_m(poses.pos_team_ned_m)[led] <= _LOW_M + _LOW_WITHIN_M).all())


class SilentPhase(_ComingDown):
    """No setpoints and no heartbeats: the autopilots' own failsafe acts. Orders to land and to kill are still sent."""

    phase = Phase.SILENT

    def __init__(self, team: Team, entry: Entry) -> None:
        super().__init__(team, entry)
        self._spoken_to = False

    @property
    def speaks(self) -> bool:
        """Silent, heartbeats too: some autopilots act only when those are gone; unless the operator wants something."""
        return self._spoken_to or bool(self._team.roster.killed.any())

    def land(self, vehicles: Sequence[int], now_ns: int) -> None:
        """The operator wants vehicles landed."""
        self._spoken_to = True
        self._team.landing.want(vehicles, now_ns)

    def _down_max_ns(self) -> int:
        down_s = self._team.preflight.checks.failsafe.down_s
        return _DOWN_MAX_NS + (round(down_s) * SECOND_NS if np.isfinite(down_s) else 0)

    def step(self, now_ns: int, poses: Poses) -> Step:
        """Waits until everybody is down."""
        return Step(event=Event.DOWN if self._over(now_ns, poses) else None)


class DonePhase(PhaseState):
    """There is nothing left to do."""

    phase = Phase.DONE

    def step(self, now_ns: int, poses: Poses) -> Step:
        """Does nothing."""
        return Step()
