"""One body in the engine: its joints, its shapes, the frames of its links.

``BodyInWorld`` is a body, and the base class of robots. The rest of the module assigns points on a rigid group to links, computes bounding boxes of
shapes, and converts collision meshes for the engine: convex hulls for movable bodies, all triangles for static ones.
"""

from __future__ import annotations

import math
import os
import re
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import replace
from functools import lru_cache
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import ConvexHull, QhullError

from gibson_sim.description.body import BodySpec
from gibson_sim.description.rigid_groups import MOVING_TYPES, RigidGroup, physics_urdf, rigid_groups
from gibson_sim.description.shapes import Shape, ShapeKind
from gibson_sim.description.urdf import UrdfModel
from gibson_sim.errors import MeshError, PhysicsError
from gibson_sim.formats.load_mesh import load_shape
from gibson_sim.geometry.transforms import Mat4, invert, matrices_from_poses, matrix_from_pose, quat_from_matrix, transform_points
from gibson_sim.physics.bullet import Bullet
from gibson_sim.physics.engine_files import to_obj
from gibson_sim.physics.engine_types import BulletBody
from gibson_sim.physics.frames import F64, FrameTable, right_multiplication
from gibson_sim.physics.joint_motors import JointMotors
from gibson_sim.quoting import quoted
from gibson_sim.robots.joints.commands import JointCommand
from gibson_sim.robots.joints.kinematics import Chain, ChainSolution
from gibson_sim.types import Pose, Vec3

_ENGINE_MESHES = (".obj",)
"""Formats read by the engine itself, with one convex hull per object in the file."""
_ENGINE_PRIMITIVES: tuple[ShapeKind, ...] = ("box", "sphere", "cylinder", "capsule")
"""Kinds that the engine has itself; the others become convex hulls."""
_MAX_ENGINE_BYTES = 2_000_000
"""Largest file read by the engine itself, which takes 0.1 s and blocks the simulation. ``prepare_meshes`` computes the hulls of larger files in
another thread."""


