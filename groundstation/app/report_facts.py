"""What a report says beside its pictures: phases, how the links did, the settings, and hashes of all that was read."""

from __future__ import annotations

import hashlib
from collections import defaultdict
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import yaml

from groundstation.app.console.link_loss import LinkLoss
from groundstation.core.types import IntArray
from groundstation.mavlink.vehicle import AUTOPILOT_COMPID
from groundstation.records.manifest import manifest_path
from groundstation.records.notes import Received
from groundstation.records.replay import Flight
from groundstation.records.tlog import read_tlog

Row = tuple[str, ...]


@dataclass(frozen=True)
class Facts:
    """Tables of a report; each begins with its head.

    Attributes:
        phases: name, begin, duration.
        links: of each vehicle: frames, lost of them, rate, longest silence, setpoints sent.
        settings: the mission as it was flown, YAML; "" where there is no manifest.
        hashes: file, SHA-256.
    """

    phases: Sequence[Row]
    links: Sequence[Row]
    settings: str
    hashes: Sequence[Row]


def facts_of(flight: Flight, log: Path) -> Facts:
    """Reads a log once more, for what its frames tell of the links.

    Raises:
        UserError: it cannot be read any more.
    """
    return Facts(_phases(flight), _links(flight, log), _settings(flight), _hashes(flight, log))


def _phases(flight: Flight) -> list[Row]:
    rows: list[Row] = [("phase", "begins", "lasts")]
    for phase in flight.phases:
        begin_s, lasts_s = (phase.start_ns - flight.start_ns) / 1e9, (phase.stop_ns - phase.start_ns) / 1e9
        rows.append((phase.name, f"{begin_s:.2f} s", f"{lasts_s:.2f} s"))
    return rows if len(rows) > 1 else []


def _links(flight: Flight, log: Path) -> list[Row]:
    """Gaps in the numbers that MAVLink counts frames with are lost frames, or what a router left out on purpose."""
    shared = len({track.sysid for track in flight.vehicles}) < len(flight.vehicles)
    times: dict[tuple[int, int], list[int]] = {
        (track.link if shared else 0, track.sysid): [] for track in flight.vehicles
    }
    losses = defaultdict[int, LinkLoss](LinkLoss)
    for record in read_tlog(log, None if flight.manifest is None else flight.manifest.epoch_unix_us):
        if not isinstance(record, Received) or record.frame.compid != AUTOPILOT_COMPID:
            continue
        link = record.link if shared else 0
        heard_ns = times.get((link, record.frame.sysid))
        if heard_ns is not None:
            heard_ns.append(record.t_ns)
            losses[link].take(record.frame.raw)
    every = range(256)
    share_of = {link: loss.take_shares(every) for link, loss in losses.items()}
    shares = [float(share_of[link][sysid]) if link in share_of else np.nan for link, sysid in times]
    rows: list[Row] = [("vehicle", "frames received", "lost", "frames a second", "longest silence", "setpoints sent")]
    for track, heard_at, share in zip(flight.vehicles, times.values(), shares, strict=True):
        heard: IntArray = np.array(heard_at, dtype=np.int64)
        lasts_s = (heard[-1] - heard[0]) / 1e9 if len(heard) > 1 else 0.0
        rows.append(
            (
                str(track.id),
                str(len(heard)),
                f"{100.0 * share:.2f} %" if np.isfinite(share) else "-",
                f"{(len(heard) - 1) / lasts_s:.1f}" if lasts_s > 0.0 else "-",
                f"{np.diff(heard).max() / 1e9:.2f} s" if len(heard) > 1 else "-",
                str(len(track.setpoint_t_ns)),
            )
        )
    return rows if any(times.values()) else []


def _settings(flight: Flight) -> str:
    """All of the mission but what is measured in kilobytes: gains of single steps."""
    manifest = flight.manifest
    if manifest is None:
        return ""
    shown = {key: value for key, value in manifest.mission.items() if key != "shapes"}
    beside = {"versions": dict(manifest.versions), "seed": manifest.seed, "faults": list(manifest.faults)}
    return yaml.safe_dump({**shown, **beside}, sort_keys=False, default_flow_style=None, width=110, allow_unicode=True)


def _hashes(flight: Flight, log: Path) -> list[Row]:
    rows: list[Row] = [("file", "SHA-256")]
    for path in (log, manifest_path(log)):
        if path.is_file():
            rows.append((path.name, hashlib.sha256(path.read_bytes()).hexdigest()))
    gains = None if flight.manifest is None else flight.manifest.gains_sha256
    if gains is not None:
        rows.append(("gains, in the manifest", gains))
    return rows
