"""A folder of NumPy arrays, one .npy file each: written atomically, read memory-mapped."""

from __future__ import annotations

import shutil
import tempfile
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gibson_sim.errors import ConfigError
from gibson_sim.picture_files import write_array
from gibson_sim.writing import cannot_write, write_file


def save_arrays(folder: Path, arrays: Mapping[str, NDArray[Any]], texts: Mapping[str, str] | None = None) -> None:
    """Writes ``NAME.npy`` for each array, and text files, atomically: the folder appears once it is complete.

    Args:
        folder: path of the folder, which must not exist.
        arrays: name without suffix -> array of any shape and dtype.
        texts: file name -> content.

    Raises:
        WriteError: an array cannot be written, such as on a full disk; what was written is deleted.
    """
    draft: Path | None = None
    try:
        folder.parent.mkdir(parents=True, exist_ok=True)
        draft = Path(tempfile.mkdtemp(prefix=".part-", dir=folder.parent))
        for name, array in arrays.items():
            write_array(draft / f"{name}.npy", array)
        for name, text in (texts or {}).items():
            write_file(draft / name, text)
        draft.rename(folder)
        draft = None
    except OSError as error:
        raise cannot_write(folder, error) from error
    finally:
        if draft is not None:
            shutil.rmtree(draft, ignore_errors=True)


def load_arrays(folder: Path, names: Sequence[str], remedy: str) -> list[NDArray[Any]]:
    """Returns the arrays of a folder, memory-mapped, in the order of ``names``.

    Args:
        folder: path of the folder.
        names: names of the arrays, without suffix.
        remedy: what to do if an array cannot be read, for the message.

    Raises:
        ConfigError: an array cannot be read.
    """
    try:
        return [np.load(folder / f"{name}.npy", mmap_mode="r") for name in names]
    except (EOFError, OSError, ValueError) as error:
        cause = str(error).partition(" If you trust")[0].rstrip(".")  # of an array of objects: not ours
        raise ConfigError(f"{folder}: not a shard of data: {cause}; {remedy}") from error
