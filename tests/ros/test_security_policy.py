"""The rights that config/sros2_policy.xml gives our nodes, beside what the nodes of a running simulation have."""

from __future__ import annotations

from collections.abc import Iterator
from fnmatch import fnmatchcase
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import pytest

from support.simulation import Launched, Listener, require, wait_until

require("rclpy", "gibson_msgs", "pybullet")

from rclpy.serialization import serialize_message  # noqa: E402
from std_msgs.msg import String  # noqa: E402

from gibson_sim.bags.writer import BagWriter  # noqa: E402

OUTPUTS = "rgb,depth,semantic,instance,normal,normal_world,position,flow"
RIGHTS = ("publish", "subscribe", "reply", "request")
NODES = ("physics", "render", "drive", "record", "snapshot", "task", "play", "top", "web", "foxglove")
"""Enclaves whose rights are compared; ``physics_stamped_commands`` and ``_record_intake`` are in processes of the first and the fourth."""
_ACTION_SERVICES = ("cancel_goal", "get_result", "send_goal")
_ACTION_TOPICS = ("feedback", "status")
ONLY_SOMETIMES = {
    ("task", "subscribe", "/joint_states"),  # tasks with an arm
    ("task", "subscribe", "/grasp_state"),
    ("drive", "subscribe", "/run_info"),  # a tour without --scene and --robot
    ("drive", "request", "/get_current_world"),
    ("drive", "request", "/get_simulation_state"),  # if no pose arrives
    ("web", "publish", "/cmd_vel"),  # a page drives
    ("web", "publish", "/goal_pose"),
    ("web", "publish", "/initialpose"),
    ("web", "publish", "/joint_command"),  # a page moves a joint
    ("foxglove", "request", "/*"),  # its client asks
}
"""Rights that the simulation of this test does not need."""


def _rights(policy: ElementTree.Element, node: str) -> set[tuple[str, str]]:
    """Returns the rights of a node's enclave: (right, pattern of topics or services)."""
    found = set()
    for profile in policy.findall(f"./enclaves/enclave[@path='/gibson_sim/{node}']/profiles/profile"):
        for rule in profile:
            for expression in rule:
                name = "/" + (expression.text or "").replace("~", profile.attrib["node"])
                for right in rule.attrib:
                    if right == "execute":
                        found |= {("reply", f"{name}/_action/{part}") for part in _ACTION_SERVICES}
                        found |= {("publish", f"{name}/_action/{part}") for part in _ACTION_TOPICS}
                    else:
                        found.add((right, name))
    return found


def _uses(listener: Listener, process: str) -> set[tuple[str, str]]:
    """Returns what the nodes of a process have."""
    graph: Any = listener.node
    found = set()
    own = "bag_player" if process == "play" else process
    for name in (own, "physics_stamped_commands" if process == "physics" else f"_{process}_intake"):
        if name in graph.get_node_names():
            looks = (
                graph.get_publisher_names_and_types_by_node,
                graph.get_subscriber_names_and_types_by_node,
                graph.get_service_names_and_types_by_node,
                graph.get_client_names_and_types_by_node,
            )
            found |= {(right, topic) for right, look in zip(RIGHTS, looks, strict=True) for topic, _ in look(name, "/")}
    return found


def _bag(folder: Path) -> Path:
    """Writes a bag with one text."""
    with BagWriter(folder, reserve_bytes=0) as writer:
        writer.add_topic("/text", "std_msgs/msg/String")
        writer.write("/text", serialize_message(String(data="hello")), 1, 1)
    return folder


@pytest.fixture(scope="module")
def simulation(ros_domain: int, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Path]:
    """A paused simulation with every node of ours beside it."""
    folder = tmp_path_factory.mktemp("policy")
    run = ("run", "--robot", "arm_bot", "--start-paused", "--lockstep", "--digests", "--camera-outputs", OUTPUTS)
    launched = [Launched(*run, "--drive", "spin", "--record", str(folder / "bag"))]
    try:
        launched[0].wait_for_line("reach: ")
        launched += [
            Launched("snapshot", str(folder / "pictures")),
            Launched("top"),
            Launched("web", "--port", "0"),
            Launched("web", "--foxglove", "--port", "0"),
            Launched("task", "point-goal", "--scene", "flat"),
            Launched("bag", "play", str(_bag(folder / "played")), "--wait-for", "/text:9"),
        ]
        yield folder
    finally:
        for process in reversed(launched):
            process.stop()


def test_policy_gives_each_node_what_it_uses_and_nothing_else(simulation: Path, listener: Listener, root: Path) -> None:
    policy = ElementTree.parse(root / "config" / "sros2_policy.xml").getroot()

    def differences() -> list[tuple[str, str, str]]:
        found = []
        for node in NODES:
            rights, uses = _rights(policy, node), _uses(listener, node)
            lacking = {use for use in uses if not any(right == use[0] and fnmatchcase(use[1], name) for right, name in rights)}
            unused = {
                right for right in rights if not any(right[0] == kind and fnmatchcase(name, right[1]) for kind, name in uses)
            }
            found += [(node, *use) for use in lacking] + [
                (node, *right) for right in unused if (node, *right) not in ONLY_SOMETIMES
            ]
        return found

    last: list[tuple[str, str, str]] = []

    def agree() -> bool:
        last[:] = differences()
        return not last

    try:
        wait_until(agree, "agreement of rights and use")
    except AssertionError as error:
        raise AssertionError(f"rights and use differ: {last}") from error
