"""Finds what is wrong with the triangles of one mesh: open, inverted, non-manifold, degenerate. A million triangles take seconds."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from trimesh.geometry import faces_to_edges
from trimesh.graph import connected_component_labels
from trimesh.grouping import group_rows, unique_rows

from gibson_sim.geometry.triangles import areas_of

F64 = NDArray[np.float64]
I64 = NDArray[np.int64]
Bools = NDArray[np.bool_]
_WELD = 1e-5
"""Vertices closer than this fraction of the mesh's longest side are one vertex."""
_THIN = 1e-12
"""Area of a triangle over the square of its longest edge, at and below which it is degenerate."""
_ROOM = 0.7
"""A closed surface larger than this fraction of the mesh is a room, which is seen from inside."""
_CLOSED_FACES = 4
"""Least number of faces of a closed surface."""


@dataclass(frozen=True, slots=True, eq=False)
class MeshFaults:
    """Faults of one mesh; faces are rows of its triangles."""

    degenerate: Bools
    """(F,): without area."""
    open_edges: int
    """Boundary edges, which belong to one face."""
    open_length: float
    """Metres."""
    holes: tuple[float, ...]
    """Length of each connected boundary, metres, the longest first."""
    crowded_edges: int
    """Non-manifold edges, which belong to more than two faces."""
    wrong_edges: int
    """Edges whose two faces have opposite winding."""
    inverted: Bools
    """(F,): faces whose winding is opposite to most of their connected component, and closed surfaces that are inside out."""
    largest_piece: float
    """Fraction of the faces in the largest connected component: most of a scan, and little of a modelled scene."""


def weld(vertices: F64) -> I64:
    """Returns a number for each vertex, (V,): the same number for all vertices at one place."""
    if not len(vertices):
        return np.zeros(0, dtype=np.int64)
    size = max(float(np.ptp(vertices, axis=0).max()), 1e-9)
    cells = np.rint((vertices - vertices.min(axis=0)) / (size * _WELD)).astype(np.int64)
    numbers: I64 = unique_rows(cells)[1].reshape(-1)
    return numbers


def find_faults(vertices: F64, triangles: NDArray[np.integer]) -> MeshFaults:
    """Returns what is wrong with a mesh.

    Args:
        vertices: (V, 3), metres.
        triangles: (F, 3).
    """
    numbers = weld(vertices)
    corners = numbers[triangles.astype(np.int64)]
    degenerate = _degenerate(vertices, triangles, corners)
    faces = np.flatnonzero(~degenerate)
    sides, owner = faces_to_edges(corners[faces], return_index=True)
    edges = np.sort(sides, axis=1)
    first, inverse = unique_rows(edges)
    counts, ends = np.bincount(inverse.reshape(-1)), edges[first]
    positions = np.zeros((int(numbers.max(initial=-1)) + 1, 3))
    positions[numbers] = vertices
    lengths = np.linalg.norm(positions[ends[:, 0]] - positions[ends[:, 1]], axis=1)
    open_ = counts == 1
    shared = group_rows(edges, require_count=2)
    pairs = owner[shared]
    # Two faces of equal winding go along their common edge in opposite directions.
    alike = sides[shared[:, 0], 0] == sides[shared[:, 1], 0]
    pieces = connected_component_labels(pairs, len(faces))
    inverted = np.zeros(len(triangles), dtype=bool)
    inverted[faces] = _inverted(positions[corners[faces]], pairs, alike, pieces)
    return MeshFaults(
        degenerate=degenerate,
        open_edges=int(open_.sum()),
        open_length=float(lengths[open_].sum()),
        holes=_boundaries(ends[open_], lengths[open_]),
        crowded_edges=int((counts > 2).sum()),
        wrong_edges=int(alike.sum()),
        inverted=inverted,
        largest_piece=float(np.bincount(pieces).max() / len(pieces)) if len(pieces) else 0.0,
    )


def _degenerate(vertices: F64, triangles: NDArray[np.integer], corners: I64) -> Bools:
    same = (corners[:, 0] == corners[:, 1]) | (corners[:, 1] == corners[:, 2]) | (corners[:, 2] == corners[:, 0])
    points = vertices[triangles]
    longest = np.linalg.norm(points - np.roll(points, 1, axis=1), axis=2).max(axis=1, initial=0.0)
    return np.asarray(same | (areas_of(points) <= _THIN * longest**2))


def _boundaries(ends: I64, lengths: F64) -> tuple[float, ...]:
    """Returns the total length of each connected set of edges (E, 2), the longest first."""
    if not len(ends):
        return ()
    label = connected_component_labels(ends)[ends[:, 0]]
    sums = np.bincount(np.unique(label, return_inverse=True)[1], weights=lengths)
    return tuple(sorted(sums.tolist(), reverse=True))


def _inverted(points: F64, pairs: I64, alike: Bools, pieces: I64) -> Bools:
    """Returns the faces (F,) to be turned round, so that neighbours have equal winding and closed surfaces face outward.

    Args:
        points: (F, 3, 3), metres.
        pairs: (P, 2), faces that share an edge.
        alike: (P,): both go along it in the same direction.
        pieces: (F,), connected component of each face.
    """
    count = len(points)
    if not count:
        return np.zeros(0, dtype=bool)
    # A graph of 2 F nodes: each face as it is, and turned round. Edges join what agrees, so each component splits into two consistent halves.
    a, b = pairs[:, 0], pairs[:, 1]
    one = np.concatenate([a, a + count])
    other = np.concatenate([np.where(alike, b + count, b), np.where(alike, b, b + count)])
    label = connected_component_labels(np.stack([one, other], axis=1), 2 * count)
    areas = areas_of(points)
    # A face belongs to the half of its component's first face, or to the other one.
    lead = np.full(int(pieces.max()) + 1, count)
    np.minimum.at(lead, pieces, np.arange(count))
    off = label[:count] != label[lead][pieces]
    # One-sided surfaces (Moebius strips) have no two halves: any winding is wrong somewhere, so they stay.
    one_sided = label[:count] == label[count:]
    off &= ~one_sided
    wrong, total = (np.bincount(pieces, weights=w) for w in (areas * off, areas))
    flip = np.where(wrong[pieces] > total[pieces] / 2, ~off & ~one_sided, off)
    return np.asarray(flip ^ _inside_out(points, flip, pieces, pairs))


def _inside_out(points: F64, flip: Bools, pieces: I64, pairs: I64) -> Bools:
    """Returns (F,): whether a face belongs to a closed component of negative volume that is no room."""
    number = int(pieces.max()) + 1
    sizes = np.bincount(pieces, minlength=number)
    closed = (np.bincount(pieces[pairs[:, 0]], minlength=number) * 2 == 3 * sizes) & (sizes >= _CLOSED_FACES)
    middle = points.reshape(-1, 3).mean(axis=0)
    p = points - middle
    volumes = np.einsum("fk,fk->f", p[:, 0], np.cross(p[:, 1], p[:, 2])) / 6.0
    volume = np.bincount(pieces, weights=np.where(flip, -volumes, volumes), minlength=number)
    low, high = np.full((number, 3), np.inf), np.full((number, 3), -np.inf)
    np.minimum.at(low, pieces, points.min(axis=1))
    np.maximum.at(high, pieces, points.max(axis=1))
    whole = max(float(np.linalg.norm(np.ptp(points.reshape(-1, 3), axis=0))), 1e-9)
    small = np.linalg.norm(high - low, axis=1) < _ROOM * whole
    return np.asarray((closed & small & (volume < 0.0))[pieces])
