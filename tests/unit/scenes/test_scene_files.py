"""Maps and free poses of a finished scene: written, read, and as shipped."""

from __future__ import annotations

import re
from pathlib import Path

import cv2
import numpy as np
import pytest

from gibson_sim.cli.main import main
from gibson_sim.errors import SceneError
from gibson_sim.maps.free_poses import FreePose, read_free_poses, scene_free_poses, write_free_poses
from gibson_sim.maps.scene_files import POSES, SPARE, USUAL_ROBOT, write_scene_files
from gibson_sim.scenes.load import load_scene
from gibson_sim_tools.importing.scene_files import clearances, free_distances, missing_items, outdated_items
from support.scenes import write_room

SCENES = sorted(path.parent for path in (Path(__file__).resolve().parents[3] / "scenes").glob("*/scene.yaml"))
EXTRA = """\
  - {name: rug, box: [1.0, 1.0, 0.01], pose: {xyz: [1.0, 1.0, 0.005]}}
  - {name: wardrobe, box: [1.2, 1.2, 2.0], pose: {xyz: [-1.2, -1.2, 1.0]}}
bodies: [{name: crate, model: ./crate.urdf, pose: {xyz: [1.2, -1.2, 0.0]}}]
rooms:
  - {name: west, class: hall, polygon: [[-2, -2], [0, -2], [0, 2], [-2, 2]]}
  - {name: east, class: office, polygon: [[0, -2], [2, -2], [2, 2], [0, 2]]}
"""
CRATE = """<robot name="crate"><link name="crate">
<collision><origin xyz="0 0 0.3"/><geometry><box size="0.6 0.6 0.6"/></geometry></collision>
<inertial><mass value="1"/><inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/></inertial></link></robot>"""


@pytest.fixture
def furnished(tmp_path: Path) -> Path:
    folder = write_room(tmp_path / "room", EXTRA)
    (folder / "crate.urdf").write_text(CRATE)
    return folder


def test_maps_and_poses_are_written_into_the_folder_and_fit_the_scene(furnished: Path) -> None:
    (furnished / "floor_trav_1.png").write_bytes(b"of a floor that is gone")
    names = [path.name for path in write_scene_files(furnished)]
    assert not (furnished / "floor_trav_1.png").exists()
    assert names == ["floor_trav_0.png", "floors.txt", "free_poses.csv"]
    scene = load_scene(furnished)
    poses = scene_free_poses(scene)
    assert len(poses) == POSES
    assert free_distances(scene, poses, USUAL_ROBOT.height).min() >= USUAL_ROBOT.radius + SPARE - 0.001
    assert {pose.room for pose in poses} == {"west", "east"}
    assert list(outdated_items(scene, USUAL_ROBOT.radius, USUAL_ROBOT.height)) == []
    # No pose is in the wardrobe, whose bottom is level and at the height of the floor, nor in the crate.
    picture = cv2.imread(str(furnished / "floor_trav_0.png"), cv2.IMREAD_UNCHANGED)
    assert picture is not None
    middle = picture.shape[0] // 2
    assert [int(picture[middle + int(100 * y), middle + int(100 * x)]) for x, y in ((-1.2, -1.2), (1.2, -1.2), (0, 0))] == [
        0,
        0,
        255,
    ]
    # On the rug a robot stands higher.
    on_rug = [pose.z for pose in poses if abs(pose.x - 1.0) < 0.4 and abs(pose.y - 1.0) < 0.4]
    assert on_rug and set(on_rug) == {0.01}


