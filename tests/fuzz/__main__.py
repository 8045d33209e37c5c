"""Throws bytes at every parser: ``python -m tests.fuzz [--bytes N] [--seed S] [--only NAME ...]``.

Cases that break a promise are written to files, with the traceback beside them; the exit code is 1 then.
"""

from __future__ import annotations

import argparse
import resource
import sys
import time
import traceback
from dataclasses import dataclass, field
from pathlib import Path
from random import Random
from tempfile import TemporaryDirectory

from tests.fuzz.mutate import Mutator
from tests.fuzz.targets import TARGETS, Target

_FINDINGS_MAX = 20


@dataclass
class Outcome:
    """What one target did with its bytes."""

    cases: int = 0
    size: int = 0
    seconds: float = 0.0
    findings: dict[str, tuple[bytes, str]] = field(default_factory=dict)


def fuzz(kind: type[Target], size: int, seed: int) -> Outcome:
    """Throws ``size`` bytes at one target; the same seed gives the same cases."""
    outcome, started = Outcome(), time.monotonic()
    random = Random(f"{kind.name} {seed}")
    with TemporaryDirectory() as folder:
        target = kind(Path(folder), random)
        mutator = Mutator(target.samples(), target.words, random)
        while outcome.size < size and len(outcome.findings) < _FINDINGS_MAX:
            data = mutator.case()
            outcome.cases += 1
            outcome.size += len(data)
            try:
                target.run(data)
            except Exception:
                lines = traceback.format_exc()
                where = "".join(line for line in lines.splitlines() if line.startswith("  File"))
                outcome.findings.setdefault(where, (data, lines))
    outcome.seconds = time.monotonic() - started
    return outcome


def main() -> int:
    """Runs it from the command line."""
    parser = argparse.ArgumentParser(prog="python -m tests.fuzz", description=__doc__)
    parser.add_argument("--bytes", type=int, default=10_000_000, help="bytes for each target")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--only", nargs="*", choices=[kind.name for kind in TARGETS], help="these targets alone")
    parser.add_argument("--findings", type=Path, default=Path("fuzz-findings"), help="folder for cases that fail")
    options = parser.parse_args()
    failed = 0
    for kind in TARGETS:
        if options.only and kind.name not in options.only:
            continue
        outcome = fuzz(kind, options.bytes, options.seed)
        peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss >> 10
        print(  # noqa: T201
            f"{kind.name:10} {outcome.size:>11,} bytes {outcome.cases:>8,} cases {outcome.seconds:7.1f} s"
            f" {len(outcome.findings)} findings, at most {peak} MB",
            flush=True,
        )
        for number, (data, lines) in enumerate(outcome.findings.values()):
            failed += 1
            options.findings.mkdir(exist_ok=True)
            stem = options.findings / f"{kind.name}-seed{options.seed}-{number}"
            stem.with_suffix(".bin").write_bytes(data)
            stem.with_suffix(".txt").write_text(lines)
            print(lines[-2000:], file=sys.stderr)  # noqa: T201
    return 1 if failed else 0


if __name__ == "__main__":
    sys.exit(main())
