"""Steps that clients request, and how the requests end."""

from __future__ import annotations

import pytest

from gibson_sim.standard.codes import Result, SimulationError
from gibson_sim.standard.stepping import MAX_REQUESTS, StepQueue, StepRequest


def test_requests_are_served_in_the_order_of_arrival() -> None:
    ended: list[str] = []
    queue = StepQueue()
    queue.add(StepRequest(2, on_end=lambda _: ended.append("first")))
    queue.add(StepRequest(1, on_end=lambda _: ended.append("second")))
    assert queue.remaining == 3
    queue.count_step()
    assert ended == []
    queue.count_step()
    assert ended == ["first"]
    queue.count_step()
    assert ended == ["first", "second"]
    assert queue.remaining == 0


def test_progress_is_reported_after_each_step() -> None:
    seen: list[tuple[int, int]] = []
    queue = StepQueue()
    queue.add(StepRequest(3, lambda r: seen.append((r.completed, r.remaining))))
    for _ in range(3):
        queue.count_step()
    assert seen == [(1, 2), (2, 1), (3, 0)]


def test_request_of_no_steps_ends_at_once_without_a_failure() -> None:
    queue, request = StepQueue(), StepRequest(0)
    queue.add(request)
    assert (request.ended, request.failure, queue.remaining) == (True, "", 0)


def test_cancelled_request_says_how_far_it_came_and_the_next_goes_on() -> None:
    queue, request, other = StepQueue(), StepRequest(10**12), StepRequest(1)
    queue.add(request)
    queue.add(other)
    queue.count_step()
    queue.cancel(request, "cancelled")
    assert request.failure == f"cancelled after 1 of {10**12} steps"
    queue.count_step()
    assert other.ended
    queue.cancel(request, "again")
    assert request.failure.startswith("cancelled")


def test_request_cancelled_by_its_own_progress_ends_once() -> None:
    queue = StepQueue()
    ends: list[str] = []
    request = StepRequest(1, lambda r: queue.cancel(r, "cancelled"), lambda r: ends.append(r.failure))
    queue.add(request)
    queue.count_step()
    assert ends == ["cancelled after 1 of 1 steps"]


def test_too_many_requests_are_refused() -> None:
    queue = StepQueue()
    for _ in range(MAX_REQUESTS):
        queue.add(StepRequest(1))
    with pytest.raises(SimulationError) as error:
        queue.add(StepRequest(1))
    assert error.value.code is Result.OPERATION_FAILED
    assert queue.clear("reset")
    assert queue.remaining == 0
    assert not queue.clear("reset")
