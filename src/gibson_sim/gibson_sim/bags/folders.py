"""Folders of bags, without reading what is in them: quick, and without the libraries that read bags."""

from __future__ import annotations

from pathlib import Path

from gibson_sim.errors import RecordError

_FILES = (".mcap", ".db3")


def check_bag(folder: str | Path) -> None:
    """Checks that a folder may be a bag.

    Raises:
        RecordError: it is not there, or holds no file of a bag.
    """
    path = Path(folder)
    if not path.is_dir():
        raise RecordError(f"there is no bag at {path}: give the folder that was recorded")
    if not any(file.name.endswith((*_FILES, *(f"{suffix}.zstd" for suffix in _FILES))) for file in path.iterdir()):
        raise RecordError(f"{path} holds no mcap or db3 file, must be the folder of one bag; give the folder that was recorded")
