from __future__ import annotations

import pytest

from gibson_sim.quoting import duration_text


@pytest.mark.parametrize(
    ("seconds", "text"),
    [(0.0, "0 s"), (42.4, "42 s"), (89.0, "89 s"), (90.0, "2 min"), (5399.0, "90 min"), (5400.0, "1.5 h"), (40000.0, "11.1 h")],
)
def test_a_duration_has_a_unit_that_suits_it(seconds: float, text: str) -> None:
    assert duration_text(seconds) == text
