"""Exposure and white balance of each photograph, and the vignette of its lens, from triangles that several photographs show.

In linear light, a photograph shows a surface brighter by a factor for each channel, and darker towards its corners:
``log light = log surface + gain[photograph, channel] + vignette . (r^2, r^4)``. The surface is eliminated; gains and vignette solve weighted
least squares, whose weights fall with the residual (Cauchy), since some views show something else.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from gibson_sim.geometry.colours import srgb_from_linear
from gibson_sim_tools.texturing.quality import LINEAR, Views

F32 = NDArray[np.float32]
F64 = NDArray[np.float64]
I64 = NDArray[np.int64]
U8 = NDArray[np.uint8]

_MOST_VIEWS = 150_000
"""Most views that are used, about."""
_DARKEST, _BRIGHTEST = 0.004, 0.93
"""Range of linear light that is used: noise below, clipping above."""
_SCALE = 0.08
"""Residual at which a view counts half, natural logarithm."""
_ROUNDS = 12
_PULL = 3.0
"""Weight of the gains themselves, views: photographs with little in common with others stay as they are."""
_TERMS = 2
"""Terms of the vignette."""
_MOST = 3.0
"""Largest logarithm of a gain."""


@dataclass(frozen=True, slots=True, eq=False)
class Exposures:
    """What to divide the light of photographs by."""

    gains: F64
    """(P, 3), natural logarithm, mean 0."""
    vignette: F64
    """(2, 3): logarithm of the light at radius r = vignette[0] r^2 + vignette[1] r^4."""

    def factors(self, photograph: NDArray[np.integer], radius: F32) -> F32:
        """Returns what the light of views is to be multiplied by, (N, 3)."""
        r2 = radius.astype(np.float64)[:, None] ** 2
        return np.asarray(np.exp(-(self.gains[photograph] + r2 * self.vignette[0] + r2**2 * self.vignette[1])), dtype=np.float32)

    def corrected(self, number: int, rgb: U8, radius: F32) -> F32:
        """Returns a photograph (H, W, 3) as the mean camera would have made it, sRGB, 0 to 1, float32.

        Args:
            number: of the photograph.
            rgb: its pixels, 8-bit sRGB.
            radius: (H, W), distance of the pixels from its middle; 1 = its corner.
        """
        r2 = radius[..., None] ** 2
        factor = np.exp(-(self.gains[number] + r2 * self.vignette[0] + r2 * r2 * self.vignette[1])).astype(np.float32)
        return np.asarray(srgb_from_linear(LINEAR[rgb] * factor), dtype=np.float32)


def no_exposures(count: int) -> Exposures:
    """Returns the exposures of photographs that are to stay as they are."""
    return Exposures(np.zeros((count, 3)), np.zeros((_TERMS, 3)))


def estimate_exposures(views: Views, count: int, rng: np.random.Generator) -> Exposures:
    """Returns the exposures of ``count`` photographs; those without views in common with others get gain 0.

    Args:
        views: all views.
        count: number of photographs.
        rng: chooses triangles if there are many.
    """
    used = _chosen(views, rng)
    gains, vignette = np.zeros((count, 3)), np.zeros((_TERMS, 3))
    if not len(used):
        return Exposures(gains, vignette)
    surface, face = np.unique(views.face[used], return_inverse=True)
    photograph, r2 = views.photograph[used], views.radius[used].astype(np.float64) ** 2
    rows = np.arange(len(used))
    # The terms of the vignette are columns behind those of the gains.
    X = sparse.csr_matrix(
        (
            np.concatenate([np.ones(len(used)), r2, r2**2]),
            (np.tile(rows, 1 + _TERMS), np.concatenate([photograph, np.full(len(used), count), np.full(len(used), count + 1)])),
        ),
        shape=(len(used), count + _TERMS),
    )
    S = sparse.csr_matrix((np.ones(len(used)), (face, rows)), shape=(len(surface), len(used)))
    for channel in range(3):
        solved = _solved(X, S, np.log(views.light[used, channel].astype(np.float64)))
        gains[:, channel], vignette[:, channel] = solved[:count], solved[count:]
    present = np.bincount(photograph, minlength=count) > 0
    gains[present] -= gains[present].mean(axis=0)
    gains[~present] = 0.0
    return Exposures(np.clip(gains, -_MOST, _MOST), vignette)


def _chosen(views: Views, rng: np.random.Generator) -> I64:
    """Returns the rows of views that are neither dark nor clipped, of triangles that at least two such views show."""
    good = ((views.light > _DARKEST) & (views.light < _BRIGHTEST)).all(axis=1)
    if not good.any():
        return np.zeros(0, dtype=np.int64)
    counts = np.bincount(views.face[good], minlength=int(views.face.max()) + 1)
    shared = np.flatnonzero(counts >= 2)
    if int(counts[shared].sum()) > _MOST_VIEWS:
        shared = rng.permutation(shared)
        shared = shared[np.cumsum(counts[shared]) <= _MOST_VIEWS]
    taken = np.zeros(len(counts), dtype=bool)
    taken[shared] = True
    return np.flatnonzero(good & taken[views.face])


def _solved(X: sparse.csr_matrix, S: sparse.csr_matrix, log_light: F64) -> F64:
    """Returns gains and vignette (K,) that explain the light best, by weights that are computed anew in each round."""
    weights = np.ones(len(log_light))
    unknowns = np.zeros(X.shape[1])
    pull = _PULL * sparse.identity(X.shape[1])
    for _ in range(_ROUNDS):
        W = sparse.diags(weights)
        total = np.asarray(S @ weights).ravel()
        inverse = sparse.diags(1.0 / total)
        SWX = S @ W @ X
        normal = (X.T @ W @ X - SWX.T @ inverse @ SWX + pull).toarray()
        right = X.T @ (weights * log_light) - SWX.T @ (inverse @ (S @ (weights * log_light)))
        unknowns = np.linalg.solve(normal, right)
        rest = log_light - X @ unknowns
        surface = (S @ (weights * rest)) / total
        rest = rest - S.T @ surface
        weights = 1.0 / (1.0 + (rest / _SCALE) ** 2)
    return np.asarray(unknowns)
