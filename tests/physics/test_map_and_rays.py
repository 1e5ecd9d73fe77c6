"""Free space in the map is free space to rays."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest

from gibson_sim.physics.world import PhysicsWorld
from gibson_sim.scenes.floor_map import FloorMap, scene_floor_map
from gibson_sim.scenes.load import load_scene
from gibson_sim.scenes.maps.traversability import RobotSize, floor_maps
from gibson_sim.scenes.spec import SceneSpec
from support.map_truth import agreement

HEIGHT = 0.5


def _published(scene: SceneSpec) -> FloorMap:
    return scene_floor_map(scene, robot_height=HEIGHT)


def _for_a_robot(scene: SceneSpec) -> FloorMap:
    return floor_maps(scene, RobotSize(height=HEIGHT))[0]


@pytest.mark.parametrize("make_map", [_published, _for_a_robot])
def test_free_and_occupied_cells_of_the_flat_agree_with_rays(root: Path, make_map: Callable[[SceneSpec], FloorMap]) -> None:
    scene = load_scene(root / "scenes/flat")
    with PhysicsWorld(scene) as world:
        free, occupied = agreement(make_map(scene), HEIGHT, world.cast_rays, cells=150)
    assert free > 0.99
    assert occupied > 0.97


def test_free_cells_of_a_real_house_agree_with_rays(data_dir: Path) -> None:
    scene = load_scene(data_dir / "aws_small_house")
    with PhysicsWorld(scene) as world:
        free, occupied = agreement(_published(scene), HEIGHT, world.cast_rays, cells=150)
    assert free > 0.99
    assert occupied > 0.97
