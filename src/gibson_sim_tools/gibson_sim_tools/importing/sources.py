"""Identifies the kind of scene in a file or folder."""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import dataclass
from enum import Enum
from pathlib import Path

from gibson_sim.errors import SceneError, SceneNotFoundError
from gibson_sim.formats.load_mesh import MESH_SUFFIXES
from gibson_sim.formats.ply import POINT_CLOUD_ADVICE
from gibson_sim.quoting import quoted
from gibson_sim.scenes.load import description_file, is_sdf_world
from gibson_sim.scenes.scene_yaml import DESCRIPTION
from gibson_sim.scenes.sources import check_file

USD_SUFFIXES = (".usd", ".usda", ".usdc", ".usdz")
ARCHIVE_SUFFIXES = (".zip", ".tar", ".tar.gz", ".tgz", ".tar.bz2", ".tar.xz")
POINT_SUFFIXES = (".pcd", ".xyz", ".pts", ".ptx", ".las", ".laz", ".e57", ".splat", ".spz")
MAX_BYTES = 4 * 2**30
"""Size limit of a mesh file, bytes."""
GIBSON_MESH = "mesh_z_up.obj"
_ADVICE = {
    ".blend": "export it from Blender as glTF (.glb)", ".fbx": "export it as glTF (.glb), for example with Blender",
    ".3ds": "export it as glTF (.glb), for example with Blender", ".max": "export it as glTF (.glb)",
    ".skp": "export it from SketchUp as COLLADA (.dae) or glTF (.glb)", ".ifc": "convert it to glTF, for example with IfcConvert",
    ".rvt": "export it as IFC, and that as glTF", ".wrl": "convert it to glTF, for example with MeshLab or Blender",
    ".off": "convert it to PLY or OBJ, for example with MeshLab", ".urdf": "it describes a body, not a scene: spawn it",
}  # fmt: skip


class SourceKind(Enum):
    """Kind of a source; the value is its name in messages."""

    GIBSON = "Gibson folder"
    REPLICA = "Replica folder"
    HABITAT = "Habitat scene"
    WORLD = "world file"
    USD = "USD file"
    MESH = "mesh"
    ARCHIVE = "archive"
    GIBSON_SIM = "Gibson Sim scene"


@dataclass(frozen=True, slots=True)
class Source:
    """A scene to import."""

    kind: SourceKind
    file: Path
    """Mesh, world or archive; for ``GIBSON`` and ``REPLICA`` the main mesh."""
    folder: Path
    """Folder that contains all files of the scene."""
    semantics: tuple[Path, ...] = ()
    """Labelled mesh, and the list of its classes; empty = no labels."""


def identify(path: Path) -> Source:
    """Identifies the source in a file or folder.

    Raises:
        SceneNotFoundError: the path does not exist or holds no scene.
        SceneError: this kind of source cannot be read; the message names a remedy.
    """
    if not path.exists():
        raise SceneNotFoundError(f"{path}: does not exist; give a file or a folder")
    # Files named in worlds are searched in parent folders, which a relative path, or one with `..`, does not contain.
    if path.is_dir():
        return _folder(Path(os.path.realpath(path)))
    path = Path(os.path.realpath(path.parent)) / path.name
    check_file(path, MAX_BYTES)
    return _file(path)


def _folder(path: Path) -> Source:
    if (path / DESCRIPTION).is_file():
        return Source(SourceKind.GIBSON_SIM, path / DESCRIPTION, path)
    if (path / GIBSON_MESH).is_file():
        return Source(SourceKind.GIBSON, path / GIBSON_MESH, path, _existing(path, ("semantic.obj",)))
    if (path / "layout").is_dir() and (path / "urdf").is_dir():
        raise SceneError(
            f"{path}: is an interactive iGibson scene, which is not supported: its furniture is in another data set under another licence. "
            f"Static scenes of Gibson and iGibson are supported: give a folder with {GIBSON_MESH}"
        )
    labelled = _existing(path / "habitat", ("mesh_semantic.ply", "info_semantic.json"))
    if (path / "mesh.ply").is_file() and (labelled or (path / "textures").is_dir()):
        return Source(SourceKind.REPLICA, path / "mesh.ply", path, labelled if len(labelled) == 2 else ())
    habitat = _habitat_mesh(path)
    if habitat is not None:
        return _file(habitat)
    usd = sorted(p for p in path.iterdir() if p.suffix.lower() in USD_SUFFIXES)
    if len(usd) == 1:
        return _file(usd[0])
    if len(usd) > 1:
        raise SceneError(f"{path}: holds {len(usd)} USD files, name one of them: {', '.join(p.name for p in usd[:8])}")
    return _described(description_file(path), path)


