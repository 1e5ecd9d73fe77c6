"""Finds ROS packages by name, without ROS: for ``$(find <package>)`` and ``package://<package>``. Imports nothing of the package but ``reading``."""

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
"""File that makes a folder a ROS package."""
_WORKSPACE_SOURCES = "src"
"""Folder of the repositories in a colcon workspace."""
_LEVELS_UP = 3
"""Folders above the package of a file that are searched."""
_LEVELS_DOWN = 4
"""Levels of folders below each of those that are searched."""
_MAX_FOLDERS = 4000
"""Folders that a search opens at most."""
_SKIPPED = frozenset({"build", "log", "install", "node_modules", "__pycache__", "site-packages"})
"""Folders that hold no sources of packages."""
_NAME = re.compile(rb"<name>\s*([\w-]+)\s*</name>")
_MAX_MANIFEST = 65536
"""Largest manifest that is read, bytes."""


def package_folders(package: str, beside: Path) -> Iterator[Path]:
    """Yields possible folders of a package, the likeliest first; they need not exist.

    They are beside the file that names it and in the folders above it; in the repositories of the file's colcon workspace
    (``src/<repository>/<package>``); in ``$AMENT_PREFIX_PATH``; an installed Python package of that name; and last, packages of that name below the
    folders of ``searched_folders``, in whatever repository.
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
    for folder in searched_folders(beside):
        yield from _packages_below(folder, _changed_ns(folder)).get(package, ())


def searched_folders(beside: Path) -> tuple[Path, ...]:
    """Returns the folders whose sub-folders are searched for packages, the nearest first: up to three above the package of a file.

    The root of the file system, the home folder and that of temporary files are not searched, nor is what is above the ``src`` of a workspace.
    """
    own = next((folder for folder in beside.parents if is_file(folder / MANIFEST)), None)
    above = list(beside.parents if own is None else own.parents)
    limits = {Path(above[-1]), Path.home(), Path(tempfile.gettempdir())}
    found: list[Path] = []
    for folder in above[:_LEVELS_UP]:
        if folder in limits:
            break
        found.append(folder)
        if folder.name == _WORKSPACE_SOURCES:
            break
    return tuple(found)


def where_looked(beside: Path) -> str:
    """Returns where packages that the file ``beside`` names are looked for, as a part of a message, and what to do."""
    places = [str(folder) for folder in searched_folders(beside)] or [str(beside.parent)]
    prefixes = os.environ.get("AMENT_PREFIX_PATH", "")
    return (
        f"{', '.join(places)} ({_LEVELS_DOWN} levels of folders below each), "
        f"$AMENT_PREFIX_PATH ({prefixes or 'not set'}) and the Python packages; put it beside the package of {beside.name}, or source the "
        "workspace that has it"
    )


@lru_cache(maxsize=64)
def _packages_below(top: Path, changed_ns: int) -> dict[str, tuple[Path, ...]]:
    """Returns the packages below a folder by their names, the nearest first; ``changed_ns`` only tells states of the folder apart.

    A folder without a manifest counts as a package of its own name, after those that have one.
    """
    named: dict[str, list[Path]] = {}
    unnamed: dict[str, list[Path]] = {}
    waiting = deque([(top, 0)])
    opened = 0
    while waiting and opened < _MAX_FOLDERS:
        folder, depth = waiting.popleft()
        opened += 1
        for inside in _entries(folder):
            if inside.name.startswith(".") or inside.name in _SKIPPED or not inside.is_dir():
                continue
            name = _manifest_name(inside / MANIFEST)
            if name:
                named.setdefault(name, []).append(inside)
                continue  # packages do not contain packages
            unnamed.setdefault(inside.name, []).append(inside)
            if depth + 1 < _LEVELS_DOWN:
                waiting.append((inside, depth + 1))
    return {name: (*named.get(name, ()), *unnamed.get(name, ())) for name in {*named, *unnamed}}


def _manifest_name(path: Path) -> str:
    """Returns the name in a ``package.xml``; empty = there is none."""
    try:
        found = _NAME.search(read_file(path, _MAX_MANIFEST))
    except OSError:
        return ""
    return found[1].decode() if found else ""


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
