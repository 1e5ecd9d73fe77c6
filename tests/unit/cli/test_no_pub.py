"""``topic pub``, which there is not."""

from __future__ import annotations

import argparse

import pytest

from gibson_sim.cli.commands import ros_tools
from gibson_sim.errors import GibsonSimError


@pytest.mark.parametrize("words", [(), ("--once", "/cmd_vel", "geometry_msgs/msg/Twist", "{linear: {x: 0.1}}", "-r", "10")])
def test_pub_points_to_drive_whatever_follows(words: tuple[str, ...]) -> None:
    parser = argparse.ArgumentParser()
    ros_tools.add_parser(parser.add_subparsers())
    args = parser.parse_args(["topic", "pub", *words])
    with pytest.raises(GibsonSimError, match="`gibson-sim drive forward`"):
        args.run(args)
