"""The whole training of Goggles by one call: pairs, network, ONNX, look of the simulator, card, examples. Needs PyTorch and onnx."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from gibson_path_following.goggles import (
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
from gibson_sim_learn.goggles.settings import GogglesSettings
from gibson_sim_learn.goggles.training import GogglesPoint, GogglesTraining
from gibson_sim_learn.path_following.drawing import HEIGHT, WIDTH
from gibson_sim_learn.path_following.split import TRAINING, VALIDATION

MODEL, CARD, LOOK, SHEET = "goggles.onnx", "goggles.md", "simulator_look.csv", "sheet.png"
"""Files of a training's folder: the network, its card, how often each level is in the simulator's images, and examples."""


@dataclass(frozen=True, slots=True)
class _Judged:
    """Pairs of the validation scenes."""

    domain: str
    views: int = VIEWS
    shots: int = 2
    size: tuple[int, int] = (WIDTH, HEIGHT)
    """Width and height of an image, pixels."""
    every: int = 4
    """One of so many views is scored."""

    @property
    def name(self) -> str:
        return f"{self.domain}-{self.size[0]}x{self.size[1]}"


CHOSEN_BY = _Judged("development")
"""What the curve is measured in, and parameters are chosen by."""
JUDGED_IN = (CHOSEN_BY, _Judged("reality"), _Judged("reality", views=12, shots=1, size=(640, 480), every=1))
"""What the card has scores of."""
_ROWS = 10
"""Rows of the sheet."""


@dataclass(frozen=True, slots=True)
class Learned:
    """What a training left."""

    model: Path
    card: Path
    point: GogglesPoint
    size: int
    """Of the model, bytes."""
    scores: Sequence[str]
    """A Markdown table, line by line."""


def learn(folder: Path, settings: GogglesSettings, progress: Callable[[str], None] = lambda text: None) -> Learned:
    """Trains in a folder, or goes on there, and writes the network.

    Args:
        folder: pairs, checkpoint, curve, network, look, card and sheet are put here.
        settings: the configuration.
        progress: called with one line now and then.

    Raises:
        GibsonSimError: nothing can be drawn here, or the folder holds another training.
    """
    training, drawn = GogglesTraining(folder, settings), folder / "pairs"
    make_pairs(drawn / "training", TRAINING, settings.shards, settings.seed, shots=settings.shots, progress=progress)
    chosen_by = _drawn(CHOSEN_BY, drawn, settings.seed, progress)
    data = load_pairs(drawn / "training")
    training.run(data, chosen_by, progress)
    size = export_network(training.network, folder / MODEL)
    originals = [
        load_shard(drawn / "training" / shard_name(scene, number))
        for number in range(settings.shards)
        for scene in TRAINING
        if is_original(number)
    ]
    look = ColourReference.of_images(image for part in originals for image in part.clean)
    write_file(folder / LOOK, look.as_text())
    ways = ways_of(folder / MODEL, look)
    scores: dict[str, dict[str, str]] = {}
    for one in JUDGED_IN:
        judged = _drawn(one, drawn, settings.seed, progress)
        progress(f"scores: {one.name}")
        scores[one.name] = {name: str(score(judged, bring, one.every)) for name, bring in ways.items()}
        for mode in ("grey_world", "histogram"):
            brought = [
                score([part], make_goggles(mode, reference=ColourReference.of_images(part.clean)), one.every) for part in judged
            ]
            scores[one.name][f"{mode}, the scene's own images as reference"] = str(mean_of(brought))
    write_picture(folder / SHEET, sheet(chosen_by, ways)[..., ::-1])
    point = training.curve[-1]
    count = sum(part.seen.shape[0] * part.seen.shape[1] for part in data)
    write_card(folder / CARD, settings, training.network, point, count, scores)
    return Learned(folder / MODEL, folder / CARD, point, size, score_table(scores))


def ways_of(model: Path, look: ColourReference) -> dict[str, Goggles]:
    """Returns by name what is compared; ``nothing`` leaves an image as it is."""
    return {
        "nothing": lambda image: image,
        "grey_world": GreyWorldGoggles(look),
        "histogram": HistogramGoggles(look),
        "learned": LearnedGoggles(model),
    }


def sheet(pairs: Sequence[Pairs], ways: dict[str, Goggles]) -> U8:
    """Returns a picture, RGB: in each row a view as seen, by each of the ways, and the simulator's own; evenly chosen from the pairs."""
    rows = []
    for k in range(_ROWS):
        part = pairs[k % len(pairs)]
        view = k * len(part.clean) // _ROWS
        seen = np.ascontiguousarray(part.seen[view, 0])
        rows.append(np.concatenate([*(bring(seen) for bring in ways.values()), part.clean[view]], axis=1))
    return np.concatenate(rows).repeat(2, axis=0).repeat(2, axis=1)


def _drawn(judged: _Judged, folder: Path, seed: int, progress: Callable[[str], None]) -> list[Pairs]:
    """Returns pairs of the validation scenes, which are drawn if they are not there."""
    make_pairs(
        folder / judged.name,
        VALIDATION,
        1,
        seed,
        views=judged.views,
        shots=judged.shots,
        domains=(judged.domain,),
        recoloured=False,
        size=judged.size,
        progress=progress,
    )
    return load_pairs(folder / judged.name)
