"""An autopilot that nobody flies: what has to be written for a third one, and nothing else."""
