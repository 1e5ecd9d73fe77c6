"""The complete training pipeline of Goggles: pairs, network, ONNX file, colour reference, model card, examples. Needs PyTorch and onnx."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from gibson_path_following.images.goggles import (
    ColourReference,
    Goggles,
    GreyWorldGoggles,
    HistogramGoggles,
    LearnedGoggles,
    make_goggles,
)
from gibson_sim.picture_files import write_picture
from gibson_sim.writing import write_file
from gibson_sim_learn.goggles.export import export_network, score_table, write_card
from gibson_sim_learn.goggles.pairs import U8, VIEWS, Pairs, is_original, load_pairs, load_shard, make_pairs, shard_name
from gibson_sim_learn.goggles.scoring import mean_of, score
from gibson_sim_learn.goggles.settings import GogglesSettings, as_dict
from gibson_sim_learn.goggles.training import GogglesPoint, GogglesTraining
from gibson_sim_learn.path_following.drawing import HEIGHT, WIDTH
from gibson_sim_learn.path_following.split import TRAINING, VALIDATION
from gibson_sim_learn.training_folder import training_folder

MODEL, CARD, REFERENCE, SHEET = "goggles.onnx", "goggles.md", "simulator_look.csv", "sheet.png"
"""Files in the folder of a training: network, model card, colour reference (histograms of the simulator's images), contact sheet."""


@dataclass(frozen=True, slots=True)
class _EvaluationSet:
    """Pairs of the validation scenes in one domain."""

    domain: str
    views: int = VIEWS
    shots: int = 2
    size: tuple[int, int] = (WIDTH, HEIGHT)
    """Width and height of an image, pixels."""
    every: int = 4
    """Stride of the views that are scored."""

    @property
    def name(self) -> str:
        return f"{self.domain}-{self.size[0]}x{self.size[1]}"


VALIDATION_SET = _EvaluationSet("development")
"""Pairs for the training curve and for the choice of hyperparameters."""
EVALUATION_SETS = (
    VALIDATION_SET,
    _EvaluationSet("reality"),
    _EvaluationSet("reality", views=12, shots=1, size=(640, 480), every=1),
)
"""Pairs for the metrics of the model card."""
_ROWS = 10
"""Rows of the contact sheet."""


@dataclass(frozen=True, slots=True)
class Learned:
    """Files and metrics of a training."""

    model: Path
    card: Path
    point: GogglesPoint
    size: int
    """Size of the network's file, bytes."""
    scores: Sequence[str]
    """A Markdown table, line by line."""


def learn(folder: Path, settings: GogglesSettings, progress: Callable[[str], None] = lambda text: None) -> Learned:
    """Trains in a folder, or resumes there, and writes the network.

    Args:
        folder: folder of pairs, checkpoint, curve, network, colour reference, card and contact sheet.
        settings: settings of the training.
        progress: called with one line of progress.

    Raises:
        GibsonSimError: there is no OpenGL device, or the folder holds another training, or another process trains in it.
    """
    with training_folder(folder, as_dict(settings), GogglesTraining.MAY_CHANGE):
        return _learn(folder, settings, progress)


def _learn(folder: Path, settings: GogglesSettings, progress: Callable[[str], None]) -> Learned:
    """Trains in a locked folder, see ``learn``."""
    training, pairs = GogglesTraining(folder, settings), folder / "pairs"
    make_pairs(pairs / "training", TRAINING, settings.shards, settings.seed, shots=settings.shots, progress=progress)
    validation = _evaluation_pairs(VALIDATION_SET, pairs, settings.seed, progress)
    data = load_pairs(pairs / "training")
    training.run(data, validation, progress)
    size = export_network(training.network, folder / MODEL)
    originals = [
        load_shard(pairs / "training" / shard_name(scene, number))
        for number in range(settings.shards)
        for scene in TRAINING
        if is_original(number)
    ]
    reference = ColourReference.of_images(image for part in originals for image in part.clean)
    write_file(folder / REFERENCE, reference.as_text())
    methods = goggles_methods(folder / MODEL, reference)
    scores: dict[str, dict[str, str]] = {}
    for one in EVALUATION_SETS:
        evaluated = _evaluation_pairs(one, pairs, settings.seed, progress)
        progress(f"scores: {one.name}")
        scores[one.name] = {name: str(score(evaluated, adapt, one.every)) for name, adapt in methods.items()}
        for mode in ("grey_world", "histogram"):
            per_scene = [
                score([part], make_goggles(mode, reference=ColourReference.of_images(part.clean)), one.every)
                for part in evaluated
            ]
            scores[one.name][f"{mode}, the scene's own images as reference"] = str(mean_of(per_scene))
    write_picture(folder / SHEET, sheet(validation, methods)[..., ::-1])
    point = training.curve[-1]
    count = sum(part.seen.shape[0] * part.seen.shape[1] for part in data)
    write_card(folder / CARD, settings, training.network, point, count, scores)
    return Learned(folder / MODEL, folder / CARD, point, size, score_table(scores))


def goggles_methods(model: Path, reference: ColourReference) -> dict[str, Goggles]:
    """Returns the compared methods by name; ``nothing`` returns the unchanged image."""
    return {
        "nothing": lambda image: image,
        "grey_world": GreyWorldGoggles(reference),
        "histogram": HistogramGoggles(reference),
        "learned": LearnedGoggles(model),
    }


def sheet(pairs: Sequence[Pairs], methods: dict[str, Goggles]) -> U8:
    """Returns a contact sheet, RGB: in each row one view, adapted by each method, and the simulator's image; evenly spaced in the pairs."""
    rows = []
    for k in range(_ROWS):
        part = pairs[k % len(pairs)]
        view = k * len(part.clean) // _ROWS
        seen = np.ascontiguousarray(part.seen[view, 0])
        rows.append(np.concatenate([*(adapt(seen) for adapt in methods.values()), part.clean[view]], axis=1))
    return np.concatenate(rows).repeat(2, axis=0).repeat(2, axis=1)


def _evaluation_pairs(evaluation: _EvaluationSet, folder: Path, seed: int, progress: Callable[[str], None]) -> list[Pairs]:
    """Returns the pairs of an evaluation set; missing ones are rendered."""
    make_pairs(
        folder / evaluation.name,
        VALIDATION,
        1,
        seed,
        views=evaluation.views,
        shots=evaluation.shots,
        domains=(evaluation.domain,),
        recoloured=False,
        size=evaluation.size,
        progress=progress,
    )
    return load_pairs(folder / evaluation.name)
