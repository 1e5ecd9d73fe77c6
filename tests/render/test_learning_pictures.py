"""Images for learning: batched rendering equals rendering of each environment, and earlier images have the reported poses."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from numpy.typing import NDArray

from gibson_path_following.obstacles.floor_plane import FloorPlane
from gibson_sim.tasks.pictures import TaskCamera
from gibson_sim.tasks.registry import task_of
from gibson_sim.tasks.run import TaskRun
from gibson_sim_bench.learning import render_batched
from gibson_sim_learn.path_following.data import World
from gibson_sim_learn.path_following.distances.obstacles import draw_obstacle_shard
from gibson_sim_learn.path_following.drawing import CAMERA_HEIGHT, HEIGHT, HFOV, WIDTH

pytestmark = pytest.mark.egl


@pytest.mark.usefixtures("egl")
def test_cameras_rendered_for_all_environments_equal_those_rendered_for_each() -> None:
    task = task_of("point-goal")
    with TaskRun(task, scene="arena") as first, TaskRun(task, scene="arena") as second:
        cameras = []
        for seed, run in enumerate((first, second)):
            run.reset(seed)
            cameras.append(TaskCamera(run, (64, 48)))
        together = render_batched([first, second], cameras[0].camera)
        alone = [camera.rgbd() for camera in cameras]
    # Poses of cameras are multiplied once more: depth agrees to float32, colours but for single pixels at edges.
    assert np.median(np.abs(together[0][1] - alone[0][1])) < 1e-4
    assert np.mean(np.abs(together[0][0].astype(int) - alone[0][0]) > 2) < 0.01
    # Loose objects are those of the first; walls and floor, most of an image, are the same.
    assert np.mean(np.abs(together[1][1] - alone[1][1]) < 1e-3) > 0.5
    assert np.mean(np.abs(together[1][1] - alone[0][1]) < 1e-3) < 0.5


@pytest.mark.usefixtures("egl")
def test_earlier_images_of_obstacles_show_the_reported_pose() -> None:
    shard = draw_obstacle_shard(World.load("mill_house"), 0, 0)
    assert shard.earlier is not None and shard.earlier_pose is not None
    floor = FloorPlane(WIDTH, HEIGHT, HFOV, CAMERA_HEIGHT)
    turned = np.flatnonzero(np.abs(shard.earlier_pose[:, 2]) > 0.15)[:60]
    assert len(turned) > 30

    def difference(pose_of: Callable[[NDArray[np.float64]], NDArray[np.float64]]) -> float:
        """Returns the median over images of the mean difference where both see something, in the lower half."""
        found = []
        for k in turned:
            warped = floor.warp(shard.earlier[k], pose_of(shard.earlier_pose[k].astype(np.float64)))[HEIGHT // 2 :]
            known = warped.any(axis=2)
            found.append(np.abs(warped.astype(float) - shard.images[k][HEIGHT // 2 :])[known].mean())
        return float(np.median(found))

    true = difference(lambda pose: pose)
    assert true < 0.8 * difference(np.zeros_like)
    assert true < 0.8 * difference(lambda pose: pose * [1.0, -1.0, -1.0]), "left is not right"
    assert true < 0.8 * difference(lambda pose: pose * [-1.0, 1.0, 1.0]), "earlier is behind"
