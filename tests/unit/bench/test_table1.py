"""The paper's table in this process: the order of interleaved measurements, stopwatches, poses from matrices, and the random velocities of the
measured loop.
"""

from __future__ import annotations

import math
from types import SimpleNamespace

import pytest

from gibson_sim_bench.own_renderer import pose_of
from gibson_sim_bench.protocol import BLOCK
from gibson_sim_bench.table1 import Clock, calls_of, copy_ms, measure_interleaved, time


def test_frames_staged_frames_and_another_configuration_are_interleaved() -> None:
    done: list[str] = []

    def other(count: int) -> list[float]:
        done.append(f"other {count}")
        return [0.5] * count

    times, others = measure_interleaved(lambda: done.append("whole"), lambda: done.append("apart"), BLOCK + 2, 3, other)
    assert (len(times), others) == (BLOCK + 2, [0.5] * (BLOCK + 2))
    before, *blocks = " ".join(done).replace("other 3", "|").split(f"other {BLOCK}")
    assert before.startswith("whole whole whole | apart")
    assert (before.count("whole"), blocks[0].count("whole")) == (3 + 1 + BLOCK, 1 + 2)
    assert done[-1] == "other 2"


def test_without_another_configuration_there_are_frames_alone() -> None:
    times, others = measure_interleaved(lambda: None, lambda: None, 2, 1)
    assert (len(times), others) == (2, [])


@pytest.fixture
def ticks(monkeypatch: pytest.MonkeyPatch) -> None:
    """A clock that goes on by 1 ms whenever it is read."""
    now = iter(range(0, 10**9, 1_000_000))
    monkeypatch.setattr(time, "perf_counter_ns", lambda: next(now))


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
