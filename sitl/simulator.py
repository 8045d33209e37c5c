"""How a firmware's own simulator is started: what a personality knows of it, for the lines that start a real team.

Nothing is started here. Refuses to know missions: places, ids and ports are given.
"""

from __future__ import annotations

from abc import ABC, abstractmethod

Place = tuple[float, float, float]
"""Latitude, longitude in degrees, height above the sea in m."""


class Simulator(ABC):
    """The simulator of one kind of autopilot."""

    @abstractmethod
    def instance(self, sysid: int, vehicle: int, kind: str, port: int) -> int:
        """Which instance of it a vehicle is.

        Args:
            sysid: its system id.
            vehicle: its position in the team, from 0.
            kind: of its link: "udpin", "tcpout", ...
            port: of its link.

        Raises:
            ValueError: the simulator has no such link for this vehicle; the message says which one it has.
        """

    @abstractmethod
    def command(self, instance: int, sysid: int, place: Place, *, stock: bool) -> str:
        """A line for a shell that becomes this instance.

        Args:
            instance: see ``instance``.
            sysid: system id that it is to have.
            place: where it is to stand.
            stock: as it comes, without what cures its faults.
        """

    @abstractmethod
    def kept(self, place: Place) -> Place:
        """Where it stands when it was told to stand at a place."""

    @abstractmethod
    def remarks(self, off_m: float, *, stock: bool) -> list[str]:
        """Lines of a script that come before its own: the folder that it is started from, and what has to be known.

        Args:
            off_m: how far the worst off of its vehicles stands from its pad.
            stock: as in ``command``.
        """
