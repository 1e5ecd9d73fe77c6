"""Map files for Nav2's map server and in the layout of Gibson's scenes, and the command that writes them."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest
import yaml

from gibson_sim.cli.main import main
from gibson_sim.maps.export import write_gibson_maps, write_nav2_map, write_picture
from gibson_sim.maps.floor_map import FloorMap
from support.scenes import write_room


@pytest.fixture
def floor() -> FloorMap:
    """0.4 x 0.3 m from (0.2, -0.1): an obstacle in cell (row 0, column 1), and no floor in the last column."""
    occupied, known = np.zeros((3, 4), dtype=bool), np.ones((3, 4), dtype=bool)
    occupied[0, 1] = True
    known[:, 3] = False
    return FloorMap(0.1, (0.2, -0.1), occupied, known, floor_z=2.5)


def test_nav2_map_has_its_first_row_at_the_highest_y(floor: FloorMap, tmp_path: Path) -> None:
    image, description = write_nav2_map(floor, tmp_path / "house")
    assert image.read_bytes().startswith(b"P5\n4 3\n255\n")
    read = cv2.imread(str(image), cv2.IMREAD_UNCHANGED)
    assert read is not None
    assert read.tolist() == [[254, 254, 254, 205], [254, 254, 254, 205], [254, 0, 254, 205]]
    assert yaml.safe_load(description.read_text()) == {
        "image": "house.pgm", "mode": "trinary", "resolution": 0.1, "origin": [0.2, -0.1, 0.0], "negate": 0,
        "occupied_thresh": 0.65, "free_thresh": 0.25,
    }  # fmt: skip


def test_grey_values_lie_on_the_right_side_of_the_thresholds(floor: FloorMap, tmp_path: Path) -> None:
    meta = yaml.safe_load(write_nav2_map(floor, tmp_path / "house")[1].read_text())
    free, unknown, occupied = ((255 - grey) / 255 for grey in (254, 205, 0))
    assert free < meta["free_thresh"]
    assert not unknown > meta["occupied_thresh"]
    assert occupied > meta["occupied_thresh"]


def test_gibson_map_has_the_world_origin_in_its_middle(floor: FloorMap, tmp_path: Path) -> None:
    picture, floors = write_gibson_maps([floor], tmp_path)
    assert picture.name == "floor_trav_0.png"
    assert floors.read_text() == "2.5\n"
    read = cv2.imread(str(picture), cv2.IMREAD_UNCHANGED)
    assert read is not None
    # It reaches to x = 0.6 m: 120 pixels of 1 cm. Rows go along y and columns along x.
    assert read.shape == (120, 120)
    row, column = (60 + 5), (60 + 35)
    assert read[row, column] == 255  # (x 0.35, y 0.05)
    assert read[60 - 5, 60 + 35] == 0  # the obstacle, at y -0.05
    assert read[60 + 5, 60 + 55] == 0  # no floor
    assert read[60 + 5, 60 - 35] == 0  # outside


def test_picture_shows_y_up(floor: FloorMap, tmp_path: Path) -> None:
    write_picture(floor, tmp_path / "map.png", 0.0, pixels=1)
    read = cv2.imread(str(tmp_path / "map.png"))
    assert read is not None
    assert read.shape == (3, 4, 3)
    assert read[2, 1].sum() < read[0, 1].sum()


def test_command_writes_all_files(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    room = write_room(tmp_path / "room")
    with pytest.raises(SystemExit) as end:
        main(["scene", "map", str(room), "--output", str(tmp_path / "maps"), "--resolution", "0.1", "--radius", "0.2"])
    assert end.value.code == 0
    names = {path.name for path in (tmp_path / "maps").iterdir()}
    assert names == {"map_0.pgm", "map_0.yaml", "map_0.png", "floor_trav_0.png", "floors.txt"}
    assert "0.00 m" in capsys.readouterr().out


def test_unknown_floor_is_an_error(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    room = write_room(tmp_path / "room")
    with pytest.raises(SystemExit) as end:
        main(["scene", "map", str(room), "--output", str(tmp_path / "maps"), "--floor", "2"])
    assert end.value.code != 0
    assert "--floor is 2; the floors of tiny_room are 0 at 0 m" in capsys.readouterr().err
