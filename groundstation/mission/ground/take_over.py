"""Takes over vehicles that are in the air when the program starts: after a crash of the one that flew them.

Holds first, thinks later: whoever is armed and in the air gets setpoints to stand still as soon as its attitude is
known, and is asked into the mode that follows them. Where everybody is in the team's frame is found out while they
stand. Then the runner brings home those that can be.

What a mission settles on the ground has to be had again in the air. A vehicle sets its home where it takes off, and
that was its pad: HOME_POSITION, in its own frame or on earth, says where its frame lies, and whether it did take off
there. Where a vehicle does not tell its home, the origin that the mission declares is believed, and people are told so.

Refuses to fight: a vehicle that a pilot flies, or another ground station, is left alone. So is one whose place cannot
be known, and its own failsafe goes on.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from groundstation.core import frames
from groundstation.core.limits import Fence
from groundstation.core.types import BoolArray, FloatArray
from groundstation.mavlink.kinds import unflown_words
from groundstation.mavlink.station import Station
from groundstation.mavlink.vehicle import LANDED_IN_AIR, LANDED_LANDING, LANDED_ON_GROUND, NEVER
from groundstation.mission.flight.team_frame import TeamFrame
from groundstation.mission.ground.preflight import Preflight
from groundstation.mission.plan.plan import MissionPlan
from groundstation.mission.roster import Roster
from groundstation.mission.timing import SECOND_NS, AskAgain, Held, Since

LISTEN_NS = 5 * SECOND_NS
"""Time to hear everybody's heartbeat, whatever the links lose."""
_LISTEN_MAX_NS = 10 * SECOND_NS
"""So long those who stand safely wait for one that nobody has heard: it may just have lost its link."""
_STREAM_FIRST_NS = SECOND_NS  # PX4 wants about a second of setpoints before it takes OFFBOARD
_ASK_AGAIN_NS = SECOND_NS
_STREAMS_AGAIN_NS = 3 * SECOND_NS
_STEADY_NS = SECOND_NS
_OLD_NEWS_NS = 3 * SECOND_NS
_PATIENCE_NS = 20 * SECOND_NS
_HOME_PATIENCE_NS = 6 * SECOND_NS
_FENCE_TOLERANCE_M = 1.0


@dataclass
class TakeOverState:
    """How it is coming on.

    Attributes:
        waiting: what is still missing, a line for each vehicle.
        notes: worth knowing, said once.
        problems: why a vehicle is not brought home, a line for each; complete when ``done``.
        home: is brought home; meaningful when done, shape (n,).
        done: everybody that can be held is held.
    """

    home: BoolArray

    waiting: list[str] = field(default_factory=list)
    notes: list[str] = field(default_factory=list)
    problems: list[str] = field(default_factory=list)
    done: bool = False


