"""The drive node: drives a robot as a user's own node would, through standard topics only."""

from __future__ import annotations

import logging
import os
import select
import sys
import termios
import time
import tty
from typing import Any

from geometry_msgs.msg import Twist, TwistStamped
from nav_msgs.msg import Odometry
from rclpy.node import Node

from gibson_msgs.msg import RunInfo
from gibson_sim.client_config import DriveConfig
from gibson_sim.errors import ConfigError, GibsonSimError, TextError
from gibson_sim.maps.floor_map import FloorMap, with_floor_at
from gibson_sim.maps.placement import furnished_floor_map
from gibson_sim.maps.tour import plan_tour
from gibson_sim.reading import parse_yaml
from gibson_sim.robots.load import load_robot
from gibson_sim.robots.path_tracking import PathFollower, ScriptedDrive, scripted_drive
from gibson_sim.robots.spec import RobotSpec
from gibson_sim.ros import conversions
from gibson_sim.ros.client.simulation_client import SimulationClient, is_success
from gibson_sim.ros.lockstep.lockstep_client import LockstepParticipant
from gibson_sim.ros.nodes.node_main import run_node, spin_while, started_by_launcher
from gibson_sim.ros.nodes.params import config_from_parameters
from gibson_sim.ros.nodes.wait_for_simulation import WaitCondition
from gibson_sim.ros.topics import names, qos
from gibson_sim.ros.topics.discovery import wait_until_acknowledged
from gibson_sim.ros.topics.silence import SilenceNotice
from gibson_sim.scenes import worlds
from gibson_sim.scenes.load import load_scene
from gibson_sim.scenes.spec import SceneSpec

logger = logging.getLogger(__name__)
DEFAULT_ROBOT = "gibson_bot"
"""Robot of a simulation that was started with several robots, or names none."""
KEYS = {"w": (1, 0), "x": (-1, 0), "a": (0, 1), "d": (0, -1), "q": (1, 1), "e": (1, -1), "s": (0, 0), " ": (0, 0)}
"""Key -> signs of the linear and the angular velocity."""
KEY_HELP = "w forward, x backward, a/d turn left/right, q/e forward and turn, s or space stop, Ctrl-C end"
TOUR_LENGTH, FORWARD_LENGTH = 30.0, 2.0
"""Default length of a tour and of other drives, m."""
_ANSWER_TIMEOUT_S = 5.0
"""Timeout for the names of the scene and the robot of a simulation, s of wall time."""
_MATCH_TIMEOUT_S, _LAUNCHED_MATCH_TIMEOUT_S = 10.0, 60.0
"""Timeouts for the matching of all subscribers of the commands, s of wall time: normally, and under the launcher, which may start a recorder."""


