"""STATUSTEXT put together: long texts come in pieces, and pieces get lost.

A text is handed out when it is whole, when another one begins to push it out, or when its next piece has not come for
a while; then it shows what came, with "..." for what did not. Reads no clock.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field

_PIECE_BYTES = 50
_PIECES_MAX = 10
_UNDER_WAY_MAX = 4  # texts of one vehicle that are put together at once
_PATIENCE_NS = 2_000_000_000
_GAP = b"..."


@dataclass(frozen=True)
class Text:
    """STATUSTEXT of one vehicle: ``severity`` is a MAV_SEVERITY, 0 the worst."""

    vehicle: int
    severity: int
    text: str
    t_rx_ns: int


@dataclass
class _Pieces:
    severity: int
    t_ns: int
    parts: dict[int, bytes] = field(default_factory=dict)

    @property
    def end(self) -> int | None:
        """Number of pieces, None as long as the last one, which is not full, has not come."""
        short = [number for number, part in self.parts.items() if len(part) < _PIECE_BYTES]
        return min(short) + 1 if short else None

    @property
    def whole(self) -> bool:
        end = self.end
        return end is not None and all(number in self.parts for number in range(end))

    def joined(self) -> bytes:
        end = self.end
        count = max(self.parts) + 1 if end is None else end
        joined = b"".join(self.parts.get(number, _GAP) for number in range(count))
        return joined if end is not None else joined + _GAP


class Texts:
    """Texts of a team that are being put together."""

    def __init__(self) -> None:
        self._under_way: dict[tuple[int, int], _Pieces] = {}

    def take(
        self, vehicle: int, severity: int, data: bytes, t_ns: int, *, number: int = 0, piece: int = 0
    ) -> Iterator[Text]:
        """Takes one message.

        Args:
            vehicle: whose.
            severity: MAV_SEVERITY.
            data: text without trailing zeros.
            t_ns: arrival.
            number: of the text, 0 for one that is whole.
            piece: its place in the text, from 0.
        """
        if number == 0:
            yield _text(vehicle, severity, data, t_ns)
            return
        yield from self.late(t_ns)
        if piece >= _PIECES_MAX:
            return
        mine = [key for key in self._under_way if key[0] == vehicle]
        if (vehicle, number) not in self._under_way and len(mine) >= _UNDER_WAY_MAX:
            yield self._end(mine[0])
        pieces = self._under_way.setdefault((vehicle, number), _Pieces(severity, t_ns))
        pieces.t_ns = t_ns
        pieces.parts[piece] = data
        if pieces.whole or len(pieces.parts) == _PIECES_MAX:
            yield self._end((vehicle, number))

    def late(self, now_ns: int) -> Iterator[Text]:
        """Hands out what came of texts whose next piece has not come."""
        for key in [key for key, pieces in self._under_way.items() if now_ns - pieces.t_ns >= _PATIENCE_NS]:
            yield self._end(key)

    def _end(self, key: tuple[int, int]) -> Text:
        pieces = self._under_way.pop(key)
        return _text(key[0], pieces.severity, pieces.joined(), pieces.t_ns)


def _text(vehicle: int, severity: int, data: bytes, t_ns: int) -> Text:
    decoded = data.decode("utf-8", "replace").rstrip("\t\n ")
    # Whatever could move a terminal's cursor or feign another line is not shown.
    words = "".join(letter if letter.isprintable() else " " for letter in decoded)
    return Text(vehicle, severity, words, t_ns)
