"""Who steers: one operator at a time. Taking over is possible, and seen by everybody."""

from __future__ import annotations

from collections.abc import Mapping

from groundstation.app.console.guard import Role
from groundstation.mission.operator import Order


class HelmSeat:
    """The one place from which orders are given.

    Attributes:
        holder: the page that has it, "" while nobody does.
        name: how that one is called for people.
        news: what was said of it last.
    """

    def __init__(self) -> None:
        self.holder = self.name = self.news = ""

    def take(self, page: str, name: str, role: Role) -> str:
        """Gives it to a page; returns why not, "" when it has it."""
        if role is not Role.OPERATOR:
            return "this page may only look: it was opened with the viewer's key"
        if self.holder and self.holder != page:
            self.news = f"{name} has taken over from {self.name}"
        elif not self.holder:
            self.news = f"{name} steers"
        self.holder, self.name = page, name
        return ""

    def leave(self, page: str) -> None:
        """A page was closed."""
        if page == self.holder:
            self.news = f"{self.name} has left; nobody steers from a console"
            self.holder = self.name = ""

    def refusal(self, page: str, role: Role, order: Order, refused: Mapping[str, str]) -> str:
        """Why a page may not give an order now, "" when it may.

        Args:
            page: its own name.
            role: what it may do.
            order: which.
            refused: what the flight itself would refuse now, and why.
        """
        if role is not Role.OPERATOR:
            return "this page may only look: it was opened with the viewer's key"
        if page != self.holder:
            return f"{self.name} steers; take over first" if self.holder else "take the helm first"
        return refused.get(order.value, "")
