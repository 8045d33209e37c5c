"""The mathematics: numpy in, numpy out; no clocks, no files, no network, no unseeded randomness."""
