"""The rule for the files that a file may name, for scenes, models, meshes, materials, buffers and images.

A file that another one names must, after following all symbolic links, lie in the package, model or scene of the naming file: that around
its path as given, or that around its path after following its own link. An installation by links (``colcon build --symlink-install``, a
store of blobs) therefore works like one by copies, and neither an absolute path nor ``..`` nor a link takes an untrusted file out of its
package. Imports ``reading`` alone.
"""

from __future__ import annotations

import os
from collections.abc import Iterable
from pathlib import Path

from gibson_sim.reading import is_file

_MARKERS = ("package.xml", "model.config", "model.sdf", "scene.yaml", "robot.yaml")
"""Files in the topmost folder of a package, a model, a scene or a robot."""
_ASSET_FOLDERS = frozenset(
    ("mesh", "meshes", "visual", "visuals", "collision", "collisions", "obj", "dae", "stl", "ply", "gltf", "glb")
)
"""Names of folders, lower case, that belong to the model around them even without a marker there."""
_LEVELS_UP = 8
"""Folders above a file that are searched for a marker."""


def is_inside(path: Path, roots: Iterable[Path]) -> bool:
    """Returns whether a file lies below one of ``roots`` after following symbolic links; False for invalid paths (a NUL in them)."""
    try:
        resolved = Path(os.path.realpath(path))
        return any(resolved.is_relative_to(os.path.realpath(root)) for root in roots)
    except (OSError, ValueError):
        return False


def in_any_case(path: Path) -> Path:
    """Returns an existing path that differs from the given one in upper and lower case alone, else the given one.

    Files from systems that ignore case, such as Windows, name others in any case.
    """
    try:
        if path.exists() or path.name in ("", "..") or path == path.parent:
            return path
        parent = in_any_case(path.parent)
        return next((entry for entry in sorted(parent.iterdir()) if entry.name.lower() == path.name.lower()), path)
    except (OSError, ValueError):
        return path


def package_roots(file: Path) -> tuple[Path, ...]:
    """Returns the resolved folders that files named by a file may lie in: its package by its path as given, and by its resolved path.

    The package is the nearest folder above the file with a ``package.xml``, ``model.config``, ``model.sdf``, ``scene.yaml`` or
    ``robot.yaml``. Without one it is the file's own folder, or the one above that if it has a name such as ``meshes``; never ``/``.
    """
    folders = (Path(os.path.realpath(file.parent)), Path(os.path.realpath(file)).parent)
    return bounded(dict.fromkeys(_package(folder) for folder in folders))


def description_roots(root: Path, file: Path) -> tuple[Path, ...]:
    """Returns the resolved folders that the files of a scene may lie in: ``root``, and the folder it mirrors if ``file`` is a link.

    Args:
        root: folder of the scene.
        file: its description, in that folder.
    """
    real = Path(os.path.realpath(file))
    roots = (Path(os.path.realpath(root)), *bounded((mirrored(root, file) or real.parent,)))
    return roots[:1] if is_inside(real, roots[:1]) else roots


def mirrored(root: Path, file: Path) -> Path | None:
    """Returns the folder that ``root`` mirrors, by the target of the link ``file`` in it; None if it mirrors none.

    If ``root/worlds/a.world`` links to ``/src/worlds/a.world``, then ``root`` mirrors ``/src``.
    """
    here, real = Path(os.path.realpath(root)), Path(os.path.realpath(file))
    named = Path(os.path.realpath(file.parent)) / file.name
    if real == named or not named.is_relative_to(here):
        return None
    tail = named.relative_to(here).parts
    there = Path(*real.parts[: -len(tail)])
    return there if real.parts[-len(tail) :] == tail and there != there.parent else None


def bounded(roots: Iterable[Path]) -> tuple[Path, ...]:
    """Returns the roots without the root of the file system, which would allow every file."""
    return tuple(root for root in roots if root != root.parent)


def _package(folder: Path) -> Path:
    """Returns the package that a folder belongs to, see ``package_roots``."""
    above = (folder, *folder.parents)[: _LEVELS_UP + 1]
    marked = (place for place in above if place != place.parent and any(is_file(place / name) for name in _MARKERS))
    beside = folder.parent if folder.name.lower() in _ASSET_FOLDERS and folder.parent != folder.parent.parent else folder
    return next(marked, beside)
