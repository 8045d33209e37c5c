# ---
# jupyter:
#   jupytext: {formats: "py:percent"}
# ---

# %% [markdown]
# # Design gains
#
# From points and a sensing graph to the numbers that each agent multiplies its neighbours' relative positions by, and to the proof that they work.

# %%
import numpy as np

import groundstation as gs

# %% [markdown]
# A formation that comes along, and what is known of its gains: all motions that are not of the formation die out, the slowest at `-lambda_max` per second.

# %%
cube = gs.load_formation("cube8")
found = gs.design(cube)
print(cube.size, "agents,", len(cube.edges), "edges, slowest mode", round(-found.certificate.lambda_max, 3), "1/s")

# %% [markdown]
# The matrix holds the cube still, wherever it stands, however it is turned and whatever its size:

# %%
p = cube.points_enu_m[:, 0] + 1j * cube.points_enu_m[:, 1]
off = found.gains.xy - np.diag(np.diag(found.gains.xy))
A = off - np.diag(off.sum(axis=1))
moved = 3.0 * np.exp(0.7j) * p + (5.0 - 2.0j)
print("residual of the cube, moved, turned and three times as large:", np.abs(A @ moved).max())
assert np.abs(A @ moved).max() < 1e-6

# %% [markdown]
# Its eigenvalues: two zeros, for place and for shape; all others negative, the fastest at ten per second.

# %%
eigenvalues = np.linalg.eigvalsh(A)
print(np.round(eigenvalues, 3))
assert (np.abs(eigenvalues) < 1e-6).sum() == 2
assert eigenvalues.max() < 1e-6

# %% [markdown]
# A graph that cannot do it is refused with the reason. Here agent 1 is left with a single neighbour:

# %%
from dataclasses import replace

one = [edge for edge in cube.edges if 0 in edge]
poor = gs.design(replace(cube, edges=tuple(edge for edge in cube.edges if edge not in one[1:])))
print(poor.feasible, "-", poor.reason)
assert not poor.feasible
