"""MAVSDK, which nobody here wrote, flies vehicles of ``gs sitl`` over real sockets."""

from __future__ import annotations

import pytest

from tests.sitl.mavsdk_client import connected, wait_for
from tests.sitl.served import FASTER, free_udp_port, serving

pytest.importorskip("mavsdk", reason="MAVSDK has no wheel for this platform")

from mavsdk.plugins.action import Action, ActionError
from mavsdk.plugins.offboard import Offboard, PositionNedYaw, VelocityBodyYawspeed, VelocityNedYaw
from mavsdk.plugins.param import Param
from mavsdk.plugins.telemetry import Telemetry

ON_GROUND, IN_AIR = 1, 2
HOLD, OFFBOARD = 3, 7


def test_finds_eight_px4_arms_one_takes_off_flies_offboard_and_lands_it() -> None:
    port = free_udp_port()
    with serving("--vehicles", "8", "--port", str(port)), connected(f"udpin://127.0.0.1:{port}", 8) as systems:
        assert sorted(systems) == list(range(1, 9))
        system = systems[3]
        telemetry, action, offboard, param = Telemetry(system), Action(system), Offboard(system), Param(system)
        wait_for(telemetry, "health", lambda h: h.is_armable and h.is_local_position_ok and h.is_home_position_ok)

        assert param.get_param_float("MPC_LAND_SPEED") == pytest.approx(0.7)
        param.set_param_int("COM_LOW_BAT_ACT", 3)
        assert param.get_param_int("COM_LOW_BAT_ACT") == 3
        every = param.get_all_params()
        assert len(every.int_params) > 100
        assert len(every.float_params) > 200

        action.set_takeoff_altitude(1.5)
        assert action.get_takeoff_altitude() == pytest.approx(1.5)
        with pytest.raises(ActionError):
            action.goto_location(47.4, 8.5, 500.0, 0.0)  # on the ground: denied
        action.arm()
        action.takeoff()
        wait_for(telemetry, "position", lambda p: p.relative_altitude_m > 1.4)
        wait_for(telemetry, "flight_mode", lambda mode: mode == HOLD)

        offboard.set_velocity_ned(VelocityNedYaw(0.0, 0.0, 0.0, 0.0))
        offboard.start()
        assert offboard.is_active()
        offboard.set_velocity_ned(VelocityNedYaw(0.5, 0.0, 0.0, 0.0))
        moved = wait_for(telemetry, "position_velocity_ned", lambda p: p.position.north_m > 0.8)
        assert moved.velocity.north_m_s == pytest.approx(0.5, abs=0.1)
        assert moved.position.east_m == pytest.approx(0.0, abs=0.15)
        offboard.set_velocity_body(VelocityBodyYawspeed(0.0, 0.5, 0.0, 0.0))
        wait_for(telemetry, "position_velocity_ned", lambda p: p.position.east_m > 0.4)
        offboard.set_position_ned(PositionNedYaw(0.0, 0.0, -1.5, 90.0))
        wait_for(
            telemetry,
            "position_velocity_ned",
            lambda p: abs(p.position.north_m) < 0.15 and abs(p.position.east_m) < 0.15,
        )
        wait_for(telemetry, "attitude_euler", lambda a: abs(a.yaw_deg - 90.0) < 5.0)
        offboard.stop()
        action.hold()
        wait_for(telemetry, "flight_mode", lambda mode: mode == HOLD)
        action.land()
        wait_for(telemetry, "landed_state", lambda state: state == ON_GROUND)
        wait_for(telemetry, "armed", lambda armed: not armed)
        wait_for(telemetry, "flight_mode", lambda mode: mode == HOLD)  # what was wanted before the landing
        action.arm()


def test_flies_arducopter() -> None:
    port = free_udp_port()
    arguments = ("--vehicles", "2", "--autopilot", "arducopter", "--port", str(port), *FASTER)
    with serving(*arguments), connected(f"udpin://127.0.0.1:{port}", 2) as systems:
        system = systems[2]
        telemetry, action, offboard, param = Telemetry(system), Action(system), Offboard(system), Param(system)
        for name in ("position", "position_velocity_ned", "health", "landed_state", "attitude_euler"):
            rate = getattr(telemetry, f"set_rate_{name}", None)
            if rate is not None:
                rate(10.0)
        wait_for(telemetry, "position_velocity_ned", lambda _: True)
        assert param.get_param_float("GUID_TIMEOUT") == 3.0
        param.set_param_float("WPNAV_SPEED", 400.0)
        assert param.get_param_float("WPNAV_SPEED") == 400.0

        action.set_takeoff_altitude(1.5)
        offboard.set_velocity_ned(VelocityNedYaw(0.0, 0.0, 0.0, 0.0))
        offboard.start()  # GUIDED, in which arming and takeoff are allowed
        action.arm()
        action.takeoff()
        wait_for(telemetry, "position", lambda p: p.relative_altitude_m > 1.35)
        offboard.set_velocity_ned(VelocityNedYaw(0.0, 0.0, 0.0, 0.0))
        offboard.start()
        offboard.set_velocity_ned(VelocityNedYaw(0.0, 0.5, 0.0, 0.0))
        moved = wait_for(telemetry, "position_velocity_ned", lambda p: p.position.east_m > 0.8)
        assert moved.position.north_m == pytest.approx(0.0, abs=0.15)
        offboard.set_position_ned(PositionNedYaw(0.0, 0.0, -1.5, 0.0))
        wait_for(telemetry, "position_velocity_ned", lambda p: abs(p.position.east_m) < 0.2)
        offboard.stop()
        action.hold()
        action.land()
        wait_for(telemetry, "armed", lambda armed: not armed)
