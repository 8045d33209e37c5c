"""A connection gets on, and is told how; a stuck one is begun anew with the reason; who is heard is left alone."""

from __future__ import annotations

from pathlib import Path

import pytest

from groundstation.gateway.bridge import Bridge
from groundstation.gateway.measured import POSE_VARIABLES
from groundstation.mavlink.codec import Frame, FrameSplitter, decode
from tests.gateway.clocks import Clock

pytest.importorskip("cflib", reason="cflib is not installed")

from groundstation.app.gateway import serving
from groundstation.app.gateway.cflib_edge import Heard

FLIES = dict.fromkeys(POSE_VARIABLES, 0.0) | {"supervisor.info": float(0x1A), "stateEstimateZ.x": 1500.0}


class _Link:
    """A connection that gets as far as it is told to."""

    def __init__(self, number: int, uri: str, *_: object) -> None:
        self.number, self.uri = number, uri
        self.begun = 0
        self.far: tuple[int, str] = (0, "no answer")

    def connect(self, _first: object = ()) -> None:
        self.begun += 1

    def progress(self) -> tuple[int, str]:
        return self.far

    def obey(self, _order: object) -> None:
        pass

    def close(self, *, flies: bool) -> None:
        pass


class _Nowhere:
    def receive(self) -> list[tuple[str, bytes]]:
        return []

    def peers(self) -> list[str]:
        return []

    def service(self, _now_ns: int) -> None:
        pass


class _NoWait:
    def wait(self, _seconds: float) -> list[int]:
        return []


@pytest.fixture
def said() -> list[str]:
    return []


@pytest.fixture
def gateway(monkeypatch: pytest.MonkeyPatch, tmp_path: Path, said: list[str]) -> serving.Gateway:
    monkeypatch.setattr(serving, "CflibVehicle", _Link)
    monkeypatch.setattr(serving, "start_drivers", lambda: None)
    uris = {1: "udp://127.0.0.1:19850", 2: "radio://0/80/2M/E7E7E7E702"}
    made = serving.Gateway(uris, _Nowhere(), Clock(), cache=tmp_path, pose_hz=25.0, say=said.append)  # type: ignore[arg-type]
    made.connect()
    return made


def _run(gateway: serving.Gateway, steps: int, step_s: float = 1.0) -> None:
    for _ in range(steps):
        gateway._clock.t_ns += round(step_s * 1e9)  # type: ignore[attr-defined]
        gateway.step(_NoWait())  # type: ignore[arg-type]


def _links(gateway: serving.Gateway) -> list[_Link]:
    return [item.link for item in gateway._vehicles]  # type: ignore[misc]


def test_each_connection_is_told_of_and_the_one_that_is_stuck_is_begun_anew_with_the_reason(
    gateway: serving.Gateway, said: list[str]
) -> None:
    stuck, slow = _links(gateway)
    stuck.far = 90, "answers, 80 of 247 parameters"
    for second in range(12):
        slow.far = second, f"answers, {second} entries of its tables"
        _run(gateway, 1)
    words = " | ".join(said)
    assert "vehicle 1: udp://127.0.0.1:19850: answers, 80 of 247 parameters yet" in words
    assert "vehicle 2: radio://0/80/2M/E7E7E7E702: answers, 4 entries of its tables yet" in words
    assert "19850: no connection: answers, 80 of 247 parameters, no further for 10 s; tried again" in words
    _run(gateway, 3)
    assert (stuck.begun, slow.begun) == (2, 1)


def test_one_that_is_heard_in_the_air_is_never_let_go_of_for_its_parameters(gateway: serving.Gateway) -> None:
    link, _ = _links(gateway)
    link.far = 90, "answers, 80 of 247 parameters"
    for number in range(100):
        gateway._take(Heard(0, "log", values=FLIES, stamp_ms=400 * (number + 1)), gateway._clock.now_ns())
        _run(gateway, 1, 0.4)
    assert link.begun == 1


def test_one_that_is_taken_over_in_the_air_tells_its_place_with_its_first_pose() -> None:
    anew, taken = Bridge(1, 0), Bridge(1, 0)
    anew.connected(12, {})
    taken.resume((0.0, 0.0, 0.0), {}, 0)
    places = []
    for bridge in (anew, taken):
        bridge.logged(FLIES, 1000, 1_000_000)
        pieces = [piece for raw in bridge.take_frames() for piece in FrameSplitter().feed(raw)]
        batches = decode([piece for piece in pieces if isinstance(piece, Frame)])
        places.append([float(batch.values["y"][0]) for batch in batches if batch.name == "LOCAL_POSITION_NED"])
    assert places == [[], [1.5]]
