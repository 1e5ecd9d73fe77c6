"""A wrapper of PyBullet.

Guarantees: every call passes the client id; poses are those of URDF LINK FRAMES and velocities those of their origins (PyBullet's are those of
centres of mass); quaternions are (x, y, z, w); nothing is written to the terminal. Not thread-safe: one owner thread per client.

Bullet's internal state outlives removed bodies: the structure of its bounding volume trees, and the progress of optimising them and of removing
separated pairs. It determines the order in which contacts are solved, so bodies that are removed and added again move slightly differently. Only
``reset``, which starts with an empty engine, makes a second run equal to the first.
"""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import chain
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gibson_sim.description.urdf_model import Mimic
from gibson_sim.errors import PhysicsError
from gibson_sim.physics.active_bodies import ActiveBodies, SleepingBodies, count_solver_bodies
from gibson_sim.physics.engine import pybullet as p, quiet
from gibson_sim.physics.engine_files import EngineFiles, listed_for_ever, mesh_pieces
from gibson_sim.physics.engine_types import BulletBody, EngineContact, JointReading
from gibson_sim.physics.frames import cross, quat_product, rotate
from gibson_sim.quoting import quoted
from gibson_sim.types import Pose, Quat, Vec3

_RAYS_PER_CALL = 16_000
"""Number of rays per batch; PyBullet refuses more than 16,384."""
_FIRST_RAY_BIT = 6
"""Lowest bit of the collision group that Bullet does not use itself."""
_GEAR_ERP = 0.5
"""Error reduction parameter of gear constraints: fraction of the error corrected in a step."""
_GEAR_FORCE = 1e5
"""Force limit of a gear constraint, N or N m: more than any motor has."""
_RAYS_FOR_THREADS = 2_000
"""Number of rays above which several threads are faster; a planar scan is faster in one thread."""
_INFINITE_M = 1e12
"""Coordinates of bounding boxes from which they are those of planes, m; the engine gives 1e30."""
MAX_BODIES_WITH_RAYS = 24
"""Maximum number of bodies that rays can ignore: each needs a bit of the 32-bit collision group, whose lowest six Bullet uses itself."""


@dataclass(slots=True)
class _Shape:
    """A collision shape and its definition."""

    name: str
    """Name for error messages."""
    arguments: dict[str, Any]
    """Arguments of ``createCollisionShape``."""
    uid: int = -1
    """Current engine id."""


