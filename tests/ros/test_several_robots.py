"""Two robots in one simulation: topics, frames and commands of each are its own, and so are its pictures."""

from __future__ import annotations

import math
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from support.simulation import Launched, Listener, require

require("rclpy", "gibson_msgs", "simulation_interfaces")

from nav_msgs.msg import Odometry  # noqa: E402
from rclpy.qos import DurabilityPolicy, QoSProfile  # noqa: E402
from sensor_msgs.msg import CameraInfo, Image, Imu, JointState, LaserScan  # noqa: E402
from std_msgs.msg import String  # noqa: E402
from tf2_msgs.msg import TFMessage  # noqa: E402

from gibson_sim.ros.conversions import array_from_image  # noqa: E402
from support.clients import DEEP, LATCHED, LaunchedNode, drive_until, stamp_ns, step_of  # noqa: E402
from support.robots import write_gibson_bot  # noqa: E402

pytestmark = pytest.mark.ros
ROBOTS = ("left", "right")
STARTS = {"left": (1.0, 4.7), "right": (6.4, 3.3)}
"""In the hall and in the kitchen of our flat: they do not see each other."""
TF_STATIC = QoSProfile(depth=100, durability=DurabilityPolicy.TRANSIENT_LOCAL)
"""As in tf2: each robot latches its own message, and a queue of one would keep only one of them."""
CAMERA_HZ = 10.0
CAMERA_STEPS = 24
OF_A_ROBOT = {
    "odom": Odometry,
    "ground_truth/odom": Odometry,
    "joint_states": JointState,
    "scan": LaserScan,
    "imu": Imu,
}


