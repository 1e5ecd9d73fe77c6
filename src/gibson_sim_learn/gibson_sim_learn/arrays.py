"""A folder of NumPy arrays, a file for each: written whole or not at all, memory-mapped when it is read."""

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
    """Writes ``NAME.npy`` for each array, and text files; the folder appears once it is whole.

    Args:
        folder: not there yet.
        arrays: name without suffix -> array of any shape and type.
        texts: name with suffix -> content.
    """
    folder.parent.mkdir(parents=True, exist_ok=True)
    part = Path(tempfile.mkdtemp(prefix=".part-", dir=folder.parent))
    try:
        for name, array in arrays.items():
            np.save(part / f"{name}.npy", array)
        for name, text in (texts or {}).items():
            (part / name).write_text(text, encoding="utf-8")
        part.rename(folder)
    except BaseException:
        shutil.rmtree(part, ignore_errors=True)
        raise


def load_arrays(folder: Path, names: Sequence[str]) -> list[NDArray[Any]]:
    """Returns arrays of a folder, memory-mapped, in the order of ``names``.

    Raises:
        ConfigError: one cannot be read.
    """
    try:
        return [np.load(folder / f"{name}.npy", mmap_mode="r") for name in names]
    except (OSError, ValueError) as error:
        raise ConfigError(f"{folder}: not a shard of data: {error}; delete it, and run the command again") from error
