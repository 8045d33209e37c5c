"""Parameters by name: packing, pacing, silence, losses; and what an autopilot's should say."""

from __future__ import annotations

import math
import random
import struct

import pytest
from hypothesis import given
from hypothesis import strategies as st

from groundstation.mavlink.autopilots import AUTOPILOTS
from groundstation.mavlink.codec import Encoder, FrameSplitter
from groundstation.mavlink.failsafes import Wish
from groundstation.mavlink.params import (
    ParamDesk,
    ParamQuestion,
    ParamState,
    ParamValue,
    bits_of_value,
    value_of_bits,
)
from groundstation.mavlink.vehicle import Fleet, ReceivedFrame

INT8, INT32, REAL32 = 2, 6, 9
MS = 1_000_000
TICK = 20 * MS


@given(st.integers(-(2**31), 2**31 - 1), st.booleans())
def test_a_whole_number_comes_back_from_its_bits(value: int, bytewise: bool) -> None:
    if not bytewise:
        value = int(struct.unpack("<f", struct.pack("<f", value))[0])  # what a float can carry
        value = min(value, 2**31 - 128)
    assert value_of_bits(bits_of_value(value, INT32, bytewise=bytewise), INT32, bytewise=bytewise) == value


@given(st.floats(width=32, allow_nan=False))
def test_a_real_number_comes_back_from_its_bits(value: float) -> None:
    for bytewise in (True, False):
        assert value_of_bits(bits_of_value(value, REAL32, bytewise=bytewise), REAL32, bytewise=bytewise) == value


def test_integers_lie_in_the_floats_bytes_or_are_cast_to_it() -> None:
    assert bits_of_value(5.0, INT32, bytewise=True) == 5
    assert bits_of_value(5.0, INT32, bytewise=False) == 0x40A00000
    assert bits_of_value(-1.0, INT32, bytewise=True) == 0xFFFFFFFF
    assert value_of_bits(0xFFFFFFFF, INT32, bytewise=True) == -1.0
    assert math.isnan(value_of_bits(0xFFFFFFFF, INT32, bytewise=False))
    with pytest.raises(ValueError, match="300 does not fit a parameter of type 2"):
        bits_of_value(300.0, INT8, bytewise=False)


@pytest.mark.parametrize("value", [0, 1, 5, -1, 2**31 - 1, -(2**31)])
def test_bits_pass_through_a_frame_unchanged(value: int) -> None:
    bits = bits_of_value(value, INT32, bytewise=True)
    raw = Encoder(1).encode(
        "PARAM_VALUE", param_id=b"COM_OBL_RC_ACT", param_value=ParamQuestion(0, "X", bits).as_float, param_type=INT32
    )
    (frame,) = FrameSplitter().feed(raw)
    fleet = Fleet([1], [0])
    fleet.ingest([ReceivedFrame(frame, 0, "peer", 7)])  # type: ignore[arg-type]
    assert fleet.take_param_values() == [ParamValue(0, "COM_OBL_RC_ACT", bits, INT32, 7)]


def _run(
    desk: ParamDesk, known: dict[str, int], *, loss: float = 0.0, seconds: float = 60.0, seed: int = 1
) -> tuple[float, int]:
    """Lets a firmware with these parameters answer; returns when nothing is asked any more, and how many questions."""
    rng, asked, last_ns = random.Random(seed), 0, 0
    answers: list[ParamValue] = []
    for now_ns in range(0, round(seconds * 1e9), TICK):
        for answer in answers:
            if rng.random() >= loss:
                desk.take(answer)
        answers = []
        for question in desk.due(now_ns):
            asked, last_ns = asked + 1, now_ns
            if question.name in known and rng.random() >= loss:
                known[question.name] = known[question.name] if question.bits is None else question.bits
                answers.append(ParamValue(question.vehicle, question.name, known[question.name], INT32, now_ns))
    return last_ns / 1e9, asked


def _names(n: int) -> dict[str, int]:
    return {f"P{k}": k for k in range(n)}


