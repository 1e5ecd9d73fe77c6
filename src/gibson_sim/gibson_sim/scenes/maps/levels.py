"""Finds the floors of a building: the heights at which much level area looks up, with room above it."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from gibson_sim.geometry.triangles import unit_normals
from gibson_sim.scenes.mesh import collision_triangles
from gibson_sim.scenes.spec import SceneSpec

F64 = NDArray[np.float64]
STOREY = 1.8
"""Two floors are at least this far apart, metres: beds and tables are no floors."""
SMALLEST_SHARE = 0.2
"""A floor has at least this part of the area of the largest one."""
SMALLEST_AREA = 2.0
"""Square metres of a floor."""
_HEADROOM = 1.5
_UP = 0.8
_BIN = 0.02


def scene_floors(scene: SceneSpec, triangles: tuple[F64, NDArray[np.int32]] | None = None) -> tuple[float, ...]:
    """Returns the heights of all floors, from the lowest, metres: those that the scene names, else those that are found.

    Args:
        scene: the scene.
        triangles: its ``collision_triangles``; None = read here.
    """
    if scene.other_floors:
        return scene.floors
    found = find_floors(*(triangles or collision_triangles(scene)))
    others = [z for z in found if abs(z - scene.floor_z) >= STOREY]
    return tuple(sorted([scene.floor_z, *others]))


def find_floors(vertices: F64, triangles: NDArray[np.int32]) -> tuple[float, ...]:
    """Returns the heights of the floors of a mesh, from the lowest, metres.

    A roof is no floor: something must stand or hang at least 1.5 m above one.

    Args:
        vertices: (V, 3), world frame, metres.
        triangles: (F, 3).
    """
    corners = np.asarray(vertices, dtype=np.float64)[triangles]
    if not len(corners):
        return ()
    normals = unit_normals(corners)
    areas = np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1) / 2
    top = _quantile(corners[:, :, 2].max(axis=1), areas, 0.999)
    z = corners[:, :, 2].mean(axis=1)
    up = (normals[:, 2] > _UP) & (z < top - _HEADROOM)
    z, areas = z[up], areas[up]
    found: list[tuple[float, float]] = []
    while len(z):
        bins = np.floor((z - z.min()) / _BIN).astype(np.int64)
        # Three bins together: the noise of a scan spreads a floor.
        height = np.convolve(np.bincount(bins, weights=areas), np.ones(3), mode="same")
        peak = z.min() + (int(height.argmax()) + 0.5) * _BIN
        near = np.abs(z - peak) <= 1.5 * _BIN
        area = float(areas[near].sum())
        if area < max(SMALLEST_AREA, SMALLEST_SHARE * max((a for _, a in found), default=0.0)):
            break
        found.append((_quantile(z[near], areas[near], 0.5), area))
        rest = np.abs(z - peak) >= STOREY
        z, areas = z[rest], areas[rest]
    return tuple(sorted(float(np.round(height, 6)) + 0.0 for height, _ in found))


def _quantile(values: F64, weights: F64, share: float) -> float:
    order = np.argsort(values)
    total = np.cumsum(weights[order])
    return float(values[order][min(int(np.searchsorted(total, share * total[-1])), len(values) - 1)])
