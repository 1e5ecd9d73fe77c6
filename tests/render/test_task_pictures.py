"""What tasks show: the robot's own pictures as observations, and the view from above."""

from __future__ import annotations

import warnings

import numpy as np
import pytest

pytestmark = pytest.mark.egl


@pytest.mark.usefixtures("egl")
def test_pictures_of_an_environment_show_its_episode() -> None:
    try:
        from gibson_sim.tasks.environments import TaskEnvironment
    except ImportError:
        message = "SKIPPED: Gymnasium is not installed: pip install gibson_sim[gym]"
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
