"""Simulated scans of scenes: scanned, fused and textured by the commands of ``gibson_sim_tools``, stage by stage.

The commands run in processes of their own, since this package does not import that one. A finished stage leaves its command line in a file
``<stage>.done``: it is not run again, and a folder with stages of other settings is rejected.
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
"""Of the scanner's images, pixels."""
_MAX_BYTES = 100_000


def stages(scene: str, folder: Path, settings: PairsSettings) -> dict[str, tuple[list[str], Path]]:
    """Returns name of a stage -> arguments of ``gibson-sim``, and what the stage writes; in their order.

    Args:
        scene: name of the scene.
        folder: of its scan.
        settings: of the scan.
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
    """Scans, fuses and textures a scene as far as that is not done; returns the folder of the scan's scene.

    Args:
        scene: name of the scene.
        folder: of its scan.
        settings: of the scan.
        run: what runs ``gibson-sim`` with arguments; None = a process.

    Raises:
        ConfigError: the folder holds a scan of other settings.
        GibsonSimError: a stage failed.
    """
    run = _run if run is None else run
    # As if run in the folder, which may be moved, or named in another way.
    lines = {stage: shlex.join(arguments) + "\n" for stage, (arguments, _) in stages(scene, Path(), settings).items()}
    for stage, (arguments, output) in stages(scene, folder, settings).items():
        done, line = folder / f"{stage}.done", lines[stage]
        if done.is_file():
            if read_file(done, _MAX_BYTES).decode("utf-8", "replace") != line:
                raise ConfigError(f"{done}: that stage was run with other settings; give another --folder, or delete {folder}")
            if stage != "texture" or output.is_dir():  # the scan and the mesh may be deleted once they are textured
                continue
        # A scan goes on where it was interrupted; the other stages write their output at the end, so what is there is a remainder.
        if stage == "texture":
            shutil.rmtree(output, ignore_errors=True)
        elif stage == "fuse":
            output.unlink(missing_ok=True)
        run(arguments)
        write_file(done, line)
    return folder / TEXTURED


def _run(arguments: Sequence[str]) -> None:
    """Runs ``gibson-sim``; its errors go to the terminal.

    Raises:
        GibsonSimError: it failed.
    """
    found = subprocess.run([sys.executable, "-m", "gibson_sim.cli.main", *arguments], stdout=subprocess.DEVNULL, check=False)
    if found.returncode:
        raise GibsonSimError(
            f"`gibson-sim {shlex.join(arguments)}` failed with exit code {found.returncode}; its message is above"
        )
