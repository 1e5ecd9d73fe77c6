"""Both nodes running in real time in our flat, seen by a client that knows only standard messages."""

from __future__ import annotations

import math
import os
import pty
import signal
import subprocess
import sys
import termios
from collections.abc import Iterator
from pathlib import Path

import cv2
import numpy as np
import pytest

from support.simulation import Launched, Listener, require

require("rclpy", "gibson_msgs", "simulation_interfaces")

from diagnostic_msgs.msg import DiagnosticArray  # noqa: E402
from geometry_msgs.msg import Twist, TwistStamped  # noqa: E402
from nav_msgs.msg import Odometry  # noqa: E402
from rclpy.qos import DurabilityPolicy, QoSProfile, qos_profile_sensor_data  # noqa: E402
from rosbags.highlevel import AnyReader  # noqa: E402
from rosgraph_msgs.msg import Clock  # noqa: E402
from sensor_msgs.msg import CameraInfo, Image, JointState, LaserScan  # noqa: E402
from tf2_msgs.msg import TFMessage  # noqa: E402

from gibson_msgs.msg import Scene  # noqa: E402
from gibson_sim.ros.client.simulation_client import SimulationClient  # noqa: E402
from gibson_sim.ros.conversions import array_from_image  # noqa: E402
from gibson_sim.types import OUTPUTS  # noqa: E402
from support.clients import DEEP, client_of  # noqa: E402

pytestmark = pytest.mark.ros
LATCHED = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
CLIENT = Path(__file__).with_name("standard_client.py")


@pytest.fixture(scope="module")
def sim(ros_domain: int) -> Iterator[Launched]:
    launched = Launched("run", "--camera-rate", "10", "--camera-outputs", ",".join(OUTPUTS))
    launched.wait_for_line("triangles")
    yield launched
    assert launched.stop() == 0, "\n".join(launched.lines)


@pytest.fixture
def control(sim: Launched, listener: Listener) -> Iterator[SimulationClient]:
    """The services of the simulation; afterwards it plays again."""
    services = client_of(listener)
    yield services
    services.play()


def _stamps(messages: list[object]) -> list[int]:
    return [m.header.stamp.sec * 10**9 + m.header.stamp.nanosec for m in messages]  # type: ignore[attr-defined]


@pytest.mark.parametrize("kind", ["twist", "stamped"])
def test_standard_client_drives_one_metre_within_two_centimetres(sim: Launched, listener: Listener, kind: str) -> None:
    truth = listener.collect(Odometry, "ground_truth/odom")
    listener.spin_until(lambda: bool(truth), "ground truth")
    before = truth[-1].pose.pose.position
    client = subprocess.Popen([sys.executable, str(CLIENT), kind, "1.0"], stdout=subprocess.PIPE, text=True)
    listener.spin_until(lambda: client.poll() is not None, "end of the client")
    after = truth[-1].pose.pose.position
    said = float(client.communicate()[0].splitlines()[-1])  # Fast DDS may have said something before
    assert math.hypot(after.x - before.x, after.y - before.y) == pytest.approx(1.0, abs=0.02)
    assert said == pytest.approx(1.0, abs=0.02)


def test_images_carry_the_stamp_of_an_odometry_and_of_their_camera_info(sim: Launched, listener: Listener) -> None:
    # Long queues on this side: a machine that stalls for a moment must not lose what was sent.
    rgb = listener.collect(Image, "camera/image_raw", 30)
    depth = listener.collect(Image, "camera/depth/image_raw", 30)
    info = listener.collect(CameraInfo, "camera/camera_info", 100)
    odometry = listener.collect(Odometry, "odom", 300)
    topics = (rgb, depth, info, odometry)

    def common() -> tuple[int, int]:
        """First and last stamp at which every topic has a message: they arrive in any order."""
        return max(_stamps(m)[0] for m in topics), min(_stamps(m)[-1] for m in topics)

    def stamps(messages: list[object]) -> set[int]:
        first, last = common()
        return {s for s in _stamps(messages) if first <= s <= last}

    listener.spin_until(lambda: all(topics) and len(stamps(rgb)) >= 8, "eight images")
    assert stamps(rgb) <= stamps(odometry)
    assert stamps(rgb) == stamps(info)
    assert stamps(rgb) == stamps(depth)
    assert all(a < b for a, b in zip(_stamps(rgb), _stamps(rgb)[1:], strict=False))
    assert {m.header.frame_id for m in rgb + depth + info} == {"camera_optical_frame"}
    assert (rgb[0].encoding, depth[0].encoding) == ("rgb8", "32FC1")
    assert len(rgb[0].data) == 640 * 480 * 3


