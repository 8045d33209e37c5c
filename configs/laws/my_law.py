"""A formation law of one's own: the paper's gains, with squared distances for the size. Put yours in its place.

Fly it:   gs fly --mission cube8 --dry-run --set law=my_law:MyLaw
"""

import numpy as np

__version__ = "0.1"


class MyLaw:
    """One of these is made for each flight, and called once a tick while the team is in formation."""

    def __init__(self, pull: float = 0.6) -> None:
        """Options come from the mission: law: {use: "my_law:MyLaw", options: {pull: 0.4}}."""
        self.pull = pull

    def __call__(self, seen):
        """Velocities, shape (n, 3), m/s, forward, left, up of each agent; see gs.Seen for what is seen."""
        rel = seen.rel_pos_flu_m + seen.lead_s * seen.rel_vel_flu_m_s  # where neighbours will be
        x, y, z = rel[..., 0], rel[..., 1], rel[..., 2]
        off = np.where(seen.neighbours, x**2 + y**2 + z**2 - seen.distances_m**2, 0.0)
        level = ((seen.gains_xy + self.pull * off) * (x + 1j * y)).sum(axis=1)
        up = ((seen.gains_z + self.pull * off) * z).sum(axis=1)
        up += np.where(seen.neighbours, seen.upright_1_s * (z - seen.rise_m), 0.0).sum(axis=1)
        return seen.control_gain * np.stack([level.real, level.imag, up], axis=1)
