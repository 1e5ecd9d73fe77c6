"""The physics of one scene: commands and time go in, poses come out. No ROS, no OpenGL; PyBullet only through ``bullet``."""

from __future__ import annotations

import logging
import math
from collections.abc import Sequence
from dataclasses import replace
from types import TracebackType
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from gibson_sim.errors import CommandError, ConfigError, MeshError, PhysicsError
from gibson_sim.geometry.transforms import Mat4, turned
from gibson_sim.physics.body import BodyInWorld
from gibson_sim.physics.bullet import Bullet
from gibson_sim.physics.frames import FrameTable
from gibson_sim.physics.robot import RobotInWorld
from gibson_sim.robots.body import BodySpec
from gibson_sim.robots.joint_commands import JointCommand
from gibson_sim.robots.spec import RobotSpec, Shape
from gibson_sim.scenes.mesh import MeshLoader, scene_roots
from gibson_sim.scenes.spec import SceneSpec
from gibson_sim.types import NS_PER_S, Contact, JointStates, Odometry, Pose, SceneState, Vec3, VelocityCommand

logger = logging.getLogger(__name__)

GROUND = "ground"
"""What contacts call the endless plane."""
_SMALLEST_AREA = 1e-12
"""Square metres: smaller triangles are dropped; their normal is noise, and Bullet's contacts with them too."""


