# ---
# jupyter:
#   jupytext: {formats: "py:percent"}
# ---

# %% [markdown]
# # Change the law
#
# The law that forms a formation can be your own. Limits, damper, monitors and the way home stay as they are and hold whatever it answers
# ([all about it](../own-laws.md)). Here: the gradient law of Krick, Broucke and Francis (2009) against the paper's.

# %%
import numpy as np

import groundstation as gs


class Gradient:
    """Down the slope of squared distances, kept upright."""

    def __init__(self, gain=0.25, upright=0.5):
        self.gain, self.upright = gain, upright

    def __call__(self, seen):
        off_m2 = np.where(seen.neighbours, seen.range_m**2 - seen.distances_m**2, 0.0)
        vel = self.gain * (off_m2[..., None] * seen.rel_pos_flu_m).sum(axis=1)
        low_m = np.where(seen.neighbours, seen.height_m - seen.rise_m, 0.0).sum(axis=1)
        return vel + self.upright * low_m[:, None] * seen.up_flu


# %% [markdown]
# The same mission, the same seed, two laws. `on_tick` sees every tick: here it writes down the formation error.

# %%
errors = {}
flown = {}
for name, law in (("the paper's", None), ("gradient", Gradient)):
    mission = gs.load_mission("four.yaml", law=law)
    seen = errors[name] = []
    flown[name] = gs.simulate(
        mission, seed=1, on_tick=lambda tick, seen=seen: seen.append((tick.t_s, tick.phase, tick.formation_error_m))
    )
    print(f"{name}: {flown[name].outcome}, formed after {flown[name].time_to_form_s:.1f} s")
    assert flown[name].outcome == "completed"

# %% [markdown]
# How they get there:

# %%
from matplotlib.figure import Figure

figure = Figure(figsize=(7, 3.5), layout="constrained")
axes = figure.add_subplot()
for name, seen in errors.items():
    formed = np.array([(t_s, error_m) for t_s, phase, error_m in seen if phase in ("form", "hold")])
    axes.semilogy(formed[:, 0] - formed[0, 0], formed[:, 1], label=name)
axes.set(xlabel="time since forming began, s", ylabel="largest distance error, m")
axes.legend()
figure.savefig("laws.svg")
figure  # noqa: B018 - shows it
