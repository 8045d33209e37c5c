"""Puts the gate of a mission together: reads its key files, keeps the time stamps of its keys.

Refuses to fly with a key whose time stamps cannot be kept: after a restart they could repeat.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Sequence
from contextlib import suppress
from pathlib import Path

from groundstation.core.errors import UserError
from groundstation.mavlink.gate import Gate, SignedLink
from groundstation.mavlink.keys import read_key, read_times, times_path, write_times
from groundstation.mavlink.signing import MINUTE, SecretKey, Signing, Times
from groundstation.mission.plan.plan import MissionPlan


class FlightGate(Gate):
    """A gate with the files that belong to it.

    Attributes:
        problem: why time stamps could not be kept, "" while they are.
    """

    problem = ""
    files: tuple[Path, ...] = ()

    def close(self) -> None:
        """Keeps the times as they are at the end, so that the next flight begins right behind this one."""
        for file, key in zip(self.files, self.keys, strict=False):
            with suppress(UserError):  # another process with this key may be further; nothing ever goes back
                key.times.sent = max(key.times.sent, read_times(file).sent)
            self._keep(file, key.times, 0, durable=True)

    def _keep(self, file: Path, times: Times, ahead: int, *, durable: bool) -> None:
        try:
            write_times(file, times, ahead, durable=durable)
        except OSError as error:
            self.problem = f"{file}: cannot keep the signatures' time stamps: {error.strerror or error}"


def key_path(plan: MissionPlan, link: int) -> Path | None:
    """Key file of a link, relative to the mission file; None for a link that is not signed."""
    name = plan.key_file(link)
    return None if name is None else Path(plan.source).parent / Path(name).expanduser()


def read_keys(plan: MissionPlan) -> list[SecretKey | None]:
    """Keys of the mission's links; None for those that are not signed.

    Raises:
        UserError: a key file cannot be used.
    """
    paths = [key_path(plan, link) for link in range(len(plan.links))]
    known = {path: read_key(path) for path in dict.fromkeys(paths) if path is not None}
    return [None if path is None else known[path] for path in paths]


def open_gate(plan: MissionPlan, epoch_unix_us: int, *, keep_times: bool) -> FlightGate | None:
    """Makes the gate of a mission.

    Args:
        plan: what is to be flown.
        epoch_unix_us: date of the flight's time 0.
        keep_times: go on from the times of earlier flights and keep those of this one; False for emulated vehicles.

    Returns:
        None where no link is signed.

    Raises:
        UserError: a key file, or the file with its times, cannot be used.
    """
    paths = [key_path(plan, link) for link in range(len(plan.links))]
    link_ids = [plan.link_id(link) for link in range(len(plan.links))]
    return gate_of(paths, link_ids, epoch_unix_us, streams=plan.stream_links, keep_times=keep_times)


def gate_of(
    paths: Sequence[Path | None],
    link_ids: Sequence[int],
    epoch_unix_us: int,
    *,
    streams: Collection[int],
    keep_times: bool,
) -> FlightGate | None:
    """Makes a gate of key files, link by link; see ``open_gate``.

    Args:
        paths: key file of each link, None for one that is not signed.
        link_ids: link id in our signatures on each link.
        epoch_unix_us: date of time 0.
        streams: links on which a frame may arrive in two pieces.
        keep_times: see ``open_gate``.

    Raises:
        UserError: a key file, or the file with its times, cannot be used.
    """
    known = {path: read_key(path) for path in dict.fromkeys(paths) if path is not None}
    signings: dict[SecretKey, Signing] = {}
    files: list[Path] = []
    for path, key in known.items():
        if key not in signings:
            files.append(times_path(path))
            signings[key] = Signing(key, read_times(files[-1]) if keep_times else None)
    if not signings:
        return None
    store: Callable[[int, Times], None] | None = None
    if keep_times:

        def store(number: int, times: Times) -> None:
            gate._keep(files[number], times, MINUTE, durable=False)

    links = [
        None if path is None else SignedLink(signings[known[path]], link_id)
        for path, link_id in zip(paths, link_ids, strict=True)
    ]
    gate = FlightGate(links, epoch_unix_us, streams=streams, store=store)
    if keep_times:
        gate.files = tuple(files)
        gate.close()  # a try, before anything is armed
        if gate.problem:
            raise UserError(
                f"{gate.problem}; a restart could repeat them, keep the key in a folder that can be written to"
            )
    return gate