class PhysicsWorld:
    """Robots among static shapes, in steps of exactly ``1 / step_hz`` seconds.

    Equal scenes and equal calls give bit-equal states. Not thread-safe. Close it, or use it in a ``with`` statement.
    """

    def __init__(self, scene: SceneSpec, *, step_hz: int = 240, cmd_vel_timeout: float = 0.5, seed: int = 0) -> None:
        """Loads the scene.

        Args:
            scene: What there is.
            step_hz: Physics steps for each second of simulation time.
            cmd_vel_timeout: Seconds of simulation time after which a command no longer counts.
            seed: Of the errors of wheel odometry.

        Raises:
            ConfigError: a setting is impossible.
            RobotError: a robot cannot be used.
            PhysicsError: the engine refuses.
        """
        if step_hz != int(step_hz) or not 1 <= step_hz <= 100_000:
            raise ConfigError(f"step_hz is {step_hz}, must be a whole number from 1 to 100000")
        if not (math.isfinite(cmd_vel_timeout) and cmd_vel_timeout > 0):
            raise ConfigError(f"cmd_vel_timeout is {cmd_vel_timeout} s, must be a finite number above 0")
        names = [*(robot.name for robot in scene.robots), *(body.name for body in scene.bodies)]
        if len(set(names)) != len(names):
            raise PhysicsError(f"robots and bodies are named {', '.join(names)}; names must differ")
        self.step_hz = int(step_hz)
        self.links: tuple[str, ...] = ()
        """Names ``<body>/<link>`` of all links, in the order of ``names``, the roots first."""
        self.warnings: list[str] = []
        """What was left out or replaced, one line each."""
        self.scene = scene
        """What there is now; its ``revision`` counts what was added and removed."""
        self._timeout_ns = round(cmd_vel_timeout * NS_PER_S)
        self._seed = seed
        self._step_count = 0
        self._state: SceneState | None = None
        self._table: FrameTable | None = None
        """Of all bodies together; None = they changed."""
        self._bullet = Bullet(self.step_hz, scene.gravity)
        try:
            self._add_static_shapes()
            self._robots: dict[str, RobotInWorld] = {}
            self._bodies: dict[str, BodyInWorld] = {}
            for robot in scene.robots:
                self._load_robot(robot)
            for body in scene.bodies:
                self._load_body(body)
            self._name_links()
        except BaseException:
            self._bullet.close()
            raise
        for warning in self.warnings:
            logger.warning("%s", warning)

    @property
    def names(self) -> tuple[str, ...]:
        """Names of all robots and bodies."""
        return (*self._robots, *self._bodies)

    def add_robot(self, spec: RobotSpec) -> None:
        """Puts a robot into the world, at its start, from the next step on.

        Raises:
            PhysicsError: the name is taken, or the engine refuses.
            RobotError: the robot cannot be used.
        """
        self._check_new(spec.name)
        self._load_robot(spec)
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

    def remove(self, name: str) -> None:
        """Takes a robot or a body out of the world; PhysicsError where there is none of this name."""
        self._bullet.remove(self._one(name).body)
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
        self._state = None

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

    def contacts(self, name: str) -> tuple[Contact, ...]:
        """Returns the points at which a robot or a body touched another one in the last step; it is always ``a``."""
        one = self._one(name)
        out = []
        for point in self._bullet.contacts(one.body):
            other = self._robots.get(point.other) or self._bodies.get(point.other)
            link_b = "" if other is None else other.link_of_row(point.other_link)
            link_a = one.link_of_row(point.link)
            out.append(Contact(name, link_a, point.other, link_b, point.position, point.normal, point.force, point.distance))
        return tuple(out)

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
            raise CommandError(f"robot {robot!r} has no drive and cannot obey a velocity; give it one in its robot.yaml")
        one.command = replace(command, stamp_ns=min(command.stamp_ns, self.stamp_ns))

    def command_joints(self, robot: str, command: JointCommand) -> None:
        """Moves joints other than those of the drive, from the next step on.

        Raises:
            CommandError: there is no such robot or joint, or it cannot move so.
        """
        self._robot(robot).command_joints(self._bullet, command, self.stamp_ns)

    def step(self, steps: int = 1) -> None:
        """Advances by ``steps``; limits and time-outs of the commands count in every one."""
        dt = 1.0 / self.step_hz
        bullet = self._bullet
        robots = tuple(self._robots.values())
        self._state = None
        for _ in range(steps):
            now_ns = self.stamp_ns
            for robot in robots:
                robot.actuate(bullet, now_ns, self._timeout_ns, dt)
            bullet.step()
            self._step_count += 1
            for robot in robots:
                robot.read_wheels(bullet, dt)

    def state(self) -> SceneState:
        """Returns the poses of all links now; its arrays are read-only and stay as they are."""
        self._bullet.check_open()
        if self._state is None:
            if self._table is None:
                self._table = FrameTable.joined([body.table for body in self._all()])
            self._state = self._state_of(self._all(), self._table, self.links)
        return self._state

    def state_of(self, name: str) -> SceneState:
        """Returns the poses of at least the links of one robot or body now: what a sensor needs between two states."""
        if self._state is not None:
            return self._state
        one = self._one(name)
        return self._state_of((one,), one.table, one.full_links)

    def _state_of(self, bodies: Sequence[BodyInWorld], table: FrameTable, links: tuple[str, ...]) -> SceneState:
        raw = [row for body in bodies for row in self._bullet.raw_states(body.body)]
        positions, quats, twists = table.links(np.array(raw, dtype=np.float64).reshape(-1, 13))
        for array in (positions, quats, twists):
            array.setflags(write=False)
        return SceneState(self.stamp_ns, self._step_count, self.scene.revision, links, positions, quats, twists)

    def base_pose(self, robot: str) -> Pose:
        """Returns T_world_base."""
        state, row = self.state(), self._base_row(robot)
        x, y, z = state.positions[row].tolist()
        qx, qy, qz, qw = state.quats_xyzw[row].tolist()
        return Pose((x, y, z), (qx, qy, qz, qw))

    def base_twist(self, robot: str) -> tuple[Vec3, Vec3]:
        """Returns linear (m/s) and angular (rad/s) velocity of the base's origin against the world, in the BASE frame."""
        state, row = self.state(), self._base_row(robot)
        x, y, z, w = state.quats_xyzw[row].tolist()
        *linear, p, q, r = state.twists[row].tolist()
        inverse = (-x, -y, -z, w)
        return turned(inverse, (linear[0], linear[1], linear[2])), turned(inverse, (p, q, r))

    def joint_states(self, robot: str) -> JointStates:
        """Returns the moving joints in the order of ``RobotSpec.moving_joints``; continuous joints count their turns."""
        one = self._robot(robot)
        names = tuple(joint for joint, _, _ in one.spec.moving_joints)
        reading = self._bullet.joint_reading(one.body, [one.body.joint_indices[joint] for joint in names])
        return JointStates(names, reading.positions, reading.velocities, reading.efforts)

    def odometry(self, robot: str) -> Odometry:
        """Returns what the wheels say; a robot without a drive stays at the origin of its odom frame."""
        drive = self._robot(robot).drive
        return drive.odometry if drive is not None else Odometry(0.0, 0.0, 0.0, 0.0, 0.0)

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
        for one in self._all():
            self._bullet.remove(one.body)
        for one in self._all():
            one.load(self._bullet)
        self._state = None
        if not keep_time:
            self._step_count = 0

    def set_step_count(self, steps: int) -> None:
        """Sets time to that of ``steps`` steps after load; nothing moves. Robots forget their commands, whose times are of the old one.

        Raises:
            PhysicsError: ``steps`` is negative.
        """
        if steps < 0:
            raise PhysicsError(f"step count is {steps}, must be 0 or more")
        self._step_count, self._state = steps, None
        for robot in self._robots.values():
            robot.forget_commands(self._bullet, self.stamp_ns)

    def close(self) -> None:
        """Frees the engine; a second call does nothing, any other use afterwards raises PhysicsError."""
        self._bullet.close()

    def __enter__(self) -> PhysicsWorld:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None) -> None:
        self.close()

    def _robot(self, name: str) -> RobotInWorld:
        if name not in self._robots:
            raise CommandError(f"no robot {name!r} in this world; known: {', '.join(self._robots) or 'none'}")
        return self._robots[name]

    def _one(self, name: str) -> BodyInWorld:
        one = self._robots.get(name) or self._bodies.get(name)
        if one is None:
            raise PhysicsError(f"nothing in this world is called {name!r}; there are: {', '.join(self.names) or 'no bodies'}")
        return one

    def _all(self) -> tuple[BodyInWorld, ...]:
        return (*self._robots.values(), *self._bodies.values())

    def _check_new(self, name: str) -> None:
        if name in self._robots or name in self._bodies:
            raise PhysicsError(f"the name {name!r} is taken; choose another one")

    def _load_robot(self, spec: RobotSpec) -> None:
        self._robots[spec.name] = robot = RobotInWorld(self._bullet, spec, self._seed)
        self.warnings += robot.warnings

    def _load_body(self, spec: BodySpec) -> None:
        self._bodies[spec.name] = body = BodyInWorld(
            self._bullet, spec.name, spec.model, spec.start, static=spec.static, joints=spec.joints
        )
        self.warnings += body.warnings

    def _name_links(self) -> None:
        self.links = tuple(link for one in self._all() for link in one.full_links)

    def _changed(self, new_links: tuple[str, ...] = (), **changes: Any) -> None:
        """Takes up another scene; ``new_links`` are those of a body that came last, so that thousands come quickly."""
        self.scene = replace(self.scene, revision=self.scene.revision + 1, **changes)
        if new_links:
            self.links += new_links
        else:
            self._name_links()
        self._state = self._table = None

    def _base_row(self, robot: str) -> int:
        spec = self._robot(robot).spec
        return self.links.index(f"{spec.name}/{spec.base_link}")

    def _add_static_shapes(self) -> None:
        scene = self.scene
        if scene.ground_z is not None:
            self._bullet.add_static(self._bullet.plane_shape(), Pose((0.0, 0.0, scene.ground_z)), GROUND)
        loader = MeshLoader(scene_roots(scene), textures=False)
        known: dict[Shape, Sequence[int]] = {}
        for collision in scene.collisions:
            if collision.shape not in known:
                known[collision.shape] = self._static_shape(loader, collision.shape, collision.name)
            self._bullet.add_static(known[collision.shape], collision.pose, collision.name)

    def _static_shape(self, loader: MeshLoader, shape: Shape, name: str) -> Sequence[int]:
        """Returns the engine's numbers of a shape; none, with a warning, for a mesh that cannot be bumped into."""
        if shape.kind == "box":
            return self._bullet.box_shape(shape.size)
        if shape.kind == "sphere":
            return self._bullet.sphere_shape(shape.size[0])
        if shape.kind == "cylinder":
            return self._bullet.cylinder_shape(shape.size[0], shape.size[1])
        try:
            vertices, triangles = loader.shape(shape).merged()
        except MeshError as error:
            self.warnings.append(f"collision {name!r} is left out: {error}")
            return []
        sound = sound_triangles(vertices, triangles)
        if not len(sound):
            self.warnings.append(f"collision {name!r} is left out: {shape.mesh} has no triangle with an area")
            return []
        return self._bullet.mesh_shape(vertices, sound, shape.mesh)


def sound_triangles(vertices: NDArray[np.float64], triangles: ArrayLike) -> NDArray[np.int64]:
    """Returns those of ``triangles``, (T, 3), that have an area and finite corners."""
    corners: NDArray[np.int64] = np.asarray(triangles, dtype=np.int64).reshape(-1, 3)
    a, b, c = (vertices[corners[:, i]] for i in range(3))
    area = np.linalg.norm(np.cross(b - a, c - a), axis=1) / 2
    sound: NDArray[np.int64] = corners[np.isfinite(area) & (area > _SMALLEST_AREA)]
    return sound
