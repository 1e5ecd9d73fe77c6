"""Measures how much of what a robot sees in a mesh is hole: pixels whose ray meets nothing, or the back of a surface.

Views are drawn from free places of the floor, level and all around, at the height of a robot's camera. Without OpenGL: some 50 small pictures.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy import ndimage

from gibson_sim.errors import SceneError
from gibson_sim.geometry.rasterise import numbered_pairs
from gibson_sim.geometry.transforms import Mat4, transform_points
from gibson_sim.maps.floor_map import FloorMap, make_floor_map

F64 = NDArray[np.float64]
I64 = NDArray[np.int64]
Bools = NDArray[np.bool_]
Progress = Callable[[float], None]

ROBOT_RADIUS, ROBOT_HEIGHT = 0.2, 0.5
"""Size of the robot whose views are drawn, and for which places are free, metres."""
CAMERA_HEIGHT = 0.5
"""Height of the camera above the floor, metres."""
PLACES = 12
"""Places on all floors together from which is looked, at most."""
WIDTH, HEIGHT = 120, 90
"""Size of a view, pixels; its horizontal field of view is 90 degrees, so four of them look all around."""
_VIEWS = 4
_NEAR = 0.02
"""Nearest depth that is drawn, metres."""
_SAME = 0.002
"""Depth behind a back face within which a front face belongs to the same board, metres."""
_CELL = 1.0
"""Edge of the cubes by which triangles outside a view are left out, metres."""
_PAIRS_AT_ONCE = 400_000
"""Pairs of a triangle and a pixel that are processed together, which limits memory."""


@dataclass(frozen=True, slots=True)
class ViewHoles:
    """Part of the pixels of a robot's views that show no surface."""

    places: int
    """Number of places from which was looked."""
    nothing: float
    """Share of the pixels whose ray meets nothing, 0 to 1."""
    backs: float
    """Share of the pixels that show the back of a one-sided surface, 0 to 1."""

    @property
    def share(self) -> float:
        """Share of both, 0 to 1."""
        return self.nothing + self.backs

    def text(self) -> str:
        """Returns the measurement in words."""
        return (
            f"{100.0 * self.share:.1f} % of a robot's view is holes ({100.0 * self.nothing:.1f} % no surface, {100.0 * self.backs:.1f} % back "
            f"faces), from {self.places} free position{'' if self.places == 1 else 's'}, camera {CAMERA_HEIGHT:g} m above the floor"
        )


