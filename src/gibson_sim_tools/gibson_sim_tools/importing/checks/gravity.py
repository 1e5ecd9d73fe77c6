"""Estimates the up direction and the unit of a scene, and how sure the estimate is."""

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
_SURE = 0.9
"""Probability from which a direction counts as up."""
_AGREE = 2
"""Least number of cues that must agree on the sign of up."""
_NOISE = {"facing": 0.1, "clutter": 0.02, "bounds": 0.05, "outside": 0.1}
"""Noise of each cue: smaller values count as zero."""
_UPRIGHT_DEG = 2.0
"""Angle to z within which a direction is up unless another one surely is, degrees."""
_LIKELY, _LIKELY_TOLD = 0.25, 0.003
"""Least probability of z, relative to the likeliest direction, for z to count as up: in general, and if the format says that z is up."""
_TILTED = ((5.0, 30.0), (ON_ITS_SIDE_DEG, 4.5))
"""(angle to z in degrees, prior odds of a direction within it): most scans are nearly upright."""
_TURNED_ODDS = 30.0
"""Prior odds for the z axis of a rotated mesh, and for its z axis before the rotation."""
_ALONG_DEG, _ALONG_ODDS = 2.0, 2.5
"""Tolerance, degrees, and prior odds of directions along x or y: files differ in their up axis."""
_ALONE, _ROOMY = 0.65, 0.2
"""Fraction of the surface with one orientation, and of the columns between a floor and a ceiling: beyond both, the surface may be a wall."""
_NEAR_GIVEN_DEG = 10.0
"""Search range around a given up direction, degrees."""
_SHOWN = 3
_LOW, _HIGH = 1.2, 25.0
_STOREY = 2.8
_NARROW, _WIDE = 1.0, 400.0
_AXES: dict[str, Vec3] = {
    "x": (1.0, 0.0, 0.0), "y": (0.0, 1.0, 0.0), "z": (0.0, 0.0, 1.0),
    "-x": (-1.0, 0.0, 0.0), "-y": (0.0, -1.0, 0.0), "-z": (0.0, 0.0, -1.0),
}  # fmt: skip


@dataclass(frozen=True, slots=True)
class UpGuess:
    """Estimate of the up direction in the frame of a mesh, whose z should be up."""

    up: Vec3
    """Unit normal of the floors, frame of the mesh; z if that is not clear."""
    sure: bool
    """Whether ``up`` is reliable; if not, the user must choose among ``others``."""
    others: tuple[Vec3, ...] = ()
    """Candidates for up, the likeliest first; empty if ``up`` is sure."""

    @property
    def tilt_deg(self) -> float:
        """Angle between ``up`` and z, degrees."""
        return _degrees(self.up[2])

    @property
    def axis(self) -> UpAxis:
        """The axis of the mesh nearest to ``up`` or its opposite."""
        names: tuple[UpAxis, ...] = ("x", "y", "z")
        return names[int(np.abs(self.up).argmax())]


def guess_up(vertices: F64, triangles: NDArray[np.integer], former: Vec3 | None = None, told: bool = False) -> UpGuess:
    """Estimates the up direction of a mesh.

    All directions are candidates. A mesh that is upright stays so unless another direction is much likelier; a small tilt needs less
    evidence than a mesh on its side or in an arbitrary orientation. With weak evidence, as in an empty room, the estimate is not sure.

    Args:
        vertices: (V, 3).
        triangles: (F, 3).
        former: direction of the mesh's z before a pose rotated it, unit vector; None = not rotated. The rotation may have mistaken
            a wall for the floor, so the new z is evidence and no proof.
        told: the user, or the file format, says that z is up; formats of scans do not.
    """
    patches = _patches(vertices, triangles)
    found = [] if patches is None else find_candidates(patches)
    if not found:
        return UpGuess((0.0, 0.0, 1.0), True)
    guess = _guess(found, told)
    return guess if former is None or (guess.sure and guess.tilt_deg > _UPRIGHT_DEG) else _guess_turned(found, former)


def _guess(found: Sequence[UpCandidate], told: bool) -> UpGuess:
    best = found[0]
    upright = max(found, key=lambda c: c.up[2])
    tilt = _degrees(upright.up[2])
    if best is upright:
        odds = next((odds for most, odds in _TILTED if tilt <= most), 1.0)
        sure = tilt <= _UPRIGHT_DEG or (_chance(best, odds) >= _SURE and (_agree(best) or tilt <= _TILTED[0][0]))
        sure &= tilt <= ON_ITS_SIDE_DEG or not _one_sided(best)
        return UpGuess(best.up, True) if sure else _unclear(found)
    along = max(abs(c) for c in best.up[:2]) >= math.cos(math.radians(_ALONG_DEG))
    if _chance(best, _ALONG_ODDS if along else 1.0) >= _SURE and _agree(best) and not _one_sided(best):
        return UpGuess(best.up, True)
    nearly = _TILTED[0][1] * upright.chance > best.chance * _SURE / (1.0 - _SURE)
    likely = upright.chance >= best.chance * (_LIKELY_TOLD if told else _LIKELY)
    stays = likely if tilt <= _UPRIGHT_DEG else tilt <= _TILTED[0][0] and nearly
    return UpGuess(upright.up, True) if stays else _unclear(found)


