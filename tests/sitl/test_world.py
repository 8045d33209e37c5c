"""The world as a sans-IO object: determinism, links, distances, robustness against any bytes."""

from __future__ import annotations

import dataclasses
import math
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from groundstation.mavlink.codec import Encoder, Frame, FrameSplitter, layout, message_id, message_name
from sitl.estimator import NOISELESS
from sitl.fleet import fleet, grid_pads
from sitl.network import LinkConfig
from sitl.world import Outgoing, VehicleConfig, World, WorldConfig
from tests.sitl.virtual_ground import Ground, hovering, world

TICK = 20_000_000


def flight(config: WorldConfig, seed: int, tick_ns: int = TICK) -> list[Outgoing]:
    """Six seconds in which all vehicles take off by velocity."""
    team = World(config, seed)
    encoder = Encoder(255, 190)
    out: list[Outgoing] = []
    for now_ns in range(0, 6_000_000_000, tick_ns):
        if now_ns % TICK == 0 and now_ns >= 2_300_000_000:
            for k, vehicle in enumerate(config.vehicles):
                setpoint = encoder.encode(
                    "SET_POSITION_TARGET_LOCAL_NED", target_system=vehicle.sysid, coordinate_frame=1,
                    type_mask=0x0DC7, vz=-0.3,
                )  # fmt: skip
                team.receive(k, setpoint, now_ns)
                for at_ns, number, params in ((2_500_000_000, 176, (1, 6)), (2_600_000_000, 400, (1, 0))):
                    if at_ns <= now_ns < at_ns + 200_000_000:  # repeated: the link may lose some
                        command = encoder.encode(
                            "COMMAND_LONG", target_system=vehicle.sysid, target_component=1, command=number,
                            param1=params[0], param2=params[1],
                        )  # fmt: skip
                        team.receive(k, command, now_ns)
        out += team.advance(now_ns + tick_ns)
    assert team.truth.airborne.all()
    return out


ROUGH = LinkConfig(delay_ns=15_000_000, jitter_ns=10_000_000, loss=0.05, duplicate=0.02, reorder=0.05, corrupt=0.02)


@pytest.mark.parametrize("link", [LinkConfig(), ROUGH])
def test_same_seed_and_same_bytes_in_give_same_bytes_out(link: LinkConfig) -> None:
    config = WorldConfig(vehicles=fleet(3), uplink=link, downlink=link)
    first, again, other = flight(config, 1), flight(config, 1), flight(config, 2)
    assert first == again
    assert first != other


