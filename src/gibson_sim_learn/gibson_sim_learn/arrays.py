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


def save_arrays(folder: Path, arrays: Mapping[str, NDArray[Any]], texts: Mapping[str, str] | None = None) -> None:
    """Writes ``NAME.npy`` for each array, and text files, atomically: the folder appears once it is complete.

    Args:
        folder: path of the folder, which must not exist.
        arrays: name without suffix -> array of any shape and dtype.
        texts: file name -> content.
    """
    folder.parent.mkdir(parents=True, exist_ok=True)
    draft = Path(tempfile.mkdtemp(prefix=".part-", dir=folder.parent))
    try:
        for name, array in arrays.items():
            np.save(draft / f"{name}.npy", array)
        for name, text in (texts or {}).items():
            (draft / name).write_text(text, encoding="utf-8")
        draft.rename(folder)
    except BaseException:
        shutil.rmtree(draft, ignore_errors=True)
        raise


def load_arrays(folder: Path, names: Sequence[str]) -> list[NDArray[Any]]:
    """Returns the arrays of a folder, memory-mapped, in the order of ``names``.

    Raises:
        ConfigError: an array cannot be read.
    """
    try:
        return [np.load(folder / f"{name}.npy", mmap_mode="r") for name in names]
    except (OSError, ValueError) as error:
        raise ConfigError(f"{folder}: not a shard of data: {error}; delete it, and run the command again") from error
