"""Generates ``scenes/objects``: draws textures, runs Blender in a separate process for the meshes, writes URDFs and the licence."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Callable, Sequence
from pathlib import Path

from gibson_sim.errors import GibsonSimError
from gibson_sim.writing import write_file
from gibson_sim_tools import package_path
from gibson_sim_tools.making.objects.catalogue import OBJECTS
from gibson_sim_tools.making.objects.model import ObjectModel
from gibson_sim_tools.making.objects.pictures import PICTURES, write_pictures
from gibson_sim_tools.making.objects.urdf import object_urdf

Progress = Callable[[str], None]
"""Callback; receives one line of text."""
LICENCE = """\
All files in this folder (URDFs, meshes and the pictures in them) were made by the authors of Gibson Sim with `gibson-sim scene objects`.

To the extent possible under law, they have waived all copyright and related or neighbouring rights to them: CC0 1.0 Universal,
https://creativecommons.org/publicdomain/zero/1.0/
"""
_HINT = "give a Python with `pip install bpy` as --blender-python"
_MODULE = "gibson_sim_tools.making.blender.objects"


def make_objects(names: Sequence[str], output: Path, blender_python: str, progress: Progress) -> None:
    """Writes objects to ``output``, one folder for each.

    Args:
        names: names of the objects; empty = all.
        output: parent folder.
        blender_python: Python interpreter in which ``import bpy`` works.
        progress: called with one line for each mesh.

    Raises:
        GibsonSimError: a name is unknown, or Blender is missing or fails.
    """
    models = select_objects(names)
    if shutil.which(blender_python) is None:
        raise GibsonSimError(f"{blender_python} cannot be run: the program does not exist; {_HINT}")
    with tempfile.TemporaryDirectory(prefix="gibson_sim_objects_") as folder:
        write_pictures(Path(folder), list(PICTURES))
        _run_blender(models, Path(folder), output, blender_python, progress)
    for model in models:
        write_file(output / model.name / f"{model.name}.urdf", object_urdf(model))
    write_file(output / "LICENSE", LICENCE)


def select_objects(names: Sequence[str]) -> list[ObjectModel]:
    """Returns the objects with these names; all without names.

    Raises:
        GibsonSimError: a name is unknown.
    """
    for name in names:
        if name not in OBJECTS:
            raise GibsonSimError(f"object {name!r} is unknown; known: {', '.join(OBJECTS)}")
    return [model for model in OBJECTS.values() if not names or model.name in names]


def _run_blender(models: Sequence[ObjectModel], pictures: Path, output: Path, blender_python: str, progress: Progress) -> None:
    """Runs Blender on the models; reports each mesh."""
    command = [blender_python, "-m", _MODULE, str(pictures), str(output.absolute()), *(model.name for model in models)]
    environment = {**os.environ, "PYTHONPATH": package_path(), "PYTHONDONTWRITEBYTECODE": "1"}
    try:
        process = subprocess.Popen(
            command, env=environment, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True, encoding="utf-8", errors="replace"
        )  # fmt: skip
    except OSError as e:
        raise GibsonSimError(f"{blender_python} cannot be run: {e.strerror or e}; {_HINT}") from e
    assert process.stdout is not None
    last = ""
    with process:
        for line in process.stdout:
            if line.startswith("{"):
                message = json.loads(line)
                progress(f"{message['object']}: {message['file']}, {message['triangles']} triangles")
            last = line.strip() or last
    if process.returncode:
        missing = "No module named 'bpy'" in last
        raise GibsonSimError(f"{blender_python} has no Blender; {_HINT}" if missing else f"Blender failed: {last}")


def default_blender_python() -> str:
    """Returns the default Python interpreter for Blender: the current one."""
    return sys.executable
