"""The physics of one scene: advances robots and bodies by commands and time. No ROS, no OpenGL; PyBullet only through ``bullet``.

``PhysicsWorld`` holds the static shapes of a scene, its robots and its bodies; its ``arms`` control arms, its ``attachments`` join any two links. The
rest of the module adds static shapes to the engine, and checks that no robot starts inside another object.
"""

from __future__ import annotations

import logging
import math
from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import replace
from types import TracebackType
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from gibson_sim.description.body import BodySpec
from gibson_sim.description.shapes import Shape
from gibson_sim.errors import CommandError, ConfigError, MeshError, PhysicsError, StartError
from gibson_sim.formats.load_mesh import MeshLoader
from gibson_sim.geometry.transforms import Mat4
from gibson_sim.physics.arms import ArmsInWorld
from gibson_sim.physics.attachments import Attachments
from gibson_sim.physics.body import BodyInWorld
from gibson_sim.physics.bullet import Bullet
from gibson_sim.physics.engine_types import EngineContact
from gibson_sim.physics.link_poses import LinkPoses, link_pose, link_twist
from gibson_sim.physics.proximity import Neighbour, neighbours
from gibson_sim.physics.robot import RobotInWorld
from gibson_sim.quoting import quoted
from gibson_sim.robots.collision_count import STANDING_HEIGHT, STANDING_NORMAL, CollisionCount
from gibson_sim.robots.drives.odometry_errors import OdometryCovariance, OdometryErrors
from gibson_sim.robots.joints.commands import JointCommand
from gibson_sim.robots.joints.grasping import GraspSettings
from gibson_sim.robots.joints.kinematics import ChainSolution
from gibson_sim.robots.joints.servo import ServoSettings
from gibson_sim.robots.sensor_specs import WheelOdometrySpec
from gibson_sim.robots.spec import RobotSpec
from gibson_sim.scenes.scene_meshes import scene_roots
from gibson_sim.scenes.spec import SceneSpec
from gibson_sim.types import NS_PER_S, Contact, JointStates, Odometry, Pose, SceneState, Vec3, VelocityCommand

GROUND = "ground"
"""Name of the infinite ground plane in contacts."""
_MAX_START_DEPTH = 0.05
"""Largest penetration depth of a robot at its start, metres: the engine pushes it out gently."""
_SMALLEST_AREA = 1e-12
"""Area below which triangles are dropped, m^2: their normals, and Bullet's contacts with them, are noise."""

logger = logging.getLogger(__name__)


