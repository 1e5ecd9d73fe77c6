"""Simplifies the collision geometry of a scan: boxes with level tops for its floors, and few triangles for the rest.

The shapes are cached, for ``collision: simplified`` in a scene.
"""

from __future__ import annotations

import logging
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.spatial import cKDTree

from gibson_sim.description.shapes import Shape
from gibson_sim.errors import MeshError
from gibson_sim.geometry.triangle_meshes import distances, simplify, smooth, spread_over, weld
from gibson_sim.scenes.collision.cache import default_folder, digest_of, get_or_create
from gibson_sim.scenes.collision.planes import THICKNESS, Flattened, Slab, flatten_floors
from gibson_sim.types import Pose

_log = logging.getLogger(__name__)
F64 = NDArray[np.float64]
I64 = NDArray[np.int64]
MAX_ERROR = 0.03
"""Maximum distance of a sample point of the scan from the simplified geometry, and vice versa, metres."""
_SAMPLES = 40_000
"""Number of sample points on the scan, and on the simplified geometry."""
_MAX_ATTEMPTS = 7
_FIXED_RADIUS = 0.1
"""Radius about points with too large an error within which the next attempt does not move vertices, metres."""


@dataclass(frozen=True, slots=True, eq=False)
class SimplifiedScan:
    """The collision geometry of a scan, world frame."""

    slabs: tuple[Slab, ...]
    """Boxes of the floors."""
    vertices: F64 = field(repr=False)
    """Vertex positions of the other geometry, (V, 3), metres."""
    triangles: I64 = field(repr=False)
    """Vertex indices of the triangles, (F, 3)."""
    error: float
    """Maximum distance of the sample points of each geometry from the other, metres."""
    before: int
    """Number of triangles of the scan."""

    def __str__(self) -> str:
        levels = sorted({round(slab.top, 3) for slab in self.slabs})
        floors = f"floors at {', '.join(f'{z:g}' for z in levels)} m of {len(self.slabs)} boxes" if levels else "no level floor"
        return f"{len(self.triangles)} triangles for {self.before}, {floors}, within {self.error * 1000:.0f} mm"


def simplify_scan(vertices: ArrayLike, triangles: ArrayLike, max_error: float = MAX_ERROR) -> SimplifiedScan:
    """Returns boxes and triangles whose distance from a scan, at sample points, is at most ``max_error``.

    Args:
        vertices: (V, 3), world metres, z up.
        triangles: (F, 3), rows of ``vertices``.
        max_error: maximum distance, metres.

    Raises:
        MeshError: there are no triangles, or meshoptimizer is not installed.
    """
    points, corners = weld(vertices, triangles)
    if not len(corners):
        raise MeshError("the scan has no triangles with finite corners and an area above 0")
    not_flattened = Flattened((), points, corners, np.zeros(len(points), dtype=bool))
    for flattened in (flatten_floors(points, corners), not_flattened):
        simplified = _simplified(points[corners], flattened, max_error)
        if simplified is not None:
            return simplified
    _log.warning("no simpler mesh is within %g m of the scan: the scan itself is used as its collision shape", max_error)
    return SimplifiedScan((), points, corners, 0.0, len(corners))


