"""What can be wrong in the air: one small class for each monitor. They look and say, the runner acts."""