class PhysicsWorld:
    """Robots and bodies among static shapes, in steps of exactly ``1 / step_hz`` seconds.

    Equal scenes and equal calls give bit-identical states. Not thread-safe. Close it, or use it in a ``with`` statement.
    """

    def __init__(
        self,
        scene: SceneSpec,
        *,
        step_hz: int = 240,
        cmd_vel_timeout: float = 0.5,
        seed: int = 0,
        grasping: GraspSettings | None = None,
        servo: ServoSettings | None = None,
    ) -> None:
        """Loads the scene.

        Args:
            scene: Static shapes, robots and bodies.
            step_hz: Physics steps per second of simulation time.
            cmd_vel_timeout: Simulation time after which a velocity command is stale, s.
            seed: Seed of the errors of wheel odometry.
            grasping: Settings of grippers; None = the defaults of ``GraspSettings``.
            servo: Settings of Cartesian servos; None = the defaults of ``ServoSettings``.

        Raises:
            ConfigError: a setting is out of range.
            RobotError: a robot cannot be loaded.
            PhysicsError: the engine reports an error, or a robot would start inside another object (StartError).
        """
        if not 1 <= step_hz <= 100_000 or step_hz != int(step_hz):
            raise ConfigError(f"step_hz is {step_hz}, must be a whole number from 1 to 100000")
        if not (math.isfinite(cmd_vel_timeout) and cmd_vel_timeout > 0):
            raise ConfigError(f"cmd_vel_timeout is {cmd_vel_timeout} s, must be a finite number above 0")
        names = [*(robot.name for robot in scene.robots), *(body.name for body in scene.bodies)]
        if len(set(names)) != len(names):
            raise PhysicsError(f"robots and bodies are named {', '.join(names)}; names must differ")
        self.step_hz = int(step_hz)
        self.warnings: list[str] = []
        """One line for each item that was omitted or replaced."""
        self.scene = scene
        """Current scene; its ``revision`` increases when a robot or a body is added or removed."""
        self._timeout_ns = round(cmd_vel_timeout * NS_PER_S)
        self._seed = seed
        self._step_count = 0
        self._bullet = Bullet(self.step_hz, scene.gravity)
        try:
            self._poses = LinkPoses(self._bullet)
            self.attachments = Attachments(self._bullet, self._body)
            """Joints between links of any two robots or bodies."""
            self.warnings += _add_static_shapes(self._bullet, scene)
            self._robots: dict[str, RobotInWorld] = {}
            self._bodies: dict[str, BodyInWorld] = {}
            """Bodies that are not robots."""
            self.arms = ArmsInWorld(
                self._bullet, self._robots, self._all, self.attachments,
                state_of=self.state_of, now_ns=lambda: self.stamp_ns,
                grasping=grasping or GraspSettings(), servo=servo or ServoSettings(),
            )  # fmt: skip
            """Arms of the robots: grasping, tool poses, inverse kinematics, servos."""
            self._commanded: dict[str, BodyInWorld] = {}
            """Bodies whose joints have been commanded."""
            for robot in scene.robots:
                self._load_robot(robot)
            for body in scene.bodies:
                self._load_body(body)
            self._poses.change_bodies(self._all())
            _check_starts(self._bullet, self._robots.values(), self._all())
            for first in self._all()[:1]:
                first.link_position(self._bullet, first.links[0])  # compiles the loops of poses before time runs
        except BaseException:
            self._bullet.close()
            raise
        logged = {warning for robot in self._robots.values() for warning in robot.model.warnings}  # when the robots were loaded
        for warning in self.warnings:
            if warning not in logged:
                logger.warning("%s", warning)

    # Robots and bodies

    @property
    def links(self) -> tuple[str, ...]:
        """Names ``<body>/<link>`` of all links, in the order of ``names``, the root of each body first."""
        return self._poses.links

    @property
    def names(self) -> tuple[str, ...]:
        """Names of all robots and bodies."""
        return (*self._robots, *self._bodies)

    def add(self, spec: RobotSpec | BodySpec) -> None:
        """Adds a robot or a body at its start, from the next step on.

        Raises:
            PhysicsError: the name is in use, the engine reports an error, or a robot would start inside another object (StartError).
            RobotError: the robot, or a joint of the body, cannot be loaded.
        """
        if spec.name in self._robots or spec.name in self._bodies:
            raise PhysicsError(f"the name {quoted(spec.name)} is taken; choose another one")
        if isinstance(spec, BodySpec):
            self._load_body(spec)
            self._changed(bodies=(*self.scene.bodies, spec), new_links=self._bodies[spec.name].full_links)
            return
        self._load_robot(spec)
        try:
            _check_starts(self._bullet, [self._robots[spec.name]], self._all())
        except StartError:
            self._bullet.remove(self._robots.pop(spec.name).engine_body)
            raise
        self._changed(robots=(*self.scene.robots, spec))

    def repopulate(self, robots: Iterable[RobotSpec], bodies: Iterable[BodySpec]) -> None:
        """Replaces all robots and bodies by the given ones, in order.

        The engine is reset, so later steps are bit-identical to those of a new world of this scene, regardless of its history. Bodies that are
        removed and added one by one leave traces in the engine's state, see ``bullet``.

        Raises:
            GibsonSimError: a robot or body cannot be added; the ones before it have been added.
        """
        self.attachments.detach_all()
        self._bullet.reset()
        for name in self.names:
            self.arms.remove(name)
        self._robots.clear()
        self._bodies.clear()
        self._commanded.clear()
        self._changed(robots=(), bodies=())
        specs: tuple[RobotSpec | BodySpec, ...] = (*robots, *bodies)
        for spec in specs:
            self.add(spec)

    def remove(self, name: str) -> None:
        """Removes a robot or a body; raises PhysicsError if the name is unknown."""
        body = self._body(name)
        self.attachments.detach_all(name)
        self._bullet.remove(body.engine_body)
        self._commanded.pop(name, None)
        self.arms.remove(name)
        self._robots.pop(name, None)
        self._bodies.pop(name, None)
        self._changed(
            robots=tuple(r for r in self.scene.robots if r.name != name),
            bodies=tuple(b for b in self.scene.bodies if b.name != name),
        )

    def set_state(self, name: str, pose: Pose | None = None, linear: Vec3 | None = None, angular: Vec3 | None = None) -> None:
        """Sets the pose or velocity of a robot or a body; None = unchanged. Wheel odometry does not change, as in reality.

        Args:
            name: Name of the robot or body.
            pose: T_world_root.
            linear: Velocity of the root's origin, m/s, world frame.
            angular: Angular velocity, rad/s, world frame.

        Raises:
            PhysicsError: the name is unknown.
        """
        self._body(name).set_state(self._bullet, pose, linear, angular)
        self.attachments.wake_beside(name)
        self._poses.forget()

    def body_pose(self, name: str) -> Pose:
        """Returns T_world_root of a robot or a body."""
        return self._body(name).root_state(self._bullet)[0]

    def body_twist(self, name: str) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Returns (linear m/s, angular rad/s), each (3,), of the root's origin, WORLD frame."""
        _, linear, angular = self._body(name).root_state(self._bullet)
        return linear, angular

    def is_static(self, name: str) -> bool:
        """Returns whether only ``set_state`` moves the root of a robot or a body."""
        return self._body(name).static

    def bounds(self, name: str, T_frame_world: Mat4 | None = None) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Returns the minimum and maximum corner, each (3,), metres, of the bounding box of the collision shapes.

        Args:
            name: Name of the robot or body.
            T_frame_world: (4, 4), transform to the frame in which the box is axis-aligned and its corners are given; None = the world.
        """
        return self._body(name).bounds(self._bullet, np.eye(4) if T_frame_world is None else T_frame_world)

    def static_bounds(self) -> tuple[NDArray[np.float64], NDArray[np.float64]] | None:
        """Returns the minimum and maximum corner, each (3,), metres, of the scene's static shapes, without an infinite ground; None = no shapes."""
        return self._bullet.static_bounds()

    # Contacts

    def contacts(self, name: str | None = None) -> tuple[Contact, ...]:
        """Returns the contact points of the last step.

        Args:
            name: Robot or body, which is always ``a`` in the result; None = all contacts, each point once, static shapes always ``b``.
        """
        return tuple(
            self._contact(point) for point in self._bullet.contacts(None if name is None else self._body(name).engine_body)
        )

    def _contact(self, point: EngineContact) -> Contact:
        body, other = self._body(point.name), self._robots.get(point.other) or self._bodies.get(point.other)
        link_a, link_b = body.link_of_row(point.link), "" if other is None else other.link_of_row(point.other_link)
        return Contact(point.name, link_a, point.other, link_b, point.position, point.normal, point.force, point.distance)

    def collisions(self, robot: str) -> CollisionCount:
        """Returns the collisions of a robot since the first call, or since a reset; ``robots.collision_count`` defines what counts.

        Raises:
            CommandError: the robot does not exist.
        """
        return self.arms.collision_count(robot, self.step_hz)

    def touching(self, robot: str) -> tuple[str, ...]:
        """Returns the sorted names of the objects that a robot collided with in the last step; ``robots.collision_count`` defines what counts.

        Raises:
            CommandError: the robot does not exist.
        """
        return self.arms.touching(robot)

    def neighbours(self, name: str, link: str, radius: float) -> tuple[Neighbour, ...]:
        """Returns the links of other robots and bodies within ``radius`` metres of a link's surface, nearest first.

        Raises:
            PhysicsError: the body or link does not exist.
        """
        return neighbours(self._bullet, self._body(name), link, self._all(), radius)

    # Commands and time

    @property
    def step_count(self) -> int:
        """Number of steps since loading."""
        return self._step_count

    @property
    def stamp_ns(self) -> int:
        """Simulation time since loading, ns, rounded down once, so that it does not drift."""
        return self._step_count * NS_PER_S // self.step_hz

    def command(self, robot: str, command: VelocityCommand) -> None:
        """Applies ``command`` from the next step on, until ``cmd_vel_timeout`` after its stamp; a stamp in the future counts as now.

        Raises:
            CommandError: the robot does not exist or has no drive.
        """
        driven = self._robot(robot)
        if driven.drive is None:
            raise CommandError(
                f"robot {quoted(robot)} has no drive, so it accepts no velocity commands; add one to its robot.yaml"
            )
        driven.command = command if command.stamp_ns <= self.stamp_ns else replace(command, stamp_ns=self.stamp_ns)

    def command_joints(self, name: str, command: JointCommand) -> None:
        """Moves joints of a robot (not those of its drive), or of a body, from the next step on.

        Raises:
            CommandError: the robot, body or joint does not exist, or the joint cannot execute the command.
        """
        if name in self._robots:
            self.arms.command_joints(name, command)
            return
        body = self._jointed(name)
        body.command_joints(self._bullet, command, self.stamp_ns)
        self._commanded[name] = body

    def step(self, steps: int = 1) -> None:
        """Advances by ``steps``; limits and timeouts of commands are applied in every step."""
        bullet, dt = self._bullet, 1.0 / self.step_hz
        step_ns = round(dt * NS_PER_S)
        robots, commanded = tuple(self._robots.values()), tuple(self._commanded.values())
        self._poses.pass_time(steps * dt)
        for _ in range(steps):
            now_ns = self.stamp_ns
            self.arms.before_step(now_ns, step_ns)
            for robot in robots:
                robot.actuate(bullet, now_ns, self._timeout_ns, dt)
            for body in commanded:
                body.actuate_joints(bullet, now_ns, dt)
            self.attachments.before_step()
            bullet.step()
            self.attachments.after_step()
            self._step_count += 1
            for robot in robots:
                robot.read_wheels(bullet, dt)
            self.arms.after_step(self.stamp_ns)

    def reset(self, *, keep_time: bool = False) -> None:
        """Moves all robots and bodies back to their starts, at rest, with zero odometry and no command.

        The engine is reset: later steps are bit-identical to those of a new world of ``scene``.

        Args:
            keep_time: Keep the simulation time (many ROS nodes cannot handle a jump back); False = reset it to 0.
        """
        self.attachments.detach_all()
        self._commanded.clear()
        self._bullet.reset()
        for body in self._all():
            body.load(self._bullet)
        self.arms.reset()
        self._poses.forget()
        if not keep_time:
            self._step_count = 0

    def set_step_count(self, steps: int) -> None:
        """Sets the time to ``steps`` steps after loading; nothing moves. Drops all commands, since their stamps refer to the old time.

        Raises:
            PhysicsError: ``steps`` is negative.
        """
        if steps < 0:
            raise PhysicsError(f"step count is {steps}, must be 0 or more")
        self._step_count = steps
        self._poses.forget()
        for body in (*self._robots.values(), *self._commanded.values()):
            body.forget_commands(self._bullet, self.stamp_ns)
        self.arms.forget_commands()

    # State

    def state(self) -> SceneState:
        """Returns the current poses of all links; the arrays are read-only and do not change later."""
        self._bullet.check_open()
        return self._poses.state(self.stamp_ns, self._step_count, self.scene.revision)

    def state_of(self, name: str) -> SceneState:
        """Returns the current poses of at least the links of one robot or body, for sensors that measure between two ticks."""
        return self._poses.state_of(self._body(name), self.stamp_ns, self._step_count, self.scene.revision)

    def base_pose(self, robot: str) -> Pose:
        """Returns T_world_base."""
        return link_pose(self.state(), self._base(robot))

    def base_twist(self, robot: str) -> tuple[Vec3, Vec3]:
        """Returns linear (m/s) and angular (rad/s) velocity of the base's origin relative to the world, in the BASE frame."""
        return link_twist(self.state(), self._base(robot))

    def joint_states(self, name: str) -> JointStates:
        """Returns the states of the movable joints in the order of the URDF; positions of continuous joints count full turns."""
        body = self._jointed(name)
        indices = [body.engine_body.joint_indices[joint] for joint in body.moving_joints]
        reading = self._bullet.joint_reading(body.engine_body, indices)
        return JointStates(body.moving_joints, reading.positions, reading.velocities, reading.efforts)

    def joint_setpoints(self, robot: str) -> dict[str, float]:
        """Returns the current setpoints of joints that follow a trajectory, radians or metres; other joints are missing."""
        motors, now_ns = self._body(robot).motors, self.stamp_ns
        if motors is None:
            return {}
        setpoints = {name: motors.setpoint(name, now_ns) for name in motors.names}
        return {name: position for name, position in setpoints.items() if position is not None}

    def solve_chain(
        self,
        name: str,
        link: str,
        target: Pose,
        *,
        joints: Sequence[str] | None = None,
        rest: Mapping[str, float] | None = None,
        orientation: bool = True,
    ) -> ChainSolution:
        """Solves the inverse kinematics of a link for ``target`` (T_world_link) at the current pose of the root; nothing moves.

        Args:
            name: Name of a robot or body.
            link: Link at the end of the chain.
            target: Target pose of the link.
            joints: Joints that may move; None = all between the root and the link.
            rest: Rest positions that redundant joints approach.
            orientation: Whether the orientation of the target counts.

        Raises:
            PhysicsError: the body does not exist.
            CommandError: the link or a joint does not exist, or no joint moves the link.
        """
        return self._body(name).solve_chain(self._bullet, link, target, joints=joints, rest=rest, orientation=orientation)

    def odometry(self, robot: str) -> Odometry:
        """Returns the wheel odometry; for a robot without a drive, the origin of its odom frame."""
        drive = self._robot(robot).drive
        return drive.wheel_odometry.odometry if drive is not None else Odometry(0.0, 0.0, 0.0, 0.0, 0.0)

    def odometry_covariance(self, robot: str) -> OdometryCovariance:
        """Returns the covariance of ``odometry``, from the error model in the robot's file."""
        drive = self._robot(robot).drive
        return drive.wheel_odometry.covariance() if drive is not None else OdometryErrors(WheelOdometrySpec()).covariance()

    def cast_rays(
        self, origins: ArrayLike, directions: ArrayLike, range_max: float, ignore: str | None = None
    ) -> NDArray[np.float64]:
        """Returns the distance to the first hit of every ray, (N,), metres; +inf = no hit within ``range_max``.

        Args:
            origins: (N, 3), world frame, metres.
            directions: (N, 3), world frame, unit vectors.
            range_max: Length of the rays, metres.
            ignore: Robot that rays pass through, e.g. the one that carries the sensor.
        """
        starts = np.asarray(origins, dtype=np.float64).reshape(-1, 3)
        ends = starts + np.asarray(directions, dtype=np.float64).reshape(-1, 3) * range_max
        body = None if ignore is None else self._robot(ignore).engine_body
        return self._bullet.cast_rays(starts, ends, body) * range_max

    def close(self) -> None:
        """Frees the engine; a second call does nothing, any other use afterwards raises PhysicsError."""
        self._bullet.close()

    def __enter__(self) -> PhysicsWorld:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None) -> None:
        self.close()

    # Inside

    def _robot(self, name: str) -> RobotInWorld:
        if name not in self._robots:
            raise CommandError(f"no robot {quoted(name)} in this world; known: {', '.join(self._robots) or 'none'}")
        return self._robots[name]

    def _jointed(self, name: str) -> BodyInWorld:
        if name not in self.names:
            raise CommandError(f"no robot or body {quoted(name)} in this world; known: {', '.join(self.names) or 'none'}")
        return self._body(name)

    def _body(self, name: str) -> BodyInWorld:
        """Returns a robot or a body; raises PhysicsError if the name is unknown."""
        body = self._robots.get(name) or self._bodies.get(name)
        if body is None:
            raise PhysicsError(f"no robot or body {quoted(name)} in this world; known: {', '.join(self.names) or 'none'}")
        return body

    def _all(self) -> tuple[BodyInWorld, ...]:
        """Returns all robots, then all bodies."""
        return (*self._robots.values(), *self._bodies.values())

    def _load_robot(self, spec: RobotSpec) -> None:
        self._robots[spec.name] = robot = RobotInWorld(self._bullet, spec, self._seed)
        self.warnings += robot.warnings

    def _load_body(self, spec: BodySpec) -> None:
        self._bodies[spec.name] = body = BodyInWorld(
            self._bullet, spec.name, spec.model, spec.start, static=spec.static, joints=spec.joints
        )
        self.warnings += body.warnings

    def _changed(self, new_links: tuple[str, ...] = (), **changes: Any) -> None:
        """Updates the scene; ``new_links`` are the links of a body appended last, so that adding thousands of bodies is fast."""
        self.scene = replace(self.scene, revision=self.scene.revision + 1, **changes)
        self._poses.change_bodies(self._all(), new_links)

    def _base(self, robot: str) -> str:
        """Returns the full name of the robot's base link."""
        spec = self._robot(robot).spec
        return f"{spec.name}/{spec.base_link}"


