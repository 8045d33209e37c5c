"""A battery that empties with the thrust it has to provide. Refuses to draw conclusions: the autopilots do."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass
class Battery:
    """State of one battery.

    Attributes:
        endurance_s: hovering time from full to empty.
        cells: number of cells in series.
        capacity_mah: only for what is reported.
        left: what is left, 1 when full.
        current_a, voltage_v: under the present load.
        extra_per_s: share that is lost per second on top (a fault).
    """

    endurance_s: float
    cells: int = 4
    capacity_mah: float = 3300.0
    left: float = 1.0
    current_a: float = 0.0
    voltage_v: float = 16.2
    extra_per_s: float = 0.0

    def drain(self, load: float, dt_s: float) -> None:
        """Runs for ``dt_s`` under a load in hovering powers (0 standing, 1 hovering)."""
        left = self.left - ((load + 0.01) / self.endurance_s + self.extra_per_s) * dt_s
        self.left = left = left if left > 0.0 else 0.0
        self.current_a = (load + 0.01) * self.capacity_mah * 3.6 / self.endurance_s
        # open-circuit voltage of a LiPo cell, nearly flat between 20 and 90 percent, minus what the load takes
        full, empty = left - 0.9, 0.1 - left
        cell = 3.5 + 0.55 * left + 0.15 * (full if full > 0.0 else 0.0) * 10
        cell -= 0.4 * (empty if empty > 0.0 else 0.0) * 10
        self.voltage_v = self.cells * ((cell if cell < 4.2 else 4.2) - 0.08 * load)

    def percent(self) -> int:
        """Remaining charge as reported, 0 to 100."""
        return max(0, min(100, round(self.left * 100)))

    def used_mah(self) -> float:
        """Charge taken out since full."""
        return (1.0 - self.left) * self.capacity_mah
