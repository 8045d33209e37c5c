"""A picture of how a vehicle follows its setpoints: what was asked, what was done, and what the models make of it."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

from groundstation.app.identifying import DIRECTIONS
from groundstation.app.picture_style import BLUE, INK, QUIET, VERMILION
from groundstation.app.pictures import save_asked_picture
from groundstation.core.velocity_loop import FIT_EVERY, FIT_STEP_S, VelocityLoop
from groundstation.records.responses import Motion


def draw_responses(path: Path, motion: Motion, loops: Mapping[str, VelocityLoop]) -> None:
    """Draws one vehicle's three axes over time.

    Args:
        path: picture to write; the ending chooses the kind.
        motion: of the vehicle.
        loops: "horizontal" and "up".

    Raises:
        UserError: the picture cannot be written.
    """
    figure = Figure(figsize=(11, 8), layout="constrained")
    panels = figure.subplots(3, 1, sharex=True)
    asked, done = motion.asked_enu_m_s[::FIT_EVERY].T, motion.done_enu_m_s[::FIT_EVERY].T
    times_s = np.arange(asked.shape[1]) * FIT_STEP_S
    for axis, panel in enumerate(panels):
        loop = loops["up" if axis == 2 else "horizontal"]
        panel.plot(times_s, asked[axis], color=QUIET, linewidth=1.0, label="asked for")
        panel.plot(times_s, done[axis], color=INK, linewidth=1.6, label="flown, as reported")
        known = np.isfinite(done[axis])
        if np.isfinite(loop.explained) and known.any():
            start_m_s = float(done[axis][known][0])
            one_lag = loop.one_lag_answer(asked[axis], start_m_s)
            panel.plot(times_s, one_lag, color=VERMILION, linestyle="--", linewidth=1.2, label="one lag and a delay")
            second = loop.answer(asked[axis], start_m_s)
            panel.plot(times_s, second, color=BLUE, linestyle=":", linewidth=1.8, label="second order")
            told = f"one lag explains {loop.one_lag_explained:.1%}, the second order {loop.explained:.1%}"
            panel.set_title(f"{DIRECTIONS[axis]}: {told}", fontsize=11, loc="left")
        else:
            panel.set_title(f"{DIRECTIONS[axis]}: {loop.problem}", fontsize=11, loc="left")
        panel.set_ylabel("m/s")
        panel.spines[["top", "right"]].set_visible(False)
    panels[-1].set_xlabel("s of flight by setpoints")
    figure.suptitle(f"Vehicle {motion.id}: how its setpoints are followed", x=0.01, ha="left")
    figure.legend(*panels[0].get_legend_handles_labels(), ncols=4, loc="upper right", frameon=False, fontsize=10)
    save_asked_picture(figure, path)
