"""PyBullet behind one class: the only file that imports it.

What callers may rely on: every call goes to its own client; poses are those of URDF LINK FRAMES and velocities those of their
origins (PyBullet speaks of centres of mass); quaternions are (x, y, z, w); nothing is written to the terminal.
Not thread-safe: one owner thread for each client.
"""

from __future__ import annotations

import contextlib
import ctypes
import hashlib
import logging
import os
import sys
import tempfile
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gibson_sim.errors import PhysicsError
from gibson_sim.physics.frames import cross, product, right_multiplication, turn
from gibson_sim.types import Pose, Quat, Vec3

logger = logging.getLogger(__name__)


@contextlib.contextmanager
def _quiet() -> Iterator[None]:
    """Takes what C code writes to stdout and stderr in the meantime and logs it at DEBUG.

    PyBullet writes its build date, and every warning of its file readers, straight to the file descriptors.
    """
    libc = ctypes.CDLL(None)
    with contextlib.ExitStack() as stack:
        sink = stack.enter_context(tempfile.TemporaryFile())
        for stream in (sys.stdout, sys.stderr):
            with contextlib.suppress(OSError, ValueError, AttributeError):  # a closed or replaced stream has nothing to flush
                stream.flush()
        libc.fflush(None)
        try:
            saved = [(fd, os.dup(fd)) for fd in (1, 2)]
        except OSError:  # a process without stdout or stderr (a daemon) has nothing to protect
            saved = []
        for fd, _ in saved:
            os.dup2(sink.fileno(), fd)
        try:
            yield
        finally:
            libc.fflush(None)
            for fd, copy in saved:
                os.dup2(copy, fd)
                os.close(copy)
            sink.seek(0)
            for line in sink.read().decode(errors="replace").splitlines():
                if line.strip():
                    logger.debug("bullet: %s", line.strip())


with _quiet():
    import pybullet as p

_RAYS_PER_CALL = 16_000
"""PyBullet refuses batches above 16,384."""
_VERTEX_LIMIT = 131_000
"""Vertices of one collision shape; PyBullet refuses arrays above 131,072 vertices or 524,288 indices."""
_TRIANGLE_LIMIT = 174_000
_VOXELS = 50_000
"""That V-HACD cuts a mesh into."""
_FIRST_RAY_BIT = 6
_SLEEP_THRESHOLD = 2.5e-5
"""Sum of the squares of all speeds (m/s, rad/s) of a body below which it falls asleep after 2 s: a few millimetres a second."""
MAX_BODIES_WITH_RAYS = 24
"""Bodies that rays can leave out: each needs a bit of the 32-bit collision group; Bullet owns the lowest six."""


@dataclass(frozen=True, slots=True)
class JointReading:
    """Joints of one body, in the order asked for."""

    positions: NDArray[np.float64]
    velocities: NDArray[np.float64]
    efforts: NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class EngineContact:
    """A point at which a body touches another one."""

    link: int
    """Of the body asked about; -1 = the root."""
    other: str
    """Name of the other body, or of the static shape."""
    other_link: int
    position: Vec3
    """On the other body, world frame, metres."""
    normal: Vec3
    """From the other body to this one, unit vector, world frame."""
    force: float
    """N, along the normal."""
    distance: float
    """Metres between the two surfaces; negative = they overlap."""


class BulletBody:
    """What was found out once about a body with joints."""

    __slots__ = (
        "joint_indices",
        "link_count",
        "link_indices",
        "link_turns",
        "links_in_inertial",
        "ray_bit",
        "root_inertial",
        "uid",
    )

    def __init__(self, uid: int, joint_indices: dict[str, int], inertial_poses: Sequence[tuple[Vec3, Quat]]) -> None:
        self.uid = uid
        self.joint_indices = joint_indices
        self.link_count = len(inertial_poses) - 1
        """Links below the root."""
        self.link_indices = tuple(range(self.link_count))
        conjugates = [(-x, -y, -z, w) for _, (x, y, z, w) in inertial_poses]
        self.links_in_inertial = -turn(np.array(conjugates), np.array([position for position, _ in inertial_poses]))
        """(N, 3): origins of the link frames in the frame that Bullet moves: centre of mass and principal axes."""
        self.link_turns = np.array([right_multiplication(quat) for quat in conjugates])
        """(N, 4, 4): multiply a quaternion of the principal axes to that of the link frame."""
        self.root_inertial = inertial_poses[0]
        """Position and quaternion of what Bullet moves in the root link's frame."""
        self.ray_bit = 0
        """Bit of the collision group that rays can leave out; 0 = rays always hit it."""


