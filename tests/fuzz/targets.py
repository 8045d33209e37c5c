"""Everything that reads bytes from outside, each as a function of one case: it must take it, or say in words why not.

A target raises (an assertion, or whatever the code under test raises beyond its own words for people) when a promise is
broken: arbitrary bytes never raise, take no memory without bound, and never let a good frame behind them go missing.
"""

from __future__ import annotations

import json
import os
import socket
from abc import ABC, abstractmethod
from collections.abc import Sequence
from contextlib import suppress
from copy import deepcopy
from itertools import pairwise
from pathlib import Path
from random import Random
from types import SimpleNamespace
from typing import cast

import numpy as np
import yaml

from groundstation.app.discovery import Discovery
from groundstation.app.order_socket import LINE_MAX, OrderSocket, _Client
from groundstation.app.resources import find_config
from groundstation.app.session import Session
from groundstation.core.errors import UserError
from groundstation.core.files import read_yaml, validate
from groundstation.core.phases import Phase
from groundstation.design.designer import design
from groundstation.design.store import load_formation, load_gains, save_gains
from groundstation.links.tcp import TcpServerLink
from groundstation.mavlink.addresses import parse_address
from groundstation.mavlink.codec import Encoder, Frame, FrameSplitter, decode, message_id
from groundstation.mavlink.gate import Gate, Refused, SignedLink
from groundstation.mavlink.keys import new_key, read_key, read_times
from groundstation.mavlink.signing import SecretKey, Signing, timestamp_at
from groundstation.mission.operator import parse_command
from groundstation.mission.plan.overrides import override_value
from groundstation.mission.plan.reading import load_mission
from groundstation.mission.plan.schema import MissionSpec
from groundstation.mission.runner import Runner
from groundstation.mission.verdict import Note
from groundstation.records.manifest import manifest_path, read_manifest
from groundstation.records.notes import Noise, Received
from groundstation.records.replay import load_flight
from groundstation.records.tlog import TlogReader, TlogWriter, read_tlog
from sitl.faults import FaultError, parse_faults
from sitl.fleet import fleet
from sitl.world import World, WorldConfig
from tests.fuzz import samples
from tests.fuzz.mutate import bend

TICK_NS = 20_000_000
YAML_WORDS = (
    b"&a ", b"*a", b"<<: *a", b"{<<: ", b"? ", b"!!python/object/apply:os.system [true]", b"!!binary ", b"!!timestamp ",
    b"!!set ", b"!!omap ", b"!!int ", b"!!float ", b"[", b"]", b"{", b"}", b"\n  - ", b"\n", b": ", b"null", b".nan",
    b".inf", b"-1", b"1e308", b"1e999", b"0x" + b"f" * 90, b"9" * 500, b"1:59:59", b"2001-99-99", b"'", b'"', b"|",
    b">", b"%YAML 9.9\n", b"---\n", b"\x00", b"\xc3\x28", b"\xef\xbb\xbf", "\u2028".encode(), b"[" * 400, b"true",
    b"~", b"#",
)  # fmt: skip
JSON_WORDS = (
    b"[", b"]", b"{", b"}", b"null", b"NaN", b"Infinity", b"-Infinity", b"1e999", b"9" * 5000, b"-1", b"[" * 3000,
    b'""', b"true", b",", b":", b'"\\ud800"', b"9223372036854775808", b"0.5", b'"id"', b'"pad_m"', b'"origin"', b"[[]]",
    b"{}",
)  # fmt: skip


class Target(ABC):
    """One parser.

    Attributes:
        name: on the command line.
    """

    name = ""
    words: Sequence[bytes] = ()

    def __init__(self, folder: Path, random: Random) -> None:
        self.folder, self.random = folder, random

    def samples(self) -> Sequence[bytes]:
        """Real input."""
        return samples.datagrams()

    @abstractmethod
    def run(self, data: bytes) -> None:
        """Takes one case; raises when a promise is broken."""


