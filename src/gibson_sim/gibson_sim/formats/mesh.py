"""Meshes in memory, and the checks that are applied when they are built. Independent of file formats."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from gibson_sim.errors import MeshError
from gibson_sim.geometry.transforms import TO_Z_UP as TO_Z_UP, UpAxis as UpAxis
from gibson_sim.types import Rgba, Vec3

AlphaMode = Literal["opaque", "mask", "blend"]
F32 = NDArray[np.float32]
F64 = NDArray[np.float64]
I64 = NDArray[np.int64]

MATTE_ROUGHNESS = 0.9
"""Minimum roughness of a matte surface, which is not a metal either."""
LIGHT_GREY: Rgba = (0.8, 0.8, 0.8, 1.0)
"""Colour of surfaces whose file gives none, sRGB and alpha."""
MAX_FRACTION = 2.0
"""Largest vertex colour of a file that counts as a fraction: white is 1, which light may exceed; above, white is 255."""


Wrap = Literal["repeat", "mirror", "clamp"]
"""What lies beyond the borders of an image: the image again, its mirror image, or the pixels at the border."""
Filter = Literal["nearest", "linear"]


@dataclass(frozen=True, slots=True)
class Sampling:
    """How an image is read beyond its borders and between its pixels."""

    wrap_u: Wrap = "repeat"
    wrap_v: Wrap = "repeat"
    magnified: Filter = "linear"
    """Filter where a pixel of the image covers several of the picture."""
    minified: Filter = "linear"
    """Filter where several pixels of the image fall on one of the picture."""
    between_levels: Filter | None = "linear"
    """Filter between mip levels; None = without mip levels."""


@dataclass(frozen=True, slots=True, eq=False)
class TextureSource:
    """A decoded image. Parts with the same image and sampling share one object, so that ``id()`` identifies textures."""

    name: str
    """Path of the image file, or file and index for an embedded image."""
    pixels: NDArray[np.uint8]
    """Pixels, (H, W, 3) RGB or (H, W, 4) RGBA uint8, sRGB, row 0 = top."""
    sampling: Sampling = Sampling()


@dataclass(frozen=True, slots=True, eq=False)
class LightMapSource:
    """A decoded light map: the light on surfaces, ``light_maps``. Parts with the same image share one object."""

    name: str
    """Path of the image file, or file and index for an embedded image."""
    pixels: NDArray[np.uint16]
    """Pixels, (H, W, 3) RGB uint16, square roots of radiances, row 0 = top. Interpolated linearly, clamped at the borders."""


@dataclass(frozen=True, slots=True)
class Material:
    """The material of one part of a mesh."""

    name: str = ""
    base_color: Rgba = LIGHT_GREY
    """Base colour, sRGB and alpha, each 0 to 1; multiplies the texture."""
    texture: TextureSource | None = None
    unlit: bool = False
    """Whether the colours include the light, so that no shading is applied (KHR_materials_unlit)."""
    alpha_mode: AlphaMode = "opaque"
    alpha_cutoff: float = 0.5
    """Alpha below which pixels are discarded, for alpha_mode mask."""
    double_sided: bool = True
    metallic: float = 0.0
    """Metalness: 0 = plastic, wood, cloth; 1 = bare metal. Multiplies the blue channel of ``metallic_roughness_texture``."""
    roughness: float = 1.0
    """Roughness: 0 = a mirror, 1 = no highlights. Multiplies the green channel of ``metallic_roughness_texture``."""
    emissive: Vec3 = (0.0, 0.0, 0.0)
    """Emitted light, linear RGB, may exceed 1; multiplies ``emissive_texture``. Does not light other surfaces."""
    normal_texture: TextureSource | None = None
    """Tangent-space normals as in glTF: +X right, +Y up in the image, linear."""
    normal_scale: float = 1.0
    """Factor on x and y of the normals."""
    metallic_roughness_texture: TextureSource | None = None
    """Green = roughness, blue = metalness, linear."""
    emissive_texture: TextureSource | None = None
    """Emitted light, sRGB."""
    occlusion_texture: TextureSource | None = None
    """Red = unoccluded share of the ambient light, linear."""
    occlusion_strength: float = 1.0
    """Strength of the occlusion, 0 to 1."""
    colored: bool = False
    """Whether vertex colours (``MeshPart.colors``) multiply ``base_color`` and ``texture``."""
    light_map: LightMapSource | None = None
    """Light that multiplies the base colour in ``MeshPart.light_uvs``, before tone mapping; the material is unlit: no other light is added."""
    light_intensity: float = 1.0
    """Radiance of a white surface where ``light_map`` is white, linear, at least 0."""

    @property
    def has_maps(self) -> bool:
        """Whether the material is lit and has textures other than that of its base colour."""
        maps = (self.normal_texture, self.metallic_roughness_texture, self.emissive_texture, self.occlusion_texture)
        return not self.unlit and any(m is not None for m in maps)


@dataclass(frozen=True, slots=True, eq=False)
class MeshPart:
    """Triangles of one material, counter-clockwise seen from outside."""

    vertices: F32
    """Vertex positions, (V, 3), metres, z up."""
    normals: F32
    """Vertex normals, (V, 3), unit length."""
    uvs: F32 | None
    """Texture coordinates, (V, 2), v = 0 at the top row of the image (glTF), or None."""
    triangles: NDArray[np.uint32]
    """Vertex indices of the triangles, (F, 3)."""
    material: Material = field(default_factory=Material)
    colors: NDArray[np.uint8] | None = None
    """Vertex colours, (V, 3) uint8 sRGB, or (V, 4) with alpha, which is linear, if the material is ``colored``; else None. They have alpha
    only if any of it is below 255."""
    light_uvs: F32 | None = None
    """Coordinates in the light map of the material, (V, 2), v = 0 at the top row, or None."""


@dataclass(frozen=True, slots=True, eq=False)
class Mesh:
    """All parts of one file or primitive, in the frame of the shape, z up, metres."""

    parts: tuple[MeshPart, ...]
    warnings: tuple[str, ...] = ()
    """Elements that were left out or replaced, one line each."""
    files: tuple[Path, ...] = ()
    """Resolved paths of all files that were read, the mesh file first."""
    up_axis: UpAxis = "z"
    """Up axis of the file or its format; ``vertices`` are already rotated to z up."""
    unit_m: float = 1.0
    """Metres per unit of the file or its format; ``vertices`` are already in metres."""

    @property
    def triangle_count(self) -> int:
        """Number of triangles of all parts."""
        return sum(len(part.triangles) for part in self.parts)

    @property
    def bounds(self) -> F64:
        """Bounding box, (2, 3) float64: minimum and maximum corner, metres."""
        lows = [part.vertices.min(axis=0) for part in self.parts]
        highs = [part.vertices.max(axis=0) for part in self.parts]
        return np.array([np.min(lows, axis=0), np.max(highs, axis=0)], dtype=np.float64)

    def merged(self) -> tuple[F64, NDArray[np.int32]]:
        """Returns all triangles as one mesh: vertices (V, 3) float64, metres, and triangles (F, 3) int32."""
        return merge([(part.vertices, part.triangles) for part in self.parts])

    def transformed(self, matrix: ArrayLike) -> Mesh:
        """Returns the mesh transformed by a (4, 4) affine matrix, which may scale non-uniformly or mirror."""
        m = np.asarray(matrix, dtype=np.float64)
        parts = tuple(
            MeshPart(
                apply(m, part.vertices).astype(np.float32),
                transform_normals(m, part.normals).astype(np.float32),
                part.uvs,
                part.triangles if np.linalg.det(m[:3, :3]) > 0 else np.ascontiguousarray(part.triangles[:, ::-1]),
                part.material,
                part.colors,
                part.light_uvs,
            )
            for part in self.parts
        )
        return Mesh(parts, self.warnings, self.files, self.up_axis, self.unit_m)


def merge(pieces: Sequence[tuple[ArrayLike, ArrayLike]]) -> tuple[F64, NDArray[np.int32]]:
    """Merges pairs of vertices (V, 3) and triangles (F, 3) to one pair, float64 and int32."""
    vertices = [np.asarray(v, dtype=np.float64) for v, _ in pieces]
    starts = np.cumsum([0, *(len(v) for v in vertices)])
    triangles = [np.asarray(t, dtype=np.int64) + start for (_, t), start in zip(pieces, starts, strict=False)]
    if not pieces:
        return np.zeros((0, 3)), np.zeros((0, 3), dtype=np.int32)
    return np.concatenate(vertices), np.concatenate(triangles).astype(np.int32)


def apply(matrix: F64, points: ArrayLike) -> F64:
    """Returns points (N, 3) transformed by a (4, 4) affine matrix."""
    return np.asarray(points, dtype=np.float64) @ matrix[:3, :3].T + matrix[:3, 3]


def transform_normals(matrix: F64, normals: ArrayLike) -> F64:
    """Returns unit normals (N, 3) of a surface transformed by a (4, 4) affine matrix; a zero normal remains zero."""
    linear = matrix[:3, :3]
    # The cofactor matrix is det * inverse transpose; the sign of det keeps the normals of a mirrored surface outward.
    cofactors = np.stack([np.cross(linear[1], linear[2]), np.cross(linear[2], linear[0]), np.cross(linear[0], linear[1])])
    sign = -1.0 if np.linalg.det(linear) < 0 else 1.0
    return unit(np.asarray(normals, dtype=np.float64) @ (sign * cofactors).T)


def unit(vectors: ArrayLike) -> F64:
    """Returns normalised vectors (N, 3); zero vectors and NaN become zero."""
    v = np.nan_to_num(np.asarray(vectors, dtype=np.float64), nan=0.0, posinf=0.0, neginf=0.0)
    length = np.linalg.norm(v, axis=1, keepdims=True)
    result: F64 = np.divide(v, length, out=np.zeros_like(v), where=length > 1e-30)
    return result


def area_normals(vertices: ArrayLike, triangles: ArrayLike) -> F64:
    """Returns unit normals (V, 3) of vertices (V, 3): the area-weighted mean of those of adjacent triangles (F, 3); +z for isolated vertices."""
    v = np.asarray(vertices, dtype=np.float64)
    t = np.asarray(triangles, dtype=np.int64)
    faces = np.cross(v[t[:, 1]] - v[t[:, 0]], v[t[:, 2]] - v[t[:, 0]])
    corners = t.ravel()
    per_corner = np.repeat(faces, 3, axis=0)
    sums = np.stack([np.bincount(corners, weights=per_corner[:, k], minlength=len(v)) for k in range(3)], axis=1)
    normals = unit(sums)
    normals[~normals.any(axis=1)] = (0.0, 0.0, 1.0)
    return normals


def build_part(
    what: str,
    vertices: ArrayLike,
    triangles: ArrayLike,
    normals: ArrayLike | None,
    uvs: ArrayLike | None,
    material: Material,
    matrix: F64 | None = None,
    colors: NDArray[np.uint8] | None = None,
    light_uvs: ArrayLike | None = None,
) -> MeshPart | None:
    """Returns a checked part, or None if it has no triangles.

    Args:
        what: the file, for messages.
        vertices: (V, 3), metres.
        triangles: (F, 3), whole numbers, rows of ``vertices``.
        normals: (V, 3), or None = compute them; zero or NaN rows are also computed.
        uvs: (V, 2), v downwards, or None.
        material: the material.
        matrix: (4, 4) affine transform of the vertices and normals; None = the identity.
        colors: vertex colours, (V, 3) uint8 sRGB, or (V, 4) with linear alpha, or None. They stand in for a missing texture; if the material
            is already ``colored``, they multiply its texture.
        light_uvs: (V, 2), in the light map of the material, v downwards, or None.

    Raises:
        MeshError: an index is out of range, or a coordinate is NaN or infinite.
    """
    # Suppress the warning about the cast of a signalling NaN.
    with np.errstate(invalid="ignore"):
        v, n, uv, light_uv = (
            None if array is None else np.asarray(array, dtype=np.float64) for array in (vertices, normals, uvs, light_uvs)
        )
    t = np.asarray(triangles, dtype=np.int64)
    if v is None or not len(t):
        return None
    if t.min() < 0 or t.max() >= len(v):
        vertex = int(t.min() if t.min() < 0 else t.max())
        raise MeshError(f"{what}: a triangle names vertex {vertex}, but there are {len(v)}; the file is broken, export it again")
    used = np.zeros(len(v), dtype=bool)
    used[t] = True
    if not used.all():
        # Exporters share one vertex array among several parts: keep the vertices of this part.
        t = (np.cumsum(used) - 1)[t]
        v = v[used]
        n = None if n is None else n[used]
        uv, light_uv = (None if array is None else array[used] for array in (uv, light_uv))
        colors = None if colors is None else colors[used]
    if matrix is not None:
        # Non-finite vertices are rejected below, with their row.
        with np.errstate(invalid="ignore", over="ignore"):
            v = apply(matrix, v)
        n = None if n is None else transform_normals(matrix, n)
        t = t if np.linalg.det(matrix[:3, :3]) > 0 else t[:, ::-1]
    with np.errstate(over="ignore", invalid="ignore"):
        v32 = v.astype(np.float32)
    if not np.isfinite(v32).all():
        row = int(np.flatnonzero(~np.isfinite(v32).all(axis=1))[0])
        raise MeshError(f"{what}: vertex {row} is {v[row].tolist()}, coordinates must be finite numbers; the file is broken")
    n = _fill_normals(v, t, n)
    with np.errstate(over="ignore"):
        uv32, light32 = (
            None if array is None else np.nan_to_num(array, nan=0.0, posinf=0.0, neginf=0.0).astype(np.float32)
            for array in (uv, light_uv)
        )
    colors = colors if material.texture is None or material.colored else None
    if colors is not None and (colors[:, 3:] == 255).all():
        colors = np.ascontiguousarray(colors[:, :3])
    material = material if material.colored == (colors is not None) else replace(material, colored=colors is not None)
    return MeshPart(v32, n.astype(np.float32), uv32, np.ascontiguousarray(t, dtype=np.uint32), material, colors, light32)


def _fill_normals(vertices: F64, triangles: I64, normals: F64 | None) -> F64:
    """Returns unit normals (V, 3): those of the file, computed where they are missing."""
    if normals is None:
        return area_normals(vertices, triangles)
    filled = unit(normals)
    empty = ~filled.any(axis=1)
    if empty.any():
        filled[empty] = area_normals(vertices, triangles)[empty]
    return filled


def index_corners(*columns: I64) -> tuple[I64, I64]:
    """Merges corners that are equal in all columns.

    Args:
        columns: each (C,) int64: position index, uv index, ... of each corner.

    Returns:
        The first corner of each group of equal corners, (V,), and the group of each corner, (C,).
    """
    key = np.zeros(len(columns[0]), dtype=np.int64)
    for column in columns:
        low = int(column.min()) if len(column) else 0
        span = (int(column.max()) - low + 1) if len(column) else 1
        # Renumber to keep the keys small, since a product of three index ranges could overflow.
        if int(key.max(initial=0)) * span > 2**62:
            key = np.unique(key, return_inverse=True)[1].astype(np.int64)
        key = key * span + (column - low)
    _, first, inverse = np.unique(key, return_index=True, return_inverse=True)
    return first.astype(np.int64), inverse.reshape(-1).astype(np.int64)