class Bullet:
    """One private physics engine without a window."""

    def __init__(self, step_hz: int, gravity: Vec3) -> None:
        self._folder: tempfile.TemporaryDirectory[str] | None = None
        with _quiet():
            self._client: int | None = p.connect(p.DIRECT)
        if self._client < 0:
            self._client = None
            raise PhysicsError("PyBullet gives no more clients; close worlds that are no longer used")
        self._names: dict[int, str] = {}
        """The engine's number of a body -> its name."""
        self._sleepers: set[int] = set()
        """The engine's numbers of bodies that may fall asleep."""
        self._wake = False
        self._thrown: dict[int, tuple[list[float], list[float]]] = {}
        """The same, with the velocities that they were given since the last step."""
        self._ray_bits = set(range(_FIRST_RAY_BIT, _FIRST_RAY_BIT + MAX_BODIES_WITH_RAYS))
        self._ray_threads = min(4, os.cpu_count() or 1)
        p.setTimeStep(1.0 / step_hz, physicsClientId=self._client)
        p.setGravity(*gravity, physicsClientId=self._client)
        p.setPhysicsEngineParameter(
            deterministicOverlappingPairs=1,
            numSolverIterations=50,
            # The cache goes by file name alone: within one client a changed file would keep its first shape.
            enableFileCaching=0,
            physicsClientId=self._client,
        )

    @property
    def client(self) -> int:
        """The client's number; raises PhysicsError after ``close``."""
        self.check_open()
        assert self._client is not None
        return self._client

    def check_open(self) -> None:
        """Raises PhysicsError after ``close``."""
        if self._client is None:
            raise PhysicsError("this physics world is closed; make a new one")

    def close(self) -> None:
        """Frees the engine; a second call does nothing."""
        client, self._client = self._client, None
        if client is not None:
            with _quiet():
                p.disconnect(physicsClientId=client)
        if self._folder is not None:
            self._folder.cleanup()
            self._folder = None

    def step(self) -> None:
        """Advances by one time step."""
        if self._wake:
            self._wake = False
            for uid in sorted(self._sleepers):
                p.changeDynamics(uid, -1, activationState=p.ACTIVATION_STATE_WAKE_UP, physicsClientId=self.client)
        p.stepSimulation(physicsClientId=self.client)
        # Who slept stands still in the step that wakes it, and forgets how it was thrown.
        for uid, (linear, angular) in self._thrown.items():
            if not any(map(any, p.getBaseVelocity(uid, physicsClientId=self.client))):
                p.resetBaseVelocity(uid, linear, angular, physicsClientId=self.client)
        self._thrown.clear()

    # Static shapes

    def plane_shape(self) -> list[int]:
        """Returns an endless plane z = 0 that faces up."""
        return [self._checked(p.createCollisionShape(p.GEOM_PLANE, planeNormal=[0, 0, 1], physicsClientId=self.client), "plane")]

    def box_shape(self, size: Vec3) -> list[int]:
        """Returns a box with edges ``size``, metres."""
        half = [edge / 2 for edge in size]
        return [self._checked(p.createCollisionShape(p.GEOM_BOX, halfExtents=half, physicsClientId=self.client), "box")]

    def sphere_shape(self, radius: float) -> list[int]:
        """Returns a sphere."""
        return [self._checked(p.createCollisionShape(p.GEOM_SPHERE, radius=radius, physicsClientId=self.client), "sphere")]

    def cylinder_shape(self, radius: float, length: float) -> list[int]:
        """Returns a cylinder about z."""
        uid = p.createCollisionShape(p.GEOM_CYLINDER, radius=radius, height=length, physicsClientId=self.client)
        return [self._checked(uid, "cylinder")]

    def mesh_shape(self, vertices: NDArray[np.float64], triangles: NDArray[np.int64], name: str) -> list[int]:
        """Returns a triangle mesh, hollow and as fine as given, in as many pieces as PyBullet's limits ask for.

        Args:
            vertices: (V, 3), metres.
            triangles: (T, 3) indices into ``vertices``.
            name: for error messages.
        """
        shapes = []
        for points, corners in _pieces(vertices, triangles):
            with _quiet():
                uid = p.createCollisionShape(
                    p.GEOM_MESH, vertices=points.tolist(), indices=corners.ravel().tolist(),
                    flags=p.GEOM_FORCE_CONCAVE_TRIMESH | p.GEOM_CONCAVE_INTERNAL_EDGE, physicsClientId=self.client,
                )  # fmt: skip
            shapes.append(self._checked(uid, name))
        return shapes

    def add_static(self, shapes: Sequence[int], pose: Pose, name: str) -> None:
        """Puts shapes into the world for good; shapes may be used many times."""
        for shape in shapes:
            # Rigid bodies, not multi-bodies: Bullet visits every multi-body in every step, static ones too.
            uid = p.createMultiBody(
                0,
                shape,
                basePosition=pose.position,
                baseOrientation=pose.quat_xyzw,
                useMaximalCoordinates=1,
                physicsClientId=self.client,
            )
            self._names[self._checked(uid, "static body")] = name
            p.changeDynamics(uid, -1, lateralFriction=1.0, restitution=0.0, physicsClientId=self.client)

    @staticmethod
    def _checked(uid: int, what: str) -> int:
        if uid < 0:
            raise PhysicsError(f"PyBullet refused the collision shape of {what}")
        return int(uid)

    # Bodies with joints

    @property
    def folder(self) -> Path:
        """A folder of this engine for files; it goes with the engine."""
        if self._folder is None:
            self._folder = tempfile.TemporaryDirectory(prefix="gibson_sim_physics_")
        return Path(self._folder.name)

    def write_mesh(self, vertices: NDArray[np.float64], triangles: NDArray[Any]) -> Path:
        """Returns an OBJ file with the triangles; equal ones share a file.

        Args:
            vertices: (V, 3), metres.
            triangles: (T, 3) indices into ``vertices``.
        """
        lines = [f"v {x!r} {y!r} {z!r}" for x, y, z in vertices.tolist()]
        lines += [f"f {a} {b} {c}" for a, b, c in (triangles + 1).tolist()]
        text = "\n".join(lines) + "\n"
        path = self.folder / f"{hashlib.sha256(text.encode()).hexdigest()[:32]}.obj"
        if not path.is_file():
            path.write_text(text)
        return path

    def wake_all(self) -> None:
        """Lets no body sleep on in the next step: what moves by itself wakes what it touches, what is put somewhere does not."""
        self._wake = True

    def load_urdf(self, text: str, pose: Pose, name: str, *, static: bool = False, sleeps: bool = False) -> BulletBody:
        """Adds a body whose root link frame is at ``pose``; its motors are off.

        Args:
            text: URDF with absolute mesh paths (``robots.rigid.physics_urdf``).
            pose: T_world_root.
            name: for error messages.
            static: its root never moves by itself.
            sleeps: costs nothing while it rests, until something that moves touches it.
        """
        path = self.folder / "body.urdf"
        path.write_text(text, encoding="utf-8")
        flags = p.URDF_USE_INERTIA_FROM_FILE | p.URDF_MAINTAIN_LINK_ORDER | p.URDF_USE_IMPLICIT_CYLINDER
        flags |= p.URDF_ENABLE_SLEEPING if sleeps else 0
        try:
            with _quiet():
                uid = p.loadURDF(
                    str(path), pose.position, pose.quat_xyzw, useFixedBase=static, flags=flags, physicsClientId=self.client
                )
        except p.error as error:
            raise PhysicsError(f"PyBullet refused the URDF of {name!r} ({error}); log level DEBUG shows its reasons") from error
        count = p.getNumJoints(uid, physicsClientId=self.client)
        joints = {p.getJointInfo(uid, i, physicsClientId=self.client)[1].decode(): i for i in range(count)}
        inertial = [p.getDynamicsInfo(uid, i, physicsClientId=self.client)[3:5] for i in range(-1, count)]
        body = BulletBody(uid, joints, inertial)
        self._names[uid] = name
        for i in range(-1, count):
            # Bullet's default drag would slow a freely rolling wheel.
            p.changeDynamics(uid, i, linearDamping=0.0, angularDamping=0.0, restitution=0.0, physicsClientId=self.client)
        for i in range(count):
            p.changeDynamics(uid, i, jointDamping=0.0, physicsClientId=self.client)
            if p.getJointInfo(uid, i, physicsClientId=self.client)[2] != p.JOINT_FIXED:
                p.setJointMotorControl2(uid, i, p.VELOCITY_CONTROL, force=0.0, physicsClientId=self.client)
        if sleeps:
            self._sleepers.add(uid)
            state = p.ACTIVATION_STATE_ENABLE_SLEEPING
            p.changeDynamics(uid, -1, activationState=state, sleepThreshold=_SLEEP_THRESHOLD, physicsClientId=self.client)
        self.wake_all()
        return body

    def let_rays_pass(self, body: BulletBody, name: str) -> None:
        """Lets ``cast_rays`` leave this body out."""
        if not self._ray_bits:
            raise PhysicsError(f"cannot add {name!r}: a world holds at most {MAX_BODIES_WITH_RAYS} robots")
        body.ray_bit = min(self._ray_bits)
        self._ray_bits.remove(body.ray_bit)
        for i in range(-1, body.link_count):
            p.setCollisionFilterGroupMask(body.uid, i, 1 << body.ray_bit, -1, physicsClientId=self.client)

    def remove(self, body: BulletBody) -> None:
        """Takes a body out of the world."""
        p.removeBody(body.uid, physicsClientId=self.client)
        del self._names[body.uid]
        self._sleepers.discard(body.uid)
        self._thrown.pop(body.uid, None)
        self.wake_all()
        if body.ray_bit:
            self._ray_bits.add(body.ray_bit)

    def place(self, body: BulletBody, pose: Pose) -> None:
        """Puts the root link's frame at ``pose`` (T_world_root); joints and velocities stay."""
        quat = product(pose.quat_xyzw, body.root_inertial[1])
        center = np.array(pose.position) - turn(np.array([quat]), body.links_in_inertial[:1])[0]
        p.resetBasePositionAndOrientation(body.uid, center.tolist(), quat, physicsClientId=self.client)
        self.wake_all()

    def set_velocity(self, body: BulletBody, quat_xyzw: Quat, linear: NDArray[np.float64], angular: NDArray[np.float64]) -> None:
        """Sets the velocity of the root link's origin.

        Args:
            body: whose.
            quat_xyzw: orientation of the root link's frame now.
            linear: (3,), m/s, world frame.
            angular: (3,), rad/s, world frame.
        """
        to_frame = turn(np.array([product(quat_xyzw, body.root_inertial[1])]), body.links_in_inertial[:1])[0]
        center = linear - cross(angular[None], to_frame[None])[0]
        p.resetBaseVelocity(body.uid, center.tolist(), angular.tolist(), physicsClientId=self.client)
        if body.uid in self._sleepers:
            self._thrown[body.uid] = (center.tolist(), angular.tolist())
        self.wake_all()

    def place_joint(self, body: BulletBody, index: int, position: float) -> None:
        """Puts a joint at ``position`` (radians or metres), at rest."""
        p.resetJointState(body.uid, index, position, 0.0, physicsClientId=self.client)
        self.wake_all()

    def damp_joint(self, body: BulletBody, index: int, damping: float) -> None:
        """Slows a joint by ``damping`` (N m s/rad or N s/m) times its speed."""
        p.changeDynamics(body.uid, index, jointDamping=damping, physicsClientId=self.client)

    def contacts(self, body: BulletBody) -> list[EngineContact]:
        """Returns what touches the body; it is always ``a``."""
        points = p.getContactPoints(bodyA=body.uid, physicsClientId=self.client) or ()
        out = []
        for point in points:
            _, a, b, link_a, link_b, _, position, normal, distance, force = point[:10]
            if a != body.uid:
                a, b, link_a, link_b, normal = b, a, link_b, link_a, tuple(-c for c in normal)
                position = point[5]
            if force > 0.0 or distance <= 0.0:
                out.append(EngineContact(link_a, self._names.get(b, ""), link_b, position, normal, force, distance))
        return out

    def raw_states(self, body: BulletBody) -> list[tuple[float, ...]]:
        """Returns 13 numbers of the root and of every link below it: see ``frames.FrameTable.groups``."""
        rows = [self.raw_root(body)]
        if body.link_count:
            states = p.getLinkStates(
                body.uid, body.link_indices, computeLinkVelocity=1, computeForwardKinematics=1, physicsClientId=self.client
            )
            # 0, 1: pose of the centre of mass; 6, 7: its velocities. The link frames at 4 and 5 are rounded to 32 bits.
            rows += [(*s[0], *s[1], *s[6], *s[7]) for s in states]
        return rows

    def raw_root(self, body: BulletBody) -> tuple[float, ...]:
        """Returns the first of ``raw_states``."""
        position, quat = p.getBasePositionAndOrientation(body.uid, physicsClientId=self.client)
        linear, angular = p.getBaseVelocity(body.uid, physicsClientId=self.client)
        return (*position, *quat, *linear, *angular)

    def joint_reading(self, body: BulletBody, indices: Sequence[int]) -> JointReading:
        """Returns positions, velocities and motor efforts of the joints."""
        states = p.getJointStates(body.uid, indices, physicsClientId=self.client) if indices else ()
        data = np.array([(s[0], s[1], s[3]) for s in states]).reshape(-1, 3)
        return JointReading(data[:, 0], data[:, 1], data[:, 2])

    def joint_angles(self, body: BulletBody, indices: Sequence[int]) -> list[float]:
        """Returns the positions alone: radians or metres."""
        return [s[0] for s in p.getJointStates(body.uid, indices, physicsClientId=self.client)] if indices else []

    def drive_joints(self, body: BulletBody, indices: Sequence[int], speeds: Sequence[float], efforts: Sequence[float]) -> None:
        """Lets motors hold ``speeds`` (rad/s) with at most ``efforts`` (N m)."""
        p.setJointMotorControlArray(
            body.uid, indices, p.VELOCITY_CONTROL, targetVelocities=speeds, forces=efforts, physicsClientId=self.client
        )

    def hold_joints(self, body: BulletBody, indices: Sequence[int], positions: Sequence[float], efforts: Sequence[float]) -> None:
        """Lets motors hold ``positions`` (radians or metres) with at most ``efforts`` (N m or N)."""
        p.setJointMotorControlArray(
            body.uid, indices, p.POSITION_CONTROL, targetPositions=positions, forces=efforts, physicsClientId=self.client
        )

    # Rays

    def cast_rays(self, starts: NDArray[np.float64], ends: NDArray[np.float64], ignore: BulletBody | None) -> NDArray[np.float64]:
        """Returns for each ray, (N, 3) to (N, 3), the fraction of its length to the first hit, (N,); +inf = no hit."""
        mask = -1 if ignore is None else -1 & ~(1 << ignore.ray_bit)
        fractions: list[float] = []
        for i in range(0, len(starts), _RAYS_PER_CALL):
            hits = p.rayTestBatch(
                starts[i : i + _RAYS_PER_CALL].tolist(), ends[i : i + _RAYS_PER_CALL].tolist(),
                numThreads=self._ray_threads, collisionFilterMask=mask, physicsClientId=self.client,
            )  # fmt: skip
            fractions.extend([hit[2] if hit[0] >= 0 else np.inf for hit in hits])
        return np.array(fractions, dtype=np.float64)


