"""``topic pub`` does not exist: the error names the alternative."""

from __future__ import annotations

import pytest

from gibson_sim.cli.commands import ros_tools
from gibson_sim.cli.parser import Parser


@pytest.mark.parametrize(
    "words", [(), ("--once", "/cmd_vel", "geometry_msgs/msg/Twist", "{linear: {x: 0.1}}", "-r", "10"), ("--help",)]
)
def test_pub_points_to_drive_whatever_follows(words: tuple[str, ...], capsys: pytest.CaptureFixture[str]) -> None:
    parser = Parser()
    ros_tools.add_parser(parser.add_subparsers())
    with pytest.raises(SystemExit) as end:
        parser.parse_args(["topic", "pub", *words])
    assert end.value.code == 2 and "`gibson-sim drive forward`" in capsys.readouterr().err
