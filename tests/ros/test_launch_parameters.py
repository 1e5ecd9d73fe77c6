"""ROS itself reads what the launch file hands to a node."""

from __future__ import annotations

from pathlib import Path

import pytest

from support.simulation import require

require("rclpy")

import rclpy  # noqa: E402
from rclpy.context import Context  # noqa: E402
from rclpy.node import Node  # noqa: E402

from gibson_sim.cli.launching import plan  # noqa: E402

pytestmark = pytest.mark.ros


@pytest.mark.parametrize("namespace", ["", "sim"])
def test_an_argument_wins_over_every_section_of_a_parameter_file(tmp_path: Path, ros_domain: int, namespace: str) -> None:
    user, ours = tmp_path / "user.yaml", tmp_path / "ours.yaml"
    user.write_text(
        "/**: {ros__parameters: {seed: 1, map: 'off'}}\n"
        "physics: {ros__parameters: {seed: 2, rate: 2.0}}\n"
        "sim: {physics: {ros__parameters: {seed: 3, rate: 2.0}}}\n"
        "/**/physics: {ros__parameters: {seed: 4, clock_hz: 50}}\n"
    )
    given = plan({"params_file": str(user), "seed": "9", "start": "1,2,90", "namespace": namespace})
    ours.write_text(given.overriding(given.nodes[0]))
    context = Context()
    files = ["--params-file", str(user), "--params-file", str(ours)]
    rclpy.init(args=["--ros-args", "-r", f"__ns:=/{namespace}", *files], context=context, domain_id=ros_domain)
    node = Node("physics", context=context, automatically_declare_parameters_from_overrides=True)
    try:
        got = {name: node.get_parameter(name).value for name in ("seed", "map", "rate", "clock_hz", "start")}
    finally:
        node.destroy_node()
        context.try_shutdown()
    assert got == {"seed": 9, "map": "off", "rate": 2.0, "clock_hz": 50, "start": "1,2,90"}
