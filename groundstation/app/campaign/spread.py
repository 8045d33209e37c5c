"""Spreads cases over a Dask cluster: processes of this machine by default, any scheduler by its address.

Cases travel as values and bytes. No more of them are under way than keep the workers busy, so that a campaign of any
length stops at once. Knows nothing of what a row says.
"""

from __future__ import annotations

import logging
import os
import queue
import signal
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from types import FrameType
from typing import Any, Protocol

from groundstation.app.campaign.cases import Case
from groundstation.app.campaign.run import Row, fly_case, lost_row
from groundstation.core.errors import UserError
from groundstation.records.manifest import versions

_AHEAD = 3  # cases per thread that are waiting or being flown
_PATIENCE_S = 30.0
_LOOK_S = 0.2
_QUIET = {
    "distributed.comm.timeouts.connect": "10s",
    "distributed.scheduler.http.routes": [],  # nothing to be looked at over HTTP
    "distributed.worker.http.routes": [],
    "distributed.nanny.http.routes": [],
}


class Flyer(Protocol):
    """Flies cases somewhere, several at a time."""

    def submit(self, case: Case) -> None:
        """Takes a case."""

    def wait(self) -> list[Row]:
        """Rows that have come back; empty after a short wait in which none did."""

    @property
    def room(self) -> int:
        """How many more cases it should be given now."""


def fly_timed(case: Case) -> Row:
    """Flies a case on a worker; the row says how long it took."""
    start = time.perf_counter()
    row = fly_case(case)
    return {**row, "wall_s": time.perf_counter() - start}


class DaskFlyer:
    """Flies cases on the workers of a Dask client."""

    def __init__(self, client: Any) -> None:
        self._client = client
        self._done: queue.SimpleQueue[Any] = queue.SimpleQueue()
        self._cases: dict[Any, Case] = {}

    def submit(self, case: Case) -> None:
        """Takes a case."""
        future = self._client.submit(fly_timed, case, pure=False)
        self._cases[future] = case
        future.add_done_callback(self._done.put)

    def wait(self) -> list[Row]:
        """Rows that have come back."""
        rows = []
        try:
            future = self._done.get(timeout=_LOOK_S)
            while True:
                case = self._cases.pop(future)
                try:
                    rows.append(future.result())
                except Exception as error:  # a worker that died; the run is not lost, its row says so
                    rows.append({**lost_row(case, f"{type(error).__name__}: {error}"), "wall_s": float("nan")})
                future.release()
                future = self._done.get_nowait()
        except queue.Empty:
            pass
        return rows

    @property
    def room(self) -> int:
        """Grows and shrinks with the cluster."""
        threads = sum(self._client.nthreads().values()) or 1
        return int(_AHEAD * threads - len(self._cases))


class Interrupted:
    """Ctrl-C, seen between rows: the campaign ends with what is there."""

    def __init__(self) -> None:
        self.asked = False

    @contextmanager
    def listening(self) -> Iterator[None]:
        """Takes SIGINT and SIGTERM while the block runs."""

        def take(_signal: int, _frame: FrameType | None) -> None:
            self.asked = True

        before = {number: signal.signal(number, take) for number in (signal.SIGINT, signal.SIGTERM)}
        try:
            yield
        finally:
            for number, handler in before.items():
                signal.signal(number, handler)


def spread(cases: Iterator[Case], flyer: Flyer, keep: Callable[[list[Row]], None], interrupted: Interrupted) -> None:
    """Flies cases until there are none left or the operator wants to stop.

    Args:
        cases: in the order in which they are begun.
        flyer: who flies them.
        keep: is given rows as they come back, in any order; an empty list now and then.
        interrupted: looked at between rows.
    """
    under_way, left = 0, True
    while (left or under_way) and not interrupted.asked:
        while left and flyer.room > 0:
            case = next(cases, None)
            if case is None:
                left = False
                break
            flyer.submit(case)
            under_way += 1
        rows = flyer.wait()
        under_way -= len(rows)
        keep(rows)


@contextmanager
def dask_flyer(address: str | None, workers: int | None) -> Iterator[DaskFlyer]:
    """A Dask cluster for as long as the block runs.

    Args:
        address: of a scheduler; None for processes of this machine.
        workers: how many of them, None for one per core; 0 for a thread of this process.

    Raises:
        UserError: the scheduler does not answer, has no workers, or they run another version of this program.
    """
    import dask  # noqa: PLC0415 - takes half a second to load
    import distributed  # noqa: PLC0415

    package: Any = distributed  # its classes are not typed

    with ExitStack() as stack:
        stack.enter_context(dask.config.set(_QUIET))
        for name in ("distributed", "distributed.worker", "distributed.nanny", "distributed.scheduler"):
            logging.getLogger(name).setLevel(logging.CRITICAL)
        if address is None:
            # Whoever ignores Ctrl-C hands that down: the workers go on until this process ends them.
            before = signal.signal(signal.SIGINT, signal.SIG_IGN)
            for variable in ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS"):
                os.environ.setdefault(variable, "1")  # inherited by the workers
            try:
                cluster = package.LocalCluster(
                    n_workers=workers or (1 if workers == 0 else os.cpu_count()),
                    threads_per_worker=1,
                    processes=workers != 0,
                    dashboard_address="127.0.0.1:0",
                    silence_logs=logging.CRITICAL,
                )
            finally:
                signal.signal(signal.SIGINT, before)
            stack.enter_context(cluster)
            client = stack.enter_context(package.Client(cluster))
        else:
            try:
                client = stack.enter_context(package.Client(address, timeout=10))
                client.wait_for_workers(1, timeout=_PATIENCE_S)
            except (OSError, TimeoutError, ValueError) as error:
                raise UserError(f"--scheduler {address}: {error or 'no worker'}; start one, or leave it out") from None
            _check_workers(client, address)
        yield DaskFlyer(client)


def _check_workers(client: Any, address: str) -> None:
    """Refuses workers that would fly something else."""
    try:
        there = client.run(versions)
    except Exception as error:
        raise UserError(
            f"--scheduler {address}: a worker cannot run this program: {error}; install the same gs on all of them"
        ) from None
    for worker, theirs in there.items():
        if theirs != versions():
            raise UserError(f"--scheduler {address}: {worker} has {theirs}, this is {versions()}; install the same")
