"""Runs Blender on a plan in a separate process, and writes the scene folder from the bake."""

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
from gibson_sim.writing import write_file
from gibson_sim_tools import package_path
from gibson_sim_tools.making.building import Building, Quality, write_plan
from gibson_sim_tools.making.pictures import write_surroundings, write_thumbnail
from gibson_sim_tools.making.scene_folder import write_scene_folder

ReportProgress = Callable[[str, float, float | None], None]
"""Callback; receives the current task, the completed fraction (0 to 1), and the remaining seconds (None = unknown)."""
_FINISHED = "finished"
"""File in the cache folder of a finished plan, with the path of its scene."""
_MAX_LOG_LINES = 12
"""Number of last lines of Blender's log in an error message."""


def make_scene(
    building: Building,
    quality: Quality,
    folder: Path,
    *,
    python: str = sys.executable,
    resume: bool = False,
    command: str = "",
    report: ReportProgress,
) -> None:
    """Bakes a building and writes its scene.

    Args:
        building: the plan.
        quality: resolution and samples.
        folder: folder of the scene; new, or with an earlier scene of the generator.
        python: Python interpreter with Blender.
        resume: continue an interrupted run of the same plan; a run that was finished is not repeated.
        command: command line recorded in the scene.
        report: progress callback.

    Raises:
        SceneError: Blender is missing or failed, or the scene became too large.
    """
    work = work_folder(building, quality)
    finished = work / _FINISHED
    if resume and finished.exists() and finished.read_text(encoding="utf-8") == str(folder.resolve()) and folder.exists():
        report("finished before", 1.0, None)
        return
    check_blender(python)
    if not resume:
        shutil.rmtree(work, ignore_errors=True)
    work.mkdir(parents=True, exist_ok=True)
    write_plan(work / "plan.json", building, quality)
    _bake(python, work, report)
    white = write_scene_folder(building, quality, work, folder, command)
    report("surroundings", 1.0, None)
    write_surroundings(folder, building, white)
    report("maps", 1.0, None)
    write_scene_files(folder)
    report("thumbnail", 1.0, None)
    write_thumbnail(folder, building)
    shutil.rmtree(work)
    write_file(finished, str(folder.resolve()))


def work_folder(building: Building, quality: Quality) -> Path:
    """Returns the cache folder of a plan: its unfinished light maps, or the note that its scene is finished."""
    key = hashlib.sha256(repr((building, quality, gibson_sim.__version__)).encode()).hexdigest()[:16]
    return cache_folder("making") / f"{building.name}-{key}"


def check_blender(python: str) -> None:
    """Checks that a Python interpreter has Blender.

    Raises:
        SceneError: Blender is missing, or the interpreter does not run.
    """
    try:
        result = subprocess.run(
            [python, "-c", "import importlib.util as u, sys; sys.exit(u.find_spec('bpy') is None)"],
            check=False,
            capture_output=True,
        )
    except OSError as e:
        raise SceneError(f"--blender-python {python}: cannot be run: {e.strerror or e}; name a Python that has bpy") from e
    if result.returncode:
        raise SceneError(
            f"{python}: has no Blender; `pip install 'gibson_sim_tools[authoring]'` into it, or name one that has bpy with --blender-python"
        )


def _bake(python: str, work: Path, report: ReportProgress) -> None:
    environment = {**os.environ, "PYTHONPATH": package_path(), "PYTHONWARNINGS": "ignore"}
    command = [python, "-m", "gibson_sim_tools.making.blender", str(work / "plan.json"), str(work)]
    log = work / "blender.log"
    with (
        log.open("w") as errors,
        subprocess.Popen(command, stdout=subprocess.PIPE, stderr=errors, text=True, env=environment) as process,
    ):
        assert process.stdout is not None
        time_left = _TimeLeft()
        try:
            for line in process.stdout:
                message = _message(line)
                if message is not None:
                    report(message["text"], message["done"], time_left.estimate(message["done"], time.monotonic()))
        except BaseException:
            process.terminate()
            raise
    if process.returncode:
        last_lines = " | ".join(log.read_text(errors="replace").splitlines()[-_MAX_LOG_LINES:])
        raise SceneError(
            f"Blender ended with exit code {process.returncode}: {last_lines or 'no output'}; --resume continues from there"
        )


def _message(line: str) -> dict[str, Any] | None:
    """Returns the progress message in an output line; None for other output of Blender."""
    try:
        message = json.loads(line)
    except ValueError:
        return None
    return message if isinstance(message, dict) and {"text", "done"} <= set(message) else None


class _TimeLeft:
    """Estimates the remaining time from the elapsed time."""

    def __init__(self) -> None:
        self._first: tuple[float, float] | None = None

    def estimate(self, done: float, now_s: float) -> float | None:
        """Returns the remaining seconds; None = not yet known. ``done``: completed fraction, ``now_s``: monotonic time."""
        if self._first is None:
            self._first = (done, now_s)
        progress, elapsed_s = done - self._first[0], now_s - self._first[1]
        return None if progress < 0.05 else elapsed_s / progress * (1.0 - done)
