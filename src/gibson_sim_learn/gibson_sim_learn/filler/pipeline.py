"""The three steps of the filler, in one folder: pairs, training, evaluation. Training needs PyTorch and onnx.

The folder holds ``scans/`` (a folder for each scene), ``pairs/`` (shards) and ``training/`` (checkpoint, curve, network, card).
Scans are simulated: the commands of ``gibson_sim_tools`` scan, fuse and texture the scenes, stage by stage. Each command runs in its own
process, since this package does not import ``gibson_sim_tools``. A finished stage leaves its command line in a file ``<stage>.done`` and is not
run again; a folder with stages of other settings is rejected.
"""

from __future__ import annotations

import shlex
import shutil
import subprocess
import sys
from collections.abc import Callable, Sequence
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from gibson_sim.errors import ConfigError, GibsonSimError
from gibson_sim.picture_files import write_picture
from gibson_sim.quoting import quoted
from gibson_sim.reading import read_file
from gibson_sim.writing import write_file
from gibson_sim_learn.filler.evaluation import (
    Flicker,
    as_json,
    beats_baselines,
    fill_methods,
    flicker_of,
    mean_flicker,
    scores_of,
    sheet,
    table,
)
from gibson_sim_learn.filler.pairs import (
    ScannedScene,
    check_present,
    check_stored_settings,
    data_hash,
    load_pairs,
    make_pairs,
    missing_shards,
    shard_name,
    store_settings,
    stored_settings,
)
from gibson_sim_learn.filler.settings import EvaluationSettings, PairsSettings, TrainingSettings
from gibson_sim_learn.path_following.split import HELD_OUT, TRAINING, VALIDATION
from gibson_sim_learn.training_folder import locked

SCANS, PAIRS, TRAINED = "scans", "pairs", "training"
"""Subfolders of a filler's folder."""
MODEL, CARD = "filler.onnx", "filler.md"
SCENES = (*TRAINING, *VALIDATION, *HELD_OUT)
_JUDGED_SHARDS = 2
"""Number of shards of each validation and held-out scene."""
TEXTURED = "textured"
"""Folder of a scan's scene, in the folder of the scan."""
_VOXEL = 0.02
"""Edge of a voxel, metres."""
_SIZE = (320, 240)
"""Width and height of the scanner's images, pixels."""
_MAX_BYTES = 100_000


@dataclass(frozen=True, slots=True)
class Trained:
    """Result of a training."""

    model: Path
    card: Path
    size: int
    """Size of the model, bytes."""
    summary: str
    """Scores on the validation scenes, in one line."""


@dataclass(frozen=True, slots=True)
class Evaluated:
    """Result of an evaluation."""

    lines: Sequence[str]
    """A Markdown table, line by line."""
    values: dict[str, Any]
    """The same as plain values, for JSON."""


def make_all_pairs(
    folder: Path,
    settings: PairsSettings,
    scenes: Sequence[str] = SCENES,
    progress: Callable[[str], None] = lambda text: None,
) -> None:
    """Scans scenes and renders their missing pairs; damaged pairs are rendered again.

    Several processes can share a folder if their scenes differ.

    Raises:
        GibsonSimError: a scene is unknown, there is no OpenGL device, a stage failed, another process works on one of the scenes, or
            the folder holds scans with other settings.
    """
    for scene in scenes:
        if scene not in SCENES:
            raise ConfigError(f"scene {quoted(scene)} is none of the filler's, must be one of {', '.join(SCENES)}")
    scenes = list(dict.fromkeys(scenes))
    with ExitStack() as locks:
        for scene in scenes:
            locks.enter_context(locked(folder / SCANS / scene, "other --scenes, or another --folder"))
        check_stored_settings(folder / PAIRS, settings)
        for scene in scenes:
            progress(f"scanning {scene}")
            scan = make_scan(scene, folder / SCANS / scene, settings)
            store_settings(folder / PAIRS, settings)  # the scan has accepted them
            make_pairs(folder / PAIRS, scene, scan, _count(scene, settings), settings.seed, progress)


