"""Preconditioned conjugate gradients for all colour channels at once, and red-black successive over-relaxation on pixel grids."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from gibson_sim.geometry.compiling import CAN_COMPILE, compiled

Bools = NDArray[np.bool_]
F32 = NDArray[np.float32]
F64 = NDArray[np.float64]
I32 = NDArray[np.int32]


def conjugate_gradients(
    A: sparse.csr_matrix, b: F64, *, start: F64 | None = None, tolerance: float = 1e-4, max_iterations: int = 400
) -> F64:
    """Returns the solution x (N, C) of A x = b, by conjugate gradients with the Jacobi preconditioner.

    Args:
        A: (N, N), symmetric positive definite.
        b: (N, C).
        start: (N, C), initial solution; None = 0.
        tolerance: largest norm of the residual of each column, relative to that of ``b``.
        max_iterations: limit of the iterations.
    """
    inverse_diagonal = (1.0 / A.diagonal())[:, None]
    x = np.zeros_like(b) if start is None else start.copy()
    residual = b - A @ x
    squared_tolerance = tolerance**2 * np.maximum(_dot(b, b), 1e-30)
    preconditioned = inverse_diagonal * residual
    residual_norm = _dot(residual, preconditioned)
    direction = preconditioned
    for _ in range(max_iterations):
        if (_dot(residual, residual) <= squared_tolerance).all():
            break
        A_direction = A @ direction
        step = residual_norm / np.maximum(_dot(direction, A_direction), 1e-300)
        x += step * direction
        residual -= step * A_direction
        preconditioned = inverse_diagonal * residual
        previous_norm, residual_norm = residual_norm, _dot(residual, preconditioned)
        direction = preconditioned + residual_norm / np.maximum(previous_norm, 1e-300) * direction
    return x


def _dot(a: F64, b: F64) -> F64:
    return np.asarray(np.einsum("nc,nc->c", a, b))


def relax_membrane(values: F32, neighbours: I32, is_red: Bools, width_px: int) -> None:
    """Solves the Laplace equation (membrane) approximately, in place, by red-black successive over-relaxation (SOR).

    The first N of M values are unknowns; the others are Dirichlet boundary values.

    Args:
        values: (M, C), initial values; changed.
        neighbours: (N, 4), rows of ``values`` of the four neighbouring pixels, -1 = none.
        is_red: (N,), mask of the red pixels of the checkerboard.
        width_px: approximate distance between boundaries, pixels; sets relaxation factor and number of iterations.
    """
    # Optimal factor of a strip of this width: https://en.wikipedia.org/wiki/Successive_over-relaxation#Convergence_Rate
    relaxation = np.float32(2.0 / (1.0 + np.sin(np.pi / (width_px + 1))))
    degree = np.maximum((neighbours >= 0).sum(axis=1), 1).astype(np.float32)
    for _ in range(width_px + 4):
        for pixels in (np.flatnonzero(is_red), np.flatnonzero(~is_red)):
            if CAN_COMPILE:
                _sor_sweep(values, neighbours, pixels, degree, relaxation)
                continue
            neighbour_sum = np.zeros((len(pixels), values.shape[1]), dtype=np.float32)
            for k in range(4):
                neighbour = neighbours[pixels, k]
                neighbour_sum += np.where(neighbour[:, None] >= 0, values[neighbour], np.float32(0.0))
            values[pixels] += relaxation * (neighbour_sum / degree[pixels, None] - values[pixels])


@compiled
def _sor_sweep(values: F32, neighbours: I32, pixels: NDArray[np.int64], degree: F32, relaxation: np.float32) -> None:
    """Updates the pixels of one colour of the checkerboard, in place; no two of them are neighbours."""
    for row in range(len(pixels)):
        pixel = pixels[row]
        for c in range(values.shape[1]):
            neighbour_sum = np.float32(0.0)
            for k in range(4):
                neighbour = neighbours[pixel, k]
                if neighbour >= 0:
                    neighbour_sum += values[neighbour, c]
            values[pixel, c] += relaxation * (neighbour_sum / degree[pixel] - values[pixel, c])
