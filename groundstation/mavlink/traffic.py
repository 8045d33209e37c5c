"""Aircraft that are none of the team, as ADS-B receivers tell of them: ADSB_VEHICLE of common.xml.

Vehicles pass on what their receivers hear. Nothing of it is signed or checked by anybody: whoever uses it decides how
far it is believed. Keeps the last report of each aircraft.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from groundstation.core.types import FloatArray, IntArray
from groundstation.mavlink.codec import Batch

MOST = 64
"""Aircraft that are kept; the one that was heard longest ago makes room."""
_VALID_COORDS, _VALID_ALTITUDE, _VALID_HEADING, _VALID_VELOCITY, _VALID_VERTICAL = 1, 2, 4, 8, 8 | 128  # ADSB_FLAGS
_GEOMETRIC = 1  # ADSB_ALTITUDE_TYPE_GEOMETRIC; the other kind is by pressure and may be a hundred metres off
_NAME_BYTES = 9


@dataclass(frozen=True)
class Aircraft:
    """The last report of one.

    Attributes:
        name: its callsign, or its ICAO address in hex where it tells none.
        place_deg_m: latitude, longitude, height above sea level; the height is NaN where it is not known by satellites.
        vel_ned_m_s: shape (3,); NaN where it is not told.
        measured_ns: when it was there.
    """

    name: str
    place_deg_m: FloatArray
    vel_ned_m_s: FloatArray
    measured_ns: int


class Traffic:
    """All that were heard."""

    def __init__(self) -> None:
        self._known: dict[int, Aircraft] = {}

    def __len__(self) -> int:
        """How many."""
        return len(self._known)

    def take(self, batch: Batch, t_ns: IntArray) -> None:
        """Takes reports; those without a place count for nothing, and so do those that are older than the last one.

        Args:
            batch: of ADSB_VEHICLE.
            t_ns: when each arrived, shape (k,).
        """
        for row, arrived_ns in zip(batch.values, t_ns.tolist(), strict=True):
            lat_deg, lon_deg, flags = float(row["lat"]) * 1e-7, float(row["lon"]) * 1e-7, int(row["flags"])
            if not flags & _VALID_COORDS or abs(lat_deg) > 90.0 or abs(lon_deg) > 180.0:
                continue
            number, measured_ns = int(row["ICAO_address"]), arrived_ns - int(row["tslc"]) * 1_000_000_000
            before = self._known.get(number)
            if before is not None and measured_ns < before.measured_ns:
                continue
            high = bool(flags & _VALID_ALTITUDE) and int(row["altitude_type"]) == _GEOMETRIC
            height_m = float(row["altitude"]) * 1e-3 if high else np.nan
            course = bool(flags & _VALID_HEADING) and bool(flags & _VALID_VELOCITY)
            heading, speed_m_s = np.radians(float(row["heading"]) * 0.01), float(row["hor_velocity"]) * 0.01
            level_m_s = speed_m_s * np.array([np.cos(heading), np.sin(heading)]) if course else np.full(2, np.nan)
            down_m_s = -float(row["ver_velocity"]) * 0.01 if flags & _VALID_VERTICAL else np.nan
            told = bytes(row["callsign"])[:_NAME_BYTES].split(b"\0")[0].decode("ascii", "replace").strip()
            name = "".join(letter for letter in told if letter.isalnum() or letter in "-_") or f"{number:06X}"
            place = np.array([lat_deg, lon_deg, height_m])
            self._known[number] = Aircraft(name, place, np.append(level_m_s, down_m_s), measured_ns)
            if len(self._known) > MOST:
                del self._known[min(self._known, key=lambda key: self._known[key].measured_ns)]

    def since(self, oldest_ns: int) -> list[Aircraft]:
        """Those that were heard since a time."""
        return [item for item in self._known.values() if item.measured_ns >= oldest_ns]
