"""Finds the inputs of an import in a folder of photographs: posed photographs, depth images, a mesh.

Scanning apps export such folders as ZIP archives, which are unpacked.
"""

from __future__ import annotations

import re
import shutil
import tempfile
import zipfile
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from gibson_sim.formats.load_mesh import MESH_SUFFIXES
from gibson_sim.reading import is_file, is_folder
from gibson_sim.scenes.scene_yaml import DESCRIPTION
from gibson_sim.writing import cannot_write
from gibson_sim_tools.importing.fetching.archives import only_folder, unpack
from gibson_sim_tools.importing.sources import USD_SUFFIXES
from gibson_sim_tools.photographs.layouts import open_photographs
from gibson_sim_tools.photographs.phone_layouts import find_record3d_images
from gibson_sim_tools.scanning.layouts import LAYOUTS, open_posed_rgbd
from gibson_sim_tools.scanning.posed_images import Photographs, PosedRgbd, ScanError, rgbd_of

_IMAGE_SUFFIXES = (".jpg", ".jpeg", ".png")
_UNSUPPORTED_SUFFIXES = (".heic", ".heif", ".dng", ".mov", ".mp4")
"""Formats of phones that are not supported."""
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
_POSE_ENTRIES = (
    "transforms.json", "sparse", "dense/sparse", "colmap/sparse", "cameras.txt", "cameras.bin", "images.txt", "images.bin", "keyframes",
    "trajectory.log", "groundtruth.txt", "scan.json",
)  # fmt: skip
"""Files and folders that hold poses; one of them marks a folder of photographs, also beside a mesh."""
_MESH_FOLDERS = ("", "dense", "dense/0", "mesh", "meshes", "exports", "exports/mesh")
"""Folders in which programs write the mesh."""
_PREFERRED_MESHES = (
    "mesh.ply",
    "mesh.glb",
    "mesh.obj",
    "raw.glb",
    "poisson_mesh.ply",
    "meshed-poisson.ply",
    "meshed-delaunay.ply",
)
"""Names of meshes with priority."""
_FACE_COUNT = re.compile(rb"element\s+face\s+(\d+)")
_HEADER_BYTES = 64 * 1024
_MAX_LISTED = 6
_POSE_FILES = ("transforms.json", "trajectory.log", "groundtruth.txt", "images.txt", "images.bin", "scan.json")
"""Names of files that hold poses."""
_EXPORT_FOLDERS = ("keyframes", "rgbd", "EXR_RGBD")
"""Names of folders of photographs in exports of apps."""


@dataclass(frozen=True, slots=True, eq=False)
class PhotographInputs:
    """Inputs of an import from photographs."""

    photographs: Photographs
    rgbd: PosedRgbd | None
    """Frames to fuse; None = ``mesh`` is used."""
    mesh: Path | None
    """Mesh to texture; None = it is fused from ``rgbd``."""

    def lines(self) -> list[str]:
        """Returns a summary as text, one line per input."""
        sizes = sorted(
            {(camera.intrinsics.width, camera.intrinsics.height) for camera in {item.camera for item in self.photographs.items}}
        )
        size = ", ".join(f"{w}x{h}" for w, h in sizes[:_MAX_LISTED]) + (", ..." if len(sizes) > _MAX_LISTED else "")
        count = len(self.photographs)
        with_depth = sum(item.depth is not None for item in self.photographs.items)
        depth = "without depth" if not with_depth else "with depth" if with_depth == count else f"{with_depth} of them with depth"
        first = f"{count} photograph{'' if count == 1 else 's'} of {size} pixels, with poses, {depth} (layout: {self.photographs.layout})"
        return [first, "no mesh: it will be fused from depth" if self.mesh is None else f"mesh: {self.mesh}"]


def is_photograph_folder(folder: Path) -> bool:
    """Returns whether a folder holds photographs, rather than a scene or a mesh with its textures."""
    if not is_folder(folder) or is_file(folder / DESCRIPTION):
        return False
    if any((folder / sign).exists() for sign in _POSE_ENTRIES) or any(layout.recognises(folder) for layout in LAYOUTS):
        return True
    if find_record3d_images(folder) is not None:
        return True
    known = (*MESH_SUFFIXES, *USD_SUFFIXES, ".world", ".sdf", ".dmd.yaml")
    if any(p.name.lower().endswith(known) for p in folder.iterdir()):
        return False
    return any(True for _ in _image_files(folder, (*_IMAGE_SUFFIXES, *_UNSUPPORTED_SUFFIXES)))


