"""Where up is in a mesh, and whether it is in metres: guessed from its level surfaces."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from gibson_sim.geometry.triangles import areas_of, unit_normals
from gibson_sim.scenes.mesh_types import UpAxis

F64 = NDArray[np.float64]
ALIGNED_DEG = 0.5
"""A floor that is less out of level than this counts as level, degrees."""
UNITS = {"m": 1.0, "cm": 0.01, "mm": 0.001, "inch": 0.0254, "foot": 0.3048, "km": 1000.0}
"""Metres per unit, by name."""
_SLABS = 400
_SURE = 1.5
_EDGE = 0.08
_CLEAR = 0.3
_CONE_DEG = 25.0
_FIRST_HALF, _LAST_HALF, _SHRINK, _NARROWEST = 0.05, 0.004, 0.7, 0.03
_MOST_FACES = 300_000
_LOW, _HIGH = 1.2, 25.0
_STOREY = 2.8
_NARROW, _WIDE = 1.0, 400.0


@dataclass(frozen=True, slots=True)
class UpGuess:
    """What level surfaces say."""

    axis: UpAxis
    """Of the mesh as it is given: the one nearest to up."""
    up: tuple[float, float, float]
    """Unit vector, frame of the mesh as it is given; its direction against z is ``tilt_deg``."""
    tilt_deg: float
    """Angle between ``up`` and the z axis; 0 where no level surface was found."""
    level_area: float
    """Area that the guess rests on, square units of the mesh."""
    sign_is_clear: bool = False
    """Whether it is known which end of ``axis`` is up; an empty room looks the same upside down."""


def guess_up(vertices: F64, triangles: NDArray[np.integer]) -> UpGuess:
    """Returns where up is: the largest flat thing of an interior is its floor.

    The z axis is given the benefit of the doubt: another axis needs a level that is half as large again.

    Args:
        vertices: (V, 3).
        triangles: (F, 3).
    """
    corners = vertices[triangles[:: max(1, len(triangles) // _MOST_FACES)]]
    normals, areas = unit_normals(corners), areas_of(corners)
    centres = corners.mean(axis=1)
    found = [_level(normals, areas, centres, axis) for axis in range(3)]
    best = max(range(3), key=lambda axis: found[axis] * (_SURE if axis == 2 else 1.0))
    start = np.zeros(3)
    balance = _sign(normals, areas, centres, best)
    start[best] = 1.0 if best == 2 or balance >= 0 else -1.0
    up, area = _refined(normals, areas, corners, start)
    tilt = math.degrees(math.acos(float(np.clip(up[2], -1.0, 1.0)))) if area > 0 else 0.0
    return UpGuess(("x", "y", "z")[best], (float(up[0]), float(up[1]), float(up[2])), tilt, area, abs(balance) > _CLEAR)


def _level(normals: F64, areas: F64, centres: F64, axis: int) -> float:
    """Returns the largest area across an axis that lies in one thin slab."""
    flat = np.abs(normals[:, axis]) > math.cos(math.radians(_CONE_DEG))
    if not flat.any():
        return 0.0
    heights = centres[flat, axis]
    size = max(float(np.ptp(centres, axis=0).max()), 1e-9)
    bins = np.clip(((heights - heights.min()) / size * _SLABS).astype(np.int64), 0, _SLABS)
    sums = np.bincount(bins, weights=areas[flat], minlength=_SLABS + 2)
    return float((sums[:-1] + sums[1:]).max())


def _sign(normals: F64, areas: F64, centres: F64, axis: int) -> float:
    """Returns how much more area between floor and ceiling faces along the axis than against it, -1 to 1.

    Tables are seen from above, and scanned from there.
    """
    heights = centres[:, axis]
    low, high = float(heights.min()), float(heights.max())
    margin = _EDGE * (high - low)
    between = (heights > low + margin) & (heights < high - margin) & (np.abs(normals[:, axis]) > 0.9)
    total = float(areas[between].sum())
    return float((areas * normals[:, axis])[between].sum()) / total if total > 0 else 0.0


def _refined(normals: F64, areas: F64, corners: F64, up: F64) -> tuple[F64, float]:
    """Returns the direction of the largest level surface near ``up``, and its area.

    Normals of a scan scatter by many degrees, so they only say which faces are meant; the direction is that of the plane through these.
    """
    near = np.abs(normals @ up) > math.cos(math.radians(_CONE_DEG))
    if not near.any():
        return up, 0.0
    # Corners rather than centres: the two triangles of a plain floor have a line of these.
    points, weights = corners[near].reshape(-1, 3), np.repeat(areas[near] / 3.0, 3)
    size = max(float(np.ptp(points, axis=0).max()), 1e-9)
    half = _FIRST_HALF * size
    heights = points @ up
    bins = np.floor((heights - heights.min()) / half).astype(np.int64)
    sums = np.bincount(bins, weights=weights)
    middle = heights.min() + (int((sums[:-1] + sums[1:]).argmax()) + 1 if len(sums) > 1 else 0.5) * half
    inside = np.abs(heights - middle) <= half
    while True:
        mean = np.average(points[inside], axis=0, weights=weights[inside])
        offsets = points[inside] - mean
        values, vectors = np.linalg.eigh((offsets * weights[inside, None]).T @ offsets / weights[inside].sum())
        if values[1] < (_NARROWEST * size) ** 2:
            return up, float(weights[inside].sum())  # a ledge or a beam says nothing
        up = vectors[:, 0] * (1.0 if float(vectors[:, 0] @ up) >= 0 else -1.0)
        if half <= _LAST_HALF * size:
            return up, float(weights[inside].sum())
        half *= _SHRINK
        closer = np.abs((points - mean) @ up) <= half
        if not closer.any():
            return up, float(weights[inside].sum())
        inside = closer


def rotation_to_z(up: Sequence[float]) -> F64:
    """Returns the smallest rotation, (3, 3), that takes a unit vector to z."""
    v = np.asarray(up, dtype=np.float64)
    axis = np.cross(v, (0.0, 0.0, 1.0))
    sine, cosine = float(np.linalg.norm(axis)), float(v[2])
    if sine < 1e-12:
        return np.eye(3) if cosine > 0 else np.diag([1.0, -1.0, -1.0])
    x, y, z = axis / sine
    k = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    return np.asarray(np.eye(3) + sine * k + (1.0 - cosine) * (k @ k))


def guess_unit(size: Sequence[float]) -> str:
    """Returns the unit, a key of ``UNITS``, in which something of this size (x, y, z) is a room or a building; "" = none fits.

    Metres are given the benefit of the doubt; of others the one in which it is nearest to a storey high.
    """
    width, depth, height = (float(c) for c in size)

    def fits(metres: float) -> bool:
        return _LOW <= height * metres <= _HIGH and _NARROW <= max(width, depth) * metres <= _WIDE

    found = [name for name, metres in UNITS.items() if fits(metres)]
    if not found or "m" in found:
        return "m" if found else ""
    return min(found, key=lambda name: abs(math.log(height * UNITS[name] / _STOREY)))
