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
    """Path of the scene.yaml."""
    kind: str
    """Kind of the source in words, such as ``Gibson folder``."""
    scene: SceneSpec
    """The written scene, loaded."""
    warnings: tuple[str, ...]
    """Warnings, one line each."""


def import_scene(source: Path, output: Path | None, options: ImportOptions | None = None) -> ImportResult:
    """Imports a scene of any kind, and loads the result.

    Args:
        source: file, folder or archive.
        output: new folder for the scene.yaml and a copy of all files; None = the scene.yaml is written beside the source, whose files
            stay in place.
        options: None = the defaults.

    Raises:
        SceneError: the source cannot be read, or the scene cannot be written.
    """
    identified = identify(source)
    if identified.kind is SourceKind.GIBSON_SIM:
        raise SceneError(f"{source}: is a Gibson Sim scene already; use it as it is")
    if identified.kind is not SourceKind.ARCHIVE:
        return _import_source(identified, output, options or ImportOptions())
    if output is None:
        raise SceneError(f"{source}: is an archive; give a folder for the scene with --output")
    output.parent.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory(prefix=f".{output.name}.", dir=output.parent) as temporary:
        unpack(source, Path(temporary) / "archive")
        content = only_folder(Path(temporary) / "archive")
        archive_options = options or ImportOptions()
        return _import_source(
            identify(content), output, replace(archive_options, name=archive_options.name or source.name.split(".")[0])
        )


def _import_source(source: Source, output: Path | None, options: ImportOptions) -> ImportResult:
    scene = read_source(source, options)
    file = write_scene(scene, output) if output is not None else write_in_place(scene, scene.in_place_folder or source.folder)
    spec = load_scene(file)
    # Loading the copy repeats the warnings about the source.
    known = {_warning_key(warning) for warning in scene.warnings}
    new_warnings = [warning for warning in spec.warnings if _warning_key(warning) not in known]
    return ImportResult(file, scene.kind, spec, (*dict.fromkeys(scene.warnings), *new_warnings))


def _warning_key(warning: str) -> str:
    return warning.replace(f"{ASSETS}/", "")


__all__ = ["ImportOptions", "ImportResult", "ImportedScene", "import_scene"]
