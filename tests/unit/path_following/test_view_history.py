"""The earlier image of a view: from about a quarter of a metre away, by the estimated motion."""

from __future__ import annotations

import numpy as np

from gibson_path_following.localisation.view_history import ViewHistory
from gibson_path_following.types import Step


def test_the_earlier_view_is_the_one_from_about_a_quarter_of_a_metre_before() -> None:
    history = ViewHistory(0.1)
    images = [np.full((2, 2, 3), k, np.uint8) for k in range(6)]
    assert history.earlier() is None
    for image in images:
        history.add(image)
        history.move(Step(0.12, 0.0))
    found = history.earlier()
    assert found is not None
    np.testing.assert_array_equal(found[0], images[4])
    np.testing.assert_allclose(found[1], [-0.24, 0.0, 0.0], atol=1e-9)


def test_a_turn_in_place_gives_no_earlier_view() -> None:
    history = ViewHistory(0.0)
    for _ in range(8):
        history.add(np.zeros((2, 2, 3), np.uint8))
        history.move(Step(0.0, 0.1))
    assert history.earlier() is None
    history.move(Step(0.3, 0.0))
    assert history.earlier() is not None
    for _ in range(12):
        history.move(Step(0.0, 0.1))
    assert history.earlier() is None, "it looks elsewhere by now"


def test_a_cleared_history_has_no_views() -> None:
    history = ViewHistory(0.0)
    history.add(np.zeros((2, 2, 3), np.uint8))
    history.move(Step(0.3, 0.0))
    assert history.earlier() is not None
    history.clear()
    assert history.earlier() is None