class BodyInWorld:
    """A tree of links in the engine."""

    sleeps = True
    """Whether the engine may put the body to sleep while it is at rest, which saves time."""

    def __init__(
        self,
        bullet: Bullet,
        name: str,
        model: UrdfModel,
        start: Pose,
        *,
        static: bool = False,
        concave: bool | None = None,
        joints: Sequence[tuple[str, float]] = (),
    ) -> None:
        """Loads the body.

        Args:
            bullet: The engine.
            name: Name of the body.
            model: Links and joints of the body.
            start: T_world_root.
            static: Whether only ``set_state`` moves the root.
            concave: Whether collision meshes keep all triangles, as hollow surfaces; None = only for a static body.
            joints: Names and initial positions of joints, radians or metres.
        """
        self.name, self.model, self.start, self.static = name, model, start, static
        self._concave = static if concave is None else concave
        self._start_joints = dict(joints)
        self.links = tuple(link.name for link in model.links)
        """Names of all links, the root first, without the body name."""
        self.full_links = tuple(f"{name}/{link}" for link in self.links)
        """Names of all links with the body name: ``<body>/<link>``."""
        self.moving_joints = tuple(joint.name for joint in model.joints if joint.kind in MOVING_TYPES)
        """Names of the movable joints, in the order of the URDF."""
        groups, warnings = rigid_groups(model, fixed_root=static)
        self.warnings = [*model.warnings, *warnings]
        self._groups = tuple(self._with_engine_meshes(bullet, group) for group in groups)
        self._urdf = physics_urdf(model, self._groups, concave=self._concave)
        self.load(bullet)
        self._names_of_rows = {self._row(group) - 1: group.name for group in self._groups}
        self.table = self._frame_table()
        self._root_table = self.table.root
        self._chains: dict[tuple[str, tuple[str, ...] | None], Chain] = {}
        self._link_shapes: dict[int, _LinkShapes] = {}
        self._outlines: list[tuple[int, Shape, Mat4, F64]] | None = None
        """Row, shape, T_group_shape and ``_corners`` of each collision shape; None = not computed yet."""

    def load(self, bullet: Bullet) -> None:
        """Loads the body at its start, at rest, with its joints at their initial positions."""
        self.engine_body: BulletBody = bullet.load_urdf(self._urdf, self.start, self.name, static=self.static, sleeps=self.sleeps)
        indices = self.engine_body.joint_indices
        for name, position in self.model.with_followers(self._start_joints).items():
            if name not in indices:
                known = ", ".join(self.moving_joints) or "none"
                raise PhysicsError(f"{quoted(self.name)} has no movable joint {quoted(name)}; known: {known}")
            bullet.place_joint(self.engine_body, indices[name], position)
        for joint in self.model.joints:
            if joint.mimic is not None:
                bullet.gear_joints(self.engine_body, indices[joint.name], indices[joint.mimic.leader], joint.mimic)
        self.motors: JointMotors | None = None
        """Joint motors; None = no joint has been commanded."""
        self._set_up_motors(bullet)

    def _set_up_motors(self, bullet: Bullet) -> None:
        """Sets the friction and damping of joints without motors, such as doors and drawers, which otherwise move freely."""
        for joint in self.model.joints:
            if joint.kind not in ("revolute", "prismatic", "continuous"):
                continue
            index = self.engine_body.joint_indices[joint.name]
            if joint.damping:
                bullet.damp_joint(self.engine_body, index, joint.damping)
            if joint.friction:
                # Dry friction is modelled by a weak motor with target velocity 0.
                bullet.drive_joints(self.engine_body, [index], [0.0], [joint.friction])

    # Joints

    def command_joints(self, bullet: Bullet, command: JointCommand, now_ns: int) -> None:
        """Applies ``command`` from the next step on; see ``JointMotors.command``."""
        if self.motors is None:
            self.motors = JointMotors(self.engine_body, [joint for joint in self.model.joints if joint.has_motor])
        self.motors.command(bullet, command, now_ns)

    def forget_commands(self, bullet: Bullet, now_ns: int) -> None:
        """Stops moving joints until the next command."""
        if self.motors is not None:
            self.motors.stop(bullet, now_ns)

    def actuate_joints(self, bullet: Bullet, now_ns: int, dt: float) -> None:
        """Sets the joint motors for the step that begins at ``now_ns`` and lasts ``dt`` seconds."""
        if self.motors is not None:
            self.motors.actuate(bullet, now_ns, dt)

    def joint_positions(self, bullet: Bullet) -> dict[str, float]:
        """Returns the positions of all movable joints, radians or metres."""
        indices = self.engine_body.joint_indices
        angles = bullet.joint_angles(self.engine_body, [indices[name] for name in self.moving_joints])
        return dict(zip(self.moving_joints, angles, strict=True))

    def chain(self, tip: str, joints: Sequence[str] | None = None) -> Chain:
        """Returns the kinematic chain from the root to a link; see ``Chain``."""
        key = tip, None if joints is None else tuple(joints)
        if key not in self._chains:
            self._chains[key] = Chain(self.model, tip, joints)
        return self._chains[key]

    def solve_chain(
        self,
        bullet: Bullet,
        link: str,
        target: Pose,
        *,
        joints: Sequence[str] | None = None,
        rest: Mapping[str, float] | None = None,
        orientation: bool = True,
    ) -> ChainSolution:
        """Solves the inverse kinematics of a link for ``target`` (T_world_link); see ``PhysicsWorld.solve_chain``."""
        T_root_target = invert(matrix_from_pose(self.root_state(bullet)[0])) @ matrix_from_pose(target)
        return self.chain(link, joints).solve(T_root_target, self.joint_positions(bullet), rest=rest, orientation=orientation)

    # Poses

    def root_state(self, bullet: Bullet) -> tuple[Pose, F64, F64]:
        """Returns T_world_root, linear (m/s) and angular (rad/s) velocity of the root link's origin, world frame."""
        raw = np.array([bullet.raw_root(self.engine_body)])
        positions, quats, linear, angular = self._root_table.groups(raw)
        x, y, z = positions[0].tolist()
        qx, qy, qz, qw = quats[0].tolist()
        return Pose((x, y, z), (qx, qy, qz, qw)), linear[0], angular[0]

    def set_state(self, bullet: Bullet, pose: Pose | None, linear: Vec3 | None, angular: Vec3 | None) -> None:
        """Sets the pose or velocity of the root; None = unchanged."""
        pose_now, linear_now, angular_now = self.root_state(bullet)
        if pose is not None:
            bullet.place(self.engine_body, pose)
        if self.static:
            return
        spin = np.asarray(angular_now if angular is None else angular, dtype=np.float64)
        speed = np.asarray(linear_now if linear is None else linear, dtype=np.float64)
        bullet.set_velocity(self.engine_body, (pose or pose_now).quat_xyzw, speed, spin)

    def bounds(self, bullet: Bullet, T_frame_world: Mat4) -> tuple[F64, F64]:
        """Returns the minimum and maximum corner, each (3,), metres, of the bounding box of all collision shapes in a frame.

        For a body without collision shapes, both are the origin of its root.
        """
        positions, quats, _, _ = self.table.groups(bullet.raw_states(self.engine_body))
        world_from_group = matrices_from_poses(positions, quats)
        low, high = np.full(3, np.inf), np.full(3, -np.inf)
        if self._outlines is None:
            self._outlines = [(self._row(g), s, T, _corners(s)) for g in self._groups for s, T in g.collisions]
        for row, shape, T_group_shape, points in self._outlines:
            lowest, highest = _extent(shape, T_frame_world @ world_from_group[row] @ T_group_shape, points)
            low, high = np.minimum(low, lowest), np.maximum(high, highest)
        if not np.isfinite(low).all():
            root = transform_points(T_frame_world, positions[:1])[0]
            return root, root.copy()
        return low, high

    # Links, and the rows of ``Bullet.raw_states`` that move them

    def row_of_link(self, link: str) -> int:
        """Returns the row of ``Bullet.raw_states`` of a link's rigid group: 0 = the root; the engine's link index is one less."""
        return int(self.table.rows[self._index_of_link(link)])

    def link_of_row(self, row: int) -> str:
        """Returns the name of the link whose rigid group is the engine's link ``row`` (-1 = the root)."""
        if row not in self._names_of_rows:
            raise PhysicsError(f"body {quoted(self.name)} has no link with index {row}")
        return self._names_of_rows[row]

    def link_position(self, bullet: Bullet, link: str) -> Vec3:
        """Returns the origin of a link, world frame, metres."""
        positions, _, _ = self.table.links(bullet.raw_states(self.engine_body))
        x, y, z = positions[self._index_of_link(link)].tolist()
        return x, y, z

    def link_at(self, bullet: Bullet, row: int, point: Vec3) -> str:
        """Returns the link to which a point on the surface of the engine's link ``row`` (-1 = the root) belongs.

        Args:
            bullet: The engine.
            row: Engine index of the link.
            point: Position of the point, world frame, metres.
        """
        group = next(group for group in self._groups if self._row(group) == row + 1)
        if row not in self._link_shapes:
            self._link_shapes[row] = _LinkShapes(self.model, group)
        positions, quats, _, _ = self.table.groups(bullet.raw_states(self.engine_body))
        T_group_world = invert(matrices_from_poses(positions, quats)[row + 1])
        return self._link_shapes[row].nearest(T_group_world[:3, :3] @ np.array(point) + T_group_world[:3, 3])

    def _row(self, group: RigidGroup) -> int:
        return 0 if group.joint is None else 1 + self.engine_body.joint_indices[group.joint.name]

    def _index_of_link(self, link: str) -> int:
        if link not in self.links:
            raise PhysicsError(f"{quoted(self.name)} has no link {quoted(link)}; known: {', '.join(self.links)}")
        return self.links.index(link)

    def _frame_table(self) -> FrameTable:
        """Returns the poses of the links relative to the inertial frames that the engine moves."""
        group_of: dict[str, tuple[RigidGroup, Mat4]] = {
            link: (group, T_group_link) for group in self._groups for link, T_group_link in group.members.items()
        }
        rows, offsets, rotations = [], [], []
        for link in self.links:
            group, T_group_link = group_of[link]
            rows.append(self._row(group))
            offsets.append(T_group_link[:3, 3])
            rotations.append(right_multiplication(quat_from_matrix(T_group_link[:3, :3])))
        return FrameTable(
            self.engine_body.links_in_inertial,
            self.engine_body.link_rotations,
            np.array(rows, dtype=np.intp),
            np.array(offsets),
            np.array(rotations),
        )

    def _with_engine_meshes(self, bullet: Bullet, group: RigidGroup) -> RigidGroup:
        """Returns the group with meshes converted to files for the engine; an unreadable mesh is omitted with a warning."""
        collisions = []
        for shape, pose in group.collisions:
            try:
                collisions.append((self._engine_shape(bullet, shape), pose))
            except MeshError as error:
                self.warnings.append(f"{self.name}: collision of link {quoted(group.name)} is left out: {error}")
        return replace(group, collisions=collisions)

    def _engine_shape(self, bullet: Bullet, shape: Shape) -> Shape:
        if shape.kind in _ENGINE_PRIMITIVES:
            return shape
        if shape.kind == "mesh" and not self._concave and _engine_reads(shape.mesh):
            return replace(shape, mesh=str(bullet.files.copy_obj(shape.mesh)))
        text = mesh_obj(shape) if self._concave else to_obj(*hull_of(shape)).encode()
        return Shape("mesh", (1.0, 1.0, 1.0), str(bullet.files.write_obj(text)))


