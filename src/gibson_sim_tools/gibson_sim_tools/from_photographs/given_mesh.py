"""Loads a mesh that was supplied with photographs, and rotates it to the frame of their poses."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from gibson_sim.errors import MeshError
from gibson_sim.formats.load_mesh import load_mesh
from gibson_sim.formats.mesh import TO_Z_UP
from gibson_sim.geometry.triangle_meshes import unit_normals
from gibson_sim_tools.scanning.posed_images import Photographs, ScanError
from gibson_sim_tools.scanning.settings import AS_READ, AUTO, CAMERA_CONVENTIONS
from gibson_sim_tools.scanning.triangle_mesh import TriangleMesh, decimated
from gibson_sim_tools.texturing.conventions import with_convention
from gibson_sim_tools.texturing.rasteriser import rasterise
from gibson_sim_tools.texturing.surface import surface_from_mesh

F64 = NDArray[np.float64]

GREY = 160
"""Vertex colour of meshes without vertex colours, sRGB, 0 to 255."""
_ROTATIONS = (("as it is", np.eye(3)), ("with the axes of its file", TO_Z_UP["y"].T), ("turned from y up to z up", TO_Z_UP["y"]))
"""Candidates of R_poses_mesh: glTF is y up and is read as z up, but poses supplied with it often stay y up."""
_VIEW_COUNT, _VIEW_WIDTH_PX, _MAX_TRIANGLES = 12, 80, 40_000
"""Number and width, pixels, of the rasterised views that rate a rotation, and the largest number of triangles of the rasterised mesh."""
_MIN_GAIN, _MIN_SHARE = 0.15, 0.2
"""Least gain of the front-face share by another rotation than the first, and least share of the selected one."""


@dataclass(frozen=True, slots=True, eq=False)
class GivenMesh:
    """A mesh that was supplied with photographs, in the frame of their poses."""

    mesh: TriangleMesh
    has_colors: bool
    """Whether its file has vertex colours."""
    convention: str
    """Convention of the poses in which the photographs show it: that of the caller, or, for ``auto``, ``as-read`` or a name."""
    text: str
    """Message about the selected rotation."""


def given_mesh(
    path: Path, photographs: Photographs, convention: str, progress: Callable[[float], None] = lambda _: None
) -> GivenMesh:
    """Returns the mesh in the frame of the poses.

    Args:
        path: file of the mesh.
        photographs: as their layout was read.
        convention: one of ``POSE_CONVENTIONS``, ``as-read`` or ``auto`` = as read, unless the photographs show the mesh in another one only.
        progress: called with the fraction that is done, 0 to 1.

    Raises:
        MeshError: it cannot be read.
        ScanError: its front faces fill less than ``_MIN_SHARE`` of the photographs, in every convention if that is ``auto``.
    """
    try:
        mesh = surface_from_mesh(load_mesh(path, [path.resolve().parent]))
    except ScanError as error:
        raise ScanError(f"{path}: {error}") from error
    has_colors = mesh.colors is not None
    if not has_colors:
        mesh = replace(mesh, colors=np.full((len(mesh.vertices), 3), GREY, dtype=np.uint8))
    simplified = mesh
    if len(mesh.triangles) > _MAX_TRIANGLES:
        try:
            simplified = decimated(mesh, _MAX_TRIANGLES)
        except MeshError:  # without meshoptimizer, rasterisation takes longer
            simplified = mesh

    def rotation_and_share(name: str) -> tuple[int, float]:
        posed = with_convention(photographs, name)
        shares = [front_face_share(replace(simplified, vertices=simplified.vertices @ R.T), posed) for _, R in _ROTATIONS]
        best = int(np.argmax(shares))
        best = best if shares[best] > shares[0] + _MIN_GAIN else 0
        return best, shares[best]

    convention_read = AS_READ if convention == AUTO else convention
    best, share = rotation_and_share(convention_read)
    progress(0.5)
    if share < _MIN_SHARE and convention == AUTO:
        found = {name: rotation_and_share(name) for name in CAMERA_CONVENTIONS}
        convention_read = max(found, key=lambda name: found[name][1])
        best, share = found[convention_read]
    if share < _MIN_SHARE:
        raise ScanError(
            f"{path}: fills {100.0 * share:.0f} % of the photographs from its front, at least {100.0 * _MIN_SHARE:.0f} % is needed"
            f"{', in any convention of the poses' if convention == AUTO else ''}; are mesh and poses of the same frame and scale, and are its "
            "triangles wound towards the room?"
        )
    name, R = _ROTATIONS[best]
    text = f"{path.name}: {len(mesh.triangles)} triangles, {name}; it fills {100.0 * share:.0f} % of the photographs"
    mesh = replace(mesh, vertices=mesh.vertices @ R.T)
    return GivenMesh(mesh, has_colors, convention_read, text)


def front_face_share(mesh: TriangleMesh, photographs: Photographs) -> float:
    """Returns the share of front-face pixels minus that of back-face pixels, mean over some photographs.

    Args:
        mesh: in the frame of the poses.
        photographs: posed photographs.
    """
    corners = mesh.corners
    normals, centres = unit_normals(corners), corners.mean(axis=1)
    shares = []
    for number in np.unique(np.linspace(0, len(photographs) - 1, _VIEW_COUNT).round().astype(int)).tolist():
        intrinsics, pose = photographs.intrinsics(number), photographs.items[number].T_world_camera
        reduced = intrinsics.resized(_VIEW_WIDTH_PX, max(round(_VIEW_WIDTH_PX * intrinsics.height / intrinsics.width), 1))
        face = rasterise(mesh, reduced, pose).face
        visible = face[face >= 0]
        is_front = np.einsum("ij,ij->i", normals[visible], pose[:3, 3] - centres[visible]) > 0.0
        shares.append((int(is_front.sum()) - int((~is_front).sum())) / face.size)
    return float(np.mean(shares))
