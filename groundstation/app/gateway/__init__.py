"""Edges of the gateway: who carries its orders to vehicles, and its messages to ground stations."""
