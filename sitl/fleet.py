"""Ready-made fleets: n vehicles of one kind on a grid of pads.

Refuses to know missions: whoever has pads of their own builds ``VehicleConfig`` directly.
"""

from __future__ import annotations

import math

from sitl.config import VehicleConfig
from sitl.estimator import MOCAP, Noise
from sitl.personalities import PERSONALITIES

_COLUMNS = 3


def grid_pads(n: int, spacing_m: float = 1.0) -> list[tuple[float, float, float]]:
    """Pads in rows of three around the origin, first the southern row from west to east, ENU m."""
    columns = min(n, _COLUMNS)
    rows = math.ceil(n / columns) if n else 0
    return [
        (
            (k % columns - (columns - 1) / 2.0) * spacing_m,
            (k // columns - (rows - 1) / 2.0) * spacing_m,
            0.0,
        )
        for k in range(n)
    ]


def fleet(
    n: int,
    *,
    autopilot: str = "px4",
    profile: str | None = None,
    spacing_m: float = 1.0,
    noise: Noise = MOCAP,
    streams: str | None = None,
    mavlink_version: int = 2,
    gps: bool = True,
    signing_key: bytes | None = None,
) -> list[VehicleConfig]:
    """Makes n vehicles with system ids 1 to n.

    Args:
        n: how many, 1 to 254 (255 is what ground stations use).
        autopilot: name of a personality.
        profile: dynamics profile; None takes the autopilot's usual one.
        spacing_m: distance between neighbouring pads.
        noise: errors of the estimates.
        streams: what is sent unasked; None takes the autopilot's own.
        mavlink_version: 1, 2, or 0 for 1 until the ground station speaks 2.
        gps: whether they have GPS receivers.
        signing_key: key that they sign with, and want others to sign with.

    Raises:
        ValueError: n is out of range, or there is no such autopilot.
    """
    if not 1 <= n <= 254:
        raise ValueError(f"vehicles: {n}, limits 1 and 254 (MAVLink system ids; 255 is the ground station's)")
    if autopilot not in PERSONALITIES:
        raise ValueError(f"autopilot is {autopilot!r}, one of {', '.join(PERSONALITIES)} is needed")
    kind = PERSONALITIES[autopilot]
    return [
        VehicleConfig(
            sysid=k + 1,
            autopilot=autopilot,
            profile=profile or kind.profile,
            pad_enu_m=pad,
            yaw_enu_rad=math.pi / 2.0,  # facing north: heading 0
            noise=noise,
            streams=streams or kind.streams,
            mavlink_version=mavlink_version,
            gps=gps,
            signing_key=signing_key,
        )
        for k, pad in enumerate(grid_pads(n, spacing_m))
    ]
