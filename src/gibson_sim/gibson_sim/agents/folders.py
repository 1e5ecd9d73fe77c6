"""The folders that an agent may read from and write into: all that the server's ``--folder`` options name, and nothing else. Without ROS."""

from __future__ import annotations

import os
from collections.abc import Collection, Sequence
from datetime import datetime
from pathlib import Path

from gibson_sim.errors import ConfigError
from gibson_sim.quoting import quoted
from gibson_sim.reading import exists, is_folder
from gibson_sim.resources import FOLDER_TIME
from gibson_sim.settings import nearest


class Folders:
    """Named folders; paths that lead out of them, also by symbolic links, are refused."""

    def __init__(self, folders: Sequence[str | Path]) -> None:
        """Resolves the folders.

        Raises:
            ConfigError: one is not a folder.
        """
        self._folders = []
        for folder in folders:
            path = Path(os.path.expanduser(folder))
            if not is_folder(path):
                raise ConfigError(f"--folder {quoted(str(folder))} is not a folder; create it, or name another")
            self._folders.append(path.resolve())

    @property
    def names(self) -> list[str]:
        """The resolved folders; relative paths are relative to the first one."""
        return [str(folder) for folder in self._folders]

    def name_or_file(self, text: str, known: Collection[str], what: str) -> str:
        """Returns a known name as it is, or the resolved path of a file or folder within the named folders.

        Args:
            text: the name or path.
            known: names that need no file.
            what: what it is, for the error message.

        Raises:
            ConfigError: it is neither.
        """
        if text in known:
            return text
        path = self._resolved(text, what) if self._folders else None
        if path is not None and exists(path):
            return str(path)
        hint = nearest(text, list(known))
        where = (
            f"a file in {self._listed()}" if self._folders else f"a file in a folder of this server, which has none: {_REMEDY}"
        )
        names = (
            f"known names: `list_names` lists all {len(known)}"
            if len(known) > _MOST_NAMED
            else f"known names: {', '.join(known)}"
        )
        raise ConfigError(f"{what} {quoted(text)} is neither a known name nor {where}; {hint or names}")

    def new_folder(self, text: str, kind: str) -> Path:
        """Returns the path of a folder that does not exist yet, within the named folders.

        Args:
            text: its path; empty = ``<kind>/<time>`` in the first folder.
            kind: what it is for, such as ``recordings``.

        Raises:
            ConfigError: it exists or lies elsewhere, or no folder is named.
        """
        if not self._folders:
            raise ConfigError(f"there is no folder for {kind}: {_REMEDY}")
        if not text:
            return self._folders[0] / kind / datetime.now().strftime(FOLDER_TIME)
        path = self._resolved(text, "folder")
        if exists(path):
            raise ConfigError(f"folder {quoted(text)} already exists; give another name")
        return path

    def _resolved(self, text: str, what: str) -> Path:
        """Returns a path with all symbolic links followed, which lies in a named folder."""
        try:
            path = (self._folders[0] / os.path.expanduser(text)).resolve()
        except (OSError, RuntimeError, ValueError) as error:  # a loop of links, a NUL
            raise ConfigError(f"{what} {quoted(text)} is not a path: {error}") from error
        if not any(path.is_relative_to(folder) for folder in self._folders):
            raise ConfigError(
                f"{what} {quoted(text)} is outside of the folders of this server, {self._listed()}: move it there, or {_REMEDY}"
            )
        return path

    def _listed(self) -> str:
        return ", ".join(self.names)


_REMEDY = "start the server with `--folder DIR`"
_MOST_NAMED = 20
"""Maximum number of known names in a message."""
