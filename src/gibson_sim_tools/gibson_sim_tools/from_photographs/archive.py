"""Archives of photographs: apps for scanning export a ZIP."""

from __future__ import annotations

import shutil
import tempfile
import zipfile
from pathlib import Path

from gibson_sim.reading import is_file
from gibson_sim.writing import cannot_write
from gibson_sim_tools.importing.fetching.archives import only_folder, unpack

_SIGNS = ("transforms.json", "trajectory.log", "groundtruth.txt", "images.txt", "images.bin", "scan.json")
"""Names of files of poses."""
_FOLDERS = ("keyframes", "rgbd", "EXR_RGBD")
"""Folders of photographs in exports of apps."""


def is_archive_of_photographs(path: Path) -> bool:
    """Returns whether a file is a ZIP with posed photographs, by the names in it."""
    if path.suffix.lower() != ".zip" or not is_file(path):
        return False
    try:
        with zipfile.ZipFile(path) as archive:
            names = [Path(name).parts for name in archive.namelist()]
    except (OSError, ValueError, NotImplementedError, zipfile.BadZipFile):
        return False  # whoever reads it next says what is wrong
    return any(parts and (parts[-1] in _SIGNS or any(part in _FOLDERS for part in parts[:-1])) for parts in names)


def unpacked(archive: Path, folder: Path) -> Path:
    """Returns the folder of photographs of an archive, which is unpacked once into ``folder``.

    Raises:
        SceneError: it is broken, too large, or holds names that leave the folder.
        WriteError: it cannot be written.
    """
    if not folder.is_dir():
        try:
            folder.parent.mkdir(parents=True, exist_ok=True)
            temporary = Path(tempfile.mkdtemp(prefix=f".{folder.name}.", dir=folder.parent))
        except OSError as error:
            raise cannot_write(folder, error) from error
        try:
            unpack(archive, temporary / "content")
            (temporary / "content").rename(folder)
        finally:
            shutil.rmtree(temporary, ignore_errors=True)
    return only_folder(folder)
