"""Makes Gaussian splats of a scene's own surfaces, so that what draws splats can be measured against the picture of the mesh.

They are flat discs with the colours of the textures, as the surface looks without lamps: true for scenes whose light is baked in.
"""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from gibson_sim.errors import SceneError
from gibson_sim.formats.load_mesh import MeshLoader
from gibson_sim.formats.mesh import MeshPart
from gibson_sim.formats.splats import SH_DC, Splats
from gibson_sim.geometry.colours import linear_from_srgb, srgb_from_linear
from gibson_sim.geometry.transforms import matrix_from_pose, transform_points
from gibson_sim.geometry.triangles import areas_of, spread_over, unit_normals
from gibson_sim.quoting import quoted
from gibson_sim.scenes.scene_meshes import scene_roots
from gibson_sim.scenes.spec import SceneSpec

F64 = NDArray[np.float64]
_WIDTH = 0.7
"""Standard deviation of a disc, mean distances between splats."""
_DRAWN = 5
"""Random points for each splat, of which those are kept that are not beside another: so there are few gaps."""
_SHIFT = 0.3719
_FLATNESS = 0.1
"""Standard deviation across the surface by that along it."""
_OPACITY = 0.95


def splats_of_scene(scene: SceneSpec, count: int, rng: np.random.Generator) -> Splats:
    """Returns about ``count`` splats on the opaque static surfaces of a scene, world frame, metres.

    Raises:
        SceneError: it has no such surface.
    """
    loader = MeshLoader(scene_roots(scene))
    pieces: list[tuple[MeshPart, F64, NDArray[np.float64] | None]] = []
    for visual in scene.visuals:
        if visual.color is not None and visual.color[3] < 1.0:
            continue
        for part in loader.shape(visual.shape).parts:
            if part.material.alpha_mode != "blend":
                color = None if visual.color is None else np.array(visual.color[:3])
                pieces.append((part, transform_points(matrix_from_pose(visual.pose), part.vertices)[part.triangles], color))
    areas = np.array([areas_of(corners).sum() for _, corners, _ in pieces])
    if not areas.sum() > 0.0:
        raise SceneError(f"scene {quoted(scene.name)}: has no opaque surface to put splats on")
    spacing = float(np.sqrt(areas.sum() / count))
    found = [
        _on_part(part, corners, color, max(round(count * share), 1), spacing, rng)
        for (part, corners, color), share in zip(pieces, areas / areas.sum(), strict=True)
    ]
    points, normals, colors = (np.concatenate(parts) for parts in zip(*found, strict=True))
    width = _WIDTH * spacing
    scales = np.tile(np.array([width, width, _FLATNESS * width], dtype=np.float32), (len(points), 1))
    return Splats(
        points.astype(np.float32),
        scales,
        _quats_to(normals),
        np.full(len(points), _OPACITY, dtype=np.float32),
        ((colors - 0.5) / SH_DC)[:, None].astype(np.float32),
    )


def _on_part(
    part: MeshPart, corners: F64, color: NDArray[np.float64] | None, count: int, spacing: float, rng: np.random.Generator
) -> tuple[F64, F64, F64]:
    """Returns points, unit normals and sRGB colours, 0 to 1, each (N, 3)."""
    points, which = _spaced(*spread_over(corners, _DRAWN * count, rng), spacing)
    base = np.asarray(part.material.base_color[:3]) if color is None else color
    shades = np.tile(linear_from_srgb(base), (len(points), 1))
    triangles = part.triangles[which]
    weights = _barycentric(corners[which], points)
    if part.colors is not None and color is None:
        shades *= np.einsum("nk,nkc->nc", weights, linear_from_srgb(part.colors[triangles] / 255.0))
    texture = part.material.texture
    if texture is not None and part.uvs is not None and color is None:
        uv = np.einsum("nk,nkc->nc", weights, part.uvs[triangles].astype(np.float64))
        shades *= linear_from_srgb(_texels(texture.pixels[:, :, :3], uv))
    return points, unit_normals(corners)[which], np.asarray(srgb_from_linear(shades), dtype=np.float64)


def _spaced(points: F64, which: NDArray[np.int64], spacing: float) -> tuple[F64, NDArray[np.int64]]:
    """Returns the first of the points (N, 3), and of ``which`` (N,), in each cell of a grid."""
    # Floors and walls often lie on round numbers: not on the borders of cells.
    cells = np.floor(points / spacing + _SHIFT).astype(np.int64)
    _, first = np.unique(cells, axis=0, return_index=True)
    kept = np.sort(first)
    return points[kept], which[kept]


def _barycentric(corners: F64, points: F64) -> F64:
    """Returns the weights (N, 3) of the corners (N, 3, 3) of triangles at points in them, (N, 3)."""
    a, b, c = (corners[:, k] for k in range(3))
    whole = np.cross(b - a, c - a)
    square = np.maximum((whole * whole).sum(axis=1), 1e-30)
    second = (np.cross(points - a, c - a) * whole).sum(axis=1) / square
    third = (np.cross(b - a, points - a) * whole).sum(axis=1) / square
    return np.stack([1.0 - second - third, second, third], axis=1)


def _texels(image: NDArray[np.uint8], uv: F64) -> F64:
    """Returns the sRGB colours, 0 to 1, (N, 3), of a repeated image (H, W, 3) at texture coordinates (N, 2), bilinear."""
    height, width = image.shape[:2]
    at = np.mod(uv, 1.0) * (width, height) - 0.5
    rows = -(-len(at) // 4096)  # OpenCV limits maps to 32767 rows and columns
    maps = np.zeros((2, rows * 4096), dtype=np.float32)
    maps[:, : len(at)] = at.T
    x, y = maps.reshape(2, rows, 4096)
    found = cv2.remap(np.ascontiguousarray(image), x, y, cv2.INTER_LINEAR, borderMode=cv2.BORDER_WRAP)
    return np.asarray(found.reshape(-1, 3)[: len(at)] / 255.0, dtype=np.float64)


def _quats_to(normals: F64) -> NDArray[np.float32]:
    """Returns unit quaternions (N, 4), x y z w, that turn the z axis to unit normals (N, 3)."""
    x, y, z = normals.T
    quats = np.stack([-y, x, np.zeros_like(x), 1.0 + z], axis=1)  # the half-way rotation
    quats[z < -0.999999] = (1.0, 0.0, 0.0, 0.0)
    return np.asarray(quats / np.linalg.norm(quats, axis=1, keepdims=True), dtype=np.float32)
