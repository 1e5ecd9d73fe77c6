"""Finds ROS packages by name, without ROS: for ``$(find <package>)`` and ``package://<package>``. Imports only ``reading`` of this package."""

from __future__ import annotations

import importlib.util
import os
import re
import tempfile
from collections import deque
from collections.abc import Iterator
from functools import lru_cache
from pathlib import Path

from gibson_sim.reading import is_file, read_file

MANIFEST = "package.xml"
"""Manifest of a ROS package."""
_WORKSPACE_SOURCES = "src"
"""Folder of the repositories in a colcon workspace."""
_LEVELS_UP = 3
"""Number of folders above the package of a file that are searched."""
_LEVELS_DOWN = 4
"""Depth to which each of these folders is searched."""
_MAX_FOLDERS = 4000
"""Maximum number of folders that a search opens."""
_SKIPPED = frozenset({"build", "log", "install", "node_modules", "__pycache__", "site-packages"})
"""Names of folders that are not searched."""
_NAME = re.compile(rb"<name>\s*([\w-]+)\s*</name>")
_MAX_MANIFEST = 65536
"""Maximum size of a manifest, bytes."""


def package_folders(package: str, beside: Path) -> Iterator[Path]:
    """Yields candidate folders of a package, the most likely first; they need not exist.

    These are: folders of that name beside the referencing file and beside its parent folders; in the repositories of the file's colcon workspace
    (``src/<repository>/<package>``); in ``$AMENT_PREFIX_PATH``; an installed Python package of that name; and packages of that name anywhere below
    the folders of ``searched_folders``.
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
            spec = importlib.util.find_spec(package)  # imports nothing, for a name without dots
        except ValueError:  # __main__
            spec = None
        yield from map(Path, (spec.submodule_search_locations or ()) if spec is not None else ())
    for folder in searched_folders(beside):
        yield from _packages_below(folder, _changed_ns(folder)).get(package, ())


def searched_folders(beside: Path) -> tuple[Path, ...]:
    """Returns the folders whose sub-folders are searched for packages, the nearest first: up to three above the package of a file.

    Excludes the root of the file system, the home folder, the folder of temporary files, and folders above the ``src`` of a workspace.
    """
    package = next((folder for folder in beside.parents if is_file(folder / MANIFEST)), None)
    above = list(beside.parents if package is None else package.parents)
    limits = {Path(above[-1]), Path.home(), Path(tempfile.gettempdir())}
    folders: list[Path] = []
    for folder in above[:_LEVELS_UP]:
        if folder in limits:
            break
        folders.append(folder)
        if folder.name == _WORKSPACE_SOURCES:
            break
    return tuple(folders)


def searched_places(beside: Path) -> str:
    """Returns the places that are searched for packages named by the file ``beside``, and a remedy, as a part of a message."""
    folders = [str(folder) for folder in searched_folders(beside)] or [str(beside.parent)]
    prefixes = os.environ.get("AMENT_PREFIX_PATH", "")
    return (
        f"{', '.join(folders)} ({_LEVELS_DOWN} levels of folders below each), "
        f"$AMENT_PREFIX_PATH ({prefixes or 'not set'}) and the Python packages; put it beside the package of {beside.name}, or source the "
        "workspace that has it"
    )


@lru_cache(maxsize=64)
def _packages_below(top: Path, changed_ns: int) -> dict[str, tuple[Path, ...]]:
    """Returns name -> packages below a folder, the nearest first; ``changed_ns``: time of change of the folder, a key of the cache only.

    A folder without a manifest counts as a package with the name of the folder, after those with a manifest.
    """
    named: dict[str, list[Path]] = {}
    unnamed: dict[str, list[Path]] = {}
    queue = deque([(top, 0)])
    opened = 0
    while queue and opened < _MAX_FOLDERS:
        folder, depth = queue.popleft()
        opened += 1
        for child in _entries(folder):
            if child.name.startswith(".") or child.name in _SKIPPED or not child.is_dir():
                continue
            name = _manifest_name(child / MANIFEST)
            if name:
                named.setdefault(name, []).append(child)
                continue  # packages do not contain packages
            unnamed.setdefault(child.name, []).append(child)
            if depth + 1 < _LEVELS_DOWN:
                queue.append((child, depth + 1))
    return {name: (*named.get(name, ()), *unnamed.get(name, ())) for name in {*named, *unnamed}}


def _manifest_name(path: Path) -> str:
    """Returns the name in a ``package.xml``; empty = no name or no file."""
    try:
        match = _NAME.search(read_file(path, _MAX_MANIFEST))
    except OSError:
        return ""
    return match[1].decode() if match else ""


def _changed_ns(folder: Path) -> int:
    try:
        return folder.stat().st_mtime_ns
    except OSError:
        return 0


def _entries(folder: Path) -> list[Path]:
    try:
        return sorted(folder.iterdir())
    except OSError:
        return []
