"""cflib, which nobody here wrote, flies a vehicle of ``gs sitl --autopilot crazyflie`` over real sockets."""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TypedDict

import pytest

from tests.sitl.served import FASTER, free_udp_port, serving

pytest.importorskip("cflib", reason="cflib is not installed")

import cflib.crtp
from cflib.crazyflie import Crazyflie
from cflib.crazyflie.log import LogConfig
from cflib.crazyflie.syncCrazyflie import SyncCrazyflie

LONGEST_S = 30.0


class Pose(TypedDict):
    x: float
    y: float
    z: float
    info: int


class Watch:
    """What the vehicle logs, 20 times a second of its time; setpoints are sent at the same pace."""

    def __init__(self, cf: Crazyflie) -> None:
        self.seen: list[Pose] = []
        self.setpoint: tuple[float, float, float, float] | None = None
        self._cf, self._met = cf, threading.Event()
        self._wanted: Callable[[Pose], bool] = lambda _: True
        block = LogConfig("pose", 50)
        for axis in "xyz":
            block.add_variable(f"stateEstimate.{axis}", "float")
        block.add_variable("supervisor.info", "uint16_t")
        cf.log.add_config(block)
        block.data_received_cb.add_callback(self._take)
        block.start()

    def _take(self, _stamp: int, data: dict[str, float], _block: object) -> None:
        pose = Pose(
            x=data["stateEstimate.x"], y=data["stateEstimate.y"], z=data["stateEstimate.z"],
            info=int(data["supervisor.info"]),
        )  # fmt: skip
        self.seen.append(pose)
        if self.setpoint is not None:
            self._cf.commander.send_velocity_world_setpoint(*self.setpoint)
        if self._wanted(pose):
            self._met.set()

    def until(self, wanted: Callable[[Pose], bool]) -> None:
        self._met.clear()
        self._wanted = wanted
        assert self._met.wait(LONGEST_S), self.seen[-1:]


@contextmanager
def connected(port: int, cache: Path) -> Iterator[Crazyflie]:
    cflib.crtp.CLASSES.clear()
    cflib.crtp.CLASSES.append(cflib.crtp.udpdriver.UdpDriver)
    with SyncCrazyflie(f"udp://127.0.0.1:{port}", cf=Crazyflie(rw_cache=str(cache))) as link:
        link.wait_for_params()
        yield link.cf


def test_connects_reads_tables_arms_takes_off_flies_by_velocity_and_lands(tmp_path: Path) -> None:
    port = free_udp_port()
    with serving("--autopilot", "crazyflie", "--vehicles", "1", "--port", str(port), *FASTER):
        with connected(port, tmp_path) as cf:
            assert cf.platform.get_protocol_version() == 12
            assert cf.param.get_value("stabilizer.estimator") == "2"
            cf.param.set_value("posCtlPid.xVelMax", 1.5)
            watch = Watch(cf)
            watch.until(lambda pose: pose["info"] & 8 > 0)  # can fly
            assert "Is auto armed" in cf.supervisor.read_state_list()

            cf.high_level_commander.takeoff(1.0, 2.0)
            watch.until(lambda pose: pose["z"] > 0.9)
            assert cf.supervisor.is_flying
            watch.setpoint = (0.5, 0.0, 0.0, 0.0)
            watch.until(lambda pose: pose["x"] > 0.5)
            watch.setpoint = (0.0, -0.4, 0.0, 0.0)
            watch.until(lambda pose: pose["y"] < -0.3)
            assert watch.seen[-1]["z"] == pytest.approx(1.0, abs=0.15)
            watch.setpoint = None
            cf.commander.send_notify_setpoint_stop()
            cf.high_level_commander.land(0.0, 2.0)
            watch.until(lambda pose: pose["z"] < 0.05 and not pose["info"] & 16)
            assert cf.param.get_value("posCtlPid.xVelMax") == "1.5"
            assert not cf.supervisor.is_locked
        assert list(tmp_path.glob("*.json"))  # tables kept: it knows them by their check sums
        with connected(port, tmp_path) as cf:
            assert cf.param.get_value("posCtlPid.xVelMax") == "1.5"
