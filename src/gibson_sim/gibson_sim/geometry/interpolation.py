"""Interpolates scene states: positions and velocities linearly, orientations along the shortest rotation."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from gibson_sim.errors import SceneMismatchError
from gibson_sim.types import SceneState

_SMALL_ANGLE = 1e-6
"""Angle between two quaternions below which arc and chord are equal in double precision, radians."""


def slerp(earlier: ArrayLike, later: ArrayLike, fraction: float) -> NDArray[np.float64]:
    """Returns unit quaternions (x, y, z, w), (..., 4), interpolated along the shortest rotation at a constant rate.

    Args:
        earlier: (..., 4), unit quaternions.
        later: (..., 4), unit quaternions.
        fraction: 0 = earlier, 1 = later; beyond [0, 1] the rotation is extrapolated.
    """
    a = np.asarray(earlier, dtype=np.float64)
    b = np.asarray(later, dtype=np.float64)
    b = np.where(np.sum(a * b, axis=-1, keepdims=True) < 0.0, -b, b)
    # The arc tangent is precise at small angles, unlike the arc cosine of the dot product.
    angle = 2.0 * np.arctan2(np.linalg.norm(b - a, axis=-1, keepdims=True), np.linalg.norm(b + a, axis=-1, keepdims=True))
    small = angle < _SMALL_ANGLE
    sine = np.where(small, 1.0, np.sin(angle))
    weight_a = np.where(small, 1.0 - fraction, np.sin((1.0 - fraction) * angle) / sine)
    weight_b = np.where(small, fraction, np.sin(fraction * angle) / sine)
    mixed = weight_a * a + weight_b * b
    out: NDArray[np.float64] = mixed / np.linalg.norm(mixed, axis=-1, keepdims=True)
    return out


def interpolate_states(earlier: SceneState, later: SceneState, fraction: float) -> SceneState:
    """Returns the state at a fraction of the time from one state to another.

    At 0 and 1 it returns the given states. Outside [0, 1] the motion is extrapolated, for cameras whose exposure begins slightly before
    ``earlier``.

    Args:
        earlier: the state at 0.
        later: the state at 1, of the same scene and revision.
        fraction: fraction of the time between the states.

    Raises:
        SceneMismatchError: the states are not of the same scene and revision.
    """
    if earlier.links != later.links or earlier.revision != later.revision:
        raise SceneMismatchError(
            f"states of revision {earlier.revision} with {len(earlier.links)} links and of revision {later.revision} with "
            f"{len(later.links)} links cannot be interpolated; give two states of the same scene"
        )
    if fraction == 0.0:
        return earlier
    if fraction == 1.0:
        return later
    return SceneState(
        stamp_ns=earlier.stamp_ns + round(fraction * (later.stamp_ns - earlier.stamp_ns)),
        step=earlier.step + round(fraction * (later.step - earlier.step)),
        revision=later.revision,
        links=later.links,
        positions=earlier.positions + fraction * (later.positions - earlier.positions),
        quats_xyzw=slerp(earlier.quats_xyzw, later.quats_xyzw, fraction),
        twists=earlier.twists + fraction * (later.twists - earlier.twists),
    )
