"""Gain design, offline: from a formation to certified gain matrices, and their files."""
