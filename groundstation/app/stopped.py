"""What a program says that Ctrl-C has ended, and what shells report of it. Loads nothing."""

STOPPED = 130
STOPPED_WORDS = "gs: stopped by Ctrl-C\n"
