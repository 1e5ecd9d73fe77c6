"""Drives recorded as a robot's own computer would: standard messages, no ROS, a simulated robot in the place of a real one."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from types import TracebackType
from typing import Any

import numpy as np
from rosbags.rosbag2 import StoragePlugin, Writer
from rosbags.typesys import Stores, get_typestore

from gibson_sim.description.shapes import Shape
from gibson_sim.physics.world import PhysicsWorld
from gibson_sim.robots.path_tracking import ScriptedDrive
from gibson_sim.robots.spec import RobotSpec
from gibson_sim.scenes.spec import CollisionSpec, SceneSpec
from gibson_sim.sensors.suite import SensorSuite
from gibson_sim.types import Pose, VelocityCommand

NS = 1_000_000_000


class StandardBag:
    """Writes standard messages into an mcap bag, with a latency that does not change."""

    def __init__(self, folder: Path, latency_ns: int = 0) -> None:
        self._store = get_typestore(Stores.ROS2_JAZZY)
        self._types = self._store.types
        self._writer = Writer(folder, version=9, storage_plugin=StoragePlugin.MCAP)
        self._writer.open()
        self._connections: dict[str, Any] = {}
        self._latency_ns = latency_ns

    def __enter__(self) -> StandardBag:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None) -> None:
        self._writer.close()

    def make(self, name: str, **fields: Any) -> Any:
        """Returns a message, e.g. ``make("geometry_msgs/msg/Point", x=0.0, y=0.0, z=0.0)``."""
        return self._types[name](**fields)

    def write(self, topic: str, log_ns: int, msg: Any) -> None:
        if topic not in self._connections:
            self._connections[topic] = self._writer.add_connection(topic, msg.__msgtype__, typestore=self._store)
        data = self._store.serialize_cdr(msg, msg.__msgtype__)
        self._writer.write(self._connections[topic], log_ns + self._latency_ns, data)

    def vector(self, x: float = 0.0, y: float = 0.0, z: float = 0.0) -> Any:
        return self.make("geometry_msgs/msg/Vector3", x=float(x), y=float(y), z=float(z))

    def header(self, ns: int, frame: str) -> Any:
        stamp = self.make("builtin_interfaces/msg/Time", sec=ns // NS, nanosec=ns % NS)
        return self.make("std_msgs/msg/Header", stamp=stamp, frame_id=frame)

    def twist(self, topic: str, ns: int, linear: float, angular: float) -> None:
        self.write(topic, ns, self.make("geometry_msgs/msg/Twist", linear=self.vector(linear), angular=self.vector(z=angular)))

    def odometry(self, topic: str, ns: int, x: float, y: float, yaw: float, linear: float, angular: float) -> None:
        make = self.make
        pose = make(
            "geometry_msgs/msg/Pose", position=make("geometry_msgs/msg/Point", x=float(x), y=float(y), z=0.0),
            orientation=make("geometry_msgs/msg/Quaternion", x=0.0, y=0.0, z=float(np.sin(yaw / 2)), w=float(np.cos(yaw / 2))),
        )  # fmt: skip
        twist = make("geometry_msgs/msg/Twist", linear=self.vector(linear), angular=self.vector(z=angular))
        with_pose = make("geometry_msgs/msg/PoseWithCovariance", pose=pose, covariance=np.zeros(36))
        with_twist = make("geometry_msgs/msg/TwistWithCovariance", twist=twist, covariance=np.zeros(36))
        msg = make(
            "nav_msgs/msg/Odometry",
            header=self.header(ns, "odom"),
            child_frame_id="base_footprint",
            pose=with_pose,
            twist=with_twist,
        )
        self.write(topic, ns, msg)

    def imu(self, topic: str, ns: int, gyro: Any, accel: Any) -> None:
        msg = self.make(
            "sensor_msgs/msg/Imu", header=self.header(ns, "base_link"), angular_velocity=self.vector(*gyro),
            linear_acceleration=self.vector(*accel), orientation=self.make("geometry_msgs/msg/Quaternion", x=0.0, y=0.0, z=0.0, w=1.0),
            orientation_covariance=np.zeros(9), angular_velocity_covariance=np.zeros(9), linear_acceleration_covariance=np.zeros(9),
        )  # fmt: skip
        self.write(topic, ns, msg)

    def scan(
        self, topic: str, ns: int, ranges: Any, angle_min: float, angle_increment: float, limits: tuple[float, float]
    ) -> None:
        ranges = np.asarray(ranges, dtype=np.float32)
        msg = self.make(
            "sensor_msgs/msg/LaserScan", header=self.header(ns, "base_scan"), angle_min=angle_min,
            angle_max=angle_min + angle_increment * (len(ranges) - 1), angle_increment=angle_increment, time_increment=0.0,
            scan_time=0.1, range_min=limits[0], range_max=limits[1], ranges=ranges, intensities=np.zeros(0, dtype=np.float32),
        )  # fmt: skip
        self.write(topic, ns, msg)

    def image(self, topic: str, ns: int, rgb: Any) -> None:
        rgb = np.ascontiguousarray(rgb, dtype=np.uint8)
        height, width, _ = rgb.shape
        msg = self.make(
            "sensor_msgs/msg/Image", header=self.header(ns, "camera"), height=height, width=width, encoding="rgb8", is_bigendian=0,
            step=3 * width, data=rgb.reshape(-1),
        )  # fmt: skip
        self.write(topic, ns, msg)


def room(*robots: RobotSpec) -> SceneSpec:
    """Returns a room of 8 m x 6 m with a pillar, its middle at the origin."""
    walls = [
        CollisionSpec("east", Shape("box", (0.1, 6.0, 1.0)), Pose((4.0, 0.0, 0.5))),
        CollisionSpec("west", Shape("box", (0.1, 6.0, 1.0)), Pose((-4.0, 0.0, 0.5))),
        CollisionSpec("north", Shape("box", (8.0, 0.1, 1.0)), Pose((0.0, 3.0, 0.5))),
        CollisionSpec("south", Shape("box", (8.0, 0.1, 1.0)), Pose((0.0, -3.0, 0.5))),
        CollisionSpec("pillar", Shape("box", (0.4, 0.4, 1.0)), Pose((3.0, -2.0, 0.5))),
    ]
    return SceneSpec("room", Path("/nonexistent"), "", (), tuple(walls), ground_z=0.0, robots=robots)


@dataclass(frozen=True)
class Recorder:
    """How a drive is recorded."""

    step_hz: int = 240
    publish_hz: int = 60
    command_hz: int = 20
    seed: int = 0


def record_drive(folder: Path, robot: RobotSpec, drive: ScriptedDrive, recorder: Recorder | None = None) -> dict[str, Any]:
    """Drives a robot in ``room`` and records commands, odometry, truth, IMU and scans; returns the true biases of the IMU."""
    how = recorder or Recorder()
    with PhysicsWorld(room(robot), step_hz=how.step_hz, seed=how.seed) as world, StandardBag(folder) as bag:
        suite = SensorSuite(robot, how.step_hz, how.publish_hz, (0.0, 0.0, -9.81), how.seed)
        for step in range(round(drive.duration * how.step_hz)):
            now = world.stamp_ns
            if step % (how.step_hz // how.command_hz) == 0:
                linear, angular = drive.command(now / NS)
                world.command(robot.name, VelocityCommand((linear, 0.0, 0.0), (0.0, 0.0, angular), now))
                bag.twist("/cmd_vel", now, linear, angular)
            world.step()
            _publish(bag, robot, world, suite, step + 1, how)
        biases = [imu.bias.tolist() for imu in suite._imus]
    return {"biases": biases}


def _publish(bag: StandardBag, robot: RobotSpec, world: PhysicsWorld, suite: SensorSuite, step: int, how: Recorder) -> None:
    now = world.stamp_ns
    if step % (how.step_hz // how.publish_hz) == 0:
        o, pose = world.odometry(robot.name), world.base_pose(robot.name)
        bag.odometry("/odom", now, o.x, o.y, o.yaw, o.linear, o.angular)
        linear, angular = world.base_twist(robot.name)
        yaw = 2 * np.arctan2(pose.quat_xyzw[2], pose.quat_xyzw[3])
        bag.odometry("/ground_truth/odom", now, pose.position[0], pose.position[1], yaw, linear[0], angular[2])
    found = suite.measure(world, step, now)
    for imu in found.imus:
        bag.imu("/imu", now, imu.angular_velocity, imu.linear_acceleration)
    for scan in found.scans:
        bag.scan("/scan", now, scan.ranges, scan.angle_min, scan.angle_increment, (scan.range_min, scan.range_max))
