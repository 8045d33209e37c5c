"""A pilot takes a vehicle over while it is landed: when else, if not when somebody walks under it? He is not fought."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial

import pytest
from pymavlink.dialects.v20 import ardupilotmega as dialect

from groundstation.mavlink.codec import Frame, FrameSplitter
from groundstation.mavlink.codec import message_id as id_of
from groundstation.mission.runner import Phase
from groundstation.mission.timing import SECOND_NS
from tests.app.flights import Flight, after, pair
from tests.mavlink.sender import Sender

Mode = tuple[float, float]
HOLD, POSCTL = (4.0, 3.0), (3.0, 0.0)  # PX4's main and sub mode
STABILIZE, LOITER = (0.0, 0.0), (5.0, 0.0)  # ArduCopter's mode number
COMMAND_LONG, SET_MODE = id_of("COMMAND_LONG"), 176


class Grabbed(Flight):
    """A pair of a PX4 and an ArduCopter; from an instant on both are in the hands of their pilots.

    Attributes:
        asked: commands that either vehicle is sent from then on.
    """

    def __init__(self, when: Callable[[Flight], bool], modes: tuple[Mode, Mode], again_s: float = 1e9) -> None:
        self.asked: list[int] = []
        self._since_ns = self._last_ns = -1
        super().__init__(pair(), interrupt_when=partial(self._grab, when, modes, again_s), limit_s=260.0)

    def _grab(self, when: Callable[[Flight], bool], modes: tuple[Mode, Mode], again_s: float, _: Flight) -> bool:
        """Sets the modes, and never interrupts."""
        due = when(self) if self._since_ns < 0 else self.now_ns - self._last_ns >= again_s * SECOND_NS
        if due:
            self._since_ns, self._last_ns = self.now_ns if self._since_ns < 0 else self._since_ns, self.now_ns
            for row, (main, sub) in enumerate(modes):
                pilot = Sender(250, 190)
                mode = dialect.MAVLink_command_long_message(row + 1, 1, SET_MODE, 0, 1, main, sub, 0, 0, 0, 0)
                self.world.receive(row, pilot.raw(mode), self.world.now_ns)
        return False

    def receive(self, vehicle_index: int, data: bytes, now_ns: int) -> None:
        """What the ground station sends, looked at."""
        if 0 <= self._since_ns < now_ns:
            for piece in FrameSplitter().feed(data):
                if isinstance(piece, Frame) and piece.msgid == COMMAND_LONG:
                    self.asked.append(dialect.MAVLink(None).parse_char(piece.raw).command)
        super().receive(vehicle_index, data, now_ns)


def _while_landing(flight: Flight) -> bool:
    """When both land by their own modes."""
    return [pilot.mode_name() for pilot in flight.world.autopilots] == ["AUTO.LAND", "LAND"]


@pytest.mark.parametrize(
    ("when", "modes", "again_s", "names"),
    [
        (_while_landing, (POSCTL, STABILIZE), 1e9, ("POSCTL", "STABILIZE")),
        (_while_landing, (HOLD, LOITER), 0.5, ("AUTO.LOITER", "LOITER")),
        # Just before landing would begin: nobody has been released by then.
        (after(Phase.RETURN, 2.4), (POSCTL, LOITER), 1e9, ("POSCTL", "LOITER")),
    ],
)
def test_who_is_taken_over_while_it_lands_is_let_go_and_asked_for_nothing(
    when: Callable[[Flight], bool], modes: tuple[Mode, Mode], again_s: float, names: tuple[str, str]
) -> None:
    """One second after it LAND was sent again, eleven times where he insisted, and nothing was said."""
    flight = Grabbed(when, modes, again_s)
    assert flight.asked == []
    assert [pilot.mode_name() for pilot in flight.world.autopilots] == list(names)
    assert flight.world.truth.airborne.all()
    assert flight.runner.outcome == "aborted"
    alarms = "\n".join(flight.texts("alarm"))
    assert "two senders" not in alarms
    for number, name in enumerate(names, 1):
        assert f"vehicle {number}: left for mode {name}; it is released and not fought over" in alarms
        assert f"vehicle {number} is still in the air, in {name}" in flight.runner.reason


def test_a_battery_that_lands_it_where_it_is_does_not_outdo_its_pilot() -> None:
    """PX4's status is critical then, as it is when a failsafe chooses a mode for sticks; none does while landing."""

    def lands(flight: Flight) -> bool:
        if flight.runner.phase is Phase.HOLD:
            for pilot in flight.world.autopilots:
                pilot.battery.left = min(pilot.battery.left, 0.04)
        return _while_landing(flight)

    flight = Grabbed(lands, (POSCTL, STABILIZE))
    assert flight.asked == []
    assert [pilot.mode_name() for pilot in flight.world.autopilots] == ["POSCTL", "STABILIZE"]
    assert "vehicle 1: left for mode POSCTL; it is released and not fought over" in "\n".join(flight.texts("alarm"))
