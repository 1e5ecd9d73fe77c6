"""Lens distortion of ROS's camera_info and OpenCV, and its inverse: plumb_bob, rational_polynomial, equidistant.

A polynomial describes its lens only up to the radius at which it stops growing. Beyond that, two directions would share a pixel, which no
lens does; all results are NaN there.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
_STEPS = 100
"""Iterations of a search that halves its interval at worst: more than the bits of a double."""


def distort(points: Array, d: Sequence[float]) -> tuple[Array, Array]:
    """Distorts points of the plane z = 1.

    Args:
        points: (..., 2), x / z and y / z.
        d: 4 or 5 numbers of plumb_bob (k1, k2, p1, p2, k3) or 8 of rational_polynomial (and k4, k5, k6).

    Returns:
        The distorted points, (..., 2), and their derivatives by x and y, (..., 2, 2); NaN beyond the valid radius of ``d``.
    """
    x, y = points[..., 0], points[..., 1]
    p1, p2 = d[2:4]
    q = x * x + y * y
    with np.errstate(invalid="ignore", over="ignore", divide="ignore"):
        radial, slope = _radial(q, d)
        out = np.stack(
            [x * radial + 2 * p1 * x * y + p2 * (q + 2 * x * x), y * radial + p1 * (q + 2 * y * y) + 2 * p2 * x * y], axis=-1
        )
        across = 2 * slope * x * y + 2 * p1 * x + 2 * p2 * y
        jacobian = np.stack(
            [
                np.stack([radial + 2 * slope * x * x + 2 * p1 * y + 6 * p2 * x, across], axis=-1),
                np.stack([across, radial + 2 * slope * y * y + 6 * p1 * y + 2 * p2 * x], axis=-1),
            ],
            axis=-2,
        )
        determinant = jacobian[..., 0, 0] * jacobian[..., 1, 1] - jacobian[..., 0, 1] * jacobian[..., 1, 0]
        bad = ~((q < valid_radius_squared(tuple(d))) & (determinant > 0.0))
    out[bad], jacobian[bad] = np.nan, np.nan
    return out, jacobian


def undistort(points: Array, d: Sequence[float]) -> Array:
    """Returns the points of the plane z = 1, (..., 2), that ``distort`` maps to ``points`` (..., 2); NaN where there are none."""
    radius = np.hypot(points[..., 0], points[..., 1])
    limit = float(np.sqrt(valid_radius_squared(tuple(d))))

    def radial(r: Array) -> tuple[Array, Array]:
        factor, slope = _radial(r * r, d)
        return r * factor, factor + 2 * slope * r * r

    straight = _inverse(radial, radius, limit)
    with np.errstate(invalid="ignore", divide="ignore"):
        start = points * np.where(radius > 0, straight / radius, 1.0)[..., None]
    if not (d[2] or d[3]):
        return start
    # Tangential terms are small: Newton's method from the radial solution. A search that leaves the valid radius ends as NaN.
    out = np.where(np.isfinite(start), start, points).reshape(-1, 2)
    targets = points.reshape(-1, 2)
    error = np.full(len(out), np.inf)
    left = np.arange(len(out))
    tolerance = 1e-15 * (1.0 + np.abs(targets).max(axis=-1))
    for _ in range(_STEPS):
        there, j = distort(out[left], d)
        rest = targets[left] - there
        now, before = np.abs(rest).max(axis=-1), error[left]
        error[left] = now
        # A point is done once it is exact within the precision of doubles; a NaN compares as false and so is done too.
        more = (now > tolerance[left]) & ((now > 100 * tolerance[left]) | (now < before))
        left, rest, j = left[more], rest[more], j[more]
        if not len(left):
            break
        determinant = j[:, 0, 0] * j[:, 1, 1] - j[:, 0, 1] * j[:, 1, 0]
        out[left, 0] += (j[:, 1, 1] * rest[:, 0] - j[:, 0, 1] * rest[:, 1]) / determinant
        out[left, 1] += (j[:, 0, 0] * rest[:, 1] - j[:, 1, 0] * rest[:, 0]) / determinant
    out[~(error <= 100 * tolerance)] = np.nan
    return out.reshape(points.shape)


def distort_angle(theta: Array, d: Sequence[float]) -> Array:
    """Returns the distance from the principal point, focal lengths, of rays at an angle from the axis, radians (equidistant model)."""
    q = theta * theta
    k1, k2, k3, k4 = d or (0.0,) * 4
    out = theta * (1.0 + q * (k1 + q * (k2 + q * (k3 + q * k4))))
    return np.where(theta <= valid_angle(tuple(d)), out, np.nan)


def undistort_angle(radius: Array, d: Sequence[float]) -> Array:
    """Returns the angle from the axis, radians, that ``distort_angle`` maps to ``radius``, focal lengths; NaN where there is none."""
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
    above = 1.0 + q * (k1 + q * (k2 + q * k3))
    below = 1.0 + q * (k4 + q * (k5 + q * k6))
    slope_above = k1 + q * (2 * k2 + q * 3 * k3)
    slope_below = k4 + q * (2 * k5 + q * 3 * k6)
    return above / below, (slope_above * below - above * slope_below) / (below * below)


@lru_cache(maxsize=64)
def valid_radius_squared(d: tuple[float, ...]) -> float:
    """Returns the squared distance from the axis on the plane z = 1 up to which plumb_bob or rational_polynomial grows."""
    k1, k2, _, _, k3, k4, k5, k6 = (*d, 0.0, 0.0, 0.0, 0.0)[:8]
    above, below = np.poly1d([k3, k2, k1, 1.0]), np.poly1d([k6, k5, k4, 1.0])
    q = np.poly1d([1.0, 0.0])
    slope = (above + 2 * q * above.deriv()) * below - 2 * q * above * below.deriv()
    return min(_first_root(slope), _first_root(below))


@lru_cache(maxsize=64)
def valid_angle(d: tuple[float, ...]) -> float:
    """Returns the angle from the axis, radians, at most pi, up to which an equidistant polynomial grows."""
    if not any(d):
        return float(np.pi)
    k1, k2, k3, k4 = d
    return float(min(np.pi, np.sqrt(_first_root(np.poly1d([9 * k4, 7 * k3, 5 * k2, 3 * k1, 1.0])))))


def _first_root(polynomial: np.poly1d) -> float:
    """Returns the least positive root, +inf if there is none."""
    # Tiny coefficients have roots near infinity, and overflow on the way there.
    roots = np.roots(np.where(np.abs(polynomial.coeffs) < 1e-30, 0.0, polynomial.coeffs))
    real = roots.real[(np.abs(roots.imag) <= 1e-9 * np.abs(roots)) & (roots.real > 0.0)]
    return float(real.min()) if len(real) else float("inf")


def _inverse(function: Callable[[Array], tuple[Array, Array]], values: Array, limit: float) -> Array:
    """Returns the arguments at which a function has ``values`` >= 0; NaN where it has none.

    The function grows from 0 at 0 up to ``limit``, and returns its derivative too. The method is Newton's, with bisection where a step
    leaves the interval of the solution.
    """
    upper, targets = limit, values.ravel()
    if not np.isfinite(upper):
        upper, largest = 1.0, float(np.nanmax(targets, initial=0.0))
        while upper < 1e9 and function(np.array(upper))[0] < largest:
            upper *= 2.0
    out = np.full(targets.shape, np.nan)
    with np.errstate(invalid="ignore", divide="ignore", over="ignore"):
        # At the limit itself the slope is zero or the value infinite, so the search ends slightly below.
        left = np.flatnonzero(targets <= function(np.array(upper * (1.0 - 1e-12)))[0])
        targets = targets[left]
        x, low, high = np.minimum(targets, upper), np.zeros_like(targets), np.full_like(targets, upper)
        for _ in range(_STEPS):
            value, slope = function(x)
            low, high = np.where(value <= targets, x, low), np.where(value >= targets, x, high)
            new = x - (value - targets) / slope
            new = np.where((new >= low) & (new <= high), new, 0.5 * (low + high))
            out[left] = new
            moved = np.abs(new - x) > 1e-15 * (1.0 + np.abs(new))
            left = left[moved]
            targets, x, low, high = (a[moved] for a in (targets, new, low, high))
            if not len(left):
                break
    return out.reshape(values.shape)
