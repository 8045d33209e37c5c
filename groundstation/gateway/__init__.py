"""Vehicles that speak no MAVLink, as MAVLink systems: a translator that knows neither sockets, threads nor a clock."""
