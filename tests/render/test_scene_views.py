"""Contact sheets of scenes."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from gibson_sim.importing import views as module
from gibson_sim.importing.views import contact_sheet, free_places
from gibson_sim.scenes.floor_map import scene_floor_map
from gibson_sim.scenes.load import load_scene
from support.scenes import write_room

pytestmark = [pytest.mark.egl, pytest.mark.usefixtures("egl")]


def test_a_sheet_has_views_a_cut_from_above_and_the_map(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    width, height = 160, 120
    for name, value in (("WIDTH", width), ("HEIGHT", height), ("_PLACES", 3)):
        monkeypatch.setattr(module, name, value)
    # A red roof, which the picture from above must not show.
    roof = "  - {name: roof, box: [4.0, 4.0, 0.1], pose: {xyz: [0, 0, 2.5]}, color: [1.0, 0.0, 0.0]}\n"
    floor = "  - {name: floor, box: [4.0, 4.0, 0.1], pose: {xyz: [0, 0, -0.05]}, color: [0.0, 0.0, 1.0]}\n"
    sheet = contact_sheet(load_scene(write_room(tmp_path / "room", roof + floor)), 1)
    views = [sheet[6 : 6 + height, left : left + width] for left in (6, 12 + width, 18 + 2 * width)]
    assert views[0].std() > 10
    middle = views[1][height // 2, width // 2].astype(int)
    assert middle[2] > middle[0] + 50
    # Walls dark, floor white.
    assert {tuple(c) for c in np.unique(views[2].reshape(-1, 3), axis=0).tolist()} >= {(255, 255, 255), (40, 40, 40)}


def test_places_of_views_are_free_and_far_apart(tmp_path: Path) -> None:
    floor = scene_floor_map(load_scene(write_room(tmp_path / "room")), robot_height=0.5)
    places = free_places(floor, 6)
    assert len(places) == 6
    assert (floor.clearance(places) > 0.2).all()
    apart = np.linalg.norm(places[:4, None] - places[None, :4], axis=2) + 9 * np.eye(4)
    assert apart.min() > 1.0
