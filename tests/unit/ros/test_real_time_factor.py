"""The real-time factor of the page."""

from __future__ import annotations

import pytest

from gibson_sim.ros.web.real_time_factor import RealTimeFactor


def test_real_time_factor_is_averaged_over_seconds() -> None:
    factor = RealTimeFactor()
    assert factor.add(0.0, 10.0) is None
    # Each look by itself would show 0.4, 1.6, 0.4, 1.6.
    shown = [factor.add(wall, time) for wall, time in ((1.0, 10.4), (2.0, 12.0), (3.0, 12.4), (4.0, 14.0), (5.0, 14.4))]
    # The last ones span 3 s: (12.4 - 10.0) / 3, (14.0 - 10.4) / 3, (14.4 - 12.0) / 3.
    assert shown == pytest.approx([0.4, 1.0, 0.8, 1.2, 0.8])


def test_a_reset_and_an_end_restart_the_average() -> None:
    factor = RealTimeFactor()
    factor.add(0.0, 10.0)
    assert factor.add(1.0, 0.0) is None and factor.add(2.0, 2.0) == pytest.approx(2.0)
    factor.clear()
    assert factor.add(3.0, 9.0) is None
