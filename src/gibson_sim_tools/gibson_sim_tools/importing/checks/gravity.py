"""Estimates the up direction and the unit of a scene, and whether the estimate is reliable."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from gibson_sim.errors import ConfigError
from gibson_sim.formats.mesh import UpAxis
from gibson_sim.geometry.level import level_direction
from gibson_sim.geometry.patches import Patches, flat_patches
from gibson_sim.geometry.upright import CUES, UpCandidate, find_candidates
from gibson_sim.quoting import quoted
from gibson_sim.types import Vec3

F64 = NDArray[np.float64]
ALIGNED_DEG = 0.5
"""Tilt below which a floor counts as level, degrees."""
ON_ITS_SIDE_DEG = 15.0
"""Tilt above which a scene lies on its side, degrees."""
UNITS = {"m": 1.0, "cm": 0.01, "mm": 0.001, "inch": 0.0254, "foot": 0.3048, "km": 1000.0}
"""Metres per unit, by name."""
_SURE_PROBABILITY = 0.9
"""Probability above which a direction is accepted as up."""
_MIN_AGREEING_CUES = 2
"""Minimum number of cues that must agree on the sign of up."""
_NOISE = {"facing": 0.1, "clutter": 0.02, "bounds": 0.05, "outside": 0.1}
"""Noise of each cue; smaller absolute values count as zero."""
_UPRIGHT_DEG = 2.0
"""Angle to z within which a direction is up, unless another one is up with certainty, degrees."""
_LIKELY, _LIKELY_IF_DECLARED = 0.25, 0.003
"""Minimum probability of z, relative to the likeliest direction, for z to be up: in general, and if the format declares z up."""
_TILT_PRIOR = ((5.0, 30.0), (ON_ITS_SIDE_DEG, 4.5))
"""(angle to z, degrees; prior odds of a direction within it): most scans are nearly upright."""
_TURNED_ODDS = 30.0
"""Prior odds for the z axis of a rotated mesh, and for its z axis before the rotation."""
_AXIS_TOLERANCE_DEG, _AXIS_ODDS = 2.0, 2.5
"""Tolerance, degrees, and prior odds of directions along x or y, which are up axes of some formats."""
_ONE_ORIENTATION, _MIN_ENCLOSED = 0.65, 0.2
"""If more than the first fraction of the surface has one orientation, and fewer than the second fraction of columns lie between a floor
and a ceiling, the surface may be a wall."""
_NEAR_GIVEN_DEG = 10.0
"""Search range around a given up direction, degrees."""
_MAX_CANDIDATES = 3
"""Maximum number of candidates reported."""
_MIN_HEIGHT, _MAX_HEIGHT = 1.2, 25.0
"""Range of a building's height, m."""
_STOREY_HEIGHT = 2.8
"""Typical height of a storey, m."""
_MIN_WIDTH, _MAX_WIDTH = 1.0, 400.0
"""Range of a building's longer horizontal side, m."""
_AXES: dict[str, Vec3] = {
    "x": (1.0, 0.0, 0.0), "y": (0.0, 1.0, 0.0), "z": (0.0, 0.0, 1.0),
    "-x": (-1.0, 0.0, 0.0), "-y": (0.0, -1.0, 0.0), "-z": (0.0, 0.0, -1.0),
}  # fmt: skip


@dataclass(frozen=True, slots=True)
class UpGuess:
    """Estimate of the up direction, in the frame of a mesh whose z should be up."""

    up: Vec3
    """Unit normal of the floors, frame of the mesh; z if ``sure`` is false."""
    sure: bool
    """Whether ``up`` is reliable; if not, the user must choose among ``others``."""
    others: tuple[Vec3, ...] = ()
    """Candidates for up, the likeliest first; empty if ``sure``."""

    @property
    def tilt_deg(self) -> float:
        """Angle between ``up`` and z, degrees."""
        return _degrees(self.up[2])

    @property
    def axis(self) -> UpAxis:
        """Axis of the mesh nearest to ``up`` or its opposite."""
        names: tuple[UpAxis, ...] = ("x", "y", "z")
        return names[int(np.abs(self.up).argmax())]


