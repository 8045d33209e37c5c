"""Laws and avoidance of one's own: they fly under all limits, are recorded, and their mistakes end safely."""

from __future__ import annotations

import json
import re
import shlex
import sys
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from groundstation.app.emulator import world_config
from groundstation.app.law_watch import LawWatch
from groundstation.app.session import Session
from groundstation.app.verify import verify_log
from groundstation.core.control import ScaleFunction, Task
from groundstation.core.errors import UserError
from groundstation.core.law import OwnCodeError, OwnLaw, Seen, seen_by
from groundstation.core.views import LocalViews
from groundstation.mission.plan import own_code
from groundstation.mission.plan.own_code import CodeSource
from groundstation.mission.plan.plan import MissionPlan
from groundstation.mission.plan.reading import load_mission
from groundstation.mission.runner import Phase, Runner
from groundstation.records.manifest import read_manifest
from sitl.world import World
from tests.app.commands import gs
from tests.app.flights import CUBE8, FULL_RATE, HALF_RATE, SECOND_NS, Flight, without_chatter

_TWO = (
    HALF_RATE,
    "formation=../formations/pair2.yaml",
    "formation_scale=1.5",
    "gains=../gains/pair2.npz",
    "vehicles=[{id: 1, link: 'udpin://127.0.0.1:14540', pad_m: [0, 0, 0]},"
    " {id: 2, link: 'udpin://127.0.0.1:14540', pad_m: [1, 0, 0]}]",
    "steps=[{form: {tolerance_m: 0.05, timeout_s: 4}}, {hold: {seconds: 1}}]",
)
_SOUND = "0.8 * np.where(seen.neighbours, seen.range_m - seen.distances_m, 0.0)[..., None] * seen.rel_pos_flu_m"
_LAW = """import sys
import numpy as np

class Law:
    def __init__(self, **options):
        self.calls, self.options = 0, options

    def __call__(self, seen):
        self.calls += 1
        {line}
        return ({sound}).sum(axis=1)
"""


def _law(folder: Path, line: str = "pass") -> Path:
    """Writes a law that is sound but for one line."""
    file = folder / "bad_law.py"
    file.write_text(_LAW.format(line=line, sound=_SOUND))
    return file


def _two(folder: Path, *changes: str, given: dict[str, Any] | None = None) -> MissionPlan:
    """Two small vehicles, flown by what lies in a folder, or by what is given."""
    return load_mission(CUBE8, (*_TWO, *changes), CodeSource((folder,), given or {}))


