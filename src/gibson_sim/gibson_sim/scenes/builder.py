"""Collects the elements of a scene while its file is read, and builds the SceneSpec: unique names, warnings, digest, floor height."""

from __future__ import annotations

import hashlib
import os
import re
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from gibson_sim.description.body import BodySpec
from gibson_sim.description.omissions import Omission, OmissionKind, kind_of
from gibson_sim.description.shapes import Appearance, Shape, VisualSpec
from gibson_sim.errors import SceneError, SceneNotFoundError
from gibson_sim.formats.file_roots import description_roots, is_inside, package_roots
from gibson_sim.formats.load_mesh import MeshLoader
from gibson_sim.formats.mesh import TO_Z_UP, UpAxis, merge
from gibson_sim.formats.splats import up_axis_of
from gibson_sim.formats.textures import IMAGE_SUFFIXES
from gibson_sim.formats.uris import environment_folders, is_registered
from gibson_sim.geometry.transforms import pose_from_matrix, transform_points
from gibson_sim.quoting import quoted
from gibson_sim.reading import is_file, read_file, real_path
from gibson_sim.scenes.collision.scan import scan_shapes
from gibson_sim.scenes.room_spec import RoomSpec
from gibson_sim.scenes.scene_meshes import shape_triangles
from gibson_sim.scenes.spec import CollisionSpec, LightSpec, SceneSpec, SplatsSpec, StartPose
from gibson_sim.types import Rgba, Vec3

F64 = NDArray[np.float64]
FAR_AWAY = 1e4
"""Maximum absolute coordinate in a scene, metres; a larger one is an error in the file."""
_MAX_NAME = 200
"""Maximum length of a scene's name, characters."""
_MAX_CLASS = 200
"""Maximum length of the model name from which a class is derived, characters."""
_UP_FACING = 0.98
"""Minimum cosine of the angle between the normal of a floor and the vertical."""
_BIN = 0.02
"""Bin width of the histogram of triangle heights, metres."""