def find_inputs(
    folder: Path, mesh: Path | None, *, fuse: bool, longest_side: int, excluded: Path,
    focal: tuple[float, float, float, float] | None = None, depth_scale: float | None = None,
) -> PhotographInputs:  # fmt: skip
    """Returns the inputs in a folder of photographs.

    Args:
        folder: the folder.
        mesh: mesh to use; None = the one in the folder, or fuse one from depth.
        fuse: fuse a mesh from depth even if the folder holds one.
        longest_side: longest side to which photographs are scaled down, pixels; 0 = full size.
        excluded: folder that is not searched for meshes: the output.
        focal: fx, fy, cx, cy in pixels; replaces the value of a folder of posed RGB-D.
        depth_scale: units of the depth images per metre; replaces the value of the folder.

    Raises:
        ScanError: there are no photographs, no poses, or neither depth nor a mesh; the message says what is missing.
    """
    if not any(True for _ in _image_files(folder, _IMAGE_SUFFIXES)) and not any(
        (folder / sign).exists() for sign in _POSE_ENTRIES
    ):
        unsupported = next(_image_files(folder, _UNSUPPORTED_SUFFIXES), None)
        raise ScanError(
            f"{folder}: has no photograph that can be read (.jpg, .png)"
            + (
                f", but {unsupported.name}: convert it to JPEG first"
                if unsupported is not None
                else "; give the folder of the export"
            )
        )
    photographs = open_photographs(folder, longest_side, focal=focal, depth_scale=depth_scale)
    mesh_file = mesh if mesh is not None or fuse else _find_mesh(folder, excluded)
    if mesh_file is not None:
        if not is_file(mesh_file):
            raise ScanError(f"--mesh {mesh_file}: is not a file; give the mesh of the scan")
        return PhotographInputs(photographs, None, mesh_file)
    is_rgbd = photographs.layout in {layout.name for layout in LAYOUTS}
    rgbd = open_posed_rgbd(folder, focal=focal, depth_scale=depth_scale) if is_rgbd else rgbd_of(photographs)
    if rgbd is None:
        raise ScanError(
            f"{folder}: has {len(photographs)} photographs with poses ({photographs.layout}), but neither depth images that can be fused nor a "
            "mesh; export the mesh, too, or make one (colmap poisson_mesher, ns-export poisson), and give it with --mesh FILE"
        )
    return PhotographInputs(photographs, rgbd, None)


def _image_files(folder: Path, suffixes: tuple[str, ...]) -> Iterator[Path]:
    for name in _IMAGE_FOLDERS:
        if is_folder(folder / name):
            yield from (p for p in sorted((folder / name).iterdir()) if p.suffix.lower() in suffixes)


def _find_mesh(folder: Path, excluded: Path) -> Path | None:
    """Returns the mesh in a folder of photographs; None = there is none.

    Raises:
        ScanError: there are several, and none has a name with priority.
    """
    folders = [folder / name for name in _MESH_FOLDERS if is_folder(folder / name)]
    if not folder.resolve().is_relative_to(excluded.resolve()):
        folders = [p for p in folders if not p.resolve().is_relative_to(excluded.resolve())]
    for place in folders:
        for name in _PREFERRED_MESHES:
            if is_file(place / name) and _has_triangles(place / name):
                return place / name
    meshes = [p for place in folders for p in sorted(place.iterdir()) if p.suffix.lower() in MESH_SUFFIXES and _has_triangles(p)]
    if len(meshes) > 1:
        named = ", ".join(str(p.relative_to(folder)) for p in meshes[:_MAX_LISTED])
        raise ScanError(f"{folder}: holds {len(meshes)} meshes ({named}); say with --mesh FILE which one, or --fuse")
    return meshes[0] if meshes else None


def _has_triangles(path: Path) -> bool:
    """Returns whether a file may be a triangle mesh rather than a point cloud, by the header of a PLY."""
    if path.suffix.lower() != ".ply":
        return True
    with path.open("rb") as file:
        faces = _FACE_COUNT.search(file.read(_HEADER_BYTES).split(b"end_header")[0])
    return faces is not None and int(faces[1]) > 0


def is_photograph_archive(path: Path) -> bool:
    """Returns whether a file is a ZIP of posed photographs, by the names of its members."""
    if path.suffix.lower() != ".zip" or not is_file(path):
        return False
    try:
        with zipfile.ZipFile(path) as archive:
            names = [Path(name).parts for name in archive.namelist()]
    except (OSError, ValueError, NotImplementedError, zipfile.BadZipFile):
        return False  # the next reader reports the error
    return any(parts and (parts[-1] in _POSE_FILES or any(part in _EXPORT_FOLDERS for part in parts[:-1])) for parts in names)


def unpack_photographs(archive: Path, folder: Path) -> Path:
    """Returns the folder of photographs of an archive; unpacks it into ``folder`` unless that exists.

    Raises:
        SceneError: it is broken, too large, or holds names that leave the folder.
        WriteError: it cannot be written.
    """
    if not folder.is_dir():
        try:
            folder.parent.mkdir(parents=True, exist_ok=True)
            temporary = Path(tempfile.mkdtemp(prefix=f".{folder.name}.", dir=folder.parent))
        except OSError as error:
            raise cannot_write(folder, error) from error
        try:
            unpack(archive, temporary / "content")
            (temporary / "content").rename(folder)
        finally:
            shutil.rmtree(temporary, ignore_errors=True)
    return only_folder(folder)
