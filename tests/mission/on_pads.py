"""Two vehicles that stand on their pads, 2.5 m west and east of the middle, and are well as far as telemetry tells."""

from __future__ import annotations

import math

from groundstation.mavlink.vehicle import LANDED_ON_GROUND, Fleet
from groundstation.mission.flight.team_frame import TeamFrame
from groundstation.mission.plan.plan import MissionPlan
from groundstation.mission.timing import SECOND_NS

LAT_DEG, LON_DEG, HEIGHT_M = 47.0, 8.0, 400.0
EAST_5_M_DEG = 5.0 / (6_388_700.0 * math.cos(math.radians(LAT_DEG)) * math.pi / 180.0)  # radius across the meridian
NORTH_1_M_DEG = 1.0 / (6_369_400.0 * math.pi / 180.0)  # radius along the meridian, at that latitude


def standing(plan: MissionPlan) -> Fleet:
    """Both stand on their pads, 5 m apart, where their local frames begin; all of it was told at 1 s."""
    fleet = Fleet([vehicle.id for vehicle in plan.spec.vehicles], plan.link_of_vehicle)
    fleet.place_deg_m[:] = [(LAT_DEG, LON_DEG, HEIGHT_M), (LAT_DEG, LON_DEG + EAST_5_M_DEG, HEIGHT_M)]
    fleet.origin_deg_m[:] = fleet.place_deg_m
    fleet.pos_local_ned_m[:] = fleet.vel_ned_m_s[:] = fleet.place_vel_ned_m_s[:] = 0.0
    for told_ns in (fleet.pose_ns, fleet.place_ns, fleet.attitude_ns, fleet.heard_ns, fleet.heartbeat_ns):
        told_ns[:] = SECOND_NS
    fleet.mav_type[:] = 2  # MAV_TYPE_QUADROTOR
    fleet.autopilot[:] = [autopilot.mav_autopilot for autopilot in plan.autopilots]
    fleet.landed_state[:] = LANDED_ON_GROUND
    return fleet


def looked_at(plan: MissionPlan, fleet: Fleet) -> TeamFrame:
    """The team's frame, after a look at where they stand."""
    frame = TeamFrame(plan)
    frame.placement.look(fleet, SECOND_NS)
    return frame
