"""Files that an engine reads: they lie in a folder of their own and go with it."""

from __future__ import annotations

import hashlib
import tempfile
from pathlib import Path

from gibson_sim.errors import MeshError
from gibson_sim.physics.obj_text import shapes_alone


class EngineFiles:
    """Writes them; a second ``close`` does nothing."""

    def __init__(self) -> None:
        self._folder: tempfile.TemporaryDirectory[str] | None = None

    @property
    def folder(self) -> Path:
        """Where they are."""
        if self._folder is None:
            self._folder = tempfile.TemporaryDirectory(prefix="gibson_sim_physics_")
        return Path(self._folder.name)

    def close(self) -> None:
        """Deletes all of them."""
        if self._folder is not None:
            self._folder.cleanup()
            self._folder = None

    def write_urdf(self, text: str) -> Path:
        """Returns a file with the text; the next one takes its place."""
        path = self.folder / "body.urdf"
        path.write_text(text, encoding="utf-8")
        return path

    def copy_obj(self, path: str) -> Path:
        """Returns an OBJ file with the shapes of another one alone: the engine would read its textures, too, and crash on wrong references.

        Raises:
            MeshError: it cannot be read.
        """
        try:
            text = Path(path).read_bytes()
        except OSError as error:
            raise MeshError(f"{path}: cannot be read: {error.strerror}") from error
        return self.write_obj(shapes_alone(text))

    def write_obj(self, text: bytes) -> Path:
        """Returns an OBJ file with this text; equal ones share a file."""
        path = self.folder / f"{hashlib.sha256(text).hexdigest()[:32]}.obj"
        if not path.is_file():
            path.write_bytes(text)
        return path
