"""The folder of a training: one process at a time, and one training. Does not need PyTorch."""

from __future__ import annotations

import json
from collections.abc import Collection, Iterator, Mapping
from contextlib import AbstractContextManager, contextmanager
from pathlib import Path
from typing import Any

from gibson_sim.errors import ConfigError
from gibson_sim.processes.folder_lock import locked_folder
from gibson_sim.writing import write_file

SETTINGS = "settings.json"
"""File with the settings of a folder's training, written before its data."""


def locked(folder: Path, alternative: str = "another --folder") -> AbstractContextManager[None]:
    """Returns a context manager that creates a folder if it is missing and locks it against other trainings.

    Args:
        folder: the folder.
        alternative: what can be chosen instead of waiting, for the message.

    Raises:
        ConfigError: on entry, if another process trains in the folder.
    """
    return locked_folder(
        folder,
        ConfigError(f"{folder}: another `gibson-sim learn` works in this folder; wait for it, or choose {alternative}"),
    )


@contextmanager
def training_folder(folder: Path, settings: Mapping[str, Any], may_change: Collection[str]) -> Iterator[None]:
    """Locks a folder for a training within a block, and stores the training's settings in it.

    Args:
        folder: folder of the training; created if it is missing.
        settings: settings of the training, values for JSON.
        may_change: names of the settings that may differ from those of an earlier call.

    Raises:
        ConfigError: another process trains in the folder, or it holds a training with other settings.
    """
    with locked(folder):
        file = folder / SETTINGS
        if file.exists():
            try:
                stored = json.loads(file.read_text(encoding="utf-8"))
                if not isinstance(stored, dict):
                    raise ValueError("not a mapping")
            except (OSError, ValueError) as error:
                raise ConfigError(f"{file}: cannot be read: {error}; choose another --folder, or delete this one") from error
            check_settings(folder, stored, settings, may_change)
        write_file(file, json.dumps(settings, indent=1) + "\n")
        yield


def check_settings(
    folder: Path, stored: Mapping[str, Any], settings: Mapping[str, Any], may_change: Collection[str], what: str = "a training"
) -> None:
    """Checks that a training has the settings that its folder stores.

    Args:
        folder: folder of the training.
        stored: settings in the folder.
        settings: settings of the training that resumes.
        may_change: names of the settings that may differ.
        what: what the folder holds, for the message.

    Raises:
        ConfigError: a setting differs; the message names the first one.
    """
    fixed = {name: value for name, value in settings.items() if name not in may_change}
    # Tuples become lists, as in a stored file.
    for name, before in _differences(json.loads(json.dumps(stored)), json.loads(json.dumps(fixed))):
        raise ConfigError(f"{folder}: holds {what} with another {name} ({before}); choose another --folder")


def _differences(stored: Mapping[str, Any], settings: Mapping[str, Any], prefix: str = "") -> Iterator[tuple[str, Any]]:
    """Yields name and stored value of each setting that differs; names of nested settings have dots."""
    for name, value in settings.items():
        before = stored.get(name)
        if isinstance(value, dict) and isinstance(before, dict):
            yield from _differences(before, value, f"{prefix}{name}.")
        elif before != value:
            yield f"{prefix}{name}", before
