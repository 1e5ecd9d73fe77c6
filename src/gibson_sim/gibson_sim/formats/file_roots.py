"""Which files a file may name: the one rule for scenes, models, meshes, materials, buffers and images.

What a file names must, all symbolic links followed, lie in the folders of the file that names it: those are the package, model or
scene that it belongs to, once as the file was named and once where the file lies with its own link followed. An installation made of
links (``colcon build --symlink-install``, a store of blobs) thus works as one made of copies, and neither an absolute path nor ``..``
nor a link takes a file of strangers beyond its own package. Imports ``reading`` alone.
"""

from __future__ import annotations

import os
from collections.abc import Iterable
from pathlib import Path

from gibson_sim.reading import is_file

_MARKERS = ("package.xml", "model.config", "model.sdf", "scene.yaml", "robot.yaml")
"""Files that stand in the topmost folder of a package, a model, a scene or a robot."""
_ASSET_FOLDERS = frozenset(
    ("mesh", "meshes", "visual", "visuals", "collision", "collisions", "obj", "dae", "stl", "ply", "gltf", "glb")
)
"""Names of folders, lower case, that are a part of the model around them even where no marker says so."""
_LEVELS_UP = 8


def is_inside(path: Path, roots: Iterable[Path]) -> bool:
    """Returns whether a file, symbolic links followed, lies under one of ``roots``; what can be no path (a NUL in it) does not."""
    try:
        resolved = Path(os.path.realpath(path))
        return any(resolved.is_relative_to(os.path.realpath(root)) for root in roots)
    except (OSError, ValueError):
        return False


def in_any_case(path: Path) -> Path:
    """Returns a file or folder that is there under a name that differs in upper and lower case alone, else the path as it was named.

    Files that were made where case does not count, as on Windows, name others so.
    """
    try:
        if path.exists() or path.name in ("", "..") or path == path.parent:
            return path
        parent = in_any_case(path.parent)
        return next((entry for entry in sorted(parent.iterdir()) if entry.name.lower() == path.name.lower()), path)
    except (OSError, ValueError):
        return path


def package_roots(file: Path) -> tuple[Path, ...]:
    """Returns the folders that the companions of a file may lie in, resolved: its package as named, and where the file really lies.

    The package is the nearest folder above the file with a ``package.xml``, ``model.config``, ``model.sdf``, ``scene.yaml`` or
    ``robot.yaml``. Without one it is the file's own folder, or the one above it where that has a name such as ``meshes``. Never ``/``.
    """
    folders = (Path(os.path.realpath(file.parent)), Path(os.path.realpath(file)).parent)
    return bounded(dict.fromkeys(_package(folder) for folder in folders))


def description_roots(root: Path, file: Path) -> tuple[Path, ...]:
    """Returns the folders that the files of a scene may lie in, resolved: ``root``, and its counterpart where ``file`` is a link.

    Args:
        root: folder that holds the scene.
        file: its description, in that folder.
    """
    real = Path(os.path.realpath(file))
    roots = (Path(os.path.realpath(root)), *bounded((mirrored(root, file) or real.parent,)))
    return roots[:1] if is_inside(real, roots[:1]) else roots


def mirrored(root: Path, file: Path) -> Path | None:
    """Returns the folder that ``root`` mirrors as far as ``file`` tells, None if it does not.

    ``root/worlds/a.world`` that links to ``/src/worlds/a.world`` says that ``root`` mirrors ``/src``.
    """
    here, real = Path(os.path.realpath(root)), Path(os.path.realpath(file))
    named = Path(os.path.realpath(file.parent)) / file.name
    if real == named or not named.is_relative_to(here):
        return None
    tail = named.relative_to(here).parts
    there = Path(*real.parts[: -len(tail)])
    return there if real.parts[-len(tail) :] == tail and there != there.parent else None


def bounded(roots: Iterable[Path]) -> tuple[Path, ...]:
    """Returns the roots without the root of the file system, which would bound nothing."""
    return tuple(root for root in roots if root != root.parent)


def _package(folder: Path) -> Path:
    above = (folder, *folder.parents)[: _LEVELS_UP + 1]
    marked = (place for place in above if place != place.parent and any(is_file(place / name) for name in _MARKERS))
    beside = folder.parent if folder.name.lower() in _ASSET_FOLDERS and folder.parent != folder.parent.parent else folder
    return next(marked, beside)
