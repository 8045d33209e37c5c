# ---
# jupyter:
#   jupytext: {formats: "py:percent"}
# ---

# %% [markdown]
# # Many simulations, and a figure for a paper
#
# One flight shows that something can work. How often does it, and how long does it take? Each seed is another flight: other noise of positions and links.

# %%
import numpy as np
from matplotlib.figure import Figure
from scipy.stats import beta

import groundstation as gs

RUNS = 2  # a thousand for a paper; see the end for all cores

# %%
mission = gs.load_mission("four.yaml")
flown = [gs.simulate(mission, seed=seed) for seed in range(RUNS)]
times_s = np.array([item.time_to_form_s for item in flown])
nearest_m = np.array([item.min_distance_m for item in flown])

# %% [markdown]
# A rate without an interval says little. Clopper and Pearson's, 95 %:

# %%
good = sum(item.outcome == "completed" and item.min_distance_m >= 0.45 for item in flown)
low = beta.ppf(0.025, good, RUNS - good + 1) if good else 0.0
high = beta.ppf(0.975, good + 1, RUNS - good) if good < RUNS else 1.0
print(f"{good} of {RUNS} good: {good / RUNS:.0%}, 95 % interval {low:.1%} to {high:.1%}")
assert good == RUNS

# %%
figure = Figure(figsize=(3.5, 2.4), layout="constrained")  # one column of a paper
axes = figure.add_subplot()
axes.step(np.sort(times_s), np.arange(1, RUNS + 1) / RUNS, where="post")
axes.set(xlabel="time to form, s", ylabel="share of runs", ylim=(0, 1.02))
figure.savefig("time_to_form.pdf")
figure  # noqa: B018 - shows it

# %% [markdown]
# On all cores, with random starts, faults and poor links, a thousand runs are one command ([campaigns](../campaigns.md)); its rows are a Parquet table:
#
#     gs campaign --mission four.yaml --runs 1000 --seed 1 -o runs/four
#
#     import pandas
#     table = pandas.read_parquet("runs/four/runs.parquet")
#     table.time_to_form_s.quantile([0.5, 0.95])
