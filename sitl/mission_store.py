"""The mission protocol and what is stored: the mission, what of it is under way; fence and rally points beside it.

Fence and rally points are kept and told again, as firmware does; nobody flies by them here.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Protocol

from groundstation.mavlink.codec import Frame
from sitl.mavlink_ids import MSG_MISSION_ITEM, MSG_MISSION_REQUEST
from sitl.voice import Voice
from sitl.wire import Fields

_ITEM_PATIENCE_NS = 250_000_000
_ITEM_TRIES = 20
MISSION_ACCEPTED, MISSION_UNSUPPORTED, MISSION_BAD_X, MISSION_BAD_Y, MISSION_BAD_SEQUENCE = 0, 3, 10, 11, 13
MISSION_ERROR, MISSION_UNSUPPORTED_FRAME = 1, 2
_FLIGHT, _FENCE, _RALLY, _ALL_KINDS = 0, 1, 2, 255  # mission types
_KNOWN = {_FENCE: range(5000, 5005), _RALLY: range(5100, 5101)}  # commands that items of these kinds may have
_POLYGONS = (5001, 5002)
_ON_EARTH = (0, 3, 5, 6)  # frames
_VERTICES_MIN = 3


class Timed(Protocol):
    """Who knows what time it is."""

    @property
    def now_ns(self) -> int:
        """The world's clock."""


@dataclass
class _Upload:
    """A mission, fence or rally points on their way here.

    Attributes:
        count: how many items it will have.
        kind: mission type.
        sender: the last frame of who sends it.
        asked_ns: when the next item was last asked for.
        items: those that have come.
        tries: how often the same one was asked for again.
        stuck_at: how many had come when that began, None before it.
    """

    count: int
    kind: int
    sender: Frame
    asked_ns: int
    items: list[Fields] = field(default_factory=list)
    tries: int = 0
    stuck_at: int | None = None


