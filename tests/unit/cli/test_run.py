"""The job of the options of ``gibson-sim run``."""

from __future__ import annotations

import argparse
from pathlib import Path

import pytest

from gibson_sim.cli.commands import run
from gibson_sim.cli.job import Job
from gibson_sim.errors import ConfigError


def plan(folder: Path, *argv: str) -> Job:
    """Returns the job of a command line."""
    parser = argparse.ArgumentParser()
    run.add_parser(parser.add_subparsers())
    return run._plan(parser.parse_args(["run", "--scene", "flat", *argv]), folder)


@pytest.mark.parametrize(("cmd_vel_type", "stamped"), [("both", False), ("twist", False), ("stamped", True)])
def test_drive_sends_a_type_with_a_subscription(cmd_vel_type: str, stamped: bool, tmp_path: Path) -> None:
    job = plan(tmp_path, "--drive", "square", "--cmd-vel-type", cmd_vel_type)
    assert job.configs["drive"].stamped is stamped
    assert job.configs["physics"].commands.cmd_vel_type == cmd_vel_type


def test_tour_is_planned_in_the_scene_and_for_the_robot_of_the_run(tmp_path: Path) -> None:
    drive = plan(tmp_path, "--drive", "tour", "--robot", "skid_bot").configs["drive"]
    assert (drive.scene, drive.robot) == ("flat", "skid_bot")


def test_drive_without_a_matching_subscription_is_refused(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match="--stamped sends TwistStamped, which --cmd-vel-type twist does not receive"):
        plan(tmp_path, "--drive", "square", "--stamped", "--cmd-vel-type", "twist")


def test_help_begins_with_what_is_used_most_in_groups() -> None:
    parser = argparse.ArgumentParser()
    subparsers = parser.add_subparsers()
    run.add_parser(subparsers)
    text = subparsers.choices["run"].format_help()
    assert "[options]\n" in text.splitlines(keepends=True)[0] and " X " not in text
    titles = [line[:-1] for line in text.splitlines() if line.endswith(":") and not line.startswith(" ")]
    assert titles == [
        "options",
        "scene and robots",
        "page",
        "drive",
        "record",
        "time",
        "commands and grippers",
        "cameras",
        "compressed images",
        "rendering",
        "lockstep",
        "the run",
    ]
