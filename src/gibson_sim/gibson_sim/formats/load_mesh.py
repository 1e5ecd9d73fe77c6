"""Converts a ``Shape``, a mesh file or a primitive, to triangles, for rendering, maps and physics.

A ``MeshLoader`` reads each file and decodes each image once in its lifetime. Only primitives are cached globally.
"""

from __future__ import annotations

import json
import math
import os
import struct
import sys
from collections.abc import Callable, Iterable, Sequence
from functools import lru_cache
from pathlib import Path

import numpy as np

from gibson_sim.description.extents import MeshPoints
from gibson_sim.description.shapes import Shape
from gibson_sim.errors import MeshError, TextError
from gibson_sim.formats.dae import load_dae
from gibson_sim.formats.file_roots import package_roots, without_file_system_root
from gibson_sim.formats.gltf import load_gltf
from gibson_sim.formats.mesh import F64, I64, LIGHT_GREY, LightMapSource, Material, Mesh, MeshPart, TextureSource, UpAxis
from gibson_sim.formats.obj import load_obj
from gibson_sim.formats.ply import load_ply
from gibson_sim.formats.stl import load_stl
from gibson_sim.formats.textures import Decode, TextureStore
from gibson_sim.geometry.triangle_meshes import areas_of
from gibson_sim.quoting import quoted
from gibson_sim.reading import read_file

__all__ = [
    "LIGHT_GREY", "MESH_SUFFIXES", "Material", "Mesh", "MeshLoader", "MeshPart", "TextureSource",
    "load_mesh", "load_shape", "mesh_points", "primitive_mesh",
]  # fmt: skip

MESH_SUFFIXES = (".glb", ".gltf", ".obj", ".dae", ".stl", ".ply")
"""Suffixes of supported mesh files, lower case."""
_MAX_MEASURED_BYTES = 64_000_000
"""Maximum size of a mesh file that is measured, bytes."""
SEGMENTS = 48
"""Number of segments of the circles of primitives."""
_Geometry = tuple[F64, F64, F64, I64]
"""Vertices (V, 3), metres, normals (V, 3), uvs (V, 2), triangles (F, 3)."""


