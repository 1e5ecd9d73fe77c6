"""Rates, gaps and latencies of synthetic stamps."""

from __future__ import annotations

import math

import numpy as np
import pytest

from gibson_sim.bags.comparison.recorded_drive import Arrivals
from gibson_sim.bags.comparison.timing import topic_timing

MS = 1_000_000
STAMPS = np.arange(100, dtype=np.int64) * 50 * MS


def test_regular_topic_has_its_rate_and_latency() -> None:
    found = topic_timing(Arrivals(STAMPS + 7 * MS, STAMPS))
    assert (found.count, found.rate_hz, found.missing) == (100, pytest.approx(20.0), 0)
    assert (found.jitter_ms, found.latency_ms) == pytest.approx((0.0, 7.0))


def test_lost_messages_are_counted_and_do_not_change_the_rate() -> None:
    kept = np.delete(STAMPS, [10, 11, 50])
    found = topic_timing(Arrivals(kept, kept))
    assert (found.missing, found.rate_hz, found.missing_part) == (3, pytest.approx(20.0), pytest.approx(0.03))


def test_jitter_is_the_spread_of_the_steps() -> None:
    moved = STAMPS + np.where(np.arange(100) % 2, 4, 0) * MS
    assert topic_timing(Arrivals(moved, None)).jitter_ms == pytest.approx(4.0, rel=0.02)


def test_stamps_of_another_clock_have_no_latency() -> None:
    found = topic_timing(Arrivals(STAMPS + 1_700_000_000_000 * MS, STAMPS))
    assert not found.same_clock
    assert math.isnan(found.latency_ms)
    assert found.rate_hz == pytest.approx(20.0)


def test_a_single_message_has_no_rate() -> None:
    assert topic_timing(Arrivals(STAMPS[:1], STAMPS[:1])).rate_hz == 0.0
