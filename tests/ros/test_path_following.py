"""A path is recorded, followed by the images alone, and judged, by the nodes and topics that a robot has."""

from __future__ import annotations

import json
import os
import signal
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from support.scenes import write_room
from support.simulation import Launched, Listener, require

require("rclpy", "gibson_msgs", "gibson_path_following")

from geometry_msgs.msg import Twist  # noqa: E402
from nav_msgs.msg import Odometry  # noqa: E402
from rclpy.parameter import Parameter  # noqa: E402
from std_srvs.srv import Trigger  # noqa: E402

from gibson_path_following.nodes.path_evaluator import PathEvaluatorNode  # noqa: E402
from gibson_path_following.nodes.path_localiser import PathLocaliserNode  # noqa: E402
from gibson_path_following.nodes.path_policy import PathPolicyNode  # noqa: E402
from gibson_path_following.nodes.path_recorder import PathRecorderNode  # noqa: E402
from gibson_path_following.paths.path_folder import load_path  # noqa: E402
from support.clients import client_of  # noqa: E402

pytestmark = [pytest.mark.ros, pytest.mark.egl]
POSTS = "".join(
    f"  - {{name: post{k}, box: [0.05, {width}, {height}], pose: {{xyz: [1.9, {y}, {height / 2}]}}, color: [{red}, 0.1, {1 - red}]}}\n"
    for k, (y, width, height, red) in enumerate(
        [(-1.7, 0.2, 1.5, 0.1), (-1.2, 0.3, 0.8, 0.9), (-0.5, 0.2, 1.9, 0.3), (0.0, 0.4, 0.6, 0.8), (0.6, 0.1, 1.2, 0.1), (1.3, 0.4, 1.7, 1.0)]
    )
)  # fmt: skip
"""Things of different colours at the wall ahead, by which a place can be told from another."""
START = "starts: [{name: middle, xy: [0.0, 0.0]"


@pytest.fixture
def simulation(ros_domain: int, tmp_path: Path) -> Iterator[Launched]:
    room = write_room(tmp_path / "room", POSTS)
    scene = room / "scene.yaml"
    scene.write_text(scene.read_text().replace(START, START.replace("0.0, 0.0", "-1.2, -0.3")))
    # Half of real time: on a busy machine images and commands come late, and the robot would follow its path less closely.
    launched = Launched(
        "run", "--scene", str(room), "--robot", "gibson_bot", "--camera-rate", "10", "--camera-outputs", "rgb", "--rate", "0.5"
    )
    yield launched
    launched.stop()
    print("\n".join(launched.lines))


class Robot:
    """The nodes of a robot, in this process."""

    def __init__(self, listener: Listener, folder: Path) -> None:
        self.listener, self._folder = listener, folder
        self._nodes: list[Any] = []
        self.poses = listener.collect(Odometry, "ground_truth/odom")
        self.commands = listener.collect(Twist, "cmd_vel", 100)

    def start(self, kind: Any, **parameters: Any) -> Any:
        values = {"use_sim_time": True, "rate_hz": 10.0, **parameters}
        if kind is PathEvaluatorNode:
            del values["rate_hz"]
        node = kind(
            context=self.listener.node.context, use_global_arguments=False, parameter_overrides=[Parameter(n, value=v) for n, v in values.items()],
            cli_args=["--ros-args", "-r", "odom:=ground_truth/odom"],
        )  # fmt: skip
        self._nodes.append(node)
        self.listener._executor.add_node(node)
        return node

    def end(self, *nodes: Any) -> None:
        for node in nodes or list(self._nodes):
            self.listener._executor.remove_node(node)
            node.stop()
            node.destroy_node()
            self._nodes.remove(node)

    @property
    def x(self) -> float:
        return float(self.poses[-1].pose.pose.position.x) if self.poses else -9.0

    def call(self, service: str) -> Any:
        return client_of(self.listener).call(service, Trigger.Request())


def _record(robot: Robot, folder: Path) -> None:
    """Drives 1.6 m in a gentle bend while the recorder listens."""
    recorder = robot.start(PathRecorderNode, folder=str(folder))
    assert robot.call("path_recorder/start").success
    robot.listener.spin_until(lambda: recorder._recorder.nodes == 1, "a first image")
    publisher = robot.listener.node.create_publisher(Twist, "cmd_vel", 10)
    command = Twist()
    command.linear.x, command.angular.z = 0.4, 0.15

    def driven() -> bool:
        publisher.publish(command)
        return robot.x >= 0.3

    robot.listener.spin_until(driven, "1.5 m")
    publisher.publish(Twist())
    answer = robot.call("path_recorder/stop")
    assert answer.success, answer.message
    robot.listener.node.destroy_publisher(publisher)
    robot.end(recorder)


def _is_stop(command: Any) -> bool:
    return bool(command.linear.x == 0.0 == command.angular.z)


def test_a_recorded_path_is_followed_and_judged_and_the_robot_stops_while_it_sees_nothing(
    simulation: Launched, listener: Listener, tmp_path: Path
) -> None:
    simulation.wait_for_line("stop: Ctrl-C")
    robot, folder, results = Robot(listener, tmp_path), tmp_path / "path", tmp_path / "results.json"
    _record(robot, folder)
    path = load_path(folder)
    assert 7 <= len(path.nodes) <= 11 and path.length == pytest.approx(1.6, abs=0.25)

    client_of(listener).reset()
    listener.spin_until(lambda: robot.x < -1.1, "the start")
    evaluator = robot.start(PathEvaluatorNode, path=str(folder), file=str(results))
    policy = robot.start(PathPolicyNode, path=str(folder))
    listener.spin_until(lambda: robot.x > -0.8, "some of the path")
    render = simulation.node_pid("render")
    os.kill(render, signal.SIGSTOP)
    try:
        listener.spin_until(lambda: policy._state == "stale", "the watchdog")
        # A command that answers the last image may still be on its way.
        listener.spin_until(lambda: all(map(_is_stop, robot.commands[-3:])), "three stops in a row")
        robot.commands.clear()
        listener.spin_until(lambda: len(robot.commands) > 5, "further commands")
        assert all(map(_is_stop, robot.commands))
    finally:
        os.kill(render, signal.SIGCONT)
    listener.spin_until(lambda: evaluator.exit_code is not None, "the end of the path")
    outcome = json.loads(results.read_text())
    assert outcome["success"] and outcome["coverage"] == 1.0 and outcome["collisions"] == 0
    assert outcome["deviation_max"] < 0.3
    states = [state for _, state in outcome["states"]]
    assert states[0] == "following" and "stale" in states and states[-1] == "finished"

    robot.end(policy, evaluator)
    localiser = robot.start(PathLocaliserNode, path=str(folder))
    places: list[Any] = []
    localiser._publisher.publish = lambda stamp_ns, place, state: places.append(place)
    listener.spin_until(lambda: bool(places) and not places[-1].is_lost, "a place")
    assert places[-1].index == pytest.approx(len(path.nodes) - 1, abs=1.5), "it stands at the end"
    robot.end()