def _guess_turned(found: Sequence[UpCandidate], former: Vec3) -> UpGuess:
    """Returns the up direction of a mesh that a pose rotated: z, the former z, or a direction that surely is."""
    oblique = max(abs(c) for c in former) < math.cos(math.radians(_ALONG_DEG))
    weights = []
    for candidate in found:
        is_z = _degrees(candidate.up[2]) <= _UPRIGHT_DEG
        is_former = oblique and _degrees(sum(a * b for a, b in zip(candidate.up, former, strict=True))) <= _TILTED[0][0]
        weights.append(candidate.chance * (_TURNED_ODDS if is_z or is_former else 1.0))
    k = int(np.argmax(weights))
    likely = weights[k] > found[k].chance
    return UpGuess(found[k].up, True) if weights[k] >= _SURE * sum(weights) and (likely or _agree(found[k])) else _unclear(found)


def _unclear(found: Sequence[UpCandidate]) -> UpGuess:
    return UpGuess((0.0, 0.0, 1.0), False, tuple(c.up for c in found[:_SHOWN]))


def _degrees(cosine: float) -> float:
    return math.degrees(math.acos(min(1.0, max(-1.0, cosine))))


def _chance(candidate: UpCandidate, odds: float) -> float:
    """Returns the posterior probability of a direction with prior ``odds``."""
    return candidate.chance * odds / (candidate.chance * odds + 1.0 - candidate.chance)


def _agree(candidate: UpCandidate) -> bool:
    """Returns whether several cues say that this end is up, and none says the opposite."""
    says = dict(zip(CUES, candidate.cues, strict=True))
    loud = [says[name] > 0 for name, noise in _NOISE.items() if abs(says[name]) > noise]
    return all(loud) and len(loud) >= _AGREE


def _one_sided(candidate: UpCandidate) -> bool:
    """Returns whether the mesh is little more than one surface: a floor without walls, or a wall with shelves and pictures."""
    return candidate.area > _ALONE and candidate.cues[CUES.index("gaps")] < _ROOMY


def level_near(vertices: F64, triangles: NDArray[np.integer], up: Sequence[float]) -> Vec3:
    """Returns the normal, unit length, of the level surfaces near an approximate up direction; that direction if there are none.

    Args:
        vertices: (V, 3).
        triangles: (F, 3).
        up: approximate up direction, not zero, frame of the mesh.
    """
    given = np.asarray(up, dtype=np.float64)
    given = given / np.linalg.norm(given)
    patches = _patches(vertices, triangles)
    found = given if patches is None else level_direction(patches, given)[0]
    near = float(found @ given) > math.cos(math.radians(_NEAR_GIVEN_DEG))
    x, y, z = (found if near else given).tolist()
    return x, y, z


def _patches(vertices: F64, triangles: NDArray[np.integer]) -> Patches | None:
    return flat_patches(vertices, triangles, np.random.default_rng(0)) if len(triangles) else None


def direction(text: str, option: str = "--up") -> Vec3:
    """Returns the unit vector that an axis (``z``, ``-y``) or three numbers (``0.1,0.3,0.9``) name.

    Raises:
        ConfigError: it is neither.
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
    """Returns the smallest rotation, (3, 3), that takes a unit vector to z."""
    v = np.asarray(up, dtype=np.float64)
    axis = np.cross(v, (0.0, 0.0, 1.0))
    sine, cosine = float(np.linalg.norm(axis)), float(v[2])
    if sine < 1e-12:
        return np.eye(3) if cosine > 0 else np.diag([1.0, -1.0, -1.0])
    x, y, z = axis / sine
    k = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    return np.asarray(np.eye(3) + sine * k + (1.0 - cosine) * (k @ k))


def guess_unit(size: Sequence[float]) -> str:
    """Returns the unit, a key of ``UNITS``, in which a scene of this size (x, y, z) is a room or a building; "" = none.

    Metres have priority; among other units, the one in which the height is nearest to a storey.
    """
    width, depth, height = (float(c) for c in size)

    def fits(metres: float) -> bool:
        return _LOW <= height * metres <= _HIGH and _NARROW <= max(width, depth) * metres <= _WIDE

    found = [name for name, metres in UNITS.items() if fits(metres)]
    if not found or "m" in found:
        return "m" if found else ""
    return min(found, key=lambda name: abs(math.log(height * UNITS[name] / _STOREY)))
