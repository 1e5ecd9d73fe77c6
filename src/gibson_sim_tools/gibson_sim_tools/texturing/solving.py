"""Solves sparse systems for all colour channels at once, and membranes over pixels."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from gibson_sim.geometry.compiling import CAN_COMPILE, compiled

Bools = NDArray[np.bool_]
F32 = NDArray[np.float32]
F64 = NDArray[np.float64]
I32 = NDArray[np.int32]


def solve(matrix: sparse.csr_matrix, right: F64, *, start: F64 | None = None, tolerance: float = 1e-4, most: int = 400) -> F64:
    """Returns the solution (N, C) of a symmetric positive definite system, by conjugate gradients with the diagonal as preconditioner.

    Args:
        matrix: (N, N).
        right: (N, C).
        start: (N, C), where to begin; None = 0.
        tolerance: of the residual, relative to ``right``.
        most: iterations.
    """
    scale = (1.0 / matrix.diagonal())[:, None]
    x = np.zeros_like(right) if start is None else start.copy()
    rest = right - matrix @ x
    target = tolerance**2 * np.maximum(_dot(right, right), 1e-30)
    step = scale * rest
    now = _dot(rest, step)
    direction = step
    for _ in range(most):
        if (_dot(rest, rest) <= target).all():
            break
        ahead = matrix @ direction
        length = now / np.maximum(_dot(direction, ahead), 1e-300)
        x += length * direction
        rest -= length * ahead
        step = scale * rest
        before, now = now, _dot(rest, step)
        direction = step + now / np.maximum(before, 1e-300) * direction
    return x


def _dot(a: F64, b: F64) -> F64:
    return np.asarray(np.einsum("nc,nc->c", a, b))


def relax(values: F32, neighbours: I32, red: Bools, width_px: int) -> None:
    """Makes the first N of M values (M, C) a membrane: each is about the mean of its neighbours; the others stay.

    Successive over-relaxation, red pixels first, then black ones, as on a chess board.

    Args:
        values: what to begin with; changed.
        neighbours: (N, 4), numbers of values, -1 = none.
        red: (N,), whether a pixel is a red one.
        width_px: distance between values that stay, about: how far values have to travel.
    """
    # Of a strip between two sides: https://en.wikipedia.org/wiki/Successive_over-relaxation#Convergence_Rate
    over = np.float32(2.0 / (1.0 + np.sin(np.pi / (width_px + 1))))
    number = np.maximum((neighbours >= 0).sum(axis=1), 1).astype(np.float32)
    for _ in range(width_px + 4):
        for color in (np.flatnonzero(red), np.flatnonzero(~red)):
            if CAN_COMPILE:
                _sweep(values, neighbours, color, number, over)
                continue
            total = np.zeros((len(color), values.shape[1]), dtype=np.float32)
            for k in range(4):
                other = neighbours[color, k]
                total += np.where(other[:, None] >= 0, values[other], np.float32(0.0))
            values[color] += over * (total / number[color, None] - values[color])


@compiled
def _sweep(values: F32, neighbours: I32, color: NDArray[np.int64], number: F32, over: np.float32) -> None:
    """Does ``relax`` for the pixels of one colour, none of which are neighbours of each other."""
    for row in range(len(color)):
        pixel = color[row]
        for c in range(values.shape[1]):
            total = np.float32(0.0)
            for k in range(4):
                other = neighbours[pixel, k]
                if other >= 0:
                    total += values[other, c]
            values[pixel, c] += over * (total / number[pixel] - values[pixel, c])
