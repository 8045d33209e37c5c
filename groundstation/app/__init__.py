"""The command line, the loops that wait, reports: the thin edge around everything else."""
