"""The physics of one scene: commands and time go in, poses come out. No ROS, no OpenGL; PyBullet only through ``bullet``."""

from __future__ import annotations

import logging
import math
from collections.abc import Sequence
from dataclasses import replace
from types import TracebackType

import numpy as np
from numpy.typing import ArrayLike, NDArray

from gibson_sim.errors import CommandError, ConfigError, MeshError, PhysicsError
from gibson_sim.geometry.transforms import matrix_from_quat
from gibson_sim.physics.bullet import Bullet
from gibson_sim.physics.robot import RobotInWorld
from gibson_sim.robots.spec import Shape
from gibson_sim.scenes.mesh import MeshLoader, scene_roots
from gibson_sim.scenes.spec import SceneSpec
from gibson_sim.types import NS_PER_S, JointStates, Odometry, Pose, SceneState, VelocityCommand

logger = logging.getLogger(__name__)

_SMALLEST_AREA = 1e-12
"""Square metres: smaller triangles are dropped; their normal is noise, and Bullet's contacts with them too."""


class PhysicsWorld:
    """Robots among static shapes, in steps of exactly ``1 / step_hz`` seconds.

    Equal scenes and equal calls give bit-equal states. Not thread-safe. Close it, or use it in a ``with`` statement.
    """

    def __init__(self, scene: SceneSpec, *, step_hz: int = 240, cmd_vel_timeout: float = 0.5) -> None:
        """Loads the scene.

        Args:
            scene: What there is.
            step_hz: Physics steps for each second of simulation time.
            cmd_vel_timeout: Seconds of simulation time after which a command no longer counts.

        Raises:
            ConfigError: a setting is impossible.
            RobotError: a robot cannot be used.
            PhysicsError: the engine refuses.
        """
        if step_hz != int(step_hz) or not 1 <= step_hz <= 100_000:
            raise ConfigError(f"step_hz is {step_hz}, must be a whole number from 1 to 100000")
        if not (math.isfinite(cmd_vel_timeout) and cmd_vel_timeout > 0):
            raise ConfigError(f"cmd_vel_timeout is {cmd_vel_timeout} s, must be a finite number above 0")
        names = [robot.name for robot in scene.robots]
        if len(set(names)) != len(names):
            raise PhysicsError(f"robots are named {', '.join(names)}; names must differ")
        self.step_hz = int(step_hz)
        self.links: tuple[str, ...] = tuple(f"{robot.name}/{link}" for robot in scene.robots for link in robot.links)
        """Names of all links, roots first, in the order of the RobotSpecs."""
        self.warnings: list[str] = []
        """What was left out or replaced, one line each."""
        self._scene = scene
        self._timeout_ns = round(cmd_vel_timeout * NS_PER_S)
        self._step_count = 0
        self._state: SceneState | None = None
        self._bullet = Bullet(self.step_hz, scene.gravity)
        try:
            self._add_static_shapes()
            self._robots = {spec.name: RobotInWorld(self._bullet, spec) for spec in scene.robots}
            self.warnings += [text for robot in self._robots.values() for text in robot.warnings]
        except BaseException:
            self._bullet.close()
            raise
        for warning in self.warnings:
            logger.warning("%s", warning)

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

    def step(self, steps: int = 1) -> None:
        """Advances by ``steps``; limits and time-outs of the commands count in every one."""
        dt = 1.0 / self.step_hz
        bullet = self._bullet
        driven = [robot for robot in self._robots.values() if robot.drive is not None]
        self._state = None
        for _ in range(steps):
            now_ns = self.stamp_ns
            for robot in driven:
                robot.actuate(bullet, now_ns, self._timeout_ns, dt)
            bullet.step()
            self._step_count += 1
            for robot in driven:
                robot.read_wheels(bullet, dt)

    def state(self) -> SceneState:
        """Returns the poses of all links now; its arrays are read-only and stay as they are."""
        self._bullet.check_open()
        if self._state is None:
            parts = [robot.link_states(self._bullet) for robot in self._robots.values()]
            positions, quats, twists = (
                np.concatenate([part[i] for part in parts]) if parts else np.zeros((0, width))
                for i, width in enumerate((3, 4, 6))
            )
            for array in (positions, quats, twists):
                array.setflags(write=False)
            self._state = SceneState(self.stamp_ns, self._step_count, self._scene.revision, self.links, positions, quats, twists)
        return self._state

    def base_pose(self, robot: str) -> Pose:
        """Returns T_world_base."""
        state, row = self.state(), self._base_row(robot)
        x, y, z = state.positions[row].tolist()
        qx, qy, qz, qw = state.quats_xyzw[row].tolist()
        return Pose((x, y, z), (qx, qy, qz, qw))

    def base_twist(self, robot: str) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Returns (linear m/s, angular rad/s), each (3,), of the base's origin against the world, in the BASE frame."""
        state, row = self.state(), self._base_row(robot)
        rotation = matrix_from_quat(state.quats_xyzw[row])
        return state.twists[row, :3] @ rotation, state.twists[row, 3:] @ rotation

    def joint_states(self, robot: str) -> JointStates:
        """Returns the moving joints in the order of ``RobotSpec.moving_joints``; continuous joints count their turns."""
        one = self._robot(robot)
        names = tuple(joint for joint, _, _ in one.spec.moving_joints)
        reading = self._bullet.joint_reading(one.body, [one.body.joint_indices[joint] for joint in names])
        return JointStates(names, reading.positions, reading.velocities, reading.efforts)

    def odometry(self, robot: str) -> Odometry:
        """Returns what the wheels say; a robot without a drive stays at the origin of its odom frame."""
        one = self._robot(robot)
        return one.odometry.odometry if one.odometry is not None else Odometry(0.0, 0.0, 0.0, 0.0, 0.0)

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
        """Puts all robots back to where they started, at rest, with zero odometry and no command.

        Args:
            keep_time: Let simulation time run on (many ROS nodes cannot bear a jump back); False = it is 0 again.
        """
        # Loading anew, not moving: contacts and impulses that Bullet remembers would make the second run differ from the first.
        for robot in self._robots.values():
            self._bullet.remove(robot.body)
        for robot in self._robots.values():
            robot.load(self._bullet)
        self._state = None
        if not keep_time:
            self._step_count = 0

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

    def _base_row(self, robot: str) -> int:
        spec = self._robot(robot).spec
        return self.links.index(f"{spec.name}/{spec.base_link}")

    def _add_static_shapes(self) -> None:
        scene = self._scene
        if scene.ground_z is not None:
            self._bullet.add_static(self._bullet.plane_shape(), Pose((0.0, 0.0, scene.ground_z)))
        loader = MeshLoader(scene_roots(scene), textures=False)
        known: dict[Shape, Sequence[int]] = {}
        for collision in scene.collisions:
            if collision.shape not in known:
                known[collision.shape] = self._static_shape(loader, collision.shape, collision.name)
            self._bullet.add_static(known[collision.shape], collision.pose)

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
