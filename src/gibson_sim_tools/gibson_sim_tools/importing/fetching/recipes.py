"""Reads recipes of public scenes: origin, licence, and the checksum of each file."""

from __future__ import annotations

import re
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path, PurePosixPath
from typing import Any
from urllib.parse import quote, urlsplit

from gibson_sim.errors import SceneError, TextError
from gibson_sim.formats.yaml_map import YamlMap
from gibson_sim.quoting import quoted
from gibson_sim.reading import read_yaml_file
from gibson_sim.resources import find_config, share_folders

RECIPE_FOLDER = "scene_recipes"
_KEYS = (
    "name",
    "title",
    "made_by",
    "homepage",
    "licence",
    "licence_url",
    "credit",
    "base_url",
    "files",
    "unpack",
    "scene",
    "note",
)
_FILE_KEYS = ("sha256", "bytes", "url")
_SHA256 = re.compile(r"[0-9a-f]{64}")


@dataclass(frozen=True, slots=True)
class RecipeFile:
    """One file to download."""

    path: str
    """Path relative to the folder of the scene, with ``/``."""
    url: str
    sha256: str
    """Checksum, 64 hexadecimal digits."""
    bytes: int
    """Size, bytes."""


@dataclass(frozen=True, slots=True)
class Recipe:
    """Origin, licence and files of a public scene."""

    name: str
    title: str
    made_by: str
    homepage: str
    licence: str
    licence_url: str
    credit: str
    """Attribution that the licence requires; empty = none."""
    files: tuple[RecipeFile, ...]
    unpack: bool
    """Whether the only file is an archive to be unpacked."""
    scene: str
    """Path of the scene relative to the folder; empty = the folder."""
    note: str

    @property
    def bytes(self) -> int:
        """Total size of all files, bytes."""
        return sum(file.bytes for file in self.files)

    def text(self) -> str:
        """Returns the text shown to the user before the download: origin, licence, credit and size."""
        lines = [
            ("scene", f"{self.name}: {self.title}"), ("made by", self.made_by), ("from", self.homepage),
            ("licence", f"{self.licence} ({self.licence_url})"), ("credit", self.credit or "none required"),
            ("size", f"{self.bytes / 1e6:.1f} MB in {len(self.files)} files"), *([("note", self.note)] if self.note else []),
        ]  # fmt: skip
        return "\n".join(f"{name:>8}  {value}" for name, value in lines)


def known_recipes() -> dict[str, Path]:
    """Returns the paths of the recipes by name."""
    recipes: dict[str, Path] = {}
    for share in share_folders():
        for path in sorted((share / "config" / RECIPE_FOLDER).glob("*.yaml")):
            recipes.setdefault(path.stem, path)
    return recipes


def load_recipe(name: str) -> Recipe:
    """Loads a recipe, given by its name below ``config/scene_recipes``, or by its file.

    Raises:
        ConfigError: the recipe does not exist.
        SceneError: a key or a value is invalid.
    """
    path = find_config(name, RECIPE_FOLDER)
    try:
        document = read_yaml_file(path)
    except OSError as e:
        raise SceneError(f"{path}: cannot be read: {e.strerror or e}") from e
    except TextError as e:
        raise SceneError(f"{path}: {e}").with_public(e.public) from e
    top = YamlMap(document, str(path), _KEYS)
    base = top.text("base_url", "")
    files = top.value("files", None)
    if not isinstance(files, dict) or not files:
        raise SceneError(f"{path}: files is {quoted(files)}, must be a mapping of paths to their sha256 and bytes")
    recipe = Recipe(
        name=top.text("name", path.stem), title=_required(top, "title"), made_by=_required(top, "made_by"), homepage=_required(top, "homepage"),
        licence=_required(top, "licence"), licence_url=_required(top, "licence_url"), credit=top.text("credit", ""),
        files=tuple(_file(path, str(key), value, base) for key, value in files.items()),
        unpack=top.flag("unpack", False), scene=top.text("scene", ""), note=top.text("note", ""),
    )  # fmt: skip
    _check_paths(path, [*(file.path for file in recipe.files), *([recipe.scene] if recipe.scene else [])])
    if recipe.unpack and len(recipe.files) != 1:
        raise SceneError(f"{path}: unpack requires a single archive, but files has {len(recipe.files)} entries")
    return recipe


def _required(top: YamlMap, key: str) -> str:
    text = top.text(key, "").strip()
    if not text:
        raise SceneError(f"{top.where}: {key} is missing; a recipe must name the author and the licence")
    return text


def _file(recipe: Path, path: str, value: Any, base: str) -> RecipeFile:
    item = YamlMap(value, f"{recipe}: {path}", _FILE_KEYS)
    sha256 = item.text("sha256", "")
    if not _SHA256.fullmatch(sha256):
        raise SceneError(
            f"{item.where}: sha256 is {quoted(sha256)}, must be 64 hexadecimal digits; without it nothing is downloaded"
        )
    url = item.text("url", "") or f"{base.rstrip('/')}/{quote(path)}"
    if urlsplit(url).scheme not in ("http", "https"):
        raise SceneError(f"{item.where}: url is {quoted(url)}, must begin with https:// or http://")
    return RecipeFile(path, url, sha256, int(item.number("bytes", 0, low=1, high=1e12)))


def _check_paths(recipe: Path, paths: Iterable[str]) -> None:
    for path in paths:
        pure = PurePosixPath(path)
        if pure.is_absolute() or ".." in pure.parts or "\\" in path or not pure.parts:
            raise SceneError(f"{recipe}: path {quoted(path)} leaves the folder; it must be relative, without ..")