def test_bytes_do_not_depend_on_how_often_time_is_advanced() -> None:
    config = WorldConfig(vehicles=fleet(2))
    assert flight(config, 1, TICK) == flight(config, 1, TICK // 5)


def test_outgoing_datagrams_are_in_order_of_time_also_with_jitter() -> None:
    times = [item.t_ns for item in flight(WorldConfig(vehicles=fleet(3), downlink=ROUGH), 3)]
    assert times == sorted(times)


def test_start_time_only_shifts_everything() -> None:
    config = WorldConfig(vehicles=fleet(1))
    early, late = World(config, 1), World(dataclasses.replace(config, start_ns=10**15), 1)
    assert [(o.t_ns, o.data) for o in early.advance(3 * 10**9)] == [
        (o.t_ns - 10**15, o.data) for o in late.advance(10**15 + 3 * 10**9)
    ]


def test_link_delay_both_ways() -> None:
    delay = LinkConfig(delay_ns=100_000_000)
    ground = Ground(world(uplink=delay, downlink=delay))
    ground.run(3.0)
    sent = ground.t_s
    ground.command(512, 148)
    ground.run(0.4)
    arrived = ground.all("AUTOPILOT_VERSION")[0][0]
    assert arrived - sent == pytest.approx(0.2, abs=0.005)


def test_smallest_distance_counts_pairs_of_which_one_is_in_the_air_and_every_physics_step() -> None:
    pads = ((0.0, 0.0, 0.0), (1.0, 0.0, 0.0), (3.0, 0.0, 0.0), (3.0, 9.0, 0.0), (3.0, 9.1, 0.0))
    ground = Ground(WorldConfig(vehicles=[VehicleConfig(k + 1, pad_enu_m=pad) for k, pad in enumerate(pads)]))
    ground.run(2.3)
    assert ground.world.min_distance_airborne_m == math.inf

    def lift(*vehicles: int) -> None:
        for vehicle in vehicles:
            ground.velocity(vz=-0.5, vehicle=vehicle)

    ground.stream = lambda: lift(0, 2)
    ground.run(0.1)
    for vehicle in (0, 2):
        ground.command(176, 1, 6, vehicle=vehicle)
        ground.command(400, 1, vehicle=vehicle)
    ground.run(4.0)
    # The second stands 1 m beside the first, which lifts off; the last two stand beside each other and do not count.
    pairs = ground.world.min_distance_airborne_of_pairs_m()
    assert ground.world.min_distance_airborne_m == pairs[0, 1] == pytest.approx(1.0, abs=0.02)
    assert pairs[0, 2] == pytest.approx(3.0, abs=0.1)
    assert pairs[3, 4] == math.inf
    ground.world.reset_min_distance()
    assert ground.world.min_distance_airborne_m == math.inf
    smallest = math.inf
    for _ in range(500):
        ground.velocity(vx=0.0, vy=0.6, vehicle=0)
        ground.velocity(vx=0.0, vy=-0.6, vehicle=2)
        ground.now_ns += 4_000_000
        ground.world.advance(ground.now_ns)
        pos = ground.world.truth.pos_enu_m
        smallest = min(smallest, float(np.linalg.norm(pos[0] - pos[2])))
    assert ground.world.min_distance_airborne_of_pairs_m()[0, 2] == pytest.approx(smallest, abs=1e-12)
    assert smallest < 1.5


def test_truth_agrees_with_what_a_noiseless_vehicle_reports() -> None:
    ground = hovering(2.0)
    ground.stream = lambda: ground.velocity(0.4, -0.3, -0.1)
    ground.run(3.0)
    truth = ground.world.truth
    local = ground.last("LOCAL_POSITION_NED")
    assert (local.y, local.x, -local.z) == pytest.approx(tuple(truth.pos_enu_m[0]), abs=0.02)
    assert (local.vy, local.vx, -local.vz) == pytest.approx(tuple(truth.vel_enu_m_s[0]), abs=0.01)
    assert truth.vel_enu_m_s[0] == pytest.approx([-0.3, 0.4, 0.1], abs=0.02)
    attitude = ground.last("ATTITUDE")
    w, x, y, z = truth.quat[0]
    assert attitude.roll == pytest.approx(math.atan2(2 * (w * x + y * z), 1 - 2 * (x * x + y * y)), abs=0.01)
    assert attitude.pitch == pytest.approx(math.asin(2 * (w * y - z * x)), abs=0.01)


def test_default_pads() -> None:
    assert [pad[:2] for pad in grid_pads(8)] == [
        (-1, -1), (0, -1), (1, -1), (-1, 0), (0, 0), (1, 0), (-1, 1), (0, 1),
    ]  # fmt: skip
    assert grid_pads(1) == [(0.0, 0.0, 0.0)]


@pytest.mark.parametrize(
    ("vehicles", "words"),
    [
        ([VehicleConfig(1), VehicleConfig(1)], "sysid 1 is taken"),
        ([VehicleConfig(0)], "sysid is 0"),
        ([VehicleConfig(1, profile="brick")], "profile is 'brick'"),
        ([VehicleConfig(1, autopilot="inav")], "autopilot is 'inav'"),
    ],
)
def test_wrong_configurations_are_named(vehicles: list[VehicleConfig], words: str) -> None:
    with pytest.raises(ValueError, match=words):
        World(WorldConfig(vehicles=vehicles), 1)
    with pytest.raises(ValueError, match="vehicles: 300"):
        fleet(300)


ANY_FLOAT = st.floats(width=32, allow_nan=True, allow_infinity=True)


@settings(max_examples=60, deadline=None)
@given(
    st.lists(
        st.one_of(
            st.binary(max_size=300),
            st.tuples(
                st.just("COMMAND_LONG"),
                st.integers(0, 65535) | st.sampled_from([22, 176, 179, 192, 400, 511]),
                st.lists(ANY_FLOAT, min_size=7, max_size=7),
            ),
            st.tuples(
                st.just("SET_POSITION_TARGET_LOCAL_NED"), st.integers(0, 65535),
                st.lists(ANY_FLOAT, min_size=11, max_size=11),
            ),
            st.tuples(st.just("PARAM_SET"), st.sampled_from([1, 6, 9]), st.lists(ANY_FLOAT, min_size=1, max_size=1)),
        ),
        max_size=12,
    )
)  # fmt: skip
def test_no_bytes_break_it(inputs: list[bytes | tuple[str, int, list[float]]]) -> None:
    ground = Ground(world(streams="radio"))
    ground.run(2.2)
    ground.send("COMMAND_LONG", target_system=1, target_component=1, command=400, param1=1)
    for item in inputs:
        if isinstance(item, bytes):
            ground.world.receive(0, item, ground.now_ns)
        elif item[0] == "COMMAND_LONG":
            ground.command(item[1], *item[2])
        elif item[0] == "PARAM_SET":
            ground.send(
                "PARAM_SET", target_system=1, param_id=b"MPC_LAND_SPEED", param_type=item[1], param_value=item[2][0]
            )
        else:
            names = ("x", "y", "z", "vx", "vy", "vz", "afx", "afy", "afz", "yaw", "yaw_rate")
            fields: dict[str, Any] = {"coordinate_frame": 1 + 7 * (item[1] % 2), "type_mask": item[1]}
            fields.update(zip(names, item[2], strict=True))
            ground.send("SET_POSITION_TARGET_LOCAL_NED", target_system=1, **fields)
        ground.run(0.06)
    ground.run(1.0)
    assert np.isfinite(ground.world.truth.pos_enu_m).all()
    assert ground.last("HEARTBEAT").type == 2


@settings(max_examples=25, deadline=None)
@given(st.sampled_from(["px4", "arducopter"]), st.integers(0, 2**32 - 1), st.booleans())
def test_no_frame_of_any_type_breaks_it(autopilot: str, seed: int, flying: bool) -> None:
    rng = np.random.default_rng(seed)
    ground = Ground(world(autopilot=autopilot, streams="radio"))
    pilot = ground.world.autopilots[0]
    ground.run(2.2)
    if flying:
        pilot.arm()
        pilot.body.motors.flying = True
        ground.world.dynamics.motion.pos_enu_m[2, 0] = 3.0
        ground.run(0.1)
    for _ in range(60):
        shape = layout(message_name(int(rng.choice(list(pilot.messages)))) or "")
        values = np.frombuffer(rng.bytes(shape.size), dtype=shape.dtype).copy()
        if rng.random() < 0.7:
            for name in {"target_system", "target_component"} & set(shape.field_names):
                values[name] = 1
            if "command" in shape.field_names and rng.random() < 0.9:
                values["command"] = rng.choice(list(pilot.commands))
            if "coordinate_frame" in shape.field_names:
                values["coordinate_frame"] = rng.choice([1, 7, 8, 9])
        ground.world.receive(0, ground.encoder.frame(shape, values.tobytes()), ground.now_ns)
        ground.run(0.04)
        pilot = ground.world.autopilots[0]  # a reboot makes a new one
    ground.run(1.0)
    assert np.isfinite(ground.world.truth.pos_enu_m).all()
    assert np.isfinite(ground.world.truth.quat).all()


def test_pads_on_posts_carry_who_stands_on_them_and_can_be_drawn_in() -> None:
    pads = ((0.0, 0.0, 2.0), (3.0, 0.0, 1.0), (6.0, 0.0, 0.0))
    config = WorldConfig(
        vehicles=tuple(VehicleConfig(sysid=i + 1, pad_enu_m=pad, noise=NOISELESS) for i, pad in enumerate(pads)),
        floor_m=0.0,
    )
    team = World(config, 1)
    dynamics = team.dynamics

    def fly(until_s: float, *velocities: tuple[float, float, float]) -> None:
        dynamics.commands.flying[:] = True
        dynamics.commands.vel_sp_enu_m_s[:] = np.array(velocities).T
        team.advance(round(until_s * 1e9))

    fly(2.0, (0.0, 0.0, 0.5), (0.0, 0.0, 0.5), (0.0, 0.0, 0.0))
    assert dynamics.motion.pos_enu_m[2].tolist() == pytest.approx([2.9, 1.9, 0.0], abs=0.15)
    # The first comes down beside its post, to the floor; the second onto its own.
    fly(5.0, (0.5, 0.0, 0.0), (0.0, 0.0, -0.5), (0.0, 0.0, 0.0))
    fly(13.0, (0.0, 0.0, -0.5), (0.0, 0.0, -0.5), (0.0, 0.0, 0.0))
    assert dynamics.motion.pos_enu_m[2].tolist() == pytest.approx([0.0, 1.0, 0.0], abs=1e-6)
    # Posts that are drawn in leave whoever stands on one standing; who has left it finds the floor.
    dynamics.ground.posts_up = False
    fly(14.0, (0.0, 0.0, 0.0), (0.0, 0.0, 0.0), (0.0, 0.0, 0.0))
    assert dynamics.motion.pos_enu_m[2, 1] == pytest.approx(1.0, abs=0.01)
    fly(15.0, (0.0, 0.0, 0.0), (0.0, 0.0, 0.5), (0.0, 0.0, 0.0))
    fly(21.0, (0.0, 0.0, 0.0), (0.0, 0.0, -0.5), (0.0, 0.0, 0.0))
    assert dynamics.motion.pos_enu_m[2, 1] == pytest.approx(0.0, abs=1e-6)


def test_whoever_comes_down_on_one_that_has_landed_is_seen_to() -> None:
    team = World(WorldConfig(vehicles=tuple(VehicleConfig(k + 1, pad_enu_m=(2.0 * k, 0.0, 0.0)) for k in range(2))), 1)
    team.dynamics.commands.flying[0] = True

    def fly(seconds: float, east: float, up: float) -> None:
        team.dynamics.commands.vel_sp_enu_m_s[:, 0] = (east, 0.0, up)
        team.advance(team.now_ns + round(seconds * 1e9))

    fly(3.0, 0.0, 0.5)
    fly(4.0, 0.5, 0.0)
    fly(1.0, 0.0, 0.0)  # over the one that stands
    assert team.truth.airborne.tolist() == [True, False]
    over_m = float(np.linalg.norm(team.truth.pos_enu_m[0] - team.truth.pos_enu_m[1]))
    assert team.min_distance_airborne_m == pytest.approx(over_m, abs=0.1)
    fly(6.0, 0.0, -0.5)
    assert not team.truth.airborne.any()
    assert team.min_distance_airborne_m < 0.1
    there_m = team.min_distance_airborne_m
    team.advance(team.now_ns + 2_000_000_000)
    assert team.min_distance_airborne_m == there_m


def test_smallest_distances_of_pairs_agree_with_the_smallest_of_all() -> None:
    config = WorldConfig(
        vehicles=tuple(VehicleConfig(sysid=i + 1, pad_enu_m=(float(i * i), 0.0, 0.0)) for i in range(3))
    )
    team = World(config, 1)
    assert np.isinf(team.min_distance_airborne_of_pairs_m()).all()
    team.dynamics.commands.flying[:2] = True
    team.dynamics.commands.vel_sp_enu_m_s[2] = 0.5
    team.advance(1_000_000_000)
    pairs = team.min_distance_airborne_of_pairs_m()
    assert pairs[0, 1] == pairs[1, 0] == team.min_distance_airborne_m < 1.1
    assert pairs[0, 2] == pytest.approx(4.0, abs=0.1)  # the third stands
    assert math.isinf(pairs[2, 2])
    team.reset_min_distance()
    assert team.min_distance_airborne_m == np.inf


def test_quiet_vehicles_say_nothing_unasked_but_their_heartbeat() -> None:
    team = World(WorldConfig(vehicles=(VehicleConfig(sysid=1, streams="quiet"),)), 1)
    splitter = FrameSplitter()
    frames = [piece for sent in team.advance(10_000_000_000) for piece in splitter.feed(sent.data)]
    names = {frame.msgid for frame in frames if isinstance(frame, Frame)}
    assert message_id("HEARTBEAT") in names
    assert names <= {message_id("HEARTBEAT"), message_id("STATUSTEXT")}
