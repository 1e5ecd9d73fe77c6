"""Converts shipped scenes to scan-like meshes for measuring renderers: one uneven open mesh, one texture atlas, a given triangle count."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from gibson_sim.errors import SceneError
from gibson_sim.formats.load_mesh import MeshLoader
from gibson_sim.formats.mesh import MeshPart, TextureSource, area_normals
from gibson_sim.geometry.transforms import matrix_from_pose
from gibson_sim.geometry.triangle_meshes import components
from gibson_sim.picture_files import write_picture
from gibson_sim.render.culling.closed_surfaces import find_closed_surfaces
from gibson_sim.render.lod.clusters import weld
from gibson_sim.scenes.scene_meshes import scene_roots
from gibson_sim.scenes.scene_yaml import write_scene_yaml
from gibson_sim.scenes.spec import SceneSpec
from gibson_sim_tools.generator.gltf import MeshBuilder, MeshMaterial, write_glb
from gibson_sim_tools.generator.rooms import wobble
from gibson_sim_tools.making.pixels import fill_gaps
from gibson_sim_tools.making.splats import colors_of
from gibson_sim_tools.texturing.rasteriser import barycentric, rasterise_2d

F64 = NDArray[np.float64]
I64 = NDArray[np.int64]

TILE = 2048
"""Width and height of each texture in the atlas, pixels."""
_STRIP, _SWATCH = 64, 16
"""Height of the strip of untextured colours below the textures, and side of the square of a colour, pixels."""
_NOISE = ((0.35, 0.004), (0.07, 0.0015))
"""Surface noise: wavelength and amplitude of each octave, metres."""
_WELD = 1e5
"""Inverse of the distance below which vertices are welded, 1/m."""


def make_scan_like_mesh(scene: SceneSpec, triangles: int, folder: Path) -> int:
    """Writes scene.yaml, mesh.glb and atlas.jpg with a scene's static visuals; returns the number of triangles.

    Args:
        scene: the scene; all materials become opaque, and textures must not repeat except below a light map.
        triangles: minimum number of triangles; surfaces are subdivided to reach it.
        folder: an existing folder.

    Raises:
        SceneError: it has no static visuals, or a texture is repeated across a surface.
    """
    vertices, uvs, faces, atlas = _merged_visuals(scene)
    vertices, uvs, faces = subdivided(vertices, uvs, faces, triangles)
    vertices = vertices + np.stack([_surface_noise(vertices, axis) for axis in range(3)], axis=1)
    faces = without_closed_surfaces(vertices, faces)
    write_picture(folder / "atlas.jpg", cv2.cvtColor(atlas, cv2.COLOR_RGB2BGR), (cv2.IMWRITE_JPEG_QUALITY, 92))
    mesh = MeshBuilder()
    mesh.add(MeshMaterial("scan", "atlas.jpg", unlit=True), vertices, area_normals(vertices, faces), uvs, faces)
    write_glb(folder / "mesh.glb", mesh)
    spec = {
        "name": f"scan_{scene.name}",
        "description": f"scan-like mesh of {scene.name}, {len(faces)} triangles, for measurements",
        "floor_z": scene.floor_z,
        "floors": list(scene.floors),
        "objects": [{"name": "scan", "mesh": "mesh.glb", "semantic_class": "building"}],
    }
    write_scene_yaml(folder, spec, width=None)
    return len(faces)


def _merged_visuals(scene: SceneSpec) -> tuple[F64, F64, I64, NDArray[np.uint8]]:
    """Returns vertices (V, 3), uvs (V, 2), triangles (F, 3) and the atlas (H, W, 3) RGB of all static visuals."""
    loader = MeshLoader(scene_roots(scene))
    found: list[tuple[F64, MeshPart]] = []
    for visual in scene.visuals:
        T = matrix_from_pose(visual.pose)
        found += [(T, part) for part in loader.shape(visual.shape).parts]
    if not found:
        raise SceneError(f"{scene.name}: has no static visuals, from which a scan-like mesh could be made")
    found = _with_light(found)
    textures = list({id(p.material.texture): p.material.texture for _, p in found if p.material.texture is not None}.values())
    atlas = _Atlas(textures, sorted({p.material.base_color[:3] for _, p in found if p.material.texture is None}))
    vertices = [part.vertices @ T[:3, :3].T + T[:3, 3] for T, part in found]
    first_vertex = np.cumsum([0, *(len(v) for v in vertices)])
    faces = [part.triangles.astype(np.int64) + first for (_, part), first in zip(found, first_vertex, strict=False)]
    uvs = [atlas.uvs(scene.name, part) for _, part in found]
    return np.concatenate(vertices), np.concatenate(uvs), np.concatenate(faces), atlas.pixels


def _with_light(placed_parts: list[tuple[F64, MeshPart]]) -> list[tuple[F64, MeshPart]]:
    """Returns the parts; those of a light map share a picture in its coordinates: base colour times light."""
    groups: dict[int, list[MeshPart]] = {}
    for _, part in placed_parts:
        if part.material.light_map is not None and part.light_uvs is not None:
            groups.setdefault(id(part.material.light_map), []).append(part)
    pictures = {key: TextureSource("light", _lit_picture(parts)) for key, parts in groups.items()}
    lit = {id(part): pictures[key] for key, parts in groups.items() for part in parts}
    return [
        (
            T,
            replace(part, uvs=part.light_uvs, material=replace(part.material, texture=lit[id(part)]))
            if id(part) in lit
            else part,
        )
        for T, part in placed_parts
    ]


def _lit_picture(parts: list[MeshPart]) -> NDArray[np.uint8]:
    """Returns the picture of all parts of a light map in its coordinates, (TILE, TILE, 3), sRGB; gaps between charts are filled."""
    corners = [np.asarray(part.light_uvs, dtype=np.float64)[part.triangles] * TILE - 0.5 for part in parts]
    face = rasterise_2d(np.concatenate(corners), TILE, TILE)
    pixels = np.zeros((TILE, TILE, 3), dtype=np.float32)
    first = 0
    for part, own in zip(parts, corners, strict=True):
        y, x = np.nonzero((face >= first) & (face < first + len(own)))
        triangles = face[y, x] - first
        weights = barycentric(own[triangles], np.stack([x, y], axis=1).astype(np.float64))
        if len(triangles):
            pixels[y, x] = colors_of(part, part.triangles[triangles], weights)
        first += len(own)
    return np.asarray(np.rint(255.0 * np.clip(fill_gaps(pixels, face >= 0), 0.0, 1.0)), dtype=np.uint8)


class _Atlas:
    """A texture atlas: textures side by side in squares, untextured colours in a strip below."""

    def __init__(self, textures: list[TextureSource], colors: list[tuple[float, ...]]) -> None:
        self._columns = max(1, math.ceil(math.sqrt(len(textures))))
        rows = math.ceil(len(textures) / self._columns)
        self._cell = {id(texture): divmod(k, self._columns) for k, texture in enumerate(textures)}
        self._colors = {color: k for k, color in enumerate(colors)}
        per_row = self._columns * TILE // _SWATCH
        strip = max(_STRIP, _SWATCH * math.ceil(len(colors) / per_row))
        self.pixels = np.zeros((rows * TILE + strip, self._columns * TILE, 3), dtype=np.uint8)
        for texture in textures:
            row, column = self._cell[id(texture)]
            small = cv2.resize(np.ascontiguousarray(texture.pixels[:, :, :3]), (TILE, TILE), interpolation=cv2.INTER_AREA)
            self.pixels[row * TILE : (row + 1) * TILE, column * TILE : (column + 1) * TILE] = small
        self._corner = {color: (rows * TILE + k // per_row * _SWATCH, k % per_row * _SWATCH) for color, k in self._colors.items()}
        for color, (row, column) in self._corner.items():
            self.pixels[row : row + _SWATCH, column : column + _SWATCH] = np.rint(255 * np.array(color))

    def uvs(self, name: str, part: MeshPart) -> F64:
        """Returns the texture coordinates of a part in the atlas, (V, 2)."""
        height, width = self.pixels.shape[:2]
        if part.material.texture is None or part.uvs is None:
            row, column = self._corner[part.material.base_color[:3]]
            middle = np.array([column + _SWATCH / 2, row + _SWATCH / 2]) / (width, height)
            return np.tile(middle, (len(part.vertices), 1))
        if part.uvs.min() < -0.01 or part.uvs.max() > 1.01:
            raise SceneError(
                f"{name}: a texture is repeated across a surface; scan-like meshes are made from scenes whose textures do not repeat, "
                "or that have light maps"
            )
        row, column = self._cell[id(part.material.texture)]
        placed: F64 = (np.clip(part.uvs.astype(np.float64), 0.0, 1.0) + np.array([column, row])) * TILE / (width, height)
        return placed


def subdivided(vertices: F64, uvs: F64, triangles: I64, min_triangles: int) -> tuple[F64, F64, I64]:
    """Returns vertices (V, 3), uvs (V, 2) and at least ``min_triangles`` triangles (F, 3) of the same surface, without cracks.

    All edges longer than a limit are repeatedly bisected, in both adjacent triangles; the limit shrinks until there are enough triangles.
    """
    if len(triangles) >= min_triangles:
        return vertices, uvs, triangles
    area = float(np.linalg.norm(_normals(vertices, triangles), axis=1).sum()) / 2.0
    limit = 10.0 * math.sqrt(area / min_triangles)
    while True:
        result = _bisected(vertices, uvs, triangles, limit)
        if len(result[2]) >= min_triangles:
            return result
        limit *= max(0.75, 0.97 * math.sqrt(len(result[2]) / min_triangles))


def without_closed_surfaces(vertices: F64, triangles: I64) -> I64:
    """Returns the triangles (F, 3) without the lowest one of each closed surface: scans, without undersides, have none."""
    normals = area_normals(vertices, triangles).astype(np.float32)
    mesh = MeshPart(vertices.astype(np.float32), normals, None, triangles.astype(np.uint32))
    closed = np.flatnonzero(find_closed_surfaces([mesh], [True]).triangles[0])
    welded = weld(mesh.vertices)
    solid = components(welded[triangles[closed]], int(welded.max()) + 1)
    order = np.lexsort((vertices[triangles[closed], 2].mean(axis=1), solid))
    lowest = order[np.unique(solid[order], return_index=True)[1]]
    return np.delete(triangles, closed[lowest], axis=0)


def _normals(vertices: F64, triangles: I64) -> F64:
    a, b, c = (vertices[triangles[:, k]] for k in range(3))
    return np.cross(b - a, c - a)


def _bisected(vertices: F64, uvs: F64, triangles: I64, limit: float) -> tuple[F64, F64, I64]:
    """Returns vertices, uvs and triangles in which all edges longer than ``limit``, metres, are bisected."""
    rows = np.hstack([vertices, uvs])
    while True:
        ends = triangles[:, [[0, 1], [1, 2], [2, 0]]]  # (F, 3, 2)
        # Rounded, so that both sides of an edge are bisected alike although their vertices are stored twice.
        at = np.rint(rows[:, :3] * _WELD)
        length = np.linalg.norm(at[ends[:, :, 0]] - at[ends[:, :, 1]], axis=2) / _WELD
        long = length > limit
        if not long.any():
            return rows[:, :3], rows[:, 3:], triangles
        edges = np.sort(ends[long], axis=1)
        unique, number = np.unique(edges[:, 0] * len(rows) + edges[:, 1], return_inverse=True)
        middle = np.full(long.shape, -1, dtype=np.int64)
        middle[long] = len(rows) + number
        rows = np.vstack([rows, (rows[unique // len(rows)] + rows[unique % len(rows)]) / 2.0])
        triangles = _split(triangles, middle)


def _split(triangles: I64, middle: I64) -> I64:
    """Returns triangles (F, 3) split at the new vertices on their edges, ``middle`` (F, 3), -1 = none."""
    splits = (middle >= 0).sum(axis=1)
    # Rotated so that the first edge is split and, if two are split, the last one is not.
    turn = np.where(splits == 2, np.argmax(middle < 0, axis=1) + 1, np.argmax(middle >= 0, axis=1)) % 3
    order = (turn[:, None] + np.arange(3)) % 3
    t, m = np.take_along_axis(triangles, order, axis=1), np.take_along_axis(middle, order, axis=1)
    (a, b, c), (ab, bc, ca) = t.T, m.T
    parts = {
        0: ((a, b, c),),
        1: ((a, ab, c), (ab, b, c)),
        2: ((a, ab, c), (ab, bc, c), (ab, b, bc)),
        3: ((a, ab, ca), (ab, b, bc), (ca, bc, c), (ab, bc, ca)),
    }
    found = [np.stack(corners, axis=1)[splits == count] for count, pieces in parts.items() for corners in pieces]
    return np.concatenate(found)


def _surface_noise(vertices: F64, axis: int) -> F64:
    """Returns the displacement along an axis, (V,), metres: a function of position, so that no crack opens."""
    off: F64 = sum(
        (height * wobble(vertices, 10 * axis + k, length) for k, (length, height) in enumerate(_NOISE)), start=np.zeros(1)
    )
    return off