@pytest.fixture(scope="module")
def robot(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_gibson_bot(tmp_path_factory.mktemp("robot"), camera={"width": 160, "height": 120, "rate_hz": CAMERA_HZ})


@pytest.fixture(scope="module", params=["namespaced", "prefixed"])
def sim(ros_domain: int, robot: Path, request: pytest.FixtureRequest) -> Iterator[Launched]:
    robots = ",".join(f"{name}={robot}" for name in ROBOTS)
    start = ";".join(f"{x},{y},0" for x, y in STARTS.values())
    launched = Launched("run", "--no-render", "--robot", robots, "--start", start, "--robot-tf", request.param)
    launched.wait_for_line("collision shapes")
    yield launched
    assert launched.stop() == 0, "\n".join(launched.lines)


namespaced = pytest.mark.parametrize("sim", ["namespaced"], indirect=True, scope="module")
prefixed = pytest.mark.parametrize("sim", ["prefixed"], indirect=True, scope="module")
each_robot = pytest.mark.parametrize("name", ROBOTS)


@pytest.fixture(scope="module")
def renderers(sim: Launched) -> Iterator[dict[str, LaunchedNode]]:
    """One render node for each robot's camera."""
    nodes = {name: LaunchedNode("render", "-r", f"__node:=render_{name}", "-p", f"cameras:={name}/camera") for name in ROBOTS}
    for node in nodes.values():
        node.wait_for_line("triangles")
    yield nodes
    for node in nodes.values():
        assert node.stop() == 0, "\n".join(node.lines)


def _publishers(listener: Listener, topic: str) -> list[str]:
    """Returns the nodes that publish a topic."""
    return [info.node_name for info in listener.node.get_publishers_info_by_topic(topic)]


def _with_publishers(listener: Listener) -> set[str]:
    """Returns the topics that have publishers."""
    return {name for name, _ in listener.node.get_topic_names_and_types() if listener.node.count_publishers(name)}


@namespaced
def test_every_topic_of_a_robot_is_in_its_namespace(sim: Launched, listener: Listener) -> None:
    names = (*OF_A_ROBOT, "tf", "tf_static", "robot_description")
    wanted = {f"/{robot}/{name}" for robot in ROBOTS for name in names}
    listener.spin_until(lambda: wanted <= _with_publishers(listener), "topics of both robots")
    assert not {f"/{name}" for name in names} & _with_publishers(listener)


def test_commands_of_a_robot_are_in_its_namespace(sim: Launched, listener: Listener) -> None:
    both = ["geometry_msgs/msg/Twist", "geometry_msgs/msg/TwistStamped"]

    def types() -> list[list[str]]:
        known = dict(listener.node.get_topic_names_and_types())
        return [sorted(known.get(f"/{robot}/cmd_vel", [])) for robot in ROBOTS]

    listener.spin_until(lambda: types() == [both, both], "cmd_vel of both robots, of both types")
    assert "/cmd_vel" not in dict(listener.node.get_topic_names_and_types())


@namespaced
@each_robot
def test_transforms_of_a_namespaced_robot_are_a_tree_of_its_own(sim: Launched, listener: Listener, name: str) -> None:
    moving = listener.collect(TFMessage, f"{name}/tf", DEEP)
    static = listener.collect(TFMessage, f"{name}/tf_static", LATCHED)
    listener.spin_until(lambda: bool(moving and static), "transforms")
    transforms = [*moving[0].transforms, *static[0].transforms]
    parents = {t.child_frame_id: t.header.frame_id for t in transforms}
    assert len(parents) == len(transforms), "each frame has one parent"
    assert parents["base_footprint"] == "odom"
    assert {"base_link", "base_scan", "camera_optical_frame"} <= set(parents)
    assert not [frame for frame in parents if "/" in frame]


@namespaced
@each_robot
def test_messages_of_a_namespaced_robot_are_in_frames_without_prefix(sim: Launched, listener: Listener, name: str) -> None:
    got = {topic: listener.collect(kind, f"{name}/{topic}") for topic, kind in OF_A_ROBOT.items()}
    listener.spin_until(lambda: all(got.values()), f"all of {name}")
    frames = {topic: messages[0].header.frame_id for topic, messages in got.items()}
    assert frames == {"odom": "odom", "ground_truth/odom": "map", "joint_states": "", "scan": "base_scan", "imu": "base_link"}


@each_robot
def test_robot_starts_at_its_requested_pose(sim: Launched, listener: Listener, name: str) -> None:
    truth = listener.collect(Odometry, f"{name}/ground_truth/odom")
    listener.spin_until(lambda: bool(truth), "ground truth")
    place = truth[0].pose.pose.position
    assert (place.x, place.y) == (pytest.approx(STARTS[name][0], abs=0.01), pytest.approx(STARTS[name][1], abs=0.01))


def test_both_robots_describe_themselves(sim: Launched, listener: Listener) -> None:
    got = [listener.collect(String, f"{name}/robot_description", LATCHED) for name in ROBOTS]
    listener.spin_until(lambda: all(got), "descriptions")
    assert all("<robot" in messages[0].data for messages in got)


def _yaw(message: Odometry) -> float:
    q = message.pose.pose.orientation
    return 2 * math.atan2(q.z, q.w)


def _rests(message: Odometry) -> bool:
    """Returns whether a robot has stopped after its last command."""
    twist = message.twist.twist
    return abs(twist.angular.z) < 1e-3 and abs(twist.linear.x) < 1e-3


def _turned(a: Odometry, b: Odometry) -> float:
    return abs(math.remainder(_yaw(b) - _yaw(a), math.tau))


@pytest.mark.parametrize(("told", "other"), [("left", "right"), ("right", "left")])
def test_command_moves_the_robot_that_it_is_for_alone(sim: Launched, listener: Listener, told: str, other: str) -> None:
    truth = {name: listener.collect(Odometry, f"{name}/ground_truth/odom", DEEP) for name in ROBOTS}
    listener.spin_until(lambda: all(m and _rests(m[-1]) for m in truth.values()), "both robots at rest")
    first = {name: messages[-1] for name, messages in truth.items()}
    drive_until(listener, f"{told}/cmd_vel", 0.0, 0.8, lambda: _turned(first[told], truth[told][-1]) > 0.6, "a turned robot")
    assert _turned(first[other], truth[other][-1]) < 0.001
    before, after = first[other].pose.pose.position, truth[other][-1].pose.pose.position
    assert math.hypot(after.x - before.x, after.y - before.y) < 0.001


@namespaced
def test_every_camera_is_drawn_by_its_own_node(renderers: dict[str, LaunchedNode], listener: Listener) -> None:
    for name in ROBOTS:
        for topic in ("image_raw", "camera_info", "depth/image_raw", "depth/camera_info"):
            full = f"/{name}/camera/{topic}"
            # A publisher is known a moment before the name of its node.
            listener.spin_until(lambda full=full, name=name: _publishers(listener, full) == [f"render_{name}"], full)  # type: ignore[misc]
    assert not [topic for topic in _with_publishers(listener) if topic.startswith("/camera")]


@namespaced
@each_robot
def test_image_has_its_robots_frame_and_a_stamp_of_its_odometry(
    renderers: dict[str, LaunchedNode], listener: Listener, name: str
) -> None:
    images = listener.collect(Image, f"{name}/camera/image_raw", DEEP)
    infos = listener.collect(CameraInfo, f"{name}/camera/camera_info", DEEP)
    odometry = listener.collect(Odometry, f"{name}/odom", DEEP)
    listener.spin_until(lambda: bool(odometry), "odometry")
    first = stamp_ns(odometry[0])
    listener.spin_until(lambda: any(stamp_ns(m) > first for m in images) and any(stamp_ns(m) > first for m in infos), "an image")
    image = next(m for m in images if stamp_ns(m) > first)
    listener.spin_until(lambda: stamp_ns(odometry[-1]) >= stamp_ns(image), "odometry")
    assert stamp_ns(image) in {stamp_ns(m) for m in odometry}
    assert step_of(stamp_ns(image)) % CAMERA_STEPS == 0
    assert image.header.frame_id == infos[0].header.frame_id == "camera_optical_frame"


@namespaced
def test_image_changes_with_the_robot_that_turns_alone(renderers: dict[str, LaunchedNode], listener: Listener) -> None:
    images = {name: listener.collect(Image, f"{name}/camera/image_raw", DEEP) for name in ROBOTS}
    truth = listener.collect(Odometry, "left/ground_truth/odom", DEEP)
    listener.spin_until(lambda: bool(truth) and all(images.values()), "images of both")
    start, before = truth[-1], {name: _pixels(messages[-1]) for name, messages in images.items()}
    drive_until(listener, "left/cmd_vel", 0.0, 0.8, lambda: _turned(start, truth[-1]) > 0.6, "a turned robot")
    now = stamp_ns(truth[-1])
    listener.spin_until(lambda: all(stamp_ns(messages[-1]) > now for messages in images.values()), "images after the turn")
    changed = {name: np.abs(_pixels(messages[-1]) - before[name]) for name, messages in images.items()}
    assert changed["left"].mean() > 5.0, "another view"
    assert changed["right"].mean() < 0.5, "the same view"


def _pixels(message: Any) -> NDArray[np.float64]:
    return array_from_image(message).astype(np.float64)


@prefixed
def test_prefixed_robots_share_one_tree_of_frames_with_prefixes(sim: Launched, listener: Listener) -> None:
    moving = listener.collect(TFMessage, "/tf", DEEP)
    static = listener.collect(TFMessage, "/tf_static", TF_STATIC)
    parents: dict[str, set[str]] = {}

    def complete() -> bool:
        for message in (*moving, *static):
            for t in message.transforms:
                parents.setdefault(t.child_frame_id, set()).add(t.header.frame_id)
        return {f"{name}/{frame}" for name in ROBOTS for frame in ("base_footprint", "base_scan")} <= set(parents)

    listener.spin_until(complete, "transforms of both robots")
    assert all(len(found) == 1 for found in parents.values()), "each frame has one parent"
    for name in ROBOTS:
        assert parents[f"{name}/base_footprint"] == {f"{name}/odom"}
    assert all(child.split("/")[0] == parent.split("/")[0] for child, (parent,) in parents.items())
    assert not [frame for frame in parents if not frame.startswith(("left/", "right/"))]


@prefixed
def test_late_joiner_gets_the_fixed_transforms_of_both_prefixed_robots(sim: Launched, listener: Listener) -> None:
    static = listener.collect(TFMessage, "/tf_static", TF_STATIC)
    wanted = {f"{name}/{frame}" for name in ROBOTS for frame in ("base_link", "base_scan", "camera_optical_frame")}
    listener.spin_until(lambda: wanted <= {t.child_frame_id for m in static for t in m.transforms}, "fixed transforms of both")


@prefixed
@each_robot
def test_messages_of_a_prefixed_robot_are_in_frames_with_its_prefix(sim: Launched, listener: Listener, name: str) -> None:
    got = {topic: listener.collect(kind, f"{name}/{topic}") for topic, kind in OF_A_ROBOT.items()}
    listener.spin_until(lambda: all(got.values()), f"all of {name}")
    frames = {topic: messages[0].header.frame_id for topic, messages in got.items()}
    own = {"odom": f"{name}/odom", "scan": f"{name}/base_scan", "imu": f"{name}/base_link"}
    assert frames == {"ground_truth/odom": "map", "joint_states": "", **own}
    assert got["odom"][0].child_frame_id == got["ground_truth/odom"][0].child_frame_id == f"{name}/base_footprint"


@prefixed
def test_prefixed_robots_have_no_tf_topics_of_their_own(sim: Launched, listener: Listener) -> None:
    wanted = {"/tf", "/tf_static", *(f"/{name}/odom" for name in ROBOTS)}
    listener.spin_until(lambda: wanted <= _with_publishers(listener), "topics of both robots")
    assert not {f"/{name}/{topic}" for name in ROBOTS for topic in ("tf", "tf_static")} & _with_publishers(listener)
