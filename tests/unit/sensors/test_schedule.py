"""When sensors are due, in whole ticks."""

from __future__ import annotations

import pytest

from gibson_sim.sensors.schedule import images_due, is_due


def _due(rate_hz: float, tick_hz: int, ticks: int) -> list[int]:
    return [t for t in range(ticks + 1) if is_due(t, rate_hz, tick_hz)]


def test_rate_that_divides_is_due_evenly() -> None:
    assert _due(20.0, 60, 12) == [3, 6, 9, 12]


def test_rate_that_does_not_divide_keeps_the_mean() -> None:
    # 25 Hz at 60 ticks a second: every 2.4 ticks, at the next whole one.
    assert _due(25.0, 60, 12) == [3, 5, 8, 10, 12]


@pytest.mark.parametrize("rate_hz", [0.1, 7.5, 10.0, 29.97, 30.0, 59.0, 60.0])
def test_mean_rate_holds_over_a_long_time(rate_hz: float) -> None:
    assert abs(len(_due(rate_hz, 60, 60_000)) - 1000 * rate_hz) <= 1


def test_rate_above_the_ticks_is_due_at_every_tick() -> None:
    assert _due(500.0, 60, 4) == [1, 2, 3, 4]


@pytest.mark.parametrize("rate_hz", [7.5, 20.0, 30.0, 60.0])
def test_images_due_between_stamps_counts_the_ticks_that_are_due(rate_hz: float) -> None:
    stamps = [tick * 1_000_000_000 // 60 for tick in range(601)]
    assert images_due(0, stamps[600], rate_hz) == 10 * rate_hz
    for tick in range(1, 601):
        assert images_due(stamps[tick - 1], stamps[tick], rate_hz) == int(is_due(tick, rate_hz, 60))