def _add_static_shapes(bullet: Bullet, scene: SceneSpec) -> list[str]:
    """Adds the ground and all collision shapes of a scene to the engine; returns one line for each omitted shape."""
    warnings: list[str] = []
    if scene.ground_z is not None:
        bullet.add_static(bullet.plane_shape(), Pose((0.0, 0.0, scene.ground_z)), GROUND, scene.ground_friction)
    loader = MeshLoader(scene_roots(scene), textures=False)
    known: dict[Shape, Sequence[int]] = {}
    for collision in scene.collisions:
        if collision.shape not in known:
            known[collision.shape] = _static_shape(bullet, loader, collision.shape, collision.name, warnings)
        bullet.add_static(known[collision.shape], collision.pose, collision.name, collision.friction)
    return warnings


def _static_shape(bullet: Bullet, loader: MeshLoader, shape: Shape, name: str, warnings: list[str]) -> Sequence[int]:
    """Returns the shape indices of a shape; an empty list, with a warning, for a mesh without collision geometry."""
    if shape.kind == "box":
        return bullet.box_shape(shape.size)
    if shape.kind == "sphere":
        return bullet.sphere_shape(shape.size[0])
    if shape.kind == "cylinder":
        return bullet.cylinder_shape(shape.size[0], shape.size[1])
    if shape.kind == "capsule":
        return bullet.capsule_shape(shape.size[0], shape.size[1])
    try:
        vertices, triangles = loader.shape(shape).merged()
    except MeshError as error:
        warnings.append(f"collision {quoted(name)} is left out: {error}")
        return []
    if shape.kind != "mesh":  # an ellipsoid or a cone
        return bullet.hull_shape(vertices, shape.kind)
    valid = non_degenerate_triangles(vertices, triangles)
    if not len(valid):
        warnings.append(f"collision {quoted(name)} is left out: {shape.mesh} has no triangle with an area")
        return []
    return bullet.mesh_shape(vertices, valid, shape.mesh)


