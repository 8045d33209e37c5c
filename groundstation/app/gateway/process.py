"""The gateway of a flight: a process of its own, begun with it, watched, and replaced when it dies.

A second one waits, loaded, so that it can take over before the firmware lets anybody fall (2 s). The flight tells the
new one who flies, so that these are told to stay before anything else is asked of them. A flight that is killed leaves
its gateway behind until nobody flies any more: it holds, lands or returns them as it was set to.
"""

from __future__ import annotations

import os
import subprocess
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path

from groundstation.app.session import Session
from groundstation.core.errors import UserError
from groundstation.core.extras import need
from groundstation.gateway.budget import Rates, capacity, check
from groundstation.gateway.handover import Handover, RoomWord, written
from groundstation.gateway.settings import LIMITS
from groundstation.mavlink.addresses import parse_address, radio_of
from groundstation.mavlink.vehicle import LANDED_ON_GROUND
from groundstation.mission.ground.failsafe import make_failsafe
from groundstation.mission.plan.plan import MissionPlan
from groundstation.mocap.bodies import relay_port

_CACHE = ".crazyflie_cache"
_AGAIN_NS, _AGAIN_MAX_NS = 1_000_000_000, 16_000_000_000
_SPARE_NS = 5_000_000_000  # the one that serves has the machine to itself while it connects
_END_S = 3.0
_LINE_MAX = 400
Start = Callable[[list[str]], "subprocess.Popen[bytes]"]


def rates_of(plan: MissionPlan) -> Rates:
    """What the mission wants of the radios."""
    told = plan.spec.rate_hz if plan.room_link is not None else 0.0
    return Rates(plan.spec.rate_hz, plan.gateway.log_hz, told, plan.gateway.broadcast)


def budget_of(plan: MissionPlan) -> list[str]:
    """The budget of each radio of a mission, a line each; none without radios.

    Raises:
        UserError: one does not carry it, with the rates that fit.
    """
    found = [radio for uri in plan.crtp_links.values() if (radio := radio_of(uri)) is not None]
    radios = {
        number: (
            sum(other == number for other, _ in found),
            plan.gateway.radio_packets or min(capacity(rate) for other, rate in found if other == number),
        )
        for number, _ in found
    }
    try:
        return check(radios, rates_of(plan))
    except UserError as error:
        raise UserError(f"{plan.source}: {error} (rate_hz, gateway.log_hz)") from None


def words_of(plan: MissionPlan) -> list[str]:
    """The command line of a mission's gateway, after ``gs``."""
    words = ["gateway", "crazyflie"]
    for sysid, uri in plan.crtp_links.items():
        words += ["--vehicle", f"{sysid}={uri}"]
    address = parse_address(plan.gateway.link)
    rates = rates_of(plan)
    words += ["--out", f"udpin://{address.host}:{address.port}", "--log-hz", f"{rates.log_hz:g}"]
    words += ["--setpoint-hz", f"{rates.setpoint_hz:g}", "--pose-hz", f"{rates.pose_hz:g}", "--cache", _CACHE]
    words += ["--kept-since", str(time.monotonic_ns())]
    words += ["--broadcast"] if rates.broadcast else []
    return words + (["--radio-packets", f"{plan.gateway.radio_packets:g}"] if plan.gateway.radio_packets else [])


def room_of(plan: MissionPlan) -> RoomWord | None:
    """Where a mission's gateway hears the motion capture; None without one."""
    room, at = plan.room(), plan.room_link
    if room is None or at is None:
        return None
    return RoomWord(f"udpin://{at.host}:{relay_port(at.port)}", room.by_place, room.speed_m_s, rates_of(plan).pose_hz)


def start(words: list[str], keep: Sequence[int] = ()) -> subprocess.Popen[bytes]:
    """Starts ``gs`` with these words, deaf to the terminal's Ctrl-C, its output in a pipe; it keeps these open."""
    package = Path(__file__).parents[2]
    path = os.pathsep.join([str(package.parent), *filter(None, [os.environ.get("PYTHONPATH")])])
    child = subprocess.Popen(  # noqa: S603 - our own program
        [sys.executable, "-m", package.name, *words],
        env=os.environ | {"PYTHONPATH": path, "NO_COLOR": "1", "COLUMNS": "300"},
        stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, start_new_session=True,
        pass_fds=keep,
    )  # fmt: skip
    assert child.stdout is not None  # noqa: S101 - a pipe
    os.set_blocking(child.stdout.fileno(), False)
    return child


