"""Solves sparse systems for all colour channels at once."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

F64 = NDArray[np.float64]


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
