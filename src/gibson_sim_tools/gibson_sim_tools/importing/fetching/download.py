"""Downloads files of known size and checksum, resumes interrupted downloads, and keeps no file that fails its check."""

from __future__ import annotations

import hashlib
import http.client
import urllib.error
import urllib.request
from collections.abc import Callable
from pathlib import Path

from gibson_sim import __version__
from gibson_sim.errors import SceneError

Progress = Callable[[int], None]
"""Receives the number of bytes downloaded so far."""
_BLOCK = 1 << 18
_TIMEOUT_S = 30.0
_PARTIAL = 206


def download(url: str, path: Path, sha256: str, size: int, progress: Progress) -> None:
    """Downloads a file, unless it exists.

    An interrupted download is kept beside it as ``.part``; the next call resumes it.

    Args:
        url: source.
        path: destination; its folder is made.
        sha256: checksum of the content.
        size: bytes; more are refused.
        progress: called with the bytes so far, including resumed ones.

    Raises:
        SceneError: the download fails, or the file is not the expected one.
    """
    path.parent.mkdir(parents=True, exist_ok=True)
    if path.is_file() and digest(path) == sha256:
        progress(size)
        return
    part = path.with_name(path.name + ".part")
    have = part.stat().st_size if part.is_file() else 0
    if have > size:
        part.unlink()
        have = 0
    if have < size:
        _fetch(url, part, have, size, progress)
    else:
        progress(have)
    found = digest(part)
    if found != sha256:
        part.unlink()
        raise SceneError(
            f"{url}: has the checksum {found}, must be {sha256}; the file has changed since the recipe was made; it was discarded"
        )
    part.replace(path)


def _fetch(url: str, part: Path, have: int, size: int, progress: Progress) -> None:
    headers = {"User-Agent": f"gibson-sim/{__version__}", **({"Range": f"bytes={have}-"} if have else {})}
    request = urllib.request.Request(url, headers=headers)
    try:
        with urllib.request.urlopen(request, timeout=_TIMEOUT_S) as answer:
            going_on = have > 0 and answer.status == _PARTIAL
            total = have if going_on else 0
            progress(total)
            with part.open("ab" if going_on else "wb") as out:
                while block := answer.read(_BLOCK):
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
        raise SceneError(f"{url}: cannot be downloaded: {_reason(e)}; run the command again to go on") from e
    if total < size:
        raise SceneError(f"{url}: the connection ended after {total} of {size} bytes; run the command again to go on")


def _reason(error: Exception) -> str:
    if isinstance(error, urllib.error.HTTPError):
        return f"the server says {error.code} {error.reason}"
    return str(getattr(error, "reason", "") or error or type(error).__name__)


def digest(path: Path) -> str:
    """Returns the SHA-256 of a file."""
    total = hashlib.sha256()
    with path.open("rb") as file:
        while block := file.read(_BLOCK):
            total.update(block)
    return total.hexdigest()