def test_label_images_hold_numbers_that_the_scene_names(sim: Launched, listener: Listener) -> None:
    scenes = listener.collect(Scene, "scene", LATCHED)
    semantic = listener.collect(Image, "camera/semantic/image_raw", qos_profile_sensor_data)
    instance = listener.collect(Image, "camera/instance/image_raw", qos_profile_sensor_data)
    normal = listener.collect(Image, "camera/normal/image_raw", qos_profile_sensor_data)
    listener.spin_until(lambda: bool(scenes and semantic and instance and normal), "labels, normals and the scene")
    classes = {scenes[0].semantic_classes[i] for i in np.unique(array_from_image(semantic[0]))}
    assert {"wall", "floor"} <= classes
    instances = {scenes[0].instances[i] for i in np.unique(array_from_image(instance[0]))}
    assert {"walls", "floors"} <= instances
    lengths = np.linalg.norm(array_from_image(normal[0]), axis=2)
    assert np.allclose(lengths[lengths > 0], 1.0, atol=1e-3)
    assert {m.header.frame_id for m in (semantic[0], instance[0], normal[0])} == {"camera_optical_frame"}


def test_late_joiner_gets_the_static_transforms(sim: Launched, listener: Listener) -> None:
    static = listener.collect(TFMessage, "/tf_static", LATCHED)
    listener.spin_until(lambda: bool(static), "static transforms")
    children = {t.child_frame_id for t in static[0].transforms}
    assert {"base_link", "base_scan", "camera_optical_frame"} <= children


def test_each_frame_has_one_parent_and_odom_is_the_root(sim: Launched, listener: Listener) -> None:
    static = listener.collect(TFMessage, "/tf_static", LATCHED)
    moving = listener.collect(TFMessage, "/tf", 100)
    listener.spin_until(lambda: bool(static) and len(moving) > 3, "transforms")
    parents = {t.child_frame_id: t.header.frame_id for t in [*static[0].transforms, *moving[-1].transforms]}
    assert len(parents) == len(static[0].transforms) + len(moving[-1].transforms)
    assert set(parents.values()) - set(parents) == {"odom"}


def test_scan_has_a_beam_a_degree_from_straight_ahead_and_no_nan(sim: Launched, listener: Listener) -> None:
    scans = listener.collect(LaserScan, "scan", qos_profile_sensor_data)
    listener.spin_until(lambda: bool(scans), "a scan")
    ranges = np.array(scans[0].ranges)
    assert (len(ranges), scans[0].angle_min) == (360, 0.0)
    assert scans[0].angle_increment == pytest.approx(math.radians(1.0))
    assert not np.isnan(ranges).any()
    assert np.isfinite(ranges).mean() > 0.9, "inside a flat nearly every beam meets a wall"


def test_joint_states_name_both_wheels(sim: Launched, listener: Listener) -> None:
    joints = listener.collect(JointState, "joint_states")
    listener.spin_until(lambda: bool(joints), "joint states")
    assert {"wheel_left_joint", "wheel_right_joint"} <= set(joints[0].name)


