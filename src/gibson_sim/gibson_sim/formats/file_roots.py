"""Restricts the files that scenes, models, meshes and materials may reference.

A referenced file must, after resolving all symbolic links, lie in the package, model or scene of the referencing file, determined from the
path of the latter as given, or from its resolved path. An installation with symbolic links (``colcon build --symlink-install``, a blob store)
therefore works like one with copies, and an untrusted file cannot escape its package by an absolute path, ``..`` or a link. Imports only
``reading``.
"""

from __future__ import annotations

import os
from collections.abc import Iterable
from pathlib import Path

from gibson_sim.reading import is_file

_MARKERS = ("package.xml", "model.config", "model.sdf", "scene.yaml", "robot.yaml")
"""Files that mark the top folder of a package, a model, a scene or a robot."""
_ASSET_FOLDERS = frozenset(
    ("mesh", "meshes", "visual", "visuals", "collision", "collisions", "obj", "dae", "stl", "ply", "gltf", "glb")
)
"""Names of asset folders, lower case, that belong to the model in their parent folder, even without a marker."""
_LEVELS_UP = 8
"""Maximum number of folders above that of a file that are searched for a marker."""


def is_inside(path: Path, roots: Iterable[Path]) -> bool:
    """Returns whether a file lies below one of ``roots`` after following symbolic links; False for invalid paths (with a NUL)."""
    try:
        resolved = Path(os.path.realpath(path))
        return any(resolved.is_relative_to(os.path.realpath(root)) for root in roots)
    except (OSError, ValueError):
        return False


def find_ignoring_case(path: Path) -> Path:
    """Returns an existing path that differs from the given one only in case, else the given one.

    Files from systems with case-insensitive paths, such as Windows, may reference others in a different case.
    """
    try:
        if path.exists() or path.name in ("", "..") or path == path.parent:
            return path
        parent = find_ignoring_case(path.parent)
        return next((entry for entry in sorted(parent.iterdir()) if entry.name.lower() == path.name.lower()), path)
    except (OSError, ValueError):
        return path


def package_roots(file: Path) -> tuple[Path, ...]:
    """Returns the resolved folders that files referenced by a file may lie in: its package by its path as given, and by its resolved path.

    The package is the nearest folder above the file with a ``package.xml``, ``model.config``, ``model.sdf``, ``scene.yaml`` or
    ``robot.yaml``. Without one it is the folder of the file, or its parent if it has a name such as ``meshes``; never ``/``.
    """
    folders = (Path(os.path.realpath(file.parent)), Path(os.path.realpath(file)).parent)
    return without_file_system_root(dict.fromkeys(_package(folder) for folder in folders))


def description_roots(root: Path, file: Path) -> tuple[Path, ...]:
    """Returns the resolved folders that the files of a scene may lie in: ``root``, and the folder that it mirrors if ``file`` is a link.

    Args:
        root: folder of the scene.
        file: its description, in that folder.
    """
    real = Path(os.path.realpath(file))
    roots = (Path(os.path.realpath(root)), *without_file_system_root((mirrored_folder(root, file) or real.parent,)))
    return roots[:1] if is_inside(real, roots[:1]) else roots


def mirrored_folder(root: Path, file: Path) -> Path | None:
    """Returns the folder that ``root`` mirrors with symbolic links, derived from the target of the link ``file`` in it; None = no mirror.

    If ``root/worlds/a.world`` links to ``/src/worlds/a.world``, then ``root`` mirrors ``/src``.
    """
    real_root, real = Path(os.path.realpath(root)), Path(os.path.realpath(file))
    link = Path(os.path.realpath(file.parent)) / file.name
    if real == link or not link.is_relative_to(real_root):
        return None
    tail = link.relative_to(real_root).parts
    mirrored = Path(*real.parts[: -len(tail)])
    return mirrored if real.parts[-len(tail) :] == tail and mirrored != mirrored.parent else None


def without_file_system_root(roots: Iterable[Path]) -> tuple[Path, ...]:
    """Returns the roots without the root of the file system, which would allow all files."""
    return tuple(root for root in roots if root != root.parent)


def _package(folder: Path) -> Path:
    """Returns the package of a folder, see ``package_roots``."""
    above = (folder, *folder.parents)[: _LEVELS_UP + 1]
    marked = (
        candidate for candidate in above if candidate != candidate.parent and any(is_file(candidate / name) for name in _MARKERS)
    )
    default = folder.parent if folder.name.lower() in _ASSET_FOLDERS and folder.parent != folder.parent.parent else folder
    return next(marked, default)
