"""Commands: one at a time per vehicle, repeated on silence with a higher confirmation, ended by the answer."""

from __future__ import annotations

from groundstation.mavlink.commands import Command, CommandQueue
from groundstation.mavlink.vehicle import Ack

SECOND_NS = 1_000_000_000
ARM = Command("arm", 400, (1.0,))
LAND = Command("land", 21)


def _sent(queue: CommandQueue, now_ns: int) -> list[tuple[int, int, int]]:
    return [(item.vehicle, item.command.command, item.confirmation) for item in queue.due(now_ns)]


def test_silence_is_met_with_three_repetitions_half_a_second_apart_then_told() -> None:
    queue = CommandQueue(2)
    queue.request(1, ARM)
    log = [(ms, item) for ms in range(0, 4000, 20) for item in _sent(queue, ms * 1_000_000)]
    assert log == [(0, (1, 400, 0)), (500, (1, 400, 1)), (1000, (1, 400, 2)), (1500, (1, 400, 3))]
    (outcome,) = queue.take_outcomes()
    assert outcome.result is None
    assert outcome.words() == "arm: no answer to 4 tries"
    assert not queue.pending(1)


def test_the_answer_ends_a_command_and_lets_the_next_one_go() -> None:
    queue = CommandQueue(1)
    queue.request(0, ARM)
    queue.request(0, LAND)
    queue.request(0, LAND)
    assert _sent(queue, 0) == [(0, 400, 0)]
    queue.acknowledge(Ack(0, 21, 0, 1))  # fits nothing under way
    assert _sent(queue, 1) == []
    queue.acknowledge(Ack(0, 400, 1, 2))
    assert _sent(queue, 3) == [(0, 21, 0)]
    (refused,) = queue.take_outcomes()
    assert (refused.accepted, refused.words()) == (False, "arm: temporarily rejected (result 1)")
    queue.acknowledge(Ack(0, 21, 0, 4))
    assert not queue.pending(0)
    assert queue.take_outcomes()[0].accepted


def test_an_answer_before_the_first_try_belongs_to_somebody_else() -> None:
    queue = CommandQueue(1)
    queue.request(0, ARM)
    queue.acknowledge(Ack(0, 400, 0, 0))
    assert queue.pending(0)


def test_in_progress_makes_it_wait_longer() -> None:
    queue = CommandQueue(1)
    queue.request(0, LAND)
    assert _sent(queue, 0)
    queue.acknowledge(Ack(0, 21, 5, 100))
    assert _sent(queue, 5 * SECOND_NS) == []
    queue.acknowledge(Ack(0, 21, 0, 6 * SECOND_NS))
    assert queue.take_outcomes()[0].accepted


def test_what_is_urgent_can_clear_what_waits() -> None:
    queue = CommandQueue(1)
    queue.request(0, ARM)
    _sent(queue, 0)
    queue.clear(0)
    queue.request(0, LAND)
    assert _sent(queue, 1) == [(0, 21, 0)]


def test_commands_that_nobody_answers_are_counted_until_somebody_does() -> None:
    queue = CommandQueue(1)
    for number in (1, 2):
        queue.request(0, ARM)
        for tick in range(4, -1, -1):
            queue.due(number * 10 * SECOND_NS - tick * SECOND_NS)
        assert (queue.unanswered, queue.answered) == ([number], [False])
    queue.acknowledge(Ack(0, 999, 3, 1))  # any answer shows that it hears
    assert (queue.unanswered, queue.answered) == ([0], [True])
