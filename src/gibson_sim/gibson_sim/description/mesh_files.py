"""Resolves the mesh files that a robot's description names. Pure."""

from __future__ import annotations

import os
from pathlib import Path
from urllib.parse import unquote

from gibson_sim.description.packages import package_folders
from gibson_sim.reading import is_file

PACKAGE_SCHEME = "package://"
_FILE_SCHEME = "file://"
_LEVELS_UP = 3
"""Maximum number of folders above that of a URDF in which relative names are looked up."""


def resolve_mesh(name: str, urdf: Path) -> Path | None:
    """Returns the absolute path of the mesh that a URDF names, or None if the file does not exist.

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
