"""The physics node: owner of time and of the scene."""

from __future__ import annotations

import logging
import time
from collections import deque
from dataclasses import replace
from threading import Thread
from typing import Any

import rclpy
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from geometry_msgs.msg import TransformStamped, Twist, TwistStamped
from nav_msgs.msg import Odometry as RosOdometry
from rclpy.clock import Clock, ClockType
from rclpy.executors import ExternalShutdownException, SingleThreadedExecutor
from rclpy.node import Node
from rosgraph_msgs.msg import Clock as ClockMsg
from sensor_msgs.msg import JointState, LaserScan
from std_msgs.msg import String
from tf2_msgs.msg import TFMessage

from gibson_msgs.msg import Scene, SceneState
from gibson_sim.config import PhysicsConfig
from gibson_sim.errors import AlreadyRunningError, CommandError
from gibson_sim.geometry.transforms import invert, matrices_from_poses, matrix_from_pose, pose_from_matrix
from gibson_sim.physics.world import PhysicsWorld
from gibson_sim.resources import find_config
from gibson_sim.robots.spec import RobotSpec
from gibson_sim.ros import conversions, names, qos
from gibson_sim.ros.node_main import run_node, started_by_launcher, write_summary
from gibson_sim.ros.pacing import Pacer
from gibson_sim.ros.params import config_from_parameters
from gibson_sim.scenes.placement import populate
from gibson_sim.scenes.randomise import randomise
from gibson_sim.scenes.randomise_yaml import load_rules
from gibson_sim.scenes.spec import WORLD_FRAME, SceneSpec, drawn_scene
from gibson_sim.sensors.lidar import measure_scan
from gibson_sim.sensors.schedule import is_due
from gibson_sim.types import NS_PER_S, SceneState as State

logger = logging.getLogger(__name__)
WAIT_LIMIT_S = 120.0
DISCOVERY_S, LATE_DISCOVERY_S = 3.0, 10.0
"""Within so long a new participant has heard of the others: usually, and on a busy machine."""