def test_all_are_read_at_once_where_there_is_room_and_in_turn_where_there_is_none() -> None:
    desk = ParamDesk(1)
    for name in _names(20):
        desk.read(0, name)
    assert len(desk.due(0)) == 8
    desk = ParamDesk(1)
    desk.pace(0, spacing_ns=100 * MS)
    for name in _names(20):
        desk.read(0, name)
    last_s, asked = _run(desk, _names(20))
    assert 1.9 <= last_s <= 2.1
    assert asked == 20


@pytest.mark.parametrize("loss", [0.0, 0.2])
def test_what_is_there_is_found_and_what_is_not_is_given_up(loss: float) -> None:
    for seed in range(20):
        desk = ParamDesk(1)
        known = _names(18)
        for name in [*known, "NOT_THERE"]:
            desk.read(0, name)
        last_s, _ = _run(desk, known, loss=loss, seed=seed)
        assert last_s < (3.0 if loss == 0.0 else 9.0)
        assert all(desk.state(0, name) is ParamState.KNOWN for name in known)
        assert desk.state(0, "NOT_THERE") is ParamState.UNKNOWN


def test_a_vehicle_that_answers_nothing_is_given_up_in_six_seconds() -> None:
    desk = ParamDesk(1)
    for name in _names(30):
        desk.read(0, name)
    last_s, asked = _run(desk, {})
    assert last_s <= 6.0
    assert asked <= 8 * 13
    assert all(desk.state(0, name) is ParamState.UNKNOWN for name in _names(30))


def test_a_setting_counts_when_the_vehicle_tells_it() -> None:
    desk = ParamDesk(1)
    desk.read(0, "P")
    _run(desk, {"P": 1}, seconds=1.0)
    desk.write(0, "P", 5, INT32)
    assert desk.state(0, "P") is ParamState.ASKED
    (question,) = desk.due(10**10)
    assert (question.bits, question.kind) == (5, INT32)
    desk.take(ParamValue(0, "P", 1, INT32, 0))  # a late answer to the first question
    assert desk.state(0, "P") is ParamState.ASKED
    desk.take(ParamValue(0, "P", 5, INT32, 0))
    told = desk.value(0, "P")
    assert told is not None
    assert (desk.state(0, "P"), told.bits) == (ParamState.KNOWN, 5)


def test_a_setting_that_is_not_taken_is_known_to_be_refused() -> None:
    desk = ParamDesk(1)
    desk.write(0, "P", 5, INT32)
    for _ in range(2):
        desk.take(ParamValue(0, "P", 1, INT32, 0))
    assert desk.state(0, "P") is ParamState.KNOWN


def test_values_that_nobody_asked_for_take_no_memory() -> None:
    desk = ParamDesk(1)
    desk.take(ParamValue(0, "P", 1, INT32, 0))
    assert desk.state(0, "P") is None
    with pytest.raises(ValueError, match="longer than 16 bytes"):
        desk.read(0, "A" * 17)


def _wish(action: str, *, stacked: bool) -> Wish:
    return Wish(
        action,
        after_s=20.0,
        height_m=12.3,
        wait_s=30.0,
        stacked=stacked,
        setpoint_s=0.02,
        speed_m_s=1.5,
        battery_min=0.2,
    )


@pytest.mark.parametrize("autopilot", AUTOPILOTS)
@pytest.mark.parametrize(("action", "stacked"), [("return", True), ("land", False), ("hold", True), ("own", False)])
def test_what_is_asked_for_is_well_when_it_is_so(autopilot: str, action: str, stacked: bool) -> None:
    failsafes, wish = AUTOPILOTS[autopilot].failsafes, _wish(action, stacked=stacked)
    settings = failsafes.settings(wish)
    findings = [finding for rule in failsafes.rules(wish) if (finding := rule.judge(settings)) is not None]
    assert findings == []
    assert all(rule.judge({}) is None for rule in failsafes.rules(wish))  # what is not told is not judged


