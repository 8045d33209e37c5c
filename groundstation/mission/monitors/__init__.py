"""What can be wrong in the air: one small class for each monitor. They look and say; ``monitor`` and the runner act."""
