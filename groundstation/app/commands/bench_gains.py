"""``gs bench gains``: measures of gain design."""

from __future__ import annotations

from pathlib import Path

from rich.table import Table
from threadpoolctl import threadpool_limits  # type: ignore[import-untyped]

from groundstation.app.bench_gains import BARS_S, draw, run
from groundstation.app.output import Output


def bench_gains(*, largest: int, picture: Path | None, as_json: bool) -> None:
    """Runs the benchmark of gain design.

    Args:
        largest: sparse graphs up to this many agents.
        picture: where to draw time over n, if anywhere.
        as_json: answer with one JSON object.
    """
    out = Output(as_json=as_json)
    with threadpool_limits(limits=1):
        report = run(largest=largest, tell=lambda what: out.console.print(what, style="dim"))
    table = Table("case", "method", "n", "edges", "seconds", "gap", "slowest mode", "bar")
    for timing in report.timings:
        bar = (
            f"{BARS_S[timing.case]:g} s {'kept' if report.within[timing.case] else 'MISSED'}"
            if timing.case in BARS_S
            else ""
        )
        row = [
            str(timing.n),
            str(timing.edges),
            f"{timing.seconds:.4f}",
            f"{timing.gap:.2g}",
            f"{timing.slowest:.4f} 1/s",
        ]
        table.add_row(timing.case, timing.method, *row, bar)
    out.console.print(table)
    out.console.print(f"largest difference from Clarabel: {report.agreement:.2g} 1/s")
    out.console.print(
        f"two_squares8_low: {report.speedup:.0f} times faster than the authors' formulation ({report.baseline_s:.3f} s)"
    )
    if picture is not None:
        draw(picture, report)
        out.console.print(f"written: {picture}", markup=False)
    out.result(
        {
            "agreement": report.agreement,
            "baseline_s": report.baseline_s,
            "speedup": report.speedup,
            "timings": [vars(timing) for timing in report.timings],
            "within": report.within,
        }
    )
