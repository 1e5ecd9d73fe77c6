"""Stopwatches, poses from matrices, and the random velocities of the measured loop."""

from __future__ import annotations

import math
from types import SimpleNamespace

import pytest

from gibson_sim_bench import clocks
from gibson_sim_bench.clocks import Clock, calls_of, copy_ms
from gibson_sim_bench.own_renderer import pose_of


@pytest.fixture
def ticks(monkeypatch: pytest.MonkeyPatch) -> None:
    """A clock that goes on by 1 ms whenever it is read."""
    now = iter(range(0, 10**9, 1_000_000))
    monkeypatch.setattr(clocks.time, "perf_counter_ns", lambda: next(now))


@pytest.mark.usefixtures("ticks")
def test_a_clock_adds_up_calls_and_begins_again_when_it_is_read() -> None:
    clock = Clock()
    double = clock.timed(lambda number: 2 * number)
    assert [double(3), double(number=4)] == [6, 8]
    assert (clock.pop_ms(), clock.pop_ms()) == (2.0, 0.0)
    with pytest.raises(ZeroDivisionError):
        clock.timed(lambda: 1 / 0)()
    assert clock.pop_ms() == 1.0, "a call that fails counts as well"


@pytest.mark.usefixtures("ticks")
def test_calls_are_timed_inside_the_block_only() -> None:
    def answer() -> int:
        return 42

    owner = SimpleNamespace(answer=answer)
    with calls_of(owner, "answer") as clock:
        assert owner.answer() == 42
    assert owner.answer is answer
    assert clock.pop_ms() == 1.0


@pytest.mark.usefixtures("ticks")
def test_a_copy_takes_the_median_of_its_times() -> None:
    assert copy_ms(1000, times=5) == 1.0


def test_a_pose_is_that_of_its_matrix() -> None:
    # A quarter turn about z, at (1, 2, 3).
    pose = pose_of([0.0, -1.0, 0.0, 1.0, 1.0, 0.0, 0.0, 2.0, 0.0, 0.0, 1.0, 3.0, 0.0, 0.0, 0.0, 1.0])
    assert pose.position == (1.0, 2.0, 3.0)
    assert pose.quat_xyzw == pytest.approx((0.0, 0.0, math.sqrt(0.5), math.sqrt(0.5)))
