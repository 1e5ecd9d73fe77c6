"""A simulation for tests: its process, a client and the robot's programs as one object that leaves nothing behind."""

from __future__ import annotations

import inspect
import math
import os
import textwrap
import warnings
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING, Any

from gibson_sim.config import robots_of
from gibson_sim.errors import AlreadyRunningError, ConfigError, GibsonSimError, SceneError
from gibson_sim.quoting import enumerated, quoted
from gibson_sim.standard.openings import BLOCKED_S
from gibson_sim.testing.processes import DOMAINS, NODE_VARIABLES, Program, SimulationProcess, free_domains, variables_set
from gibson_sim.testing.settings import PARTICIPANT, SimulationSettings

if TYPE_CHECKING:
    from gibson_sim.ros.client.client import Client, RobotPose
    from gibson_sim.ros.client.collisions import Collision
    from gibson_sim.standard.openings import JointOpening

__tracebackhide__ = True
"""pytest shows the line of the test instead of lines of this module; ``--full-trace`` shows all."""
PlanarPose = tuple[float, float, float]
"""x and y in metres and yaw in radians, in the map frame."""
_CLEARANCES = (0.1, 0.05, 0.0)
"""Clearances in addition to the robot's radius for path planning, tried in order, m."""
_OCCUPIED = 50
"""Value of an occupancy grid above which a cell counts as occupied."""
_MAX_DOORS = 10
"""Number of doors that a message lists."""
_DOOR_STATE_S = 0.2
"""Longest time until the state of doors is published, s of simulation time."""
_MAX_COLLISIONS = 5
"""Number of collisions that a message lists."""


class WaitError(GibsonSimError):
    """A condition did not hold in time; the message names condition and time, and summarises the state of the robots."""


class SimulationEndedError(GibsonSimError):
    """The simulation has ended; the message has the reason."""