@pytest.mark.parametrize(
    ("autopilot", "asked", "name", "value", "grave"),
    [
        ("px4", "return stacked", "COM_OBL_RC_ACT", 0, True),
        ("px4", "return stacked", "COM_OBL_RC_ACT", 4, True),
        ("px4", "land", "COM_OBL_RC_ACT", 4, None),
        ("px4", "land", "COM_OBL_RC_ACT", 0, False),
        ("px4", "own stacked", "COM_OBL_RC_ACT", 4, True),
        ("px4", "own", "COM_OBL_RC_ACT", 7, True),
        ("px4", "return stacked", "COM_OF_LOSS_T", 30.0, True),
        ("px4", "return stacked", "COM_OF_LOSS_T", 3.0, False),
        ("px4", "return stacked", "COM_OF_LOSS_T", 0.01, True),
        ("px4", "return stacked", "COM_OF_LOSS_T", math.nan, True),
        ("px4", "return stacked", "NAV_DLL_ACT", 0, True),
        ("px4", "own stacked", "NAV_DLL_ACT", 0, False),
        ("px4", "return stacked", "RTL_RETURN_ALT", 60.0, True),
        ("px4", "return stacked", "COM_DL_LOSS_T", 10, True),
        ("px4", "land", "COM_DL_LOSS_T", 10, False),
        ("px4", "return stacked", "COM_LOW_BAT_ACT", 0, True),
        ("px4", "return stacked", "COM_LOW_BAT_ACT", 2, False),
        ("px4", "return stacked", "COM_RCL_EXCEPT", 0, False),
        ("px4", "return stacked", "COM_RC_IN_MODE", 99, False),
        ("px4", "return stacked", "COM_DLL_EXCEPT", 4, True),
        ("px4", "return stacked", "BAT_CRIT_THR", 0.25, False),
        ("px4", "return stacked", "MPC_XY_VEL_MAX", 1.0, False),
        ("arducopter", "return stacked", "FS_GCS_ENABLE", 0, True),
        ("arducopter", "return stacked", "FS_GCS_ENABLE", 5, True),
        ("arducopter", "own stacked", "FS_GCS_ENABLE", 0, True),
        ("arducopter", "own stacked", "FS_GCS_ENABLE", 5, False),
        ("arducopter", "land", "FS_GCS_ENABLE", 5, None),
        ("arducopter", "return stacked", "GUID_TIMEOUT", 3.0, False),
        ("arducopter", "return stacked", "GUID_TIMEOUT", 60.0, True),
        ("arducopter", "return stacked", "FS_EKF_ACTION", 0, True),
        ("arducopter", "return stacked", "FS_EKF_ACTION", 2, False),
        ("arducopter", "return stacked", "FS_THR_ENABLE", 3, False),
        ("arducopter", "return stacked", "BATT_FS_LOW_ACT", 0, True),
        ("arducopter", "return stacked", "BATT_FS_LOW_ACT", 1, False),
        ("arducopter", "return stacked", "SYSID_MYGCS", 252, True),
        ("arducopter", "return stacked", "RTL_ALT", 1500, True),
        ("arducopter", "return stacked", "RTL_ALT_M", 12.3, None),
        ("arducopter", "return stacked", "RTL_ALT_M", 15.0, True),
        ("arducopter", "return stacked", "RTL_CONE_SLOPE", 3.0, True),
        ("arducopter", "return stacked", "RTL_LOIT_TIME", 5000, True),
        ("arducopter", "return stacked", "ARMING_CHECK", 0, False),
    ],
)
def test_dangerous_values_are_refused_and_unusual_ones_told(
    autopilot: str, asked: str, name: str, value: float, grave: bool | None
) -> None:
    rules = AUTOPILOTS[autopilot].failsafes.rules(_wish(asked.split(maxsplit=1)[0], stacked="stacked" in asked))
    findings = [finding for rule in rules if (finding := rule.judge({name: value})) is not None]
    if grave is None:
        assert findings == []
        return
    (finding,) = findings
    assert (finding.name, finding.grave) == (name, grave)
    assert finding.text().startswith(f"{name} is ")
    assert finding.short().startswith(f"{name} is ")