class Datagrams(Target):
    """The splitter on whole datagrams: nothing is lost, and the good frame behind the noise is there."""

    name = "splitter"

    def run(self, data: bytes) -> None:
        good = samples.random_frame(self.random, 200, self.random.choice((0, 30, 32, 84)))
        pieces = FrameSplitter().feed(data + good)
        check_pieces(pieces, data, good)
        decode([piece for piece in pieces if isinstance(piece, Frame)])


class Streams(Target):
    """The splitter on a stream, cut anywhere."""

    name = "stream"

    def run(self, data: bytes) -> None:
        good = samples.random_frame(self.random, 200, self.random.choice((0, 30, 32, 84)))
        splitter = FrameSplitter(datagrams=False)
        pieces: list[Frame | bytes] = []
        rest = data + good + bytes(300)  # what comes later: a stream waits for the end of what it takes for a frame
        while rest:
            cut = self.random.choice((1, 3, 50, 1000))
            pieces += splitter.feed(rest[:cut])
            rest = rest[cut:]
            assert len(splitter._held) <= 300
        check_pieces(pieces, data, good, bytes(300))


def check_pieces(pieces: list[Frame | bytes], data: bytes, good: bytes, behind: bytes = b"") -> None:
    """Nothing lost, nothing doubled; the good frame stands where it was put, unless a good checksum covers it."""
    raws = [piece.raw if isinstance(piece, Frame) else piece for piece in pieces]
    assert b"".join(raws) == (data + good + behind)[: sum(map(len, raws))]
    assert sum(map(len, raws)) >= len(data) + len(good)
    start = 0
    for piece, raw in zip(pieces, raws, strict=True):
        stop = start + len(raw)
        if start == len(data) and isinstance(piece, Frame) and raw == good:
            return
        if isinstance(piece, Frame) and start < len(data) < stop and decode([piece]):
            return  # one in 65,536 has a right checksum by chance
        start = stop
    raise AssertionError("a good frame behind other bytes went missing")


class GroundStation(Target):
    """The whole mission object: vehicles, commands, preflight; strangers and vehicles by turns."""

    name = "vehicle"

    def __init__(self, folder: Path, random: Random) -> None:
        super().__init__(folder, random)
        self._plan = load_mission(write_mission(folder))
        self._begin()

    def _begin(self) -> None:
        self._runner = Runner(self._plan, 0)
        self._now_ns = 0

    def samples(self) -> Sequence[bytes]:
        return samples.datagrams(1) + samples.datagrams(2)

    def run(self, data: bytes) -> None:
        runner = self._runner
        self._now_ns += TICK_NS
        runner.receive(0, self.random.choice(("a", "a", "b", str(self.random.random()))), data, self._now_ns)
        hello = Encoder(3).encode("HEARTBEAT", type=2, autopilot=12, system_status=3)
        runner.receive(0, "good", hello, self._now_ns)
        for outgoing in runner.step(self._now_ns):
            for raw in outgoing.frames:
                assert isinstance(FrameSplitter().feed(raw)[0], Frame)
        assert runner.fleet.heartbeat_ns[2] == self._now_ns, "the good vehicle was not heard"
        runner.take_notes()
        if runner.done or self._now_ns > 100 * 1_000_000_000:
            self._begin()


