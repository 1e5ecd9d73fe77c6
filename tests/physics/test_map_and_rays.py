"""Free space in the map is free space to rays."""

from __future__ import annotations

from pathlib import Path

from gibson_sim.maps.floor_map import scene_floor_map
from gibson_sim.maps.traversability import RobotSize, floor_maps
from gibson_sim.physics.world import PhysicsWorld
from gibson_sim.scenes.load import load_scene
from support.map_truth import agreement

HEIGHT = 0.5


def test_free_and_occupied_cells_of_the_flat_agree_with_rays(root: Path) -> None:
    scene = load_scene(root / "scenes/flat")
    published, for_a_robot = scene_floor_map(scene, robot_height=HEIGHT), floor_maps(scene, RobotSize(height=HEIGHT))[0]
    with PhysicsWorld(scene) as world:
        for floor in (published, for_a_robot):
            free, occupied = agreement(floor, HEIGHT, world.cast_rays, cells=120)
            assert free > 0.99
            assert occupied > 0.97


def test_free_and_occupied_cells_of_a_real_house_agree_with_rays(data_dir: Path) -> None:
    scene = load_scene(data_dir / "aws_small_house")
    with PhysicsWorld(scene) as world:
        free, occupied = agreement(scene_floor_map(scene, robot_height=HEIGHT), HEIGHT, world.cast_rays, cells=150)
    assert free > 0.99
    assert occupied > 0.97