def non_degenerate_triangles(vertices: NDArray[np.float64], triangles: ArrayLike) -> NDArray[np.int64]:
    """Returns the non-degenerate triangles with finite vertices, of ``triangles``, (T, 3)."""
    corners: NDArray[np.int64] = np.asarray(triangles, dtype=np.int64).reshape(-1, 3)
    a, b, c = (vertices[corners[:, i]] for i in range(3))
    area = np.linalg.norm(np.cross(b - a, c - a), axis=1) / 2
    valid: NDArray[np.int64] = corners[np.isfinite(area) & (area > _SMALLEST_AREA)]
    return valid


def _check_starts(bullet: Bullet, robots: Iterable[BodyInWorld], others: Collection[BodyInWorld]) -> None:
    """Checks that robots at their starts are not inside other objects.

    Args:
        bullet: The engine.
        robots: Robots to check.
        others: All robots and bodies; static shapes are always checked.

    Raises:
        StartError: a robot penetrates an object deeper than allowed. Surfaces that it stands on are ignored.
    """
    for robot in robots:
        x, y, z = robot.root_state(bullet)[0].position
        deepest, where = _MAX_START_DEPTH, ""
        for gap in bullet.overlaps(robot.engine_body, [other.engine_body for other in others if other is not robot]):
            stands = gap.normal[2] > STANDING_NORMAL and gap.position[2] < z + STANDING_HEIGHT
            if -gap.distance > deepest and not stands:
                deepest, where = -gap.distance, gap.other
        if where:
            raise StartError(
                f"robot {quoted(robot.name)} would start at ({x:.2f}, {y:.2f}, {z:.2f}), {deepest:.2f} m deep in {quoted(where)}; at most "
                f"{_MAX_START_DEPTH:g} m are allowed: choose a free place as its start"
            )