class MeshLoader:
    """Reads meshes, each file once.

    Args:
        allowed_roots: folders that meshes must lie in after following symbolic links; None = anywhere. Textures, materials and buffers
            that a mesh names must lie in these folders or in the package of the mesh (``file_roots``).
        textures: False = textures are checked for existence, with warnings, but not decoded; "sizes" = black images of the right size.
        max_bytes: maximum size of a mesh file, bytes; None = unlimited.
        max_parts: maximum number of meshes in the nodes of a glTF; None = unlimited.
    """

    def __init__(
        self,
        allowed_roots: Sequence[Path] | None,
        *,
        textures: Decode = True,
        max_bytes: int | None = None,
        max_parts: int | None = None,
    ) -> None:
        self.roots = None if allowed_roots is None else tuple(allowed_roots)
        self.max_bytes = max_bytes
        self.max_parts = max_parts
        self._textures = TextureStore((), textures)
        self._meshes: dict[Path, Mesh] = {}
        # Cached, since many meshes share few folders, and resolving links takes longer than reading a small mesh.
        self._packages: dict[tuple[Path, Path], tuple[Path, ...]] = {}
        """(Folder of a mesh as given, resolved folder) -> its packages."""
        self._real_roots: dict[Path, str] = {}
        """Root -> its resolved path."""

    def mesh(self, path: Path) -> Mesh:
        """Returns the mesh in a file, in its own frame, z up, metres.

        Raises:
            MeshError: the file is missing, outside the allowed folders, of an unknown format, or corrupt.
        """
        real = Path(os.path.realpath(path))
        if real not in self._meshes:
            self._meshes[real] = self._read(Path(path), real)
        return self._meshes[real]

    def image_bytes(self, texture: TextureSource | LightMapSource) -> bytes:
        """Returns the encoded image of a texture that this loader has read with ``textures`` "sizes"."""
        return self._textures.encoded(texture)

    def shape(self, shape: Shape) -> Mesh:
        """Returns the triangles of a shape, metres, in its frame: its scaled mesh file, or the primitive.

        Raises:
            MeshError: the mesh cannot be read, or a size is invalid.
        """
        if shape.kind != "mesh":
            return primitive_mesh(shape)
        mesh = self.mesh(Path(shape.mesh))
        if tuple(shape.size) == (1.0, 1.0, 1.0):
            return mesh
        if not (np.isfinite(shape.size).all() and all(shape.size)):
            raise MeshError(f"{shape.mesh}: scale is {tuple(shape.size)}, the three factors must be finite and not 0")
        return mesh.transformed(np.diag([*shape.size, 1.0]))

    def _read(self, path: Path, real: Path) -> Mesh:
        if self.roots is not None and not self._is_allowed(real):
            raise MeshError(f"{path}: lies outside {', '.join(map(str, self.roots))}; move it into the scene's folder")
        try:
            data = read_file(real, self.max_bytes or sys.maxsize - 1)
        except OSError as e:
            raise MeshError(f"{path}: cannot be read: {e.strerror or e}") from e
        if not data:
            raise MeshError(f"{path}: the file is empty")
        try:
            mesh = self._parse(path, real, data)
        except MeshError:
            raise
        except TextError as e:
            raise MeshError(f"{path}: {e}").with_public(e.public) from e
        # A corrupt file can cause any of these in a parser.
        except (
            ValueError, KeyError, IndexError, TypeError, AttributeError, OverflowError, RecursionError, MemoryError,
            OSError, struct.error, json.JSONDecodeError,
        ) as e:  # fmt: skip
            raise MeshError(f"{path}: is not a readable {path.suffix.lower()} file: {type(e).__name__}: {_one_line(e)}") from e
        if not mesh.parts:
            reasons = "; ".join(warning.removeprefix(f"{path}: ") for warning in mesh.warnings)
            raise MeshError(f"{path}: has no triangles{reasons and f' ({reasons})'}")
        return mesh

    def _is_allowed(self, real: Path) -> bool:
        """Returns whether a resolved path lies below one of the roots."""
        for root in self.roots or ():
            if root not in self._real_roots:
                self._real_roots[root] = os.path.realpath(root)
            if real.is_relative_to(self._real_roots[root]):
                return True
        return False

    def _packages_of(self, path: Path, real: Path) -> tuple[Path, ...]:
        folders = (path.parent, real.parent)
        if folders not in self._packages:
            self._packages[folders] = package_roots(path)
        return self._packages[folders]

    def _parse(self, path: Path, real: Path, data: bytes) -> Mesh:
        suffix = path.suffix.lower()
        warnings: list[str] = []
        files = [real]
        textures = self._textures.within(without_file_system_root((*self._packages_of(path, real), *(self.roots or ()))))

        def warn(text: str) -> None:
            if text not in warnings:
                warnings.append(text)

        up_axis: UpAxis = "z"
        unit_m = 1.0
        if suffix in (".glb", ".gltf"):
            parts = load_gltf(path, data, textures, files, warn, self.max_parts)
            up_axis = "y"
        elif suffix == ".obj":
            parts = load_obj(path, data, textures, files, warn)
        elif suffix == ".dae":
            parts, up_axis, unit_m = load_dae(path, data, textures, files, warn)
        elif suffix == ".stl":
            parts = load_stl(path, data, warn)
        elif suffix == ".ply":
            parts = load_ply(path, data, textures, files, warn)
        elif suffix == ".zae":
            raise MeshError(
                f"{path}: is a ZIP archive of a COLLADA file, which is not read; unpack it and use the .dae file in it"
            )
        else:
            raise MeshError(
                f"{path}: {quoted(suffix or 'no suffix')} is not a mesh format that can be read; known: {', '.join(MESH_SUFFIXES)}"
            )
        return Mesh(tuple(parts), tuple(warnings), tuple(files), up_axis, unit_m)


def mesh_points(roots: Sequence[Path] | None = None) -> MeshPoints:
    """Returns a function that maps the path of a mesh file to its vertices (N, 3), metres, and reads each file once.

    Args:
        roots: folders that meshes must lie in; None = anywhere.
    """
    loader = MeshLoader(roots, textures=False, max_bytes=_MAX_MEASURED_BYTES)
    return lambda path: loader.mesh(path).merged()[0]


def load_mesh(path: Path, allowed_roots: Sequence[Path]) -> Mesh:
    """Returns the mesh in a glTF, GLB, OBJ, DAE, STL or PLY file, z up, metres; use one ``MeshLoader`` for several files."""
    return MeshLoader(allowed_roots).mesh(path)


