"""One half of it, found by whoever looks into this folder."""