class MissionStore:
    """One vehicle's.

    Attributes:
        items: fields of MISSION_ITEM_INT.
        seq: which of them is under way; a new mission starts at its beginning.
        beside: fence and rally points, by mission type.
    """

    def __init__(self, voice: Voice, body: Timed) -> None:
        self._voice, self._body = voice, body
        self.items: list[Fields] = []
        self.seq = 0
        self.beside: dict[int, list[Fields]] = {_FENCE: [], _RALLY: []}
        self._upload: _Upload | None = None

    def __len__(self) -> int:
        return len(self.items)

    @property
    def uploading(self) -> bool:
        """Whether somebody is sending one."""
        return self._upload is not None

    def _ack(self, result: int, kind: int, frame: Frame) -> None:
        self._voice.send(
            "MISSION_ACK",
            target_system=frame.sysid,
            target_component=frame.compid,
            type=result,
            mission_type=kind,
        )

    def _of(self, kind: int) -> list[Fields] | None:
        """What is stored of a kind; None for one that is not known."""
        return self.items if kind == _FLIGHT else self.beside.get(kind)

    def _store(self, kind: int, items: list[Fields]) -> None:
        if kind == _FLIGHT:
            self.items, self.seq = items, 0
        else:
            self.beside[kind] = items

    def on_list(self, fields: Fields, frame: Frame) -> None:
        """Tells how many items there are."""
        kind = fields.get("mission_type", 0)
        count = len(self._of(kind) or ())
        self._voice.send(
            "MISSION_COUNT",
            target_system=frame.sysid,
            target_component=frame.compid,
            count=count,
            mission_type=kind,
        )

    def on_request(self, fields: Fields, frame: Frame) -> None:
        """Sends one item."""
        seq, kind = fields["seq"], fields.get("mission_type", 0)
        held = self._of(kind)
        if held is None or seq >= len(held):
            self._ack(MISSION_BAD_SEQUENCE, kind, frame)
            return
        item = {k: v for k, v in held[seq].items() if not k.startswith("target_")}
        name = "MISSION_ITEM_INT"
        if frame.msgid == MSG_MISSION_REQUEST:
            name = "MISSION_ITEM"
            scale = 1e-7 if item["frame"] not in (1, 2) else 1e-4
            item["x"], item["y"] = item["x"] * scale, item["y"] * scale
        self._voice.send(name, target_system=frame.sysid, target_component=frame.compid, **item)

    def on_count(self, fields: Fields, frame: Frame) -> None:
        """Begins to take a mission."""
        kind = fields.get("mission_type", 0)
        if self._of(kind) is None:
            self._ack(MISSION_UNSUPPORTED, kind, frame)
            return
        if fields["count"] == 0:
            self._store(kind, [])
            self._ack(MISSION_ACCEPTED, kind, frame)
            return
        self._upload = _Upload(fields["count"], kind, frame, self._body.now_ns)
        self._ask_item(frame)

    def _ask_item(self, frame: Frame) -> None:
        upload = self._upload
        if upload is not None:
            upload.asked_ns, upload.sender = self._body.now_ns, frame
            self._voice.send(
                "MISSION_REQUEST_INT",
                target_system=frame.sysid,
                target_component=frame.compid,
                seq=len(upload.items),
                mission_type=upload.kind,
            )

    def on_item(self, fields: Fields, frame: Frame) -> None:
        """Takes an item of it."""
        upload = self._upload
        kind = fields.get("mission_type", 0)
        if upload is None or kind != upload.kind:
            return
        if fields["seq"] == len(upload.items):
            item = dict(fields)
            if frame.msgid == MSG_MISSION_ITEM:
                scale = 1e7 if item["frame"] not in (1, 2) else 1e4
                for axis, refusal in (("x", MISSION_BAD_X), ("y", MISSION_BAD_Y)):
                    # NaN fails the comparison too; what is stored has to fit MISSION_ITEM_INT
                    if not abs(item[axis] * scale) <= 0x7FFFFFFF:
                        self._upload = None
                        self._ack(refusal, kind, frame)
                        return
                    item[axis] = round(item[axis] * scale)
            refusal_of_item = _refusal(kind, item)
            if refusal_of_item is not None:
                self._upload = None
                self._ack(refusal_of_item, kind, frame)
                return
            upload.items.append(item)
        if len(upload.items) == upload.count:
            self._upload = None
            if kind == _FENCE and not _closed(upload.items):
                self._ack(MISSION_ERROR, kind, frame)
                return
            self._store(kind, upload.items)
            self._ack(MISSION_ACCEPTED, kind, frame)
        else:
            self._ask_item(frame)

    def ask_again(self) -> None:
        """Repeats the request for a mission item that has not come; gives an upload up after a while."""
        upload = self._upload
        if upload is None or self._body.now_ns - upload.asked_ns < _ITEM_PATIENCE_NS:
            return
        upload.tries = 0 if len(upload.items) != upload.stuck_at else upload.tries + 1
        upload.stuck_at = len(upload.items)
        if upload.tries >= _ITEM_TRIES:
            self._upload = None
            return
        self._ask_item(upload.sender)

    def on_clear(self, fields: Fields, frame: Frame) -> None:
        """Forgets the mission."""
        kind = fields.get("mission_type", 0)
        kinds = (_FLIGHT, _FENCE, _RALLY) if kind == _ALL_KINDS else (kind,)
        if self._of(kinds[0]) is None:
            self._ack(MISSION_UNSUPPORTED, kind, frame)
            return
        for one in kinds:
            self._store(one, [])
        self._ack(MISSION_ACCEPTED, kind, frame)

    def set_current(self, seq: int) -> bool:
        """Goes on with another item of the mission. Returns whether there is such an item."""
        if not 0 <= seq < len(self.items):
            return False
        self.seq = seq
        self._voice.send("MISSION_CURRENT", seq=seq, total=len(self.items))
        return True

    def on_set_current(self, fields: Fields, _frame: Frame) -> None:
        """Goes on with another item, as ``set_current``."""
        self.set_current(fields["seq"])


def _refusal(kind: int, item: Fields) -> int | None:
    """Why an item of a fence or a rally point is not taken, as MAV_MISSION_RESULT; None where it is."""
    known = _KNOWN.get(kind)
    if known is None:
        return None
    if int(item["command"]) not in known:
        return MISSION_UNSUPPORTED
    return None if item["frame"] in _ON_EARTH else MISSION_UNSUPPORTED_FRAME


def _closed(items: list[Fields]) -> bool:
    """Whether every polygon has as many vertices as its items say, and three at least."""
    position = 0
    while position < len(items):
        item = items[position]
        vertices = round(item["param1"]) if item["command"] in _POLYGONS else 1
        together = items[position : position + vertices]
        if item["command"] in _POLYGONS and (
            vertices < _VERTICES_MIN
            or len(together) < vertices
            or any((one["command"], round(one["param1"])) != (item["command"], vertices) for one in together)
        ):
            return False
        position += vertices
    return True
