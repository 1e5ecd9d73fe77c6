"""A simulation for tests: its process, a client of it, and the robot's own programs beside it, as one object that leaves nothing behind."""

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

from gibson_sim.errors import AlreadyRunningError, ConfigError, GibsonSimError, SceneError
from gibson_sim.quoting import quoted
from gibson_sim.testing.processes import DOMAINS, OF_THE_NODES, Program, SimulationProcess, free_domains, variables_set
from gibson_sim.testing.settings import PARTICIPANT, SimulationSettings

if TYPE_CHECKING:
    from gibson_sim.ros.client.client import Client, RobotPose
    from gibson_sim.ros.client.collisions import Collision

__tracebackhide__ = True
"""pytest shows the line of the test, not those of this module; ``--full-trace`` shows all."""
At = tuple[float, float, float]
"""x and y in metres and yaw in radians, in the map frame."""
_ROOM = (0.1, 0.05, 0.0)
"""Distances to obstacles beyond the robot's radius with which paths are planned, the first that there is room for, m."""
_OCCUPIED = 50
"""Value of an occupancy grid above which a cell is occupied."""
_MOST_COLLISIONS = 5
"""Collisions that a message lists."""


class WaitError(GibsonSimError):
    """What a test waited for has not happened; the message says what, for how long, and how the robot stands."""


class SimulationEndedError(GibsonSimError):
    """The simulation has ended; the message says why."""


