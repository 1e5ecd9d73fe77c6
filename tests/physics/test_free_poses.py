"""In every shipped scene our robot has room: at free poses of the map it stands on the floor and touches nothing."""

from __future__ import annotations

from pathlib import Path

import pytest

from gibson_sim.geometry.transforms import pose_from_xyz_rpy
from gibson_sim.robots.spec import RobotSpec
from gibson_sim.scenes.load import load_scene
from support.drops import free_poses, what_goes_wrong

SCENES = sorted(path.parent for path in (Path(__file__).resolve().parents[2] / "scenes").glob("*/scene.yaml"))
POSES = 100


@pytest.mark.parametrize("folder", SCENES, ids=lambda folder: folder.name)
def test_robot_dropped_at_100_random_free_poses_rests_on_the_floor_and_touches_nothing(folder: Path, robot: RobotSpec) -> None:
    scene = load_scene(folder)
    poses = free_poses(scene, robot, POSES, seed=1)
    assert len(poses) == POSES
    assert what_goes_wrong(scene, robot, poses) == []


def test_robot_inside_a_wall_and_above_the_floor_is_noticed(root: Path, robot: RobotSpec) -> None:
    scene = load_scene(root / "scenes/flat")
    # Half a metre in the air, and in the outer wall, where no robot may start.
    wrong = what_goes_wrong(scene, robot, [pose_from_xyz_rpy((1.0, 4.7, 0.5)), pose_from_xyz_rpy((0.1, 1.0, 0.0))])
    assert any("touches walls" in line for line in wrong)
    assert any("from the floor at 0.5 m" in line for line in wrong)
