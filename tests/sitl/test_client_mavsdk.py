"""MAVSDK, which nobody here wrote, flies vehicles of ``gs sitl`` over real sockets."""

from __future__ import annotations

import pytest

from tests.sitl.mavsdk_client import connected, wait_for
from tests.sitl.served import free_udp_port, serving

pytest.importorskip("mavsdk", reason="MAVSDK has no wheel for this platform")

from mavsdk.plugins.action import Action
from mavsdk.plugins.offboard import Offboard, VelocityNedYaw
from mavsdk.plugins.telemetry import Telemetry

ON_GROUND, HOLD, OFFBOARD = 1, 3, 7


def test_finds_eight_px4_arms_one_takes_off_flies_offboard_and_lands_it() -> None:
    port = free_udp_port()
    with serving("--vehicles", "8", "--port", str(port)), connected(f"udpin://127.0.0.1:{port}", 8) as systems:
        assert sorted(systems) == list(range(1, 9))
        system = systems[3]
        telemetry, action, offboard = Telemetry(system), Action(system), Offboard(system)
        wait_for(telemetry, "health", lambda h: h.is_armable and h.is_local_position_ok and h.is_home_position_ok)
        action.set_takeoff_altitude(1.5)
        assert action.get_takeoff_altitude() == pytest.approx(1.5)
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
        offboard.stop()
        action.land()
        wait_for(telemetry, "landed_state", lambda state: state == ON_GROUND)
        wait_for(telemetry, "armed", lambda armed: not armed)
