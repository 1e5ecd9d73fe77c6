"""Finds faults of one mesh: open edges, inverted, non-manifold and degenerate triangles. A million triangles take seconds."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from trimesh.geometry import faces_to_edges
from trimesh.graph import connected_component_labels
from trimesh.grouping import group_rows, unique_rows

from gibson_sim.geometry.triangle_meshes import areas_of

F64 = NDArray[np.float64]
I64 = NDArray[np.int64]
Bools = NDArray[np.bool_]
_WELD_TOLERANCE = 1e-5
"""Distance within which vertices are merged, as a fraction of the mesh's longest side."""
_DEGENERATE_RATIO = 1e-12
"""Ratio of a triangle's area to the square of its longest edge, at and below which it is degenerate."""
_ROOM_SIZE = 0.7
"""Size of a closed surface, as a fraction of the mesh, above which it is a room, seen from inside."""
_MIN_CLOSED_FACES = 4
"""Minimum number of faces of a closed surface."""


@dataclass(frozen=True, slots=True, eq=False)
class MeshFaults:
    """Faults of one mesh; faces are rows of its triangles."""

    degenerate: Bools
    """Whether each face has no area, (F,)."""
    open_edges: int
    """Number of boundary edges, which belong to one face."""
    open_length: float
    """Total length of the boundary edges, m."""
    holes: tuple[float, ...]
    """Length of each connected boundary, m, the longest first."""
    non_manifold_edges: int
    """Number of non-manifold edges, which belong to more than two faces."""
    inconsistent_edges: int
    """Number of edges whose two faces have opposite winding."""
    inverted: Bools
    """Whether each face has a winding opposite to most of its connected component, or is part of a closed surface inside out, (F,)."""
    largest_piece: float
    """Fraction of the faces in the largest connected component: large for a scan, small for a modelled scene."""


def weld(vertices: F64) -> I64:
    """Returns an index for each vertex, (V,); vertices at the same position have the same index."""
    if not len(vertices):
        return np.zeros(0, dtype=np.int64)
    size = max(float(np.ptp(vertices, axis=0).max()), 1e-9)
    cells = np.rint((vertices - vertices.min(axis=0)) / (size * _WELD_TOLERANCE)).astype(np.int64)
    numbers: I64 = unique_rows(cells)[1].reshape(-1)
    return numbers


def find_faults(vertices: F64, triangles: NDArray[np.integer]) -> MeshFaults:
    """Finds the faults of a mesh.

    Args:
        vertices: (V, 3), metres.
        triangles: (F, 3).
    """
    numbers = weld(vertices)
    corners = numbers[triangles.astype(np.int64)]
    degenerate = _degenerate(vertices, triangles, corners)
    faces = np.flatnonzero(~degenerate)
    directed_edges, owner = faces_to_edges(corners[faces], return_index=True)
    edges = np.sort(directed_edges, axis=1)
    first, inverse = unique_rows(edges)
    counts, ends = np.bincount(inverse.reshape(-1)), edges[first]
    positions = np.zeros((int(numbers.max(initial=-1)) + 1, 3))
    positions[numbers] = vertices
    lengths = np.linalg.norm(positions[ends[:, 0]] - positions[ends[:, 1]], axis=1)
    is_open = counts == 1
    shared = group_rows(edges, require_count=2)
    pairs = owner[shared]
    # Two faces with consistent winding traverse their common edge in opposite directions.
    same_direction = directed_edges[shared[:, 0], 0] == directed_edges[shared[:, 1], 0]
    component = connected_component_labels(pairs, len(faces))
    inverted = np.zeros(len(triangles), dtype=bool)
    inverted[faces] = _inverted(positions[corners[faces]], pairs, same_direction, component)
    return MeshFaults(
        degenerate=degenerate,
        open_edges=int(is_open.sum()),
        open_length=float(lengths[is_open].sum()),
        holes=_boundaries(ends[is_open], lengths[is_open]),
        non_manifold_edges=int((counts > 2).sum()),
        inconsistent_edges=int(same_direction.sum()),
        inverted=inverted,
        largest_piece=float(np.bincount(component).max() / len(component)) if len(component) else 0.0,
    )