# Which link of a rigid group a point belongs to


class _LinkShapes:
    """The collision shapes of one rigid group, by link."""

    def __init__(self, model: UrdfModel, group: RigidGroup) -> None:
        """Collects the shapes of all links of the group."""
        self._first = group.name
        self._shapes = [
            (name, invert(T_group_link @ matrix_from_pose(item.pose)), item.shape, _planes(item.shape))
            for name, T_group_link in group.members.items()
            for item in model.link(name).collisions
        ]

    def nearest(self, point: F64) -> str:
        """Returns the link whose shape is nearest to a point, (3,), metres, group's frame; the group's first link if no link has a shape."""
        if len({name for name, *_ in self._shapes}) < 2:
            return self._shapes[0][0] if self._shapes else self._first
        return min(self._shapes, key=lambda entry: _distance(entry[1], entry[2], entry[3], point))[0]


def _planes(shape: Shape) -> F64:
    """Returns the outward planes, (P, 4), of the convex hull of a mesh, ellipsoid or cone; (0, 4) for other shapes and for flat meshes."""
    if shape.kind in _ENGINE_PRIMITIVES:
        return np.zeros((0, 4))
    vertices, _ = load_shape(shape).merged()
    try:
        return np.asarray(ConvexHull(vertices).equations)
    except (QhullError, ValueError):
        return np.zeros((0, 4))