class SignedLinks(Target):
    """The gate: nothing comes in but what was signed and never came before."""

    name = "signing"

    def __init__(self, folder: Path, random: Random) -> None:
        super().__init__(folder, random)
        self._clock = timestamp_at(samples.EPOCH_US)
        self._signing = Signing(SecretKey(samples.SECRET[::-1]))
        self._gate = Gate([SignedLink(Signing(SecretKey(samples.SECRET[::-1])), 0)], samples.EPOCH_US)
        self._seen: set[int] = set()
        self._signed: dict[bytes, None] = {}

    def samples(self) -> Sequence[bytes]:
        return samples.frames()

    def run(self, data: bytes) -> None:
        good = self._signing.sign(samples.random_frame(self.random, 7, 30), 0, self._clock)
        self._signed[good] = None
        if self.random.random() < 0.5:  # a recorded one, bent or as it was
            old = bytearray(self.random.choice(list(self._signed)[-50:]))
            if self.random.random() < 0.7:
                old[self.random.randrange(len(old))] ^= 1 << self.random.randrange(8)
            data += bytes(old)
        heard = []
        for piece in self._gate.receive(0, "p", data + good, 0):
            if isinstance(piece, Frame) and piece.signed:
                assert piece.raw in self._signed, "a frame came in that nobody signed"
                heard.append(piece.raw)
            assert isinstance(piece, Frame | Refused | bytes)
        assert len(set(heard)) == len(heard)
        assert heard[-1:] == [good] or len(heard) == 0
        for raw in heard:
            assert hash(raw) not in self._seen, "a frame came in twice"
            self._seen.add(hash(raw))
        while len(self._signed) > 1000:
            del self._signed[next(iter(self._signed))]


class Log(Target):
    """The reader: bent records cost themselves, those behind them are there; the writer's log is read back."""

    name = "tlog"

    def samples(self) -> Sequence[bytes]:
        return samples.logs()

    def run(self, data: bytes) -> None:
        end_us = samples.EPOCH_US + 10_000_000
        behind = [end_us.to_bytes(8, "big") + samples.random_frame(self.random, 9, 30) for _ in range(3)]
        try:
            reader = TlogReader(data + b"".join(behind))
        except UserError:
            return
        received = [record.frame.raw for record in reader if isinstance(record, Received)]
        reader.message  # noqa: B018 - has to work whatever was left out
        assert received[-1:] == [behind[-1][8:]], "the last good record went missing"
        assert reader.damaged_bytes + reader.truncated_bytes <= len(data) + sum(map(len, behind))
        self._write_and_read(data)

    def _write_and_read(self, data: bytes) -> None:
        """What the writer takes as received comes back byte by byte, but for keys."""
        path = self.folder / "written.tlog"
        with TlogWriter(path, samples.EPOCH_US) as log:
            log.received(0, "p", data, 1000)
        back = b"".join(
            record.frame.raw if isinstance(record, Received) else record.data
            for record in read_tlog(path)
            if isinstance(record, Received | Noise)
        )
        without_setup = b"".join(
            piece.raw if isinstance(piece, Frame) else piece
            for piece in FrameSplitter().feed(data)
            if not (isinstance(piece, Frame) and piece.msgid == message_id("SETUP_SIGNING"))
        )
        assert len(back) == len(without_setup)
        assert all(a in (b, 0) for a, b in zip(back, without_setup, strict=True))


class Replay(Target):
    """A flight out of a bent log beside a good manifest, or the other way round."""

    name = "replay"
    words = JSON_WORDS

    def __init__(self, folder: Path, random: Random) -> None:
        super().__init__(folder, random)
        self._log = folder / "flight.tlog"
        self._manifests = samples.manifests(b"")
        self._logs = samples.logs()

    def samples(self) -> Sequence[bytes]:
        return self._logs + self._manifests * 20

    def run(self, data: bytes) -> None:
        if data.lstrip()[:1] == b"{":
            data = json.dumps(bend(json.loads(self.random.choice(self._manifests)), self.random)).encode()
        bent_log = data.lstrip()[:1] != b"{"
        self._log.write_bytes(data if bent_log else self.random.choice(self._logs))
        manifest_path(self._log).write_bytes(self.random.choice(self._manifests) if bent_log else data)
        try:
            flight = load_flight(self._log)
            flight.min_distance_m()
            flight.formation_error_at(flight.instants_ns()[:50])
        except UserError as error:
            check_words(error)


