"""pymavlink's mavutil in a plain script, in the manner of the public examples: connect, arm, take off, move, land."""

from __future__ import annotations

import time
from typing import Any

import pytest
from pymavlink import mavutil

from tests.sitl.served import FASTER, free_udp_port, serving

MAV = mavutil.mavlink
LIMIT_S = 20.0


def _wait(link: Any, kind: str, condition: Any = None) -> Any:
    message = link.recv_match(type=kind, condition=condition, blocking=True, timeout=LIMIT_S)
    assert message is not None, f"no {kind} with {condition} within {LIMIT_S} s"
    return message


def _command(link: Any, number: int, *params: float) -> int:
    padded = [*params, *[0.0] * (7 - len(params))]
    link.mav.command_long_send(link.target_system, link.target_component, number, 0, *padded)
    return int(_wait(link, "COMMAND_ACK", f"COMMAND_ACK.command=={number}").result)


def _fly_north(link: Any, metres: float, keep_alive: bool = True) -> None:
    """Streams a velocity at 20 Hz until the vehicle has got there."""
    deadline = time.monotonic() + LIMIT_S
    start = _wait(link, "LOCAL_POSITION_NED")
    while time.monotonic() < deadline:
        link.mav.set_position_target_local_ned_send(
            0, link.target_system, link.target_component, MAV.MAV_FRAME_LOCAL_NED, 0x0DC7,
            0, 0, 0, 0.5, 0, 0, 0, 0, 0, 0, 0,
        )  # fmt: skip
        message = link.recv_match(type="LOCAL_POSITION_NED", blocking=True, timeout=0.05)
        if message is not None and message.x - start.x > metres:
            return
    raise AssertionError(f"did not get {metres} m north within {LIMIT_S} s")


def _all_parameters(link: Any) -> dict[str, float]:
    link.param_fetch_all()
    values: dict[str, float] = {}
    count = 1
    while len(values) < count:
        message = _wait(link, "PARAM_VALUE")
        count = message.param_count
        values[message.param_id] = message.param_value
    return values


def test_arducopter_in_the_manner_of_the_examples() -> None:
    port = free_udp_port()
    with serving("--vehicles", "1", "--autopilot", "arducopter", "--port", str(port), *FASTER):
        link = mavutil.mavlink_connection(f"udpin:127.0.0.1:{port}")
        link.wait_heartbeat(timeout=LIMIT_S)
        assert link.target_system == 1
        link.mav.request_data_stream_send(1, 1, MAV.MAV_DATA_STREAM_ALL, 20, 1)
        parameters = _all_parameters(link)
        assert len(parameters) > 300
        assert parameters["GUID_TIMEOUT"] == 3.0
        _wait(link, "LOCAL_POSITION_NED")
        link.set_mode("GUIDED")
        _wait(link, "HEARTBEAT", "HEARTBEAT.custom_mode==4")
        link.arducopter_arm()
        assert _wait(link, "COMMAND_ACK", "COMMAND_ACK.command==400").result == 0
        link.motors_armed_wait()
        assert _command(link, MAV.MAV_CMD_NAV_TAKEOFF, 0, 0, 0, 0, 0, 0, 1.5) == 0
        _wait(link, "GLOBAL_POSITION_INT", "GLOBAL_POSITION_INT.relative_alt>1350")
        _fly_north(link, 1.0)
        link.set_mode("LAND")
        _wait(link, "HEARTBEAT", "HEARTBEAT.custom_mode==9")
        link.motors_disarmed_wait()
        link.close()


def test_px4_in_the_manner_of_the_examples() -> None:
    port = free_udp_port()
    with serving("--vehicles", "1", "--port", str(port), *FASTER):
        link = mavutil.mavlink_connection(f"udpin:127.0.0.1:{port}")
        link.wait_heartbeat(timeout=LIMIT_S)
        assert len(_all_parameters(link)) > 300
        _wait(link, "SYS_STATUS", f"SYS_STATUS.onboard_control_sensors_health&{0x10000000}")
        home = _wait(link, "HOME_POSITION")
        assert _command(link, MAV.MAV_CMD_COMPONENT_ARM_DISARM, 1) == 0
        nan = float("nan")
        height = home.altitude / 1000 + 2.5
        assert _command(link, MAV.MAV_CMD_NAV_TAKEOFF, 0, 0, 0, nan, nan, nan, height) == 0
        _wait(link, "HEARTBEAT", "HEARTBEAT.custom_mode==50593792")  # AUTO.LOITER: it has arrived
        link.mav.set_position_target_local_ned_send(0, 1, 1, 1, 0x0DC7, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0)
        assert _command(link, MAV.MAV_CMD_DO_SET_MODE, 1, 6) == 0
        _fly_north(link, 1.0)
        assert _command(link, MAV.MAV_CMD_NAV_LAND, 0, 0, 0, nan, nan, nan, nan) == 0
        _wait(link, "EXTENDED_SYS_STATE", "EXTENDED_SYS_STATE.landed_state==1")
        link.motors_disarmed_wait()
        link.close()


def test_refusals_have_the_right_codes_for_a_foreign_parser() -> None:
    port = free_udp_port()
    with serving("--vehicles", "1", "--port", str(port), *FASTER):
        link = mavutil.mavlink_connection(f"udpin:127.0.0.1:{port}")
        link.wait_heartbeat(timeout=LIMIT_S)
        _wait(link, "SYS_STATUS", f"SYS_STATUS.onboard_control_sensors_health&{0x10000000}")
        assert _command(link, 31010) == MAV.MAV_RESULT_UNSUPPORTED
        assert _command(link, MAV.MAV_CMD_DO_SET_MODE, 1, 6) == 0
        assert _command(link, MAV.MAV_CMD_COMPONENT_ARM_DISARM, 1) == MAV.MAV_RESULT_TEMPORARILY_REJECTED
        last = link.messages["STATUSTEXT"]  # the second chunk of "Arming denied: Resolve system health failures first"
        assert (last.severity, last.chunk_seq, last.text) == (2, 1, "t\t")
        link.close()


@pytest.mark.parametrize("wire", ["1", "2"])
def test_both_versions_of_mavlink_for_a_foreign_parser(wire: str) -> None:
    port = free_udp_port()
    with serving("--vehicles", "1", "--port", str(port), *FASTER, "--mavlink", wire):
        link = mavutil.mavlink_connection(f"udpin:127.0.0.1:{port}")
        assert link.wait_heartbeat(timeout=LIMIT_S) is not None
        raw = _wait(link, "LOCAL_POSITION_NED").get_msgbuf()
        assert raw[0] == {"1": 0xFE, "2": 0xFD}[wire]
        link.close()
