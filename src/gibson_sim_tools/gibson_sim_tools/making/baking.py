"""Runs Blender on a plan in a separate process, and makes the scene folder from the bake."""

from __future__ import annotations

import hashlib
import json
import os
import shutil
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import gibson_sim
from gibson_sim.errors import SceneError
from gibson_sim.maps.scene_files import write_scene_files
from gibson_sim.resources import cache_folder
from gibson_sim_tools import package_path
from gibson_sim_tools.making.building import Building
from gibson_sim_tools.making.building_file import Quality, write_plan
from gibson_sim_tools.making.pictures import write_thumbnail
from gibson_sim_tools.making.scene_folder import write_scene_folder
from gibson_sim_tools.making.surroundings import write_surroundings

Tell = Callable[[str, float, float | None], None]
"""Receives the current task, the fraction that is done (0 to 1), and the seconds left (None = unknown)."""
_LAST_LINES = 12


def make_scene(
    building: Building,
    quality: Quality,
    folder: Path,
    *,
    python: str = sys.executable,
    resume: bool = False,
    command: str = "",
    tell: Tell,
) -> None:
    """Bakes a building and writes its scene.

    Args:
        building: the plan.
        quality: resolution and samples.
        folder: of the scene; new, or with an earlier scene of the generator.
        python: interpreter with Blender.
        resume: continue an interrupted run of the same plan.
        command: command line recorded in the scene.
        tell: progress callback.

    Raises:
        SceneError: Blender is missing or failed, or the scene became too large.
    """
    check_blender(python)
    work = work_folder(building, quality)
    if not resume:
        shutil.rmtree(work, ignore_errors=True)
    work.mkdir(parents=True, exist_ok=True)
    write_plan(work / "plan.json", building, quality)
    _bake(python, work, tell)
    white = write_scene_folder(building, quality, work, folder, command)
    tell("surroundings", 1.0, None)
    write_surroundings(folder, building, white)
    tell("maps", 1.0, None)
    write_scene_files(folder)
    tell("thumbnail", 1.0, None)
    write_thumbnail(folder, building)
    shutil.rmtree(work)


def work_folder(building: Building, quality: Quality) -> Path:
    """Returns the cache folder for the unfinished atlases of a plan."""
    key = hashlib.sha256(repr((building, quality, gibson_sim.__version__)).encode()).hexdigest()[:16]
    return cache_folder("making") / f"{building.name}-{key}"


def check_blender(python: str) -> None:
    """Checks that an interpreter has Blender.

    Raises:
        SceneError: it has not, or does not run.
    """
    try:
        found = subprocess.run(
            [python, "-c", "import importlib.util as u, sys; sys.exit(u.find_spec('bpy') is None)"],
            check=False,
            capture_output=True,
        )
    except OSError as e:
        raise SceneError(f"--blender-python {python}: cannot be run: {e.strerror or e}; name a Python that has bpy") from e
    if found.returncode:
        raise SceneError(
            f"{python}: has no Blender; `pip install 'gibson_sim_tools[authoring]'` into it, or name one that has bpy with --blender-python"
        )


def _bake(python: str, work: Path, tell: Tell) -> None:
    environment = {**os.environ, "PYTHONPATH": package_path(), "PYTHONWARNINGS": "ignore"}
    command = [python, "-m", "gibson_sim_tools.making.blender", str(work / "plan.json"), str(work)]
    log = work / "blender.log"
    with (
        log.open("w") as errors,
        subprocess.Popen(command, stdout=subprocess.PIPE, stderr=errors, text=True, env=environment) as process,
    ):
        assert process.stdout is not None
        left = _TimeLeft()
        try:
            for line in process.stdout:
                message = _message(line)
                if message is not None:
                    tell(message["text"], message["done"], left.after(message["done"], time.monotonic()))
        except BaseException:
            process.terminate()
            raise
    if process.returncode:
        last = " | ".join(log.read_text(errors="replace").splitlines()[-_LAST_LINES:])
        raise SceneError(
            f"Blender ended with exit code {process.returncode}: {last or 'it said nothing'}; --resume goes on where it stopped"
        )


def _message(line: str) -> dict[str, Any] | None:
    """Returns the message in an output line, or None for a line of Blender's own."""
    try:
        message = json.loads(line)
    except ValueError:
        return None
    return message if isinstance(message, dict) and {"text", "done"} <= set(message) else None


class _TimeLeft:
    """Estimates the remaining time from the elapsed time."""

    def __init__(self) -> None:
        self._first: tuple[float, float] | None = None

    def after(self, done: float, now_s: float) -> float | None:
        """Returns the seconds left; None = unknown yet."""
        if self._first is None:
            self._first = (done, now_s)
        part, since = done - self._first[0], now_s - self._first[1]
        return None if part < 0.05 else since / part * (1.0 - done)
