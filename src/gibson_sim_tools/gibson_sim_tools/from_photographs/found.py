"""What a folder of photographs holds: posed photographs, depth images, a mesh."""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from gibson_sim.formats.load_mesh import MESH_SUFFIXES
from gibson_sim.reading import is_file, is_folder
from gibson_sim_tools.from_photographs.depth_frames import depth_frames
from gibson_sim_tools.importing.sources import USD_SUFFIXES
from gibson_sim_tools.photographs.layouts import open_photographs
from gibson_sim_tools.photographs.phone_layouts import find_record3d_images
from gibson_sim_tools.photographs.photographs import Photographs
from gibson_sim_tools.scanning.layouts import LAYOUTS, open_posed_rgbd
from gibson_sim_tools.scanning.posed_rgbd import PosedRgbd, ScanError

_IMAGES = (".jpg", ".jpeg", ".png")
_UNREADABLE = (".heic", ".heif", ".dng", ".mov", ".mp4")
"""What phones write beside JPEG."""
_IMAGE_FOLDERS = (
    "",
    "images",
    "image",
    "color",
    "rgb",
    "rgbd",
    "EXR_RGBD/rgb",
    "keyframes/images",
    "keyframes/corrected_images",
    "dense/images",
)
_SIGNS = (
    "transforms.json", "sparse", "dense/sparse", "colmap/sparse", "cameras.txt", "cameras.bin", "images.txt", "images.bin", "keyframes",
    "trajectory.log", "groundtruth.txt", "scan.json",
)  # fmt: skip
"""Files and folders of poses: what has one is a folder of photographs, although a mesh lies beside them."""
_MESH_FOLDERS = ("", "dense", "dense/0", "mesh", "meshes", "exports", "exports/mesh")
"""Where programs put the mesh."""
_FIRST = ("mesh.ply", "mesh.glb", "mesh.obj", "raw.glb", "poisson_mesh.ply", "meshed-poisson.ply", "meshed-delaunay.ply")
"""Names that are taken before others."""
_FACES = re.compile(rb"element\s+face\s+(\d+)")
_HEADER_BYTES = 64 * 1024
_SHOWN = 6


@dataclass(frozen=True, slots=True, eq=False)
class Found:
    """What is in a folder of photographs."""

    photographs: Photographs
    rgbd: PosedRgbd | None
    """What is to be fused; None = a mesh is there."""
    mesh: Path | None
    """The mesh to texture; None = it is to be fused from depth."""

    def lines(self) -> list[str]:
        """Returns what was found, for people."""
        sizes = sorted(
            {(camera.intrinsics.width, camera.intrinsics.height) for camera in {item.camera for item in self.photographs.items}}
        )
        size = ", ".join(f"{w}x{h}" for w, h in sizes[:_SHOWN]) + (", ..." if len(sizes) > _SHOWN else "")
        count = len(self.photographs)
        deep = sum(item.depth is not None for item in self.photographs.items)
        depth = "without depth" if not deep else "with depth" if deep == count else f"{deep} of them with depth"
        first = f"{count} photograph{'' if count == 1 else 's'} of {size} pixels, with poses, {depth} (layout: {self.photographs.layout})"
        return [first, "no mesh: it will be fused from depth" if self.mesh is None else f"mesh: {self.mesh}"]


def is_of_photographs(folder: Path) -> bool:
    """Returns whether a folder is one of photographs, and not of a scene or a mesh with its textures."""
    if not is_folder(folder) or is_file(folder / "scene.yaml"):
        return False
    if any((folder / sign).exists() for sign in _SIGNS) or any(layout.looks_like(folder) for layout in LAYOUTS):
        return True
    if find_record3d_images(folder) is not None:
        return True
    known = (*MESH_SUFFIXES, *USD_SUFFIXES, ".world", ".sdf", ".dmd.yaml")
    if any(p.name.lower().endswith(known) for p in folder.iterdir()):
        return False
    return any(True for _ in _images(folder, (*_IMAGES, *_UNREADABLE)))


def find(folder: Path, mesh: Path | None, *, fuse: bool, longest_side: int, leave_out: Path) -> Found:
    """Returns what a folder of photographs holds.

    Args:
        folder: the folder.
        mesh: the mesh to use; None = one in the folder, else it is fused from depth.
        fuse: fuse a mesh although one is there.
        longest_side: longest side to which photographs are scaled down, pixels; 0 = full size.
        leave_out: folder in which no mesh is looked for, since the scene is written there.

    Raises:
        ScanError: there are no photographs, no poses, or neither depth nor a mesh; the message says what is missing.
    """
    if not any(True for _ in _images(folder, _IMAGES)) and not any((folder / sign).exists() for sign in _SIGNS):
        other = next(_images(folder, _UNREADABLE), None)
        raise ScanError(
            f"{folder}: has no photograph that can be read (.jpg, .png)"
            + (f", but {other.name}: convert it to JPEG first" if other is not None else "; give the folder of the export")
        )
    photographs = open_photographs(folder, longest_side)
    chosen = mesh if mesh is not None or fuse else _mesh_in(folder, leave_out)
    if chosen is not None:
        if not is_file(chosen):
            raise ScanError(f"--mesh {chosen}: is not a file; give the mesh of the scan")
        return Found(photographs, None, chosen)
    is_rgbd = photographs.layout in {layout.name for layout in LAYOUTS}
    rgbd = open_posed_rgbd(folder) if is_rgbd else depth_frames(photographs)
    if rgbd is None:
        raise ScanError(
            f"{folder}: has {len(photographs)} photographs with poses ({photographs.layout}), but neither depth images that can be fused nor a "
            "mesh; export the mesh, too, or make one (colmap poisson_mesher, ns-export poisson), and give it with --mesh FILE"
        )
    return Found(photographs, rgbd, None)


def _images(folder: Path, suffixes: tuple[str, ...]) -> Iterator[Path]:
    for name in _IMAGE_FOLDERS:
        if is_folder(folder / name):
            yield from (p for p in sorted((folder / name).iterdir()) if p.suffix.lower() in suffixes)


def _mesh_in(folder: Path, leave_out: Path) -> Path | None:
    """Returns the mesh in a folder of photographs.

    Raises:
        ScanError: there are several.
    """
    places = [folder / name for name in _MESH_FOLDERS if is_folder(folder / name)]
    if not folder.resolve().is_relative_to(leave_out.resolve()):
        places = [p for p in places if not p.resolve().is_relative_to(leave_out.resolve())]
    for place in places:
        for name in _FIRST:
            if is_file(place / name) and _has_triangles(place / name):
                return place / name
    meshes = [p for place in places for p in sorted(place.iterdir()) if p.suffix.lower() in MESH_SUFFIXES and _has_triangles(p)]
    if len(meshes) > 1:
        named = ", ".join(str(p.relative_to(folder)) for p in meshes[:_SHOWN])
        raise ScanError(f"{folder}: holds {len(meshes)} meshes ({named}); say with --mesh FILE which one, or --fuse")
    return meshes[0] if meshes else None


def _has_triangles(path: Path) -> bool:
    """Returns whether a file may be a mesh: PLY holds clouds of points, too."""
    if path.suffix.lower() != ".ply":
        return True
    with path.open("rb") as file:
        faces = _FACES.search(file.read(_HEADER_BYTES).split(b"end_header")[0])
    return faces is not None and int(faces[1]) > 0
