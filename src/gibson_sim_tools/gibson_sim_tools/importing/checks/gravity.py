"""Where up is in a scene, how sure that is, and whether it is in metres."""

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
from gibson_sim.geometry.upright import CUES, Candidate, find_candidates
from gibson_sim.quoting import quoted
from gibson_sim.types import Vec3

F64 = NDArray[np.float64]
ALIGNED_DEG = 0.5
"""A floor that is less out of level than this counts as level, degrees."""
ON_ITS_SIDE_DEG = 15.0
"""What is more out of level lies on its side or is turned, degrees."""
UNITS = {"m": 1.0, "cm": 0.01, "mm": 0.001, "inch": 0.0254, "foot": 0.3048, "km": 1000.0}
"""Metres per unit, by name."""
_SURE = 0.9
"""Chance from which a direction is taken for up."""
_AGREE = 2
"""Cues that must say which end is up."""
_NOISE = {"facing": 0.1, "clutter": 0.02, "bounds": 0.05, "outside": 0.1}
"""Of these cues: less says nothing."""
_UPRIGHT_DEG = 2.0
"""What is this near to the scene's z is up unless another direction surely is."""
_LIKELY, _LIKELY_TOLD = 0.25, 0.003
"""So much as likely as the likeliest direction z must be to pass for up; where the format says that it is, the lesser one."""
_TILTED = ((5.0, 30.0), (ON_ITS_SIDE_DEG, 4.5))
"""Angle to z, degrees, and odds for a direction within it: scans are held nearly upright more often than not."""
_TURNED_ODDS = 30.0
"""Odds for z of a mesh that a pose turned, and for its z before."""
_ALONG_DEG, _ALONG_ODDS = 2.0, 2.5
"""The same for directions along x or y: files differ in which axis is up."""
_ALONE, _ROOMY = 0.65, 0.2
"""Of the whole surface, of its columns: where more lies one way and fewer end at a floor and a ceiling, a wall is as likely as a floor."""
_NEAR_GIVEN_DEG = 10.0
"""What is level this near to a direction that somebody gave decides the rest."""
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
    """Which way is up in a mesh whose z is meant to be."""

    up: Vec3
    """Unit vector, frame of the mesh: across its floors. z where that is not clear."""
    sure: bool
    """Whether ``up`` may be relied on; if not, a person must choose among ``others``."""
    others: tuple[Vec3, ...] = ()
    """Directions that may be up as well, the likeliest first; where ``up`` is not sure."""

    @property
    def tilt_deg(self) -> float:
        """Angle between ``up`` and z, degrees."""
        return _degrees(self.up[2])

    @property
    def axis(self) -> UpAxis:
        """The axis of the mesh nearest to ``up`` or to its opposite."""
        names: tuple[UpAxis, ...] = ("x", "y", "z")
        return names[int(np.abs(self.up).argmax())]


def guess_up(vertices: F64, triangles: NDArray[np.integer], former: Vec3 | None = None, told: bool = False) -> UpGuess:
    """Returns which way is up, and whether that is sure.

    All directions are looked at. A mesh that is upright already stays so unless another direction is much likelier; one that is a little
    tilted needs less evidence than one that lies on its side or is turned anyhow. Where evidence is weak, as in an empty room, nothing is
    said to be sure.

    Args:
        vertices: (V, 3).
        triangles: (F, 3).
        former: where z of the mesh pointed before a pose turned it, unit vector; None = it was not turned. Whoever turned it may have
            taken a wall for the floor, and so its z is good evidence, but no more than that.
        told: whether somebody, or the format of the file, says that z is up; formats of scans do not.
    """
    patches = _patches(vertices, triangles)
    found = [] if patches is None else find_candidates(patches)
    if not found:
        return UpGuess((0.0, 0.0, 1.0), True)
    guess = _guess(found, told)
    return guess if former is None or (guess.sure and guess.tilt_deg > _UPRIGHT_DEG) else _guess_turned(found, former)


def _guess(found: Sequence[Candidate], told: bool) -> UpGuess:
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


def _guess_turned(found: Sequence[Candidate], former: Vec3) -> UpGuess:
    """Returns which way is up in a mesh that a pose turned: z, the former z, or what surely is."""
    oblique = max(abs(c) for c in former) < math.cos(math.radians(_ALONG_DEG))
    weights = []
    for candidate in found:
        is_z = _degrees(candidate.up[2]) <= _UPRIGHT_DEG
        is_former = oblique and _degrees(sum(a * b for a, b in zip(candidate.up, former, strict=True))) <= _TILTED[0][0]
        weights.append(candidate.chance * (_TURNED_ODDS if is_z or is_former else 1.0))
    k = int(np.argmax(weights))
    likely = weights[k] > found[k].chance
    return UpGuess(found[k].up, True) if weights[k] >= _SURE * sum(weights) and (likely or _agree(found[k])) else _unclear(found)


def _unclear(found: Sequence[Candidate]) -> UpGuess:
    return UpGuess((0.0, 0.0, 1.0), False, tuple(c.up for c in found[:_SHOWN]))


def _degrees(cosine: float) -> float:
    return math.degrees(math.acos(min(1.0, max(-1.0, cosine))))


def _chance(candidate: Candidate, odds: float) -> float:
    """Returns the chance of a direction, ``odds`` being what speaks for it beforehand."""
    return candidate.chance * odds / (candidate.chance * odds + 1.0 - candidate.chance)


def _agree(candidate: Candidate) -> bool:
    """Returns whether several cues say that this end is up, and none that the other one is."""
    says = dict(zip(CUES, candidate.cues, strict=True))
    loud = [says[name] > 0 for name, noise in _NOISE.items() if abs(says[name]) > noise]
    return all(loud) and len(loud) >= _AGREE


def _one_sided(candidate: Candidate) -> bool:
    """Returns whether there is little but one surface and what is on it: a floor without walls, or a wall with shelves and pictures."""
    return candidate.area > _ALONE and candidate.cues[CUES.index("gaps")] < _ROOMY


def level_near(vertices: F64, triangles: NDArray[np.integer], up: Sequence[float]) -> Vec3:
    """Returns the direction, unit length, across what is level near a direction that is known to be about up; that one where nothing is.

    Args:
        vertices: (V, 3).
        triangles: (F, 3).
        up: not zero; frame of the mesh.
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
    """Returns a direction as ``direction`` reads it."""
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
    """Returns the unit, a key of ``UNITS``, in which something of this size (x, y, z) is a room or a building; "" = none fits.

    Metres are given the benefit of the doubt; of others the one in which it is nearest to a storey high.
    """
    width, depth, height = (float(c) for c in size)

    def fits(metres: float) -> bool:
        return _LOW <= height * metres <= _HIGH and _NARROW <= max(width, depth) * metres <= _WIDE

    found = [name for name, metres in UNITS.items() if fits(metres)]
    if not found or "m" in found:
        return "m" if found else ""
    return min(found, key=lambda name: abs(math.log(height * UNITS[name] / _STOREY)))