def missing_for_training(folder: Path) -> list[str]:
    """Returns the names of the missing shards that ``train`` needs."""
    return missing_shards(folder / PAIRS, _shards(folder, (*TRAINING, *VALIDATION)))


def train(folder: Path, settings: TrainingSettings, progress: Callable[[str], None] = lambda text: None) -> Trained:
    """Trains with the pairs of a folder, or resumes there, and writes the network at each point of the curve.

    Raises:
        ConfigError: pairs are missing or damaged, or the folder holds another training.
    """
    # Imported here, since pairs and evaluation do not need PyTorch.
    from gibson_sim_learn.filler.export import export_network, write_card
    from gibson_sim_learn.filler.training import FillerTraining

    check_present(folder / PAIRS, _shards(folder, (*TRAINING, *VALIDATION)))
    names, place = _shards(folder, TRAINING), folder / TRAINED
    pairs = load_pairs(folder / PAIRS, names, progress)
    validation = load_pairs(folder / PAIRS, _shards(folder, VALIDATION), progress)
    data = data_hash(folder / PAIRS, names)
    training = FillerTraining(place, settings, data)

    def export() -> int:
        size = export_network(training.best, place / MODEL, settings, data, training.best_point.iteration)
        count = sum(len(part.hole) for part in pairs)
        write_card(place / CARD, settings, training, count, stored_settings(folder / PAIRS))
        return size

    training.run(pairs, validation, progress, export)
    size, point = export(), training.best_point
    return Trained(
        place / MODEL,
        place / CARD,
        size,
        f"validation scenes: holes {point.hole_psnr:.2f} dB, seen {point.seen_psnr:.2f} dB, GMSD {point.gmsd:.3f}",
    )


def evaluate(
    folder: Path,
    scenes: Sequence[str],
    model: Path | None,
    settings: EvaluationSettings,
    *,
    sheet_file: Path | None = None,
    progress: Callable[[str], None] = lambda text: None,
) -> Evaluated:
    """Compares a network with methods without training.

    Args:
        folder: folder with scans and pairs.
        scenes: scenes of the comparison.
        model: file of the network, by which the result names it; None = the network of the folder, named ``learned``.
        settings: settings of the comparison.
        sheet_file: file for a contact sheet of examples; None = none.
        progress: called with one line of progress.

    Raises:
        GibsonSimError: the model is not a filler network, pairs are missing, or there is no OpenGL device.
    """
    network = "learned" if model is None else str(model)
    methods = fill_methods(folder / TRAINED / MODEL if model is None else model, network)
    names = _shards(folder, scenes)
    pairs = load_pairs(folder / PAIRS, names, progress)
    scores = scores_of(pairs, methods, settings.every, progress)
    flicker: dict[str, Flicker] = {}
    if settings.drive:
        found = []
        for scene in scenes:
            progress(f"flicker: {scene}")
            found.append(
                flicker_of(ScannedScene.load(scene, folder / SCANS / scene / TEXTURED), methods, settings.seed, settings.drive)
            )
        flicker = mean_flicker(found)
    if sheet_file is not None:
        write_picture(sheet_file, sheet(pairs, methods, network, settings.seed)[..., ::-1])
    values: dict[str, Any] = {
        "scenes": list(scenes),
        "views": sum(len(range(0, len(part.hole), settings.every)) for part in pairs),
        "data": data_hash(folder / PAIRS, names),
        "scores": as_json(scores),
        "flicker": as_json(flicker),
        "beats_baselines": beats_baselines(scores, network),
    }
    return Evaluated(table(scores, flicker), values)


def _shards(folder: Path, scenes: Sequence[str]) -> list[str]:
    """Returns the names of all shards of some scenes, in order of scene and number, according to the stored settings."""
    settings = stored_settings(folder / PAIRS)
    return [shard_name(scene, number) for scene in scenes for number in range(_count(scene, settings))]


def _count(scene: str, settings: PairsSettings) -> int:
    return settings.shards if scene in TRAINING else _JUDGED_SHARDS


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
