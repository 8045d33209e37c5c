"""The radios' budget: what is refused, and that the rate that is named instead really fits."""

from __future__ import annotations

import re
import struct
import threading
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from groundstation.core.errors import UserError
from groundstation.gateway.budget import (
    LEAST_HZ,
    USABLE,
    Rates,
    capacity,
    check,
    fitting,
    table,
    transactions,
)
from groundstation.gateway.orders import ExternalPose
from groundstation.mavlink.addresses import radio_of
from tests.app.commands import gs

FAST = Rates(50.0, 100.0, 100.0)


def test_a_vehicle_costs_the_busier_of_its_two_directions() -> None:
    assert transactions(1, Rates(20.0, 50.0)) == transactions(1, Rates(40.0, 50.0))
    assert transactions(1, Rates(80.0, 50.0)) > transactions(1, Rates(40.0, 50.0))
    assert transactions(6, Rates(20.0, 50.0)) == 6 * transactions(1, Rates(20.0, 50.0))


def test_poses_for_two_in_one_packet_cost_less_than_one_for_each() -> None:
    alone = Rates(25.0, 25.0, 100.0)
    assert transactions(8, replace(alone, broadcast=True)) < 0.75 * transactions(8, alone)


def test_a_slower_radio_carries_less() -> None:
    assert 100.0 < capacity("250K") < capacity("1M") < capacity("2M") < 1100.0


_WANTED = st.builds(Rates, st.floats(5, 100), st.floats(5, 100), st.floats(5, 200), st.booleans())


@given(st.integers(1, 40), _WANTED, st.floats(50, 2000))
def test_what_is_said_to_fit_fits_and_hardly_more_would(vehicles: int, rates: Rates, packets_s: float) -> None:
    fits = fitting(vehicles, rates, packets_s)
    if fits is None:
        least = min(rates.setpoint_hz, rates.log_hz, rates.pose_hz)
        assert transactions(vehicles, rates.scaled(min(1.0, LEAST_HZ / least))) > USABLE * packets_s * 0.999
        return
    assert transactions(vehicles, fits) <= USABLE * packets_s * (1 + 1e-9)
    assert fits == rates or transactions(vehicles, fits) > 0.999 * USABLE * packets_s


def test_too_much_is_refused_with_the_rate_that_fits() -> None:
    with pytest.raises(UserError, match=r"radio 0: 8 vehicles, 816 packets/s of 600 usable .* would fit") as told:
        check({"0": (8, 1000.0), "1": (1, 1000.0)}, Rates(50.0, 100.0, 50.0))
    setpoint_hz, log_hz = map(float, re.findall(r"at (\d+) Hz", str(told.value))[:2])
    assert transactions(8, Rates(setpoint_hz, log_hz, setpoint_hz)) <= 600.0
    with pytest.raises(UserError, match=r"not even 10 Hz fit; at most \d+ vehicles on this radio, use more radios"):
        check({"0": (60, 1000.0)}, FAST)


def test_more_radios_carry_more() -> None:
    lines = table(8, FAST, 1000.0)
    assert [line.split(":")[0] for line in lines] == [
        "1 radio, 8 vehicles each", "2 radios, 4 vehicles each", "3 radios, 3 vehicles each",
    ]  # fmt: skip
    assert "fits with setpoints at" in lines[0]
    assert lines[2].endswith(": fits")


def test_an_address_names_its_radio() -> None:
    assert radio_of("radio://2/80/1M/E7E7E7E701") == ("2", "1M")
    assert radio_of("udp://127.0.0.1:19850") is None
    for wrong in ("radio://0", "radio://0/80/3M/E7E7E7E701", "radio://0/x/2M/E7"):
        with pytest.raises(UserError, match="expected radio://"):
            radio_of(wrong)


@pytest.mark.parametrize(
    ("words", "told"),
    [
        ([], "--vehicle: none given"),
        (["-v", "1"], "expected ID=ADDRESS"),
        (["-v", "0=udp://127.0.0.1:1"], "expected ID=ADDRESS"),
        (["-v", "1=udp://127.0.0.1:1", "-v", "1=udp://127.0.0.1:2"], "stands twice"),
        (["-v", "1=udp://127.0.0.1:1", "-v", "2=udp://127.0.0.1:1"], "stands twice"),
        (
            [w for k in range(8) for w in ("-v", f"{k + 1}=radio://0/80/250K/E7E7E7E70{k}")],
            "would fit",
        ),
    ],
)
def test_wrong_vehicles_and_radios_that_are_too_full_are_refused_before_anything_is_opened(
    words: list[str], told: str, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    code, _, err = gs(["gateway", "crazyflie", *words], monkeypatch, capsys)
    assert code == 2
    assert told in err
    assert len(err.splitlines()) == 1


def test_the_budget_is_printed_for_one_two_and_three_radios(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    vehicles = [w for k in range(8) for w in ("-v", f"{k + 1}=radio://{k % 2}/80/2M/E7E7E7E70{k}")]
    code, out, _ = gs(["gateway", "crazyflie", *vehicles, "--budget"], monkeypatch, capsys)
    assert code == 0
    assert [line for line in out.splitlines() if line.startswith(("1 radio,", "2 radios,", "3 radios,"))]
    assert "radio 0: 4 vehicles" in out
    assert "radio 1: 4 vehicles" in out


def test_broadcasts_go_where_every_crazyflie_listens_once_each_and_places_without_an_attitude_by_themselves(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    pytest.importorskip("cflib", reason="cflib is not installed")
    from groundstation.app.gateway import broadcasting

    done: list[tuple[str, Any]] = []
    sent = threading.Event()

    class Radio:
        def __getattr__(self, name: str) -> Callable[[Any], None]:
            def note(value: Any = None) -> None:
                done.append((name, value))
                if name == "set_arc" and value:
                    sent.set()

            return note

    monkeypatch.setattr("cflib.crtp.radiodriver.RadioManager.open", lambda _number: Radio())
    uris = {k: f"radio://0/80/2M/E7E7E7E70{k}" for k in (1, 2, 3)} | {4: "radio://0/80/2M/AABBCCDD04"}
    (one,) = broadcasting.broadcasts(uris | {9: "radio://0/80/2M/AABBCCDD05", 5: "radio://0/80/2M/E7E7E7E705"})
    assert one.sysids == [1, 2, 3, 4]  # 5 and 9 end alike
    level = (0.0, 0.0, 0.0, 1.0)
    one.send({1: ExternalPose((1.0, 2.0, 0.5), level), 2: ExternalPose((0.0, 0.0, 0.5), None)})
    assert sent.wait(30.0)
    one.close()
    assert ("set_address", (0xFF, 0xE7, 0xE7, 0xE7, 0xE7)) in done
    assert [name for name, _ in done if name in ("set_arc", "send_packet")] == [
        "set_arc", "send_packet", "send_packet", "set_arc",
    ]  # fmt: skip
    with_attitude, place = (bytes(value) for name, value in done if name == "send_packet")
    # As extPosePackedItem and extPositionPackedItem of the firmware: id, millimetres, and the compressed quaternion.
    assert with_attitude[1:2] + with_attitude[2:9] == b"\x09" + struct.pack("<Bhhh", 1, 1000, 2000, 500)
    assert len(with_attitude) == 1 + 1 + 11
    assert (place[0] & 3, place[1:]) == (2, struct.pack("<Bhhh", 2, 0, 0, 500))
