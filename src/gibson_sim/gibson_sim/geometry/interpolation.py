"""Scene states between two others: positions and velocities linearly, orientations along the shortest turn."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from gibson_sim.errors import SceneMismatchError
from gibson_sim.types import SceneState

_SMALL_ANGLE = 1e-6
"""Radians between two quaternions below which the arc and its chord are the same to the last digit."""


def slerp(earlier: ArrayLike, later: ArrayLike, fraction: float) -> NDArray[np.float64]:
    """Returns unit quaternions (x, y, z, w) that turn at a constant rate, by the shortest way, from one to the other.

    Args:
        earlier: (..., 4), unit quaternions.
        later: (..., 4), unit quaternions.
        fraction: 0 = earlier, 1 = later; outside of [0, 1] the turning goes on at the same rate.
    """
    a = np.asarray(earlier, dtype=np.float64)
    b = np.asarray(later, dtype=np.float64)
    b = np.where(np.sum(a * b, axis=-1, keepdims=True) < 0.0, -b, b)
    # The arc tangent keeps its digits at small angles, where the arc cosine of the dot product has none.
    angle = 2.0 * np.arctan2(np.linalg.norm(b - a, axis=-1, keepdims=True), np.linalg.norm(b + a, axis=-1, keepdims=True))
    small = angle < _SMALL_ANGLE
    sine = np.where(small, 1.0, np.sin(angle))
    weight_a = np.where(small, 1.0 - fraction, np.sin((1.0 - fraction) * angle) / sine)
    weight_b = np.where(small, fraction, np.sin(fraction * angle) / sine)
    mixed = weight_a * a + weight_b * b
    turned: NDArray[np.float64] = mixed / np.linalg.norm(mixed, axis=-1, keepdims=True)
    return turned


def interpolate_states(earlier: SceneState, later: SceneState, fraction: float) -> SceneState:
    """Returns the state at ``fraction`` of the time from one state to another, for all links at once.

    At 0 and 1 it returns the given states themselves. Outside of [0, 1] everything moves on as it did in between: a camera whose
    exposure begins a little before ``earlier`` needs that.

    Raises:
        SceneMismatchError: the states are not of the same scene and revision.
    """
    if earlier.links != later.links or earlier.revision != later.revision:
        raise SceneMismatchError(
            f"states of revision {earlier.revision} with {len(earlier.links)} links and of revision {later.revision} with "
            f"{len(later.links)} links have nothing in between; give two states of the same scene"
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
