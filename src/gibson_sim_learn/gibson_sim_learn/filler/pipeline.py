"""The three steps of the filler, in one folder: pairs, training, evaluation. Training needs PyTorch and onnx.

The folder holds ``scans/`` (a folder for each scene), ``pairs/`` (shards) and ``training/`` (checkpoint, curve, network, card).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from gibson_sim.errors import ConfigError
from gibson_sim.picture_files import write_picture
from gibson_sim.quoting import quoted
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
from gibson_sim_learn.filler.scans import TEXTURED, make_scan
from gibson_sim_learn.filler.settings import EvaluationSettings, PairsSettings, TrainingSettings
from gibson_sim_learn.path_following.split import HELD_OUT, TRAINING, VALIDATION
from gibson_sim_learn.training_folder import locked

SCANS, PAIRS, TRAINED = "scans", "pairs", "training"
"""Subfolders of a filler's folder."""
MODEL, CARD = "filler.onnx", "filler.md"
SCENES = (*TRAINING, *VALIDATION, *HELD_OUT)
_JUDGED_SHARDS = 2
"""Number of shards of each validation and held-out scene."""


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