class ManifestFile(Target):
    """The manifest alone."""

    name = "manifest"
    words = JSON_WORDS

    def samples(self) -> Sequence[bytes]:
        return samples.manifests(b"gains" * 100)

    def run(self, data: bytes) -> None:
        if self.random.random() < 0.5:
            values = bend(json.loads(self.random.choice(self.samples())), self.random)
            data = json.dumps(values).encode()
        path = self.folder / "f.manifest.json"
        path.write_bytes(data)
        try:
            read_manifest(path).to_json()
        except UserError as error:
            check_words(error)


class Mission(Target):
    """A mission file, with what it names."""

    name = "mission"
    words = YAML_WORDS

    def __init__(self, folder: Path, random: Random) -> None:
        super().__init__(folder, random)
        self._path = write_mission(folder)

    def samples(self) -> Sequence[bytes]:
        return samples.missions()

    def run(self, data: bytes) -> None:
        if self.random.random() < 0.5:  # well formed, with values that nobody expects
            values = yaml.safe_load(self.random.choice(samples.missions()))
            data = yaml.safe_dump(bend(values, self.random)).encode()
        self._path.write_bytes(data)
        override = data[: self.random.randrange(20)].decode(errors="replace")
        try:
            load_mission(self._path, [f"rate_hz={override}"] if self.random.random() < 0.1 else ())
        except UserError as error:
            check_words(error)


class CommandLine(Target):
    """What is typed: ``--set`` and link addresses."""

    name = "typed"
    words = (
        *YAML_WORDS,
        b".",
        b"=",
        b"vehicles.0.",
        b"steps.1.hold",
        "\u00b2".encode(),
        b"9" * 5000,
        b"[::1",
        b"://",
        b":0",
    )

    def __init__(self, folder: Path, random: Random) -> None:
        super().__init__(folder, random)
        self._values = read_yaml(write_mission(folder))

    def samples(self) -> Sequence[bytes]:
        return (
            b"vehicles.2.pad_m=[1,0,0]", b"speed_limit_m_s=0.3", b"steps.1.hold.seconds=5", b"limits.new={a: [1, 2]}",
            b"udpin://0.0.0.0:14540", b"tcpout://[::1]:5760", b"serial:///dev/ttyUSB0:57600", b"mavsdk://udpin://h:1",
        )  # fmt: skip

    def run(self, data: bytes) -> None:
        text = data[:200].decode(errors="replace")
        values = deepcopy(self._values)
        for use in (
            lambda: override_value(values, text),
            lambda: validate(MissionSpec, values, "typed"),
            lambda: parse_address(text),
            lambda: find_config(Path(text * 20), "missions"),
        ):
            try:
                use()
            except UserError as error:
                check_words(error)


class FormationFile(Target):
    """A formation file."""

    name = "formation"
    words = YAML_WORDS

    def samples(self) -> Sequence[bytes]:
        return samples.formations()

    def run(self, data: bytes) -> None:
        path = self.folder / "formation.yaml"
        if self.random.random() < 0.5:
            data = yaml.safe_dump(bend(yaml.safe_load(self.random.choice(samples.formations())), self.random)).encode()
        path.write_bytes(data)
        try:
            load_formation(path)
        except UserError as error:
            check_words(error)


class Faults(Target):
    """The emulator's timetable of faults."""

    name = "faults"
    words = YAML_WORDS

    def samples(self) -> Sequence[bytes]:
        return (samples.faults_text(),)

    def run(self, data: bytes) -> None:
        try:
            if self.random.random() < 0.5:
                data = yaml.safe_dump(bend(yaml.safe_load(samples.faults_text()), self.random)).encode()
            faults = parse_faults(data.decode())
            World(WorldConfig(vehicles=fleet(2), faults=faults), 0)
        except (FaultError, UnicodeDecodeError) as error:
            check_words(error)


