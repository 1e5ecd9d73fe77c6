"""Resolves the URIs in world files: ``model://``, ``package://``, ``file://`` and relative paths."""

from __future__ import annotations

import os
from collections.abc import Iterator
from pathlib import Path
from urllib.parse import unquote

from gibson_sim.formats.file_roots import find_ignoring_case, is_inside, mirrored_folder
from gibson_sim.reading import exists, is_folder
from gibson_sim.resources import PATH_VARIABLE

_MODEL_VARIABLES = ("GAZEBO_MODEL_PATH", "GZ_SIM_RESOURCE_PATH", "IGN_GAZEBO_RESOURCE_PATH", "SDF_PATH")
_LEVELS_UP = 3
"""Default maximum number of folders above a folder in ``ancestors``."""


def environment_folders() -> tuple[Path, ...]:
    """Returns the existing model folders of Gazebo's environment variables and of ``$GIBSON_SIM_PATH``."""
    entries = [entry for variable in _MODEL_VARIABLES for entry in _entries(variable)]
    entries += [folder for entry in _entries(PATH_VARIABLE) for folder in (entry / "models", entry / "objects", entry)]
    return tuple(dict.fromkeys(Path(os.path.realpath(e)) for e in entries if is_folder(e)))


def _entries(variable: str) -> list[Path]:
    return [Path(os.path.expanduser(entry)) for entry in os.environ.get(variable, "").split(":") if entry]


def ancestors(folder: Path, levels: int = _LEVELS_UP) -> tuple[Path, ...]:
    """Returns the folder and up to ``levels`` folders above it, without the root of the file system."""
    return tuple(p for p in (folder, *folder.parents)[: levels + 1] if p != p.parent)


def installed_paths(rest: str) -> Iterator[Path]:
    """Yields the candidate paths of ``<package>/<path>`` in the ROS installations named by the environment."""
    name, _, inner = rest.partition("/")
    for variable, package_folder in (("AMENT_PREFIX_PATH", f"share/{name}"), ("ROS_PACKAGE_PATH", name)):
        yield from (entry / package_folder / inner for entry in _entries(variable))


def is_registered(path: Path) -> bool:
    """Returns whether a file lies in a folder named by the environment, including installations with symbolic links.

    These are the model folders, and the packages in ``$AMENT_PREFIX_PATH`` and ``$ROS_PACKAGE_PATH``.
    """
    roots = list(environment_folders())
    for variable, below in (("AMENT_PREFIX_PATH", "share"), ("ROS_PACKAGE_PATH", "")):
        for folder in (entry / below for entry in _entries(variable)):
            if path.is_relative_to(folder) and path != folder:
                roots.append(folder / path.relative_to(folder).parts[0])
    return is_inside(path, roots) or any(
        is_inside(path, (mirrored,)) for root in roots if (mirrored := mirrored_folder(root, path)) is not None
    )


class UriResolver:
    """Resolves the URIs in the files of one scene.

    Args:
        root: folder of the scene.
        world: folder of the world file.
    """

    def __init__(self, root: Path, world: Path) -> None:
        self.root = root
        inside = [p for p in ancestors(world, 8) if p.is_relative_to(root)] or [world]
        self.ancestors = (*inside, *(() if root in inside else (root,)))
        local = [folder for base in self.ancestors for folder in (base / "models", base)]
        self.model_folders = tuple(dict.fromkeys([f for f in local if is_folder(f)] + list(environment_folders())))

    def find(self, uri: str, base: Path) -> Path | None:
        """Returns the file or folder at a URI, or None if it does not exist; ``base``: folder of the file with the URI."""
        candidates = dict.fromkeys(self._candidates(unquote(uri.strip()), base))
        exact = next((p for p in candidates if exists(p)), None)
        return exact or next((p for p in map(find_ignoring_case, candidates) if exists(p)), None)

    def _candidates(self, uri: str, base: Path) -> Iterator[Path]:
        scheme, separator, rest = uri.partition("://")
        scheme = scheme.lower() if separator else ""
        if scheme == "package":
            yield from self._package(rest)
        elif scheme == "model":
            yield from (folder / rest.lstrip("/") for folder in self.model_folders)
            yield from installed_paths(rest.lstrip("/"))
        elif scheme == "file":
            if rest.startswith("/"):
                yield Path(rest)
            yield from (folder / rest.lstrip("/").removeprefix("models/") for folder in self.model_folders)
            yield base / rest.lstrip("/")
        elif not scheme:
            yield base / uri
            yield from (folder / uri.removeprefix("models/") for folder in self.model_folders)

    def _package(self, rest: str) -> Iterator[Path]:
        name, _, inner = rest.partition("/")
        yield from installed_paths(rest)
        yield from (folder / inner for folder in self.ancestors if folder.name == name)
        # The package is not installed, but the scene may contain a part of it: try shorter and shorter ends of the path.
        parts = [p for p in inner.split("/") if p]
        for start in range(len(parts)):
            yield from (folder.joinpath(name, *parts[start:]) for folder in self.ancestors if start == 0)
            yield from (folder.joinpath(*parts[start:]) for folder in self.ancestors)
