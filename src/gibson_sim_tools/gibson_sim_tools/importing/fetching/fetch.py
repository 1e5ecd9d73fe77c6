"""Downloads a public scene from its origin according to a recipe, and imports it.

Files have a known size and checksum; interrupted downloads are resumed; files with a wrong checksum are discarded.
"""

from __future__ import annotations

import hashlib
import http.client
import shutil
import urllib.error
import urllib.request
from collections.abc import Callable
from pathlib import Path

from gibson_sim import __version__
from gibson_sim.errors import SceneError
from gibson_sim.resources import cache_folder
from gibson_sim.writing import write_file
from gibson_sim_tools.importing.fetching.archives import check_disk_space, only_folder, unpack
from gibson_sim_tools.importing.fetching.recipes import Recipe
from gibson_sim_tools.importing.importers import ImportOptions, ImportResult, import_scene

_SPACE_FACTOR = 3
"""Ratio of the disk space needed to the size of the download: packed, unpacked and imported."""
_Progress = Callable[[int], None]
"""Callback; receives the number of bytes downloaded since the last call."""
_BLOCK = 1 << 18
_TIMEOUT_S = 30.0
_PARTIAL_CONTENT = 206


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


def download(url: str, path: Path, sha256: str, size: int, progress: _Progress) -> None:
    """Downloads a file, unless it exists with the right checksum.

    An interrupted download is kept beside it as ``.part``; the next call resumes it.

    Args:
        url: source.
        path: destination; its folder is created if missing.
        sha256: checksum of the content, 64 hexadecimal digits.
        size: size of the file, bytes; a longer response is rejected.
        progress: called with the number of new bytes, first with those of an earlier, resumed download.

    Raises:
        SceneError: the download fails, or the checksum differs.
    """
    path.parent.mkdir(parents=True, exist_ok=True)
    if path.is_file() and _digest(path) == sha256:
        progress(size)
        return
    part = path.with_name(path.name + ".part")
    resumed_size = part.stat().st_size if part.is_file() else 0
    if resumed_size > size:
        part.unlink()
        resumed_size = 0
    if resumed_size < size:
        _fetch(url, part, resumed_size, size, progress)
    else:
        progress(resumed_size)
    checksum = _digest(part)
    if checksum != sha256:
        part.unlink()
        raise SceneError(
            f"{url}: has the checksum {checksum}, must be {sha256}; the file has changed since the recipe was written; it was discarded"
        )
    part.replace(path)


def _fetch(url: str, part: Path, resumed_size: int, size: int, progress: _Progress) -> None:
    headers = {"User-Agent": f"gibson-sim/{__version__}", **({"Range": f"bytes={resumed_size}-"} if resumed_size else {})}
    request = urllib.request.Request(url, headers=headers)
    try:
        with urllib.request.urlopen(request, timeout=_TIMEOUT_S) as response:
            is_resumed = resumed_size > 0 and response.status == _PARTIAL_CONTENT
            total = resumed_size if is_resumed else 0
            progress(total)
            with part.open("ab" if is_resumed else "wb") as out:
                while block := response.read(_BLOCK):
                    total += len(block)
                    if total > size:
                        raise SceneError(
                            f"{url}: sends more than the {size} bytes of the recipe; the file has changed; it was discarded"
                        )
                    out.write(block)
                    progress(len(block))
    except SceneError:
        part.unlink(missing_ok=True)
        raise
    except (urllib.error.URLError, http.client.HTTPException, OSError) as e:
        raise SceneError(f"{url}: cannot be downloaded: {_reason(e)}; run the command again to resume") from e
    if total < size:
        raise SceneError(f"{url}: the connection ended after {total} of {size} bytes; run the command again to resume")


def _reason(error: Exception) -> str:
    if isinstance(error, urllib.error.HTTPError):
        return f"the server returned {error.code} {error.reason}"
    return str(getattr(error, "reason", "") or error or type(error).__name__)


def _digest(path: Path) -> str:
    """Returns the SHA-256 of a file."""
    total = hashlib.sha256()
    with path.open("rb") as file:
        while block := file.read(_BLOCK):
            total.update(block)
    return total.hexdigest()