@pytest.mark.parametrize("message_type", [Twist, TwistStamped])
@pytest.mark.parametrize("bad", [math.nan, math.inf])
def test_command_that_is_not_a_number_is_refused_and_the_robot_stays(
    sim: Launched, other_listener: Listener, message_type: type, bad: float
) -> None:
    listener = other_listener
    odometry = listener.collect(Odometry, "odom")
    publisher = listener.node.create_publisher(message_type, "cmd_vel", 1)
    listener.spin_until(lambda: publisher.get_subscription_count() > 0 and bool(odometry), "a simulation that subscribes")
    lines = len(sim.lines)
    message = message_type()
    (message.twist if message_type is TwistStamped else message).linear.x = bad

    def refused() -> bool:
        # Again and again: the first may be lost while the peers still match, and the warning comes once a second.
        publisher.publish(message)
        return any("holds a NaN or an infinity; it is ignored" in line for line in sim.lines[lines:])

    listener.spin_until(refused, "a warning")
    before, count = odometry[-1].pose.pose.position, len(odometry)
    listener.spin_until(lambda: len(odometry) > count + 20, "twenty odometries more")
    after = odometry[-1].pose.pose.position
    assert math.hypot(after.x - before.x, after.y - before.y) < 0.001


def test_covariance_of_odometry_is_that_of_this_robot(sim: Launched, listener: Listener) -> None:
    odometry = listener.collect(Odometry, "odom")
    listener.spin_until(lambda: bool(odometry), "odometry")
    pose, twist = (np.array(part.covariance).reshape(6, 6) for part in (odometry[-1].pose, odometry[-1].twist))
    for covariance in (pose, twist):
        assert (covariance.diagonal()[[0, 1, 5]] > 0.0).all()
        assert (covariance.diagonal()[[2, 3, 4]] == 1e6).all()
    # gibson_bot measures exactly: the yaw rate of one at rest is known to 1 mrad/s, not to the 10 mrad/s of any robot.
    assert twist[5, 5] < 1e-5


def test_robot_stops_when_commands_cease(sim: Launched, listener: Listener, control: SimulationClient) -> None:
    odometry = listener.collect(Odometry, "odom", DEEP)
    publisher = listener.node.create_publisher(Twist, "cmd_vel", 1)
    listener.spin_until(lambda: publisher.get_subscription_count() > 0 and bool(odometry), "a simulation that subscribes")
    turn = Twist()
    turn.angular.z = 0.5
    # Steps, not wall time, lie between the last command and the stop.
    control.pause()

    def turning() -> bool:
        if odometry[-1].twist.twist.angular.z > 0.4:
            return True
        publisher.publish(turn)
        control.step(12)
        return False

    listener.spin_until(turning, "a turning robot")
    reports = listener.collect(DiagnosticArray, "/diagnostics")
    listener.spin_until(lambda: len(reports) > 2, "rest: all commands have arrived")
    last = _stamps(odometry)[-1]
    control.step(240)
    listener.spin_until(lambda: _stamps(odometry)[-1] - last >= 0.98e9, "a second")
    turns = [m.twist.twist.angular.z for m in odometry if _stamps([m])[0] - last >= 0.9e9]
    # 0.5 s until the command is stale, then 0.5 rad/s at 4 rad/s^2 in an eighth of a second; a little for settling.
    assert max(map(abs, turns)) < 0.01


def test_second_simulation_in_the_domain_is_refused(sim: Launched) -> None:
    second = Launched("run")
    assert second.wait() == 3
    assert "a simulation runs in ROS domain" in second.lines[-1]
    assert sim.process.poll() is None


def test_physics_node_started_by_hand_refuses_too_and_disturbs_nothing(sim: Launched, listener: Listener) -> None:
    reloads = sum("triangles" in line for line in sim.lines)
    done = subprocess.run(
        [sys.executable, "-m", "gibson_sim.ros.nodes.physics_node"], capture_output=True, text=True, check=False
    )
    assert done.returncode == 1
    assert sum("triangles" in line for line in sim.lines) == reloads, "the renderer took up another scene"
    assert "a simulation runs in ROS domain" in done.stderr
    scenes = listener.collect(Scene, "scene", LATCHED)
    listener.spin_until(lambda: bool(scenes), "the scene")
    assert len(scenes[0].cameras[0].outputs) == len(OUTPUTS), "it must not replace the scene of the one that runs"


