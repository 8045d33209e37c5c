"""``gs mocap fake``: a mission's emulated team on real sockets, and what a motion capture system would see of it."""

from __future__ import annotations

from collections.abc import Callable, Sequence

from groundstation.app.emulator import world_config
from groundstation.app.mocap.fake import FakeConfig, FakeRoom, RoomFault, aside
from groundstation.core import frames
from groundstation.core.errors import UserError
from groundstation.mission.plan.plan import MissionPlan
from sitl.personalities import PERSONALITIES
from sitl.server import Server

_KINDS = ("occlude", "swap", "jump", "freeze", "gone")
_PORT = 14540


class ServedRoom:
    """What sees a served team.

    Args:
        room: makes the frames.

    Attributes:
        sent: how many there were.
    """

    def __init__(self, room: FakeRoom) -> None:
        self._room = room
        self._begun_ns: int | None = None
        self.sent = 0

    def status(self, send: Callable[[bytes], None]) -> Callable[[Server], None]:
        """What a server is to call for each frame."""

        def look(server: Server) -> None:
            world = server.world
            truth = world.truth
            self._begun_ns = world.now_ns if self._begun_ns is None else self._begun_ns
            seen = self._room.sees(
                world.now_ns - self._begun_ns, frames.ned_from_enu(truth.pos_enu_m), truth.quat_ned_from_frd
            )
            if seen is not None and seen[1]:
                send(seen[1])
                self.sent += 1

        return look


def fake_server(
    plan: MissionPlan, seed: int, port: int | None, *, hz: float, noise_m: float, faults: Sequence[RoomFault]
) -> tuple[Server, ServedRoom]:
    """The team of a mission, on its ports, and its room.

    Raises:
        UserError: a port is taken.
    """
    config = world_config(plan, seed)
    kind = PERSONALITIES[config.vehicles[0].autopilot]
    port = port or kind.first_port or next((address.port for address in plan.addresses), _PORT)
    room = plan.room()
    names = room is None or not room.by_place
    fake = FakeConfig(hz=hz, noise_m=noise_m, names=names, faults=faults, others=aside(plan))
    sees = FakeRoom(fake, [vehicle.sysid for vehicle in config.vehicles], seed)
    try:
        return Server(config, seed, port=port), ServedRoom(sees)
    except (OSError, ValueError) as error:
        raise UserError(f"gs mocap fake: {error}") from error


def read_faults(words: Sequence[str], plan: MissionPlan) -> list[RoomFault]:
    """Faults of the command line.

    Raises:
        UserError: another form, or a vehicle that is not there.
    """
    rows = {vehicle.id: row for row, vehicle in enumerate(plan.spec.vehicles)}
    found = []
    for word in words:
        kind, *rest = word.split(":")
        try:
            at_s, until_s = float(rest[0]), float(rest[1])
            concerned = tuple(rows[int(item)] for item in (rest[2].split(",") if len(rest) > 2 else ()))
        except (ValueError, IndexError, KeyError):
            kind = ""
        if kind not in _KINDS or (kind == "swap" and len(concerned) != 2):
            raise UserError(
                f"--fault {word}: expected KIND:FROM:UNTIL:IDS with one of {', '.join(_KINDS)}, seconds, and ids of the"
                " mission's vehicles (two for swap), for example occlude:20:23:3"
            )
        found.append(RoomFault(kind, at_s, until_s, concerned))
    return found
