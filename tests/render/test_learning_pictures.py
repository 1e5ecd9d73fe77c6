"""The images that ``gibson-sim bench learning`` draws for all environments at once stand where those of each environment do."""

from __future__ import annotations

import numpy as np
import pytest

from gibson_sim.tasks.pictures import TaskCamera
from gibson_sim.tasks.registry import task_of
from gibson_sim.tasks.run import TaskRun
from gibson_sim_bench.learning import draw_together

pytestmark = pytest.mark.egl


@pytest.mark.usefixtures("egl")
def test_cameras_of_all_environments_see_what_those_of_each_see() -> None:
    task = task_of("point-goal")
    with TaskRun(task, scene="arena") as first, TaskRun(task, scene="arena") as second:
        cameras = []
        for seed, run in enumerate((first, second)):
            run.reset(seed)
            cameras.append(TaskCamera(run, (64, 48)))
        together = draw_together([first, second], cameras[0].camera)
        alone = [camera.rgbd() for camera in cameras]
    # Poses of cameras are multiplied once more: depth agrees to float32, colours but for single pixels at edges.
    assert np.median(np.abs(together[0][1] - alone[0][1])) < 1e-4
    assert np.mean(np.abs(together[0][0].astype(int) - alone[0][0]) > 2) < 0.01
    # Loose objects are those of the first; walls and floor, most of an image, are the same.
    assert np.mean(np.abs(together[1][1] - alone[1][1]) < 1e-3) > 0.5
    assert np.mean(np.abs(together[1][1] - alone[0][1]) < 1e-3) < 0.5