def _distance(T_shape_group: Mat4, shape: Shape, planes: F64, point: F64) -> float:
    """Returns the distance of a point in the group's frame from a shape, metres; negative inside."""
    local = T_shape_group[:3, :3] @ point + T_shape_group[:3, 3]
    if shape.kind == "sphere":
        return float(np.linalg.norm(local)) - shape.size[0]
    if shape.kind == "capsule":
        beyond = max(abs(float(local[2])) - shape.size[1] / 2, 0.0)
        return math.hypot(local[0], local[1], beyond) - shape.size[0]
    if shape.kind == "box":
        return _outside([abs(c) - size / 2 for c, size in zip(local.tolist(), shape.size, strict=True)])
    if shape.kind == "cylinder":
        return _outside([math.hypot(local[0], local[1]) - shape.size[0], abs(float(local[2])) - shape.size[1] / 2])
    return float((planes[:, :3] @ local + planes[:, 3]).max()) if len(planes) else math.inf


def _outside(excess: Sequence[float]) -> float:
    """Returns the signed distance to a box or a cylinder, from the signed distances of a point to each pair of sides."""
    return math.hypot(*(max(c, 0.0) for c in excess)) + min(max(excess), 0.0)


# Bounding boxes of shapes


def _corners(shape: Shape) -> F64:
    """Returns the points, (N, 3), that determine the bounding box of a shape; (0, 3) for round shapes."""
    if shape.kind == "box":
        signs = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)])
        return np.asarray(signs * np.array(shape.size) / 2)
    if shape.kind not in _ENGINE_PRIMITIVES:
        vertices, _ = load_shape(shape).merged()
        return vertices
    return np.zeros((0, 3))