class HeadlessSimulation:
    """A running simulation without a window.

        with HeadlessSimulation(scene="flat", start="2.6,7.2,-90") as sim:
            sim.drive_to(2.0, 5.0)
            assert not sim.contacts

    Lengths are in metres, angles in radians, times in seconds of simulation time, poses in the map frame. In lockstep, the default, time does not
    advance between two calls, and equal calls give equal values; with ``lockstep=False`` time advances continuously at ``rate``.
    """

    def __init__(
        self, *, domains: str = DOMAINS, folder: Path | None = None, bag: Path | None = None, first_domain: int | None = None,
        reach: str | None = None, **settings: Any,
    ) -> None:  # fmt: skip
        """Starts a simulation and waits until it is ready.

        Args:
            domains: range of ROS domains; a free one is used.
            folder: folder to which relative paths in the settings refer; None = the working folder.
            bag: folder of the recording, required with ``record=True``.
            first_domain: first position in the range that is tried; None = derived from the process id.
            reach: who can reach the nodes, as for ``node_environment``.
            settings: see ``SimulationSettings``; all settings of the physics node, and of the render node with ``cameras=True``.

        Raises:
            GibsonSimError: a setting is not allowed, or the simulation cannot start; the message is that of the simulation.
        """
        from gibson_sim.cli.environment import node_environment, require_nodes

        require_nodes()
        self.settings = SimulationSettings.of(settings)
        if self.settings.record and bag is None:
            raise ConfigError("simulation setting 'record' is True, but no folder is given for the bag")
        self.bag = bag if self.settings.record else None
        """Folder of the recording; None = nothing is recorded."""
        self._folder = folder or Path.cwd()
        self._programs: list[Program] = []
        self._last_summary, self._is_ready = "", False
        self._planner: Any = None
        self._client: Client | None = None
        self._process: SimulationProcess | None = None
        for domain in free_domains(domains, os.getpid() if first_domain is None else first_domain):
            environment = node_environment(domain_id=domain, reach=reach)
            try:
                self._start(domain, environment)
            except AlreadyRunningError:  # another process took the domain meanwhile
                self.close()
                continue
            except BaseException:
                self.close()
                raise
            break
        self.domain_id = domain
        """ROS domain of the simulation."""
        self.environment: dict[str, str] = {name: text for name, text in environment.items() if name not in NODE_VARIABLES}
        """Environment for processes whose nodes communicate with the simulation: ``subprocess.Popen([...], env=sim.environment)``."""

    def _start(self, domain: int, environment: Mapping[str, str]) -> None:
        self._process = SimulationProcess(self.settings, environment, self._folder, self.bag)
        with variables_set(environment), warnings.catch_warnings():
            warnings.simplefilter("ignore", DeprecationWarning)  # raised by a parser that generated messages import
            from gibson_sim.ros.client.client import Client

            self._client = Client(
                domain,
                {robot: self.settings.namespace(robot) for robot in self.settings.robots},
                name=PARTICIPANT,
                lockstep=self.settings.lockstep,
                stamped=self.settings.physics.commands.cmd_vel_type == "stamped",
                check=self._check,
                waits_for=lambda: self._process.waits_for if self._process is not None else "",
            )
        self._client.connect()
        self._is_ready = True

    def _check(self) -> None:
        """Raises an error if the simulation has ended or a program has failed."""
        if self._process is None or self._process.has_ended:
            reason = self._process.error() if self._process is not None else GibsonSimError("it was closed")
            if isinstance(reason, AlreadyRunningError):
                raise reason
            raise SimulationEndedError(f"the simulation {'has ended' if self._is_ready else 'cannot start'}: {reason}")
        for program in self._programs:
            program.check()

    @property
    def _running_client(self) -> Client:
        self._check()
        assert self._client is not None
        return self._client

    # Time

    @property
    def time(self) -> float:
        """Simulation time since the start or the last reset, s."""
        client = self._running_client
        client.catch_up()
        return client.now

    def step(self, seconds: float) -> None:
        """Advances time: in lockstep by whole ticks and while paused by whole steps, rounded up; otherwise at least by the given time.

        Args:
            seconds: simulation time, s.
        """
        client, physics = self._running_client, self.settings.physics
        if not (math.isfinite(seconds) and seconds > 0):
            raise ConfigError(f"step: seconds is {quoted(seconds)}, must be a number above 0")
        if client.is_paused:
            client.step(math.ceil(seconds * physics.time.step_hz - 1e-6), physics.time.step_hz)
        elif self.settings.lockstep:
            for _ in range(math.ceil(seconds * physics.time.publish_hz - 1e-6)):
                client.next_tick()
        else:
            client.catch_up()
            end = client.now + seconds
            while client.now < end:
                client.next_tick()

    def wait_until(self, condition: Callable[[], Any], timeout: float = 30.0, *, what: str = "") -> Any:
        """Advances time until a condition holds; evaluates it at every tick and returns its value.

        Args:
            condition: function without arguments; any true value ends the wait.
            timeout: seconds of simulation time.
            what: name of the condition in the error; empty = its source code.

        Raises:
            WaitError: the condition does not hold in time.
        """
        client = self._running_client
        begin = self.time
        while not (value := condition()):
            if client.now - begin >= timeout - 1e-9:
                raise WaitError(f"waited {timeout:g} s of simulation time for {what or _source(condition)}; {self.summary()}")
            client.next_tick()
        return value

    @property
    def is_paused(self) -> bool:
        """Whether ``pause`` has paused time."""
        return self._running_client.is_paused

    def pause(self) -> None:
        """Pauses time; ``step`` then executes physics steps."""
        self._running_client.set_playing(False)

    def play(self) -> None:
        """Resumes time."""
        self._running_client.set_playing(True)

    def reset(self) -> None:
        """Resets time, poses, and spawned and deleted entities to the initial state; discards received messages."""
        self._running_client.reset()

    # Entities

    def spawn(self, model: str, at: PlanarPose, name: str = "") -> str:
        """Spawns an object or robot on the floor; returns its name.

        Args:
            model: name in the catalogue such as ``chair``, a robot, or a file: URDF, SDF, mesh.
            at: x, y, yaw, map frame, m and rad.
            name: name of the entity; empty = derived from the model, with a number if the name exists.
        """
        return self._running_client.services.spawn(str(model), _pose(at), self._floor_z(), name)

    def move(self, name: str, at: PlanarPose) -> None:
        """Moves an entity or a robot to another pose on the floor, at rest."""
        self._running_client.services.move(name, _pose(at), self._floor_z())

    def delete(self, name: str) -> None:
        """Removes an entity."""
        self._running_client.services.delete(name)

    def entities(self) -> dict[str, RobotPose]:
        """Returns the poses of all robots and bodies by name."""
        client = self._running_client
        from gibson_sim.ros.client.client import robot_pose

        return {name: robot_pose(pose) for name, pose in client.services.poses().items()}

    def places(self) -> dict[str, RobotPose]:
        """Returns the named poses of the scene."""
        client = self._running_client
        from gibson_sim.ros.client.client import robot_pose

        return {place.name: robot_pose(place.pose) for place in client.services.ask("get_named_poses").poses}

    def _floor_z(self) -> float:
        client = self._running_client
        try:
            return float(client.floor().info.origin.position.z)
        except GibsonSimError:  # a scene without a floor
            client.raise_if_ended()
            return 0.0

    # The robot

    def robot_pose(self, robot: str = "") -> RobotPose:
        """Returns the true pose of a robot; empty = the first robot."""
        return self._running_client.pose(self._robot(robot))

    @property
    def contacts(self) -> list[Collision]:
        """Collisions of the robots since the start or a reset, without the ground and objects held by a gripper."""
        client = self._running_client
        client.catch_up()
        return client.collisions()

    def drive(self, linear: float, angular: float, seconds: float, *, robot: str = "", lateral: float = 0.0) -> None:
        """Commands a velocity at every tick for some time, then a stop.

        Args:
            linear: forward velocity, m/s.
            angular: yaw rate, rad/s, counter-clockwise.
            seconds: simulation time, s.
            robot: name of the robot; empty = the first robot.
            lateral: velocity to the left, m/s; only omnidirectional robots have one.
        """
        client, name = self._running_client, self._robot(robot)
        end = self.time + seconds
        while client.now < end - 1e-9:
            client.command(name, linear, angular, lateral)
            client.next_tick()
        client.command(name, 0.0, 0.0)
        client.next_tick()

    def drive_to(
        self, x: float, y: float, within: float = 0.2, *, timeout: float = 120.0, linear: float = 0.4, angular: float = 1.2,
        robot: str = "",
    ) -> None:  # fmt: skip
        """Drives a robot that can turn in place along the shortest path on the floor map, which does not include spawned objects.

        Args:
            x: goal, map frame, m.
            y: goal, map frame, m.
            within: distance from the goal at which it counts as reached, m.
            timeout: seconds of simulation time.
            linear: greatest speed, m/s.
            angular: greatest yaw rate, rad/s.
            robot: name of the robot; empty = the first robot.

        Raises:
            WaitError: the robot does not reach the goal in time.
            SceneError: the goal or the robot is not on free floor, or no path connects them.
        """
        from gibson_sim.robots.path_tracking import PathFollower

        client, name = self._running_client, self._robot(robot)
        pose, begin, follower = client.pose(name), self.time, None
        while pose.distance_to(x, y) > within:
            if follower is None or follower.done:
                path = self._path((pose.x, pose.y), (x, y), within)
                follower = PathFollower(path, max_linear=linear, max_angular=angular)
            if client.now - begin >= timeout:
                raise WaitError(
                    f"waited {timeout:g} s of simulation time for {name} to drive to x {x:.2f} m, y {y:.2f} m within {within:g} m; {self.summary()}"
                )
            client.command(name, *follower.command(pose.x, pose.y, pose.yaw))
            client.next_tick()
            pose = client.pose(name)
        client.command(name, 0.0, 0.0)
        client.next_tick()

    def send_goal(self, x: float, y: float, yaw: float = 0.0, *, topic: str = "goal_pose", patience: float = 30.0) -> None:
        """Publishes a goal (geometry_msgs/PoseStamped) for a navigation stack when its topic has a subscriber; time advances meanwhile.

        Args:
            x: goal, map frame, m.
            y: goal, map frame, m.
            yaw: heading at the goal, rad.
            topic: topic of the goal.
            patience: timeout for a subscriber, seconds of wall time.
        """
        self._running_client.send_goal(topic, *_pose((x, y, yaw)), patience)

    def _robot(self, name: str) -> str:
        robots = self.settings.robots
        if name and name not in robots:
            raise ConfigError(f"robot {quoted(name)} is not in this simulation; it has: {', '.join(robots)}")
        return name or robots[0]

    def _path(self, start: tuple[float, float], goal: tuple[float, float], within: float) -> Any:
        """Returns the shortest path (N, 2), map frame, metres, with the largest possible clearance.

        Raises:
            SceneError: no path exists.
        """
        if self._planner is None:
            self._planner = self._path_planners()
        last_error = None
        for planner in self._planner:
            try:
                path = planner.path(start, goal)
            except SceneError as error:
                last_error = error
                continue
            if math.dist(path[-1], goal) < within:
                return path
            last_error = SceneError(
                f"the goal x {goal[0]:.2f} m, y {goal[1]:.2f} m is too close to an obstacle of the floor map for the robot; the nearest point "
                f"is x {path[-1][0]:.2f} m, y {path[-1][1]:.2f} m"
            )
        assert last_error is not None
        raise last_error

    def _path_planners(self) -> list[Any]:
        """Returns path planners for the robot on the map, with decreasing clearance."""
        import numpy as np

        from gibson_sim.maps.floor_map import FloorMap
        from gibson_sim.maps.paths import PathPlanner
        from gibson_sim.robots.load import load_robot

        grid = self._running_client.floor()
        data = np.asarray(grid.data, dtype=np.int8).reshape(grid.info.height, grid.info.width)
        origin = (grid.info.origin.position.x, grid.info.origin.position.y)
        floor = FloorMap(grid.info.resolution, origin, data > _OCCUPIED, data >= 0)
        robot = robots_of(self.settings.physics.world.robot)[0][1]
        radius = load_robot(robot).radius
        return [PathPlanner(floor, radius + clearance) for clearance in _CLEARANCES]

    # Doors

    def doors(self) -> dict[str, float]:
        """Returns the opening of each door and drawer by name, ``<body>/<joint>``: 0 = closed, 1 = fully open.

        Unless it is paused, time advances until the simulation has published them, up to 0.1 s.
        """
        return {name: joint.opening for name, joint in self._openings().items()}

    def _openings(self) -> Mapping[str, JointOpening]:
        """Returns the present state of doors and drawers."""
        client = self._running_client
        begin = self.time
        while True:
            stamp, openings = client.openings()
            if stamp > begin or client.is_paused or client.now > begin + _DOOR_STATE_S:
                return openings
            client.next_tick()

    def open_door(self, name: str, opening: float = 1.0) -> None:
        """Moves a door or drawer while time advances, and releases it, so that it swings freely.

        Args:
            name: name of the joint, ``<body>/<joint>``.
            opening: 0 = closed, 1 = fully open.

        Raises:
            WaitError: the door is blocked; the message has its opening.
        """
        client = self._running_client
        doors: Mapping[str, JointOpening] = self._openings()
        if name not in doors:
            known = f"; it has: {enumerated(sorted(doors), _MAX_DOORS)}" if doors else ", which has none"
            raise ConfigError(f"{quoted(name)} is not a door or drawer of this simulation{known}")
        if not 0.0 <= opening <= 1.0:
            raise ConfigError(f"opening is {quoted(opening)}, must be from 0 (closed) to 1 (open)")
        client.move_joint(name, doors[name].position_at(opening))
        begin, arrived = self.time, False
        while not arrived and client.now < begin + BLOCKED_S:
            client.next_tick()
            stamp, doors = client.openings()
            arrived = stamp > begin and doors[name].has_reached(opening)
        client.move_joint(name, None)
        client.next_tick()
        if not arrived:
            reached = 100.0 * doors[name].opening
            raise WaitError(f"{name} is blocked: it is {reached:.0f} % open after {BLOCKED_S:g} s; {self.summary()}")

    # Topics

    def topics(self) -> dict[str, str]:
        """Returns topic -> message type of the topics that have publishers."""
        return self._running_client.topics()

    def subscribe(self, topic: str, kind: Any = None) -> None:
        """Subscribes to a topic and stores its messages; ``messages`` and ``latest`` do so at their first call.

        Args:
            topic: name of the topic.
            kind: message class; required only before the topic has a publisher.
        """
        self._running_client.subscribe(topic, kind)

    def unsubscribe(self) -> None:
        """Ends all subscriptions and discards their messages."""
        self._running_client.unsubscribe_all()

    def messages(self, topic: str) -> Sequence[Any]:
        """Returns all messages of a topic since its subscription or a reset, oldest first."""
        return self._running_client.messages(topic)

    def latest(self, topic: str, timeout: float = 10.0) -> Any:
        """Returns the latest message of a topic; advances time until one arrives if there is none.

        Args:
            topic: name of the topic.
            timeout: seconds of simulation time.
        """
        return self.wait_until(lambda: self._latest(topic), timeout, what=f"a message on {topic}")[0]

    def _latest(self, topic: str) -> Sequence[Any]:
        client = self._running_client
        if not client.is_subscribed(topic) and client.resolve(topic) not in client.topics() and client.now:
            return ()  # the topic may get a publisher while time advances
        return client.messages(topic)[-1:]

    # The robot's programs

    def has_joined(self, node: str) -> bool:
        """Returns whether a node has joined the lockstep; with ``lockstep=False``, whether it exists."""
        return self._running_client.has_joined(node)

    def start(
        self,
        command: Sequence[str],
        *,
        answers: str = "",
        environment: Mapping[str, str] | None = None,
        may_fail: bool = False,
        patience: float = 60.0,
    ) -> Program:
        """Starts a program of the robot in the simulation's domain; it ends with all its descendants at the latest at the end of the test.

        With ``answers``, every tick waits for the program's answer: time advances as fast as both can, and the run is repeatable if the program's
        decisions do not depend on wall time. Without it, the simulation switches to real time unless the setting ``rate`` is given, since the
        program could not keep up with a faster simulation.

        Args:
            command: program and arguments, as for ``subprocess.Popen``.
            answers: lockstep rule, ``TOPIC after TOPIC`` or ``TOPIC every SECONDS``, such as ``cmd_vel after scan``; the first topic is the
                program's answer; empty = time does not wait for the program.
            environment: additional environment variables.
            may_fail: whether a nonzero exit code is allowed; otherwise the next call after such an end raises.
            patience: with ``answers``, timeout for the program's publisher of the topic, seconds of wall time.
        """
        from gibson_sim.ros.client.answers import parse_rule

        client = self._running_client
        existing: frozenset[tuple[int, ...]] = frozenset()
        if answers:
            existing = client.publishers(parse_rule(answers).answer)
            if not self.settings.lockstep:
                raise ConfigError(
                    "answers is given, but with lockstep=False time does not wait for programs: leave one of them out"
                )
        elif self.settings.lockstep and not self.settings.has_rate:
            client.set_rate(1.0)
        program = Program(command, {**self.environment, **(environment or {})}, self._folder, may_fail=may_fail)
        self._programs.append(program)
        if answers:
            client.follow(answers, existing, lambda: program.returncode is not None, patience)
        return program

    @property
    def programs(self) -> tuple[Program, ...]:
        """All programs started since the beginning of the test."""
        return tuple(self._programs)

    # Report

    @property
    def log(self) -> str:
        """The end of the simulation's log."""
        return self._process.log if self._process is not None else ""

    def summary(self) -> str:
        """Returns the latest known time, poses and collisions in one line; never waits."""
        if self._client is None:
            return self._last_summary or "it is closed"
        client = self._client
        parts = [f"at {client.now:.3f} s"]
        for robot in self.settings.robots:
            pose = client.last_pose(robot)
            parts.append(f"{robot} at {pose}" if pose is not None else f"{robot}'s pose is unknown")
        collisions = client.collisions()
        listed = ", ".join(map(str, collisions[-_MAX_COLLISIONS:]))
        more = f" ({len(collisions) - _MAX_COLLISIONS} earlier ones)" if len(collisions) > _MAX_COLLISIONS else ""
        return "; ".join([*parts, f"collided with {listed}{more}" if collisions else "no collisions"])

    def report_sections(self) -> list[tuple[str, str]]:
        """Returns the sections of a failed test's report as (title, text); never waits."""
        sections = [("simulation", f"ROS domain {self.domain_id}, {self.summary()}"), ("log of the simulation", self.log)]
        for program in self._programs:
            code = program.returncode
            state = "which is running" if code is None else f"which ended with code {code}"
            sections.append((f"output of `{program.name}`, {state}", program.output))
        if self.bag is not None:
            sections.append(("recording", f"{self.bag}\nreplay: gibson-sim replay {self.bag} --verify"))
        return sections

    # End

    @property
    def is_usable(self) -> bool:
        """Whether the simulation is running and can be reset for another test."""
        return self._client is not None and self._process is not None and not self._process.has_ended

    def restart(self) -> None:
        """Ends the programs and subscriptions of a test and resets the simulation for the next test."""
        had_programs = bool(self._programs)
        self.stop_programs()
        client = self._running_client
        client.unsubscribe_all()
        if had_programs and not self.settings.has_rate:
            client.set_rate(self.settings.physics.time.rate)
        client.reset()
        if client.is_paused != self.settings.physics.time.start_paused:
            client.set_playing(not self.settings.physics.time.start_paused)
            if not client.is_paused:
                client.next_tick()

    def stop_programs(self) -> None:
        """Ends the programs started by ``start``, the last one first."""
        while self._programs:
            self._programs[-1].stop()
            self._programs.pop()

    def close(self) -> None:
        """Ends the programs and the simulation; a second call does nothing."""
        self.stop_programs()
        if self._client is not None:
            self._last_summary = self.summary()
            with suppress(GibsonSimError):
                self._client.close()
            self._client = None
        if self._process is not None:
            self._process.stop()

    def __repr__(self) -> str:
        return f"<HeadlessSimulation {self.settings.physics.world.scene}, ROS domain {self.domain_id}>"

    def __enter__(self) -> HeadlessSimulation:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()


def _pose(at: Sequence[float]) -> PlanarPose:
    try:
        x, y, yaw = (float(value) for value in at)
    except (TypeError, ValueError):
        raise ConfigError(f"the pose {quoted(at)} must be three numbers: x and y in metres, yaw in radians") from None
    if not all(map(math.isfinite, (x, y, yaw))):
        raise ConfigError(f"the pose {quoted(at)} must be three finite numbers: x and y in metres, yaw in radians")
    return x, y, yaw


def _source(condition: Callable[[], Any]) -> str:
    """Returns the source code of a condition, first line, for a message."""
    try:
        text = textwrap.dedent(inspect.getsource(condition)).strip()
    except (OSError, TypeError, SyntaxError):
        return getattr(condition, "__name__", "the condition")
    return f"`{text.splitlines()[0].strip()}`"
