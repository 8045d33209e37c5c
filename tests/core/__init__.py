"""Tests of groundstation.core."""
