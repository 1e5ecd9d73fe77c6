"""Finds the files that a robot's description names. Pure."""

from __future__ import annotations

import importlib.util
import os
from collections.abc import Iterator
from pathlib import Path
from urllib.parse import unquote

from gibson_sim.reading import is_file

PACKAGE_SCHEME = "package://"
_FILE_SCHEME = "file://"
_WORKSPACE_SOURCES = "src"
"""Folder of the repositories in a colcon workspace."""
_LEVELS_UP = 3
"""Folders above that of a URDF in which relative names are looked up."""


def resolve_mesh(name: str, urdf: Path) -> Path | None:
    """Returns the absolute path of the mesh that a URDF names, or None if there is no such file.

    ``package://<package>/<rest>`` is looked up in the folders of ``package_folders``; other names are relative to the URDF's
    folder, or to one of the three above it.
    """
    if name.startswith(_FILE_SCHEME):
        name = unquote(name[len(_FILE_SCHEME) :])
    if not name.startswith(PACKAGE_SCHEME):
        above = [folder for folder in urdf.parents[1 : _LEVELS_UP + 1] if folder != folder.parent]
        paths = (Path(os.path.normpath(folder / name)) for folder in (urdf.parent, *above))
        return next((path for path in paths if is_file(path)), None)
    package, _, rest = name[len(PACKAGE_SCHEME) :].partition("/")
    return next((folder / rest for folder in package_folders(package, urdf) if is_file(folder / rest)), None)


def package_folders(package: str, beside: Path) -> Iterator[Path]:
    """Yields possible folders of a package, the likeliest first; they need not exist.

    They are beside the file that names it and in the folders above it; in the repositories of the file's colcon workspace
    (``src/<repository>/<package>``); in ``$AMENT_PREFIX_PATH``; an installed Python package of that name.
    """
    for folder in beside.parents:
        if folder.name == package:
            yield folder
        yield folder / package
        if folder.name == _WORKSPACE_SOURCES:
            yield from (repository / package for repository in _entries(folder))
    for prefix in os.environ.get("AMENT_PREFIX_PATH", "").split(os.pathsep):
        if prefix:
            yield Path(prefix) / "share" / package
    if package.isidentifier():
        try:
            found = importlib.util.find_spec(package)  # imports nothing, for a name without dots
        except ValueError:  # __main__
            found = None
        yield from map(Path, (found.submodule_search_locations or ()) if found is not None else ())


def _entries(folder: Path) -> list[Path]:
    try:
        return sorted(folder.iterdir())
    except OSError:
        return []
