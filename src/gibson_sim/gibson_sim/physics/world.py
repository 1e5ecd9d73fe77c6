"""The physics of one scene: commands and time go in, poses come out. No ROS, no OpenGL; PyBullet only through ``bullet``."""

from __future__ import annotations

import logging
import math
from collections.abc import Collection, Iterable, Sequence
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
from gibson_sim.physics.arm_commands import ArmCommands
from gibson_sim.physics.arms import Arms
from gibson_sim.physics.attachments import Attachments
from gibson_sim.physics.body import BodyInWorld
from gibson_sim.physics.bullet import Bullet
from gibson_sim.physics.engine_types import EngineContact
from gibson_sim.physics.link_poses import LinkPoses, link_pose, link_twist
from gibson_sim.physics.proximity import Neighbour, neighbours
from gibson_sim.physics.robot import RobotInWorld
from gibson_sim.quoting import quoted
from gibson_sim.robots.collision_count import STANDING_HEIGHT, STANDING_NORMAL
from gibson_sim.robots.drives.odometry_errors import OdometryCovariance, OdometryErrors
from gibson_sim.robots.joints.commands import JointCommand
from gibson_sim.robots.joints.grasping import GraspSettings
from gibson_sim.robots.joints.servo import ServoSettings
from gibson_sim.robots.sensor_specs import WheelOdometrySpec
from gibson_sim.robots.spec import RobotSpec
from gibson_sim.scenes.scene_meshes import scene_roots
from gibson_sim.scenes.spec import SceneSpec
from gibson_sim.types import NS_PER_S, Contact, JointStates, Odometry, Pose, SceneState, Vec3, VelocityCommand

_DEEPEST = 0.05
"""Metres that a robot may reach into something where it starts: it is pushed out gently."""


def check_starts(bullet: Bullet, robots: Iterable[BodyInWorld], others: Collection[BodyInWorld]) -> None:
    """Checks where robots were just put.

    Args:
        bullet: The engine.
        robots: Stand at their starts.
        others: All robots and bodies; static shapes count in any case.

    Raises:
        StartError: one reaches deeper into something than is allowed. What it stands on does not count.
    """
    for robot in robots:
        x, y, z = robot.root_state(bullet)[0].position
        deepest, where = _DEEPEST, ""
        for gap in bullet.overlaps(robot.body, [one.body for one in others if one is not robot]):
            stands = gap.normal[2] > STANDING_NORMAL and gap.position[2] < z + STANDING_HEIGHT
            if -gap.distance > deepest and not stands:
                deepest, where = -gap.distance, gap.other
        if where:
            raise StartError(
                f"robot {quoted(robot.name)} would start at ({x:.2f}, {y:.2f}, {z:.2f}), {deepest:.2f} m deep in {quoted(where)}; at most "
                f"{_DEEPEST:g} m are allowed: choose a free place as its start"
            )


GROUND = "ground"
"""What contacts call the endless plane."""
_SMALLEST_AREA = 1e-12
"""Square metres: smaller triangles are dropped; their normal is noise, and Bullet's contacts with them too."""


def add_static_shapes(bullet: Bullet, scene: SceneSpec) -> list[str]:
    """Puts the ground and all collision shapes of a scene into the engine; returns what was left out, one line each."""
    warnings: list[str] = []
    if scene.ground_z is not None:
        bullet.add_static(bullet.plane_shape(), Pose((0.0, 0.0, scene.ground_z)), GROUND)
    loader = MeshLoader(scene_roots(scene), textures=False)
    known: dict[Shape, Sequence[int]] = {}
    for collision in scene.collisions:
        if collision.shape not in known:
            known[collision.shape] = _static_shape(bullet, loader, collision.shape, collision.name, warnings)
        bullet.add_static(known[collision.shape], collision.pose, collision.name)
    return warnings


