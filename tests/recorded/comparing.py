"""What the emulator sends otherwise than a recording of real firmware: kinds, rates, flags, acks, texts, order, timing.

``python -m tests.recorded.comparing [NAME ...]`` flies each recording's own mission on the emulator and prints the
differences. Both sides are read off the bytes that the ground received, by pymavlink, and by nothing of ours.
"""

from __future__ import annotations

import sys
import tempfile
from collections import Counter, defaultdict
from collections.abc import Iterable
from dataclasses import dataclass, field
from itertools import pairwise
from pathlib import Path
from typing import Any

from pymavlink.dialects.v20 import ardupilotmega

from groundstation.records.notes import Received, Sent
from groundstation.records.tlog import read_tlog
from tests.app.flights import Flight
from tests.recorded.recording import Recording, chosen, load

_RATE_SAME = 0.1  # rates that differ by less are the same
_SECONDS_SAME = 0.35
_TEXTS_OF_ONE = 40
_ARMED = 0x80
_INTERVAL = ardupilotmega.MAV_CMD_SET_MESSAGE_INTERVAL
_ANSWERS = {"COMMAND_ACK", "PARAM_VALUE", "STATUSTEXT", "TIMESYNC", "GPS_GLOBAL_ORIGIN", "AUTOPILOT_VERSION"}
_FLAGS = {
    "SYS_STATUS": (
        "onboard_control_sensors_present", "onboard_control_sensors_enabled", "onboard_control_sensors_health",
    ),
    "ESTIMATOR_STATUS": ("flags",),
    "EKF_STATUS_REPORT": ("flags",),
    "HEARTBEAT": ("type", "base_mode", "custom_mode", "system_status"),
    "EXTENDED_SYS_STATE": ("landed_state",),
    "AUTOPILOT_VERSION": ("capabilities",),
}  # fmt: skip


@dataclass
class Heard:
    """What one vehicle sent in a flight.

    Attributes:
        times_s: arrivals by kind.
        flags: values by kind and state (ground, air), as often as they were seen.
        acks: (command, first parameters, result) as often as they were seen.
        texts: severity and words, in order, each once.
        marks: seconds from the acknowledgement of arming to what followed.
        ack_s: seconds from a command to its answer.
        silenced: kinds that it was told not to send.
        armed: by the last heartbeat.
    """

    times_s: dict[str, list[float]] = field(default_factory=lambda: defaultdict(list))
    flags: dict[tuple[str, str], Counter[tuple[int, ...]]] = field(default_factory=lambda: defaultdict(Counter))
    acks: Counter[tuple[int, int]] = field(default_factory=Counter)
    texts: list[tuple[int, str]] = field(default_factory=list)
    marks: dict[str, float] = field(default_factory=dict)
    ack_s: list[float] = field(default_factory=list)
    silenced: set[str] = field(default_factory=set)
    armed: bool = False


@dataclass(frozen=True)
class Difference:
    """One thing that the emulator does otherwise than a recording.

    Attributes:
        subject: by which docs/emulator.md names it.
        words: what differs.
    """

    subject: str
    words: str


def hear(records: Iterable[object], sysids: Iterable[int]) -> dict[int, Heard]:
    """Reads what each vehicle sent."""
    parser = ardupilotmega.MAVLink(None)
    heard = {sysid: Heard() for sysid in sysids}
    asked: dict[int, dict[int, float]] = defaultdict(dict)
    for record in records:
        if not isinstance(record, Received | Sent):
            continue
        try:
            message = parser.decode(bytearray(record.frame.raw))
        except ardupilotmega.MAVError:
            continue
        t_s = record.t_ns / 1e9
        if isinstance(record, Sent):
            if message.get_type() == "COMMAND_LONG":
                asked[message.target_system].setdefault(message.command, t_s)
                if message.command == _INTERVAL and message.param2 < 0 and message.target_system in heard:
                    kind = ardupilotmega.mavlink_map.get(int(message.param1))
                    heard[message.target_system].silenced.add(kind.msgname if kind else "")
            continue
        if record.frame.sysid in heard:
            _take(heard[record.frame.sysid], message, t_s, asked[record.frame.sysid])
    return heard


def _take(heard: Heard, message: Any, t_s: float, sent_s: dict[int, float]) -> None:
    kind = message.get_type()
    heard.times_s[kind].append(t_s)
    if kind == "HEARTBEAT":
        heard.armed = bool(message.base_mode & _ARMED)
        _mark(heard, f"mode {message.custom_mode} shown", t_s)
        _mark(heard, "armed shown" if heard.armed else "disarmed shown", t_s)
    if kind in _FLAGS:
        state = "armed" if heard.armed else "disarmed"
        heard.flags[kind, state][tuple(int(getattr(message, name)) for name in _FLAGS[kind])] += 1
    if kind == "EXTENDED_SYS_STATE":
        _mark(heard, f"landed state {message.landed_state}", t_s)
    elif kind == "COMMAND_ACK":
        heard.acks[message.command, message.result] += 1
        if message.command in sent_s:
            heard.ack_s.append(t_s - sent_s.pop(message.command))
        if message.command == ardupilotmega.MAV_CMD_COMPONENT_ARM_DISARM and "armed" not in heard.marks:
            heard.marks["armed"] = t_s
    elif kind == "STATUSTEXT":
        words = (int(message.severity), str(message.text))
        if words not in heard.texts and len(heard.texts) < _TEXTS_OF_ONE:
            heard.texts.append(words)


def _mark(heard: Heard, what: str, t_s: float) -> None:
    """Keeps the first time of something after arming, counted from there."""
    began_s = heard.marks.get("armed")
    if began_s is not None:
        heard.marks.setdefault(what, t_s - began_s)