def _simplified(scan: F64, flattened: Flattened, max_error: float) -> SimplifiedScan | None:
    """Returns the simplified geometry of a scan (F, 3, 3) with flattened floors; None if its error remains too large."""
    measure = _ErrorMeasure(scan, _tops(flattened.slabs), max_error)
    rest, flat = flattened.triangles, flattened.flat
    if measure.check(flattened.vertices, rest)[0] >= max_error:
        return None
    smoothed = smooth(flattened.vertices, rest, flat, max_error / 3)
    fixed = np.zeros(len(smoothed), dtype=bool)
    for attempt in range(_MAX_ATTEMPTS):
        mesh = simplify(smoothed, rest, max_error / 2 ** (1 + attempt // 3), fixed)
        error, bad = measure.check(*mesh)
        if error < max_error:
            return SimplifiedScan(flattened.slabs, *mesh, error, len(scan))
        # The next attempt does not move vertices near points with too large an error.
        fixed |= cKDTree(bad).query(smoothed, distance_upper_bound=_FIXED_RADIUS)[0] <= _FIXED_RADIUS
    return None


class _ErrorMeasure:
    """Measures the distance between a scan and meshes.

    Args:
        scan: (F, 3, 3), triangles, metres.
        tops: (N, 3, 3), triangles that are part of each mesh, metres.
        max_error: maximum distance, metres.
    """

    def __init__(self, scan: F64, tops: F64, max_error: float) -> None:
        self._scan, self._tops, self._max_error = scan, tops, max_error
        self._points = spread_over(scan, _SAMPLES, np.random.default_rng(0))[0]

    def check(self, vertices: F64, triangles: I64) -> tuple[float, F64]:
        """Returns the maximum distance of sample points in both directions, metres, and the points (N, 3) with too large a distance."""
        rng = np.random.default_rng(1)
        mesh = np.concatenate([vertices[triangles], self._tops])
        points = np.concatenate([self._points, spread_over(mesh, _SAMPLES, rng)[0]])
        from_scan = distances(self._points, mesh, rng)
        all_distances = np.concatenate([from_scan, distances(points[len(from_scan) :], self._scan, rng)])
        return float(all_distances.max(initial=0.0)), points[all_distances >= self._max_error]


def _tops(slabs: tuple[Slab, ...]) -> F64:
    """Returns the upper faces of N slabs as triangles (2 N, 3, 3), world metres."""
    out = []
    for slab in slabs:
        (x, y), (X, Y), z = slab.low, slab.high, slab.top
        out += [[[x, y, z], [X, y, z], [X, Y, z]], [[x, y, z], [X, Y, z], [x, Y, z]]]
    return np.array(out, dtype=np.float64).reshape(-1, 3, 3)


def scan_shapes(
    vertices: ArrayLike, triangles: ArrayLike, name: str, *, folder: Path | None = None, max_error: float = MAX_ERROR
) -> tuple[tuple[Shape, Pose], ...]:
    """Returns the simplified collision shapes of a scan, each with T_world_shape; computed once and cached.

    Args:
        vertices: (V, 3), world metres, z up.
        triangles: (F, 3), rows of ``vertices``.
        name: name of the scan for the log.
        folder: folder of the cache; None = ``default_folder()``.
        max_error: maximum distance between the scan and the shapes, metres.

    Raises:
        MeshError: the scan has no triangles.
        SceneError: the cache cannot be written.
    """
    points, corners = np.asarray(vertices, dtype=np.float64), np.asarray(triangles, dtype=np.int64)

    def make(place: Path) -> dict[str, object]:
        simplified = simplify_scan(points, corners, max_error)
        meshes = [(simplified.vertices, simplified.triangles)] if len(simplified.triangles) else []
        write_meshes(place, meshes)
        slabs = [[*slab.low, *slab.high, slab.top] for slab in simplified.slabs]
        return {"what": str(simplified), "meshes": len(meshes), "slabs": slabs}

    place, record = get_or_create(folder or default_folder(), digest_of(points, corners, "scan", max_error), make)
    _log.info("%s collides as %s", name, record["what"])
    shapes = [(_mesh(path), Pose()) for path in mesh_files(place, record)]
    slabs = record["slabs"]
    assert isinstance(slabs, list)
    for x, y, right, far, top in slabs:
        center = ((x + right) / 2, (y + far) / 2, top - THICKNESS / 2)
        shapes.append((Shape("box", (right - x, far - y, THICKNESS)), Pose(center)))
    return tuple(shapes)


def write_meshes(place: Path, meshes: Sequence[tuple[F64, I64]]) -> None:
    """Writes meshes, pairs of vertices (V, 3), metres, and triangles (F, 3), as OBJ files to a folder of the cache."""
    for number, (points, corners) in enumerate(meshes):
        with (place / f"part_{number}.obj").open("w", encoding="ascii") as file:
            np.savetxt(file, points, fmt="v %.6f %.6f %.6f")
            np.savetxt(file, corners + 1, fmt="f %d %d %d")


def mesh_files(place: Path, record: dict[str, object]) -> list[Path]:
    """Returns the OBJ files in a folder of the cache; ``record`` contains their number."""
    count = record["meshes"]
    assert isinstance(count, int)
    return [place / f"part_{number}.obj" for number in range(count)]


def _mesh(path: Path) -> Shape:
    return Shape("mesh", (1.0, 1.0, 1.0), str(path.resolve()))
