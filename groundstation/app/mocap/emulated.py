"""The emulated team of a dry run: vehicles, the gateway of those that need one, and a fake motion capture system."""

from __future__ import annotations

from groundstation.app.gateway.emulated import GatewayWorld, RadioConfig
from groundstation.app.mocap.fake import FakeConfig, FakeRoom, aside
from groundstation.core import frames
from groundstation.mission.plan.plan import MissionPlan
from sitl.world import Outgoing, World


class RoomWorld:
    """A team in a room whose motion capture system sees it; what that tells comes as from vehicle n.

    Args:
        team: the vehicles.
        world: the truth.
        room: what sees it.

    Attributes:
        team: the vehicles.
    """

    def __init__(self, team: GatewayWorld, world: World, room: FakeRoom) -> None:
        self.team, self._world, self.room = team, world, room
        self._next_ns = self._now_ns = world.now_ns
        self._under_way: list[Outgoing] = []

    def advance(self, now_ns: int) -> list[Outgoing]:
        """Moves everything to a time; returns what reached the ground station on the way."""
        told: list[Outgoing] = []
        while self._next_ns <= now_ns:
            told += self.team.advance(self._next_ns)
            truth = self._world.truth
            seen = self.room.sees(self._next_ns, frames.ned_from_enu(truth.pos_enu_m), truth.quat_ned_from_frd)
            if seen is not None and seen[1]:
                self._under_way.append(Outgoing(seen[0], self._world.n, seen[1]))
            self._next_ns += self.room.period_ns
        told += self.team.advance(now_ns)
        told += [item for item in self._under_way if item.t_ns <= now_ns]
        self._under_way = [item for item in self._under_way if item.t_ns > now_ns]
        return sorted(told, key=lambda item: item.t_ns)

    def receive(self, vehicle_index: int, data: bytes, now_ns: int) -> None:
        """Hands in what the ground station sent to a vehicle."""
        self.team.receive(vehicle_index, data, now_ns)


def emulated_team(
    plan: MissionPlan,
    world: World,
    seed: int,
    fake: FakeConfig | None = None,
    radio: RadioConfig | None = None,
) -> GatewayWorld | RoomWorld:
    """The other end of a dry run.

    Args:
        plan: whether there is a room.
        world: the emulator.
        seed: of the fake system's noise.
        fake: what that is like; None as it is at its best.
        radio: what vehicles behind a gateway are reached by; None for links that carry everything at once.
    """
    team = GatewayWorld(world, radio=radio)
    room = plan.room()
    if room is None:
        return team
    config = fake or FakeConfig(names=not room.by_place, others=aside(plan))
    return RoomWorld(team, world, FakeRoom(config, room.ids, seed))
