"""Pairs of the filler, drawn in a scene that is its own scan."""

from __future__ import annotations

from dataclasses import fields
from pathlib import Path

import numpy as np
import pytest

from gibson_sim.resources import find_scene
from gibson_sim_learn.filler.evaluation import flicker_of
from gibson_sim_learn.filler.pairs import Pairs, ScannedScene, draw_pairs, is_hole, normals_of

pytestmark = [pytest.mark.egl, pytest.mark.usefixtures("egl")]


def test_a_scene_that_is_its_own_scan_has_equal_pairs_and_no_more_flicker_than_the_truth() -> None:
    scanned = ScannedScene.load("arena", Path(find_scene("arena")))
    pairs, again = (draw_pairs(scanned, 0, 0, views=3) for _ in range(2))
    assert all(np.array_equal(getattr(pairs, item.name), getattr(again, item.name)) for item in fields(Pairs))
    seen = ~is_hole(pairs.hole)
    assert seen.mean() > 0.3 and (pairs.drawn[seen] == pairs.truth[seen]).mean() > 0.99
    lengths = np.linalg.norm(normals_of(pairs.normals[seen & (pairs.hole == 0)]), axis=-1)
    assert np.abs(lengths - 1.0).max() < 0.02
    found = flicker_of(scanned, {"nothing": lambda colour, depth, normals, hole: colour}, 0, 3)
    assert found["nothing"].all == pytest.approx(found["truth"].all, abs=0.05) and found["truth"].all < 8.0