class _Child:
    """One process, and what it has to say."""

    def __init__(self, process: subprocess.Popen[bytes]) -> None:
        self.process = process
        self._said = b""

    def descriptor(self) -> int:
        """Of its output; -1 when that is closed."""
        return -1 if self.process.stdout is None or self.process.stdout.closed else self.process.stdout.fileno()

    def begin(self, vehicles: dict[int, Handover], room: RoomWord | None) -> None:
        """Gives it its word."""
        with suppress(OSError):  # it has died in the meantime, and is replaced
            if self.process.stdin is not None:
                self.process.stdin.write(written(vehicles, room).encode() + b"\n")
                self.process.stdin.flush()

    def lines(self) -> list[str]:
        """What it has said since the last call."""
        output = self.process.stdout
        if output is None or output.closed:
            return []
        with suppress(OSError):
            while data := output.read(65536):
                self._said += data
        *whole, self._said = self._said.split(b"\n")
        return [text for line in whole if (text := line.decode("utf-8", "replace").strip()[:_LINE_MAX])]

    def end(self) -> None:
        """Lets go of it, and waits for a moment; one that has somebody in the air is left to that."""
        if self.process.stdin is not None:
            with suppress(OSError):
                self.process.stdin.close()
        with suppress(subprocess.TimeoutExpired):
            self.process.wait(_END_S)
        if self.process.stdout is not None:
            self.process.stdout.close()


class GatewayKeeper:
    """The gateway of one flight; a ``Control`` of its loop.

    Args:
        plan: whom it serves.
        starts: starts a process.
    """

    def __init__(self, plan: MissionPlan, starts: Start = start) -> None:
        self._plan, self._starts = plan, starts
        self._words = words_of(plan)
        self._serves = _Child(starts(self._words))
        self._waits: _Child | None = None
        self._began_ns: int | None = None
        self._lines: list[str] = []
        self._died_ns: int | None = None
        self._again_ns = _AGAIN_NS
        self._serves.begin(handover_of(self._plan, None), room_of(plan))

    @property
    def pid(self) -> int:
        """Of the process that serves."""
        return self._serves.process.pid

    def sources(self) -> Sequence[int]:
        """What it says can be waited for."""
        return tuple(number for child in self._children if (number := child.descriptor()) >= 0)

    @property
    def _children(self) -> list[_Child]:
        return [child for child in (self._serves, self._waits) if child is not None]

    def read(self) -> None:
        """Takes what it says."""
        for child in self._children:
            self._lines += child.lines()

    def apply(self, session: Session, now_ns: int) -> None:
        """Passes on what it says, and puts another in its place when it has died."""
        code = self._serves.process.poll()
        self.read()
        for line in self._lines:
            session.remark("info", f"gateway: {line}", now_ns)
        self._lines = []
        self._began_ns = now_ns if self._began_ns is None else self._began_ns
        if self._waits is None and now_ns - self._began_ns >= _SPARE_NS:
            self._waits = _Child(self._starts(self._words))
        if code is None or (self._died_ns is not None and now_ns - self._died_ns < self._again_ns):
            return
        short = self._died_ns is not None and now_ns - self._died_ns < _SPARE_NS + self._again_ns
        self._again_ns = min(2 * self._again_ns, _AGAIN_MAX_NS) if short else _AGAIN_NS
        self._died_ns = now_ns
        vehicles = handover_of(self._plan, session)
        flying = [sysid for sysid, told in vehicles.items() if told.flies]
        how = f"killed by signal {-code}" if code < 0 else f"it ended with {code}"
        who = f"; vehicles {', '.join(map(str, flying))} fly: by setpoints they fall after 2 s" if flying else ""
        words = f"the gateway's process has gone ({how}){who}; another one takes over, and tells them to stay"
        session.remark(
            "alarm", words if flying else f"the gateway's process has gone ({how}); another one begins", now_ns
        )
        self._serves.end()
        self._serves, self._waits = self._waits or _Child(self._starts(self._words)), None
        self._serves.begin(vehicles, room_of(self._plan))
        self._began_ns = now_ns

    def answer(self, session: Session) -> None:
        """It asks nothing."""

    def close(self) -> None:
        """The flight is over: it ends when nobody flies, and until then does what preflight has set it to."""
        for child in self._children:
            child.end()


def handover_of(plan: MissionPlan, session: Session | None) -> dict[int, Handover]:
    """What a gateway has to know of each vehicle, by what the flight knows now; None: it has just begun."""
    wishes = make_failsafe(plan).wishes
    told = {}
    for row, vehicle in enumerate(plan.spec.vehicles):
        if vehicle.id not in plan.crtp_links:
            continue
        flies, own = False, {}
        if session is not None:
            fleet = session.runner.fleet
            flies = bool(fleet.armed[row]) and int(fleet.landed_state[row]) != LANDED_ON_GROUND
            settings = plan.autopilots[row].failsafes.settings(wishes[row])
            own = {name: value for name, value in settings.items() if name in LIMITS}
        east, north, up = plan.pads_enu_m[row].tolist()
        told[vehicle.id] = Handover(flies, (east, north, up), own)
    return told


@contextmanager
def serving(plan: MissionPlan, keep: Sequence[int] = ()) -> Iterator[tuple[GatewayKeeper, ...]]:
    """Serves the mission's vehicles beside the block, where it has any behind a cflib address.

    Args:
        plan: the mission.
        keep: descriptors that the gateway keeps open as long as it lives.

    Raises:
        UserError: cflib is not installed, or the radios do not carry the mission.
    """
    if not plan.crtp_links:
        yield ()
        return
    need("crazyflie", f"link {next(iter(plan.crtp_links.values()))}")
    budget_of(plan)
    keeper = GatewayKeeper(plan, lambda words: start(words, keep))
    try:
        yield (keeper,)
    finally:
        keeper.close()
