"""Spreads cases over a Dask cluster: processes of this machine by default, any scheduler by its address.

Cases travel as values and bytes. No more of them are under way than keep the workers busy, so that a campaign of any
length stops at once. A run whose workers died, Dask gives it to four of them, counts as not flown: what comes of it
nobody knows, and flown again it may well come to something. Knows nothing of what a row says.
"""

from __future__ import annotations

import logging
import os
import queue
import signal
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from types import FrameType
from typing import Any, Protocol

from groundstation.app.campaign.cases import Case
from groundstation.app.campaign.run import Row, fly_case
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


@dataclass(frozen=True)
class Lost:
    """A run that was not flown, since whoever was to do it died or could not.

    Attributes:
        run: its number.
        why: in words.
    """

    run: int
    why: str


class Flyer(Protocol):
    """Flies cases somewhere, several at a time."""

    def submit(self, case: Case) -> None:
        """Takes a case."""

    def wait(self) -> list[Row | Lost]:
        """What has come back; empty after a short wait in which nothing did."""

    @property
    def room(self) -> int:
        """How many more cases it should be given now."""


def fly_timed(case: Case) -> Row:
    """Flies a case on a worker; the row says how long it took."""
    start = time.perf_counter()
    row = fly_case(case)
    return {**row, "wall_s": time.perf_counter() - start}


class DaskFlyer:
    """Flies cases on the workers of a Dask client.

    Args:
        client: of the scheduler.
        where: the workers are, in words.
        tell: is given a line when there are no workers, and when there are again.
    """

    def __init__(self, client: Any, where: str, tell: Callable[[str], None]) -> None:
        self._client, self._where, self._tell = client, where, tell
        self._done: queue.SimpleQueue[Any] = queue.SimpleQueue()
        self._cases: dict[Any, Case] = {}
        self._deserted = False

    def submit(self, case: Case) -> None:
        """Takes a case."""
        future = self._client.submit(fly_timed, case, pure=False)
        self._cases[future] = case
        future.add_done_callback(self._done.put)

    def wait(self) -> list[Row | Lost]:
        """What has come back; where nothing does, looks whether there is anybody."""
        back: list[Row | Lost] = []
        try:
            future = self._done.get(timeout=_LOOK_S)
            while True:
                case = self._cases.pop(future)
                try:
                    back.append(future.result())
                except Exception as error:  # not of the run, which would be a row: of who was to fly it
                    back.append(Lost(case.run, _why(error)))
                future.release()
                future = self._done.get_nowait()
        except queue.Empty:
            pass
        if not back:
            self._look()
        return back

    def _look(self) -> None:
        """Tells when the last worker is gone, and when there is one again."""
        deserted = not self._threads()
        if deserted and not self._deserted:
            self._tell(f"no workers {self._where}; waiting for one (Ctrl-C stops, --resume goes on)")
        elif self._deserted and not deserted:
            self._tell(f"there are workers {self._where} again")
        self._deserted = deserted

    @property
    def room(self) -> int:
        """Grows and shrinks with the cluster."""
        return _AHEAD * (self._threads() or 1) - len(self._cases)

    def _threads(self) -> int:
        """How many cases the workers can fly at a time.

        Raises:
            UserError: the scheduler is gone.
        """
        try:
            return sum(self._client.nthreads().values())
        except OSError:
            raise UserError(f"the scheduler {self._where} is gone; start it again, then --resume") from None


def _why(error: Exception) -> str:
    """Why a run did not come back, in words that are the same whenever it happens."""
    from distributed import KilledWorker  # noqa: PLC0415

    if isinstance(error, KilledWorker):
        died = error.allowed_failures + 1
        return f"{died} workers died with it" if died > 1 else "its worker died"
    return f"{type(error).__name__}: {error}"


class Interrupted:
    """Ctrl-C, seen between rows: the campaign ends with what is there, table, summary and all."""

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


def spread(
    cases: Iterator[Case], flyer: Flyer, keep: Callable[[list[Row]], None], interrupted: Interrupted
) -> list[Lost]:
    """Flies cases until there are none left or the operator wants to stop.

    Args:
        cases: in the order in which they are begun.
        flyer: who flies them.
        keep: is given rows as they come back, in any order; an empty list now and then.
        interrupted: looked at between rows.

    Returns:
        Runs that were lost with their workers.
    """
    under_way, left = 0, True
    lost: list[Lost] = []
    while (left or under_way) and not interrupted.asked:
        while left and flyer.room > 0:
            case = next(cases, None)
            if case is None:
                left = False
                break
            flyer.submit(case)
            under_way += 1
        back = flyer.wait()
        under_way -= len(back)
        lost += [item for item in back if isinstance(item, Lost)]
        keep([item for item in back if not isinstance(item, Lost)])
    return lost


@contextmanager
def dask_flyer(address: str | None, workers: int | None, tell: Callable[[str], None]) -> Iterator[DaskFlyer]:
    """A Dask cluster for as long as the block runs.

    Args:
        address: of a scheduler; None for processes of this machine.
        workers: how many of them, None for one per core; 0 for a thread of this process.
        tell: is given a line when there are no workers any more.

    Raises:
        UserError: the scheduler does not answer, has no workers, or they run another version of this program.
    """
    import dask  # noqa: PLC0415 - takes half a second to load
    import distributed  # noqa: PLC0415

    package: Any = distributed  # its classes are not typed

    with ExitStack() as stack:
        stack.enter_context(dask.config.set(_QUIET))
        for name in ("", ".client", ".worker", ".nanny", ".scheduler"):
            logging.getLogger(f"distributed{name}").setLevel(logging.CRITICAL)
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
        yield DaskFlyer(client, "on this machine" if address is None else f"at {address}", tell)


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
