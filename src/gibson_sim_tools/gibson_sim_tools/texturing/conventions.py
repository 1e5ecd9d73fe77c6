"""Finds out in which convention poses were written, and whether the depth images have the scale of the mesh: by what photographs show.

Right poses make photographs agree in what they show of the mesh. If they do not, and do in another convention, its name helps the user.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from gibson_sim.formats.mesh import TO_Z_UP
from gibson_sim_tools.photographs.photographs import Photographs
from gibson_sim_tools.scanning.pose_conventions import reread
from gibson_sim_tools.scanning.posed_rgbd import ScanError
from gibson_sim_tools.scanning.settings import AS_READ, AUTO
from gibson_sim_tools.texturing.quality import Views, areas_px, joined, views_of
from gibson_sim_tools.texturing.settings import POSE_CONVENTIONS
from gibson_sim_tools.texturing.surface import Surface
from gibson_sim_tools.texturing.visibility import seen_faces

F64 = NDArray[np.float64]

_TO_Z_UP = np.block([[TO_Z_UP["y"], np.zeros((3, 1))], [np.zeros((1, 3)), np.ones((1, 1))]])
_PAIRS, _LONGEST = 6, 160
"""Pairs of neighbouring photographs that are compared, and the longest side that they are reduced to, pixels."""
_GOOD, _BETTER = 0.25, 2.0
"""Agreement that right poses reach even with few patterns, and the ratio of agreements that makes another convention the right one."""
_COMMON = 50
"""Triangles that photographs must have in common to be compared."""
_SAME_DEPTH, _OTHER_SCALE, _SPREAD = 0.1, 0.15, 0.1
"""Relative difference at which a depth is that of the mesh, that of a scale that is another one, and of depths that have one scale."""
_LEAST_DEPTHS = 200


@dataclass(frozen=True, slots=True)
class Agreement:
    """How well photographs agree with each other on a mesh."""

    share: float
    """Part of the photographs that shows the front of the mesh, 0 to 1."""
    likeness: float
    """Correlation of the brightness of the same triangles in several photographs, 0 to 1."""

    @property
    def value(self) -> float:
        """0 = none, 1 = perfect."""
        return self.share * self.likeness


def in_convention(photographs: Photographs, name: str) -> Photographs:
    """Returns the photographs, their poses taken in another convention than that of their layout: one of ``POSE_CONVENTIONS`` or ``as-read``."""
    if name == AS_READ:
        return photographs
    if name == "y-up":
        return photographs.at(_TO_Z_UP @ photographs.poses)
    if name == "before-applied-transform":
        if photographs.applied is None:
            raise ScanError(
                f"{photographs.folder}: has no applied_transform, which only transforms.json of nerfstudio has; take {AS_READ}"
            )
        return photographs.at(np.linalg.inv(photographs.applied) @ photographs.poses)
    return photographs.at(reread(photographs.poses, photographs.layout, name))


def agreement(surface: Surface, photographs: Photographs) -> Agreement:
    """Returns how well some of the photographs agree on a surface."""
    small = replace(photographs, longest=min(_LONGEST, photographs.longest or _LONGEST))
    firsts = np.unique(np.linspace(0, max(len(small) - 2, 0), _PAIRS).round().astype(int))
    shares, parts = [], []
    for number in np.unique(np.concatenate([firsts, firsts + 1]))[: 2 * _PAIRS].tolist():
        if number >= len(small):
            continue
        lens = small.intrinsics(number)
        seen = seen_faces(surface, lens, small.items[number].T_world_camera)
        shares.append(float(areas_px(seen.corners).sum()) / (lens.width * lens.height))
        parts.append(views_of(number, seen, small.picture(number)))
    return Agreement(min(float(np.mean(shares)), 1.0), _likeness(joined(parts)))


def _likeness(views: Views) -> float:
    """Returns the correlation of the brightness of triangles in a photograph with that in the others, at least 0."""
    if not len(views):
        return 0.0
    value = np.sqrt(np.maximum(views.light.mean(axis=1), 0.0)).astype(np.float64)
    photograph = views.photograph
    # Exposures differ.
    value -= (np.bincount(photograph, value) / np.maximum(np.bincount(photograph), 1))[photograph]
    number, total = np.bincount(views.face), np.bincount(views.face, value)
    shared = number[views.face] > 1
    if int(shared.sum()) < _COMMON:
        return 0.0
    others = (total[views.face] - value)[shared] / (number[views.face][shared] - 1)
    a, b = value[shared] - value[shared].mean(), others - others.mean()
    spread = float(np.sqrt((a * a).sum() * (b * b).sum()))
    return max(float((a * b).sum()) / spread, 0.0) if spread > 0.0 else 0.0


def checked(surface: Surface, photographs: Photographs, convention: str = AS_READ) -> tuple[Photographs, str]:
    """Returns the photographs with their poses in a convention, and a line about it; empty = nothing to say.

    Args:
        surface: in the world of the poses.
        photographs: as their layout was read.
        convention: one of ``POSE_CONVENTIONS``, ``as-read`` or ``auto`` = the one in which photographs agree best.

    Raises:
        ScanError: they do not agree as they are, and do in another convention, which is named; or depth images have another scale.
    """
    taken = in_convention(photographs, AS_READ if convention == AUTO else convention)
    now = agreement(surface, taken)
    text = ""
    if now.value < _GOOD:
        name, best = _best(surface, photographs)
        if best.value >= _GOOD / 2.0 and best.value > _BETTER * now.value:
            found = f"photographs agree if poses are read as {name} ({POSE_CONVENTIONS[name]}), but not as they are read now"
            numbers = f"agreement {best.value:.2f} against {now.value:.2f}"
            if convention != AUTO:
                raise ScanError(f"{photographs.folder}: {found} ({numbers}); give --pose-convention {name}, or {AUTO}")
            taken, text = in_convention(photographs, name), f"poses are read as {name}: {POSE_CONVENTIONS[name]} ({numbers})"
    _check_depth(surface, taken)
    return taken, text


def _best(surface: Surface, photographs: Photographs) -> tuple[str, Agreement]:
    names = [name for name in POSE_CONVENTIONS if name != "before-applied-transform" or photographs.applied is not None]
    found = [(name, agreement(surface, in_convention(photographs, name))) for name in names]
    return max(found, key=lambda pair: pair[1].value)


def _check_depth(surface: Surface, photographs: Photographs) -> None:
    """Raises ScanError if depth images have one scale that is another than that of the mesh."""
    ratios = []
    for number in np.unique(np.linspace(0, len(photographs) - 1, _PAIRS).round().astype(int)).tolist():
        depth = photographs.depth(number)
        if depth is None:
            continue
        T = photographs.items[number].T_world_camera
        seen = seen_faces(surface, photographs.intrinsics(number), T)
        column, row = np.rint(seen.corners.mean(axis=1)).astype(np.int64).T
        z = (surface.vertices[surface.triangles[seen.faces]].mean(axis=1) - T[:3, 3]) @ T[:3, 2]
        ratios.append(depth[row, column] / z)
    ratio = np.concatenate(ratios) if ratios else np.zeros(0)
    ratio = ratio[np.isfinite(ratio)]
    if len(ratio) < _LEAST_DEPTHS:
        return
    middle = float(np.median(ratio))
    spread = float(np.median(np.abs(ratio - middle))) / middle
    if abs(middle - 1.0) > _OTHER_SCALE and spread < _SPREAD and float((np.abs(ratio - 1.0) < _SAME_DEPTH).mean()) < _SAME_DEPTH:
        raise ScanError(
            f"{photographs.folder}: in the depth images everything is {middle:.3g} times as far as in the mesh; if depths are metric, mesh "
            f"and poses are not: give --unit {middle:.4g}; else the unit of the depths is wrong"
        )