def test_a_law_of_twenty_lines_from_elsewhere_flies_the_cube_and_its_log_verifies(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    code, out, _ = gs(["new", "law", "mine", "--json"], monkeypatch, capsys)
    made = json.loads(out.splitlines()[-1])
    assert (code, made) == (0, {"file": "mine.py", "use": "mine:MyLaw"})
    body = Path("mine.py").read_text().partition("class MyLaw")[2]
    assert len([line for line in body.splitlines() if line.strip()]) <= 20
    assert gs(["new", "law", "mine"], monkeypatch, capsys)[0] == 2  # it is there already

    log = tmp_path / "cube.tlog"
    plan = load_mission(CUBE8, ("law=mine:MyLaw", "steps.1.hold.seconds=1"))
    flight = Flight(plan, log=log)
    assert flight.runner.outcome == "completed"
    assert flight.meter.formation_error_m < 0.05
    assert flight.world.min_distance_airborne_m >= plan.spec.avoidance.radius_m
    assert any("law mine:MyLaw asks for" in text and "is shortened" in text for text in flight.texts("info"))

    recorded = read_manifest(tmp_path / "cube.manifest.json").mission
    assert recorded["law"] == {"use": "mine:MyLaw", "options": {}}
    assert recorded["own_code"]["law"]["version"] == "0.1"
    verified = verify_log(log, CodeSource((tmp_path,)))
    assert (verified.mismatches, verified.setpoints) == (0, flight.runner.setpoints_sent)

    with pytest.raises(UserError, match=r"there is no module mine .*; name its folder with --laws"):
        verify_log(log)
    Path("mine.py").write_text("raise SystemExit('was run')")
    with pytest.raises(UserError, match=r"mine:MyLaw is not the code that was flown \(version 0.1 of it"):
        verify_log(log, CodeSource((tmp_path,)))
    code, _, err = gs(["replay", str(log), "--verify", "--laws", str(tmp_path)], monkeypatch, capsys)
    assert (code, "is not the code that was flown" in err) == (2, True)


@pytest.mark.parametrize(
    ("line", "words"),
    [
        ("self.calls < 20 or 1 / 0", "failed: ZeroDivisionError: division by zero (bad_law.py, line 10)"),
        (
            "if self.calls > 20: return np.full((2, 3), np.nan)",
            "velocities that are no finite numbers for vehicles 1, 2",
        ),
    ],
)
def test_a_law_that_fails_in_the_air_brings_everybody_home_and_is_told(line: str, words: str, tmp_path: Path) -> None:
    _law(tmp_path, line)
    log = tmp_path / "bad.tlog"
    flight = Flight(_two(tmp_path, "law=bad_law:Law"), log=log)
    assert flight.runner.outcome == "aborted"
    assert flight.runner.reason.startswith("law bad_law:Law ")
    assert words in flight.runner.reason
    assert flight.texts("alarm")[0] == flight.runner.reason
    assert flight.phase_seen[-4:] == [Phase.FORM, Phase.RETURN, Phase.LAND, Phase.DONE]
    truth = flight.world.truth
    assert not truth.armed.any()
    assert np.linalg.norm(truth.pos_enu_m - flight.plan.pads_enu_m, axis=1).max() < 0.2
    assert verify_log(log, CodeSource((tmp_path,))).mismatches == 0


@pytest.mark.parametrize(
    ("answer", "words"),
    [
        (lambda seen: sys.exit(0), "failed: SystemExit: 0 (test_own_laws.py, line"),
        (lambda seen: [[0, 0, 0], [0, np.inf, 0]], "answered with velocities that are no finite numbers for vehicle 9"),
        (lambda seen: np.zeros((3, 2)), "answered with an array of shape (3, 2), expected (2, 3)"),
        (lambda seen: None, "answered with an array of shape (), expected (2, 3)"),
        (lambda seen: [[0], [1, 2]], "failed: ValueError: setting an array element"),
        (lambda seen: [[1j, 0, 0]] * 2, "failed: TypeError: velocities are complex numbers"),
        (lambda seen: seen.rel_pos_flu_m.fill(0.0), "failed: ValueError: assignment destination is read-only"),
        (lambda seen: seen.vel_flu_m_s.sort(), "failed: ValueError: sort array is read-only"),
    ],
)
def test_whatever_a_law_does_wrong_is_one_error_in_words(answer: Callable[..., Any], words: str) -> None:
    with pytest.raises(OwnCodeError) as told:
        OwnLaw("law here:Law", answer, [3, 9])(_seen())
    assert str(told.value).startswith(f"law here:Law {words}")


def test_what_a_law_sets_of_numpy_and_keeps_of_its_answer_is_nobody_elses() -> None:
    kept = np.ones((2, 3))

    def law(seen: Seen) -> Any:
        np.seterr(all="raise")
        return kept

    answer = OwnLaw("law here:law", law, [3, 9])(_seen())
    kept[:] = np.nan
    assert np.array_equal(answer, np.ones((2, 3)))
    assert np.geterr()["divide"] == "warn"


def _seen() -> Seen:
    rel = np.array([[[np.nan] * 3, [1.0, 0.0, 0.0]], [[-1.0, 0.0, 0.0], [np.nan] * 3]])
    near = ~np.eye(2, dtype=np.bool_)
    zeros = np.zeros((2, 2))
    return seen_by(
        LocalViews(rel, np.full((2, 2, 3), np.nan), near, np.full((2, 3), np.nan)),
        Task(zeros.astype(complex), zeros, near, zeros, zeros),
        ScaleFunction(),
        1.0,
        lead_s=0.0,
        upright_1_s=1.0,
        speed_limit_m_s=0.5,
        period_s=0.02,
    )


def test_what_is_not_seen_is_zero_and_never_nan() -> None:
    seen = _seen()
    assert seen.range_m.tolist() == [[0.0, 1.0], [1.0, 0.0]]
    assert not seen.rel_vel_flu_m_s.any()
    assert not seen.vel_flu_m_s.any()


@pytest.mark.parametrize("way", [-1.0, 1.0], ids=["apart", "together"])
def test_a_law_that_is_too_fast_is_held_to_speed_fence_and_distance(way: float, tmp_path: Path) -> None:
    _law(tmp_path, f"return {way} * 1e6 * seen.rel_pos_flu_m.sum(axis=1)")
    seen: list[tuple[float, float]] = []

    def look(flight: Flight) -> bool:
        if flight.runner.phase is Phase.FORM:
            speed = np.linalg.norm(flight.runner._sent_ned_m_s, axis=1).max()
            seen.append((float(speed), float(np.abs(flight.world.truth.pos_enu_m).max())))
        return False

    flight = Flight(_two(tmp_path, "law=bad_law:Law"), interrupt_when=look)
    speed, reach = np.max(seen, axis=0)
    assert 0.4 < speed <= 0.5 + 1e-12
    assert reach < 3.0
    assert flight.world.min_distance_airborne_m >= 0.45
    assert flight.runner.outcome == "aborted"
    assert flight.runner.reason.startswith("not formed after 4 s: a distance is")
    assert [text for text in flight.texts("info") if "m/s of vehicle" in text and "speed_limit_m_s is 0.5" in text]


def test_a_law_that_goes_nowhere_ends_when_the_time_for_it_is_over(tmp_path: Path) -> None:
    _law(tmp_path, "return np.zeros((2, 3))")
    flight = Flight(_two(tmp_path, "law=bad_law:Law", "steps.0.form.timeout_s=3"))
    assert flight.runner.reason.startswith("not formed after 3 s")
    assert not flight.world.truth.armed.any()


@pytest.mark.parametrize(
    ("took_s", "words"),
    [
        (0.045, "ticks a second, minimum is 25; everybody comes back"),
        (1.5, "the ground station stood still for 1.52 s"),
    ],
)
def test_a_law_that_takes_too_long_loses_the_team_which_comes_home(took_s: float, words: str, tmp_path: Path) -> None:
    clock = SimpleNamespace(now_ns=0)

    class Slow:
        def __init__(self) -> None:
            self.calls = 0

        def __call__(self, seen: Seen) -> Any:
            self.calls += 1
            if self.calls > 50:  # time passes while it thinks
                clock.now_ns += round(took_s * SECOND_NS)
            return np.zeros((2, 3))

    plan = _two(tmp_path, FULL_RATE, "law=here:Slow", "steps.0.form.timeout_s=60", given={"law": Slow})
    world = World(without_chatter(world_config(plan, 1)), 1)
    runner = Runner(plan, 0)
    session = Session(runner, None)
    alarms: list[str] = []
    while not runner.done:
        clock.now_ns += round(SECOND_NS / plan.spec.rate_hz)
        now_ns = clock.now_ns
        for sent in world.advance(now_ns):
            session.deliver(0, f"emulator:{plan.spec.vehicles[sent.vehicle_index].id}", sent.data, sent.t_ns)
        for datagram in session.tick(now_ns):
            world.receive(int(datagram.peer.partition(":")[2]) - 1, b"".join(datagram.frames), now_ns)
        alarms += [note.text for note in session.take_notes() if note.kind == "alarm"]
        assert now_ns < 200 * SECOND_NS
    assert runner.outcome == "aborted"
    assert any(words in text for text in alarms), alarms
    assert not world.truth.armed.any()
    assert world.min_distance_airborne_m >= 0.45


def test_how_long_a_law_takes_is_told_and_so_is_one_that_never_comes_back(tmp_path: Path) -> None:
    clock = SimpleNamespace(now_ns=0)
    watches: list[LawWatch] = []
    stuck: list[str] = []

    def thoughtful(seen: Seen) -> Any:
        clock.now_ns += 15_000_000
        stuck.append(watches[0].stuck())
        clock.now_ns += 3 * SECOND_NS if len(stuck) == 3 else 0
        stuck.append(watches[0].stuck())
        return np.zeros((2, 3))

    plan = _two(tmp_path, FULL_RATE, given={})
    found = CodeSource(given={"law": lambda seen: np.zeros((2, 3))}).find("law", "here:thoughtful", {}, "x")
    code = own_code.OwnCode("here:thoughtful", lambda: thoughtful, found.version, found.sha256)
    watch = LawWatch(_with(plan, code), lambda: clock.now_ns)
    watches.append(watch)
    session = Session(Runner(watch.plan, 0), None)
    asked = watch.plan.own_code["law"].make()
    watch(session, 0)
    assert not session.take_notes()
    asked(None)
    watch(session, 0)
    watch(session, 0)
    (note,) = session.take_notes()
    assert note.text.startswith("here:thoughtful took 15 ms, a tick has 20 ms for everything")
    asked(None)
    assert [words[:45] for words in stuck] == ["", "", "", "gs: here:thoughtful has not come back for 3 s"]
    assert watch.stuck() == ""


def _with(plan: MissionPlan, code: own_code.OwnCode) -> MissionPlan:
    from dataclasses import replace

    return replace(plan, own_code={"law": code})


def test_avoidance_of_ones_own_flies_formations_alone_and_the_damper_keeps_r(tmp_path: Path) -> None:
    asked: list[Phase] = []
    flights: list[Flight] = []

    class Careless:
        """Turns away from nobody."""

        def __call__(self, views: Any, desired_flu_m_s: Any, region: Any) -> Any:
            asked.extend(flight.runner.phase for flight in flights)
            return 3.0 * desired_flu_m_s

    def collide(seen: Seen) -> Any:
        return 10.0 * seen.rel_pos_flu_m.sum(axis=1)

    plan = _two(
        tmp_path, "law=here:collide", "avoidance.law=here:Careless", given={"law": collide, "avoidance.law": Careless}
    )
    log = tmp_path / "own.tlog"

    def note(flight: Flight) -> bool:
        if not flights:
            flights.append(flight)
        return False

    flight = Flight(plan, interrupt_when=note, log=log)
    assert flight.world.min_distance_airborne_m >= 0.45
    assert set(asked) == {Phase.FORM}
    assert {Phase.TAKEOFF, Phase.RETURN, Phase.LAND} < set(flight.phase_seen)
    given: dict[str, Any] = {"law": collide, "avoidance.law": Careless}
    assert verify_log(log, CodeSource(given=given)).mismatches == 0


@pytest.mark.parametrize(
    ("text", "use", "words"),
    [
        (None, "nowhere:Law", "law: there is no module nowhere (looked for "),
        ("class Law: ...", "mine:Low", "has no Low, did you mean Law?"),
        ("class Law(: ...", "mine:Law", "mine:Law cannot be loaded: SyntaxError: invalid syntax"),
        ("import nothing_such", "mine:Law", "cannot be loaded: ModuleNotFoundError: No module named 'nothing_such'"),
        ("raise SystemExit(3)", "mine:Law", "cannot be loaded: SystemExit: 3 (mine.py, line 1)"),
        ("Law = 3", "mine:Law", "mine:Law cannot be called; name a function, or a class"),
        ("class Law: ...", "mine:Law", "its objects cannot be called; give it a method __call__"),
        (
            "class Law:\n def __init__(self, a): ...\n def __call__(self, seen): ...",
            "mine:Law",
            "cannot be made: TypeError",
        ),
        ("def law(seen):\n return seen.nothing", "mine:law", "failed: AttributeError: 'Seen' object has no attribute"),
        ("def law(seen):\n return [1, 2]", "mine:law", "answered with an array of shape (2,), expected (2, 3)"),
        (None, "1 2:Law", "1 2:Law is no name; write MODULE:NAME"),
        (None, "swarm", "no swarm is offered by the entry points groundstation.laws (none is installed)"),
    ],
)
def test_a_law_that_cannot_fly_is_refused_on_the_desk(text: str | None, use: str, words: str, tmp_path: Path) -> None:
    if text is not None:
        (tmp_path / "mine.py").write_text(text)
    with pytest.raises(UserError) as refused:
        _two(tmp_path, f"law='{use}'")
    assert str(refused.value).startswith(f"{CUBE8}: law: ")
    assert words in str(refused.value)


def test_an_installed_package_offers_its_law_under_a_name(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def still(seen: Seen, weight: float = 1.0) -> Any:
        return np.full((2, 3), weight)

    point = SimpleNamespace(name="still", load=lambda: still, dist=SimpleNamespace(version="2.1"))
    offered: Callable[..., list[Any]] = lambda group: [point] if group == "groundstation.laws" else []  # noqa: E731
    monkeypatch.setattr("importlib.metadata.entry_points", offered)
    plan = _two(tmp_path, "law={use: still, options: {weight: 0.25}}")
    assert plan.own_code["law"].version == "2.1"
    assert np.asarray(plan.own_code["law"].make()(None)).tolist() == [[0.25] * 3] * 2
    with pytest.raises(UserError, match=r"no calm is offered .* \(installed are still\)"):
        _two(tmp_path, "law=calm")


def test_the_law_of_the_page_flies_as_the_page_says(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    page = (Path(__file__).parents[2] / "docs" / "own-laws.md").read_text(encoding="utf-8")
    commands = re.search(r"```\n(gs init rigid.*?)```", page, re.DOTALL)
    law = re.search(r"```python\n(.*?)```", page, re.DOTALL)
    assert commands is not None
    assert law is not None
    monkeypatch.chdir(tmp_path)
    Path("gradient.py").write_text(law[1])
    *first, fly = [shlex.split(re.sub(r"\s#.*", "", line))[1:] for line in commands[1].splitlines()]
    for line in first:
        assert gs(line, monkeypatch, capsys)[0] == 0, line
    # Half the rate, a short hold: to save time only.
    cheap = ["rate_hz=25", "steps.1.hold.seconds=0.5"]
    code, out, _ = gs([*fly, "--json", *(part for item in cheap for part in ("--set", item))], monkeypatch, capsys)
    flown = json.loads(out.splitlines()[-1])
    assert (code, flown["outcome"], flown["converged"]) == (0, "completed", True)


@pytest.mark.parametrize(
    ("took_ms", "every", "words"),
    [
        (3, 1, ""),
        (60, 1, "less than half of the ticks are made in time: everybody comes back"),
        (60, 10, "ticks are late, and it is said"),
        (60, 40, ""),  # a machine that had other things to do now and then
        (1_500, 40, "one call takes longer than limits.late_s, 1 s: everybody comes back"),
    ],
)
def test_a_law_that_is_too_slow_is_told_in_a_dry_run_and_changes_nothing_in_it(
    took_ms: int, every: int, words: str, tmp_path: Path
) -> None:
    file = _law(tmp_path)
    plan = load_mission(CUBE8, [*_TWO, "law=bad_law:Law"], CodeSource((tmp_path,)))
    assert file.exists()
    clock = SimpleNamespace(now_ns=0, calls=0)
    watch = LawWatch(plan, lambda: clock.now_ns, dry=True)
    session = SimpleNamespace(notes=[])
    answer = watch.plan.own_code["law"].make()
    made = plan.own_code["law"].make
    slow = replace(plan.own_code["law"], make=lambda: _slow(made(), clock, took_ms, every))
    watch = LawWatch(replace(plan, own_code={"law": slow}), lambda: clock.now_ns, dry=True)
    answer = watch.plan.own_code["law"].make()
    seen = SimpleNamespace(
        neighbours=np.ones((2, 2), bool),
        range_m=np.ones((2, 2)),
        distances_m=np.ones((2, 2)),
        rel_pos_flu_m=np.zeros((2, 2, 3)),
    )
    for _ in range(100):
        answer(seen)
        watch(session, 0)  # type: ignore[arg-type]
    assert watch.words().removesuffix(". Make it faster, or lower rate_hz").endswith(words)
    assert bool(watch.words()) == bool(words) == bool(session.notes)
    assert watch.figures()["law_time"]["ticks"] == 100  # type: ignore[index]


def _slow(answer: Callable[..., Any], clock: SimpleNamespace, took_ms: int, every: int) -> Callable[..., Any]:
    """The same law, by a clock that moves on when it is asked: each time by 1 ms, and every so often by more."""

    def asked(*given: Any) -> Any:
        clock.calls += 1
        clock.now_ns += (took_ms if clock.calls % every == 0 else 1) * 1_000_000
        return answer(*given)

    return asked


def test_a_slow_law_is_told_at_the_end_of_a_plain_dry_run_which_is_the_same_flight(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    changes = [part for change in (*_TWO, "law=bad_law:Law", "rate_hz=10") for part in ("--set", change)]
    logs = []
    for name, line in (("quick", "pass"), ("slow", "import time; time.sleep(0.06 if 20 < self.calls < 30 else 0.0)")):
        _law(tmp_path, line)
        fly = ["fly", "--mission", str(CUBE8), "--dry-run", "--log", f"{name}.tlog", "--json", *changes]
        _, out, err = gs(fly, monkeypatch, capsys)
        answer = json.loads(out.splitlines()[-1])
        said = " ".join(err.split())
        logs.append(Path(f"{name}.tlog").read_bytes())
        assert ("bad_law:Law took" in said) == bool(answer["law_time"]["words"]) == (name == "slow"), said
    assert logs[0] == logs[1]