def guess_up(vertices: F64, triangles: NDArray[np.integer], original: Vec3 | None = None, declared: bool = False) -> UpGuess:
    """Estimates the up direction of a mesh.

    All directions are candidates. z stays up unless another direction is much likelier; a small tilt needs less evidence than a mesh on
    its side or in an arbitrary orientation. With weak evidence, as in an empty room, the estimate is not sure.

    Args:
        vertices: (V, 3).
        triangles: (F, 3).
        original: direction of the mesh's z before a pose rotated it, unit vector; None = not rotated. The rotation may have levelled
            a wall instead of the floor, so the new z is evidence, not proof.
        declared: whether the user or the file format declares z up; formats of scans do not.
    """
    patches = _patches(vertices, triangles)
    candidates = [] if patches is None else find_candidates(patches)
    if not candidates:
        return UpGuess((0.0, 0.0, 1.0), True)
    guess = _guess(candidates, declared)
    return guess if original is None or (guess.sure and guess.tilt_deg > _UPRIGHT_DEG) else _guess_rotated(candidates, original)


def _guess(candidates: Sequence[UpCandidate], declared: bool) -> UpGuess:
    best = candidates[0]
    upright = max(candidates, key=lambda c: c.up[2])
    tilt = _degrees(upright.up[2])
    if best is upright:
        odds = next((odds for tilt_limit, odds in _TILT_PRIOR if tilt <= tilt_limit), 1.0)
        sure = tilt <= _UPRIGHT_DEG or (
            _posterior(best, odds) >= _SURE_PROBABILITY and (_agree(best) or tilt <= _TILT_PRIOR[0][0])
        )
        sure &= tilt <= ON_ITS_SIDE_DEG or not _one_sided(best)
        return UpGuess(best.up, True) if sure else _unclear(candidates)
    along = max(abs(c) for c in best.up[:2]) >= math.cos(math.radians(_AXIS_TOLERANCE_DEG))
    if _posterior(best, _AXIS_ODDS if along else 1.0) >= _SURE_PROBABILITY and _agree(best) and not _one_sided(best):
        return UpGuess(best.up, True)
    nearly = _TILT_PRIOR[0][1] * upright.chance > best.chance * _SURE_PROBABILITY / (1.0 - _SURE_PROBABILITY)
    likely = upright.chance >= best.chance * (_LIKELY_IF_DECLARED if declared else _LIKELY)
    stays = likely if tilt <= _UPRIGHT_DEG else tilt <= _TILT_PRIOR[0][0] and nearly
    return UpGuess(upright.up, True) if stays else _unclear(candidates)


def _guess_rotated(candidates: Sequence[UpCandidate], original: Vec3) -> UpGuess:
    """Returns the up direction of a mesh that a pose rotated: z, the original z, or a direction with strong evidence."""
    oblique = max(abs(c) for c in original) < math.cos(math.radians(_AXIS_TOLERANCE_DEG))
    weights = []
    for candidate in candidates:
        is_z = _degrees(candidate.up[2]) <= _UPRIGHT_DEG
        is_former = oblique and _degrees(sum(a * b for a, b in zip(candidate.up, original, strict=True))) <= _TILT_PRIOR[0][0]
        weights.append(candidate.chance * (_TURNED_ODDS if is_z or is_former else 1.0))
    k = int(np.argmax(weights))
    likely = weights[k] > candidates[k].chance
    return (
        UpGuess(candidates[k].up, True)
        if weights[k] >= _SURE_PROBABILITY * sum(weights) and (likely or _agree(candidates[k]))
        else _unclear(candidates)
    )


def _unclear(candidates: Sequence[UpCandidate]) -> UpGuess:
    return UpGuess((0.0, 0.0, 1.0), False, tuple(c.up for c in candidates[:_MAX_CANDIDATES]))


def _degrees(cosine: float) -> float:
    return math.degrees(math.acos(min(1.0, max(-1.0, cosine))))


def _posterior(candidate: UpCandidate, odds: float) -> float:
    """Returns the posterior probability of a direction with prior ``odds``."""
    return candidate.chance * odds / (candidate.chance * odds + 1.0 - candidate.chance)


def _agree(candidate: UpCandidate) -> bool:
    """Returns whether several cues indicate this sign of the direction, and none the opposite."""
    cues = dict(zip(CUES, candidate.cues, strict=True))
    is_positive = [cues[name] > 0 for name, noise in _NOISE.items() if abs(cues[name]) > noise]
    return all(is_positive) and len(is_positive) >= _MIN_AGREEING_CUES


