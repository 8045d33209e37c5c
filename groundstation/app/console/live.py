"""A flight as it goes on, for Foxglove: each snapshot as the messages that ``gs export --to mcap`` writes. Pure."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from groundstation.app.body_axes import enu_from_flu
from groundstation.app.console.feed import distances_m, largest_error_m
from groundstation.app.console.snapshot import AIRBORNE, Snapshot
from groundstation.app.foxglove_messages import TEAM, Message, log_message, pose_messages, velocity_message
from groundstation.mission.timing import SECOND_NS
from groundstation.records.wide import PAIRS_MOST

_LEVEL = np.array([1.0, 0.0, 0.0, 0.0])


def live_messages(snapshot: Snapshot, notes: Sequence[tuple[float, str, str]]) -> Iterator[Message]:
    """What is told of one instant.

    Args:
        snapshot: of that instant.
        notes: what happened since the one before: seconds, kind, text.
    """
    t_ns, words = round(snapshot.t_s * SECOND_NS), snapshot.words
    for row, sysid in enumerate(snapshot.ids.tolist()):
        pos_m, setpoint = snapshot.pos_team_enu_m[row], snapshot.setpoint_enu_m_s[row]
        quat = snapshot.quat_ned_from_frd[row]
        if np.isfinite(pos_m).all():
            turned = enu_from_flu(quat if np.isfinite(quat).all() else _LEVEL)
            yield from pose_messages(t_ns, sysid, TEAM, pos_m, turned)
        if np.isfinite(setpoint).all():
            yield velocity_message(t_ns, sysid, "setpoint", setpoint)
    yield from _of_team(snapshot, t_ns)
    about: dict[str, object] = {"name": words.mission, "outcome": words.outcome, "reason": words.reason}
    if np.isfinite(words.radius_m):
        about["safety_radius_m"] = words.radius_m
    yield Message(t_ns, "/flight", "gs.Flight", about)
    for at_s, kind, text in notes:
        yield log_message(round(at_s * SECOND_NS), f"{kind}: {text}")


def _of_team(snapshot: Snapshot, t_ns: int) -> Iterator[Message]:
    """Phase, error, and distances; the smallest is of two of whom one at least flies, as the monitors count."""
    ids = snapshot.ids.tolist()
    first, second = np.triu_indices(len(ids), 1)
    apart_m = distances_m(snapshot)[first, second]
    team: dict[str, object] = {"phase": snapshot.words.phase}
    flies = (snapshot.state & AIRBORNE) != 0
    counted_m = np.where(flies[first] | flies[second], apart_m, np.nan)
    if np.isfinite(counted_m).any():
        pair = int(np.nanargmin(counted_m))
        team["min_distance_m"] = float(counted_m[pair])
        team["min_distance_pair"] = f"{ids[first[pair]]}-{ids[second[pair]]}"
    error_m = largest_error_m(snapshot)
    if np.isfinite(error_m):
        team["formation_error_m"] = error_m
    yield Message(t_ns, "/team", "gs.Team", team)
    known = np.isfinite(apart_m)
    if len(ids) <= PAIRS_MOST and known.any():
        content: dict[str, object] = {
            f"distance_{ids[first[pair]]}_{ids[second[pair]]}_m": float(apart_m[pair])
            for pair in np.flatnonzero(known).tolist()
        }
        yield Message(t_ns, "/team/distances", "gs.Distances", content)
