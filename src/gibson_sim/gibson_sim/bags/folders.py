"""Quick checks of bag folders and of the disk, without the libraries that read bags."""

from __future__ import annotations

import shutil
from pathlib import Path

from gibson_sim.errors import RecordError

MIB = 1024 * 1024
EMERGENCY_BYTES = 8 * MIB
"""Size of the file that is deleted when the disk is full, to free space for messages in memory, the index and the metadata, bytes."""
_FILES = (".mcap", ".db3")


class DiskFullError(RecordError):
    """The disk is full or nearly full. The bag was closed and contains all earlier messages."""


def check_bag(folder: str | Path) -> None:
    """Checks that a folder exists and has storage files.

    Raises:
        RecordError: the folder does not exist, or has no mcap or db3 file.
    """
    path = Path(folder)
    if not path.is_dir():
        raise RecordError(f"there is no bag at {path}: give the folder that was recorded")
    if not any(file.name.endswith((*_FILES, *(f"{suffix}.zstd" for suffix in _FILES))) for file in path.iterdir()):
        raise RecordError(f"{path} holds no mcap or db3 file, must be the folder of one bag; give the folder that was recorded")


def check_room(folder: Path, reserve_bytes: int) -> None:
    """Checks that the disk has room for a new bag.

    Args:
        folder: folder of the bag; need not exist.
        reserve_bytes: free space below which recording ends.

    Raises:
        DiskFullError: the disk has less free space.
        OSError: the free space is unknown.
    """
    existing_folder = next(candidate for candidate in (folder, *folder.absolute().parents) if candidate.is_dir())
    free, needed = shutil.disk_usage(existing_folder).free, reserve_bytes + EMERGENCY_BYTES
    if free < needed:
        raise DiskFullError(
            f"the disk of {folder} has {free / MIB:.0f} MiB left, recording needs more than {needed / MIB:.0f} MiB: make room, choose "
            "another disk or reserve less"
        )
