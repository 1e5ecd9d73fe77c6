"""Imports a source into a folder with a scene.yaml."""

from __future__ import annotations

import tempfile
from dataclasses import dataclass, replace
from pathlib import Path

from gibson_sim.errors import SceneError
from gibson_sim.scenes.load import load_scene
from gibson_sim.scenes.spec import SceneSpec
from gibson_sim_tools.importing.document import ASSETS, ImportedScene, write_in_place, write_scene
from gibson_sim_tools.importing.fetching.archives import only_folder, unpack
from gibson_sim_tools.importing.importers import ImportOptions, read_source
from gibson_sim_tools.importing.sources import Source, SourceKind, identify


@dataclass(frozen=True, slots=True, eq=False)
class ImportResult:
    """Result of an import."""

    file: Path
    """The scene.yaml."""
    kind: str
    scene: SceneSpec
    """The written scene, loaded."""
    warnings: tuple[str, ...]
    """One line each."""


def import_scene(source: Path, output: Path | None, choices: ImportOptions | None = None) -> ImportResult:
    """Imports a scene of any kind, and loads the result.

    Args:
        source: file, folder or archive.
        output: new folder that gets the scene.yaml and a copy of all files; None = the scene.yaml goes beside the source, whose files
            stay where they are.
        choices: None = everything as the source says.

    Raises:
        SceneError: it cannot be read or written.
    """
    found = identify(source)
    if found.kind is SourceKind.OURS:
        raise SceneError(f"{source}: is a scene of ours already; use it as it is")
    if found.kind is not SourceKind.ARCHIVE:
        return _imported(found, output, choices or ImportOptions())
    if output is None:
        raise SceneError(f"{source}: is an archive; say with --output FOLDER where the scene goes")
    output.parent.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory(prefix=f".{output.name}.", dir=output.parent) as temporary:
        unpack(source, Path(temporary) / "archive")
        inside = only_folder(Path(temporary) / "archive")
        named = choices or ImportOptions()
        return _imported(identify(inside), output, replace(named, name=named.name or source.name.split(".")[0]))


def _imported(source: Source, output: Path | None, choices: ImportOptions) -> ImportResult:
    scene = read_source(source, choices)
    file = write_scene(scene, output) if output is not None else write_in_place(scene, scene.home or source.folder)
    spec = load_scene(file)
    # Warnings about the source would appear once more for the copy.
    known = {_key(warning) for warning in scene.warnings}
    fresh = [warning for warning in spec.warnings if _key(warning) not in known]
    return ImportResult(file, scene.kind, spec, (*dict.fromkeys(scene.warnings), *fresh))


def _key(warning: str) -> str:
    return warning.replace(f"{ASSETS}/", "")


__all__ = ["ImportOptions", "ImportResult", "ImportedScene", "import_scene"]
