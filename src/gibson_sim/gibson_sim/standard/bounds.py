"""Volumes of the standard, and the test whether an entity's bounding box overlaps one."""

from __future__ import annotations

from dataclasses import dataclass
from enum import IntEnum

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.spatial import ConvexHull, QhullError

from gibson_sim.standard.codes import Result, SimulationError
from gibson_sim.types import Vec3

MOST_POINTS = 256
"""Greatest number of points of a convex hull."""
_NEARLY_ZERO = 1e-9
"""Lengths below it count as zero, m."""
_TOLERANCE = 1e-9
"""Volumes this near to each other overlap, so that touching counts, m."""


F64 = NDArray[np.float64]


class BoundsType(IntEnum):
    """Types of ``simulation_interfaces/Bounds``."""

    EMPTY = 0
    BOX = 1
    CONVEX_HULL = 2
    SPHERE = 3


@dataclass(frozen=True, slots=True)
class Bounds:
    """A volume from a client. Points of BOX: two corners; SPHERE: the centre, then the radius as x; CONVEX_HULL: three or more."""

    kind: int
    points: tuple[Vec3, ...] = ()


def box_bounds(low: Vec3, high: Vec3) -> Bounds:
    """Returns a box; in the standard the upper corner comes first."""
    return Bounds(BoundsType.BOX, (high, low))


class OverlapTest:
    """Tests whether axis-aligned boxes overlap a volume.

    Raises:
        SimulationError: Result.FEATURE_UNSUPPORTED for an unknown type, OPERATION_FAILED for points that make no volume.
    """

    def __init__(self, bounds: Bounds) -> None:
        known = ", ".join(f"{kind.value} {kind.name}" for kind in BoundsType)
        if bounds.kind not in list(BoundsType):
            raise SimulationError(Result.FEATURE_UNSUPPORTED, f"bounds of type {bounds.kind} are not known; known: {known}")
        self._kind = BoundsType(bounds.kind)
        points = np.array(bounds.points, dtype=np.float64).reshape(-1, 3)
        least, most = {"BOX": (2, 2), "SPHERE": (2, 2), "CONVEX_HULL": (3, MOST_POINTS)}.get(self._kind.name, (0, MOST_POINTS))
        if not least <= len(points) <= most:
            allowed = str(least) if least == most else f"{least} to {most}"
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
        along = points @ self._axes.T
        self._low, self._high = along.min(axis=0, initial=np.inf), along.max(axis=0, initial=-np.inf)

    @property
    def always_true(self) -> bool:
        """Whether the volume is all of space."""
        return self._kind is BoundsType.EMPTY

    def overlaps_box(self, low: ArrayLike, high: ArrayLike) -> bool:
        """Returns whether the box from ``low`` to ``high``, each (3,), metres, has a point in common with the volume."""
        lowest, highest = np.asarray(low, dtype=np.float64), np.asarray(high, dtype=np.float64)
        if self._kind is BoundsType.EMPTY:
            return True
        if self._kind is BoundsType.SPHERE:
            center, radius = self._points[0], self._points[1, 0]
            nearest = np.clip(center, lowest, highest)
            return bool(np.linalg.norm(nearest - center) <= radius + _TOLERANCE)
        center, half = (lowest + highest) / 2, (highest - lowest) / 2
        middle, reach = self._axes @ center, np.abs(self._axes) @ half + _TOLERANCE
        return bool(((self._low <= middle + reach) & (self._high >= middle - reach)).all())


def _separating_axes(points: F64, hull: bool) -> F64:
    """Returns the candidate axes (N, 3), unit vectors, of the separating axis theorem for the points' hull and a box.

    They are the face normals of both and the cross products of their edges.
    """
    boxes = np.eye(3)
    if not hull:
        return boxes
    normals, edges = _faces_and_edges(points)
    crossed = np.cross(edges[:, None], boxes[None]).reshape(-1, 3)
    axes = np.concatenate([boxes, normals, crossed])
    lengths = np.linalg.norm(axes, axis=1)
    return np.asarray(axes[lengths > _NEARLY_ZERO] / lengths[lengths > _NEARLY_ZERO, None])


def _faces_and_edges(points: F64) -> tuple[F64, F64]:
    """Returns normals (F, 3) and directions of edges (E, 3), unit vectors, of the convex hull of points (N, 3), which may be flat."""
    middle = points.mean(axis=0)
    _, sizes, directions = np.linalg.svd(points - middle, full_matrices=True)
    rank = int((sizes > max(_NEARLY_ZERO, _NEARLY_ZERO * sizes[0])).sum())
    if rank <= 1:
        return np.zeros((0, 3)), directions[:rank]
    flat = (points - middle) @ directions[:rank].T
    try:
        found = ConvexHull(flat)
    except QhullError:  # nearly flat
        rank, flat = 2, (points - middle) @ directions[:2].T
        found = ConvexHull(flat)
    corners = points[found.simplices]
    edges = np.concatenate([corners[:, i] - corners[:, i - 1] for i in range(corners.shape[1] if rank == 3 else 1)])
    edges = edges / np.maximum(np.linalg.norm(edges, axis=1, keepdims=True), _NEARLY_ZERO)
    return (found.equations[:, :3] @ directions if rank == 3 else directions[2:]), edges