class HeadlessSimulation:
    """A running simulation without a window.

        with HeadlessSimulation(scene="flat", start="2.6,7.2,-90") as sim:
            sim.drive_to(2.0, 5.0)
            assert not sim.contacts

    Lengths are in metres, angles in radians, times in seconds of simulation time, poses in the map frame. In lockstep, the default, time stands
    still between two calls and the same calls give the same values; with ``lockstep=False`` time passes by itself, at ``rate``.
    """

    def __init__(
        self, *, domains: str = DOMAINS, folder: Path | None = None, bag: Path | None = None, first_domain: int | None = None,
        **settings: Any,
    ) -> None:  # fmt: skip
        """Starts a simulation and waits until it is ready.

        Args:
            domains: range of ROS domains, of which a free one is used.
            folder: from which relative paths in the settings count; None = the current one.
            bag: folder of the recording, with ``record=True``.
            first_domain: place in the range at which the search for a free one begins; None = by the id of this process.
            settings: of the simulation, see ``SimulationSettings``: every setting of the physics node, and of the render node with ``cameras=True``.

        Raises:
            GibsonSimError: a setting is not allowed, or the simulation cannot start; the message is the simulation's own.
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
            environment = node_environment(domain_id=domain)
            try:
                self._start(domain, environment)
            except AlreadyRunningError:  # another one was quicker
                self.close()
                continue
            except BaseException:
                self.close()
                raise
            break
        self.domain_id = domain
        """ROS domain of the simulation."""
        self.environment: dict[str, str] = {name: text for name, text in environment.items() if name not in OF_THE_NODES}
        """All variables of a process whose nodes are to find the simulation: ``subprocess.Popen([...], env=sim.environment)``."""

    def _start(self, domain: int, environment: Mapping[str, str]) -> None:
        self._process = SimulationProcess(self.settings, environment, self._folder, self.bag)
        with variables_set(environment), warnings.catch_warnings():
            warnings.simplefilter("ignore", DeprecationWarning)  # of the parser that generated messages load
            from gibson_sim.ros.client.client import Client

            self._client = Client(
                domain,
                {robot: self.settings.namespace(robot) for robot in self.settings.robots},
                name=PARTICIPANT,
                lockstep=self.settings.lockstep,
                stamped=self.settings.physics.cmd_vel_type == "stamped",
                check=self._check,
                waits_for=lambda: self._process.waits_for if self._process is not None else "",
            )
        self._client.connect()
        self._is_ready = True

    def _check(self) -> None:
        """Raises the reason if the simulation, or a program, has ended as it should not."""
        if self._process is None or self._process.has_ended:
            reason = self._process.error() if self._process is not None else GibsonSimError("it was closed")
            if isinstance(reason, AlreadyRunningError):
                raise reason
            raise SimulationEndedError(f"the simulation {'has ended' if self._is_ready else 'cannot start'}: {reason}")
        for program in self._programs:
            program.check()

    @property
    def _running(self) -> Client:
        self._check()
        assert self._client is not None
        return self._client

    # Time

    @property
    def time(self) -> float:
        """Simulation time since it began or was reset, s."""
        client = self._running
        client.catch_up()
        return client.now

    def step(self, seconds: float) -> None:
        """Lets time pass: in lockstep and while paused by whole ticks or steps, rounded up, exactly; else at least so long.

        Args:
            seconds: of simulation time.
        """
        client, physics = self._running, self.settings.physics
        if not (math.isfinite(seconds) and seconds > 0):
            raise ConfigError(f"step: seconds is {quoted(seconds)}, must be a number above 0")
        if client.is_paused:
            client.step(math.ceil(seconds * physics.step_hz - 1e-6), physics.step_hz)
        elif self.settings.lockstep:
            for _ in range(math.ceil(seconds * physics.publish_hz - 1e-6)):
                client.next_tick()
        else:
            client.catch_up()
            end = client.now + seconds
            while client.now < end:
                client.next_tick()

    def wait_until(self, condition: Callable[[], Any], timeout: float = 30.0, *, what: str = "") -> Any:
        """Lets time pass until a condition holds, which is looked at in every tick; returns its value.

        Args:
            condition: a function without arguments; any true value ends the wait.
            timeout: seconds of simulation time.
            what: names the condition in the error; empty = its source.

        Raises:
            WaitError: it does not hold in time.
        """
        client = self._running
        begin = client.now
        while not (value := condition()):
            if client.now - begin >= timeout - 1e-9:
                raise WaitError(f"waited {timeout:g} s of simulation time for {what or _source(condition)}; {self.summary()}")
            client.next_tick()
        return value

    def pause(self) -> None:
        """Holds time; ``step`` then makes physics steps."""
        self._running.set_playing(False)

    def play(self) -> None:
        """Lets time pass again."""
        self._running.set_playing(True)

    def reset(self) -> None:
        """Resets everything to the start, as if it had been started anew: time, poses, spawned and deleted entities; forgets what was received."""
        self._running.reset()

    # Things

    def spawn(self, thing: str, at: At, name: str = "") -> str:
        """Puts a thing on the floor; returns the name that it got.

        Args:
            thing: of the catalogue, such as ``chair``, a robot, or a file: URDF, SDF, mesh.
            at: x, y, yaw.
            name: empty = by the thing, with a number if that is taken.
        """
        return self._running.services.spawn(str(thing), _place(at), self._floor_z(), name)

    def move(self, name: str, at: At) -> None:
        """Puts an entity, also a robot, elsewhere on the floor, at rest."""
        self._running.services.move(name, _place(at), self._floor_z())

    def delete(self, name: str) -> None:
        """Removes an entity."""
        self._running.services.delete(name)

    def entities(self) -> dict[str, RobotPose]:
        """Returns the pose of every robot and body by its name."""
        client = self._running
        from gibson_sim.ros.client.client import robot_pose

        return {name: robot_pose(pose) for name, pose in client.services.poses().items()}

    def _floor_z(self) -> float:
        client = self._running
        try:
            return float(client.floor().info.origin.position.z)
        except GibsonSimError:  # a scene without a floor
            client.raise_if_ended()
            return 0.0

    # The robot

    def robot_pose(self, robot: str = "") -> RobotPose:
        """Returns the true pose of a robot; empty = the only, or first, one."""
        return self._running.pose(self._robot(robot))

    @property
    def contacts(self) -> list[Collision]:
        """What the robots collided with since the start or a reset; the ground, and what a gripper holds, do not count."""
        client = self._running
        client.catch_up()
        return client.collisions()

    def drive(self, linear: float, angular: float, seconds: float, *, robot: str = "") -> None:
        """Commands a velocity in every tick for some time, then a stop.

        Args:
            linear: m/s.
            angular: rad/s, counter-clockwise.
            seconds: of simulation time.
            robot: empty = the only, or first, one.
        """
        client, name = self._running, self._robot(robot)
        end = client.now + seconds
        while client.now < end - 1e-9:
            client.command(name, linear, angular)
            client.next_tick()
        client.command(name, 0.0, 0.0)
        client.next_tick()

    def drive_to(
        self, x: float, y: float, within: float = 0.2, *, timeout: float = 120.0, linear: float = 0.4, angular: float = 1.2,
        robot: str = "",
    ) -> None:  # fmt: skip
        """Drives a robot that can turn in place along the shortest path on the floor map, which does not know what a test spawned.

        Args:
            x: goal, map frame.
            y: the same.
            within: distance at which the goal is reached.
            timeout: seconds of simulation time.
            linear: greatest speed, m/s.
            angular: greatest yaw rate, rad/s.
            robot: empty = the only, or first, one.

        Raises:
            WaitError: it does not get there in time.
            SceneError: the goal, or the robot, is not on free floor, or no path connects them.
        """
        from gibson_sim.robots.path_tracking import PathFollower

        client, name = self._running, self._robot(robot)
        pose, begin, follower = client.pose(name), client.now, None
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
        """Publishes a goal (geometry_msgs/PoseStamped) for a navigation stack, once a node subscribes to it; time passes meanwhile.

        Args:
            x: map frame.
            y: the same.
            yaw: heading at the goal.
            topic: of the goal.
            patience: seconds of wall time for a subscriber.
        """
        self._running.send_goal(topic, *_place((x, y, yaw)), patience)

    def _robot(self, name: str) -> str:
        robots = self.settings.robots
        if name and name not in robots:
            raise ConfigError(f"robot {quoted(name)} is not in this simulation; it has: {', '.join(robots)}")
        return name or robots[0]

    def _path(self, start: tuple[float, float], goal: tuple[float, float], within: float) -> Any:
        """Returns the shortest path (N, 2), as far from obstacles as there is room for.

        Raises:
            SceneError: there is none.
        """
        if self._planner is None:
            self._planner = self._path_planners()
        failure = None
        for planner in self._planner:
            try:
                path = planner.path(start, goal)
            except SceneError as error:
                failure = error
                continue
            if math.dist(path[-1], goal) < within:
                return path
            failure = SceneError(
                f"the goal x {goal[0]:.2f} m, y {goal[1]:.2f} m is too near to an obstacle of the floor map for the robot; the nearest place "
                f"is x {path[-1][0]:.2f} m, y {path[-1][1]:.2f} m"
            )
        assert failure is not None
        raise failure

    def _path_planners(self) -> list[Any]:
        """Returns planners for the robot on the map, with less and less room to both sides of it."""
        import numpy as np

        from gibson_sim.maps.floor_map import FloorMap
        from gibson_sim.maps.paths import PathPlanner
        from gibson_sim.scenes.robot_files import load_robot

        grid = self._running.floor()
        data = np.asarray(grid.data, dtype=np.int8).reshape(grid.info.height, grid.info.width)
        origin = (grid.info.origin.position.x, grid.info.origin.position.y)
        floor = FloorMap(grid.info.resolution, origin, data > _OCCUPIED, data >= 0)
        first = self.settings.physics.robot.split(",")[0].rpartition("=")[2].strip()
        radius = load_robot(first).radius
        return [PathPlanner(floor, radius + room) for room in _ROOM]

    # Topics

    def topics(self) -> dict[str, str]:
        """Returns topic -> message type of the topics that have publishers now."""
        return self._running.topics()

    def subscribe(self, topic: str, kind: Any = None) -> None:
        """Begins to keep the messages of a topic; ``messages`` and ``latest`` do so at their first call.

        Args:
            topic: its name.
            kind: message class; needed only before the topic has a publisher.
        """
        self._running.subscribe(topic, kind)

    def messages(self, topic: str) -> Sequence[Any]:
        """Returns all messages of a topic since its subscription or a reset, the oldest first."""
        return self._running.messages(topic)

    def latest(self, topic: str, timeout: float = 10.0) -> Any:
        """Returns the newest message of a topic; where there is none yet, time passes until one arrives.

        Args:
            topic: its name.
            timeout: seconds of simulation time.
        """
        return self.wait_until(lambda: self._newest(topic), timeout, what=f"a message on {topic}")[0]

    def _newest(self, topic: str) -> Sequence[Any]:
        client = self._running
        if not client.is_subscribed(topic) and client.resolve(topic) not in client.topics() and client.now:
            return ()  # it may get a publisher while time passes
        return client.messages(topic)[-1:]

    # The robot's programs

    def start(
        self,
        command: Sequence[str],
        *,
        answers: str = "",
        environment: Mapping[str, str] | None = None,
        may_fail: bool = False,
        patience: float = 60.0,
    ) -> Program:
        """Starts a program of the robot in the domain of the simulation; it ends, with all that it started, at the end of the test at the latest.

        With ``answers``, every tick waits until the program has answered it, so that time passes as fast as both can, and the run repeats if the
        program's decisions do not depend on wall time. Without, the simulation runs in real time from now on, unless the setting ``rate`` is
        given: the program could not keep up with a faster one.

        Args:
            command: program and arguments, as for ``subprocess.Popen``.
            answers: rule of lockstep, ``TOPIC after TOPIC`` or ``TOPIC every SECONDS``, such as ``cmd_vel after scan``: what the program publishes
                in answer to what; empty = time does not wait for it.
            environment: further variables.
            may_fail: whether it may end with an exit code other than 0; otherwise the next call after that raises.
            patience: with ``answers``, seconds of wall time until it must publish the topic.
        """
        from gibson_sim.ros.client.answers import parse_rule

        client = self._running
        earlier: frozenset[tuple[int, ...]] = frozenset()
        if answers:
            earlier = client.publishers(parse_rule(answers).answer)
            if not self.settings.lockstep:
                raise ConfigError("answers is given, but time waits for nothing with lockstep=False: leave one of them out")
        elif self.settings.lockstep and not self.settings.has_rate:
            client.set_rate(1.0)
        program = Program(command, {**self.environment, **(environment or {})}, self._folder, may_fail=may_fail)
        self._programs.append(program)
        if answers:
            client.follow(answers, earlier, lambda: program.returncode is not None, patience)
        return program

    @property
    def programs(self) -> tuple[Program, ...]:
        """All programs that were started since the beginning of the test."""
        return tuple(self._programs)

    # What a report shows

    @property
    def log(self) -> str:
        """The end of the simulation's log."""
        return self._process.log if self._process is not None else ""

    def summary(self) -> str:
        """Returns time, poses and collisions in one line, as they are known; it never waits."""
        if self._client is None:
            return self._last_summary or "it is closed"
        client = self._client
        parts = [f"at {client.now:.3f} s"]
        for robot in self.settings.robots:
            pose = client.last_pose(robot)
            parts.append(f"{robot} at {pose}" if pose is not None else f"{robot}'s pose is not known")
        found = client.collisions()
        listed = ", ".join(map(str, found[-_MOST_COLLISIONS:]))
        more = f" ({len(found) - _MOST_COLLISIONS} more before)" if len(found) > _MOST_COLLISIONS else ""
        return "; ".join([*parts, f"collided with {listed}{more}" if found else "no collisions"])

    def report_sections(self) -> list[tuple[str, str]]:
        """Returns title and text of what the report of a failed test shows; it never waits."""
        sections = [("simulation", f"ROS domain {self.domain_id}, {self.summary()}"), ("log of the simulation", self.log)]
        for program in self._programs:
            code = program.returncode
            how = "which runs" if code is None else f"which ended with code {code}"
            sections.append((f"output of `{program.name}`, {how}", program.output))
        if self.bag is not None:
            sections.append(("recording", f"{self.bag}\nrepeat it: gibson-sim replay {self.bag} --verify"))
        return sections

    # End

    @property
    def is_usable(self) -> bool:
        """Whether it runs and can be reset for another test."""
        return self._client is not None and self._process is not None and not self._process.has_ended

    def begin_again(self) -> None:
        """Ends the programs and the subscriptions of a test, and resets, for the next test."""
        had_programs = bool(self._programs)
        self.stop_programs()
        client = self._running
        client.unsubscribe_all()
        if had_programs and not self.settings.has_rate:
            client.set_rate(self.settings.physics.rate)
        client.reset()
        if client.is_paused != self.settings.physics.start_paused:
            client.set_playing(not self.settings.physics.start_paused)
            if not client.is_paused:
                client.next_tick()

    def stop_programs(self) -> None:
        """Ends the programs that ``start`` started, the last one first."""
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
        return f"<HeadlessSimulation {self.settings.physics.scene}, ROS domain {self.domain_id}>"

    def __enter__(self) -> HeadlessSimulation:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()


def _place(at: Sequence[float]) -> At:
    try:
        x, y, yaw = (float(value) for value in at)
    except (TypeError, ValueError):
        raise ConfigError(f"the place {quoted(at)} must be three numbers: x and y in metres, yaw in radians") from None
    if not all(map(math.isfinite, (x, y, yaw))):
        raise ConfigError(f"the place {quoted(at)} must be three finite numbers: x and y in metres, yaw in radians")
    return x, y, yaw


def _source(condition: Callable[[], Any]) -> str:
    """Returns the source of a condition in one line, for a message."""
    try:
        text = textwrap.dedent(inspect.getsource(condition)).strip()
    except (OSError, TypeError, SyntaxError):
        return getattr(condition, "__name__", "the condition")
    return f"`{text.splitlines()[0].strip()}`"