def convex_parts(
    vertices: NDArray[np.float64], triangles: NDArray[np.int64]
) -> list[tuple[NDArray[np.float64], NDArray[np.int64]]]:
    """Returns convex parts that together fill about what a mesh fills, each as vertices (V, 3) and triangles (F, 3); V-HACD makes them.

    Args:
        vertices: (V, 3).
        triangles: (F, 3).

    Raises:
        PhysicsError: it makes none.
    """
    with tempfile.TemporaryDirectory(prefix="gibson_sim_parts_") as folder:
        whole, parts = Path(folder, "whole.obj"), Path(folder, "parts.obj")
        with whole.open("w", encoding="ascii") as file:
            file.writelines(f"v {x!r} {y!r} {z!r}\n" for x, y, z in vertices.tolist())
            file.writelines(f"f {a} {b} {c}\n" for a, b, c in (triangles + 1).tolist())
        with _quiet():
            p.vhacd(str(whole), str(parts), str(Path(folder, "log.txt")), resolution=_VOXELS)
        lines = parts.read_text(encoding="ascii").splitlines() if parts.is_file() else []
    points = np.array([line.split()[1:4] for line in lines if line.startswith("v ")], dtype=np.float64).reshape(-1, 3)
    out, faces = [], []
    for line in [*lines, "o end"]:
        if line.startswith("f "):
            faces.append([int(corner) - 1 for corner in line.split()[1:4]])
        elif line.startswith("o ") and faces:
            used, corners = np.unique(np.array(faces, dtype=np.int64), return_inverse=True)
            out.append((points[used], corners.reshape(-1, 3)))
            faces = []
    if not out:
        raise PhysicsError(f"V-HACD makes no convex parts of a mesh with {len(triangles)} triangles; is it flat, or empty?")
    return out


def _pieces(
    vertices: NDArray[np.float64], triangles: NDArray[np.int64]
) -> Iterator[tuple[NDArray[np.float64], NDArray[np.int64]]]:
    """Yields (vertices, triangles) of pieces below the size limit, cut across the longest axis so that each is compact."""
    if len(triangles) <= _TRIANGLE_LIMIT:
        used, corners = np.unique(triangles, return_inverse=True)
        if len(used) <= _VERTEX_LIMIT:
            yield vertices[used], corners.reshape(-1, 3)
            return
    centers = vertices[triangles].mean(axis=1)
    axis = int(np.argmax(np.ptp(centers, axis=0)))
    order = np.argsort(centers[:, axis], kind="stable")
    half = len(order) // 2
    yield from _pieces(vertices, triangles[order[:half]])
    yield from _pieces(vertices, triangles[order[half:]])
