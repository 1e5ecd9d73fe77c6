"""What is wrong with the triangles of one mesh: open, inverted, non-manifold, degenerate. numpy throughout: a million take seconds."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import sparse
from scipy.sparse import csgraph

from gibson_sim.geometry.triangles import areas_of

F64 = NDArray[np.float64]
I64 = NDArray[np.int64]
Bools = NDArray[np.bool_]
_WELD = 1e-5
"""Vertices nearer than this part of the whole are one."""
_THIN = 1e-12
"""Area of a triangle against the square of its longest edge: less is none."""
_INSIDE = 0.7
"""A closed surface larger than this part of the whole is a room, which is seen from inside."""
_CLOSED_FACES = 4


@dataclass(frozen=True, slots=True, eq=False)
class MeshFaults:
    """Findings of one mesh; faces are rows of its triangles."""

    degenerate: Bools
    """(F,): without area."""
    open_edges: int
    """Edges of one face."""
    open_length: float
    """Metres."""
    holes: tuple[float, ...]
    """Length of each connected rim, metres, the longest first."""
    crowded_edges: int
    """Edges of more than two faces."""
    wrong_edges: int
    """Edges whose two faces go round in different ways."""
    inverted: Bools
    """(F,): faces that go round otherwise than most of what they hang together with, and closed surfaces that are inside out."""
    largest_piece: float
    """Part of the faces, 0 to 1, that hang together in the largest piece: most of a scan does, and little of what was modelled."""


def weld(vertices: F64) -> I64:
    """Returns a number for each vertex, (V,): the same for all at one place."""
    size = max(float(np.ptp(vertices, axis=0).max()), 1e-9) if len(vertices) else 1.0
    cells = (
        np.rint((vertices - vertices.min(axis=0)) / (size * _WELD)).astype(np.int64)
        if len(vertices)
        else np.zeros((0, 3), np.int64)
    )
    span = round(1.0 / _WELD) + 2
    key = (cells[:, 0] * span + cells[:, 1]) * span + cells[:, 2]
    numbers: I64 = np.unique(key, return_inverse=True)[1].reshape(-1).astype(np.int64)
    return numbers


def find_faults(vertices: F64, triangles: NDArray[np.integer]) -> MeshFaults:
    """Returns what is wrong with a mesh.

    Args:
        vertices: (V, 3), metres.
        triangles: (F, 3).
    """
    place = weld(vertices)
    corners = place[triangles.astype(np.int64)]
    degenerate = _degenerate(vertices, triangles, corners)
    faces = np.flatnonzero(~degenerate)
    edges, owner, forward = _edges(corners[faces])
    codes, inverse, counts = np.unique(edges, return_inverse=True, return_counts=True)
    inverse = inverse.reshape(-1)
    positions = np.zeros((int(place.max(initial=-1)) + 1, 3))
    positions[place] = vertices
    ends = np.stack([codes // _base(corners), codes % _base(corners)], axis=1) if len(codes) else np.zeros((0, 2), np.int64)
    lengths = np.linalg.norm(positions[ends[:, 0]] - positions[ends[:, 1]], axis=1)
    open_ = counts == 1
    pairs, alike = _pairs(inverse, counts, owner, forward)
    pieces = _pieces(len(faces), pairs)
    inverted = np.zeros(len(triangles), dtype=bool)
    inverted[faces] = _inverted(positions, corners[faces], pairs, alike, pieces)
    return MeshFaults(
        degenerate=degenerate,
        open_edges=int(open_.sum()),
        open_length=float(lengths[open_].sum()),
        holes=_rims(ends[open_], lengths[open_]),
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


def _base(corners: I64) -> int:
    return int(corners.max(initial=0)) + 1


def _edges(corners: I64) -> tuple[I64, I64, Bools]:
    """Returns code, face and direction of every side of every face, (3 F,)."""
    a, b = corners.ravel(), np.roll(corners, -1, axis=1).ravel()
    low, high = np.minimum(a, b), np.maximum(a, b)
    return low * _base(corners) + high, np.repeat(np.arange(len(corners)), 3), a < b


def _pairs(inverse: I64, counts: I64, owner: I64, forward: Bools) -> tuple[I64, Bools]:
    """Returns the faces (P, 2) that share an edge of just two, and whether both go along it in the same way, which is wrong."""
    double = counts[inverse] == 2
    rows = np.flatnonzero(double)
    sides = rows[np.argsort(inverse[rows], kind="stable")].reshape(-1, 2)
    return owner[sides], np.asarray(forward[sides[:, 0]] == forward[sides[:, 1]])


def _rims(ends: I64, lengths: F64) -> tuple[float, ...]:
    """Returns the total length of each connected set of edges (E, 2), the longest first."""
    if not len(ends):
        return ()
    used, numbers = np.unique(ends, return_inverse=True)
    numbers = numbers.reshape(-1, 2)
    graph = sparse.coo_matrix((np.ones(len(numbers)), (numbers[:, 0], numbers[:, 1])), shape=(len(used), len(used)))
    _, label = csgraph.connected_components(graph, directed=False)
    sums = np.bincount(label[numbers[:, 0]], weights=lengths)
    return tuple(sorted((float(s) for s in sums), reverse=True))


def _pieces(count: int, pairs: I64) -> I64:
    """Returns for each face, (F,), the number of what it hangs together with over edges of two faces."""
    ones = np.ones(len(pairs), dtype=np.int8)
    graph = sparse.coo_matrix((ones, (pairs[:, 0], pairs[:, 1])), shape=(count, count))
    pieces: I64 = csgraph.connected_components(graph, directed=False)[1].astype(np.int64)
    return pieces


def _inverted(positions: F64, corners: I64, pairs: I64, alike: Bools, pieces: I64) -> Bools:
    """Returns (F,): faces to be turned round so that neighbours agree, and closed things are seen from outside."""
    count = len(corners)
    if not count:
        return np.zeros(0, dtype=bool)
    # Each face as it is and turned round: what must agree is joined, so that each piece falls into two consistent halves.
    a, b = pairs[:, 0], pairs[:, 1]
    one = np.concatenate([a, a + count])
    other = np.concatenate([np.where(alike, b + count, b), np.where(alike, b, b + count)])
    graph = sparse.coo_matrix((np.ones(len(one), dtype=np.int8), (one, other)), shape=(2 * count, 2 * count))
    _, label = csgraph.connected_components(graph, directed=False)
    points = positions[corners]
    areas = areas_of(points)
    # A face belongs to the half that its piece's first face is in, or to the other one.
    lead = np.full(int(pieces.max()) + 1, count)
    np.minimum.at(lead, pieces, np.arange(count))
    off = label[:count] != label[lead][pieces]
    # One-sided surfaces have no two halves: whatever is chosen is wrong somewhere, so they stay.
    one_sided = label[:count] == label[count:]
    off &= ~one_sided
    wrong, total = (np.bincount(pieces, weights=w) for w in (areas * off, areas))
    flip = np.where(wrong[pieces] > total[pieces] / 2, ~off & ~one_sided, off)
    return np.asarray(flip ^ _inside_out(points, flip, pieces, pairs))


def _inside_out(points: F64, flip: Bools, pieces: I64, pairs: I64) -> Bools:
    """Returns (F,): whether the closed piece that a face belongs to has a negative volume; rooms may."""
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
    small = np.linalg.norm(high - low, axis=1) < _INSIDE * whole
    return np.asarray((closed & small & (volume < 0.0))[pieces])