def test_snapshot_writes_colour_and_depth_of_every_camera(sim: Launched, tmp_path: Path) -> None:
    taken = Launched("snapshot", str(tmp_path / "shots"))
    assert taken.wait() == 0, "\n".join(taken.lines)
    rgb = cv2.imread(str(tmp_path / "shots" / "camera_rgb.png"))
    depth = cv2.imread(str(tmp_path / "shots" / "camera_depth.png"), cv2.IMREAD_UNCHANGED)
    assert {p.stem for p in (tmp_path / "shots").iterdir()} == {f"camera_{output}" for output in OUTPUTS}
    assert rgb.shape == (480, 640, 3)
    assert rgb.std() > 5
    assert (depth.shape, depth.dtype) == ((480, 640), np.uint16)
    assert 100 < np.median(depth) < 10_000, "millimetres to the walls of a flat"


def test_keyboard_turns_the_robot_and_gives_the_terminal_back(sim: Launched, listener: Listener) -> None:
    odometry = listener.collect(Odometry, "odom", 50)
    master, slave = pty.openpty()
    before = termios.tcgetattr(slave)
    command = [sys.executable, "-m", "gibson_sim.cli.main", "drive", "keyboard"]
    with subprocess.Popen(command, stdin=slave, stdout=slave, stderr=slave) as driver:

        def turning() -> bool:
            os.write(master, b"a")  # again and again: keys typed before the drive is ready are thrown away
            return bool(odometry) and odometry[-1].twist.twist.angular.z > 0.5

        listener.spin_until(turning, "a turn to the left")
        os.write(master, b"s")
        listener.spin_until(lambda: abs(odometry[-1].twist.twist.angular.z) < 0.01, "a stop")
        driver.send_signal(signal.SIGINT)
        assert driver.wait() == 0
    assert termios.tcgetattr(slave) == before
    os.close(master)
    os.close(slave)


def test_keyboard_without_a_terminal_says_what_to_do(sim: Launched) -> None:
    command = [sys.executable, "-m", "gibson_sim.cli.main", "drive", "keyboard"]
    done = subprocess.run(command, stdin=subprocess.DEVNULL, capture_output=True, text=True, check=False)
    assert done.returncode == 1
    assert "needs a terminal on standard input" in done.stderr


def test_record_beside_a_running_simulation_ends_after_its_duration(sim: Launched, tmp_path: Path) -> None:
    recorder = Launched("record", str(tmp_path / "bag"), "--topics", "odom,clock,camera/camera_info", "--duration", "5")
    assert recorder.wait() == 0, "\n".join(recorder.lines)
    with AnyReader([tmp_path / "bag"]) as reader:
        counts = {c.topic: c.msgcount for c in reader.connections}
        seconds = reader.duration / 1e9
    assert set(counts) == {"/odom", "/clock", "/camera/camera_info"}
    assert 0 < counts["/odom"] <= 310, "five seconds at 60 Hz, less what passed until the topic was found"
    assert 4.5 < seconds < 5.1


@pytest.mark.parametrize("name", ["physics", "render"])
def test_sigusr1_prints_the_stacks_of_a_node_that_goes_on(sim: Launched, listener: Listener, name: str) -> None:
    lines = len(sim.lines)
    os.kill(sim.node_pid(name), signal.SIGUSR1)
    assert sim.wait_for_line("most recent call first", after=lines).startswith(name)
    clocks = listener.collect(Clock, "/clock", qos_profile_sensor_data)
    listener.spin_until(lambda: len(clocks) > 1, "time that goes on")
    assert sim.process.poll() is None


def test_render_node_that_is_killed_comes_back_and_images_go_on(sim: Launched, listener: Listener) -> None:
    images = listener.collect(Image, "camera/image_raw", qos_profile_sensor_data)
    listener.spin_until(lambda: len(images) > 1, "images")
    lines = len(sim.lines)
    os.kill(sim.node_pid("render"), signal.SIGKILL)
    sim.wait_for_line("restarting it", after=lines)
    sim.wait_for_line("triangles", after=lines)
    count = len(images)
    listener.spin_until(lambda: len(images) > count + 3, "images after the restart")