class Bullet:
    """One private physics engine without a window."""

    def __init__(self, step_hz: int, gravity: Vec3) -> None:
        self.files = EngineFiles()
        """Files that the engine reads; ``close`` deletes them."""
        with quiet():
            self._client: int | None = p.connect(p.DIRECT)
        if self._client < 0:
            self._client = None
            raise PhysicsError("PyBullet has no free client; close unused worlds")
        self._step_hz, self._gravity = step_hz, gravity
        self._ray_threads = min(4, os.cpu_count() or 1)
        self._shapes: list[_Shape] = []
        """Shapes for static bodies; methods refer to them by their index."""
        self._placed: list[tuple[Sequence[int], Pose, str, float]] = []
        """Arguments of all calls of ``add_static``."""
        self._begin()

    def _begin(self) -> None:
        """Sets up an empty engine."""
        client = self.client
        self._names: dict[int, str] = {}
        """Engine id of a body -> its name."""
        self._static: set[int] = set()
        """Engine ids of static shapes."""
        self._ray_bits = set(range(_FIRST_RAY_BIT, _FIRST_RAY_BIT + MAX_BODIES_WITH_RAYS))
        self._sleeping = SleepingBodies(client)
        self.active_bodies = ActiveBodies(client)
        """Counter of the bodies that were active in the last steps."""
        p.setTimeStep(1.0 / self._step_hz, physicsClientId=client)
        p.setGravity(*self._gravity, physicsClientId=client)
        p.setPhysicsEngineParameter(
            deterministicOverlappingPairs=1,
            numSolverIterations=50,
            # The cache uses only the file name as its key: within one client a changed file would keep its first shape.
            enableFileCaching=0,
            physicsClientId=client,
        )

    def reset(self) -> None:
        """Removes all bodies and constraints, keeps static shapes. Later steps are bit-identical to those of a new engine with these shapes."""
        with quiet():
            p.resetSimulation(physicsClientId=self.client)
        self._begin()
        for shape in self._shapes:
            shape.uid = self._create_shape(shape)
        for placed in self._placed:
            self._place_static(*placed)

    @property
    def client(self) -> int:
        """PyBullet's client id; raises PhysicsError after ``close``."""
        self.check_open()
        assert self._client is not None
        return self._client

    def check_open(self) -> None:
        """Raises PhysicsError after ``close``."""
        if self._client is None:
            raise PhysicsError("this physics world is closed; create a new one")

    def close(self) -> None:
        """Frees the engine; a second call does nothing."""
        client, self._client = self._client, None
        if client is not None:
            with quiet():
                p.disconnect(physicsClientId=client)
        self.files.close()

    def step(self) -> None:
        """Advances by one time step."""
        client = self.client
        self._sleeping.before_step()
        self.active_bodies.add_step(p.stepSimulation(client))
        self._sleeping.after_step()

    # Static shapes

    def plane_shape(self) -> list[int]:
        """Creates the infinite plane z = 0, facing up, and returns its shape indices."""
        return [self._add_shape(_Shape("plane", {"shapeType": p.GEOM_PLANE, "planeNormal": [0, 0, 1]}))]

    def box_shape(self, size: Vec3) -> list[int]:
        """Creates a box with edges ``size``, metres, and returns its shape indices."""
        return [self._add_shape(_Shape("box", {"shapeType": p.GEOM_BOX, "halfExtents": [edge / 2 for edge in size]}))]

    def sphere_shape(self, radius: float) -> list[int]:
        """Creates a sphere with ``radius``, metres, and returns its shape indices."""
        return [self._add_shape(_Shape("sphere", {"shapeType": p.GEOM_SPHERE, "radius": radius}))]

    def cylinder_shape(self, radius: float, length: float) -> list[int]:
        """Creates a cylinder about z, metres, and returns its shape indices."""
        return [self._add_shape(_Shape("cylinder", {"shapeType": p.GEOM_CYLINDER, "radius": radius, "height": length}))]

    def capsule_shape(self, radius: float, length: float) -> list[int]:
        """Creates a capsule about z, metres, and returns its shape indices; ``length``: without its half spheres."""
        return [self._add_shape(_Shape("capsule", {"shapeType": p.GEOM_CAPSULE, "radius": radius, "height": length}))]

    def hull_shape(self, vertices: NDArray[np.float64], name: str) -> list[int]:
        """Creates the convex hull of ``vertices``, (V, 3), metres, and returns its shape indices; ``name`` is for error messages."""
        return [self._add_shape(_Shape(name, {"shapeType": p.GEOM_MESH, "vertices": listed_for_ever(vertices)}))]

    def mesh_shape(self, vertices: NDArray[np.float64], triangles: NDArray[np.int64], name: str) -> list[int]:
        """Creates a triangle mesh, hollow and with all its triangles, in as many pieces as PyBullet's limits require; returns their indices.

        Args:
            vertices: (V, 3), metres.
            triangles: (T, 3), indices into ``vertices``.
            name: Name for error messages.
        """
        flags = p.GEOM_FORCE_CONCAVE_TRIMESH | p.GEOM_CONCAVE_INTERNAL_EDGE
        shapes = []
        for points, corners in mesh_pieces(vertices, triangles):
            mesh = {"vertices": listed_for_ever(points), "indices": listed_for_ever(corners.ravel())}
            shapes.append(self._add_shape(_Shape(name, {"shapeType": p.GEOM_MESH, "flags": flags, **mesh})))
        return shapes

    def engine_shape(self, shape: int) -> int:
        """Returns the engine id of a shape, valid until the next ``reset``."""
        return self._shapes[shape].uid

    def add_static(self, shapes: Sequence[int], pose: Pose, name: str, friction: float = 1.0) -> None:
        """Adds shapes with a friction coefficient to the world permanently; a shape may be added several times."""
        self._place_static(shapes, pose, name, friction)
        self._placed.append((shapes, pose, name, friction))

    def _place_static(self, shapes: Sequence[int], pose: Pose, name: str, friction: float) -> None:
        for shape in shapes:
            # Rigid bodies, not multi-bodies: Bullet visits every multi-body in every step, even static ones.
            uid = p.createMultiBody(
                0,
                self._shapes[shape].uid,
                basePosition=pose.position,
                baseOrientation=pose.quat_xyzw,
                useMaximalCoordinates=1,
                physicsClientId=self.client,
            )
            self._names[_checked(uid, "static body")] = name
            self._static.add(uid)
            p.changeDynamics(
                uid,
                -1,
                lateralFriction=friction,
                restitution=0.0,
                # PyBullet leaves it active, and Bullet would then check contacts of sleeping bodies with it in every step.
                activationState=p.ACTIVATION_STATE_SLEEP,
                physicsClientId=self.client,
            )

    def _add_shape(self, shape: _Shape) -> int:
        shape.uid = self._create_shape(shape)
        self._shapes.append(shape)
        return len(self._shapes) - 1

    def _create_shape(self, shape: _Shape) -> int:
        """Creates a shape in the engine and returns its engine id."""
        with quiet():
            return _checked(p.createCollisionShape(**shape.arguments, physicsClientId=self.client), shape.name)

    # Bodies with joints

    def wake(self, body: BulletBody) -> None:
        """Wakes a body before the next step; a moving body wakes the bodies that it touches."""
        self._sleeping.wake(body)

    def load_urdf(self, text: str, pose: Pose, name: str, *, static: bool = False, sleeps: bool = False) -> BulletBody:
        """Adds a body whose root link frame is at ``pose``; its motors are off.

        Args:
            text: URDF with absolute mesh paths (``description.rigid_groups.physics_urdf``).
            pose: T_world_root.
            name: Name for error messages.
            static: Whether the root is fixed.
            sleeps: Whether the body may sleep while it is at rest, which saves time, until a moving body touches it.

        Raises:
            PhysicsError: PyBullet refuses the URDF.
        """
        path = self.files.write_urdf(text)
        flags = p.URDF_USE_INERTIA_FROM_FILE | p.URDF_MAINTAIN_LINK_ORDER | p.URDF_USE_IMPLICIT_CYLINDER
        flags |= p.URDF_ENABLE_SLEEPING if sleeps else 0
        try:
            with quiet():
                uid = p.loadURDF(
                    str(path), pose.position, pose.quat_xyzw, useFixedBase=static, flags=flags, physicsClientId=self.client
                )
        except p.error as error:
            raise PhysicsError(
                f"PyBullet refused the URDF of {quoted(name)} ({error}); log level DEBUG shows its reasons"
            ) from error
        count = p.getNumJoints(uid, physicsClientId=self.client)
        joints = {p.getJointInfo(uid, i, physicsClientId=self.client)[1].decode(): i for i in range(count)}
        inertial = [p.getDynamicsInfo(uid, i, physicsClientId=self.client)[3:5] for i in range(-1, count)]
        body = BulletBody(uid, joints, inertial, count_solver_bodies(uid, count, self.client))
        self._names[uid] = name
        self.active_bodies.change_bodies(len(self._names) - len(self._static))
        for i in range(-1, count):
            # Bullet's default drag would slow a freely rolling wheel.
            p.changeDynamics(uid, i, linearDamping=0.0, angularDamping=0.0, restitution=0.0, physicsClientId=self.client)
        for i in range(count):
            p.changeDynamics(uid, i, jointDamping=0.0, physicsClientId=self.client)
            if p.getJointInfo(uid, i, physicsClientId=self.client)[2] != p.JOINT_FIXED:
                p.setJointMotorControl2(uid, i, p.VELOCITY_CONTROL, force=0.0, physicsClientId=self.client)
        if sleeps:
            self._sleeping.add(body)
        self._sleeping.wake_beside(body)
        return body

    def let_rays_ignore(self, body: BulletBody, name: str) -> None:
        """Makes the body ignorable by ``cast_rays``; raises PhysicsError if ``MAX_BODIES_WITH_RAYS`` are."""
        if not self._ray_bits:
            raise PhysicsError(f"cannot add {quoted(name)}: a world holds at most {MAX_BODIES_WITH_RAYS} robots")
        body.ray_bit = min(self._ray_bits)
        self._ray_bits.remove(body.ray_bit)
        for i in range(-1, body.link_count):
            p.setCollisionFilterGroupMask(body.uid, i, 1 << body.ray_bit, -1, physicsClientId=self.client)

    def remove(self, body: BulletBody) -> None:
        """Removes a body."""
        self._sleeping.remove(body)
        p.removeBody(body.uid, physicsClientId=self.client)
        del self._names[body.uid]
        self.active_bodies.change_bodies(len(self._names) - len(self._static))
        if body.ray_bit:
            self._ray_bits.add(body.ray_bit)

    def place(self, body: BulletBody, pose: Pose) -> None:
        """Moves the root link's frame to ``pose`` (T_world_root); joint positions and velocities are unchanged."""
        quat = quat_product(pose.quat_xyzw, body.root_inertial[1])
        center = np.array(pose.position) - rotate(np.array([quat]), body.links_in_inertial[:1])[0]
        self._sleeping.wake_beside(body)
        p.resetBasePositionAndOrientation(body.uid, center.tolist(), quat, physicsClientId=self.client)
        self._sleeping.wake_beside(body)

    def set_velocity(self, body: BulletBody, quat_xyzw: Quat, linear: NDArray[np.float64], angular: NDArray[np.float64]) -> None:
        """Sets the velocity of the root link's origin.

        Args:
            body: The body.
            quat_xyzw: Current orientation of the root link's frame.
            linear: (3,), m/s, world frame.
            angular: (3,), rad/s, world frame.
        """
        to_frame = rotate(np.array([quat_product(quat_xyzw, body.root_inertial[1])]), body.links_in_inertial[:1])[0]
        center = linear - cross(angular[None], to_frame[None])[0]
        p.resetBaseVelocity(body.uid, center.tolist(), angular.tolist(), physicsClientId=self.client)
        self._sleeping.wake_moving(body, center.tolist(), angular.tolist())

    def place_joint(self, body: BulletBody, index: int, position: float) -> None:
        """Moves a joint to ``position`` (radians or metres), at rest."""
        self._sleeping.wake_beside(body)
        p.resetJointState(body.uid, index, position, 0.0, physicsClientId=self.client)
        self._sleeping.wake_beside(body)

    def gear_joints(self, body: BulletBody, follower: int, leader: int, mimic: Mimic) -> None:
        """Couples two joints of a body by a gear constraint, so that either can move the other; it is removed with the body."""
        ends = ([0.0, 0.0, 0.0],) * 3
        gear = p.createConstraint(body.uid, follower, body.uid, leader, p.JOINT_GEAR, *ends, physicsClientId=self.client)
        p.changeConstraint(
            gear,
            gearRatio=-mimic.multiplier,
            relativePositionTarget=mimic.offset,
            erp=_GEAR_ERP,
            maxForce=_GEAR_FORCE,
            physicsClientId=self.client,
        )

    def damp_joint(self, body: BulletBody, index: int, damping: float) -> None:
        """Sets the damping of a joint, N m s/rad or N s/m."""
        p.changeDynamics(body.uid, index, jointDamping=damping, physicsClientId=self.client)

    def contacts(self, body: BulletBody | None = None) -> list[EngineContact]:
        """Returns the contacts of a body in the last step; None = all bodies, each point once, with static shapes as ``other``."""
        if body is None:
            points = p.getContactPoints(physicsClientId=self.client) or ()
            contacts = [self._contact(point, point[2] if point[1] in self._static else point[1]) for point in points]
        else:
            points = p.getContactPoints(bodyA=body.uid, physicsClientId=self.client) or ()
            contacts = [self._contact(point, body.uid) for point in points]
        return [contact for contact in contacts if contact.force > 0.0 or contact.distance <= 0.0]

    def static_bounds(self) -> tuple[NDArray[np.float64], NDArray[np.float64]] | None:
        """Returns the minimum and maximum corner, each (3,), metres, of the bounding box of the static shapes without planes; None = no shapes."""
        boxes = np.array([p.getAABB(uid, physicsClientId=self.client) for uid in self._static]).reshape(-1, 2, 3)
        boxes = boxes[np.abs(boxes).max(axis=(1, 2)) < _INFINITE_M]
        return (boxes[:, 0].min(axis=0), boxes[:, 1].max(axis=0)) if len(boxes) else None

    def bodies_near(self, body: BulletBody, link: int, radius: float) -> set[int]:
        """Returns the engine ids of bodies whose bounding boxes are within ``radius`` metres of that of a link (-1 = the root)."""
        low, high = p.getAABB(body.uid, link, physicsClientId=self.client)
        low, high = [c - radius for c in low], [c + radius for c in high]
        return {uid for uid, _ in p.getOverlappingObjects(low, high, physicsClientId=self.client) or ()}

    def closest_points(self, body: BulletBody, link: int, other: BulletBody, radius: float) -> list[EngineContact]:
        """Returns the closest points of a link (-1 = the root) and the links of another body within ``radius`` metres; without forces."""
        points = p.getClosestPoints(body.uid, other.uid, radius, linkIndexA=link, physicsClientId=self.client) or ()
        return [self._contact(point, body.uid) for point in points]

    def overlaps(self, body: BulletBody, others: Sequence[BulletBody]) -> list[EngineContact]:
        """Returns the current overlaps of a body with static shapes or other bodies; without forces, and without side effects in the engine."""
        client, uids = self.client, [*self._static, *(other.uid for other in others)]
        points = (p.getClosestPoints(body.uid, uid, 0.0, physicsClientId=client) or () for uid in uids)
        return [self._contact(point, body.uid) for point in chain.from_iterable(points)]

    def _contact(self, point: tuple[Any, ...], uid: int) -> EngineContact:
        """Converts a contact point of PyBullet, seen from the body ``uid``."""
        _, a, b, link_a, link_b, on_a, on_b, normal, distance, force = point[:10]
        if a != uid:
            a, b, link_a, link_b, on_a, on_b, normal = b, a, link_b, link_a, on_b, on_a, tuple(-c for c in normal)
        return EngineContact(self._names.get(a, ""), link_a, self._names.get(b, ""), link_b, on_b, on_a, normal, force, distance)

    def raw_states(self, *bodies: BulletBody) -> NDArray[np.float64]:
        """Returns a row of 13 numbers for the root and every link below it, body by body: see ``frames.FrameTable.groups``."""
        client, parts = self.client, []
        for body in bodies:
            parts += p.getBasePositionAndOrientation(body.uid, client)
            parts += p.getBaseVelocity(body.uid, client)
            if body.link_count:
                for state in p.getLinkStates(body.uid, body.link_indices, 1, 1, client):
                    # 0, 1: centre of mass; 6, 7: its velocities, requested by the first 1. The frames at 4, 5 have only 32 bits.
                    parts += state[0], state[1], state[6], state[7]
        return np.fromiter(chain.from_iterable(parts), np.float64).reshape(-1, 13)

    def at_rest(self, bodies: Sequence[BulletBody]) -> list[bool]:
        """Returns for each body whether all its velocities are exactly 0, which is true only for sleeping bodies."""
        client = self.client
        return [
            not (self.raw_states(body)[:, 7:].any() if body.link_count else any(map(any, p.getBaseVelocity(body.uid, client))))
            for body in bodies
        ]

    def raw_root(self, body: BulletBody) -> tuple[float, ...]:
        """Returns the first row of ``raw_states``."""
        client = self.client
        parts = *p.getBasePositionAndOrientation(body.uid, client), *p.getBaseVelocity(body.uid, client)
        return tuple(chain.from_iterable(parts))

    def joint_reading(self, body: BulletBody, indices: Sequence[int]) -> JointReading:
        """Returns positions, velocities and motor efforts of the joints."""
        states = p.getJointStates(body.uid, indices, self.client) if indices else ()
        data = np.array([(s[0], s[1], s[3]) for s in states]).reshape(-1, 3)
        return JointReading(data[:, 0], data[:, 1], data[:, 2])

    def joint_angles(self, body: BulletBody, indices: Sequence[int]) -> list[float]:
        """Returns the positions of the joints, radians or metres."""
        return [s[0] for s in p.getJointStates(body.uid, indices, self.client)] if indices else []

    def drive_joints(self, body: BulletBody, indices: Sequence[int], speeds: Sequence[float], efforts: Sequence[float]) -> None:
        """Sets velocity targets ``speeds`` (rad/s or m/s) of motors with effort limits ``efforts`` (N m or N)."""
        p.setJointMotorControlArray(
            body.uid, indices, p.VELOCITY_CONTROL, targetVelocities=speeds, forces=efforts, physicsClientId=self.client
        )

    def hold_joints(self, body: BulletBody, indices: Sequence[int], positions: Sequence[float], efforts: Sequence[float]) -> None:
        """Sets position targets ``positions`` (radians or metres) of motors with effort limits ``efforts`` (N m or N)."""
        p.setJointMotorControlArray(
            body.uid, indices, p.POSITION_CONTROL, targetPositions=positions, forces=efforts, physicsClientId=self.client
        )

    # Rays

    def cast_rays(self, starts: NDArray[np.float64], ends: NDArray[np.float64], ignore: BulletBody | None) -> NDArray[np.float64]:
        """Returns for each ray, (N, 3) to (N, 3), the fraction of its length to the first hit, (N,); +inf = no hit."""
        mask = -1 if ignore is None else -1 & ~(1 << ignore.ray_bit)
        threads = self._ray_threads if len(starts) > _RAYS_FOR_THREADS else 1
        fractions: list[float] = []
        for i in range(0, len(starts), _RAYS_PER_CALL):
            hits = p.rayTestBatch(
                starts[i : i + _RAYS_PER_CALL].tolist(), ends[i : i + _RAYS_PER_CALL].tolist(),
                numThreads=threads, collisionFilterMask=mask, physicsClientId=self.client,
            )  # fmt: skip
            fractions.extend([hit[2] if hit[0] >= 0 else np.inf for hit in hits])
        return np.array(fractions, dtype=np.float64)


def _checked(uid: int, what: str) -> int:
    """Returns the engine id of a new object; raises PhysicsError if the engine refused it."""
    if uid < 0:
        raise PhysicsError(f"PyBullet refused the collision shape of {what}")
    return int(uid)
