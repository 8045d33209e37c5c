# ---
# jupyter:
#   jupytext: {formats: "py:percent"}
# ---

# %% [markdown]
# # Read a log
#
# Every flight leaves a log with all frames that went over its links. Here one is made, and read as any of yours would be.

# %%
import numpy as np

import groundstation as gs

flown = gs.simulate(gs.load_mission("four.yaml"), seed=2, log="four.tlog")
log = gs.read_log("four.tlog")
print(log)

# %% [markdown]
# What happened when, and how it ended:

# %%
for name, start_s, stop_s in log.phases:
    print(f"{start_s:6.2f} to {stop_s:6.2f} s  {name}")
print(log.result["outcome"], "in", log.result["duration_s"], "s")
assert [name for name, _, _ in log.phases][-1] == "done"

# %% [markdown]
# Positions as columns; `log.to_pandas()` and `log.to_polars()` give the same as tables, where these packages are installed.

# %%
positions = log.positions()
print({name: column[:3] for name, column in positions.items()})
assert set(positions) == {"t_s", "vehicle", "x_enu_m", "y_enu_m", "z_enu_m"}

# %% [markdown]
# Distances of all pairs at common instants, and the smallest while the formation was held:

# %%
start_s, stop_s = next((start, stop) for name, start, stop in log.phases if name == "hold")
there = log.at(np.arange(start_s, stop_s, 0.1))
first, second = np.triu_indices(len(log.vehicles), 1)
apart_m = np.linalg.norm(there[:, first] - there[:, second], axis=2)
print("while holding:", apart_m.min().round(3), "to", apart_m.max().round(3), "m; asked for", np.sqrt(2).round(3))
assert abs(apart_m - np.sqrt(2)).max() < 0.2

# %% [markdown]
# Was it recorded truly? Flown again from its bytes it gives the same setpoints, to the bit:

# %%
assert gs.verify("four.tlog").mismatches == 0

# %% [markdown]
# `gs.report(log, "four-report")` draws the pictures of `gs report` and a page.
