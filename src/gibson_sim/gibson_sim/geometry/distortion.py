"""Lens distortion of ROS's camera_info and OpenCV, and its inverse: plumb_bob, rational_polynomial, equidistant.

A distortion polynomial is valid up to the radius at which it stops increasing. Beyond it, two directions would map to the same pixel; all
results are NaN there.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
_STEPS = 100
"""Maximum number of iterations of a search that at worst bisects: more than the bits of a double."""


def distort(points: Array, d: Sequence[float]) -> tuple[Array, Array]:
    """Distorts points of the plane z = 1.

    Args:
        points: (..., 2), x / z and y / z.
        d: 4 or 5 coefficients of plumb_bob (k1, k2, p1, p2, k3) or 8 of rational_polynomial (also k4, k5, k6).

    Returns:
        The distorted points, (..., 2), and their Jacobians, (..., 2, 2); NaN beyond the valid radius of ``d``.
    """
    x, y = points[..., 0], points[..., 1]
    p1, p2 = d[2:4]
    q = x * x + y * y
    with np.errstate(invalid="ignore", over="ignore", divide="ignore"):
        radial, slope = _radial(q, d)
        out = np.stack(
            [x * radial + 2 * p1 * x * y + p2 * (q + 2 * x * x), y * radial + p1 * (q + 2 * y * y) + 2 * p2 * x * y], axis=-1
        )
        mixed = 2 * slope * x * y + 2 * p1 * x + 2 * p2 * y
        jacobian = np.stack(
            [
                np.stack([radial + 2 * slope * x * x + 2 * p1 * y + 6 * p2 * x, mixed], axis=-1),
                np.stack([mixed, radial + 2 * slope * y * y + 6 * p1 * y + 2 * p2 * x], axis=-1),
            ],
            axis=-2,
        )
        determinant = jacobian[..., 0, 0] * jacobian[..., 1, 1] - jacobian[..., 0, 1] * jacobian[..., 1, 0]
        invalid = ~((q < valid_radius_squared(tuple(d))) & (determinant > 0.0))
    out[invalid], jacobian[invalid] = np.nan, np.nan
    return out, jacobian


def undistort(points: Array, d: Sequence[float]) -> Array:
    """Returns the points of the plane z = 1, (..., 2), that ``distort`` maps to ``points`` (..., 2); NaN if none exists."""
    radius = np.hypot(points[..., 0], points[..., 1])
    limit = float(np.sqrt(valid_radius_squared(tuple(d))))

    def radial(r: Array) -> tuple[Array, Array]:
        factor, slope = _radial(r * r, d)
        return r * factor, factor + 2 * slope * r * r

    undistorted_radius = _inverse(radial, radius, limit)
    with np.errstate(invalid="ignore", divide="ignore"):
        start = points * np.where(radius > 0, undistorted_radius / radius, 1.0)[..., None]
    if not (d[2] or d[3]):
        return start
    # Tangential terms are small: Newton's method starts from the radial solution. Iterations that leave the valid radius become NaN.
    out = np.where(np.isfinite(start), start, points).reshape(-1, 2)
    targets = points.reshape(-1, 2)
    error = np.full(len(out), np.inf)
    active = np.arange(len(out))
    tolerance = 1e-15 * (1.0 + np.abs(targets).max(axis=-1))
    for _ in range(_STEPS):
        distorted, j = distort(out[active], d)
        residual = targets[active] - distorted
        new_error, old_error = np.abs(residual).max(axis=-1), error[active]
        error[active] = new_error
        # A point has converged once it is exact to double precision; NaN compares as false and so counts as converged.
        unconverged = (new_error > tolerance[active]) & ((new_error > 100 * tolerance[active]) | (new_error < old_error))
        active, residual, j = active[unconverged], residual[unconverged], j[unconverged]
        if not len(active):
            break
        determinant = j[:, 0, 0] * j[:, 1, 1] - j[:, 0, 1] * j[:, 1, 0]
        out[active, 0] += (j[:, 1, 1] * residual[:, 0] - j[:, 0, 1] * residual[:, 1]) / determinant
        out[active, 1] += (j[:, 0, 0] * residual[:, 1] - j[:, 1, 0] * residual[:, 0]) / determinant
    out[~(error <= 100 * tolerance)] = np.nan
    return out.reshape(points.shape)


def distort_angle(theta: Array, d: Sequence[float]) -> Array:
    """Returns the distance from the principal point, in focal lengths, of rays at angle ``theta`` from the axis, radians (equidistant model)."""
    q = theta * theta
    k1, k2, k3, k4 = d or (0.0,) * 4
    out = theta * (1.0 + q * (k1 + q * (k2 + q * (k3 + q * k4))))
    return np.where(theta <= valid_angle(tuple(d)), out, np.nan)


def undistort_angle(radius: Array, d: Sequence[float]) -> Array:
    """Returns the angle from the axis, radians, that ``distort_angle`` maps to ``radius``, focal lengths; NaN if none exists."""
    limit = valid_angle(tuple(d))
    if not any(d):
        return np.where(radius <= limit, radius, np.nan)
    k1, k2, k3, k4 = d

    def polynomial(theta: Array) -> tuple[Array, Array]:
        q = theta * theta
        value = theta * (1.0 + q * (k1 + q * (k2 + q * (k3 + q * k4))))
        return value, 1.0 + q * (3 * k1 + q * (5 * k2 + q * (7 * k3 + q * 9 * k4)))

    return _inverse(polynomial, radius, limit)


def _radial(q: Array, d: Sequence[float]) -> tuple[Array, Array]:
    """Returns the radial factor of points at a squared distance ``q`` from the axis, and its derivative by ``q``."""
    k1, k2, _, _, k3, k4, k5, k6 = (*d, 0.0, 0.0, 0.0, 0.0)[:8]
    numerator = 1.0 + q * (k1 + q * (k2 + q * k3))
    denominator = 1.0 + q * (k4 + q * (k5 + q * k6))
    numerator_slope = k1 + q * (2 * k2 + q * 3 * k3)
    denominator_slope = k4 + q * (2 * k5 + q * 3 * k6)
    derivative = (numerator_slope * denominator - numerator * denominator_slope) / (denominator * denominator)
    return numerator / denominator, derivative


@lru_cache(maxsize=64)
def valid_radius_squared(d: tuple[float, ...]) -> float:
    """Returns the squared distance from the axis in the plane z = 1 up to which plumb_bob or rational_polynomial increases."""
    k1, k2, _, _, k3, k4, k5, k6 = (*d, 0.0, 0.0, 0.0, 0.0)[:8]
    numerator, denominator = np.poly1d([k3, k2, k1, 1.0]), np.poly1d([k6, k5, k4, 1.0])
    q = np.poly1d([1.0, 0.0])
    slope = (numerator + 2 * q * numerator.deriv()) * denominator - 2 * q * numerator * denominator.deriv()
    return min(_first_root(slope), _first_root(denominator))


@lru_cache(maxsize=64)
def valid_angle(d: tuple[float, ...]) -> float:
    """Returns the angle from the axis, radians, at most pi, up to which an equidistant polynomial increases."""
    if not any(d):
        return float(np.pi)
    k1, k2, k3, k4 = d
    return float(min(np.pi, np.sqrt(_first_root(np.poly1d([9 * k4, 7 * k3, 5 * k2, 3 * k1, 1.0])))))


def _first_root(polynomial: np.poly1d) -> float:
    """Returns the smallest positive root, +inf if none exists."""
    # Tiny coefficients have roots near infinity and would overflow.
    roots = np.roots(np.where(np.abs(polynomial.coeffs) < 1e-30, 0.0, polynomial.coeffs))
    real = roots.real[(np.abs(roots.imag) <= 1e-9 * np.abs(roots)) & (roots.real > 0.0)]
    return float(real.min()) if len(real) else float("inf")


def _inverse(function: Callable[[Array], tuple[Array, Array]], values: Array, limit: float) -> Array:
    """Returns the arguments at which a function has ``values`` >= 0; NaN if none exists.

    The function, which also returns its derivative, increases from 0 at 0 up to ``limit``. Uses Newton's method, with bisection where a
    step leaves the bracketing interval.
    """
    upper, targets = limit, values.ravel()
    if not np.isfinite(upper):
        upper, largest = 1.0, float(np.nanmax(targets, initial=0.0))
        while upper < 1e9 and function(np.array(upper))[0] < largest:
            upper *= 2.0
    out = np.full(targets.shape, np.nan)
    with np.errstate(invalid="ignore", divide="ignore", over="ignore"):
        # At the limit the slope is zero or the value infinite, so the search ends slightly below.
        active = np.flatnonzero(targets <= function(np.array(upper * (1.0 - 1e-12)))[0])
        targets = targets[active]
        x, low, high = np.minimum(targets, upper), np.zeros_like(targets), np.full_like(targets, upper)
        for _ in range(_STEPS):
            value, slope = function(x)
            low, high = np.where(value <= targets, x, low), np.where(value >= targets, x, high)
            new = x - (value - targets) / slope
            new = np.where((new >= low) & (new <= high), new, 0.5 * (low + high))
            out[active] = new
            moved = np.abs(new - x) > 1e-15 * (1.0 + np.abs(new))
            active = active[moved]
            targets, x, low, high = (a[moved] for a in (targets, new, low, high))
            if not len(active):
                break
    return out.reshape(values.shape)
