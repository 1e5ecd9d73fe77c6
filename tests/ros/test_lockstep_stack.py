"""A navigation stack without support for lockstep repeats its drive, to the bit, from the same start."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from support.scenes import write_room
from support.simulation import Launched, Listener, require

require("rclpy", "gibson_msgs", "simulation_interfaces", "gibson_examples")

from geometry_msgs.msg import PoseStamped, PoseWithCovarianceStamped  # noqa: E402
from std_msgs.msg import String  # noqa: E402

from gibson_msgs.msg import TickDigest  # noqa: E402
from gibson_sim.cli.environment import node_environment  # noqa: E402
from support.clients import LATCHED, client_of  # noqa: E402
from support.lockstep import ALL_OF_IT, Digests  # noqa: E402

pytestmark = pytest.mark.ros
RULES = "nav=cmd_vel every 0.05 from goal_pose; localise=/pose after scan from initialpose"
STEPS = 3 * 240
"""Three seconds."""


class Stack(Launched):
    """The example, as a user starts it."""

    def __init__(self) -> None:
        self._start([sys.executable, "-u", "-m", "gibson_examples.navigate"], node_environment())


@pytest.fixture
def launched(ros_domain: int, tmp_path: Path) -> Iterator[list[Launched]]:
    room, robot = str(write_room(tmp_path / "room")), "gibson_bot_real"
    options = ("--no-render", "--lockstep", "--rate", "max", "--digests", "--start-paused", "--participants", RULES)
    found = [Launched("run", "--scene", room, "--robot", robot, *options), Stack()]
    yield found
    for one in reversed(found):
        one.stop()
        print("\n".join(one.lines))


def test_a_drive_after_a_reset_repeats_the_first_one_to_the_bit(launched: list[Launched], listener: Listener) -> None:
    digests: Digests = {}

    def note(msg: Any) -> None:
        for topic, digest in zip(msg.topics, msg.digests, strict=True):
            digests[msg.epoch, msg.step, topic] = int(digest)

    node, control = listener.node, client_of(listener)
    node.create_subscription(TickDigest, "tick_digest", note, ALL_OF_IT)
    status = listener.collect(String, "navigation/status", LATCHED)
    initial = node.create_publisher(PoseWithCovarianceStamped, "initialpose", 1)
    goal = node.create_publisher(PoseStamped, "goal_pose", 1)
    drives = []
    for epoch in range(2):
        if epoch:
            control.pause()
            control.reset()
        listener.spin_until(lambda: all(p.get_subscription_count() == 2 for p in (initial, goal)), "the stack and the gate")
        where, there = PoseWithCovarianceStamped(), PoseStamped()
        where.pose.pose.orientation.w = there.pose.orientation.w = 1.0
        there.pose.position.x = 1.2
        there.pose.position.y = 0.8
        initial.publish(where)
        goal.publish(there)
        assert initial.wait_for_all_acked() and goal.wait_for_all_acked()
        control.play()
        listener.spin_until(lambda e=epoch: any(key[:2] == (e, STEPS) for key in digests), "three seconds")
        drives.append({(step, topic): digest for (e, step, topic), digest in digests.items() if e == epoch and step <= STEPS})
    assert drives[0].keys() == drives[1].keys()
    differing = sorted(key for key, digest in drives[0].items() if drives[1][key] != digest)
    assert differing == []
    scans = [digest for (_, topic), digest in drives[0].items() if topic.endswith("scan")]
    assert len(scans) == len(set(scans)) == 30, "ten a second, each from elsewhere"
    assert [msg.data.split()[0] for msg in status][-1] == "driving"
