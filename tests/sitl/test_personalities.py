"""A personality is one folder: what it has to keep, and that nobody else has to know it."""

from __future__ import annotations

import ast
import re
from pathlib import Path

import pytest

import groundstation
import sitl
from sitl.messages import MESSAGES, in_wire_order
from sitl.messages_hardware import HARDWARE_MESSAGES
from sitl.personalities import PERSONALITIES, PROFILES, RATES_HZ
from sitl.world import VehicleConfig, World, WorldConfig
from tests.sitl.virtual_ground import Ground, arducopter, world

EMULATOR = Path(sitl.__file__).parent
STATION = Path(groundstation.__file__).parent
PLACES = EMULATOR / "personalities", STATION / "mavlink" / "autopilots"
AIRFRAMES = {"crazyflie"}  # the airframe of that name, which all kinds can fly
NAMES_PROFILES = STATION / "mission" / "plan" / "profiles.py"  # one is called as the autopilot that it is flown by


def _strings(path: Path) -> set[str]:
    """Words that a module compares, looks up or puts into tables; not what it says to people or keeps as a default."""
    tree = ast.parse(path.read_text(encoding="utf-8"))
    defaults = {
        id(item)
        for node in ast.walk(tree)
        for item in (
            [*node.args.defaults, *node.args.kw_defaults]
            if isinstance(node, ast.FunctionDef)
            else [node.value]
            if isinstance(node, ast.AnnAssign)
            else []
        )
    }
    return {
        node.value
        for node in ast.walk(tree)
        if isinstance(node, ast.Constant) and isinstance(node.value, str) and id(node) not in defaults
    }


def test_no_module_outside_its_folders_asks_for_an_autopilot_by_name() -> None:
    paths = [path for root in (EMULATOR, STATION) for path in root.rglob("*.py")]
    outside = [path for path in paths if path.parent.parent not in PLACES and path != NAMES_PROFILES]
    assert len(outside) > 150
    named = {str(path): found for path in outside if (found := _strings(path) & (PERSONALITIES.keys() - AIRFRAMES))}
    assert named == {}


def test_what_nobody_says_is_there() -> None:
    for kind in PERSONALITIES.values():
        assert kind.profile in PROFILES
        assert kind.streams in RATES_HZ
        for rates_hz in kind.rates_hz.values():
            assert rates_hz.keys() <= {*MESSAGES, *HARDWARE_MESSAGES, *kind.messages}


def test_the_order_on_the_wire_does_not_depend_on_where_a_message_is_made() -> None:
    names = [*MESSAGES, *HARDWARE_MESSAGES, *(name for kind in PERSONALITIES.values() for name in kind.messages)]
    assert in_wire_order(reversed(names)) == in_wire_order(sorted(names))
    assert in_wire_order(["ZEBRA", "VIBRATION", "ANT", "HEARTBEAT"]) == ("HEARTBEAT", "VIBRATION", "ANT", "ZEBRA")


@pytest.mark.parametrize(("config", "result"), [(world(), 2), (arducopter(), 0)])
def test_messages_of_one_dialect_are_sent_by_their_own_kind_alone(config: WorldConfig, result: int) -> None:
    ground = Ground(config)
    ground.run(2.5)
    for msgid in (193, 152):  # EKF_STATUS_REPORT, MEMINFO
        assert ground.ask(511, msgid, 100_000) == result
        assert ground.ask(512, msgid) == result
    ground.run(0.5)
    sent = ground.count(since_s=2.5)
    assert (sent["EKF_STATUS_REPORT"] > 4, sent["MEMINFO"] > 4) == ((result == 0,) * 2)


@pytest.mark.parametrize(
    ("vehicle", "words"),
    [
        (VehicleConfig(1, autopilot="kite"), "autopilot is 'kite'"),
        (VehicleConfig(1, profile="brick"), "profile is 'brick'"),
        (VehicleConfig(1, streams="all"), "streams is 'all'"),
    ],
)
def test_an_unknown_kind_profile_or_set_of_streams_is_named(vehicle: VehicleConfig, words: str) -> None:
    with pytest.raises(ValueError, match=re.escape(f"emulated vehicle 1: {words}, one of ")):
        World(WorldConfig(vehicles=[vehicle]), 0)
