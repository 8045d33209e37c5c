"""What is wrong in a world now: faults begin and end, and what overlaps adds up.

Refuses to read timetables: ``faults`` does.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

from sitl.autopilot import Autopilot
from sitl.config import SECOND
from sitl.faults import LINK_KINDS, VEHICLE_KINDS, Fault, FaultError
from sitl.network import Channel, LinkConfig
from sitl.state import HAS_FIX, State

_NEVER = 1 << 62
_STATES = set(VEHICLE_KINDS) - {"position_jump", "position_drift", "reboot", "battery_level", "clock_jump"}


class FaultDesk:
    """Begins and ends the faults of one state.

    Args:
        state: of the state.
        autopilots: the world's list, in which a reboot puts a new one.
        links: to and from each vehicle.
        reboot: powers a vehicle off and on.
        faults: the timetable.

    Attributes:
        active: what is wrong now, in order of beginning.
        next_ns: when something begins or ends next.
    """

    def __init__(
        self,
        state: State,
        autopilots: Sequence[Autopilot],
        links: Sequence[tuple[Channel, Channel]],
        reboot: Callable[[int], None],
        faults: Sequence[Fault],
    ) -> None:
        self._state, self._autopilots, self._links, self._reboot = state, autopilots, links, reboot
        self.active: list[tuple[Fault, int]] = []  # with the time of its end
        start_ns = state.config.start_ns
        self._waiting = sorted(
            ((start_ns + round(fault.at_s * SECOND), order, fault) for order, fault in enumerate(faults)), reverse=True
        )
        self._base = [(uplink.config, downlink.config) for uplink, downlink in links]
        self._check(faults)
        self._plan()

    def _check(self, faults: Sequence[Fault]) -> None:
        known = {vehicle.known_as for vehicle in self._state.config.vehicles}
        for fault in faults:
            for name in fault.vehicles:
                if name not in known:
                    raise FaultError(f"{fault.kind}: vehicles: {name} is not among the emulated ones")

    def _plan(self) -> None:
        begins = self._waiting[-1][0] if self._waiting else _NEVER
        self.next_ns = min([begins, *(end_ns for _, end_ns in self.active)])

    def act(self, now_ns: int) -> None:
        """Begins and ends what is due."""
        while self._waiting and self._waiting[-1][0] <= now_ns:
            at_ns, _, fault = self._waiting.pop()
            self._begin(fault, at_ns)
        for entry in [entry for entry in self.active if entry[1] <= now_ns]:
            self._end(entry)
        self._plan()

    def inject(self, *faults: Fault) -> None:
        """Begins faults now, whatever their ``at_s``; all, or none when a vehicle is not there (FaultError)."""
        self._check(faults)
        for fault in faults:
            self._begin(fault, self._state.now_ns)
        self._plan()

    def clear(self) -> None:
        """Ends everything that is wrong now; what has not begun is forgotten."""
        self._waiting.clear()
        for entry in list(self.active):
            self._end(entry)
        self._plan()

    def _indices(self, fault: Fault) -> list[int]:
        vehicles = self._state.config.vehicles
        return [i for i, vehicle in enumerate(vehicles) if not fault.vehicles or vehicle.known_as in fault.vehicles]

    def _begin(self, fault: Fault, at_ns: int) -> None:
        end_ns = _NEVER if fault.for_s is None else at_ns + round(fault.for_s * SECOND)
        self.active.append((fault, end_ns))
        self._apply(fault, True)

    def _end(self, entry: tuple[Fault, int]) -> None:
        self.active.remove(entry)
        self._apply(entry[0], False)

    def _apply(self, fault: Fault, on: bool) -> None:
        if fault.kind in LINK_KINDS:
            self._set_links()
            return
        for i in self._indices(fault):
            self._apply_to(fault, i, on)
        self._state.estimator.refresh()

    def _apply_to(self, fault: Fault, i: int, on: bool) -> None:
        estimator, kind = self._state.estimator, fault.kind
        if kind == "position_jump":
            jump = [fault.number(axis) for axis in ("east_m", "north_m", "up_m")]
            estimator.offset_enu_m[:, i] += jump if on else [-value for value in jump]
        elif kind == "position_drift":
            drift = [fault.number(axis) for axis in ("east_m_s", "north_m_s", "up_m_s")]
            estimator.drift_enu_m_s[:, i] += drift if on else [-value for value in drift]
        elif kind in _STATES:
            self._set_state(kind, i)
        elif on:
            self._once(fault, i)

    def _set_state(self, kind: str, i: int) -> None:
        """Gives a vehicle what all active faults of one kind add up to."""
        state, pilot = self._state, self._autopilots[i]
        faults = [fault for fault, _ in self.active if fault.kind == kind and i in self._indices(fault)]
        on = bool(faults)
        if kind == "position_frozen":
            if on and not state.broken.frozen[i]:
                state.broken.frozen_pos_enu_m[:, i] = pilot.body.senses.pos_enu_m
            state.broken.frozen[i] = on
        elif kind == "gps_lost":
            self._lose_gps(i, faults)
        elif kind == "position_nan":
            state.broken.invalid[i] = on
        elif kind == "heartbeat_missing":
            state.broken.muted["HEARTBEAT"][i] = on
        elif kind == "battery_drain":
            pilot.battery.extra_per_s = sum(fault.number("percent_per_s") for fault in faults) / 100.0
        elif kind == "motor_failure":
            state.dynamics.health.tumble(i, on)
            state.broken.motor_share[i] = min((fault.number("thrust_share") for fault in faults), default=1.0)
        elif kind == "arming_refused":
            pilot.deny_arming = on
        elif kind == "commands_ignored":
            pilot.ignore_commands = on

    def _lose_gps(self, i: int, faults: Sequence[Fault]) -> None:
        """Only one that lives by GPS goes astray without it."""
        state = self._state
        if not state.known.has_gps[i]:
            return
        was = int(state.broken.no_fix_ns[i])
        state.broken.no_fix_ns[i] = min(was, state.now_ns) if faults else HAS_FIX
        astray = [sum(fault.number(axis) for fault in faults) for axis in ("east_m_s2", "north_m_s2")]
        state.estimator.coast(i, [*astray, 0.0] if faults else None)

    def _once(self, fault: Fault, i: int) -> None:
        """The faults that happen at one moment."""
        if fault.kind == "reboot":
            self._reboot(i)
        elif fault.kind == "clock_jump":
            self._state.clocks.jump(i, round(fault.number("seconds") * SECOND))
        elif fault.kind == "battery_level":
            self._autopilots[i].battery.left = fault.number("percent") / 100.0

    def _set_links(self) -> None:
        """Gives every link what all active faults of it add up to."""
        for i, (channels, base) in enumerate(zip(self._links, self._base, strict=True)):
            for channel, config, direction in zip(channels, base, ("up", "down"), strict=True):
                changed = config
                for fault, _ in self.active:
                    concerns = fault.kind in LINK_KINDS and fault.direction in (direction, "both")
                    if concerns and i in self._indices(fault):
                        changed = _worsened(changed, fault)
                channel.config = changed


def _worsened(config: LinkConfig, fault: Fault) -> LinkConfig:
    """A link with one more fault: delays add up, of two probabilities the larger counts."""
    kind = fault.kind
    if kind == "blackout":
        return replace(config, blackout=True)
    if kind == "delay":
        return replace(config, delay_ns=config.delay_ns + round(fault.number("seconds") * SECOND))
    if kind == "jitter":
        return replace(config, jitter_ns=config.jitter_ns + round(fault.number("seconds") * SECOND))
    probability = fault.number("probability")
    if kind == "burst":
        return replace(
            config,
            burst_start=max(config.burst_start, probability),
            burst_ns=round(fault.number("length_s") * SECOND),
        )
    if kind == "reorder":
        return replace(
            config, reorder=max(config.reorder, probability), reorder_ns=round(fault.number("by_s") * SECOND)
        )
    return replace(config, **{kind: max(getattr(config, kind), probability)})