def _static_shape(bullet: Bullet, loader: MeshLoader, shape: Shape, name: str, warnings: list[str]) -> Sequence[int]:
    """Returns the engine's numbers of a shape; none, with a warning, for a mesh without collision geometry."""
    if shape.kind == "box":
        return bullet.box_shape(shape.size)
    if shape.kind == "sphere":
        return bullet.sphere_shape(shape.size[0])
    if shape.kind == "cylinder":
        return bullet.cylinder_shape(shape.size[0], shape.size[1])
    try:
        vertices, triangles = loader.shape(shape).merged()
    except MeshError as error:
        warnings.append(f"collision {quoted(name)} is left out: {error}")
        return []
    sound = sound_triangles(vertices, triangles)
    if not len(sound):
        warnings.append(f"collision {quoted(name)} is left out: {shape.mesh} has no triangle with an area")
        return []
    return bullet.mesh_shape(vertices, sound, shape.mesh)


def sound_triangles(vertices: NDArray[np.float64], triangles: ArrayLike) -> NDArray[np.int64]:
    """Returns those of ``triangles``, (T, 3), that have an area and finite corners."""
    corners: NDArray[np.int64] = np.asarray(triangles, dtype=np.int64).reshape(-1, 3)
    a, b, c = (vertices[corners[:, i]] for i in range(3))
    area = np.linalg.norm(np.cross(b - a, c - a), axis=1) / 2
    sound: NDArray[np.int64] = corners[np.isfinite(area) & (area > _SMALLEST_AREA)]
    return sound


logger = logging.getLogger(__name__)


