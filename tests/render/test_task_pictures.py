"""Pictures of tasks: the robot's cameras as observations, and the top view."""

from __future__ import annotations

import warnings
from dataclasses import replace

import numpy as np
import pytest

from gibson_sim.errors import ConfigError
from gibson_sim.tasks.pictures import FARTHEST_DEPTH, TaskCamera
from gibson_sim.tasks.registry import task_of
from gibson_sim.tasks.run import TaskRun

pytestmark = pytest.mark.egl


@pytest.mark.usefixtures("egl")
def test_images_of_a_task_are_those_of_its_simulation_without_depth_noise() -> None:
    with TaskRun(task_of("point-goal"), scene="arena", robot="gibson_bot_real") as run:
        run.reset(1)
        camera = TaskCamera(run, (64, 48))
        rgb, depth = camera.rgbd()
        frame = run.simulation.render(camera.camera)
        assert frame.rgb is not None and frame.depth is not None
        assert np.array_equal(rgb, frame.rgb) and depth.shape == (48, 64, 1)
        assert not np.array_equal(depth[..., 0], frame.depth), "the robot's camera has noise"
        true = run.simulation.renderer.render(run.world.state(), [camera.camera])[0].depth
        assert true is not None
        assert np.array_equal(depth[..., 0], np.clip(true, 0.0, FARTHEST_DEPTH))
        # The next episode is another scene for the same renderer.
        renderer = run.simulation.renderer
        run.reset(2)
        assert not np.array_equal(camera.rgbd()[1], depth)
        assert run.simulation.renderer is renderer


def test_a_robot_without_a_camera_is_refused() -> None:
    with TaskRun(task_of("point-goal"), scene="arena") as run:
        run.robot = replace(run.robot, cameras=())
        with pytest.raises(ConfigError, match="robot 'robot' has no camera; choose another one, or observation='state'"):
            TaskCamera(run, (64, 48))


@pytest.mark.usefixtures("egl")
def test_pictures_of_an_environment_show_its_episode() -> None:
    try:
        from gibson_sim.tasks.environments import TaskEnvironment
    except ImportError:
        message = "SKIPPED: Gymnasium is not installed: pip install 'gibson_sim[gym]'"
        warnings.warn(message, stacklevel=2)
        pytest.skip(message)
    environment = TaskEnvironment("push-through", observation="rgbd", scene="arena", size=(64, 48), render_mode="rgb_array")
    try:
        seen, _ = environment.reset(seed=4)
        assert environment.observation_space.contains(seen)
        assert seen["rgb"].shape == (48, 64, 3) and 0.1 < seen["depth"].min() < seen["depth"].max() <= 10.0
        same, _ = environment.reset(seed=4)
        other, _ = environment.reset(seed=5)
        assert np.array_equal(seen["rgb"], same["rgb"]) and np.array_equal(seen["depth"], same["depth"])
        assert not np.array_equal(seen["depth"], other["depth"])
        picture = environment.render()
        assert picture is not None and picture.shape == (256, 512, 3)
        # From above: the robot, which is dark, in the middle of the floor.
        above = picture[:, 256:].astype(int)
        assert above[123:133, 123:133].sum(axis=2).min() + 150 < np.median(above.sum(axis=2))
    finally:
        environment.close()