def _extent(shape: Shape, T_frame_shape: Mat4, points: F64) -> tuple[F64, F64]:
    """Returns the minimum and maximum corner, each (3,), of the bounding box of a shape in a frame."""
    if len(points):
        corners = transform_points(T_frame_shape, points)
        return corners.min(axis=0), corners.max(axis=0)
    center, radius = T_frame_shape[:3, 3], shape.size[0]
    if shape.kind == "sphere":
        reach = np.full(3, radius)
    elif shape.kind == "capsule":
        reach = np.abs(T_frame_shape[:3, 2]) * shape.size[1] / 2 + radius
    else:
        axis = T_frame_shape[:3, 2]
        reach = np.abs(axis) * shape.size[1] / 2 + radius * np.sqrt(np.maximum(0.0, 1.0 - axis**2))
    return center - reach, center + reach


# Meshes for the engine


def prepare_meshes(spec: BodySpec) -> None:
    """Converts a body's collision meshes for the engine, in any thread, so that adding the body later is fast."""
    groups, _ = rigid_groups(spec.model, fixed_root=spec.static)
    for shape, _ in (collision for group in groups for collision in group.collisions):
        if shape.kind == "mesh" and (spec.static or not _engine_reads(shape.mesh)):
            with suppress(MeshError):  # the body itself warns of it
                (mesh_obj if spec.static else hull_of)(shape)


def _engine_reads(mesh: str) -> bool:
    """Returns whether the engine itself reads the mesh of a movable body."""
    if not mesh.lower().endswith(_ENGINE_MESHES):
        return False
    try:
        if os.path.getsize(mesh) <= _MAX_ENGINE_BYTES:
            return True
        # The engine creates one hull per object of an OBJ: files of convex parts have several objects.
        return len(re.findall(rb"^[og]\s", Path(mesh).read_bytes(), re.MULTILINE)) > 1
    except OSError:
        return True  # which then reports the error


def hull_of(shape: Shape) -> tuple[F64, NDArray[np.int64]]:
    """Returns vertices (N, 3) and outward triangles (T, 3) of the convex hull of a scaled mesh; reads a changed file again.

    Raises:
        MeshError: the mesh cannot be read, or is flat.
    """
    return _hull(shape, _file_version(shape.mesh))


def mesh_obj(shape: Shape) -> bytes:
    """Returns the text of an OBJ file with all triangles of a scaled mesh, equal vertices merged; reads a changed file again.

    Raises:
        MeshError: the mesh cannot be read.
    """
    return _mesh_obj(shape, _file_version(shape.mesh))


def _file_version(file: str) -> tuple[int, ...]:
    try:
        state = os.stat(file)
    except (OSError, ValueError):
        return ()
    return state.st_ino, state.st_size, state.st_mtime_ns


@lru_cache(maxsize=16)
def _mesh_obj(shape: Shape, version: tuple[int, ...]) -> bytes:
    del version
    vertices, triangles = load_shape(shape).merged()
    rows = np.ascontiguousarray(vertices + 0.0).view([("", np.float64)] * 3).ravel()  # + 0.0 turns -0 into 0
    _, first, same = np.unique(rows, return_index=True, return_inverse=True)
    return to_obj(vertices[first], same[triangles]).encode()


@lru_cache(maxsize=256)
def _hull(shape: Shape, version: tuple[int, ...]) -> tuple[F64, NDArray[np.int64]]:
    del version
    vertices, _ = load_shape(shape).merged()
    try:
        hull = ConvexHull(vertices)
    except (QhullError, ValueError) as error:
        raise MeshError(f"{shape.mesh}: has no convex hull (flat, or not finite); give the body a box as collision") from error
    corners = vertices[hull.vertices]
    number = {int(v): i for i, v in enumerate(hull.vertices)}
    triangles = np.array([[number[int(v)] for v in simplex] for simplex in hull.simplices], dtype=np.int64)
    a, b, c = (corners[triangles[:, i]] for i in range(3))
    inward = np.einsum("ij,ij->i", np.cross(b - a, c - a), hull.equations[:, :3]) < 0
    triangles[inward] = triangles[inward][:, ::-1]
    return corners, triangles
