"""Downloads a public scene from its origin according to a recipe, and imports it."""

from __future__ import annotations

import shutil
from collections.abc import Callable
from pathlib import Path

from gibson_sim.errors import SceneError
from gibson_sim.resources import cache_folder
from gibson_sim.writing import write_file
from gibson_sim_tools.importing.fetching.archives import check_disk_space, only_folder, unpack
from gibson_sim_tools.importing.fetching.download import download
from gibson_sim_tools.importing.fetching.recipes import Recipe
from gibson_sim_tools.importing.run import ImportOptions, ImportResult, import_scene

_SPACE_FACTOR = 3
"""Ratio of the disk space needed to the size of the download: packed, unpacked and imported."""


def download_folder(name: str) -> Path:
    """Returns the cache folder for the downloaded files of a scene."""
    return cache_folder("downloads") / name


def fetch_scene(recipe: Recipe, output: Path, progress: Callable[[float], None]) -> ImportResult:
    """Downloads, verifies, unpacks and imports a scene.

    Downloads stay in the cache until the scene is imported, so that a second call resumes an interrupted one.

    Args:
        recipe: recipe of the scene; the user has accepted its licence.
        output: new folder for the scene.
        progress: called with the completed fraction of the download, 0 to 1.

    Raises:
        SceneError: a download fails, a checksum differs, or the scene cannot be imported.
    """
    if output.exists() and any(output.iterdir()):
        raise SceneError(f"{output}: already exists and is not empty; give another folder with --output, or delete it first")
    cache = download_folder(recipe.name)
    check_disk_space(cache, _SPACE_FACTOR * recipe.bytes)
    done = 0

    def report(count: int) -> None:
        nonlocal done
        done += count
        progress(min(done / max(recipe.bytes, 1), 1.0))

    for file in recipe.files:
        download(file.url, cache / "files" / file.path, file.sha256, file.bytes, report)
    source = cache / "files"
    if recipe.unpack:
        shutil.rmtree(cache / "unpacked", ignore_errors=True)
        unpack(source / recipe.files[0].path, cache / "unpacked")
        source = only_folder(cache / "unpacked")
    imported = import_scene(source / recipe.scene if recipe.scene else source, output, ImportOptions(name=recipe.name))
    write_file(output / "ORIGIN.txt", recipe.text() + "\n")
    shutil.rmtree(cache, ignore_errors=True)
    return imported
