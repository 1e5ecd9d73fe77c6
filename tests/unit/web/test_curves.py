"""Values over time for plots: bounded, without losing peaks."""

from __future__ import annotations

import math

from gibson_sim.web.curves import SPAN_S, Curve, Curves


def test_a_peak_between_two_samples_is_kept_and_the_rate_is_bounded() -> None:
    curve = Curve()
    for k in range(100):  # 1 s at 100 Hz
        curve.add(k / 100, 9.0 if k == 42 else float(k % 3))
    samples = curve.pop_new(2.0)
    assert (0.42, 9.0) in samples and len(samples) == 20
    assert [t for t, _ in samples] == sorted(t for t, _ in samples)
    assert curve.pop_new(2.0) == []


def test_a_tenth_of_a_second_is_sent_once_it_is_over() -> None:
    curve = Curve()
    curve.add(1.01, 5.0)
    assert curve.pop_new(1.02) == []
    assert curve.pop_new(1.11) == [(1.01, 5.0)]


def test_values_that_are_not_finite_break_the_line() -> None:
    curve = Curve()
    for t, value in ((0.0, 1.0), (0.1, math.nan), (0.2, math.inf), (0.3, 2.0)):
        curve.add(t, value)
    assert curve.pop_new(1.0) == [(0.0, 1.0), (0.1, None), (0.2, None), (0.3, 2.0)]


def test_the_history_is_the_last_minute() -> None:
    curves = Curves()
    curves.update([("/a", "x"), ("/b", "y")])
    for k in range(5000):
        curves.add(("/a", "x"), k / 20, float(k))
    curves.add(("/c", "z"), 0.0, 1.0)  # nobody plots it
    curves.pop_new(1e9)
    times = [t for t, _ in curves.history([("/a", "x")])[("/a", "x")]]
    assert 0.9 * SPAN_S <= times[-1] - times[0] <= SPAN_S
    curves.update([("/a", "x")])
    assert curves.names == {("/a", "x")} and len(curves.history([("/a", "x")])[("/a", "x")]) == len(times)
