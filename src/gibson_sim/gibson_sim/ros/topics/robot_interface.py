"""Topics of one robot."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Sequence
from functools import partial
from typing import Any

from geometry_msgs.msg import Twist, TwistStamped, WrenchStamped
from nav_msgs.msg import Odometry as RosOdometry
from rclpy.node import Node
from rclpy.publisher import Publisher
from sensor_msgs.msg import BatteryState, Imu, JointState, LaserScan, PointCloud2
from std_msgs.msg import Bool, String
from tf2_msgs.msg import TFMessage
from trajectory_msgs.msg import JointTrajectory

from gibson_sim.config import PhysicsConfig
from gibson_sim.description.xacro import published_description
from gibson_sim.errors import CommandError
from gibson_sim.geometry.transforms import invert, matrix_from_pose, pose_from_matrix
from gibson_sim.physics.world import PhysicsWorld
from gibson_sim.robots.spec import RobotSpec
from gibson_sim.ros import conversions
from gibson_sim.ros.lockstep.digest_publisher import DigestPublisher
from gibson_sim.ros.lockstep.journal import Journal
from gibson_sim.ros.topics import names, qos
from gibson_sim.ros.topics.arm_interface import ArmInterface
from gibson_sim.ros.topics.stamped_commands import StampedCommands
from gibson_sim.ros.wire.fast_publish import FastImu, FastJointStates, FastOdometry, FastTf, RelativePoses
from gibson_sim.sensors.imu import ImuReading
from gibson_sim.sensors.suite import Measurements, SensorSuite
from gibson_sim.types import WORLD_FRAME, SceneState

_Published = list[tuple[Publisher, bytes]]
"""Serialized messages, each with the publisher that has sent it."""


class CommandQueue:
    """Commands of several topics in the order of their arrival: of each topic the newest ``qos.MAX_COMMANDS``."""

    def __init__(self) -> None:
        self._commands: deque[tuple[str, Any]] = deque()

    def append(self, topic: str, msg: Any) -> None:
        """Appends a command; drops the oldest of its topic if that has too many."""
        waiting = [index for index, (other, _) in enumerate(self._commands) if other == topic]
        if len(waiting) >= qos.MAX_COMMANDS:
            del self._commands[waiting[0]]
        self._commands.append((topic, msg))

    def take(self) -> list[tuple[str, Any]]:
        """Returns topic and message of all commands, the oldest first, and empties the queue."""
        commands = list(self._commands)
        self._commands.clear()
        return commands

    def clear(self) -> None:
        """Drops all commands."""
        self._commands.clear()


class RobotInterface:
    """Applies the commands of a robot, and publishes its state and measurements. All names are relative to its namespace.

    Subscribes:
        cmd_vel (geometry_msgs/Twist, geometry_msgs/TwistStamped, or both, see ``cmd_vel_type``): velocity, base frame, m/s
            and rad/s. The robot stops when it is older than ``cmd_vel_timeout``. A NaN or an infinity is ignored with a warning.
        joint_trajectory (trajectory_msgs/JointTrajectory): joints pass through its points; an empty one stops them.
        joint_command (sensor_msgs/JointState): joints move to the positions, or at the velocities if it has no positions.

    Publishes:
        tf: odom -> base, moving links; tf_static, latched: fixed links, sensors. A single robot uses /tf and /tf_static.
        odom (nav_msgs/Odometry): wheel odometry. ground_truth/odom (nav_msgs/Odometry): true pose and velocity, map frame.
        joint_states (sensor_msgs/JointState), robot_description (std_msgs/String, latched).
        cmd_vel_applied (geometry_msgs/TwistStamped): each applied velocity command, unchanged, of either type, with the stamp from
            which it is in effect.
        The sensors of the robot: scan (sensor_msgs/LaserScan), lidar/points (sensor_msgs/PointCloud2), imu (sensor_msgs/Imu), bumper
        (std_msgs/Bool) and bumper/wrench (geometry_msgs/WrenchStamped), battery_state (sensor_msgs/BatteryState).

    See ``ArmInterface`` for its arms.
    """

    def __init__(
        self,
        node: Node,
        stamped: StampedCommands | None,
        robot: RobotSpec,
        world: PhysicsWorld,
        config: PhysicsConfig,
        on_received: Callable[[str], None],
    ) -> None:
        """Creates publishers and subscriptions, and publishes the latched messages.

        Args:
            node: node of the topics.
            stamped: receives cmd_vel as TwistStamped while the node receives it as Twist; None = only one type is received.
            robot: robot of the topics.
            world: world of the robot.
            config: settings of the node.
            on_received: called with the topic of each command.
        """
        self.robot = robot
        self.refused_commands = self.command_count = 0
        self._node, self._config = node, config
        self._base_frame = f"{robot.frame_prefix}{robot.base_link}"
        self._odom_frame = f"{robot.frame_prefix}{names.ODOM_FRAME}"
        self._publishers: list[Publisher] = []
        self._make_publishers()
        self.sensors = SensorSuite(robot, config.time.step_hz, config.time.publish_hz, world.scene.gravity, config.world.seed)
        self._received_commands = CommandQueue()
        self._due_commands: deque[tuple[str, Any]] = deque()
        self._applied: list[TwistStamped] = []
        self._on_received = on_received
        self._subscriptions = [
            node.create_subscription(kind, self._topic(name), partial(self._on_command, self._resolved(name)), qos.COMMAND)
            for kind, name in (
                (TwistStamped if config.commands.cmd_vel_type == "stamped" else Twist, names.CMD_VEL),
                (JointTrajectory, names.JOINT_TRAJECTORY),
                (JointState, names.JOINT_COMMAND),
            )
        ]
        every_tick = (names.ODOM, names.GROUND_TRUTH, names.JOINT_STATES)
        self._short_names = {name: self._resolved(name).lstrip("/") for name in (*every_tick, *self._sensor_pubs)}
        self._every_tick = {self._short_names[name] for name in every_tick}
        self.truth_topic = self._resolved(names.GROUND_TRUTH)
        base_topics = frozenset(map(self._resolved, (names.CMD_VEL, names.JOINT_TRAJECTORY, names.JOINT_COMMAND)))
        self._arms = ArmInterface(node, robot, on_received, world.stamp_ns)
        self.command_topics = base_topics | self._arms.command_topics
        self._stamped = stamped
        if stamped is not None:
            on_command = partial(self._on_command, self._resolved(names.CMD_VEL))
            self._stamped_subscription = stamped.subscribe(TwistStamped, self._topic(names.CMD_VEL), on_command, qos.COMMAND)
        self._rates = {lidar.name: lidar.rate_hz for lidar in robot.sensors.lidars}
        self._imus: dict[str, FastImu] = {}
        self._rows_revision = -1
        """Scene revision for which ``_relative`` is valid."""
        self._lay_out_messages()
        self._publish_latched()

    def _topic(self, name: str) -> str:
        return f"{self.robot.namespace}/{name}" if self.robot.namespace else name

    def _resolved(self, name: str) -> str:
        return self._node.resolve_topic_name(self._topic(name))

    def _on_command(self, topic: str, msg: Any) -> None:
        self.receive_command(topic, msg)
        self._on_received(topic)

    def receive_command(self, topic: str, msg: Any) -> None:
        """Appends a command to the queue of received commands, as if it had arrived on ``topic``."""
        if topic in self._arms.command_topics:
            self._arms.receive_command(topic, msg)
        else:
            self._received_commands.append(topic, msg)

    def topics_of_tick(self, measured: Measurements) -> set[str]:
        """Returns the topics that are published at a tick with these measurements, without leading slashes."""
        kinds = (measured.scans, measured.clouds, measured.imus, measured.bumpers, measured.batteries)
        return self._every_tick | {self._short_names[reading.name] for readings in kinds for reading in readings}

    def _publisher(self, kind: type[Any], topic: str, profile: Any) -> Publisher:
        publisher = self._node.create_publisher(kind, topic, **qos.overridable(profile))
        self._publishers.append(publisher)
        return publisher

    def _make_publishers(self) -> None:
        robot, topic = self.robot, self._topic
        tf, tf_static = (topic("tf"), topic("tf_static")) if robot.own_tf else (names.TF, names.TF_STATIC)
        self._tf_pub = self._publisher(TFMessage, tf, qos.TF)
        self._tf_static_pub = self._publisher(TFMessage, tf_static, qos.LATCHED)
        self._applied_pub = self._publisher(TwistStamped, topic(names.CMD_VEL_APPLIED), qos.STATE)
        self._odom_pub = self._publisher(RosOdometry, topic(names.ODOM), qos.STATE)
        self._joints_pub = self._publisher(JointState, topic(names.JOINT_STATES), qos.STATE)
        self._description_pub = self._publisher(String, topic(names.ROBOT_DESCRIPTION), qos.LATCHED)
        sensors = robot.sensors
        self._sensor_pubs: dict[str, Publisher] = {}
        for kind, specs in (
            (LaserScan, sensors.lidars),
            (PointCloud2, sensors.lidars_3d),
            (Imu, sensors.imus),
            (Bool, sensors.bumpers),
            (BatteryState, () if sensors.battery is None else (sensors.battery,)),
        ):
            for spec in specs:
                self._sensor_pubs[spec.name] = self._publisher(kind, topic(spec.name), qos.SENSOR)
        for bumper in sensors.bumpers:
            name = names.bumper_wrench(bumper.name)
            self._sensor_pubs[name] = self._publisher(WrenchStamped, topic(name), qos.SENSOR)
        # Created last: a node that has discovered it has discovered all other topics of this robot, see ``PhysicsConfig.wait_for``.
        self._truth_pub = self._publisher(RosOdometry, topic(names.GROUND_TRUTH), qos.STATE)

    def _publish_latched(self) -> None:
        """Publishes the robot description and the static transforms."""
        robot, prefix = self.robot, self.robot.frame_prefix
        self._description_pub.publish(String(data=published_description(robot.urdf)))
        transforms = [
            conversions.transform_to_msg(0, prefix + parent, prefix + child, pose)
            for parent, child, pose in robot.fixed_transforms
        ]
        frames = {t.child_frame_id for t in transforms}
        for camera in robot.cameras:
            if camera.optical_frame not in frames:
                parent = prefix + names.link_name(camera.link)
                transforms.append(conversions.transform_to_msg(0, parent, camera.optical_frame, camera.pose))
        self._tf_static_pub.publish(TFMessage(transforms=transforms))

    def has_commanders(self, count: int) -> bool:
        """Returns whether at least ``count`` publishers of cmd_vel, of either type, are matched."""
        subscriptions = (
            [self._subscriptions[0]] if self._stamped is None else [self._subscriptions[0], self._stamped_subscription]
        )
        return bool(sum(subscription.handle.get_publisher_count() for subscription in subscriptions) >= count)

    def latch_commands(self) -> None:
        """Makes all commands received so far due at the next step; later commands are due at later steps."""
        self._due_commands.extend(self._received_commands.take())
        self._arms.latch_commands()

    def apply_commands(self, world: PhysicsWorld, journal: Journal) -> None:
        """Applies the due commands in the order of their arrival, and records them in the journal."""
        while self._due_commands:
            self.command_count += 1
            topic, msg = self._due_commands.popleft()
            journal.record(topic, msg)
            try:
                self._apply(world, msg)
            except CommandError as error:
                self.refused_commands += 1
                self._node.get_logger().warning(str(error), throttle_duration_sec=1.0)
        count, refused = self._arms.apply_commands(world, journal)
        self.command_count, self.refused_commands = self.command_count + count, self.refused_commands + refused

    def _apply(self, world: PhysicsWorld, msg: Any) -> None:
        name, now = self.robot.name, world.stamp_ns
        if isinstance(msg, (JointTrajectory, JointState)):
            world.command_joints(name, conversions.joint_command_from_msg(msg))
        else:
            twist = msg.twist if isinstance(msg, TwistStamped) else msg
            world.command(name, conversions.velocity_from_msg(twist, now))
            if self._applied_pub.get_subscription_count():
                self._applied.append(TwistStamped(header=conversions.header_to_msg(now, self._base_frame), twist=twist))

    def pop_applied(self) -> list[TwistStamped]:
        """Returns the velocity commands applied since the last call, for ``publish_applied``; none without subscribers."""
        applied, self._applied = self._applied, []
        return applied

    def publish_applied(self, commands: Sequence[TwistStamped]) -> None:
        """Publishes applied velocity commands, each with the stamp from which it is in effect."""
        for command in commands:
            self._applied_pub.publish(command)

    def begin_tick(self, world: PhysicsWorld) -> RobotTick:
        """Publishes the wheel odometry, which does not need the scene state; the returned tick publishes the rest."""
        return RobotTick(self, world, self._publish_odometry(world))

    def _publish_odometry(self, world: PhysicsWorld) -> _Published:
        if not self._odom_pub.get_subscription_count():
            return []
        odometry = world.odometry(self.robot.name)
        pose = conversions.odometry_pose(odometry)
        twist = (odometry.linear, odometry.lateral, 0.0), (0.0, 0.0, odometry.angular)
        covariances = map(conversions.planar_covariance, world.odometry_covariance(self.robot.name))
        message = self._odom.serialize(world.stamp_ns, pose.position, pose.quat_xyzw, *twist, *covariances)
        return _publish(self._odom_pub, message)

    def _publish_transforms(self, world: PhysicsWorld, state: SceneState) -> _Published:
        if not self._tf_pub.get_subscription_count():
            return []
        return _publish(self._tf_pub, self._tf.serialize(state.stamp_ns, self._transforms(world, state)))

    def _publish_states(self, world: PhysicsWorld, state: SceneState, digests: DigestPublisher | None) -> _Published:
        name, stamp = self.robot.name, state.stamp_ns
        published: _Published = []
        if digests is not None or self._truth_pub.get_subscription_count():
            base, (linear, angular) = world.base_pose(name), world.base_twist(name)
            truth = self._truth.serialize(stamp, base.position, base.quat_xyzw, linear, angular)
            published += _publish(self._truth_pub, truth)
            if digests is not None:
                digests.add(self._topic(names.ODOM), world.odometry(name))
                digests.add(self._topic(names.GROUND_TRUTH), base, linear, angular)
        if digests is not None or self._joints_pub.get_subscription_count():
            joints = world.joint_states(name)
            published += _publish(self._joints_pub, self._joints.serialize(stamp, joints))
            if digests is not None:
                digests.add(self._topic(names.JOINT_STATES), joints)
        self._arms.publish(world, digests)
        return published

    def _transforms(self, world: PhysicsWorld, state: SceneState) -> list[Sequence[float]]:
        """Returns the poses for ``tf``, (x, y, z, qx, qy, qz, qw) each: T_odom_base, moving joints, and T_map_odom if it is enabled."""
        if state.revision != self._rows_revision:
            self._find_rows(state)
        odom_pose = conversions.odometry_pose(world.odometry(self.robot.name))
        poses: list[Sequence[float]] = [
            (*odom_pose.position, *odom_pose.quat_xyzw),
            *self._relative.of(state.positions, state.quats_xyzw),
        ]
        if self._config.topics.publish_map_tf:
            base = matrix_from_pose(world.base_pose(self.robot.name))
            T_map_odom = pose_from_matrix(base @ invert(matrix_from_pose(odom_pose)))
            poses.append((*T_map_odom.position, *T_map_odom.quat_xyzw))
        return poses

    def _lay_out_messages(self) -> None:
        """Prepares the serializers of messages with a fixed layout."""
        robot, prefix = self.robot, self.robot.frame_prefix
        frames = [(self._odom_frame, self._base_frame), *((prefix + p, prefix + c) for _, p, c in robot.moving_joints)]
        if self._config.topics.publish_map_tf:
            frames.append((WORLD_FRAME, self._odom_frame))
        self._tf = FastTf(frames)
        self._odom = FastOdometry(self._odom_frame, self._base_frame)
        self._truth = FastOdometry(WORLD_FRAME, self._base_frame)
        self._joints = FastJointStates([joint for joint, _, _ in robot.moving_joints])

    def _find_rows(self, state: SceneState) -> None:
        """Finds the rows of this robot's links in states of this scene revision."""
        row, name = {link: i for i, link in enumerate(state.links)}, self.robot.name
        pairs = [(row[f"{name}/{parent}"], row[f"{name}/{child}"]) for _, parent, child in self.robot.moving_joints]
        self._relative = RelativePoses(pairs)
        self._rows_revision = state.revision

    def measure(self, world: PhysicsWorld, *, all_sensors: bool) -> Measurements:
        """Returns the measurements due at the present step; without ``all_sensors``, lidars and IMUs without subscribers are skipped."""
        return self.sensors.measure(world, world.step_count, world.stamp_ns, None if all_sensors else self._has_subscribers)

    def _has_subscribers(self, sensor: str) -> bool:
        return bool(self._sensor_pubs[sensor].get_subscription_count())

    def publish_sensors(self, measured: Measurements, digests: DigestPublisher | None = None) -> None:
        """Publishes the measurements of a step with its stamp, and adds them to ``digests``."""
        if digests is not None:
            for readings in (measured.scans, measured.clouds, measured.imus, measured.bumpers, measured.batteries):
                for reading in readings:
                    digests.add(self._topic(reading.name), reading)
        for scan in measured.scans:
            scan_time = 1.0 / self._rates[scan.name]
            self._sensor_pubs[scan.name].publish(conversions.scan_to_msg(scan, self._frame(scan.link), scan_time))
        for cloud in measured.clouds:
            self._sensor_pubs[cloud.name].publish(conversions.lidar_cloud_to_msg(cloud, self._frame(cloud.link)))
        for imu in measured.imus:
            if self._sensor_pubs[imu.name].get_subscription_count():
                self._sensor_pubs[imu.name].publish(self._imu_message(imu))
        for bumper in measured.bumpers:
            pressed, wrench = conversions.bumper_to_msgs(bumper, self._frame(bumper.link))
            self._sensor_pubs[bumper.name].publish(pressed)
            self._sensor_pubs[names.bumper_wrench(bumper.name)].publish(wrench)
        for battery in measured.batteries:
            self._sensor_pubs[battery.name].publish(conversions.battery_to_msg(battery))

    def _imu_message(self, reading: ImuReading) -> bytes:
        """Returns a serialized IMU message; the orientation covariance is always that of the first message."""
        message = self._imus.get(reading.name)
        if message is None:
            orientation_covariance = conversions.imu_to_msg(reading, "").orientation_covariance
            message = FastImu(self._frame(reading.link), orientation_covariance.tolist())
            self._imus[reading.name] = message
        quat = reading.orientation_xyzw or (0.0, 0.0, 0.0, 1.0)
        angular, linear = reading.angular_velocity.tolist(), reading.linear_acceleration.tolist()
        variances = reading.angular_variance, reading.linear_variance
        return message.serialize(reading.stamp_ns, quat, angular, linear, *variances)

    def _frame(self, link: str) -> str:
        return self.robot.frame_prefix + names.link_name(link)

    def reset(self, step: int) -> None:
        """Drops commands and resets the sensors; ``step`` is the step count of the world."""
        self._received_commands.clear()
        self._due_commands.clear()
        self._applied.clear()
        self._arms.reset()
        self.sensors.reset(step)

    def close(self) -> None:
        """Destroys publishers and subscriptions."""
        self._arms.close()
        if self._stamped is not None:
            self._stamped.unsubscribe(self._stamped_subscription)
        for subscription in self._subscriptions:
            self._node.destroy_subscription(subscription)
        for publisher in self._publishers:
            self._node.destroy_publisher(publisher)
        self._publishers, self._subscriptions = [], []


class RobotTick:
    """What a robot publishes at one tick: the odometry, which ``RobotInterface.begin_tick`` has published before this object exists, then
    the transforms and the states, with the stamp of the scene state.
    """

    def __init__(self, robot: RobotInterface, world: PhysicsWorld, published: _Published) -> None:
        self._robot, self._world, self._published = robot, world, published

    def publish_transforms(self, state: SceneState) -> None:
        """Publishes the transforms."""
        self._published += self._robot._publish_transforms(self._world, state)

    def publish_states(self, state: SceneState, digests: DigestPublisher | None = None) -> None:
        """Publishes ground truth, joint states and arm states, and adds them to ``digests``."""
        self._published += self._robot._publish_states(self._world, state, digests)

    def publish_again(self) -> None:
        """Republishes all that was published, without the arm states."""
        for publisher, message in self._published:
            publisher.publish(message)


def _publish(publisher: Publisher, message: bytes) -> _Published:
    publisher.publish(message)
    return [(publisher, message)]
