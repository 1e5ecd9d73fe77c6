"""Simulated scans of scenes: the commands of ``gibson_sim_tools`` scan, fuse and texture them, stage by stage.

Each command runs in its own process, since this package does not import ``gibson_sim_tools``. A finished stage leaves its command line in a
file ``<stage>.done`` and is not run again; a folder with stages of other settings is rejected.
"""

from __future__ import annotations

import shlex
import shutil
import subprocess
import sys
from collections.abc import Callable, Sequence
from pathlib import Path

from gibson_sim.errors import ConfigError, GibsonSimError
from gibson_sim.reading import read_file
from gibson_sim.writing import write_file
from gibson_sim_learn.filler.settings import PairsSettings

TEXTURED = "textured"
"""Folder of a scan's scene, in the folder of the scan."""
_VOXEL = 0.02
"""Edge of a voxel, metres."""
_SIZE = (320, 240)
"""Width and height of the scanner's images, pixels."""
_MAX_BYTES = 100_000


def stages(scene: str, folder: Path, settings: PairsSettings) -> dict[str, tuple[list[str], Path]]:
    """Returns, in order, name of a stage -> arguments of ``gibson-sim`` and the output of the stage.

    Args:
        scene: name of the scene.
        folder: folder of its scan.
        settings: settings of the scan.
    """
    scan, mesh, textured = folder / "scan", folder / "mesh.ply", folder / TEXTURED
    width, height = _SIZE
    options: dict[str, list[object]] = {
        "scan": [scene, "--preset", "kinect", "--frames", settings.frames, "--width", width, "--height", height, "--seed", settings.seed + 1],
        "fuse": [scan, "--voxel", _VOXEL, "--triangles", settings.triangles],
        "texture": [scan, mesh],
    }  # fmt: skip
    outputs = {"scan": scan, "fuse": mesh, "texture": textured}
    return {
        stage: (["scene", stage, *(str(word) for word in given), "--output", str(outputs[stage])], outputs[stage])
        for stage, given in options.items()
    }


def make_scan(scene: str, folder: Path, settings: PairsSettings, run: Callable[[Sequence[str]], None] | None = None) -> Path:
    """Runs the missing stages of a scan; returns the folder of the scan's scene.

    Args:
        scene: name of the scene.
        folder: folder of its scan.
        settings: settings of the scan.
        run: runs ``gibson-sim`` with arguments; None = in a new process.

    Raises:
        ConfigError: the folder holds a scan with other settings.
        GibsonSimError: a stage failed.
    """
    run = _run if run is None else run
    # Paths relative to the folder: it may be moved, or named in another way.
    lines = {stage: shlex.join(arguments) + "\n" for stage, (arguments, _) in stages(scene, Path(), settings).items()}
    for stage, (arguments, output) in stages(scene, folder, settings).items():
        done, line = folder / f"{stage}.done", lines[stage]
        if done.is_file():
            if read_file(done, _MAX_BYTES).decode("utf-8", "replace") != line:
                raise ConfigError(f"{done}: that stage was run with other settings; give another --folder, or delete {folder}")
            if stage != "texture" or output.is_dir():  # scan and mesh may be deleted after texturing
                continue
        # An interrupted scan resumes. The other stages write their output at the end, so any existing output is left over.
        if stage == "texture":
            shutil.rmtree(output, ignore_errors=True)
        elif stage == "fuse":
            output.unlink(missing_ok=True)
        run(arguments)
        write_file(done, line)
    return folder / TEXTURED


def _run(arguments: Sequence[str]) -> None:
    """Runs ``gibson-sim``; its errors are printed on the terminal.

    Raises:
        GibsonSimError: the command failed.
    """
    found = subprocess.run([sys.executable, "-m", "gibson_sim.cli.main", *arguments], stdout=subprocess.DEVNULL, check=False)
    if found.returncode:
        raise GibsonSimError(
            f"`gibson-sim {shlex.join(arguments)}` failed with exit code {found.returncode}; its message is above"
        )