class TakeOver:
    """The way of n vehicles from wherever they are to standing still under our setpoints.

    Args:
        plan: autopilots, pads, limits.
        station: what is asked goes out by it.
        frame: settled when everybody stands.
        preflight: knows which streams a vehicle is asked for.
        roster: whom it holds.
        start_ns: time at which it begins.

    Attributes:
        yaw_ned_rad: heading that is held, shape (n,).
    """

    def __init__(
        self,
        plan: MissionPlan,
        station: Station,
        frame: TeamFrame,
        preflight: Preflight,
        *,
        roster: Roster,
        start_ns: int,
    ) -> None:
        n = plan.size
        self._roster = roster
        self.yaw_ned_rad: FloatArray = np.zeros(n)
        self._plan, self._station, self._frame, self._preflight = plan, station, frame, preflight
        self._start_ns = start_ns
        self._taken = Since(n)
        self._held = [Held() for _ in range(n)]
        self._mode_asking = AskAgain(n, _ASK_AGAIN_NS)
        self._streams_asking = AskAgain(n, _STREAMS_AGAIN_NS)
        self._frame_asking = AskAgain(n, _ASK_AGAIN_NS)
        self._noted: set[str] = set()
        self._came_down: BoolArray = np.zeros(n, dtype=np.bool_)
        self._fence = Fence.from_enu(np.array(plan.spec.fence.min_m), np.array(plan.spec.fence.max_m))

    def step(self, now_ns: int, pos_team_ned_m: FloatArray) -> TakeOverState:
        """Asks for what is missing, and takes whom it can; whoever was killed by the operator is left alone.

        Args:
            now_ns: time of the tick.
            pos_team_ned_m: where the vehicles report to be at this tick, shape (n, 3).
        """
        roster = self._roster
        state = TakeOverState(home=np.zeros(self._plan.size, dtype=np.bool_))
        fleet = self._station.fleet
        off_m = self._frame.home_off_pad_m(fleet)
        pose_ns = self._frame.pose_ns(fleet)
        outside_m = self._fence.outside_m(pos_team_ned_m)
        late = now_ns - self._start_ns >= _PATIENCE_NS
        for vehicle, spec in enumerate(self._plan.spec.vehicles):
            name = f"vehicle {spec.id}"
            if not roster.ours[vehicle]:
                continue
            if fleet.heartbeat_ns[vehicle] == NEVER:
                if now_ns - self._start_ns < _LISTEN_MAX_NS:
                    state.waiting.append(f"{name}: no heartbeat on {spec.link} yet")
                else:
                    state.problems.append(
                        f"{name}: not heard, where it is is not known; look for it, and see to its link"
                    )
                continue
            self._ask(vehicle, now_ns, int(pose_ns[vehicle]))
            if self._on_the_ground(vehicle):
                self._came_down[vehicle] |= roster.steered[vehicle]
                roster.let_go(vehicle)
                if not fleet.armed[vehicle] and fleet.landed_state[vehicle] in (LANDED_IN_AIR, LANDED_LANDING):
                    state.problems.append(
                        f"{name}: its heartbeats say disarmed, its landed state that it flies; which is true is not"
                        " known, and it is not touched; keep people away, bring it down by its remote control"
                    )
                elif self._came_down[vehicle]:
                    state.problems.append(f"{name}: has come down by its own failsafe before it could be brought home")
                continue
            problem = self._not_ours(vehicle, now_ns)
            if problem is not None:
                roster.let_go(vehicle)
                (state.problems if late else state.waiting).append(f"{name}: {problem}")
                continue
            waiting = self._hold(vehicle, now_ns) or self._place(
                vehicle, now_ns, float(off_m[vehicle]), float(outside_m[vehicle]), state
            )
            if waiting is None and now_ns - int(pose_ns[vehicle]) > self._plan.spec.limits.pose_age_s * SECOND_NS:
                waiting = "no position yet"
            if waiting is None:
                state.home[vehicle] = True
            elif late:
                state.problems.append(f"{name}: {waiting}; it is left to its own failsafe, keep people away")
            else:
                state.waiting.append(f"{name}: {waiting}")
        state.done = not state.waiting and now_ns - self._start_ns >= LISTEN_NS
        state.notes = [note for note in state.notes if note not in self._noted]
        self._noted.update(state.notes)
        return state

    def gather_ned_m(self) -> FloatArray:
        """Where everybody flies to before landing: above its pad, shape (n, 3)."""
        above = frames.ned_from_enu(self._plan.pads_enu_m)
        above[:, 2] -= self._plan.spec.takeoff.height_m
        return above

    def _ask(self, vehicle: int, now_ns: int, pose_ns: int) -> None:
        """Asks for streams, and for where the vehicle's frame lies."""
        fleet, autopilot, commands = self._station.fleet, self._plan.autopilots[vehicle], self._station.commands
        told = min(pose_ns, int(fleet.status_ns[vehicle]))
        silent = now_ns - told > SECOND_NS or fleet.landed_state[vehicle] == 0
        if silent and self._streams_asking.due(vehicle, now_ns):
            self._streams_asking.asked(vehicle, now_ns)
            for message, rate_hz in self._preflight.streams.wanted_hz(vehicle).items():
                commands.request(vehicle, autopilot.message_interval(message, rate_hz))
        if commands.pending(vehicle) or not self._frame_asking.due(vehicle, now_ns):
            return
        self._frame_asking.asked(vehicle, now_ns)
        if np.isnan(fleet.home_deg_m[vehicle]).any() and np.isnan(fleet.home_local_ned_m[vehicle]).any():
            commands.request(vehicle, autopilot.once("HOME_POSITION"))
        elif np.isnan(fleet.origin_deg_m[vehicle]).any() and self._plan.uses_gps(vehicle):
            commands.request(vehicle, autopilot.once("GPS_GLOBAL_ORIGIN"))

    def _on_the_ground(self, vehicle: int) -> bool:
        fleet = self._station.fleet
        return not fleet.armed[vehicle] or bool(fleet.landed_state[vehicle] == LANDED_ON_GROUND)

    def _not_ours(self, vehicle: int, now_ns: int) -> str | None:
        """Why a vehicle in the air must not be touched, None when it may be."""
        fleet, autopilot = self._station.fleet, self._plan.autopilots[vehicle]
        mode = int(fleet.custom_mode[vehicle])
        if now_ns - fleet.heartbeat_ns[vehicle] > _OLD_NEWS_NS:
            return (
                f"last heartbeat {(now_ns - int(fleet.heartbeat_ns[vehicle])) / SECOND_NS:.1f} s ago; see to its link"
            )
        if fleet.autopilot[vehicle] != autopilot.mav_autopilot:
            return f"its heartbeat says MAV_AUTOPILOT {fleet.autopilot[vehicle]}; correct vehicles[{vehicle}].autopilot"
        kind = unflown_words(int(fleet.mav_type[vehicle]))
        if kind is not None:
            return f"{kind}; it is left alone: bring it down by its remote control"
        twin = fleet.twin(vehicle, now_ns)
        if twin is not None:
            return f"{twin}; neither is touched: bring them down by their remote controls"
        if autopilot.is_flown_by_pilot(mode, int(fleet.system_status[vehicle])):
            return f"is flown by a pilot, in mode {autopilot.mode_name(mode)}; it is not fought over"
        if not self._roster.steered[vehicle] and autopilot.is_followed_closely(mode, int(fleet.system_status[vehicle])):
            return (
                f"follows setpoints that are not ours, in mode {autopilot.mode_name(mode)}; end the other ground"
                " station first"
            )
        return None

    def _hold(self, vehicle: int, now_ns: int) -> str | None:
        """Lets a vehicle stand still; returns what is missing, None once it has stood for a second."""
        fleet, autopilot, commands = self._station.fleet, self._plan.autopilots[vehicle], self._station.commands
        if fleet.landed_state[vehicle] == 0:
            return "has not told whether it is in the air"
        if not self._roster.steered[vehicle]:
            if now_ns - fleet.attitude_ns[vehicle] > self._plan.spec.limits.pose_age_s * SECOND_NS:
                return "no attitude yet"
            self._roster.take(vehicle)
            self._taken.again(vehicle, now_ns)
            self._held[vehicle].forget()
            self.yaw_ned_rad[vehicle] = frames.yaw_ned_from_quat(fleet.quat_ned_from_frd)[vehicle]
        mode = int(fleet.custom_mode[vehicle])
        streaming = autopilot.is_streaming_mode(mode)
        held = self._held[vehicle](streaming, now_ns, _STEADY_NS)
        if streaming:
            return None if held and self._taken.held(vehicle, now_ns, _STREAM_FIRST_NS) else "is coming to a stand"
        if self._taken.held(vehicle, now_ns, _STREAM_FIRST_NS) and self._mode_asking.due(vehicle, now_ns):
            self._mode_asking.asked(vehicle, now_ns)
            commands.request(vehicle, autopilot.streaming_mode())
        return f"in mode {autopilot.mode_name(mode)}, asked for {autopilot.streaming_mode().name}"

    def _place(self, vehicle: int, now_ns: int, off_m: float, outside_m: float, state: TakeOverState) -> str | None:
        """Whether a vehicle's place is known in the team's frame; returns what is missing."""
        plan, name = self._plan, f"vehicle {self._plan.spec.vehicles[vehicle].id}"
        if not self._frame.placement.known(vehicle):
            return "its place in the team frame is not known: no origin, or no home on earth"
        if np.isnan(off_m):
            if plan.uses_gps(vehicle) or self._taken.began(vehicle, now_ns, _HOME_PATIENCE_NS):
                return "has not told where it took off (HOME_POSITION)"
            state.notes.append(
                f"{name}: does not tell where it took off; that its frame begins where the mission says is taken on"
                " trust"
            )
        elif off_m > plan.limits.pad_error_m:
            return (
                f"took off {off_m:.2f} m from its pad, limit {plan.limits.pad_error_m:.3g} m; is pad_m or its id right?"
            )
        if not outside_m <= _FENCE_TOLERANCE_M:
            return (
                f"reports a place {outside_m:.1f} m outside the fence, limit {_FENCE_TOLERANCE_M:g} m; its frame is not"
                " what the mission says"
            )
        return None