class DriveNode(Node):
    """Follows a tour, a script or the keyboard; ends with exit code 0 when the drive is done.

    Parameters: the fields of ``gibson_sim.client_config.DriveConfig``.

    Subscribes:
        ground_truth/odom (nav_msgs/Odometry): the robot's pose; each message causes one command, so the drive follows
            simulation time at any rate.
        run_info (gibson_msgs/RunInfo): for a tour without ``scene`` or ``robot``, the robot that the simulation was started with.

    Publishes:
        cmd_vel (geometry_msgs/Twist, or TwistStamped with ``stamped``); tick_done (gibson_msgs/TickDone), for lockstep.

    Calls, for a tour without ``scene`` or ``robot``:
        get_current_world (simulation_interfaces/GetCurrentWorld): the loaded world, which is another one after ``load_world``.
    """

    def __init__(self, **kwargs: Any) -> None:
        """Reads the script, or loads the scene in which the tour is planned. ``kwargs`` go to ``rclpy.node.Node``.

        Raises:
            GibsonSimError: a setting, the script, the scene or the robot cannot be used.
        """
        super().__init__("drive", **kwargs)
        self._config = config = config_from_parameters(self, DriveConfig)
        self._drive: _Drive | None = None
        self._site: tuple[SceneSpec, RobotSpec] | None = None
        """Scene and robot that a tour is planned for."""
        self._map: FloorMap | None = None
        self._world: _SimulatedWorld | None = None
        """World that a tour is planned in; None = the settings name it."""
        self._answer: WaitCondition | None = None
        if config.drive == "keyboard":
            if not sys.stdin.isatty():
                raise ConfigError("drive 'keyboard' needs a terminal on standard input; from a script use --drive with a file")
            self._drive = _KeyboardDrive(config)
        elif config.drive == "tour":
            for module in (load_scene.__module__, load_robot.__module__):
                logging.getLogger(module).setLevel(logging.ERROR)  # the physics node logs the same warnings
            if config.scene and config.robot:
                self._load_map(load_scene(config.scene), config.robot)
            else:
                self._world = _SimulatedWorld(self)
        else:
            length = config.length or FORWARD_LENGTH
            self._drive = _ScriptDrive(scripted_drive(config.drive, linear=config.linear, angular=config.angular, length=length))
        self._message_type = TwistStamped if config.stamped else Twist
        self._publisher = self.create_publisher(self._message_type, names.CMD_VEL, qos.COMMAND)
        self._simulation = WaitCondition.for_robot(self, names.GROUND_TRUTH, config.timeout)
        self._done, self._started, self._sent = False, False, 0
        self._start_by: float | None = None
        self._silence: SilenceNotice | None = None
        self._lockstep: LockstepParticipant | None = None

    def _load_map(self, scene: SceneSpec, robot_name: str) -> None:
        """Computes the map that a tour is planned in."""
        robot = load_robot(robot_name)
        self._site, self._map = (scene, robot), furnished_floor_map(scene, robot)

    def _has_map(self) -> bool:
        """Returns whether the drive needs no map, or has it; requests the names of scene and robot that the settings do not give.

        Raises:
            GibsonSimError: the simulation does not name them, or their files cannot be read here.
        """
        world, config = self._world, self._config
        if world is None or self._map is not None:
            return True
        if self._answer is None:
            self._answer = WaitCondition(
                self,
                "the simulation to name its scene and its robot",
                world.is_known,
                timeout_s=_ANSWER_TIMEOUT_S,
                remedy="name them with --scene and --robot",
            )
        if not self._answer.is_met():
            return False
        try:
            scene = load_scene(config.scene) if config.scene else world.load_scene()
            self._load_map(scene, config.robot or world.robot)
        except GibsonSimError as error:
            raise GibsonSimError(f"{error}; name the scene with --scene, the robot with --robot") from error
        self.get_logger().info(f"the tour is planned in scene {scene.name}")
        return True

    def _try_to_start(self) -> None:
        """Starts once the simulation runs and all subscribers of the commands are matched; time waits for that."""
        if self._started or not self._simulation.is_met() or not self._has_map():
            return
        if self._start_by is None:
            self._start_by = time.monotonic() + (_LAUNCHED_MATCH_TIMEOUT_S if started_by_launcher() else _MATCH_TIMEOUT_S)
        matched, required = self._publisher.get_subscription_count(), self._config.subscribers
        if matched < required:
            if time.monotonic() < self._start_by:
                return
            kind = self._message_type.__name__
            self.get_logger().warning(
                f"only {matched} of {required} subscribers receive {self._publisher.topic_name} as {kind}; driving anyway"
            )
        self._started = True
        self.create_subscription(Odometry, names.GROUND_TRUTH, self._on_odometry, qos.STATE)
        if not started_by_launcher():  # the launcher reports that a run starts paused
            self._silence = SilenceNotice(self, self.get_logger().warning, None, time.monotonic())
        if self._config.drive != "keyboard":  # a user does not press a key at every tick
            self._lockstep = LockstepParticipant(self, after=names.GROUND_TRUTH)

    def _on_odometry(self, msg: Odometry) -> None:
        """Publishes one command for each odometry message."""
        if self._silence is not None:
            self._silence.end()
        if self._done:
            return
        x, y, yaw, stamp_ns = conversions.planar_from_odometry(msg)
        if self._drive is None:
            self._drive = self._plan(x, y, msg.pose.pose.position.z)
        linear, angular = self._drive.command(x, y, yaw, stamp_ns)
        self._send(linear, angular, msg.header.stamp)
        if self._lockstep is not None:
            self._lockstep.tick_done(msg.header.stamp, (self._publisher.topic_name,))
        self._done = self._drive.done

    def _plan(self, x: float, y: float, z: float) -> _Drive:
        """Returns a tour that starts at (x, y), m, on the floor at ``z``, m."""
        assert self._map is not None and self._site is not None
        scene, robot = self._site
        level = with_floor_at(scene, z)
        if level is not scene:
            self._map = furnished_floor_map(level, robot)
        path = plan_tour(self._map, (x, y), robot.radius, self._config.length or TOUR_LENGTH)
        self.get_logger().info(f"tour of {len(path)} points starts at x {x:.2f} m, y {y:.2f} m")
        return _TourDrive(PathFollower(path, max_linear=self._config.linear, max_angular=self._config.angular))

    def _send(self, linear: float, angular: float, stamp: Any) -> None:
        msg = self._message_type()
        twist = msg
        if isinstance(msg, TwistStamped):
            msg.header.stamp, twist = stamp, msg.twist
        twist.linear.x, twist.angular.z = float(linear), float(angular)
        self._publisher.publish(msg)
        self._sent += 1

    def spin(self) -> int:
        """Drives until the drive is done or the context ends; returns the exit code."""
        spin_while(self, self._is_unfinished)
        wait_until_acknowledged(self._publisher)
        if self._lockstep is not None and not started_by_launcher():  # the launcher ends the run at this tick
            self._lockstep.leave()
        self.get_logger().info(f"{'done' if self._done else 'stopped'} after {self._sent} commands")
        return 0

    def _is_unfinished(self) -> bool:
        self._try_to_start()
        if self._silence is not None:
            self._silence.check(time.monotonic())
        return not self._done

    def close(self) -> None:
        """Restores the terminal."""
        if self._drive is not None:
            self._drive.close()


