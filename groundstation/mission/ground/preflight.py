"""Everything before arming: rates asked for and counted, clocks, origins, and what is not well yet, in words.

Sends through the station it is given; arms nothing. One that starts anew on the ground is asked for everything
again. Nothing here waits: the runner calls it once per tick and decides how long is long enough.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from groundstation.core.quick import some
from groundstation.core.types import BoolArray, FloatArray, IntArray
from groundstation.mavlink.kinds import unflown_words
from groundstation.mavlink.station import GROUND_STATION_SYSID, Station
from groundstation.mavlink.vehicle import AUTOPILOT_COMPID, HEARTBEAT_PATIENCE, LANDED_ON_GROUND, NEVER
from groundstation.mission.flight.team_frame import TeamFrame
from groundstation.mission.ground.check_table import CheckRow, check_rows
from groundstation.mission.ground.checks import Checks
from groundstation.mission.ground.origins import Origins
from groundstation.mission.ground.still_check import MotionCheck
from groundstation.mission.ground.streams import Streams
from groundstation.mission.plan.plan import MissionPlan
from groundstation.mission.plan.profiles import approach_rate_1_s
from groundstation.mission.reasons.blame import HELP_IN_THE_AIR
from groundstation.mission.timing import SECOND_NS, AskAgain, Held, Since, age_s

_ASK_AGAIN_NS = 5 * SECOND_NS
_REASON_FIRST_NS, _REASON_AGAIN_NS = 3 * SECOND_NS, 10 * SECOND_NS
_REASON_PATIENCE_NS = 3 * SECOND_NS
REASONS_NS = 12 * SECOND_NS
"""Words older than this no longer tell why a vehicle cannot be armed, where newer ones are there."""
_UNANSWERED = 2  # commands in a row, each sent four times: on a lossy link this is no chance
_PROBE_AGAIN_NS = 2 * SECOND_NS
_SYNC_SAMPLES = 3
_ARMED_PATIENCE_NS = 3 * SECOND_NS  # heartbeats and landed states of the whole team
_SYNC_PATIENCE_NS = 5 * SECOND_NS
_ROUND_TRIP_SPARE_S = 0.15
_ROUND_TRIP_CALM = 0.25
"""Delay that the mission does not reckon with, as a share of the lag and delay that k is fitted to, above which people
are told: cube8 formed at 0.35 of it and swung, never within its tolerance, at 0.5."""


_AT_ONCE = 128  # vehicles that are looked at in one tick


@dataclass
class GroundState:
    """What stands between the team and arming, a line for each vehicle.

    Attributes:
        waiting: may pass with time.
        fatal: will not.
        notes: worth knowing, said once.
    """

    waiting: list[str] = field(default_factory=list)
    fatal: list[str] = field(default_factory=list)
    notes: list[str] = field(default_factory=list)


@dataclass
class _Found(GroundState):
    """What was found of one vehicle when it was looked at last.

    Attributes:
        grave: told when nothing else is waited for.
        checked: nothing of it is waited for.
    """

    grave: list[str] = field(default_factory=list)
    checked: bool = False


@dataclass(frozen=True)
class _Sight:
    """What a look at a vehicle needs of this tick; see ``Preflight.step``."""

    now_ns: int
    said: Mapping[int, str]
    pose_ns: IntArray
    off_m: FloatArray
    drift_m: FloatArray
    positions: FloatArray
    silent: BoolArray
    stale: BoolArray
    any_armed: bool


class _Looks:
    """Whose turn it is: of a large team so many are looked at in a tick.

    Attributes:
        found: what was found of each vehicle.
    """

    def __init__(self, n: int) -> None:
        self.found = [_Found() for _ in range(n)]
        self._turns, self._turn = -(-n // _AT_ONCE), 0

    def due(self) -> range:
        """Vehicles that are looked at in this tick."""
        self._turn = (self._turn + 1) % self._turns
        return range(self._turn, len(self.found), self._turns)

    def others(self) -> list[int]:
        """Those who are not, where nothing is missing by the last looks: that is said of one tick alone."""
        if self._turns == 1 or any(found.waiting or found.fatal for found in self.found):
            return []
        return [vehicle for vehicle in range(len(self.found)) if vehicle % self._turns != self._turn]


class _Reasons:
    """When vehicles that cannot be armed are asked why.

    Attributes:
        unready: since when they cannot be armed.
    """

    def __init__(self, n: int) -> None:
        self.unready = Since(n)
        self._asking = AskAgain(n, _REASON_AGAIN_NS)
        self._asks = [0] * n

    def due(self, vehicle: int, now_ns: int) -> bool:
        """Whether one that cannot be armed is to be asked now: most say why by themselves, once, if they do."""
        self.unready.note(vehicle, now_ns)
        return self.unready.held(vehicle, now_ns, _REASON_FIRST_NS) and self._asking.due(vehicle, now_ns)

    def asked(self, vehicle: int, now_ns: int) -> None:
        """It is asked now."""
        self._asking.asked(vehicle, now_ns)
        self._asks[vehicle] += 1

    def may_answer(self, vehicle: int, now_ns: int) -> bool:
        """Whether it has not had the time to say why."""
        asks = self._asks[vehicle]
        return not asks or (asks == 1 and self._asking.lately(vehicle, now_ns, _REASON_PATIENCE_NS))


class Preflight:
    """The way of n vehicles from the first heartbeat to being ready to arm.

    Args:
        plan: rates, pads, limits.
        station: what is asked goes out by it.
        frame: settled by the runner when all is well.
        look_only: set no parameters, whatever the mission says.

    Attributes:
        checks: what a safety officer looks at.
        streams: what vehicles are asked to send.
    """

    def __init__(self, plan: MissionPlan, station: Station, frame: TeamFrame, *, look_only: bool = False) -> None:
        self._plan, self._station, self._frame = plan, station, frame
        self.streams = Streams(plan, station)
        self._mode_asking = AskAgain(plan.size, _ASK_AGAIN_NS)
        self._reasons = _Reasons(plan.size)
        self._probing = AskAgain(plan.size, _PROBE_AGAIN_NS)
        self._heard_of = Since(plan.size)
        self._noted: set[str] = set()
        self._told_slow: BoolArray = np.zeros(plan.size, dtype=np.bool_)
        self._any_armed = Held()
        self._looks = _Looks(plan.size)
        self._origins = Origins(plan, station, frame)
        self.checks = Checks(plan, station, look_only=look_only)
        self._motion = MotionCheck(plan, station.fleet)

    def step(self, now_ns: int, said: Mapping[int, str], pos_team_ned_m: FloatArray) -> GroundState:
        """Asks for what is missing and looks at what is there.

        Args:
            now_ns: time of this tick.
            said: what vehicles refused or warned of, by vehicle.
            pos_team_ned_m: where they report to stand at this tick, shape (n, 3).
        """
        fleet, state = self._station.fleet, GroundState()
        self._origins.look(now_ns)
        self.streams.count_bytes(now_ns)
        off_m = self._frame.off_pad_m(pos_team_ned_m)
        drift_m = self._frame.drift_m(fleet, now_ns)
        pose_ns = self._frame.pose_ns(fleet)
        self._motion.look(now_ns, pos_team_ned_m, pose_ns)
        # A place that is in doubt accuses nobody else.
        doubted = self._origins.doubted(now_ns)
        positions = np.where(doubted[:, None], np.nan, pos_team_ned_m)
        old_s = self._plan.spec.limits.heartbeat_age_s
        silent, stale = fleet.silent(now_ns, old_s), fleet.heartbeat_stale(now_ns, old_s)
        sight = _Sight(now_ns, said, pose_ns, off_m, drift_m, positions, silent, stale, some(fleet.armed))
        for vehicle in self._looks.due():
            self._look(vehicle, sight)
        for vehicle in self._looks.others():
            self._look(vehicle, sight)
        held: list[str] = []  # told together, when nothing else is waited for
        if (team := self.checks.team_problem()) is not None:
            held.append(f"mission: {team}")
        for found in self._looks.found:
            state.waiting += found.waiting
            state.fatal += found.fatal
            state.notes += found.notes
            held += found.grave
        (state.waiting if state.waiting else state.fatal).extend(held)
        state.notes += self.checks.team_notes()
        state.notes = [note for note in state.notes if note not in self._noted]
        self._noted.update(state.notes)
        return state

    def _look(self, vehicle: int, sight: _Sight) -> None:
        """Asks one vehicle for what is missing, and keeps what is found."""
        fleet, spec, now_ns = self._station.fleet, self._plan.spec.vehicles[vehicle], sight.now_ns
        state = self._looks.found[vehicle] = _Found()
        name, pose_ns = f"vehicle {spec.id}", int(sight.pose_ns[vehicle])
        twin = fleet.twin(vehicle, now_ns)
        if twin is not None:
            state.fatal.append(f"{name}: {twin}; give each vehicle its own id (MAV_SYS_ID, MAV_SYSID, SYSID_THISMAV)")
            return
        self._tell_part(vehicle, now_ns, state)
        if fleet.heartbeat_ns[vehicle] == NEVER:
            if sight.silent[vehicle]:
                state.waiting.append(f"{name}: no heartbeat on {spec.link}; {self._where_else(vehicle, now_ns)}")
            else:  # it is there, and what its link cannot carry may be the very heartbeats
                self.streams.ask(vehicle, now_ns, pose_ns, every=True)
                state.waiting.append(f"{name}: {self.streams.no_heartbeat_words(vehicle)}")
            return
        autopilot = self._plan.autopilots[vehicle]
        if fleet.autopilot[vehicle] != autopilot.mav_autopilot:
            state.fatal.append(
                f"{name}: its heartbeat says MAV_AUTOPILOT {fleet.autopilot[vehicle]}, {spec.autopilot} is"
                f" {autopilot.mav_autopilot}; correct vehicles[{vehicle}].autopilot"
            )
            return
        if (kind := unflown_words(int(fleet.mav_type[vehicle]))) is not None:
            state.fatal.append(f"{name}: {kind}; correct its type or frame, or take it out of the mission")
            return
        if sight.any_armed:  # then nothing is asked of the others, and nothing set
            if fleet.armed[vehicle]:
                self._armed(vehicle, now_ns, state)
            return
        self.streams.ask(vehicle, now_ns, pose_ns)
        self._origins.ask(vehicle, now_ns)
        self.checks.ask(vehicle, now_ns)
        off_m = float(sight.off_m[vehicle]), float(sight.drift_m[vehicle])
        problem = (
            self._deaf(vehicle, sight)
            or (None if fleet.room is None else fleet.room.words(vehicle, now_ns))
            or self._heard(vehicle, sight)
            or self._readiness(vehicle, now_ns, sight.said)
            or self._clock(vehicle, now_ns, state)
            or self._place(vehicle, now_ns, off_m, sight.positions, state)
            or self._motion.words(vehicle)
            or self.checks.waiting(vehicle, now_ns, sight.positions)
        )
        state.grave = [f"{name}: {text}" for text in self.checks.grave(vehicle)]
        state.notes += [f"{name}: {text}" for text in self.checks.notes(vehicle, now_ns)]
        far = self._origins.far_away(vehicle)
        if far is not None:
            state.fatal.append(f"{name}: {far}")
        state.checked = problem is None
        if problem is not None:
            state.waiting.append(f"{name}: {problem}")
        slow = self.streams.slow_words(vehicle)
        if slow is not None:
            state.notes.append(f"{name}: {slow}")

    def rows(self, problems: Sequence[str], now_ns: int) -> list[CheckRow]:
        """What was found, a row for each vehicle."""
        rates_hz = [rates.hz for rates in self.streams.rates]
        return check_rows(
            self._plan,
            self._station,
            self._frame,
            self.checks,
            rates_hz=rates_hz,
            checked=[found.checked for found in self._looks.found],
            problems=problems,
            now_ns=now_ns,
        )

    def _armed(self, vehicle: int, now_ns: int, state: GroundState) -> None:
        """Refuses a vehicle that is armed, when there was time to hear everybody and whether they are in the air."""
        fleet = self._station.fleet
        name = f"vehicle {self._plan.spec.vehicles[vehicle].id}"
        self.checks.armed(vehicle)
        landed = int(fleet.landed_state[vehicle])
        if landed == 0 and now_ns - self.streams.rates[vehicle].asked_ns >= SECOND_NS:
            self.streams.request(vehicle, now_ns)
        if not self._any_armed(True, now_ns, _ARMED_PATIENCE_NS):
            state.waiting.append(f"{name}: is armed; whether it is in the air is being found out")
        elif landed == LANDED_ON_GROUND:
            state.fatal.append(f"{name}: is armed already; disarm it before the mission")
        else:
            # Who disarms a vehicle that flies lets it fall.
            mode = self._plan.autopilots[vehicle].mode_name(int(fleet.custom_mode[vehicle]))
            where = f"is in the air, in {mode}" if landed else f"is armed, in {mode}, and may be in the air"
            state.fatal.append(f"{name}: {where}; {HELP_IN_THE_AIR}")

    def _tell_part(self, vehicle: int, now_ns: int, state: GroundState) -> None:
        """Tells of a companion, a camera or a ground station that speaks as if it were the autopilot."""
        part = self._station.fleet.senders.part(vehicle, now_ns)
        if part is not None:
            state.notes.append(
                f"vehicle {self._plan.spec.vehicles[vehicle].id}: under its id and component {AUTOPILOT_COMPID} speaks"
                f" also what is no autopilot, {part.words}; its heartbeats count for nothing; give it a component of"
                " its own"
            )

    # What is not well yet: each returns a problem in words, or None

    def _where_else(self, vehicle: int, now_ns: int) -> str:
        plan, fleet = self._plan, self._station.fleet
        component = fleet.senders.component(vehicle, now_ns)
        if component is not None:
            return (
                f"heard as component {component}, and an autopilot has to be component {AUTOPILOT_COMPID}; correct"
                " MAV_COMP_ID, or the program that speaks in its name"
            )
        part = fleet.senders.part(vehicle, now_ns)
        if part is not None:
            return f"heard under its id is only what is no autopilot, {part.words}; switch the autopilot on"
        sysid = plan.sysids[vehicle]
        other = [plan.links[link] for link in fleet.links_of(sysid, now_ns)]
        if other:
            return f"a system {sysid} is heard on {', '.join(other)}; correct its link"
        strangers = fleet.strangers(plan.link_of_vehicle[vehicle], now_ns)
        if strangers:
            return f"heard there instead: system {', '.join(map(str, strangers[:8]))}; correct its id or link"
        return "switch it on, or correct its id or link"

    def _deaf(self, vehicle: int, sight: _Sight) -> str | None:
        """Words for a vehicle that talks and answers no command: whatever else it lacks follows from that."""
        commands = self._station.commands
        if commands.unanswered[vehicle] < _UNANSWERED:
            return None
        if not commands.pending(vehicle) and self._probing.due(vehicle, sight.now_ns):
            # Any answer will do, a refusal too; otherwise one that hears again might never be asked again.
            self._probing.asked(vehicle, sight.now_ns)
            commands.request(vehicle, self._plan.autopilots[vehicle].once("AUTOPILOT_VERSION"))
        if sight.silent[vehicle]:
            return None  # it does not talk either
        since = "any more" if commands.answered[vehicle] else f"({commands.unanswered[vehicle]} so far)"
        return (
            f"is heard, and answers no command {since}; see that its link carries both ways, that it takes commands"
            f" from system {GROUND_STATION_SYSID}, and restart it"
        )

    def _heard(self, vehicle: int, sight: _Sight) -> str | None:
        fleet, limits, rates = self._station.fleet, self._plan.spec.limits, self.streams.rates[vehicle]
        now_ns = sight.now_ns
        if sight.silent[vehicle]:
            heard_s = age_s(now_ns, int(fleet.heard_ns[vehicle]))
            return f"last heard {heard_s:.1f} s ago, limit {limits.heartbeat_age_s:g} s; see to its link"
        if sight.stale[vehicle]:
            heartbeat_s = age_s(now_ns, int(fleet.heartbeat_ns[vehicle]))
            limit_s = HEARTBEAT_PATIENCE * limits.heartbeat_age_s
            return f"last heartbeat {heartbeat_s:.1f} s ago, limit {limit_s:g} s; restart it, or see to its link"
        pose_s = age_s(now_ns, int(sight.pose_ns[vehicle]))
        if pose_s > limits.pose_age_s:
            age = "none yet" if pose_s == np.inf else f"{pose_s:.2f} s old"
            sends = "none" if pose_s == np.inf else "none any more"
            yes = f"; it acknowledged the rates and sends {sends}" if self.streams.said_yes(vehicle) else ""
            return (
                f"position and attitude: {age}, limit {limits.pose_age_s:g} s{yes}; check its estimator and the message"
                " rates"
            )
        if not rates.good:
            if np.isnan(rates.hz).any():
                return "message rates asked for, not counted yet"
            planned = self._plan.rates_of(vehicle)
            return (
                f"sends {rates.hz[0]:.0f} positions and {rates.hz[1]:.0f} attitudes per second,"
                f" {planned.pose_hz:.0f} and {planned.attitude_hz:.0f} were asked for"
                f"{', and acknowledged' if self.streams.said_yes(vehicle) else ''}; is the link too slow, or lossy?"
            )
        return None

    def _readiness(self, vehicle: int, now_ns: int, said: Mapping[int, str]) -> str | None:
        fleet = self._station.fleet
        if not fleet.prearm_ok[vehicle]:
            self._leave_the_last_flight(vehicle, now_ns)
            self._ask_for_reason(vehicle, now_ns)
            return f"not ready to arm{self._reason(vehicle, now_ns, said.get(vehicle))}"
        self._reasons.unready.forget(vehicle)
        if fleet.landed_state[vehicle] != LANDED_ON_GROUND:
            state = int(fleet.landed_state[vehicle])
            return f"does not report to stand on the ground (landed state {state}); put it on its pad, or restart it"
        return None

    def _ask_for_reason(self, vehicle: int, now_ns: int) -> None:
        """Has a vehicle that cannot be armed say why, now and then: most say it once, or never unasked."""
        if not self._reasons.due(vehicle, now_ns) or self._station.commands.pending(vehicle):
            return
        self._reasons.asked(vehicle, now_ns)
        self._station.commands.request(vehicle, self._plan.autopilots[vehicle].run_prearm_checks())

    def _reason(self, vehicle: int, now_ns: int, words: str | None) -> str:
        """Why a vehicle cannot be armed, in its own words; the end of a sentence."""
        if words:
            return f": {words}; its own checks have to pass"
        if self._reasons.may_answer(vehicle, now_ns):
            return ", and has not said why yet; its own checks have to pass"
        return (
            ", and gives no reason (it was asked); see what QGroundControl or Mission Planner show of its checks, or"
            " restart it"
        )

    def _leave_the_last_flight(self, vehicle: int, now_ns: int) -> None:
        """Asks a vehicle that stands in the mode of its last flight, in which it cannot be armed, to leave it."""
        autopilot, mode = self._plan.autopilots[vehicle], int(self._station.fleet.custom_mode[vehicle])
        stuck = autopilot.is_streaming_mode(mode) or autopilot.is_landing_mode(mode)
        if stuck and self._mode_asking.due(vehicle, now_ns):
            self._mode_asking.asked(vehicle, now_ns)
            self._station.commands.request(vehicle, autopilot.idle_mode())

    def _clock(self, vehicle: int, now_ns: int, state: GroundState) -> str | None:
        clocks = self._station.fleet.clocks
        self._heard_of.note(vehicle, now_ns)
        if clocks.samples[vehicle] < _SYNC_SAMPLES and self._heard_of.began(vehicle, now_ns, _SYNC_PATIENCE_NS):
            return "clock asked for, not answered yet"
        if not clocks.known[vehicle]:
            state.notes.append(
                f"vehicle {self._plan.spec.vehicles[vehicle].id}: does not answer TIMESYNC; its positions are dated by"
                " their arrival"
            )
            return None
        trip_s = float(clocks.round_trip_s[vehicle])
        limit_s = self._plan.profile.delay_s + _ROUND_TRIP_SPARE_S
        if trip_s > limit_s:
            more_s = self._plan.spec.link_delay_s + trip_s - limit_s + 0.05
            return (
                f"its answers take {trip_s:.2f} s, limit {limit_s:.2f} s for the delay that r is kept with; use a"
                f" quicker link, or set link_delay_s: {more_s:.2f}"
            )
        # The quickest trip of late moves about: said once, with the first figure.
        fitted_s = 0.25 / approach_rate_1_s(self._plan.profile, self._plan.lead_s)
        if trip_s - self._plan.spec.link_delay_s > _ROUND_TRIP_CALM * fitted_s and not self._told_slow[vehicle]:
            self._told_slow[vehicle] = True
            state.notes.append(
                f"vehicle {self._plan.spec.vehicles[vehicle].id}: its answers take {trip_s:.2f} s, and the mission"
                f" reckons with link_delay_s: {self._plan.spec.link_delay_s:g}; the team may swing and not come"
                f" to rest in the formation; link_delay_s: {math.ceil(100.0 * trip_s - 1e-6) / 100.0:.2f} would make"
                " it calmer"
            )
        return None

    def _place(
        self,
        vehicle: int,
        now_ns: int,
        off_and_drift_m: tuple[float, float],
        positions: FloatArray,
        state: GroundState,
    ) -> str | None:
        fleet, plan = self._station.fleet, self._plan
        off_m, drift_m = off_and_drift_m
        first = self._frame.placement.hangs_on
        if first is not None and first != vehicle and plan.uses_gps(vehicle) and self._origins.in_doubt(first, now_ns):
            return None  # told of the first one, on which this place hangs
        if plan.uses_gps(vehicle) and plan.spec.vehicles[vehicle].position == "local":
            if self._origins.untold(vehicle):
                return "has not told its origin (GPS_GLOBAL_ORIGIN) yet; has it a GPS position?"
            if self._origins.in_doubt(vehicle, now_ns):
                return (
                    f"reports two different origins, {fleet.origin_moved_m[vehicle]:.2f} m apart; wait until its"
                    " estimator has settled, or restart it"
                )
            if (origin := self._origins.waiting(vehicle)) is not None:
                return origin
            if self._origins.derived(vehicle):
                state.notes.append(
                    f"vehicle {plan.spec.vehicles[vehicle].id}: does not tell its origin (GPS_GLOBAL_ORIGIN); it is"
                    " taken from its local and global positions"
                )
        if not self._frame.placement.known(vehicle):
            return "its place in the team frame is not known yet: no global position of the first vehicle"
        if drift_m > plan.limits.frame_drift_m:
            return (
                f"its local and global positions are {drift_m:.2f} m apart, limit {plan.limits.frame_drift_m:.2g} m;"
                " restart its estimator"
            )
        if not off_m <= plan.limits.pad_error_m:
            remedy = self._origins.what_to_correct(vehicle) or "put it on its pad, restart it there, or correct pad_m"
            words = self.checks.place_words(vehicle, positions) or f"; {remedy}"
            return f"reports a position {off_m:.2f} m from its pad, limit {plan.limits.pad_error_m:.3g} m{words}"
        return None
