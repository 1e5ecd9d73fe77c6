"""Generates Gaussian splats from the surfaces of a scene, as a reference: their image can be compared with that of the mesh.

They are flat discs with the colours of the textures, in the light of light maps; that is correct for scenes with baked light.
"""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from gibson_sim.errors import SceneError
from gibson_sim.formats.light_maps import radiance_of
from gibson_sim.formats.load_mesh import MeshLoader
from gibson_sim.formats.mesh import MeshPart
from gibson_sim.formats.splats import SH_DC, Splats
from gibson_sim.geometry.colours import linear_from_srgb, srgb_from_linear
from gibson_sim.geometry.transforms import matrix_from_pose, transform_points
from gibson_sim.geometry.triangle_meshes import areas_of, spread_over, unit_normals
from gibson_sim.quoting import quoted
from gibson_sim.scenes.scene_meshes import scene_roots
from gibson_sim.scenes.spec import SceneSpec
from gibson_sim_tools.making.pixels import tone_map

F64 = NDArray[np.float64]
_RELATIVE_WIDTH = 0.7
"""Standard deviation of a disc, as a multiple of the mean distance between splats."""
_CANDIDATES_PER_SPLAT = 5
"""Number of random points per splat; one per grid cell is kept, so that few gaps remain."""
_GRID_SHIFT = 0.3719
"""Offset of the grid, cells: floors and walls often lie at round coordinates, which must not be cell borders."""
_FLATNESS = 0.1
"""Ratio of the standard deviation normal to the surface to that along it."""
_OPACITY = 0.95


def splats_of_scene(scene: SceneSpec, count: int, rng: np.random.Generator) -> Splats:
    """Returns about ``count`` splats on the opaque static surfaces of a scene, world frame, metres.

    Raises:
        SceneError: the scene has no such surface.
    """
    loader = MeshLoader(scene_roots(scene))
    sampled_parts: list[tuple[MeshPart, F64, NDArray[np.float64] | None]] = []
    for visual in scene.visuals:
        if visual.color is not None and visual.color[3] < 1.0:
            continue
        for part in loader.shape(visual.shape).parts:
            if part.material.alpha_mode != "blend":
                color = None if visual.color is None else np.array(visual.color[:3])
                sampled_parts.append(
                    (part, transform_points(matrix_from_pose(visual.pose), part.vertices)[part.triangles], color)
                )
    areas = np.array([areas_of(corners).sum() for _, corners, _ in sampled_parts])
    if not areas.sum() > 0.0:
        raise SceneError(f"scene {quoted(scene.name)}: has no opaque surface for splats")
    spacing = float(np.sqrt(areas.sum() / count))
    samples = [
        _sample_part(part, corners, color, max(round(count * share), 1), spacing, rng)
        for (part, corners, color), share in zip(sampled_parts, areas / areas.sum(), strict=True)
    ]
    points, normals, colors = (np.concatenate(parts) for parts in zip(*samples, strict=True))
    width = _RELATIVE_WIDTH * spacing
    scales = np.tile(np.array([width, width, _FLATNESS * width], dtype=np.float32), (len(points), 1))
    return Splats(
        points.astype(np.float32),
        scales,
        _quats_from_normals(normals),
        np.full(len(points), _OPACITY, dtype=np.float32),
        ((colors - 0.5) / SH_DC)[:, None].astype(np.float32),
    )


def _sample_part(
    part: MeshPart, corners: F64, color: NDArray[np.float64] | None, count: int, spacing: float, rng: np.random.Generator
) -> tuple[F64, F64, F64]:
    """Samples a part; returns points, m, unit normals, and sRGB colours, 0 to 1, each (N, 3)."""
    points, triangle_of_point = _thin_out(*spread_over(corners, _CANDIDATES_PER_SPLAT * count, rng), spacing)
    weights = _barycentric(corners[triangle_of_point], points)
    return points, unit_normals(corners)[triangle_of_point], colors_of(part, part.triangles[triangle_of_point], weights, color)