class SceneBuilder:
    """Collects the elements of one scene.

    Args:
        name: name of the scene.
        root: folder of its files.
        extra_roots: further folders that its files may lie in; None = anywhere.
        environment: whether its files may also lie in folders named by environment variables such as ``$GAZEBO_MODEL_PATH``.
        description: the file in ``root`` that describes the scene; if it is a symbolic link, files may also lie in the folder of its
            target. None = the description is not a file.
        max_bytes: maximum size of a mesh file, bytes; None = unlimited.
    """

    def __init__(
        self,
        name: str,
        root: Path,
        extra_roots: Sequence[Path] | None = (),
        *,
        environment: bool = False,
        description: Path | None = None,
        max_bytes: int | None = None,
    ) -> None:
        self.name = name
        self.description = ""
        self.root = Path(os.path.realpath(root))
        self._description_roots = (self.root,) if description is None else description_roots(root, description)
        self._environment = environment
        environment_roots = environment_folders() if environment else ()
        self.roots: tuple[Path, ...] | None = (
            None if extra_roots is None else (*self._description_roots, *extra_roots, *environment_roots)
        )
        """Folders that the files of the scene must lie in; None = anywhere."""
        self.loader = MeshLoader(self.roots, textures=False, max_bytes=max_bytes)
        # The reader of a body has already checked the location of its files.
        self._body_loader = MeshLoader(None, textures=False, max_bytes=max_bytes)
        self.gravity: Vec3 = (0.0, 0.0, -9.81)
        self.ground_z: float | None = None
        self.ground_friction = 1.0
        self.floor_z: float | None = None
        self.floors: tuple[float, ...] = ()
        self.light = LightSpec()
        self.splats: SplatsSpec | None = None
        self.sdf_lamps = False
        self.starts: list[StartPose] = []
        self.visuals: list[VisualSpec] = []
        self.collisions: list[CollisionSpec] = []
        self.bodies: list[BodySpec] = []
        self.rooms: list[RoomSpec] = []
        self._visual_names: dict[str, int] = {}
        self._collision_names: dict[str, int] = {}
        self.warnings: list[Omission] = []
        self._files: dict[Path, None] = {}
        self._texts: list[bytes] = []

    def warn(self, text: str, kind: OmissionKind | None = None) -> None:
        """Adds one line to the warnings, unless it is a duplicate; paths below the root are shortened.

        Args:
            text: the line.
            kind: kind of the omission; None = that of ``text``, if it is an ``Omission``.
        """
        short = Omission(text.replace(f"{self.root}{os.sep}", ""), kind or kind_of(text))
        if short not in self.warnings:
            self.warnings.append(short)

    def admits(self, path: Path) -> bool:
        """Returns whether a model or a mesh may be read: it lies in the roots, or in a folder named by an environment variable.

        In the second case its package is added to the roots, so that it may name files of that package.
        """
        if self.roots is None or is_inside(path, self.roots):
            return True
        if not (self._environment and is_registered(path)):
            return False
        self._add_roots(*package_roots(path))
        return True

    def _add_roots(self, *roots: Path) -> None:
        if self.roots is not None:
            self.roots = self.loader.roots = tuple(dict.fromkeys((*self.roots, *roots)))

    def add_text(self, text: str) -> None:
        """Adds a description that is not a file to the digest."""
        self._texts.append(text.encode("utf-8", errors="replace"))

    def read_bytes(self, path: Path) -> bytes:
        """Returns the content of a description file, and adds the file to the digest.

        Raises:
            SceneNotFoundError: the file cannot be read.
        """
        try:
            data = read_file(path)
        except OSError as e:
            raise SceneNotFoundError(f"{path}: cannot be read: {e.strerror or e}") from e
        self._files[Path(os.path.realpath(path))] = None
        return data

    def add_body(self, body: BodySpec, description: Path) -> None:
        """Adds a body; the file ``description`` and all its meshes become part of the digest.

        Raises:
            MeshError: a mesh cannot be read.
        """
        self.bodies.append(body)
        self._files[Path(os.path.realpath(description))] = None
        shapes = [v.shape for link in body.model.links for v in link.visuals]
        shapes += [c.shape for link in body.model.links for c in link.collisions]
        for mesh in dict.fromkeys(shape.mesh for shape in shapes if shape.kind == "mesh"):
            for file in self._body_loader.mesh(Path(mesh)).files:
                self._files[file] = None

    def mesh_shape(
        self, path: Path, matrix: F64, scale: Vec3, up_axis: UpAxis | None = None, unit_m: float | None = None
    ) -> tuple[Shape, F64]:
        """Reads a mesh and returns its shape and T_world_shape.

        Args:
            path: the mesh file.
            matrix: T_world_object, (4, 4), rigid.
            scale: factors along the axes of the object (z up).
            up_axis: up axis that overrides that of the file or its format; None = no override.
            unit_m: metres per unit that override those of the file or its format; None = no override.

        Raises:
            MeshError: the mesh cannot be used.
        """
        self.admits(path)  # the loader raises for a path that is not admitted
        mesh = self.loader.mesh(path)
        for file in mesh.files:
            self._files[file] = None
        for warning in mesh.warnings:
            self.warn(warning)
        factor = 1.0 if unit_m is None else unit_m / mesh.unit_m
        # The loader has rotated the mesh by the file's up axis: undo that rotation and apply the requested one. Both only permute
        # axes, so the scale remains a scale along axes.
        rotation = np.eye(3) if up_axis is None else TO_Z_UP[up_axis] @ TO_Z_UP[mesh.up_axis].T
        sizes = np.diag(rotation.T @ np.diag(scale) @ rotation) * factor
        rotated = matrix.copy()
        rotated[:3, :3] = matrix[:3, :3] @ rotation
        return Shape("mesh", (float(sizes[0]), float(sizes[1]), float(sizes[2])), str(real_path(path))), rotated

    def has_textures(self, shape: Shape) -> bool:
        """Returns whether a mesh has image files, or is a GLB, which may contain images."""
        files = self.loader.mesh(Path(shape.mesh)).files if shape.kind == "mesh" else ()
        return any(file.suffix.lower() in (*IMAGE_SUFFIXES, ".glb") for file in files)

    def add_visual(
        self,
        name: str,
        shape: Shape,
        matrix: F64,
        color: Rgba | None = None,
        semantic_class: str = "",
        appearance: Appearance | None = None,
    ) -> None:
        """Adds a visual at T_world_shape, ``matrix`` (4, 4); None as ``color`` = the colours of the mesh."""
        pose = pose_from_matrix(matrix)
        self.visuals.append(VisualSpec(_unique(name, self._visual_names), "", shape, pose, color, semantic_class, appearance))

    def environment_file(self, path: Path, where: str) -> str:
        """Returns the absolute path of an environment image, and adds it to the digest.

        Args:
            path: the image.
            where: file and key that name it, for messages.

        Raises:
            SceneError: the image is missing or lies outside the scene's folders.
        """
        real = Path(os.path.realpath(path))
        if not self.admits(path):
            raise SceneError(f"{where}: environment {path} lies outside the scene's folder; put it inside")
        if not is_file(real):
            raise SceneError(f"{where}: environment {path} is missing; give an equirectangular .hdr, .png or .jpg")
        self._files[real] = None
        return str(real)

    def set_splats(self, path: Path, matrix: F64, scale: float, up_axis: UpAxis | None = None) -> None:
        """Sets the splats that are drawn over the visuals; their file becomes part of the digest.

        Args:
            path: the file.
            matrix: T_world_file, (4, 4), rigid, for a file with z up.
            scale: metres per unit of the file.
            up_axis: up axis of the file; None = that of its format.

        Raises:
            SceneError: the file is missing, of an unsupported format, or outside the scene's folders.
        """
        if not self.admits(path):
            raise SceneError(f"{path}: lies outside the scene's folder; put it inside")
        real = real_path(path)
        rotated = matrix.copy()
        rotated[:3, :3] = matrix[:3, :3] @ TO_Z_UP[up_axis_of(real) if up_axis is None else up_axis]
        self.splats = SplatsSpec(str(real), pose_from_matrix(rotated), scale)
        self._files[real] = None

    def add_collision(self, name: str, shape: Shape, matrix: F64, friction: float = 1.0) -> None:
        """Adds a collision shape with a friction coefficient at T_world_shape, ``matrix`` (4, 4)."""
        pose = pose_from_matrix(matrix)
        self.collisions.append(CollisionSpec(_unique(name, self._collision_names), shape, pose, friction))

    def add_simplified_collision(self, name: str, shape: Shape, matrix: F64, friction: float = 1.0) -> None:
        """Adds the simplified collision shapes of a scan at T_world_shape, under one name: boxes for its floors, few triangles for the rest.

        Raises:
            SceneError: the user's cache cannot be written.
        """
        unique = _unique(name, self._collision_names)
        vertices, triangles = self.loader.shape(shape).merged()
        for simple, pose in scan_shapes(transform_points(matrix, vertices), triangles, f"{self.name}: {unique}"):
            if simple.kind == "mesh":
                # The mesh lies in the user's cache, which is trusted.
                self._add_roots(Path(simple.mesh).parent)
            self.collisions.append(CollisionSpec(unique, simple, pose, friction))

    def finish(self) -> SceneSpec:
        """Returns the scene.

        Raises:
            SceneError: the scene is empty, or its name is invalid.
        """
        if len(self.name) > _MAX_NAME or not self.name.isprintable():
            raise SceneError(f"scene {quoted(self.name)}: its name must be one line of at most {_MAX_NAME} characters")
        if not self.visuals and not self.collisions and self.ground_z is None:
            reason = f": {self.warnings[0]}" if self.warnings else ""
            raise SceneError(f"scene {quoted(self.name)}: it has no visuals, collision shapes or ground plane{reason}")
        floor_z = self.floor_z
        if floor_z is None:
            triangles = merge([shape_triangles(self.loader, c) for c in self.collisions])
            floor_z = estimate_floor(*triangles, self.ground_z)
        return SceneSpec(
            self.name, self.root, self.digest(), tuple(self.visuals), tuple(self.collisions), self.ground_z, floor_z,
            self.gravity, tuple(self.starts), self.light, (), tuple(self.warnings), bodies=tuple(self.bodies),
            other_floors=self.floors, rooms=tuple(self.rooms), floor_estimated=self.floor_z is None, splats=self.splats,
            ground_friction=self.ground_friction,
        )  # fmt: skip

    def digest(self) -> str:
        """Returns the SHA-256 of the scene's name, its texts, and the relative names, sizes and contents of all its files."""
        total = hashlib.sha256(self.name.encode())
        for text in self._texts:
            total.update(f"\n{len(text)}\n".encode())
            total.update(text)
        named = {self._relative(p): p for p in self._files}
        for relative, path in sorted(named.items()):
            data = path.read_bytes()
            total.update(f"\n{Path(relative).as_posix()} {len(data)}\n".encode())
            total.update(data)
        return total.hexdigest()

    def _relative(self, path: Path) -> str:
        """Returns the name of a file in the digest: its path relative to the scene's folder, independent of symbolic links."""
        root = next((folder for folder in self._description_roots if path.is_relative_to(folder)), None)
        return path.name if root is None else os.path.relpath(path, root)