def view_holes(
    corners: F64,
    one_sided: Bools,
    floors: Sequence[FloorMap],
    radius: float,
    *,
    ground_z: float | None = None,
    progress: Progress = lambda _: None,
) -> ViewHoles | None:
    """Returns how much of what a robot sees is hole; None if it fits nowhere.

    Args:
        corners: (F, 3, 3), triangles, metres, z up, counter-clockwise seen from where they shall be seen.
        one_sided: (F,), whether the back of a triangle is a hole, as in scans.
        floors: maps of the floors on which the robot may stand.
        radius: of the robot, metres.
        ground_z: height of the ground plane, metres; None = there is none.
        progress: called with the fraction that is done, 0 to 1.
    """
    eyes = [eye for floor in floors for eye in _places(floor, radius, max(1, PLACES // len(floors)))]
    if not eyes or not len(corners):
        return None
    cubes = _Cubes.of(corners)
    nothing = backs = 0
    for done, eye in enumerate(eyes):
        for view in range(_VIEWS):
            rotation = _level_view(2.0 * math.pi * view / _VIEWS)
            seen, back = first_faces(*cubes.near_view(eye, rotation, corners, one_sided))
            if ground_z is not None and eye[2] > ground_z:
                seen |= _rays()[:, 1].reshape(HEIGHT, WIDTH) > 0.0
            nothing += int((~seen).sum())
            backs += int(back.sum())
        progress((done + 1) / len(eyes))
    pixels = len(eyes) * _VIEWS * WIDTH * HEIGHT
    return ViewHoles(len(eyes), nothing / pixels, backs / pixels)


def _places(floor: FloorMap, radius: float, count: int) -> list[F64]:
    """Returns camera positions (3,) spread over the free floor: each is the place farthest from those before it."""
    free = floor.inflate(radius)
    labels, pieces = ndimage.label(free)
    if not pieces:
        return []
    cells = np.argwhere(labels == 1 + int(np.bincount(labels.ravel())[1:].argmax()))
    at = floor.centers(cells)
    k = int(floor.distance_to_obstacle[tuple(cells.T)].argmax())
    found, away = [k], np.full(len(at), np.inf)
    for _ in range(min(count, len(at)) - 1):
        away = np.minimum(away, np.linalg.norm(at - at[found[-1]], axis=1))
        if away.max() < 2.0 * radius:
            break
        found.append(int(away.argmax()))
    return [np.array([*at[k], floor.floor_z + CAMERA_HEIGHT]) for k in found]


def _level_view(yaw: float) -> F64:
    """Returns the rotation (3, 3) that takes world to camera: x right, y down, z ahead."""
    c, s = math.cos(yaw), math.sin(yaw)
    return np.array([[s, -c, 0.0], [0.0, 0.0, -1.0], [c, s, 0.0]])


def _rays() -> F64:
    """Returns the rays (P, 2) of the pixels: x and y at depth 1, row by row."""
    half = math.tan(math.radians(45.0))
    x = ((np.arange(WIDTH) + 0.5) / WIDTH * 2.0 - 1.0) * half
    y = ((np.arange(HEIGHT) + 0.5) / HEIGHT * 2.0 - 1.0) * half * HEIGHT / WIDTH
    return np.stack(np.meshgrid(x, y), axis=-1).reshape(-1, 2)


@dataclass(frozen=True, slots=True, eq=False)
class _Cubes:
    """Triangles by the cubes of their centroids."""

    order: I64
    """(F,), triangles sorted by cube."""
    first: I64
    """(C + 1,), where the triangles of each cube begin in ``order``."""
    centres: F64
    """(C, 3), of the bounding boxes of the triangles of each cube."""
    radii: F64
    """(C,), metres."""

    @staticmethod
    def of(corners: F64) -> _Cubes:
        """Returns the cubes of triangles (F, 3, 3)."""
        cells = np.floor(corners.mean(axis=1) / _CELL).astype(np.int64)
        cells -= cells.min(axis=0)
        sides = cells.max(axis=0) + 1
        codes = (cells[:, 0] * sides[1] + cells[:, 1]) * sides[2] + cells[:, 2]
        order = np.argsort(codes, kind="stable")
        starts = np.flatnonzero(np.diff(codes[order], prepend=-1))
        low = np.minimum.reduceat(corners.min(axis=1)[order], starts)
        high = np.maximum.reduceat(corners.max(axis=1)[order], starts)
        return _Cubes(order, np.append(starts, len(order)), (low + high) / 2, np.linalg.norm(high - low, axis=1) / 2)

    def near_view(self, eye: F64, rotation: F64, corners: F64, one_sided: Bools) -> tuple[F64, Bools]:
        """Returns the triangles that may be in view, (N, 3, 3), camera frame, and whether they are one-sided, (N,)."""
        x, y, z = ((self.centres - eye) @ rotation.T).T
        # The sides of the view are at 45 degrees, its top and bottom nearer.
        slope = HEIGHT / WIDTH
        inside = (z > -self.radii) & (np.abs(x) - z < math.sqrt(2.0) * self.radii)
        inside &= np.abs(y) - slope * z < math.hypot(1.0, slope) * self.radii
        # A view's triangles are those of some runs of the sorted ones.
        rows = self.order[np.repeat(inside, np.diff(self.first))]
        return (corners[rows] - eye) @ rotation.T, one_sided[rows]


def first_faces(corners: F64, one_sided: Bools) -> tuple[Bools, Bools]:
    """Returns (H, W) which pixels show a surface, and (H, W) which of them show the back of a one-sided one.

    Args:
        corners: (F, 3, 3), camera frame: x right, y down, z ahead, metres.
        one_sided: (F,).
    """
    depth = np.full(HEIGHT * WIDTH, np.inf)
    hits = list(_hits(corners))
    for _, pixel, at, _ in hits:
        np.minimum.at(depth, pixel, at)
    fronts = np.zeros(HEIGHT * WIDTH, dtype=bool)
    for which, pixel, at, front in hits:
        nearest = at <= depth[pixel] + _SAME
        fronts[pixel[nearest & (front | ~one_sided[which])]] = True
    seen = np.isfinite(depth)
    return seen.reshape(HEIGHT, WIDTH), (seen & ~fronts).reshape(HEIGHT, WIDTH)


def _hits(corners: F64) -> Sequence[tuple[I64, I64, F64, Bools]]:
    """Returns where rays meet triangles (F, 3, 3): number of the triangle, pixel, depth, and whether its front is met."""
    which = np.flatnonzero(corners[:, :, 2].max(axis=1) > _NEAR)
    first, sizes = _boxes(corners[which])
    counts = sizes.prod(axis=1)
    which, first, sizes, counts = which[counts > 0], first[counts > 0], sizes[counts > 0], counts[counts > 0]
    a, b, c = (corners[which, k] for k in range(3))
    # The ray through a pixel passes a triangle on the inner side of the three planes through the eye and its edges. A common edge of two
    # triangles gives the same numbers with opposite signs, so no ray slips through between them.
    edges = [np.ascontiguousarray(np.cross(*ends).T) for ends in ((b, c), (c, a), (a, b))]
    normals = np.cross(b - a, c - a)
    offsets = np.einsum("nk,nk->n", normals, a)
    rays, out = _rays(), []
    for k, number in numbered_pairs(counts, _PAIRS_AT_ONCE):
        pixel = (first[k, 1] + number // sizes[k, 0]) * WIDTH + first[k, 0] + number % sizes[k, 0]
        x, y = rays[pixel].T
        sides = [edge[0, k] * x + edge[1, k] * y + edge[2, k] for edge in edges]
        inside = np.minimum(np.minimum(*sides[:2]), sides[2]) >= 0.0
        inside |= np.maximum(np.maximum(*sides[:2]), sides[2]) <= 0.0
        k, pixel, x, y = k[inside], pixel[inside], x[inside], y[inside]
        along = normals[k, 0] * x + normals[k, 1] * y + normals[k, 2]
        with np.errstate(divide="ignore", invalid="ignore"):
            at = offsets[k] / along
        met = at > _NEAR
        out.append((which[k[met]], pixel[met], at[met], np.asarray(along[met] < 0.0)))
    return out


def _boxes(corners: F64) -> tuple[I64, I64]:
    """Returns the bounding boxes of triangles (F, 3, 3) in the view: first pixel (F, 2), as column and row, and size (F, 2)."""
    z = corners[:, :, 2]
    low, high = np.full((len(corners), 2), np.inf), np.full((len(corners), 2), -np.inf)
    for k in range(3):
        a, b = corners[:, k], corners[:, (k + 1) % 3]
        with np.errstate(divide="ignore", invalid="ignore"):
            t = np.clip((_NEAR - a[:, 2]) / (b[:, 2] - a[:, 2]), 0.0, 1.0)
        crosses = (z[:, k] > _NEAR) != (z[:, (k + 1) % 3] > _NEAR)
        cut = (a + np.where(crosses, t, 0.0)[:, None] * (b - a))[:, :2] / _NEAR
        with np.errstate(divide="ignore", invalid="ignore"):
            own = a[:, :2] / a[:, 2:]
        for points, valid in ((own, z[:, k] > _NEAR), (cut, crosses)):
            low = np.where(valid[:, None], np.minimum(low, points), low)
            high = np.where(valid[:, None], np.maximum(high, points), high)
    size = np.array([WIDTH, HEIGHT])
    # Pixel of a point: its x and y run from -1 to 1 over the width.
    scale, middle = WIDTH / 2.0, size / 2.0
    first = np.clip(np.ceil(low * scale + middle - 0.5 - 1e-6), 0, size)
    last = np.clip(np.floor(high * scale + middle - 0.5 + 1e-6), -1, size - 1)
    return first.astype(np.int64), np.maximum(last - first + 1, 0).astype(np.int64)


def mesh_view_holes(
    vertices: ArrayLike, triangles: ArrayLike, T_level_mesh: Mat4, progress: Callable[[float], None] = lambda _: None
) -> ViewHoles | None:
    """Returns the share of holes in the views of a robot in a fused mesh; None = no position on the floor is free.

    Args:
        vertices: (V, 3), in any frame, metres.
        triangles: (F, 3), rows of ``vertices``.
        T_level_mesh: (4, 4), takes its frame to one with z up and the floor at z = 0.
        progress: called with the fraction that is done, 0 to 1.
    """
    faces, level = np.asarray(triangles), transform_points(T_level_mesh, vertices)
    try:
        floor = make_floor_map(level, faces, floor_z=0.0, robot_height=ROBOT_HEIGHT)
    except SceneError:
        return None
    sides = np.ones(len(faces), dtype=bool)
    return view_holes(level[faces], sides, [floor], ROBOT_RADIUS, progress=progress)
