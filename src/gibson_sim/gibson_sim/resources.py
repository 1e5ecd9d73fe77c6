"""Finds scenes, configuration files and other data by name, and cache folders.

A name that starts with ``/``, ``./``, ``../`` or ``~`` is a path. Any other name is searched in this order: below every folder of
``$GIBSON_SIM_PATH`` (separated by colons); in the ROS installations of ``$AMENT_PREFIX_PATH``; where pip has installed this package
(``<prefix>/share/gibson_sim``), and in the Python installation; in the source tree of an editable installation; in the current folder.
Imports only ``errors``, ``quoting`` and ``reading``.
"""

from __future__ import annotations

import difflib
import os
import sys
from collections.abc import Iterator, Sequence
from pathlib import Path

from gibson_sim.errors import ConfigError, GibsonSimError, RobotError, SceneNotFoundError
from gibson_sim.quoting import quoted
from gibson_sim.reading import exists, is_file, is_folder, real_path

PACKAGE = "gibson_sim"
PATH_VARIABLE = "GIBSON_SIM_PATH"
FOLDER_TIME = "%Y-%m-%d_%H-%M-%S"
"""strftime format of the names of folders that get results when the user names none."""
_CONFIG_SUFFIXES = ("", ".yaml", ".yml", ".param.yaml")
_OBJECTS = "objects"
"""Folder of objects beside the scenes, which is not a scene."""


def share_folders() -> tuple[Path, ...]:
    """Returns the existing folders that may contain ``scenes/``, ``config/``, ``robots/`` and ``objects/``, in order of precedence."""
    candidates = [Path(os.path.expanduser(entry)) for entry in os.environ.get(PATH_VARIABLE, "").split(":") if entry]
    prefixes = [Path(entry) for entry in os.environ.get("AMENT_PREFIX_PATH", "").split(":") if entry]
    prefixes += [*_installation_prefixes(Path(__file__).resolve()), Path(sys.prefix)]
    candidates += [_unlinked(prefix / "share" / PACKAGE) for prefix in prefixes]
    candidates += [p for p in Path(__file__).resolve().parents if is_folder(p / "config") and is_folder(p / "scenes")]
    shares: list[Path] = []
    for folder in candidates:
        # The Python package has a folder `scenes` too, but is not a share folder.
        if is_folder(folder) and not exists(folder / "__init__.py") and folder not in shares:
            shares.append(folder)
    return tuple(shares)


def _installation_prefixes(module: Path) -> list[Path]:
    """Returns the installation prefix of ``module``; empty for a source tree.

    It differs from ``sys.prefix`` after ``pip install --user``, and on Debian outside of virtual environments.
    """
    site = module.parents[1]
    return [site.parents[2]] if site.name in ("site-packages", "dist-packages") else []


def _unlinked(share: Path) -> Path:
    """Returns the source tree if ``share`` consists of symbolic links to its folders, so that every file has a unique path; else ``share``."""
    links = [share / "config", share / "scenes"]
    trees = {link.resolve().parent for link in links if link.is_symlink()}
    return trees.pop() if len(trees) == 1 and all(link.is_symlink() for link in links) else share


def find_scene(name_or_path: str | Path) -> Path:
    """Returns the folder or the file of a scene.

    Args:
        name_or_path: a folder, a world or mesh file, or the name of a folder in ``scenes/`` of a share folder. Folders of
            ``$GIBSON_SIM_PATH`` may also contain scenes directly.

    Raises:
        SceneNotFoundError: the scene does not exist; the message names the searched folders and the most similar scene.
    """
    return _find(name_or_path, _folders("scenes"), ("",), SceneNotFoundError, "scene")


def find_config(name_or_path: str | Path, kind: str = "") -> Path:
    """Returns a configuration file.

    Args:
        name_or_path: a file, or the name of a file in ``config/<kind>`` of a share folder, with or without ``.yaml``.
        kind: subfolder of ``config``, such as ``presets``; empty = ``config`` itself.

    Raises:
        ConfigError: the file does not exist; the message names the searched folders and the most similar file.
    """
    folders = tuple(share / "config" / kind for share in share_folders())
    path = _find(
        name_or_path, folders, _CONFIG_SUFFIXES, ConfigError, f"configuration of kind {quoted(kind)}" if kind else "configuration"
    )
    if not is_file(path):
        raise ConfigError(f"configuration {quoted(str(name_or_path))}: {path} is not a file")
    return path


