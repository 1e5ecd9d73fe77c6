"""Ticks that are due by wall time, with given times."""

from __future__ import annotations

from gibson_sim.ros.lockstep.pacing import Pacer

MS = 1_000_000


def test_real_time_makes_as_many_ticks_as_time_has_passed() -> None:
    pacer = Pacer(tick_hz=100, rate=1.0)
    assert [pacer.due(t * MS) for t in (0, 10, 25, 30, 50)] == [0, 1, 1, 1, 2]


def test_double_speed_makes_twice_as_many() -> None:
    pacer = Pacer(tick_hz=100, rate=2.0)
    assert [pacer.due(t * MS) for t in (0, 10, 20)] == [0, 2, 2]


def test_lag_beyond_the_limit_is_dropped() -> None:
    pacer = Pacer(tick_hz=100, rate=1.0, max_lag_ns=50 * MS)
    assert pacer.due(0) == 0
    assert pacer.due(1000 * MS) == 5
    assert pacer.lost_ns == 950 * MS
    assert pacer.due(1010 * MS) == 1


def test_no_tick_is_lost_or_doubled_over_many_small_steps() -> None:
    pacer = Pacer(tick_hz=120, rate=1.0)
    total = sum(pacer.due(t * 1_234_567) for t in range(10_000))
    assert abs(total - 9_999 * 1_234_567 * 120 / 1e9) <= 1
    assert pacer.lost_ns == 0


def test_as_fast_as_possible_always_has_one_due() -> None:
    pacer = Pacer(tick_hz=120, rate=0.0)
    assert [pacer.due(0), pacer.due(0), pacer.due(5)] == [1, 1, 1]


def test_new_rate_counts_from_when_it_was_set() -> None:
    pacer = Pacer(tick_hz=100, rate=1.0)
    assert [pacer.due(t * MS) for t in (0, 100)] == [0, 10]
    pacer.set_rate(0.5)
    assert [pacer.due(t * MS) for t in (110, 210)] == [0, 5]


def test_time_that_stood_still_is_neither_caught_up_nor_lost() -> None:
    pacer = Pacer(tick_hz=100, rate=1.0)
    pacer.due(0)
    pacer.restart()
    assert [pacer.due(t * MS) for t in (9_000, 9_010)] == [0, 1]
    assert pacer.lost_ns == 0


def test_without_a_pace_a_burst_is_due_at_any_time() -> None:
    pacer = Pacer(tick_hz=240, rate=0.0, burst=4)
    assert [pacer.due(t) for t in (0, 1, 10**12)] == [4, 4, 4]