def differences(real: Heard, emulated: Heard) -> list[Difference]:
    """What one emulated vehicle sends otherwise than its real one."""
    return [
        *_kinds(real, emulated),
        *_flags(real, emulated),
        *(
            Difference(
                f"ack {command}: {result}", f"from the {'real' if real.acks[command, result] else 'emulated'} one only"
            )
            for command, result in sorted(set(real.acks) ^ set(emulated.acks))
        ),
        *_texts(real, emulated),
        *_timing(real, emulated),
    ]


def _kinds(real: Heard, emulated: Heard) -> Iterable[Difference]:
    left_out = real.silenced | emulated.silenced | _ANSWERS
    for kind in sorted((set(real.times_s) | set(emulated.times_s)) - left_out):
        theirs, ours = _rate_hz(real, kind), _rate_hz(emulated, kind)
        few = min(len(real.times_s[kind]), len(emulated.times_s[kind])) < 3
        if not emulated.times_s[kind]:
            yield Difference(kind, f"real {theirs:.2f} a second, emulated never")
        elif not real.times_s[kind]:
            yield Difference(kind, f"emulated {ours:.2f} a second, real never")
        elif not few and abs(theirs - ours) > max(_RATE_SAME * theirs, 0.15):
            yield Difference(kind, f"real {theirs:.2f} a second, emulated {ours:.2f}")


def _flags(real: Heard, emulated: Heard) -> Iterable[Difference]:
    for kind, state in sorted(set(real.flags) & set(emulated.flags)):
        names = ", ".join(_FLAGS[kind])
        theirs, ours = real.flags[kind, state], emulated.flags[kind, state]
        for value in sorted(value for value in ours if value not in theirs):
            yield Difference(f"flags of {kind}", f"{_hex(value)} {state}, from the emulated one only ({names})")
        for value in sorted(value for value, times in theirs.items() if times > 2 and value not in ours):
            yield Difference(f"flags of {kind}", f"{_hex(value)} {state}, from the real one only ({names})")


def _texts(real: Heard, emulated: Heard) -> Iterable[Difference]:
    theirs, ours = ({words for _, words in side.texts} for side in (real, emulated))
    for _, words in real.texts:
        if words not in ours:
            yield Difference(_subject(words), f"{words.strip()!r} is said by the real one only")
    for _, words in emulated.texts:
        if words not in theirs:
            yield Difference(_subject(words), f"{words.strip()!r} is said by the emulated one only")
    in_order = [item for item in real.texts if item[1] in ours]
    if in_order != [item for item in emulated.texts if item[1] in theirs]:
        yield Difference("texts", "in another order, or with another severity")


def _subject(words: str) -> str:
    """What a text is about, without its figures."""
    return " ".join(word for word in words.split() if not any(letter.isdigit() for letter in word))


def _timing(real: Heard, emulated: Heard) -> Iterable[Difference]:
    for what in sorted(set(real.marks) & set(emulated.marks) - {"armed"}):
        theirs, ours = real.marks[what], emulated.marks[what]
        if abs(theirs - ours) > _SECONDS_SAME:
            yield Difference(what, f"{theirs:.2f} s after arming, {ours:.2f} s emulated")
    for what in sorted(set(real.marks) ^ set(emulated.marks)):
        yield Difference(what, f"seen from the {'real' if what in real.marks else 'emulated'} one only")
    if real.ack_s and emulated.ack_s:
        theirs, ours = (sorted(side.ack_s)[len(side.ack_s) // 2] for side in (real, emulated))
        if theirs > 2.0 * ours or ours > 2.0 * theirs:
            yield Difference("acks", f"after {theirs * 1e3:.0f} ms in the middle, {ours * 1e3:.0f} ms emulated")


def _rate_hz(heard: Heard, kind: str) -> float:
    times = heard.times_s[kind]
    if len(times) < 2 or times[-1] <= times[0]:
        return 0.0
    gaps = sorted(b - a for a, b in pairwise(times))
    # Streams that were stopped or begun late count by their usual gap
    usual_s = gaps[len(gaps) // 2]
    mean_hz = (len(times) - 1) / (times[-1] - times[0])
    return mean_hz if usual_s <= 0.0 or mean_hz > 0.5 / usual_s else 1.0 / usual_s


def _hex(values: tuple[int, ...]) -> str:
    return " ".join(f"{value:#x}" for value in values)


def fly_again(recording: Recording, scratch: Path) -> list[object]:
    """Flies a recording's mission on the emulator; returns what was received and sent."""
    log = scratch / "emulated.tlog"
    Flight(recording.plan, log=log, chatter=True, limit_s=400.0)
    return list(read_tlog(log, 0))


def compare(recording: Recording, scratch: Path) -> dict[str, list[Difference]]:
    """Differences by autopilot: those of its first vehicle."""
    spec = recording.plan.spec.vehicles
    first = {vehicle.autopilot: vehicle.id for vehicle in reversed(spec)}
    real, emulated = hear(recording.records, first.values()), hear(fly_again(recording, scratch), first.values())
    return {autopilot: differences(real[sysid], emulated[sysid]) for autopilot, sysid in first.items()}


def main(names: list[str]) -> None:
    """Goes through the recordings whose names contain one of ``names``, or all."""
    for folder in chosen(names):
        with tempfile.TemporaryDirectory() as scratch:
            recording = load(folder, Path(scratch))
            for autopilot, lines in compare(recording, Path(scratch)).items():
                told = "".join(f"  {line.subject}: {line.words}\n" for line in lines)
                sys.stdout.write(f"{folder.name}, {autopilot}:\n{told}")


if __name__ == "__main__":
    main(sys.argv[1:])
