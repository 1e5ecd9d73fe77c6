from __future__ import annotations

from gibson_sim.ros.recording.raw_subscriptions import LossCounter


def _noted(*numbers: int | None) -> dict[str, int]:
    losses = LossCounter()
    for number in numbers:
        losses.add("/a", number)
    return losses.counts()


def test_every_missing_number_is_a_lost_message() -> None:
    assert _noted(17, 18, 21, 22, 24) == {"/a": 3}


def test_messages_before_the_first_received_one_are_not_lost() -> None:
    assert _noted(500, 501) == {"/a": 0}


def test_restarted_publisher_lost_nothing() -> None:
    assert _noted(7, 8, 1, 2) == {"/a": 0}


def test_middleware_without_sequence_numbers_reports_nothing() -> None:
    assert _noted(None, None) == {}


def test_losses_of_a_topic_with_two_publishers_are_unknown() -> None:
    losses = LossCounter()
    losses.add("/a", 1)
    losses.add("/b", 1)
    losses.set_publisher_count("/a", 2)
    losses.set_publisher_count("/b", 1)
    losses.set_publisher_count("/a", 1)
    losses.add("/a", 9)
    assert losses.counts() == {"/b": 0}