class PhysicsNode(Node):
    """Steps the world and publishes all of a tick with one stamp.

    Parameters: the fields of ``gibson_sim.config.PhysicsConfig``.

    Subscribes:
        cmd_vel (geometry_msgs/Twist and geometry_msgs/TwistStamped): wanted velocity, base frame, m/s and rad/s. Older than
            ``cmd_vel_timeout`` it stops the robot. A NaN or an infinity is ignored with a warning.

    Publishes:
        /clock (rosgraph_msgs/Clock) at ``clock_hz``.
        /tf (tf2_msgs/TFMessage): odom -> base, wheels; map -> odom if ``publish_map_tf``. /tf_static: sensors, latched.
        odom (nav_msgs/Odometry): from the wheels. ground_truth/odom (nav_msgs/Odometry): the truth, in the map frame.
        joint_states (sensor_msgs/JointState), scan (sensor_msgs/LaserScan), robot_description (std_msgs/String, latched).
        scene (gibson_msgs/Scene, latched), scene_state (gibson_msgs/SceneState).
        /diagnostics (diagnostic_msgs/DiagnosticArray): real-time factor, time lost, commands, once a second of wall time.
    """

    def __init__(self, **kwargs: Any) -> None:
        """Loads the scene. ``kwargs`` go to ``rclpy.node.Node`` (``parameter_overrides`` in tests).

        Raises:
            GibsonSimError: a setting, the scene or the robot cannot be used, or another simulation publishes /clock.
        """
        super().__init__("physics", **kwargs)
        self._world: PhysicsWorld | None = None
        self._stamped: _StampedCommands | None = None
        self._config = config = config_from_parameters(self, PhysicsConfig)
        populated = populate(config.scene, config.robot, config.start, sdf_lamps=config.sdf_lamps)
        self._scene = scene = _with_camera_settings(populated, config)
        self._rules = load_rules(find_config(config.randomise, "randomisation")) if config.randomise else None
        self._look_for_others()
        self._robot: RobotSpec = scene.robots[0]
        self._world = PhysicsWorld(scene, step_hz=config.step_hz, cmd_vel_timeout=config.cmd_vel_timeout)
        self._base_frame = self._robot.base_link
        self._tick, self._lost_commands, self._commands_seen = 0, 0, 0
        self._pacer = Pacer(config.clock_hz, config.rate)
        self._first_tick: tuple[int, int] | None = None
        self._last_tick, self._last_report = (0, 0), (0, 0)
        self._make_publishers()
        self._commands: deque[Twist] = deque(maxlen=16)
        self.create_subscription(Twist, names.CMD_VEL, lambda msg: self._commands.append(msg), qos.COMMAND)
        self._stamped = _StampedCommands(self, self._commands)
        self._publish_latched()
        self.get_logger().info(
            f"scene {scene.name}: {len(scene.visuals)} visuals, {len(scene.collisions)} collision shapes; "
            f"{self._robot.name} at {self._robot.start.position[0]:.2f},{self._robot.start.position[1]:.2f}"
        )

    def _look_for_others(self) -> None:
        """Refuses before anything is published: a second scene would replace the first one in its renderers.

        The launcher keeps a lock on the domain, so a node that it started need not wait for what discovery brings.
        """
        deadline = time.monotonic() + (0.0 if started_by_launcher() else DISCOVERY_S)
        self._refuse_second_simulation(own=0)
        while time.monotonic() < deadline:
            time.sleep(0.05)
            self._refuse_second_simulation(own=0)

    def _refuse_second_simulation(self, own: int) -> None:
        """Two sources of /clock make time jump to and fro for everybody: the younger one, with ``own`` publishers, gives way."""
        if self.count_publishers(names.CLOCK) > own:
            raise AlreadyRunningError(
                "another node publishes /clock in this ROS domain: stop that simulation, or choose another ROS_DOMAIN_ID"
            )

    def _give_way_while_young(self) -> None:
        if time.monotonic() < self._young_until:
            self._refuse_second_simulation(own=1)

    def _make_publishers(self) -> None:
        self._clock_pub = self.create_publisher(ClockMsg, names.CLOCK, qos.CLOCK)
        self._tf_pub = self.create_publisher(TFMessage, names.TF, qos.TF)
        self._tf_static_pub = self.create_publisher(TFMessage, names.TF_STATIC, qos.LATCHED)
        self._odom_pub = self.create_publisher(RosOdometry, names.ODOM, qos.STATE)
        self._truth_pub = self.create_publisher(RosOdometry, names.GROUND_TRUTH, qos.STATE)
        self._joints_pub = self.create_publisher(JointState, names.JOINT_STATES, qos.STATE)
        self._scan_pub = self.create_publisher(LaserScan, names.SCAN, qos.SENSOR)
        self._description_pub = self.create_publisher(String, names.ROBOT_DESCRIPTION, qos.LATCHED)
        self._scene_pub = self.create_publisher(Scene, names.SCENE, qos.LATCHED)
        self._state_pub = self.create_publisher(SceneState, names.SCENE_STATE, qos.STATE)
        self._diagnostics_pub = self.create_publisher(DiagnosticArray, names.DIAGNOSTICS, qos.STATE)

    def _publish_latched(self) -> None:
        """Publishes what does not change: scene, description, fixed transforms."""
        drawn = drawn_scene(self._scene, self.world.links)
        if self._rules is not None:
            drawn = randomise(drawn, self._config.randomise_seed, self._rules)
        self._cameras = drawn.cameras
        self._scene_pub.publish(conversions.scene_to_msg(drawn, self.world.stamp_ns))
        self._description_pub.publish(String(data=self._robot.urdf.read_text(encoding="utf-8")))
        transforms = [
            conversions.transform_to_msg(0, parent, child, pose) for parent, child, pose in self._robot.fixed_transforms
        ]
        known = {t.child_frame_id for t in transforms}
        for camera in self._robot.cameras:
            if camera.optical_frame not in known:
                parent = _link_name(camera.link)
                transforms.append(conversions.transform_to_msg(0, parent, camera.optical_frame, camera.pose))
        self._tf_static_pub.publish(TFMessage(transforms=transforms))

    @property
    def world(self) -> PhysicsWorld:
        """The world; it is there from the end of the constructor to ``close``."""
        assert self._world is not None, "the world is closed"
        return self._world

    def spin(self) -> int:
        """Makes time until the context ends or ``duration`` has passed; returns the exit code."""
        done = False
        steady = Clock(clock_type=ClockType.STEADY_TIME)
        executor = SingleThreadedExecutor()
        executor.add_node(self)
        self._wait_for_subscribers(executor)

        def tick() -> None:
            nonlocal done
            done = done or self._make_ticks(time.monotonic_ns())

        period = 1.0 / (self._config.clock_hz * self._config.rate) if self._config.rate else 1e-5
        self.create_timer(min(period, 0.01), tick, clock=steady)
        self.create_timer(1.0, self._publish_diagnostics, clock=steady)
        self._young_until = time.monotonic() + LATE_DISCOVERY_S
        self.create_timer(0.2, self._give_way_while_young, clock=steady)
        self._last_report = (time.monotonic_ns(), self.world.stamp_ns)
        try:
            while rclpy.ok() and not done:
                executor.spin_once(timeout_sec=0.5)
        except (KeyboardInterrupt, ExternalShutdownException):
            pass
        return 0

    def _wait_for_subscribers(self, executor: SingleThreadedExecutor) -> None:
        """Holds time until the topics in ``wait_for`` have their subscribers, so that nobody misses the start."""
        wanted, deadline = self._config.wanted_subscribers(), time.monotonic() + WAIT_LIMIT_S
        count = wanted.pop("cameras", 0)
        images = [names.camera_topics(camera.name)[output] for camera in self._cameras for output in camera.outputs]
        wanted.update(dict.fromkeys(images, count))
        while rclpy.ok():
            missing = {topic: count for topic, count in wanted.items() if self.count_subscribers(topic) < count}
            if not missing:
                return
            if time.monotonic() > deadline:
                self.get_logger().warning(f"still too few subscribers after {WAIT_LIMIT_S:.0f} s, starting without: {missing}")
                return
            executor.spin_once(timeout_sec=0.05)

    def _make_ticks(self, now_ns: int) -> bool:
        """Makes the ticks that are due at wall time ``now_ns``; returns whether ``duration`` has passed."""
        for _ in range(self._pacer.due(now_ns)):
            self._first_tick = self._first_tick or (now_ns, self.world.stamp_ns)
            self._take_commands()
            self.world.step(self._config.step_hz // self._config.clock_hz)
            self._tick += 1
            stamp_ns = self.world.stamp_ns
            self._clock_pub.publish(ClockMsg(clock=conversions.time_to_msg(stamp_ns)))
            ticks_per_state = self._config.clock_hz // self._config.publish_hz
            if self._tick % ticks_per_state == 0:
                self._publish_state(self._tick // ticks_per_state)
            self._last_tick = (time.monotonic_ns(), stamp_ns)
            if self._config.duration and stamp_ns >= self._config.duration * NS_PER_S:
                return True
        return False

    def _take_commands(self) -> None:
        """Hands the commands that arrived since the last tick to the world, in the order of their arrival."""
        while self._commands:
            self._commands_seen += 1
            try:
                command = conversions.velocity_from_msg(self._commands.popleft(), self.world.stamp_ns)
                self.world.command(self._robot.name, command)
            except CommandError as error:
                self._lost_commands += 1
                self.get_logger().warning(str(error), throttle_duration_sec=1.0)

    def _publish_state(self, tick: int) -> None:
        """Publishes everything that describes this tick, with its stamp. ``tick`` counts at ``publish_hz``."""
        state, robot, hz = self.world.state(), self._robot, self._config.publish_hz
        odometry = self.world.odometry(robot.name)
        self._tf_pub.publish(TFMessage(transforms=self._transforms(state)))
        self._odom_pub.publish(conversions.odometry_to_msg(odometry, state.stamp_ns, names.ODOM_FRAME, self._base_frame))
        linear, angular = self.world.base_twist(robot.name)
        truth = conversions.ground_truth_to_msg(
            self.world.base_pose(robot.name), linear, angular, state.stamp_ns, self._base_frame
        )
        self._truth_pub.publish(truth)
        self._joints_pub.publish(conversions.joint_states_to_msg(self.world.joint_states(robot.name), state.stamp_ns))
        if robot.lidar and is_due(tick, robot.lidar.rate_hz, hz):
            scan = measure_scan(robot.lidar, state, self.world.cast_rays)
            self._scan_pub.publish(conversions.scan_to_msg(scan, _link_name(robot.lidar.link), 1.0 / robot.lidar.rate_hz))
        due = tuple(i for i, c in enumerate(self._cameras) if is_due(tick, c.rate_hz, hz))
        self._state_pub.publish(conversions.scene_state_to_msg(state, due))

    def _transforms(self, state: State) -> list[TransformStamped]:
        """Returns the moving transforms of the robot at one tick."""
        robot = self._robot
        odom_from_base = conversions.odometry_pose(self.world.odometry(robot.name))
        transforms = [conversions.transform_to_msg(state.stamp_ns, names.ODOM_FRAME, self._base_frame, odom_from_base)]
        world_from = dict(zip(state.links, matrices_from_poses(state.positions, state.quats_xyzw), strict=True))
        for _, parent, child in robot.moving_joints:
            relative = invert(world_from[f"{robot.name}/{parent}"]) @ world_from[f"{robot.name}/{child}"]
            transforms.append(conversions.transform_to_msg(state.stamp_ns, parent, child, pose_from_matrix(relative)))
        if self._config.publish_map_tf:
            world_from_odom = world_from[f"{robot.name}/{self._base_frame}"] @ invert(matrix_from_pose(odom_from_base))
            pose = pose_from_matrix(world_from_odom)
            transforms.append(conversions.transform_to_msg(state.stamp_ns, WORLD_FRAME, names.ODOM_FRAME, pose))
        return transforms

    def _publish_diagnostics(self) -> None:
        """Publishes how fast time passed since the last report."""
        wall_ns, sim_ns = time.monotonic_ns(), self.world.stamp_ns
        factor = (sim_ns - self._last_report[1]) / max(1, wall_ns - self._last_report[0])
        self._last_report = (wall_ns, sim_ns)
        behind = bool(self._config.rate) and factor < 0.95 * self._config.rate
        status = DiagnosticStatus(
            level=DiagnosticStatus.WARN if behind else DiagnosticStatus.OK,
            name="gibson_sim: physics",
            message="slower than asked for" if behind else "on time",
            hardware_id=self._scene.name,
            values=[
                KeyValue(key="real_time_factor", value=f"{factor:.3f}"),
                KeyValue(key="lost_wall_time_s", value=f"{self._pacer.lost_ns / NS_PER_S:.3f}"),
                KeyValue(key="refused_commands", value=str(self._lost_commands)),
            ],
        )
        self._diagnostics_pub.publish(DiagnosticArray(header=conversions.header_to_msg(sim_ns, ""), status=[status]))

    def summary(self) -> dict[str, Any]:
        """Returns what was measured since the first tick."""
        first = self._first_tick or self._last_tick
        wall_s = (self._last_tick[0] - first[0]) / NS_PER_S
        sim_s = (self._last_tick[1] - first[1]) / NS_PER_S
        return {
            "scene": self._scene.name,
            "simulation_time_s": sim_s,
            "wall_time_s": wall_s,
            "real_time_factor": sim_s / wall_s if wall_s else 0.0,
            "physics_steps": self.world.step_count,
            "step_hz": self._config.step_hz,
            "lost_wall_time_s": self._pacer.lost_ns / NS_PER_S,
            "commands": self._commands_seen,
            "refused_commands": self._lost_commands,
        }

    def close(self) -> None:
        """Writes the summary and frees the world."""
        if self._stamped is not None:
            self._stamped.close()
            self._stamped = None
        if self._world is not None:
            write_summary(self._config.summary_path, self.summary())
            self._world.close()
            self._world = None


class _StampedCommands:
    """Takes cmd_vel as TwistStamped as well.

    One participant cannot hold a topic under two types, so this is a second context with a thread of its own. It only puts
    messages into the queue; the world is touched by the main thread alone.
    """

    def __init__(self, node: Node, commands: deque[Twist]) -> None:
        self._context = rclpy.Context()
        self._context.init(domain_id=node.context.get_domain_id())
        self._node = Node(
            "physics_stamped_commands", namespace=node.get_namespace(), context=self._context, use_global_arguments=False
        )
        topic = node.resolve_topic_name(names.CMD_VEL)
        self._node.create_subscription(TwistStamped, topic, lambda msg: commands.append(msg.twist), qos.COMMAND)
        self._executor = SingleThreadedExecutor(context=self._context)
        self._executor.add_node(self._node)
        self._thread = Thread(target=self._spin, name="stamped-commands", daemon=True)
        self._thread.start()

    def _spin(self) -> None:
        try:
            self._executor.spin()
        except ExternalShutdownException:
            pass

    def close(self) -> None:
        """Ends the thread and the context."""
        self._executor.shutdown(timeout_sec=2.0)
        self._context.try_shutdown()
        self._thread.join(timeout=2.0)
        self._node.destroy_node()


def _link_name(name: str) -> str:
    """Returns the tf frame of ``<body>/<link>``."""
    return name.rpartition("/")[2]


def _with_camera_settings(scene: SceneSpec, config: PhysicsConfig) -> SceneSpec:
    """Returns the scene with the rate and the outputs that the settings ask of every camera."""
    changes: dict[str, Any] = {}
    if config.camera_rate:
        changes["rate_hz"] = config.camera_rate
    if outputs := config.wanted_outputs():
        changes["outputs"] = outputs
    robots = tuple(replace(r, cameras=tuple(replace(c, **changes) for c in r.cameras)) for r in scene.robots)
    return replace(scene, robots=robots)


def main(args: list[str] | None = None) -> None:
    """Runs the physics node."""
    run_node(PhysicsNode, args)


if __name__ == "__main__":
    main()