def _unique(name: str, used: dict[str, int]) -> str:
    """Returns the name, with _2, _3, ... if it is in ``used``, and adds the result to ``used``: name -> last number."""
    candidate, number = name, used.get(name, 0)
    while candidate in used:
        number += 1
        candidate = f"{name}_{number}"
    used[name] = max(number, 1)
    used.setdefault(candidate, 1)
    return candidate


def estimate_floor(vertices: F64, triangles: NDArray[np.int32], ground_z: float | None = None) -> float:
    """Returns the height of the floor, world metres: the height with the most up-facing area in the lowest metre.

    Args:
        vertices: (V, 3), world metres.
        triangles: (F, 3), rows of ``vertices``.
        ground_z: height of an infinite ground plane; it is the floor unless a large floor lies just above it.
    """
    corners = vertices[triangles]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    lengths = np.linalg.norm(normals, axis=1)
    level = normals[:, 2] > _UP_FACING * lengths
    area, z = normals[level, 2] / 2, corners[level][:, :, 2].mean(axis=1)
    if not len(z):
        return ground_z if ground_z is not None else float(vertices[:, 2].min(initial=0.0) if len(vertices) else 0.0)
    if ground_z is not None:
        low, span = ground_z - 0.01, 0.3
    else:
        # Skip the lowest percent of the area: outlier triangles below the floor must not shift the search.
        order = np.argsort(z)
        low = float(z[order][np.searchsorted(np.cumsum(area[order]), 0.01 * area.sum())]) - 0.5 * _BIN
        span = 1.0
    near = (z >= low) & (z <= low + span)
    if not near.any():
        return ground_z if ground_z is not None else float(z.min())
    bins = np.floor((z[near] - low) / _BIN).astype(int)
    areas = np.bincount(bins, weights=area[near])
    peak = int(areas.argmax())
    if ground_z is not None:
        spans = vertices[:, :2].max(axis=0) - vertices[:, :2].min(axis=0)
        if areas[peak] < 0.5 * float(spans[0] * spans[1]):
            return ground_z
    on_peak = np.abs(bins - peak) <= 1
    # The median is the height of the floor itself; carpets would bias a mean.
    z, area = z[near][on_peak], area[near][on_peak]
    order = np.argsort(z)
    middle = np.searchsorted(np.cumsum(area[order]), 0.5 * area.sum())
    return float(np.round(z[order][middle], 6)) + 0.0


def class_from_model(name: str) -> str:
    """Returns a class name derived from a model's name: ``aws_robomaker_residential_KitchenTable_01`` gives ``kitchen_table``.

    Removes the vendor's prefix, trailing numbers and a trailing variant letter, and converts camel case to snake case.
    """
    base = re.sub(r"^aws_robomaker_[a-z]+_", "", name[:_MAX_CLASS])
    base = re.sub(r"([_\- ]\d+)+$", "", base)
    base = re.sub(r"(?<=[a-z])[A-Z]$", "", base)
    base = re.sub(r"(?<=[a-z0-9])(?=[A-Z])|(?<=[A-Z])(?=[A-Z][a-z])", "_", base)
    return re.sub(r"[^a-z0-9]+", "_", base.lower()).strip("_")
