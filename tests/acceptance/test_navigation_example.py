"""A navigation stack that knows only standard topics localises, plans and drives in the simulation, as it would on a robot.

``GIBSON_NAVIGATION_RUNS`` drives more than the first goal of each scene, up to 10.
"""

from __future__ import annotations

import os

import pytest

from support.simulation import require

require("rclpy", "gibson_msgs", "gibson_examples")

from gibson_examples.judging import Trial, describe  # noqa: E402
from gibson_examples.trial import run_trial  # noqa: E402

pytestmark = pytest.mark.ros
RUNS = int(os.environ.get("GIBSON_NAVIGATION_RUNS", "1"))
SCENES = {"flat": "flat", "small_house": "aws_small_house/worlds/small_house.world"}
"""By name: ours, and a file under ``data_dir``."""


@pytest.fixture(scope="module", params=SCENES)
def trial(request: pytest.FixtureRequest, ros_domain: int) -> Trial:
    scene = SCENES[request.param]
    if scene != "flat":
        scene = str(request.getfixturevalue("data_dir") / scene)
    return run_trial(scene, "gibson_bot_real", runs=RUNS, rate=2.0)


def _told(trial: Trial) -> str:
    return "\n".join(map(describe, trial.runs))


def test_every_goal_is_reached_within_25_cm_of_ground_truth(trial: Trial) -> None:
    assert len(trial.runs) == RUNS
    assert all(run.status.startswith("reached") and run.error <= 0.25 for run in trial.runs), _told(trial)


def test_robot_has_no_collisions(trial: Trial) -> None:
    assert all(run.clearance >= 0.175 for run in trial.runs), _told(trial)


def test_every_run_passes_through_two_doorways(trial: Trial) -> None:
    assert all(len(run.doorways) >= 2 for run in trial.runs), _told(trial)


def test_localisation_error_stays_within_a_decimetre(trial: Trial) -> None:
    assert all(run.localisation_error < 0.1 for run in trial.runs), _told(trial)