class Gains(Target):
    """A gains file."""

    name = "gains"

    def samples(self) -> Sequence[bytes]:
        write_mission(self.folder)
        return ((self.folder / "square.npz").read_bytes(),)

    def run(self, data: bytes) -> None:
        path = self.folder / "bent.npz"
        path.write_bytes(data)
        try:
            load_gains(path)
        except UserError as error:
            check_words(error)


class Key(Target):
    """A key file and the file with its times."""

    name = "key"
    words = (b"passphrase:", b"0" * 64, b"=", b"sent", b"streams", b"9" * 5000, b"[" * 3000)

    def samples(self) -> Sequence[bytes]:
        path = self.folder / "sample.key"
        new_key(path)
        times = b'{"sent": 37526662495457, "newest": 1, "streams": [[1, 1, 0, 37526656709055], [2, 1, 0, 5]]}'
        return (path.read_bytes(), b"passphrase: correct horse", times, times)

    def run(self, data: bytes) -> None:
        path = self.folder / "bent.key"
        path.write_bytes(data)
        path.chmod(0o600)
        for read in (read_key, read_times):
            try:
                read(path)
            except UserError as error:
                check_words(error)


class Emulator(Target):
    """Emulated vehicles of both kinds, on datagrams and streams."""

    name = "sitl"

    def __init__(self, folder: Path, random: Random) -> None:
        super().__init__(folder, random)
        self._begin()

    def _begin(self) -> None:
        vehicles = (*fleet(1), *(item for item in fleet(2, autopilot="arducopter")[1:]))
        self._world = World(WorldConfig(vehicles=vehicles), 1)
        self._now_ns = 0
        self._world.advance(3_000_000_000)
        self._now_ns = 3_000_000_000

    def samples(self) -> Sequence[bytes]:
        return samples.datagrams(255)

    def run(self, data: bytes) -> None:
        world, vehicle = self._world, self.random.randrange(2)
        stream = self.random.random() < 0.3
        source = self.random.choice(("a", "b", str(self.random.random())))
        world.receive(vehicle, data, self._now_ns, f"{source}{stream}", stream=stream)
        ping = Encoder(255, 190).encode("PING", seq=self._now_ns // 1000 & 0xFFFFFFFF)
        world.receive(vehicle, ping, self._now_ns, "good")
        self._now_ns += 8_000_000
        sent = b"".join(out.data for out in world.advance(self._now_ns) if out.vehicle_index == vehicle)
        frames = [piece for piece in FrameSplitter().feed(sent) if isinstance(piece, Frame)]
        powered = world.state.talking[vehicle]
        answers = [frame for frame in frames if frame.msgid == message_id("PING")]
        assert answers or not powered or world.signing[vehicle].on, "the good frame was not answered"
        assert world.frame_errors == [0, 0], "a frame was not handled"
        assert np.isfinite(world.truth.pos_enu_m).all()
        if not powered or world.signing[vehicle].on or self._now_ns > 200 * 1_000_000_000:
            self._begin()


class Discover(Target):
    """``gs vehicles`` on a stream and on datagrams."""

    name = "discovery"

    def __init__(self, folder: Path, random: Random) -> None:
        super().__init__(folder, random)
        self._discovery = Discovery([parse_address("udpin://0.0.0.0:1"), parse_address("tcpin://0.0.0.0:1")])
        self._now_ns = 0

    def run(self, data: bytes) -> None:
        self._now_ns += 600_000_000
        for link in (0, 1):
            self._discovery.receive(link, str(self.random.randrange(2000)), data, self._now_ns)
        self._discovery.outgoing(self._now_ns)
        self._discovery.doubles(self._now_ns)
        self._discovery.block(self._now_ns)
        if len(self._discovery.found) > 30:
            self._discovery = Discovery([parse_address("udpin://0.0.0.0:1"), parse_address("tcpin://0.0.0.0:1")])


class Tcp(Target):
    """A TCP link in real pieces, with whatever is at the other end, in front of the mission object's splitters."""

    name = "tcp"

    def __init__(self, folder: Path, random: Random) -> None:
        super().__init__(folder, random)
        self._link = TcpServerLink(parse_address("tcpin://127.0.0.1:0"))
        self._peer = socket.create_connection(self._link.listener.getsockname())
        self._splitter = FrameSplitter(datagrams=False)

    def run(self, data: bytes) -> None:
        good = samples.random_frame(self.random, 200, 30)
        self._peer.sendall(data + good + bytes(300))
        wanted, pieces = len(data) + len(good) + 300, b""
        while len(pieces) < wanted:  # loopback: what was sent is there, in one piece or many
            pieces += b"".join(piece for _, piece in self._link.receive())
        check_pieces(FrameSplitter(datagrams=False).feed(pieces), data, good, bytes(300))


class _Listener:
    """What the order socket sees of a flight."""

    def __init__(self) -> None:
        self.said: list[Note] = []
        self.runner = SimpleNamespace(phase=Phase.FORM)

    def operator(self, order: str, _now_ns: int) -> str:
        return parse_command(order, [1, 2]).text


class Orders(Target):
    """The socket of a second terminal: whatever it says, the line behind that is answered, or it is cut off."""

    name = "orders"
    words = (*JSON_WORDS, b'{"order": "', b'"}\n', b'{"about": true}\n', b"\n", b"kill all", b"\\u0000", b"\\udcff")

    def samples(self) -> Sequence[bytes]:
        return [b'{"order": "hold"}\n', b'{"order": "kill 2 1"}\n{"about": 1}\n', b'{"order": "land all"}\n', b"{}\n"]

    def run(self, data: bytes) -> None:
        flight = cast("Session", _Listener())
        orders = OrderSocket(self.folder, {"mission": "a", "log": "b\udcff", "pid": 1, "vehicles": [1, 2]})
        ours, theirs = socket.socketpair()
        with ours, theirs:
            theirs.setblocking(False)
            client = _Client(theirs, 0)
            orders._clients.append(client)
            line = b'\n{"about": "the last one"}\n'
            ours.sendall(data[:_ORDERS_BYTES] + line)
            for tick in range(_ORDERS_TICKS):
                orders.read()
                orders.apply(flight, tick * TICK_NS)
                orders.answer(flight)
                assert not orders._clients or len(client.received) <= LINE_MAX
            ours.setblocking(False)
            said = b""
            with suppress(OSError):  # nothing more, or cut off with something unread
                while more := ours.recv(65536):
                    said += more
            answers = [json.loads(item) for item in said.splitlines()]
            assert not orders._clients or any(answer.get("log") == "b\udcff" for answer in answers), answers[-1:]


_ORDERS_BYTES, _ORDERS_TICKS = 8_000, 400

TARGETS: tuple[type[Target], ...] = (
    Datagrams, Streams, GroundStation, SignedLinks, Log, Replay, ManifestFile, Mission, CommandLine, FormationFile,
    Faults, Gains, Key, Emulator, Discover, Tcp, Orders,
)  # fmt: skip


def check_words(error: Exception) -> None:
    """A message that people can read: not empty, and not the whole input over again."""
    assert 0 < len(str(error)) < 100_000, f"a message of {len(str(error))} characters"


def write_mission(folder: Path) -> Path:
    """A good mission with its formation, gains and key, once in a folder."""
    path = folder / "mission.yaml"
    path.write_bytes(samples.mission_text())
    if not (folder / "square.npz").exists():
        (folder / "square.yaml").write_bytes(samples.formation_text())
        formation = load_formation(folder / "square.yaml")
        result = design(formation)
        assert result.gains is not None
        assert result.certificate is not None
        save_gains(folder / "square.npz", formation, result.gains, result.certificate, result.method)
        os.close(os.open(folder / "team.key", os.O_CREAT | os.O_WRONLY, 0o600))
    return path


assert all(a.name != b.name for a, b in pairwise(TARGETS))
