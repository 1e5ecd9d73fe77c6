"""Imports: from what the user names to a folder with a scene.yaml."""

from __future__ import annotations

import tempfile
from dataclasses import dataclass, replace
from pathlib import Path

from gibson_sim.errors import SceneError
from gibson_sim.scenes.load import load_scene
from gibson_sim.scenes.spec import SceneSpec
from gibson_sim_tools.importing.document import ASSETS, ImportedScene, write_in_place, write_scene
from gibson_sim_tools.importing.fetching.archives import only_folder, unpack
from gibson_sim_tools.importing.importers import Choices, read_source
from gibson_sim_tools.importing.sources import Kind, Source, identify


@dataclass(frozen=True, slots=True, eq=False)
class Imported:
    """What an import made."""

    file: Path
    """The scene.yaml."""
    kind: str
    scene: SceneSpec
    """As it loads."""
    warnings: tuple[str, ...]
    """One line each."""


def import_scene(source: Path, output: Path | None, choices: Choices | None = None) -> Imported:
    """Writes a scene of any kind as one of ours, and loads it.

    Args:
        source: file, folder or archive.
        output: new folder that gets the scene.yaml and a copy of all files; None = the scene.yaml goes beside the source, whose files
            stay where they are.
        choices: None = the source says everything itself.

    Raises:
        SceneError: it cannot be read, or not be written.
    """
    found = identify(source)
    if found.kind is Kind.OURS:
        raise SceneError(f"{source}: is a scene of ours already; use it as it is")
    if found.kind is not Kind.ARCHIVE:
        return _imported(found, output, choices or Choices())
    if output is None:
        raise SceneError(f"{source}: is an archive; say with --output FOLDER where the scene goes")
    output.parent.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory(prefix=f".{output.name}.", dir=output.parent) as temporary:
        unpack(source, Path(temporary) / "archive")
        inside = only_folder(Path(temporary) / "archive")
        named = choices or Choices()
        return _imported(identify(inside), output, replace(named, name=named.name or source.name.split(".")[0]))


def _imported(source: Source, output: Path | None, choices: Choices) -> Imported:
    scene = read_source(source, choices)
    file = write_scene(scene, output) if output is not None else write_in_place(scene, scene.home or source.folder)
    spec = load_scene(file)
    # What is said of the source would be said of the copy once more.
    known = {_key(warning) for warning in scene.warnings}
    fresh = [warning for warning in spec.warnings if _key(warning) not in known]
    return Imported(file, scene.kind, spec, (*dict.fromkeys(scene.warnings), *fresh))


def _key(warning: str) -> str:
    return warning.replace(f"{ASSETS}/", "")


__all__ = ["Choices", "Imported", "ImportedScene", "import_scene"]
