"""Gets a public scene from its origin, as a recipe says, and imports it."""

from __future__ import annotations

import shutil
from collections.abc import Callable
from pathlib import Path

from gibson_sim.errors import SceneError
from gibson_sim.resources import cache_folder
from gibson_sim.writing import write_file
from gibson_sim_tools.importing.fetching.archives import needs_space, only_folder, unpack
from gibson_sim_tools.importing.fetching.download import download
from gibson_sim_tools.importing.fetching.recipes import Recipe
from gibson_sim_tools.importing.run import Choices, Imported, import_scene

_SPACE = 3
"""Times the size of the download: itself, unpacked, and imported."""


def download_folder(name: str) -> Path:
    """Returns where the files of a scene are kept while it is not imported yet."""
    return cache_folder("downloads") / name


def fetch_scene(recipe: Recipe, output: Path, progress: Callable[[float], None]) -> Imported:
    """Downloads, checks, unpacks and imports a scene.

    Downloads are kept in the cache until the scene is imported, so that a second call goes on where the first one stopped.

    Args:
        recipe: of the scene, whose licence the user has accepted.
        output: new folder.
        progress: told how much of the download is done, 0 to 1.

    Raises:
        SceneError: a file cannot be had, is not the right one, or the scene cannot be imported.
    """
    if output.exists() and any(output.iterdir()):
        raise SceneError(f"{output}: is there already and not empty; give another folder with --output, or delete it first")
    cache = download_folder(recipe.name)
    needs_space(cache, _SPACE * recipe.bytes)
    done = 0

    def told(count: int) -> None:
        nonlocal done
        done += count
        progress(min(done / max(recipe.bytes, 1), 1.0))

    for file in recipe.files:
        download(file.url, cache / "files" / file.path, file.sha256, file.bytes, told)
    source = cache / "files"
    if recipe.unpack:
        shutil.rmtree(cache / "unpacked", ignore_errors=True)
        unpack(source / recipe.files[0].path, cache / "unpacked")
        source = only_folder(cache / "unpacked")
    imported = import_scene(source / recipe.scene if recipe.scene else source, output, Choices(name=recipe.name))
    write_file(output / "ORIGIN.txt", recipe.text() + "\n")
    shutil.rmtree(cache, ignore_errors=True)
    return imported