def _degenerate(vertices: F64, triangles: NDArray[np.integer], corners: I64) -> Bools:
    has_repeated_corner = (corners[:, 0] == corners[:, 1]) | (corners[:, 1] == corners[:, 2]) | (corners[:, 2] == corners[:, 0])
    points = vertices[triangles]
    longest_edge = np.linalg.norm(points - np.roll(points, 1, axis=1), axis=2).max(axis=1, initial=0.0)
    return np.asarray(has_repeated_corner | (areas_of(points) <= _DEGENERATE_RATIO * longest_edge**2))


def _boundaries(ends: I64, lengths: F64) -> tuple[float, ...]:
    """Returns the total length of each connected set of edges (E, 2), the longest first."""
    if not len(ends):
        return ()
    label = connected_component_labels(ends)[ends[:, 0]]
    sums = np.bincount(np.unique(label, return_inverse=True)[1], weights=lengths)
    return tuple(sorted(sums.tolist(), reverse=True))


def _inverted(points: F64, pairs: I64, same_direction: Bools, component: I64) -> Bools:
    """Returns the faces, (F,), to be flipped so that neighbours have consistent winding and closed surfaces face outward.

    Args:
        points: (F, 3, 3), metres.
        pairs: pairs of faces that share an edge, (P, 2).
        same_direction: whether both traverse that edge in the same direction, (P,).
        component: connected component of each face, (F,).
    """
    count = len(points)
    if not count:
        return np.zeros(0, dtype=bool)
    # A graph of 2 F nodes: each face as it is, and flipped. Edges join consistent nodes, so each component splits into two consistent halves.
    a, b = pairs[:, 0], pairs[:, 1]
    nodes_a = np.concatenate([a, a + count])
    nodes_b = np.concatenate([np.where(same_direction, b + count, b), np.where(same_direction, b, b + count)])
    label = connected_component_labels(np.stack([nodes_a, nodes_b], axis=1), 2 * count)
    areas = areas_of(points)
    # A face belongs to the half that contains its component's first face, or to the other half.
    first_face = np.full(int(component.max()) + 1, count)
    np.minimum.at(first_face, component, np.arange(count))
    is_off = label[:count] != label[first_face][component]
    # One-sided surfaces (Moebius strips) do not split into halves: no winding is consistent, so they stay as they are.
    one_sided = label[:count] == label[count:]
    is_off &= ~one_sided
    off_area, total_area = (np.bincount(component, weights=w) for w in (areas * is_off, areas))
    flip = np.where(off_area[component] > total_area[component] / 2, ~is_off & ~one_sided, is_off)
    return np.asarray(flip ^ _inside_out(points, flip, component, pairs))


def _inside_out(points: F64, flip: Bools, component: I64, pairs: I64) -> Bools:
    """Returns whether each face belongs to a closed component of negative volume that is not a room, (F,)."""
    number = int(component.max()) + 1
    sizes = np.bincount(component, minlength=number)
    closed = (np.bincount(component[pairs[:, 0]], minlength=number) * 2 == 3 * sizes) & (sizes >= _MIN_CLOSED_FACES)
    middle = points.reshape(-1, 3).mean(axis=0)
    p = points - middle
    volumes = np.einsum("fk,fk->f", p[:, 0], np.cross(p[:, 1], p[:, 2])) / 6.0
    volume = np.bincount(component, weights=np.where(flip, -volumes, volumes), minlength=number)
    low, high = np.full((number, 3), np.inf), np.full((number, 3), -np.inf)
    np.minimum.at(low, component, points.min(axis=1))
    np.maximum.at(high, component, points.max(axis=1))
    mesh_size = max(float(np.linalg.norm(np.ptp(points.reshape(-1, 3), axis=0))), 1e-9)
    is_small = np.linalg.norm(high - low, axis=1) < _ROOM_SIZE * mesh_size
    return np.asarray((closed & is_small & (volume < 0.0))[component])