def find_robot(name_or_path: str | Path) -> Path:
    """Returns the folder or file of a robot: a path, or a name under ``robots/`` or ``config/robots/`` of a share folder.

    Raises:
        RobotError: the robot does not exist; the message names the searched folders and the most similar robot.
    """
    return _find(name_or_path, _robot_folders(), _CONFIG_SUFFIXES, RobotError, "robot")


def list_scenes() -> list[str]:
    """Returns the names of all installed scenes, in alphabetical order."""
    return sorted(known_scenes())


def list_robots() -> list[str]:
    """Returns the names of all installed robots, in alphabetical order."""
    return sorted(set(_names(_robot_folders())))


def list_trials() -> list[str]:
    """Returns the names of all installed scenario files of trials, in alphabetical order."""
    return sorted(set(_names([share / "config" / "trials" for share in share_folders()])))


def known_objects() -> list[str]:
    """Returns the names of all installed objects of the catalogue, in alphabetical order, without reading them."""
    folders = [
        folder for share in share_folders() for folder in (share / "scenes" / _OBJECTS, share / _OBJECTS) if is_folder(folder)
    ]
    return sorted(
        {entry.name for folder in folders for entry in folder.iterdir() if is_folder(entry) and entry.name[0] not in "._"}
    )


def known_scenes() -> dict[str, Path]:
    """Returns name -> folder of all installed scenes."""
    scenes: dict[str, Path] = {}
    for folder in _folders("scenes"):
        for entry in sorted(folder.iterdir()) if is_folder(folder) else ():
            if is_file(entry / "scene.yaml"):
                scenes.setdefault(entry.name, entry)
    return scenes


def cache_folder(kind: str) -> Path:
    """Returns the cache folder of a kind, ``$XDG_CACHE_HOME/gibson-sim/<kind>``, by default below ``~/.cache``; it may not exist yet."""
    base = os.environ.get("XDG_CACHE_HOME", "")
    return (Path(base) if base else Path.home() / ".cache") / "gibson-sim" / kind


def _robot_folders() -> tuple[Path, ...]:
    return (*_folders("robots"), *(share / "config" / "robots" for share in share_folders()))


def _folders(kind: str) -> tuple[Path, ...]:
    explicit = [Path(os.path.expanduser(entry)) for entry in os.environ.get(PATH_VARIABLE, "").split(":") if entry]
    return tuple(p for share in share_folders() for p in ((share / kind, share) if share in explicit else (share / kind,)))


def _find(
    name_or_path: str | Path, folders: Sequence[Path], suffixes: Sequence[str], error: type[GibsonSimError], what: str
) -> Path:
    text = str(name_or_path)
    if not text.strip():
        raise error(f"{what}: the name is empty; give a name or a path")
    path = Path(os.path.expanduser(text))  # unlike pathlib, does not raise for the home of an unknown user
    # Names take precedence over relative paths: a folder in the current directory must not shadow an installed scene.
    is_path = path.is_absolute() or text.startswith(("./", "../", "~")) or text in (".", "..")
    if is_path:
        if exists(path):
            return real_path(path)
        raise error(f"{what} {quoted(text)}: {path.resolve()} does not exist")
    for folder in folders:
        for suffix in suffixes or ("",):
            candidate = folder / (text + suffix)
            # The name must not escape the folder, but a symbolic link in it may, since an installation can consist of links.
            if exists(candidate) and Path(os.path.normpath(candidate)).is_relative_to(os.path.normpath(folder)):
                return real_path(candidate)
    if exists(path):
        return real_path(path)
    known = sorted(set(_names(folders)))
    near = difflib.get_close_matches(text, known, n=1, cutoff=0.5)
    looked = ", ".join([str(Path.cwd()), *map(str, folders)])
    guess = f"did you mean {quoted(near[0])}? " if near else ""
    missing = f"{'install gibson_sim_scenes, or ' if what == 'scene' else ''}set {PATH_VARIABLE}"
    hint = f"{guess}known: {', '.join(known[:20])}" if known else missing
    raise error(f"{what} {quoted(text)} is not found; {hint} (looked in {looked})")


def _names(folders: Sequence[Path]) -> Iterator[str]:
    for folder in folders:
        for entry in folder.iterdir() if is_folder(folder) else ():
            if not entry.name.startswith((".", "_")) and entry.name != _OBJECTS:
                yield entry.name.split(".")[0] if is_file(entry) else entry.name
