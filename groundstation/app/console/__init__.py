"""The page that a flight is watched and steered by: a process of its own, fed by snapshots."""
