"""Emulator of multirotors and their autopilots: an independent witness for the ground station.

Of ``groundstation`` it imports the MAVLink codec and nothing else; its frame conversions are its own.
"""
