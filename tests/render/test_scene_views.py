"""Contact sheets of scenes."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from gibson_sim.cli.main import main
from gibson_sim.maps.floor_map import scene_floor_map
from gibson_sim.scenes.load import load_scene
from gibson_sim_tools.importing import views as module
from gibson_sim_tools.importing.views import contact_sheet, free_places, gallery_of_scenes
from support.scenes import write_house, write_room

CRATE = """<robot name="crate"><link name="crate">
<visual><geometry><box size="1 1 1"/></geometry><material name="green"><color rgba="0 1 0 1"/></material></visual>
<collision><geometry><box size="1 1 1"/></geometry></collision>
<inertial><mass value="1"/><inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/></inertial></link></robot>"""

pytestmark = [pytest.mark.egl, pytest.mark.usefixtures("egl")]


def test_a_sheet_has_views_a_cut_from_above_and_the_map(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    width, height = 160, 120
    for name, value in (("WIDTH", width), ("HEIGHT", height), ("_CANDIDATES", 3)):
        monkeypatch.setattr(module, name, value)
    # A red roof, which the top view must not show.
    roof = "  - {name: roof, box: [4.0, 4.0, 0.1], pose: {xyz: [0, 0, 2.5]}, color: [1.0, 0.0, 0.0]}\n"
    floor = "  - {name: floor, box: [4.0, 4.0, 0.1], pose: {xyz: [0, 0, -0.05]}, color: [0.0, 0.0, 1.0]}\n"
    # Bodies are drawn where they start.
    bodies = "bodies: [{name: crate, model: ./crate.urdf, pose: {xyz: [1.2, 1.2, 0.5]}}]\n"
    folder = write_room(tmp_path / "room", roof + floor + bodies)
    (folder / "crate.urdf").write_text(CRATE)
    sheet = contact_sheet(load_scene(folder), 1)
    views = [sheet[6 : 6 + height, left : left + width] for left in (6, 12 + width, 18 + 2 * width)]
    assert views[0].std() > 10
    middle = views[1][height // 2, width // 2].astype(int)
    assert middle[2] > middle[0] + 50
    greenest = views[1].astype(int)[..., 1] - views[1].max(axis=2, initial=0, where=[True, False, True])
    row, column = np.unravel_index(int(greenest.argmax()), greenest.shape)
    assert greenest.max() > 50 and row < height // 2 and column > width // 2
    # Walls dark, floor white.
    assert {tuple(c) for c in np.unique(views[2].reshape(-1, 3), axis=0).tolist()} >= {(255, 255, 255), (40, 40, 40)}


def test_places_of_views_are_free_and_far_apart(tmp_path: Path) -> None:
    floor = scene_floor_map(load_scene(write_room(tmp_path / "room")), robot_height=0.5)
    places = free_places(floor, 6)
    assert len(places) == 6
    assert (floor.clearance(places) > 0.2).all()
    apart = np.linalg.norm(places[:4, None] - places[None, :4], axis=2) + 9 * np.eye(4)
    assert apart.min() > 1.0


def test_several_scenes_have_a_row_each(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    for name, value in (("WIDTH", 160), ("HEIGHT", 120), ("_CANDIDATES", 3)):
        monkeypatch.setattr(module, name, value)
    picture = gallery_of_scenes([load_scene(write_room(tmp_path / name)) for name in ("a", "b")], 2)
    assert picture.shape[:2] == (2 * (120 + 28) + 6, 2 * (160 + 6) + 6)


def test_the_floor_of_a_house_is_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    for name, value in (("WIDTH", 160), ("HEIGHT", 120), ("_CANDIDATES", 3)):
        monkeypatch.setattr(module, name, value)
    titles: list[str] = []
    monkeypatch.setattr(module, "sheet", lambda pictures, columns=3: titles.extend(title for title, _ in pictures))
    house = load_scene(write_house(tmp_path / "house"))
    contact_sheet(house, 1)
    contact_sheet(house, 1, floor_z=3.0)
    assert [title.partition(", ")[0] for title in titles] == ["floor 0"] * 3 + ["floor 1"] * 3
    titles.clear()
    contact_sheet(load_scene(write_room(tmp_path / "room")), 1)
    assert not any("floor " in title for title in titles), "one floor needs no number"


def test_a_floor_is_for_one_scene(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    rooms = [str(write_room(tmp_path / name)) for name in ("a", "b")]
    with pytest.raises(SystemExit):
        main(["scene", "view", *rooms, "--floor", "0"])
    assert "--floor is for one scene" in capsys.readouterr().err