class PhysicsWorld(ArmCommands):
    """Robots among static shapes, in steps of exactly ``1 / step_hz`` seconds.

    Equal scenes and equal calls give bit-equal states. Not thread-safe. Close it, or use it in a ``with`` statement.
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
            scene: What there is.
            step_hz: Physics steps for each second of simulation time.
            cmd_vel_timeout: Seconds of simulation time after which a command no longer counts.
            seed: Of the errors of wheel odometry.
            grasping: How grippers hold; None = as ``GraspSettings`` has it.
            servo: How tools move at a velocity; None = as ``ServoSettings`` has it.

        Raises:
            ConfigError: a setting is impossible.
            RobotError: a robot cannot be used.
            PhysicsError: the engine refuses, or a robot would start inside of something (StartError).
        """
        if step_hz != int(step_hz) or not 1 <= step_hz <= 100_000:
            raise ConfigError(f"step_hz is {step_hz}, must be a whole number from 1 to 100000")
        if not (math.isfinite(cmd_vel_timeout) and cmd_vel_timeout > 0):
            raise ConfigError(f"cmd_vel_timeout is {cmd_vel_timeout} s, must be a finite number above 0")
        names = [*(robot.name for robot in scene.robots), *(body.name for body in scene.bodies)]
        if len(set(names)) != len(names):
            raise PhysicsError(f"robots and bodies are named {', '.join(names)}; names must differ")
        self.step_hz = int(step_hz)
        self.warnings: list[str] = []
        """What was left out or replaced, one line each."""
        self.scene = scene
        """What there is now; its ``revision`` counts what was added and removed."""
        self._timeout_ns = round(cmd_vel_timeout * NS_PER_S)
        self._seed = seed
        self._step_count = 0
        self._bullet = Bullet(self.step_hz, scene.gravity)
        try:
            self._poses = LinkPoses(self._bullet)
            self.attachments = Attachments(self._bullet, self._one)
            """What holds links together."""
            self.warnings += add_static_shapes(self._bullet, scene)
            self._robots: dict[str, RobotInWorld] = {}
            self._bodies: dict[str, BodyInWorld] = {}
            rules = grasping or GraspSettings(), servo or ServoSettings()
            self._arms = Arms(self._bullet, self._robots, self._all, self.attachments, *rules)
            self._commanded: dict[str, BodyInWorld] = {}
            """Bodies, not robots, whose joints were told something."""
            for robot in scene.robots:
                self._load_robot(robot)
            for body in scene.bodies:
                self._load_body(body)
            self._poses.change_bodies(self._all())
            check_starts(self._bullet, self._robots.values(), self._all())
        except BaseException:
            self._bullet.close()
            raise
        said = {warning for robot in self._robots.values() for warning in robot.model.warnings}  # by whoever loaded them
        for warning in self.warnings:
            if warning not in said:
                logger.warning("%s", warning)

    @property
    def links(self) -> tuple[str, ...]:
        """Names ``<body>/<link>`` of all links, in the order of ``names``, the roots first."""
        return self._poses.links

    @property
    def names(self) -> tuple[str, ...]:
        """Names of all robots and bodies."""
        return (*self._robots, *self._bodies)

    def add_robot(self, spec: RobotSpec) -> None:
        """Puts a robot into the world, at its start, from the next step on.

        Raises:
            PhysicsError: the name is taken, the engine refuses, or it would start inside of something (StartError).
            RobotError: the robot cannot be used.
        """
        self._check_new(spec.name)
        self._load_robot(spec)
        try:
            check_starts(self._bullet, [self._robots[spec.name]], self._all())
        except StartError:
            self._bullet.remove(self._robots.pop(spec.name).body)
            raise
        self._changed(robots=(*self.scene.robots, spec))

    def add_body(self, spec: BodySpec) -> None:
        """Puts a body into the world, at its start, from the next step on.

        Raises:
            PhysicsError: the name is taken, or the engine refuses.
            RobotError: its joints cannot be used.
        """
        self._check_new(spec.name)
        self._load_body(spec)
        self._changed(bodies=(*self.scene.bodies, spec), new_links=self._bodies[spec.name].full_links)

    def repopulate(self, robots: Iterable[RobotSpec], bodies: Iterable[BodySpec]) -> None:
        """Removes all robots and bodies, and adds these, in their order: equal order, equal physics, whatever was there before.

        Raises:
            GibsonSimError: one of them cannot be added; those before it are there.
        """
        for name in self.names:
            self.remove(name)
        for robot in robots:
            self.add_robot(robot)
        for body in bodies:
            self.add_body(body)

    def remove(self, name: str) -> None:
        """Takes a robot or a body out of the world; PhysicsError where there is none of this name."""
        one = self._one(name)
        self.attachments.detach_all(name)
        self._bullet.remove(one.body)
        self._commanded.pop(name, None)
        self._arms.remove(name)
        self._robots.pop(name, None)
        self._bodies.pop(name, None)
        self._changed(
            robots=tuple(r for r in self.scene.robots if r.name != name),
            bodies=tuple(b for b in self.scene.bodies if b.name != name),
        )

    def set_state(self, name: str, pose: Pose | None = None, linear: Vec3 | None = None, angular: Vec3 | None = None) -> None:
        """Moves a robot or a body, or changes its velocity; what is None stays. Wheel odometry does not notice, as in reality.

        Args:
            name: which.
            pose: T_world_root.
            linear: velocity of the root's origin, m/s, world frame.
            angular: rad/s, world frame.

        Raises:
            PhysicsError: there is none of this name.
        """
        self._one(name).set_state(self._bullet, pose, linear, angular)
        self.attachments.wake_beside(name)
        self._poses.forget()

    def body_pose(self, name: str) -> Pose:
        """Returns T_world_root of a robot or a body."""
        return self._one(name).root_state(self._bullet)[0]

    def body_twist(self, name: str) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Returns (linear m/s, angular rad/s), each (3,), of the root's origin, WORLD frame."""
        _, linear, angular = self._one(name).root_state(self._bullet)
        return linear, angular

    def is_static(self, name: str) -> bool:
        """Returns whether nothing moves it but ``set_state``."""
        return self._one(name).static

    def bounds(self, name: str, T_frame_world: Mat4 | None = None) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Returns the lowest and the highest corner, each (3,), metres, of the box about its collision shapes.

        Args:
            name: which robot or body.
            T_frame_world: (4, 4): the frame whose axes the box has and whose coordinates are returned; None = the world.
        """
        return self._one(name).bounds(self._bullet, np.eye(4) if T_frame_world is None else T_frame_world)

    def contacts(self, name: str | None = None) -> tuple[Contact, ...]:
        """Returns the points at which things touched in the last step.

        Args:
            name: A robot or a body: it is always ``a``; None = all of them, each point once, static shapes always ``b``.
        """
        return tuple(self._contact(point) for point in self._bullet.contacts(None if name is None else self._one(name).body))

    def _contact(self, point: EngineContact) -> Contact:
        one, other = self._one(point.name), self._robots.get(point.other) or self._bodies.get(point.other)
        link_a, link_b = one.link_of_row(point.link), "" if other is None else other.link_of_row(point.other_link)
        return Contact(point.name, link_a, point.other, link_b, point.position, point.normal, point.force, point.distance)

    def neighbours(self, name: str, link: str, radius: float) -> tuple[Neighbour, ...]:
        """Returns the links of other robots and bodies within ``radius`` metres of a link's surface, the nearest first.

        Raises:
            PhysicsError: there is no such body or link.
        """
        return neighbours(self._bullet, self._one(name), link, self._all(), radius)

    @property
    def step_count(self) -> int:
        """Steps since load."""
        return self._step_count

    @property
    def stamp_ns(self) -> int:
        """Simulation time since load, nanoseconds, rounded down once: it does not drift."""
        return self._step_count * NS_PER_S // self.step_hz

    def command(self, robot: str, command: VelocityCommand) -> None:
        """Obeys ``command`` from the next step on, until ``cmd_vel_timeout`` after its stamp; a stamp in the future means now.

        Raises:
            CommandError: there is no such robot, or it cannot drive.
        """
        one = self._robot(robot)
        if one.drive is None:
            raise CommandError(f"robot {quoted(robot)} has no drive and cannot obey a velocity; give it one in its robot.yaml")
        one.command = command if command.stamp_ns <= self.stamp_ns else replace(command, stamp_ns=self.stamp_ns)

    def command_joints(self, name: str, command: JointCommand) -> None:
        """Moves joints of a robot (not those of its drive), or of a body, from the next step on.

        Raises:
            CommandError: there is no such robot, body or joint, or it cannot move so.
        """
        one = self._jointed(name)
        one.command_joints(self._bullet, command, self.stamp_ns)
        if name in self._bodies:
            self._commanded[name] = one
        else:
            self._arms.notice(name, command, self.stamp_ns)

    def step(self, steps: int = 1) -> None:
        """Advances by ``steps``; limits and time-outs of the commands count in every one."""
        bullet, dt = self._bullet, 1.0 / self.step_hz
        step_ns = round(dt * NS_PER_S)
        robots, commanded = tuple(self._robots.values()), tuple(self._commanded.values())
        self._poses.pass_time(steps * dt)
        for _ in range(steps):
            now_ns = self.stamp_ns
            self._arms.before_step(now_ns, step_ns)
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
            self._arms.after_step(self.stamp_ns)

    def state(self) -> SceneState:
        """Returns the poses of all links now; its arrays are read-only and stay as they are."""
        self._bullet.check_open()
        return self._poses.state(self.stamp_ns, self._step_count, self.scene.revision)

    def state_of(self, name: str) -> SceneState:
        """Returns the poses of at least the links of one robot or body now: what a sensor needs between two states."""
        return self._poses.state_of(self._one(name), self.stamp_ns, self._step_count, self.scene.revision)

    def base_pose(self, robot: str) -> Pose:
        """Returns T_world_base."""
        return link_pose(self.state(), self._base(robot))

    def base_twist(self, robot: str) -> tuple[Vec3, Vec3]:
        """Returns linear (m/s) and angular (rad/s) velocity of the base's origin against the world, in the BASE frame."""
        return link_twist(self.state(), self._base(robot))

    def joint_states(self, name: str) -> JointStates:
        """Returns the moving joints of a robot or a body in the order of its URDF; continuous joints count their turns."""
        one = self._jointed(name)
        reading = self._bullet.joint_reading(one.body, [one.body.joint_indices[joint] for joint in one.moving_joints])
        return JointStates(one.moving_joints, reading.positions, reading.velocities, reading.efforts)

    def odometry(self, robot: str) -> Odometry:
        """Returns what the wheels say; a robot without a drive stays at the origin of its odom frame."""
        drive = self._robot(robot).drive
        return drive.wheel_odometry.odometry if drive is not None else Odometry(0.0, 0.0, 0.0, 0.0, 0.0)

    def odometry_covariance(self, robot: str) -> OdometryCovariance:
        """Returns how well ``odometry`` is known, by the errors that the robot's file gives to it."""
        drive = self._robot(robot).drive
        return drive.wheel_odometry.covariance() if drive is not None else OdometryErrors(WheelOdometrySpec()).covariance()

    def cast_rays(
        self, origins: ArrayLike, directions: ArrayLike, range_max: float, ignore: str | None = None
    ) -> NDArray[np.float64]:
        """Returns the distance to the first hit of every ray, (N,), metres; +inf = nothing within ``range_max``.

        Args:
            origins: (N, 3), world frame, metres.
            directions: (N, 3), world frame, unit vectors.
            range_max: Length of the rays, metres.
            ignore: Body that rays pass through: a robot does not see itself.
        """
        starts = np.asarray(origins, dtype=np.float64).reshape(-1, 3)
        ends = starts + np.asarray(directions, dtype=np.float64).reshape(-1, 3) * range_max
        body = None if ignore is None else self._robot(ignore).body
        return self._bullet.cast_rays(starts, ends, body) * range_max

    def reset(self, *, keep_time: bool = False) -> None:
        """Puts all robots and bodies back to where they started, at rest, with zero odometry and no command.

        Args:
            keep_time: Let simulation time run on (many ROS nodes cannot bear a jump back); False = it is 0 again.
        """
        # Loading anew, not moving: contacts and impulses that Bullet remembers would make the second run differ from the first.
        self.attachments.detach_all()
        self._commanded.clear()
        for one in self._all():
            self._bullet.remove(one.body)
        for one in self._all():
            one.load(self._bullet)
        self._arms.reset()
        self._poses.forget()
        if not keep_time:
            self._step_count = 0

    def set_step_count(self, steps: int) -> None:
        """Sets time to that of ``steps`` steps after load; nothing moves. Robots and bodies forget their commands, whose times are of the old one.

        Raises:
            PhysicsError: ``steps`` is negative.
        """
        if steps < 0:
            raise PhysicsError(f"step count is {steps}, must be 0 or more")
        self._step_count = steps
        self._poses.forget()
        for one in (*self._robots.values(), *self._commanded.values()):
            one.forget_commands(self._bullet, self.stamp_ns)
        self._arms.forget_commands()

    def close(self) -> None:
        """Frees the engine; a second call does nothing, any other use afterwards raises PhysicsError."""
        self._bullet.close()

    def __enter__(self) -> PhysicsWorld:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None) -> None:
        self.close()

    def _robot(self, name: str) -> RobotInWorld:
        if name not in self._robots:
            raise CommandError(f"no robot {quoted(name)} in this world; known: {', '.join(self._robots) or 'none'}")
        return self._robots[name]

    def _jointed(self, name: str) -> BodyInWorld:
        if name not in self.names:
            raise CommandError(f"no robot or body {quoted(name)} in this world; known: {', '.join(self.names) or 'none'}")
        return self._one(name)

    def _one(self, name: str) -> BodyInWorld:
        one = self._robots.get(name) or self._bodies.get(name)
        if one is None:
            raise PhysicsError(
                f"nothing in this world is called {quoted(name)}; there are: {', '.join(self.names) or 'no bodies'}"
            )
        return one

    def _all(self) -> tuple[BodyInWorld, ...]:
        return (*self._robots.values(), *self._bodies.values())

    def _check_new(self, name: str) -> None:
        if name in self._robots or name in self._bodies:
            raise PhysicsError(f"the name {quoted(name)} is taken; choose another one")

    def _load_robot(self, spec: RobotSpec) -> None:
        self._robots[spec.name] = robot = RobotInWorld(self._bullet, spec, self._seed)
        self.warnings += robot.warnings

    def _load_body(self, spec: BodySpec) -> None:
        self._bodies[spec.name] = body = BodyInWorld(
            self._bullet, spec.name, spec.model, spec.start, static=spec.static, joints=spec.joints
        )
        self.warnings += body.warnings

    def _changed(self, new_links: tuple[str, ...] = (), **changes: Any) -> None:
        """Takes up another scene; ``new_links`` are those of a body that came last, so that thousands come quickly."""
        self.scene = replace(self.scene, revision=self.scene.revision + 1, **changes)
        self._poses.change_bodies(self._all(), new_links)

    def _base(self, robot: str) -> str:
        """Returns the whole name of the robot's base link."""
        spec = self._robot(robot).spec
        return f"{spec.name}/{spec.base_link}"