def load_shape(shape: Shape, allowed_roots: Sequence[Path] | None = None) -> Mesh:
    """Returns the triangles of a shape, metres, in its frame; use one ``MeshLoader`` for several shapes.

    Args:
        shape: the shape.
        allowed_roots: folders that its mesh must lie in; None = its path has already been checked.
    """
    return MeshLoader(mesh_folders([shape]) if allowed_roots is None else allowed_roots).shape(shape)


def mesh_folders(shapes: Iterable[Shape]) -> tuple[Path, ...]:
    """Returns the folders of the mesh files of shapes, for a ``MeshLoader`` of files whose paths have already been checked.

    For a symbolic link these are the folder of the link and that of its target.
    """
    files = {Path(shape.mesh) for shape in shapes if shape.kind == "mesh"}
    return tuple(sorted({folder for file in files for folder in (file.parent, Path(os.path.realpath(file)).parent)}))


@lru_cache(maxsize=256)
def primitive_mesh(shape: Shape) -> Mesh:
    """Returns the mesh of a primitive in its own frame, metres.

    Raises:
        MeshError: the shape is not a primitive, or a size is not above 0.
    """
    builders: dict[str, Callable[[float, float, float], _Geometry]] = {
        "box": _box, "sphere": _sphere, "cylinder": _cylinder, "capsule": _capsule, "ellipsoid": _ellipsoid, "cone": _cone,
    }  # fmt: skip
    if shape.kind not in builders:
        raise MeshError(f"shape {quoted(shape.kind)} is not a primitive; known: {', '.join(builders)}")
    size_count = {"box": 3, "sphere": 1, "ellipsoid": 3}.get(shape.kind, 2)
    if not all(math.isfinite(s) and s > 0 for s in shape.size[:size_count]):
        raise MeshError(f"{shape.kind}: size is {tuple(shape.size)}, the first {size_count} must be finite and above 0 (metres)")
    vertices, normals, uvs, triangles = builders[shape.kind](*shape.size)
    part = MeshPart(
        vertices.astype(np.float32), normals.astype(np.float32), uvs.astype(np.float32), triangles.astype(np.uint32), Material()
    )
    return Mesh((part,))


def _box(x: float, y: float, z: float) -> _Geometry:
    faces = []
    for axis in range(3):
        for sign in (1.0, -1.0):
            normal = np.zeros(3)
            normal[axis] = sign
            right = np.array([0.0, 1.0, 0.0]) if axis == 0 else np.array([1.0, 0.0, 0.0])
            up = np.cross(normal, right)
            faces.append(np.stack([normal - right - up, normal + right - up, normal + right + up, normal - right + up]))
    vertices = np.concatenate(faces) * np.array([x, y, z]) / 2
    normals = np.repeat([np.eye(3)[k] * s for k in range(3) for s in (1.0, -1.0)], 4, axis=0)
    uvs = np.tile([[0.0, 1.0], [1.0, 1.0], [1.0, 0.0], [0.0, 0.0]], (6, 1))
    quads = np.arange(24).reshape(6, 4)
    return vertices, normals, uvs, np.concatenate([quads[:, [0, 1, 2]], quads[:, [0, 2, 3]]])


def _circle() -> F64:
    """Returns points on the unit circle, (SEGMENTS + 1, 2); the last is exactly equal to the first, so that closed surfaces have no gap."""
    angle = 2 * math.pi * (np.arange(SEGMENTS + 1) % SEGMENTS) / SEGMENTS
    return np.column_stack([np.cos(angle), np.sin(angle)])


def _grid(rows: int, columns: int) -> I64:
    """Returns the triangles (F, 3) of a grid of vertices, row by row; counter-clockwise if rows go down and columns right."""
    corner = (np.arange(rows - 1)[:, None] * columns + np.arange(columns - 1)[None, :]).ravel()
    lower = corner + columns
    return np.concatenate([np.stack([corner, lower, lower + 1], 1), np.stack([corner, lower + 1, corner + 1], 1)])


def _sphere(radius: float, _y: float, _z: float) -> _Geometry:
    rings = SEGMENTS // 2
    u, v = np.meshgrid(np.linspace(0, 1, SEGMENTS + 1), np.linspace(0, 1, rings + 1))
    down = math.pi * v
    level = np.sin(down)
    level[-1] = 0.0  # sin(pi) is not exactly 0
    around = np.tile(_circle(), (rings + 1, 1))
    normals = np.column_stack([level.ravel() * around[:, 0], level.ravel() * around[:, 1], np.cos(down).ravel()])
    triangles = _grid(rings + 1, SEGMENTS + 1)
    area = areas_of((radius * normals)[triangles])
    # Half of the triangles at the poles have no area.
    return radius * normals, normals, np.stack([u.ravel(), v.ravel()], 1), triangles[area > 5e-10 * radius * radius]