def _one_sided(candidate: UpCandidate) -> bool:
    """Returns whether the mesh is mostly one surface: a floor without walls, or a wall with shelves and pictures."""
    return candidate.area > _ONE_ORIENTATION and candidate.cues[CUES.index("gaps")] < _MIN_ENCLOSED


def refine_up(vertices: F64, triangles: NDArray[np.integer], up: Sequence[float]) -> Vec3:
    """Refines an approximate up direction: returns the unit normal of the level surfaces near it; the direction itself without any.

    Args:
        vertices: (V, 3).
        triangles: (F, 3).
        up: approximate up direction, not zero, frame of the mesh.
    """
    initial = np.asarray(up, dtype=np.float64)
    initial = initial / np.linalg.norm(initial)
    patches = _patches(vertices, triangles)
    normal = initial if patches is None else level_direction(patches, initial)[0]
    is_near = float(normal @ initial) > math.cos(math.radians(_NEAR_GIVEN_DEG))
    x, y, z = (normal if is_near else initial).tolist()
    return x, y, z


def _patches(vertices: F64, triangles: NDArray[np.integer]) -> Patches | None:
    return flat_patches(vertices, triangles, np.random.default_rng(0)) if len(triangles) else None


def direction(text: str, option: str = "--up") -> Vec3:
    """Parses an axis (``z``, ``-y``) or three numbers (``0.1,0.3,0.9``); returns a unit vector.

    Raises:
        ConfigError: the text is neither.
    """
    if text.lower().lstrip("+") in _AXES:
        return _AXES[text.lower().lstrip("+")]
    try:
        vector = np.array([float(word) for word in text.split(",")])
    except ValueError:
        vector = np.zeros(0)
    length = float(np.linalg.norm(vector)) if vector.shape == (3,) and np.isfinite(vector).all() else 0.0
    if not 1e-6 < length < 1e9:
        raise ConfigError(
            f"{option} is {quoted(text)}, must be an axis, {', '.join(_AXES)}, or a direction of three numbers that are not all 0, as 0.1,0.3,0.9"
        )
    x, y, z = (vector / length).tolist()
    return x, y, z


def direction_text(up: Sequence[float]) -> str:
    """Returns a direction in the form that ``direction`` reads."""
    for name, axis in _AXES.items():
        if math.dist(axis, up) < 1e-3:
            return name
    return ",".join(f"{round(float(c), 3) + 0.0:g}" for c in up)


def rotation_to_z(up: Sequence[float]) -> F64:
    """Returns the smallest rotation, (3, 3), that rotates a unit vector to z."""
    v = np.asarray(up, dtype=np.float64)
    axis = np.cross(v, (0.0, 0.0, 1.0))
    sine, cosine = float(np.linalg.norm(axis)), float(v[2])
    if sine < 1e-12:
        return np.eye(3) if cosine > 0 else np.diag([1.0, -1.0, -1.0])
    x, y, z = axis / sine
    k = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    return np.asarray(np.eye(3) + sine * k + (1.0 - cosine) * (k @ k))


def size_text(size: Sequence[float]) -> str:
    """Returns the size of a scene (x, y, z), metres, as text; unless it is a room or a building, also the unit in which it would be one."""
    text, unit = f"{' x '.join(f'{c:.4g}' for c in size)} m", guess_unit(size)
    if unit == "m":
        return text
    if unit:
        return f"{text}; in {unit} it would be a room or a building"
    return f"{text}; it is not the size of a room in any of {', '.join(UNITS)}"


def guess_unit(size: Sequence[float]) -> str:
    """Returns the unit, a key of ``UNITS``, in which a scene of this size (x, y, z) has the size of a room or a building; "" = none.

    Metres have priority; among other units, the one in which the height is nearest to a storey.
    """
    width, depth, height = (float(c) for c in size)

    def fits(metres: float) -> bool:
        return _MIN_HEIGHT <= height * metres <= _MAX_HEIGHT and _MIN_WIDTH <= max(width, depth) * metres <= _MAX_WIDTH

    units = [name for name, metres in UNITS.items() if fits(metres)]
    if not units or "m" in units:
        return "m" if units else ""
    return min(units, key=lambda name: abs(math.log(height * UNITS[name] / _STOREY_HEIGHT)))
