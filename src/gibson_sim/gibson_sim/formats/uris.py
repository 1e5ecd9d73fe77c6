"""Resolves the URIs in world files: ``model://``, ``package://``, ``file://``, relative paths, and models of Gazebo Fuel (``https://``)."""

from __future__ import annotations

import os
import re
import shlex
from collections.abc import Iterator
from pathlib import Path
from urllib.parse import unquote

from gibson_sim.formats.file_roots import find_ignoring_case, is_inside, mirrored_folder
from gibson_sim.reading import exists, is_folder
from gibson_sim.resources import PATH_VARIABLE

_MODEL_VARIABLES = ("GAZEBO_MODEL_PATH", "GZ_SIM_RESOURCE_PATH", "IGN_GAZEBO_RESOURCE_PATH", "SDF_PATH")
_FUEL_CACHES = (("GZ_FUEL_CACHE_PATH", "~/.gz/fuel"), ("IGN_FUEL_CACHE_PATH", "~/.ignition/fuel"))
"""Environment variable and default folder of the models that Gazebo has downloaded from Fuel."""
_FUEL_URL = re.compile(r"https?://([^/]+)/[^/]+/([^/]+)/models/([^/]+)(?:/([^/]+))?(?:/files)?(?:/(.*))?", re.IGNORECASE)
"""URL of a model on Fuel: server, owner, name, version (a number or "tip"), and path of a file in it."""
_LEVELS_UP = 3
"""Default maximum number of folders above a folder in ``ancestors``."""


def environment_folders() -> tuple[Path, ...]:
    """Returns the existing model folders of Gazebo's environment variables and of ``$GIBSON_SIM_PATH``."""
    entries = [entry for variable in _MODEL_VARIABLES for entry in _entries(variable)]
    entries += [folder for entry in _entries(PATH_VARIABLE) for folder in (entry / "models", entry / "objects", entry)]
    return tuple(dict.fromkeys(Path(os.path.realpath(e)) for e in (*entries, *fuel_caches()) if is_folder(e)))


def fuel_caches() -> tuple[Path, ...]:
    """Returns the existing folders of the models that Gazebo has downloaded."""
    folders = (Path(os.path.expanduser(os.environ.get(variable) or default)) for variable, default in _FUEL_CACHES)
    return tuple(folder for folder in folders if is_folder(folder))


def cached_models(uri: str) -> Iterator[Path]:
    """Yields the copies, in Gazebo's caches, of the model or file at a URI: ``model://`` or the URL of a model on Fuel."""
    scheme, _, rest = uri.partition("://")
    found = _FUEL_URL.fullmatch(uri)
    if found is not None:
        yield from _cached(*((part or "") for part in found.groups()))
    elif scheme.lower() == "model" and rest.strip("/"):
        name, _, inner = rest.lstrip("/").partition("/")
        yield from _cached("*", "*", name, inner=inner)


def fuel_model(uri: str) -> str:
    """Returns the URL of the model on Fuel that a URI names, or that has the file that it names, with its version; "" for other URIs."""
    found = _FUEL_URL.fullmatch(uri)
    if found is None:
        return ""
    last = found.start(5) if found[5] is not None else len(uri)
    return re.sub(r"(/files)?/?$", "", uri[:last], flags=re.IGNORECASE)


def missing_from_cache(uri: str) -> str:
    """Returns what to do about a model of Fuel that is in none of Gazebo's caches, as the end of a sentence; "" for other URIs."""
    model = fuel_model(unquote(uri))
    if not model:
        return ""
    folder = next((str(folder) for folder in fuel_caches()), _FUEL_CACHES[0][1])
    return f"is not in Gazebo's cache, {folder}: download it with `gz fuel download -u {shlex.quote(model)}`"


def _cached(server: str, owner: str, name: str, version: str = "", inner: str = "") -> Iterator[Path]:
    """Yields the copies of a model in Gazebo's caches: those of the given version, else the one of the highest version.

    Args:
        server: host name; "*" = any.
        owner: owner of the model; "*" = any.
        name: name of the model; Gazebo stores it in lower case.
        version: number of the version; another text means the highest.
        inner: path of a file in the model; empty = its folder.
    """
    for cache in fuel_caches():
        wanted = [text.lower() for text in (server, owner, "models", name)]
        for folder in _below(cache, wanted):
            numbers = sorted((int(v.name) for v in _entries_of(folder) if v.name.isdecimal()), reverse=True)
            chosen = [int(version)] if version.isdecimal() else numbers[:1]
            yield from (folder / str(number) / inner for number in chosen if number in numbers)


def _below(folder: Path, names: list[str]) -> Iterator[Path]:
    """Yields the folders at a path of lower-case names, ignoring case; "*" = any name."""
    if not names:
        yield folder
        return
    for entry in _entries_of(folder):
        if names[0] in ("*", entry.name.lower()):
            yield from _below(entry, names[1:])


def _entries_of(folder: Path) -> list[Path]:
    try:
        return sorted(folder.iterdir())
    except OSError:
        return []


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

    def reason_missing(self, uri: str) -> str:
        """Returns why ``find`` does not find a URI, and what to do, as the end of a sentence."""
        elsewhere = "is on the network: download it and name the copy" if uri.startswith("http") else "does not exist"
        return missing_from_cache(uri) or elsewhere

    def _candidates(self, uri: str, base: Path) -> Iterator[Path]:
        scheme, separator, rest = uri.partition("://")
        scheme = scheme.lower() if separator else ""
        if scheme == "package":
            yield from self._package(rest)
        elif scheme == "model":
            yield from (folder / rest.lstrip("/") for folder in self.model_folders)
            yield from installed_paths(rest.lstrip("/"))
            yield from cached_models(uri)
        elif scheme in ("http", "https"):
            yield from cached_models(uri)
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