def test_no_pose_lies_on_or_beside_a_bump_that_a_robot_drives_up(tmp_path: Path) -> None:
    # A slab 8 cm high, and four sides of 15 degrees down to the floor: robots reach its top.
    side, top = 0.7, 0.4
    corners = [(c * x, c * y, z) for c, z in ((side, 0.0), (top, 0.08)) for x, y in ((-1, -1), (1, -1), (1, 1), (-1, 1))]
    faces = [
        (4, 5, 6),
        (4, 6, 7),
        *((k, (k + 1) % 4, 4 + (k + 1) % 4) for k in range(4)),
        *((k, 4 + (k + 1) % 4, 4 + k) for k in range(4)),
    ]
    (tmp_path / "room").mkdir()
    lines = [
        *("v {:g} {:g} {:g}".format(*corner) for corner in corners),
        *("f {} {} {}".format(*(i + 1 for i in face)) for face in faces),
    ]
    (tmp_path / "room/bump.obj").write_text("\n".join(lines))
    folder = write_room(tmp_path / "room", "  - {name: bump, mesh: ./bump.obj, collision: same}\n")
    write_scene_files(folder)
    scene = load_scene(folder)
    # On the map the top is free.
    picture = cv2.imread(str(folder / "floor_trav_0.png"), cv2.IMREAD_UNCHANGED)
    assert picture is not None and picture[picture.shape[0] // 2, picture.shape[1] // 2] == 255
    assert list(outdated_items(scene, USUAL_ROBOT.radius, USUAL_ROBOT.height)) == []
    assert {pose.z for pose in scene_free_poses(scene)} == {0.0}


def test_the_same_seed_gives_the_same_files_and_another_gives_other_poses(furnished: Path) -> None:
    first, again, other = ([path.read_bytes() for path in write_scene_files(furnished, seed=seed)] for seed in (0, 0, 1))
    assert first == again
    assert first[:2] == other[:2] and first[2] != other[2]


def test_outdated_files_are_reported(furnished: Path) -> None:
    write_scene_files(furnished)
    text = (furnished / "scene.yaml").read_text()
    (furnished / "scene.yaml").write_text(
        text.replace("[1.2, -1.2, 0.0]", "[0.3, 0.3, 0.0]")
        .replace("name: east", "name: den")
        .replace("ground_z: 0.0", "ground_z: 0.0\nfloor_z: 0.02")
    )
    told = "\n".join(outdated_items(load_scene(furnished), 0.2, 0.5))
    assert "has floors at 0 m, the scene at 0.02 m" in told
    assert re.search(r"\d+ of 100 poses lie in another room", told)
    assert re.search(r"\d+ of 100 poses are not free", told)


def test_the_command_writes_into_the_scene(furnished: Path, capsys: pytest.CaptureFixture[str]) -> None:
    for words, code, said in (
        (["--write", "--floor", "0"], 2, "--floor: not with --write"),
        (["--write", "--radius", "0.4"], 0, "free_poses.csv"),
        (["--write", "--radius", "3"], 1, "poses fit with 3.03 m to obstacles"),
    ):
        with pytest.raises(SystemExit) as end:
            main(["scene", "map", str(furnished), *words])
        said_all = "".join(capsys.readouterr())
        assert said in said_all
        assert (end.value.code == 0) == (code == 0)


def test_a_mesh_alone_has_no_place_for_maps(tmp_path: Path) -> None:
    with pytest.raises(SceneError, match=r"holds no scene\.yaml"):
        write_scene_files(tmp_path)


def test_poses_are_read_as_they_were_written(tmp_path: Path) -> None:
    poses = (FreePose(0, 1.25, -2.5, 0.01, 1.5708, "bed, room"), FreePose(1, 0.0, 0.0, 2.8, -3.1, ""))
    write_free_poses(tmp_path / "a.csv", poses)
    assert read_free_poses(tmp_path / "a.csv") == poses
    assert poses[0].pose.position == (1.25, -2.5, 0.01)
    assert poses[0].pose.quat_xyzw == pytest.approx((0.0, 0.0, 0.5**0.5, 0.5**0.5), abs=1e-5)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("", "begins with nothing, must begin with floor,x,y,z,yaw,room"),
        ("x,y\n", "begins with 'x,y', must begin"),
        ("floor,x,y,z,yaw,room\n0,1,2\n", "line 2: has 3 values, must have 6"),
        ("floor,x,y,z,yaw,room\n0,1,2,3,4,a\n0,a,2,3,4,b\n", "line 3: could not convert"),
        ("floor,x,y,z,yaw,room\n-1,1,2,3,4,a\n", "line 2: .*floor must be 0 or more"),
        ("floor,x,y,z,yaw,room\n0,nan,2,3,4,a\n", "finite"),
    ],
)
def test_a_broken_file_of_poses_is_refused(tmp_path: Path, text: str, words: str) -> None:
    (tmp_path / "a.csv").write_text(text)
    with pytest.raises(SceneError, match=words):
        read_free_poses(tmp_path / "a.csv")


def test_clearances_are_exact() -> None:
    # A wall along x = 1 from y = -1 to 1, a plank below, and one above the robot.
    wall = [[[1, -1, 0], [1, 1, 0], [1, 1, 2]], [[1, -1, 0], [1, 1, 2], [1, -1, 2]]]
    planks = [[[-1, -1, z], [0.5, 0, z], [-1, 1, z]] for z in (0.01, 1.6)]
    places = [(0.4, 0.0), (1.0, 0.5), (1.3, 1.4), (-5.0, 0.0)]
    assert clearances(wall + planks, places, 0.03, 1.5) == pytest.approx([0.6, 0.0, 0.5, 1.0])
    assert clearances(planks, [(0.0, 0.0), (0.8, 0.0)], 0.0, 1.5) == pytest.approx([0.0, 0.3])


@pytest.mark.shipped
@pytest.mark.parametrize("folder", SCENES, ids=lambda folder: folder.name)
def test_a_shipped_scene_carries_everything_and_all_of_it_fits(folder: Path) -> None:
    scene = load_scene(folder)
    assert missing_items(scene) == []
    assert list(outdated_items(scene, USUAL_ROBOT.radius, USUAL_ROBOT.height)) == []
    poses = scene_free_poses(scene)
    assert len(poses) == POSES * len(scene.floors)
    assert all(pose.room for pose in poses)
    for number, floor_z in enumerate(scene.floors):
        here = [pose for pose in poses if pose.floor == number]
        assert max(abs(pose.z - floor_z) for pose in here) <= 0.03
        picture = cv2.imread(str(folder / f"floor_trav_{number}.png"), cv2.IMREAD_UNCHANGED)
        assert picture is not None
        cells = np.array([(pose.y, pose.x) for pose in here]) * 100 + picture.shape[0] // 2
        assert (picture[tuple(cells.astype(int).T)] == 255).all()