class _SimulatedWorld:
    """Requests the world of a simulation, and receives the name of its robot; the owner of the node spins it."""

    def __init__(self, node: Node) -> None:
        self._simulation = SimulationClient(node)
        self._robot, self._response = "", None
        self._subscription = node.create_subscription(RunInfo, names.RUN_INFO, self._on_run_info, qos.RUN_INFO)

    def is_known(self) -> bool:
        """Returns whether the simulation has named its world and its robot; requests them."""
        self._response = self._simulation.poll("get_current_world")
        return bool(self._robot) and self._response is not None

    @property
    def robot(self) -> str:
        """Name or path of the robot, once it is known."""
        return self._robot

    def load_scene(self) -> SceneSpec:
        """Returns the scene of the world, without robots, once it is known.

        Raises:
            GibsonSimError: no world is loaded, or its files cannot be read here.
        """
        response: Any = self._response
        if not is_success("get_current_world", response):
            raise GibsonSimError(f"the simulation names no scene: {response.result.error_message}")
        resource = response.world.world_resource
        return worlds.load_world(resource.uri, resource.resource_string, ignore_missing=True)

    def _on_run_info(self, msg: RunInfo) -> None:
        if msg.kind != "physics":
            return
        try:
            settings = parse_yaml(msg.settings)
        except TextError as error:
            logger.warning("run_info of %s cannot be read: %s", msg.node, error)
            settings = {}
        robot = str(settings.get("robot", "")) if isinstance(settings, dict) else ""
        self._robot = DEFAULT_ROBOT if not robot or "=" in robot else robot


class _Drive:
    """Computes the velocity command at a pose and a time; ``done`` ends the drive."""

    done = False

    def command(self, x: float, y: float, yaw: float, stamp_ns: int) -> tuple[float, float]:
        """Returns the linear (m/s) and the angular velocity (rad/s) at x, y (m) and yaw (rad)."""
        raise NotImplementedError

    def close(self) -> None:
        """Releases the resources of the drive."""


class _TourDrive(_Drive):
    def __init__(self, follower: PathFollower) -> None:
        self._follower = follower

    def command(self, x: float, y: float, yaw: float, stamp_ns: int) -> tuple[float, float]:
        command = self._follower.command(x, y, yaw)
        self.done = self._follower.done
        return command


class _ScriptDrive(_Drive):
    def __init__(self, script: ScriptedDrive) -> None:
        self._script, self._start_ns = script, -1

    def command(self, x: float, y: float, yaw: float, stamp_ns: int) -> tuple[float, float]:
        if self._start_ns < 0:
            self._start_ns = stamp_ns
        seconds = (stamp_ns - self._start_ns) / 1e9
        self.done = seconds >= self._script.duration
        return self._script.command(seconds)


class _KeyboardDrive(_Drive):
    """Reads single keys from the terminal."""

    def __init__(self, config: DriveConfig) -> None:
        self._config, self._direction = config, (0, 0)
        self._terminal = termios.tcgetattr(sys.stdin)
        tty.setcbreak(sys.stdin)
        sys.stderr.write(KEY_HELP + "\n")

    def command(self, x: float, y: float, yaw: float, stamp_ns: int) -> tuple[float, float]:
        while select.select([sys.stdin], [], [], 0.0)[0]:
            key = os.read(sys.stdin.fileno(), 1).decode(errors="ignore")
            if not key:
                self.done = True
                break
            self._direction = KEYS.get(key.lower(), self._direction)
        return self._direction[0] * self._config.linear, self._direction[1] * self._config.angular

    def close(self) -> None:
        termios.tcsetattr(sys.stdin, termios.TCSADRAIN, self._terminal)


def main(args: list[str] | None = None) -> None:
    """Runs the drive node."""
    run_node(DriveNode, args)


if __name__ == "__main__":
    main()
