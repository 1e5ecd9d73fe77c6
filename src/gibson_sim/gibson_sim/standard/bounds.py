"""Bounding volumes of the standard, and the overlap test of an entity's bounding box against one."""

from __future__ import annotations

from dataclasses import dataclass
from enum import IntEnum

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.spatial import ConvexHull, QhullError

from gibson_sim.standard.codes import Result, SimulationError
from gibson_sim.types import Vec3

MAX_POINTS = 256
"""Maximum number of points of a convex hull."""
_NEARLY_ZERO = 1e-9
"""Length below which a vector counts as zero, m."""
_TOLERANCE = 1e-9
"""Distance up to which two volumes count as overlapping, m: volumes that touch overlap."""


F64 = NDArray[np.float64]


class BoundsType(IntEnum):
    """Types of ``simulation_interfaces/Bounds``."""

    EMPTY = 0
    BOX = 1
    CONVEX_HULL = 2
    SPHERE = 3


@dataclass(frozen=True, slots=True)
class Bounds:
    """A volume from a client's request, unchecked."""

    kind: int
    """Number of a ``BoundsType``."""
    points: tuple[Vec3, ...] = ()
    """Points, m. BOX: two corners; SPHERE: the centre, then the radius as x; CONVEX_HULL: three or more vertices."""


def box_bounds(low: Vec3, high: Vec3) -> Bounds:
    """Returns a box from its corners, m; in the standard the upper corner comes first."""
    return Bounds(BoundsType.BOX, (high, low))


class OverlapTest:
    """Tests whether axis-aligned boxes overlap a volume.

    Raises:
        SimulationError: Result.FEATURE_UNSUPPORTED for an unknown type, OPERATION_FAILED for points that do not define a volume.
    """

    def __init__(self, bounds: Bounds) -> None:
        known = ", ".join(f"{kind.value} {kind.name}" for kind in BoundsType)
        if bounds.kind not in list(BoundsType):
            raise SimulationError(Result.FEATURE_UNSUPPORTED, f"bounds have the unknown type {bounds.kind}; known: {known}")
        self._kind = BoundsType(bounds.kind)
        points = np.array(bounds.points, dtype=np.float64).reshape(-1, 3)
        minimum, maximum = {"BOX": (2, 2), "SPHERE": (2, 2), "CONVEX_HULL": (3, MAX_POINTS)}.get(self._kind.name, (0, MAX_POINTS))
        if not minimum <= len(points) <= maximum:
            allowed = str(minimum) if minimum == maximum else f"{minimum} to {maximum}"
            raise SimulationError(
                Result.OPERATION_FAILED, f"bounds {self._kind.name} have {len(points)} points, must have {allowed}"
            )
        if not np.isfinite(points).all():
            raise SimulationError(
                Result.OPERATION_FAILED, f"bounds {self._kind.name} hold a NaN or an infinity; give finite metres"
            )
        if self._kind is BoundsType.SPHERE and points[1, 0] < 0.0:
            raise SimulationError(Result.OPERATION_FAILED, f"bounds SPHERE have radius {points[1, 0]:g} m, must be 0 or more")
        self._points = points
        self._axes = _separating_axes(points, self._kind is BoundsType.CONVEX_HULL)
        projections = points @ self._axes.T
        self._low, self._high = projections.min(axis=0, initial=np.inf), projections.max(axis=0, initial=-np.inf)

    @property
    def always_true(self) -> bool:
        """Whether the volume is the whole space, so that every box overlaps it."""
        return self._kind is BoundsType.EMPTY

    def overlaps_box(self, low: ArrayLike, high: ArrayLike) -> bool:
        """Returns whether the axis-aligned box from ``low`` to ``high``, each (3,), m, overlaps the volume."""
        lowest, highest = np.asarray(low, dtype=np.float64), np.asarray(high, dtype=np.float64)
        if self._kind is BoundsType.EMPTY:
            return True
        if self._kind is BoundsType.SPHERE:
            center, radius = self._points[0], self._points[1, 0]
            nearest = np.clip(center, lowest, highest)
            return bool(np.linalg.norm(nearest - center) <= radius + _TOLERANCE)
        center, half_extents = (lowest + highest) / 2, (highest - lowest) / 2
        projected_center, projected_radius = self._axes @ center, np.abs(self._axes) @ half_extents + _TOLERANCE
        overlaps = (self._low <= projected_center + projected_radius) & (self._high >= projected_center - projected_radius)
        return bool(overlaps.all())


def _separating_axes(points: F64, hull: bool) -> F64:
    """Returns the candidate axes (N, 3), unit vectors, of the separating axis theorem for the convex hull of the points and a box.

    They are the face normals of both and the cross products of their edges.
    """
    box_axes = np.eye(3)
    if not hull:
        return box_axes
    normals, edges = _faces_and_edges(points)
    crossed = np.cross(edges[:, None], box_axes[None]).reshape(-1, 3)
    axes = np.concatenate([box_axes, normals, crossed])
    lengths = np.linalg.norm(axes, axis=1)
    return np.asarray(axes[lengths > _NEARLY_ZERO] / lengths[lengths > _NEARLY_ZERO, None])


def _faces_and_edges(points: F64) -> tuple[F64, F64]:
    """Returns the face normals (F, 3) and edge directions (E, 3), unit vectors, of the convex hull of points (N, 3), which may be flat."""
    centroid = points.mean(axis=0)
    _, singular_values, directions = np.linalg.svd(points - centroid, full_matrices=True)
    rank = int((singular_values > max(_NEARLY_ZERO, _NEARLY_ZERO * singular_values[0])).sum())
    if rank <= 1:
        return np.zeros((0, 3)), directions[:rank]
    projected = (points - centroid) @ directions[:rank].T
    try:
        hull = ConvexHull(projected)
    except QhullError:  # nearly flat
        rank, projected = 2, (points - centroid) @ directions[:2].T
        hull = ConvexHull(projected)
    corners = points[hull.simplices]
    edges = np.concatenate([corners[:, i] - corners[:, i - 1] for i in range(corners.shape[1] if rank == 3 else 1)])
    edges = edges / np.maximum(np.linalg.norm(edges, axis=1, keepdims=True), _NEARLY_ZERO)
    return (hull.equations[:, :3] @ directions if rank == 3 else directions[2:]), edges
