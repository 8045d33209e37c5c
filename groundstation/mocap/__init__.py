"""Bodies that a motion capture system sees: which vehicle each is, and whether that can be. No sockets, no clock."""
