"""The shipped generated scenes are those that the generator makes."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from gibson_sim.formats.load_mesh import MeshLoader
from gibson_sim.maps.placement import robot_floor_map
from gibson_sim.maps.tour import plan_tour
from gibson_sim.robots.load import load_robot
from gibson_sim.scenes.load import load_scene
from gibson_sim.scenes.spec import SceneSpec
from gibson_sim_tools.generator.flat import ROOMS, make_flat


def _files(folder: Path) -> dict[str, bytes]:
    return {str(p.relative_to(folder)): p.read_bytes() for p in sorted(folder.rglob("*")) if p.is_file()}


def _flat(root: Path) -> SceneSpec:
    return load_scene(root / "scenes" / "flat")


def test_same_seed_makes_the_same_bytes(tmp_path: Path) -> None:
    make_flat(tmp_path / "a", seed=3)
    make_flat(tmp_path / "b", seed=3)
    assert _files(tmp_path / "a") == _files(tmp_path / "b")


def test_other_seed_makes_other_textures(tmp_path: Path) -> None:
    make_flat(tmp_path / "a", seed=3)
    make_flat(tmp_path / "b", seed=4)
    assert _files(tmp_path / "a")["assets/textures/oak.jpg"] != _files(tmp_path / "b")["assets/textures/oak.jpg"]


def test_shipped_flat_is_the_one_that_the_script_makes(root: Path, tmp_path: Path) -> None:
    make_flat(tmp_path, seed=1)
    shipped, made = _files(root / "scenes" / "flat"), _files(tmp_path)
    # Made of the finished scene, or by hand.
    assert shipped.keys() - made.keys() == {"floor_trav_0.png", "floors.txt", "free_poses.csv", "thumbnail.jpg"}
    assert made.keys() <= shipped.keys()
    assert made["scene.yaml"] == shipped["scene.yaml"]
    # The last bits of a cosine and the encoder of a JPEG differ between machines; sizes and shapes do not.
    assert [n for n in made if n.endswith(".glb") and len(made[n]) != len(shipped[n])] == []


def test_flat_loads_without_a_warning_and_is_small(root: Path) -> None:
    scene = _flat(root)
    assert scene.warnings == ()
    loader = MeshLoader((scene.root,), textures=False)
    assert sum(loader.shape(v.shape).triangle_count for v in scene.visuals) <= 25_000
    assert sum(len(data) for data in _files(root / "scenes" / "flat").values()) < 4_000_000
    assert {"wall", "floor", "ceiling", "window", "door_frame", "sofa", "bed", "chair"} <= {
        v.semantic_class for v in scene.visuals
    }


def test_robot_can_tour_all_rooms_from_every_start(root: Path) -> None:
    scene, robot = _flat(root), load_robot("gibson_bot")
    floor = robot_floor_map(scene, robot)
    free = floor.largest_free_region(robot.radius)
    cells = floor.cells(np.array([s.pose.position[:2] for s in scene.starts]))
    assert all(free[tuple(cell)] for cell in cells), "every start is in the one region that holds all rooms"
    x, y, _ = scene.starts[0].pose.position
    path = plan_tour(floor, (x, y), robot.radius, 60.0)
    for room in ROOMS:
        inside = ((path > (room.x0 + 0.2, room.y0 + 0.2)) & (path < (room.x1 - 0.2, room.y1 - 0.2))).all(axis=1)
        assert inside.any(), f"the tour never sees the {room.name}"
