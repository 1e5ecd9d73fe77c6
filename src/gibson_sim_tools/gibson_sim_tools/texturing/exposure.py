"""Photometric calibration: gain of each photograph and channel (exposure, white balance), and vignetting, from triangles with several views.

Model in linear light: ``log light = log surface + gain[photograph, channel] + vignette . (r^2, r^4)``. The unknown surface colours are eliminated
(Schur complement); gains and vignetting solve iteratively reweighted least squares with Cauchy weights, because some views are outliers.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from gibson_sim.geometry.colours import srgb_from_linear
from gibson_sim_tools.texturing.quality import LINEAR_FROM_SRGB8, Views

F32 = NDArray[np.float32]
F64 = NDArray[np.float64]
I64 = NDArray[np.int64]
U8 = NDArray[np.uint8]

_MAX_VIEWS = 150_000
"""Approximate largest number of views in the system."""
_MIN_LIGHT, _MAX_LIGHT = 0.004, 0.93
"""Range of usable linear light, 0 to 1: noise below, clipping above."""
_CAUCHY_SCALE = 0.08
"""Residual with Cauchy weight 1/2, natural logarithm of light."""
_ITERATIONS = 12
"""Iterations of the reweighted least squares."""
_REGULARISATION = 3.0
"""Weight of the gains themselves, in views: photographs that share few triangles keep their exposure."""
_VIGNETTE_TERMS = 2
"""Number of even powers of the radius in the vignetting model."""
_MAX_LOG_GAIN = 3.0
"""Largest absolute log gain."""


@dataclass(frozen=True, slots=True, eq=False)
class Exposures:
    """Photometric calibration of P photographs."""

    gains: F64
    """(P, 3), log gain of each photograph and RGB channel, natural logarithm, mean 0."""
    vignette: F64
    """(2, 3), vignetting: log light at radius r = vignette[0] r^2 + vignette[1] r^4."""

    def factors(self, photograph: NDArray[np.integer], radius: F32) -> F32:
        """Returns the factors (N, 3) that bring the linear light of N views to the mean exposure.

        Args:
            photograph: (N,), photograph of each view.
            radius: (N,), normalised radius of each view; 1 = corner of the image.
        """
        r2 = radius.astype(np.float64)[:, None] ** 2
        return np.asarray(np.exp(-(self.gains[photograph] + r2 * self.vignette[0] + r2**2 * self.vignette[1])), dtype=np.float32)

    def corrected(self, number: int, rgb: U8, radius: F32) -> F32:
        """Returns a photograph at the mean exposure and without vignetting, (H, W, 3) float32, sRGB, 0 to 1.

        Args:
            number: number of the photograph.
            rgb: (H, W, 3) uint8, sRGB.
            radius: (H, W), normalised radius of the pixels; 1 = corner of the image.
        """
        r2 = radius[..., None] ** 2
        factor = np.exp(-(self.gains[number] + r2 * self.vignette[0] + r2 * r2 * self.vignette[1])).astype(np.float32)
        return np.asarray(srgb_from_linear(LINEAR_FROM_SRGB8[rgb] * factor), dtype=np.float32)


def identity_exposures(count: int) -> Exposures:
    """Returns the calibration of ``count`` photographs that changes nothing."""
    return Exposures(np.zeros((count, 3)), np.zeros((_VIGNETTE_TERMS, 3)))


def estimate_exposures(views: Views, count: int, rng: np.random.Generator) -> Exposures:
    """Returns the photometric calibration of ``count`` photographs; those that share no triangle with others get log gain 0.

    Args:
        views: all views.
        count: number of photographs.
        rng: draws a subset of the triangles if there are too many views.
    """
    used = _select_views(views, rng)
    gains, vignette = np.zeros((count, 3)), np.zeros((_VIGNETTE_TERMS, 3))
    if not len(used):
        return Exposures(gains, vignette)
    surfaces, face = np.unique(views.face[used], return_inverse=True)
    photograph, r2 = views.photograph[used], views.radius[used].astype(np.float64) ** 2
    rows = np.arange(len(used))
    # The columns of the vignetting terms follow those of the gains.
    X = sparse.csr_matrix(
        (
            np.concatenate([np.ones(len(used)), r2, r2**2]),
            (
                np.tile(rows, 1 + _VIGNETTE_TERMS),
                np.concatenate([photograph, np.full(len(used), count), np.full(len(used), count + 1)]),
            ),
        ),
        shape=(len(used), count + _VIGNETTE_TERMS),
    )
    S = sparse.csr_matrix((np.ones(len(used)), (face, rows)), shape=(len(surfaces), len(used)))
    for channel in range(3):
        solution = _robust_least_squares(X, S, np.log(views.linear_rgb[used, channel].astype(np.float64)))
        gains[:, channel], vignette[:, channel] = solution[:count], solution[count:]
    present = np.bincount(photograph, minlength=count) > 0
    gains[present] -= gains[present].mean(axis=0)
    gains[~present] = 0.0
    return Exposures(np.clip(gains, -_MAX_LOG_GAIN, _MAX_LOG_GAIN), vignette)


def _select_views(views: Views, rng: np.random.Generator) -> I64:
    """Returns the rows of the well-exposed views of triangles with at least two of them."""
    is_well_exposed = ((views.linear_rgb > _MIN_LIGHT) & (views.linear_rgb < _MAX_LIGHT)).all(axis=1)
    if not is_well_exposed.any():
        return np.zeros(0, dtype=np.int64)
    counts = np.bincount(views.face[is_well_exposed], minlength=int(views.face.max()) + 1)
    shared = np.flatnonzero(counts >= 2)
    if int(counts[shared].sum()) > _MAX_VIEWS:
        shared = rng.permutation(shared)
        shared = shared[np.cumsum(counts[shared]) <= _MAX_VIEWS]
    is_selected = np.zeros(len(counts), dtype=bool)
    is_selected[shared] = True
    return np.flatnonzero(is_well_exposed & is_selected[views.face])


def _robust_least_squares(X: sparse.csr_matrix, S: sparse.csr_matrix, log_light: F64) -> F64:
    """Returns gains and vignetting (K,) of one channel by iteratively reweighted least squares with Cauchy weights.

    Args:
        X: (N, K), design matrix of gains and vignetting.
        S: (F, N), sums the N views of each of F triangles; eliminates the surface colours.
        log_light: (N,), natural logarithm of the linear light of each view.
    """
    weights = np.ones(len(log_light))
    unknowns = np.zeros(X.shape[1])
    regularisation = _REGULARISATION * sparse.identity(X.shape[1])
    for _ in range(_ITERATIONS):
        W = sparse.diags(weights)
        weight_sums = np.asarray(S @ weights).ravel()
        inverse_sums = sparse.diags(1.0 / weight_sums)
        SWX = S @ W @ X
        normal = (X.T @ W @ X - SWX.T @ inverse_sums @ SWX + regularisation).toarray()
        rhs = X.T @ (weights * log_light) - SWX.T @ (inverse_sums @ (S @ (weights * log_light)))
        unknowns = np.linalg.solve(normal, rhs)
        residuals = log_light - X @ unknowns
        log_surface = (S @ (weights * residuals)) / weight_sums
        residuals = residuals - S.T @ log_surface
        weights = 1.0 / (1.0 + (residuals / _CAUCHY_SCALE) ** 2)
    return np.asarray(unknowns)