def _file(path: Path) -> Source:
    name, suffix = path.name.lower(), path.suffix.lower()
    if name.endswith(ARCHIVE_SUFFIXES):
        return Source(SourceKind.ARCHIVE, path, path.parent)
    if suffix in POINT_SUFFIXES:
        raise SceneError(f"{path}: {POINT_CLOUD_ADVICE}")
    if suffix in _ADVICE:
        raise SceneError(f"{path}: a {suffix} file cannot be read; {_ADVICE[suffix]}")
    if suffix in USD_SUFFIXES:
        return Source(SourceKind.USD, path, path.parent)
    if path.name == GIBSON_MESH or (path.name == "mesh.ply" and (path.parent / "habitat").is_dir()):
        return _folder(path.parent)
    semantics = _habitat_semantics(path)
    if semantics:
        return Source(SourceKind.HABITAT, path, path.parent, semantics)
    return _described(path, path.parent)


def _described(file: Path, folder: Path) -> Source:
    suffix = file.suffix.lower()
    if is_sdf_world(file) or file.name.lower().endswith((".dmd.yaml", ".dmd.yml")):
        return Source(SourceKind.WORLD, file, folder)
    if suffix in MESH_SUFFIXES:
        return Source(SourceKind.MESH, file, folder)
    if suffix in (".yaml", ".yml"):
        return Source(SourceKind.GIBSON_SIM, file, folder)
    known = ", ".join((*MESH_SUFFIXES, *USD_SUFFIXES, ".world", ".sdf", ".dmd.yaml", *ARCHIVE_SUFFIXES))
    raise SceneError(f"{file}: {quoted(suffix or 'no suffix')} is not a supported scene format; known: {known}")


def _existing(folder: Path, names: Sequence[str]) -> tuple[Path, ...]:
    return tuple(folder / name for name in names if (folder / name).is_file())


def _habitat_mesh(folder: Path) -> Path | None:
    """Returns the mesh in a folder with Habitat's layout: ``NAME.glb`` beside ``NAME.semantic.glb``, ``NAME.scn``, ..."""
    meshes = sorted(p for p in folder.iterdir() if p.suffix.lower() == ".glb")
    plain = [p for p in meshes if not p.name.endswith((".semantic.glb", ".basis.glb"))]
    with_labels = [p for p in plain if _habitat_semantics(p)]
    if len(with_labels) == 1:
        return with_labels[0]
    basis = [p for p in meshes if p.name.endswith(".basis.glb")]
    return basis[0] if basis and not plain else None


def _habitat_semantics(mesh: Path) -> tuple[Path, ...]:
    """Returns the labelled mesh and the class list beside a Habitat mesh; empty without them."""
    stem = os.path.splitext(mesh.name)[0].removesuffix(".basis")
    folder = mesh.parent
    for labelled, lists in (
        (f"{stem}.semantic.glb", (f"{stem}.semantic.txt",)),
        (f"{stem}_semantic.ply", (f"{stem}.scn", f"{stem}.house", "info_semantic.json")),
        ("mesh_semantic.ply", ("info_semantic.json",)),
    ):
        existing_lists = _existing(folder, lists)
        if (folder / labelled).is_file() and existing_lists and mesh.name != labelled:
            return (folder / labelled, existing_lists[0])
    return ()