def _ellipsoid(x: float, y: float, z: float) -> _Geometry:
    _, sphere, uvs, triangles = _sphere(1.0, 0.0, 0.0)
    radii = np.array([x, y, z])
    normals = sphere / radii
    return sphere * radii, normals / np.linalg.norm(normals, axis=1, keepdims=True), uvs, triangles


def _capsule(radius: float, length: float, _z: float) -> _Geometry:
    vertices, normals, uvs, triangles = _sphere(radius, 0.0, 0.0)
    # The equator occurs twice, at both ends of the cylinder.
    columns, rings = SEGMENTS + 1, SEGMENTS // 2
    rows = np.concatenate([np.arange(rings // 2 + 1), np.arange(rings // 2, rings + 1)])
    index = (rows[:, None] * columns + np.arange(columns)).ravel()
    shift = np.zeros((len(index), 3))
    shift[:, 2] = np.repeat(np.where(np.arange(len(rows)) <= rings // 2, 0.5, -0.5) * length, columns)
    vertices = vertices[index] + shift
    triangles = _grid(len(rows), columns)
    # Half of the triangles at the poles have no area.
    return vertices, normals[index], uvs[index], triangles[areas_of(vertices[triangles]) > 5e-10 * radius * min(radius, length)]


def _cone(radius: float, length: float, _z: float) -> _Geometry:
    """Returns a cone about z, its base down; its apex has one vertex per triangle, since each has another normal."""
    circle, n, k = _circle(), SEGMENTS + 1, np.arange(SEGMENTS)
    base = np.column_stack([circle * radius, np.full(n, -length / 2)])
    apex = np.tile([0.0, 0.0, length / 2], (SEGMENTS, 1))
    slant = math.hypot(radius, length)
    around = np.column_stack([circle * length, np.full(n, radius)]) / slant
    middle = around[:-1] + around[1:]
    middle /= np.linalg.norm(middle, axis=1, keepdims=True)
    down = np.array([[0.0, 0.0, -1.0]])
    vertices = np.concatenate([base, apex, base, [[0.0, 0.0, -length / 2]]])
    normals = np.concatenate([around, middle, np.repeat(down, n + 1, 0)])
    strip = np.linspace(0, 1, n)
    uvs = np.concatenate(
        [np.stack([strip, 0 * strip + 1], 1), np.stack([strip[:-1], 0 * strip[:-1]], 1), 0.5 + 0.5 * circle, [[0.5, 0.5]]]
    )
    side = np.stack([n + k, k, k + 1], 1)
    bottom = np.stack([np.full(SEGMENTS, 2 * n + SEGMENTS), n + SEGMENTS + k + 1, n + SEGMENTS + k], 1)
    return vertices, normals, uvs, np.concatenate([side, bottom])


def _cylinder(radius: float, length: float, _z: float) -> _Geometry:
    side = np.column_stack([_circle(), np.zeros(SEGMENTS + 1)])
    ring = side * radius
    up = np.array([0.0, 0.0, length / 2])
    top, bottom = ring + up, ring - up
    n = SEGMENTS + 1
    k = np.arange(SEGMENTS)
    vertices = np.concatenate([top, bottom, top, bottom, [[0, 0, length / 2], [0, 0, -length / 2]]])
    z = np.array([[0.0, 0.0, 1.0]])
    normals = np.concatenate([side, side, np.repeat(z, n, 0), np.repeat(-z, n, 0), z, -z])
    disc = 0.5 + 0.5 * side[:, :2] * [1, -1]
    strip = np.linspace(0, 1, n)
    uvs = np.concatenate([np.stack([strip, 0 * strip], 1), np.stack([strip, 0 * strip + 1], 1), disc, disc, [[0.5, 0.5]] * 2])
    upper = np.stack([np.full(SEGMENTS, 4 * n), 2 * n + k, 2 * n + k + 1], 1)
    lower = np.stack([np.full(SEGMENTS, 4 * n + 1), 3 * n + k + 1, 3 * n + k], 1)
    return vertices, normals, uvs, np.concatenate([_grid(2, n), upper, lower])


def _one_line(error: BaseException) -> str:
    """Returns the message of an error in one line of at most 200 characters."""
    return " ".join(str(error).split())[:200]
