"""ZIP archives of posed photographs, as scanning apps export them."""

from __future__ import annotations

import shutil
import tempfile
import zipfile
from pathlib import Path

from gibson_sim.reading import is_file
from gibson_sim.writing import cannot_write
from gibson_sim_tools.importing.fetching.archives import only_folder, unpack

_POSE_FILES = ("transforms.json", "trajectory.log", "groundtruth.txt", "images.txt", "images.bin", "scan.json")
"""Names of files that hold poses."""
_IMAGE_FOLDERS = ("keyframes", "rgbd", "EXR_RGBD")
"""Names of folders of photographs in exports of apps."""


def is_photograph_archive(path: Path) -> bool:
    """Returns whether a file is a ZIP of posed photographs, by the names of its members."""
    if path.suffix.lower() != ".zip" or not is_file(path):
        return False
    try:
        with zipfile.ZipFile(path) as archive:
            names = [Path(name).parts for name in archive.namelist()]
    except (OSError, ValueError, NotImplementedError, zipfile.BadZipFile):
        return False  # the next reader reports the error
    return any(parts and (parts[-1] in _POSE_FILES or any(part in _IMAGE_FOLDERS for part in parts[:-1])) for parts in names)


def unpack_photographs(archive: Path, folder: Path) -> Path:
    """Returns the folder of photographs of an archive; unpacks it into ``folder`` unless that exists.

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
