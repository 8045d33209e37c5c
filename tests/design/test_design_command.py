"""``gs design`` as people and programs call it."""

from __future__ import annotations

import json
import re
import signal
import time
from pathlib import Path

import pytest
from typer.testing import CliRunner

from groundstation.app.cli import build
from groundstation.app.designing import interruptible
from groundstation.app.output import Output
from groundstation.app.resources import packaged_configs
from groundstation.core.errors import MissionFailed, UserError
from groundstation.design.problem import Progress
from groundstation.design.store import check_gains, load_formation, load_gains

CONTRACT = {
    "n",
    "edges",
    "feasible",
    "lambda_max",
    "lambda_min",
    "zero_eigenvalues",
    "kernel_residual",
    "method",
    "seconds",
}


def gs(*arguments: str) -> tuple[dict[str, object], BaseException | None]:
    """Runs ``gs design ... --json``: the object on the last line of stdout, and how it ended."""
    done = CliRunner().invoke(build("design"), ["design", *arguments, "--json"])
    lines = done.stdout.strip().splitlines()
    return (json.loads(lines[-1]) if lines else {}), done.exception


def test_answer_of_a_feasible_formation_follows_the_contract(tmp_path: Path) -> None:
    path = tmp_path / "gains.npz"
    answer, error = gs("two_squares8_low.yaml", "-o", str(path))
    assert error is None
    assert answer.keys() >= CONTRACT
    assert "reason" not in answer
    assert (answer["n"], answer["edges"], answer["feasible"], answer["zero_eigenvalues"]) == (8, 16, True, 6)
    assert answer["lambda_max"] == pytest.approx(-5.0, abs=5e-4)
    assert answer["lambda_min"] == pytest.approx(-10.0, abs=5e-4)
    assert isinstance(answer["kernel_residual"], float)
    assert answer["kernel_residual"] < 1e-9
    check_gains(load_gains(path), load_formation(packaged_configs() / "formations" / "two_squares8_low.yaml"))


@pytest.mark.parametrize("name", ["twisted_cube8", "parallelepiped8"])
def test_infeasible_formation_ends_with_1_stores_nothing_and_still_answers(name: str, tmp_path: Path) -> None:
    path = tmp_path / "gains.npz"
    answer, error = gs(f"{name}.yaml", "-o", str(path))
    assert isinstance(error, MissionFailed)
    assert error.exit_code == 1
    assert "not feasible" in str(error)
    assert answer["feasible"] is False
    assert "no gains on this graph" in str(answer["reason"])
    assert len(answer["mend"]) == 1  # type: ignore[arg-type]
    assert not path.exists()


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (("nowhere.yaml",), "nowhere.yaml: no such file"),
        (("cube8.yaml", "--method", "magic"), "--method magic: unknown"),
        (("cube8.yaml", "--method", "closed-form"), "the graph is not complete"),
        (("cube8.yaml", "--gap", "2"), "--gap 2: must lie between 0 and 1"),
        (("cube8.yaml", "--budget", "0"), "--budget 0: must be more than 0"),
        (("cube8.yaml", "--suggest-graph", "dense"), "--suggest-graph dense: unknown"),
        (("cube8.yaml", "--max-degree", "0"), "--max-degree 0: must be at least 1"),
        (("cube8.yaml", "--max-degree", "3"), "--max-degree: only for a suggested graph"),
        (("cube8.yaml", "--range", "3"), "--range: only for a suggested graph"),
        (("cube8.yaml", "--picture", "a.png"), "--picture: only for a suggested graph"),
        (("cube8.yaml", "--graph-file", "a.yaml"), "--graph-file: only for a suggested graph"),
        (("cube8.yaml", "--suggest-graph", "sparse", "--range", "-1"), "--range -1: must be more than 0 m"),
        (("cube8.yaml", "--suggest-graph", "sparse", "--range", "nan"), "--range nan: must be more than 0 m"),
        (("cube8.yaml", "--suggest-graph", "sparse", "--range", "0.1"), "allow a longer sensing range"),
        (("cube8.yaml", "-o", "/proc/nowhere/gains.npz"), "cannot be written"),
    ],
)
def test_wrong_usage_is_one_message_and_2(arguments: tuple[str, ...], message: str) -> None:
    _, error = gs(*arguments)
    assert isinstance(error, UserError)
    assert error.exit_code == 2
    assert message in str(error)


def test_suggested_graph_is_written_as_a_formation_that_can_be_designed(tmp_path: Path) -> None:
    graph, picture = tmp_path / "mine.yaml", tmp_path / "graph.png"
    answer, error = gs(
        "pyramid6.yaml",
        *("--suggest-graph", "balanced", "--max-degree", "4"),
        *("--graph-file", str(graph), "--picture", str(picture)),
    )
    assert error is None
    shape = load_formation(graph)
    assert [[i + 1, j + 1] for i, j in shape.edges] == answer["suggested_edges"]
    assert shape.adjacency.sum(axis=1).max() <= 4
    assert picture.read_bytes().startswith(b"\x89PNG")
    again, error = gs(str(graph))
    assert error is None
    assert again["lambda_max"] == pytest.approx(answer["lambda_max"])


def test_robustness_report_is_part_of_the_answer() -> None:
    answer, error = gs("tetrahedron4.yaml", "--robustness")
    assert error is None
    report = answer["robustness"]
    assert isinstance(report, dict)
    assert report["converged"] == report["runs"] == 20
    assert report["lyapunov_rises"] == 0
    assert report["condition"] == pytest.approx(1.0, abs=1e-6)
    assert len(report["losses"]) == 6 + 4


def test_spent_budget_keeps_what_is_certified_and_says_so(monkeypatch: pytest.MonkeyPatch) -> None:
    kept, undecided = 0, 0
    for budget in (0.2, 0.4, 0.6, 1, 2, 3, 4, 6, 8):
        clock_ns = iter(range(0, 10**15, 10**8))  # a tenth of a second passes with every look at it
        monkeypatch.setattr(time, "monotonic_ns", clock_ns.__next__)
        answer, error = gs("rings16.yaml", "--gap", "1e-9", "--budget", str(budget))
        if error is not None:
            undecided += 1
            assert str(answer["reason"]).startswith("undecided: time ran out")
            assert "not feasible" not in str(error)
            assert answer["feasible"] is False
            assert "mend" not in answer
            assert "edges" not in str(answer["reason"]), "time ran out, the graph is not to blame"
        elif not answer["finished"]:
            interval = answer["interval"]
            assert isinstance(interval, list)
            assert 0 < interval[0] < interval[1]
            kept += 1
    assert kept > 0
    assert undecided > 0


def test_names_that_look_like_markup_are_printed_as_they_are(tmp_path: Path) -> None:
    path = tmp_path / "odd.yaml"
    source = packaged_configs() / "formations" / "tetrahedron4.yaml"
    text = re.sub(r"^name: .*$", 'name: "a[/b]"', source.read_text(), flags=re.MULTILINE)
    path.write_text(text)
    for extra in ((), ("--suggest-graph", "sparse"), ("--robustness",)):
        done = CliRunner().invoke(build("design"), ["design", str(path), *extra])
        assert done.exception is None
        assert "a[/b]" in done.stdout


def test_interrupt_is_a_request_to_stop_and_the_second_one_quits() -> None:
    with interruptible(Output(as_json=True), None) as watch:
        assert not watch.stop()
        signal.raise_signal(signal.SIGINT)
        assert watch.stop()
        watch.report(Progress("xy", "splitting", 1, 0.1, 0.2))
        with pytest.raises(KeyboardInterrupt):
            signal.raise_signal(signal.SIGINT)