def colors_of(part: MeshPart, triangles: NDArray[np.integer], weights: F64, color: F64 | None = None) -> F64:
    """Returns the colours, sRGB, 0 to 1, (N, 3), of points on a part in the light of its light map.

    Args:
        part: the part.
        triangles: vertex indices of the triangle of each point, (N, 3).
        weights: barycentric coordinates of the points, (N, 3).
        color: sRGB colour that replaces the material; None = none.
    """
    base = np.asarray(part.material.base_color[:3]) if color is None else color
    colors = np.tile(linear_from_srgb(base), (len(weights), 1))
    if part.colors is not None and color is None:
        colors *= np.einsum("nk,nkc->nc", weights, linear_from_srgb(part.colors[:, :3][triangles] / 255.0))
    texture = part.material.texture
    if texture is not None and part.uvs is not None and color is None:
        uv = np.einsum("nk,nkc->nc", weights, part.uvs[triangles].astype(np.float64))
        colors *= linear_from_srgb(_sample_texture(texture.pixels[:, :, :3], uv) / 255.0)
    srgb = srgb_from_linear(colors)
    light = part.material.light_map
    if light is not None and part.light_uvs is not None and color is None:
        uv = np.clip(np.einsum("nk,nkc->nc", weights, part.light_uvs[triangles].astype(np.float64)), 0.0, 1.0)
        srgb = tone_map(colors * _sample_texture(radiance_of(light.pixels, part.material.light_intensity), uv)) / 255.0
    return np.asarray(srgb, dtype=np.float64)


def _thin_out(points: F64, triangle_of_point: NDArray[np.int64], spacing: float) -> tuple[F64, NDArray[np.int64]]:
    """Keeps the first point in each cell of a grid. ``triangle_of_point``: (N,), reduced in the same way."""
    cells = np.floor(points / spacing + _GRID_SHIFT).astype(np.int64)
    _, first = np.unique(cells, axis=0, return_index=True)
    kept = np.sort(first)
    return points[kept], triangle_of_point[kept]


def _barycentric(corners: F64, points: F64) -> F64:
    """Returns the barycentric coordinates, (N, 3), of points (N, 3) in triangles with corners (N, 3, 3)."""
    a, b, c = (corners[:, k] for k in range(3))
    normal = np.cross(b - a, c - a)
    normal_squared = np.maximum((normal * normal).sum(axis=1), 1e-30)
    weight_b = (np.cross(points - a, c - a) * normal).sum(axis=1) / normal_squared
    weight_c = (np.cross(b - a, points - a) * normal).sum(axis=1) / normal_squared
    return np.stack([1.0 - weight_b - weight_c, weight_b, weight_c], axis=1)


def _sample_texture(image: NDArray[np.uint8] | NDArray[np.float32], uv: F64) -> F64:
    """Returns the values, (N, 3), of a repeating image (H, W, 3) at texture coordinates (N, 2), interpolated bilinearly."""
    height, width = image.shape[:2]
    pixels = np.mod(uv, 1.0) * (width, height) - 0.5
    rows = -(-len(pixels) // 4096)  # OpenCV limits maps to 32767 rows and columns
    maps = np.zeros((2, rows * 4096), dtype=np.float32)
    maps[:, : len(pixels)] = pixels.T
    x, y = maps.reshape(2, rows, 4096)
    colors = cv2.remap(np.ascontiguousarray(image), x, y, cv2.INTER_LINEAR, borderMode=cv2.BORDER_WRAP)
    return np.asarray(colors.reshape(-1, 3)[: len(pixels)], dtype=np.float64)


def _quats_from_normals(normals: F64) -> NDArray[np.float32]:
    """Returns unit quaternions, (N, 4), xyzw, that rotate the z axis to unit normals (N, 3)."""
    x, y, z = normals.T
    quats = np.stack([-y, x, np.zeros_like(x), 1.0 + z], axis=1)  # rotation from z to the normal, not yet normalised
    quats[z < -0.999999] = (1.0, 0.0, 0.0, 0.0)
    return np.asarray(quats / np.linalg.norm(quats, axis=1, keepdims=True), dtype=np.float32)
