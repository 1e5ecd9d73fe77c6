"""Trains the network of the filler: steps of the optimiser, a curve on the validation scenes, checkpoints. Needs PyTorch.

Everything lies in one folder. An interrupted training goes on from its last checkpoint; with the same settings, pairs and software on the
same kind of processor it gives what an uninterrupted one gives, up to the rounding of sums.
"""

from __future__ import annotations

import copy
import time
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor
from torch.nn import functional

from gibson_sim.errors import ConfigError
from gibson_sim.filling.inputs import packed
from gibson_sim_learn.filler.network import FillerNetwork
from gibson_sim_learn.filler.pairs import Pairs, depth_of, is_hole, normals_of
from gibson_sim_learn.filler.scoring import Score, Scoring
from gibson_sim_learn.filler.settings import TrainingSettings
from gibson_sim_learn.training import (
    descend,
    has_bfloat16,
    load_checkpoint,
    save_checkpoint,
    set_step_size,
    step_size,
    write_curve,
)

F32 = NDArray[np.float32]
U8 = NDArray[np.uint8]

_WARM_UP = 200
"""Iterations in which the step size rises."""
_MEAN = 0.998
"""Share of the mean of the weights that a step leaves: what is exported is the mean, which is better than the last step."""
_EVERY = 4
"""A point of the curve is made of every so many views."""
_SOFT = 0.05
"""Errors of colours, of 1, below which they count squared, not as they are."""
_HOLES = 1.0
"""How much more pixels in holes count."""
_EDGES, _SCALES = 0.5, (1, 2, 4)
"""Weight of the differences of neighbours relative to that of the pixels; sizes of the pictures that they are taken in."""
_GAINS = (0.65, 1.15)
"""Factors on each colour of a cutting, for variety."""
_REORDERED = 0.3
"""Probability that a cutting has its red, green and blue exchanged, for variety."""
_MAY_CHANGE = ("iterations", "evaluate_every")
"""Settings by which a training can be made longer."""
_PANELS = (
    ("loss of training", ["loss"]),
    ("holes, validation scenes, PSNR dB", ["hole_psnr"]),
    ("seen, validation scenes, PSNR dB", ["seen_psnr"]),
    ("GMSD, validation scenes", ["gmsd"]),
)
"""Of the curve: title and fields of its points."""


@dataclass(frozen=True, slots=True)
class CurvePoint:
    """How near pictures are to the truth after some iterations, on the validation scenes."""

    iteration: int
    loss: float
    """Mean loss of training since the point before."""
    hole_psnr: float
    """dB."""
    seen_psnr: float
    """dB."""
    gmsd: float
    processor_s: float
    """Processor time of the training so far, seconds."""

    @property
    def rank(self) -> float:
        """By which the best point is chosen: the sum of both PSNRs, dB."""
        return self.hole_psnr + self.seen_psnr


class Training:
    """One training in one folder."""

    def __init__(self, folder: Path, settings: TrainingSettings, data: str) -> None:
        """Begins, or goes on from the checkpoint in the folder.

        Args:
            folder: of the training.
            settings: of the training.
            data: hash of the pairs.

        Raises:
            ConfigError: the checkpoint in the folder is of other settings or pairs, or cannot be read.
        """
        self.folder, self.settings, self.data = folder, settings, data
        torch.manual_seed(settings.seed)
        self._network = FillerNetwork().to(memory_format=torch.channels_last)
        self.network = copy.deepcopy(self._network)
        """The mean of the weights of the last steps."""
        self.best = copy.deepcopy(self._network)
        """The same at the best point of the curve: a long training learns its scenes by heart."""
        self._optimiser = torch.optim.AdamW(
            self._network.parameters(), lr=settings.learning_rate, weight_decay=settings.weight_decay
        )
        self._rng = np.random.default_rng(settings.seed)
        self._half = has_bfloat16()
        self.iteration = 0
        self.curve: list[CurvePoint] = []
        self._processor_s = 0.0
        if self.checkpoint.exists():
            self._load()

    @property
    def checkpoint(self) -> Path:
        """File of the newest checkpoint."""
        return self.folder / "checkpoint.pt"

    @property
    def best_point(self) -> CurvePoint:
        """The point of the curve, which has one at least, with the best pictures of the validation scenes."""
        return max(self.curve, key=lambda point: point.rank)

    def run(
        self,
        data: Sequence[Pairs],
        validation: Sequence[Pairs],
        progress: Callable[[str], None] = lambda text: None,
        after_point: Callable[[], object] = lambda: None,
    ) -> None:
        """Trains until the iteration of the settings, with a checkpoint and a point of the curve every so many.

        Args:
            data: what it trains on.
            validation: what the curve is measured on.
            progress: called with one line after each tenth iteration.
            after_point: called after each point of the curve.
        """
        settings, losses, until = self.settings, [], self.settings.iterations
        began, before, start = time.monotonic(), time.process_time(), self.iteration
        while self.iteration < until:
            set_step_size(self._optimiser, step_size(settings.learning_rate, self.iteration, until, _WARM_UP))
            losses.append(self._step(*batch_of(data, self._rng, settings.batch, settings.crop)))
            self.iteration += 1
            if self.iteration % 10 == 0:
                left = (time.monotonic() - began) / (self.iteration - start) * (until - self.iteration)
                progress(f"iteration {self.iteration} of {until}, loss {np.mean(losses[-50:]):.4f}, {left / 60.0:.0f} min left")
            if self.iteration % settings.evaluate_every == 0 or self.iteration == until:
                self._processor_s += time.process_time() - before
                found = self._scored(validation)
                self.curve.append(
                    CurvePoint(
                        self.iteration,
                        round(float(np.mean(losses)), 5),
                        round(found.hole_psnr, 3),
                        round(found.seen_psnr, 3),
                        round(found.gmsd, 4),
                        round(self._processor_s, 1),
                    )
                )
                if self.curve[-1] is self.best_point:
                    self.best.load_state_dict(self.network.state_dict())
                before, losses = time.process_time(), []
                self._save()
                progress(f"iteration {self.iteration}: {found}")
                after_point()

    def fill(self, values: F32) -> U8:
        """Returns a picture (H, W, 3) of an input (1, 9, H, W)."""
        with torch.inference_mode(), torch.autocast("cpu", dtype=torch.bfloat16, enabled=self._half):
            found = self.network(torch.from_numpy(values).contiguous(memory_format=torch.channels_last))
        picture = found.float()[0].permute(1, 2, 0).clamp(0.0, 1.0).mul(255.0).round()
        return np.asarray(picture.to(torch.uint8).numpy())

    def _scored(self, pairs: Sequence[Pairs]) -> Score:
        scoring = Scoring()
        for part in pairs:
            for k in range(0, len(part.hole), _EVERY):
                values = packed(
                    np.array(part.filled[k]), depth_of(part.depth_mm[k]), normals_of(part.normals[k]), np.array(part.hole[k])
                )
                scoring.add(self.fill(values), part.truth[k], is_hole(part.hole[k]))
        return scoring.score()

    def _step(self, values: F32, truth: F32) -> float:
        inputs = torch.from_numpy(values).contiguous(memory_format=torch.channels_last)
        with torch.autocast("cpu", dtype=torch.bfloat16, enabled=self._half):
            found = self._network(inputs)
        loss = loss_of(found.float(), torch.from_numpy(truth), inputs[:, 7:8])
        told = descend(self._network, self._optimiser, loss, 1.0)
        share = min(_MEAN, (1.0 + self.iteration) / (10.0 + self.iteration))
        with torch.no_grad():
            for mean, new in zip(self.network.parameters(), self._network.parameters(), strict=True):
                mean.lerp_(new, 1.0 - share)
        return told

    def _save(self) -> None:
        content = {
            "settings": asdict(self.settings),
            "data": self.data,
            "network": self._network.state_dict(),
            "mean": self.network.state_dict(),
            "best": self.best.state_dict(),
            "optimiser": self._optimiser.state_dict(),
            "rng": self._rng.bit_generator.state,
            "iteration": self.iteration,
            "curve": [asdict(point) for point in self.curve],
            "processor_s": self._processor_s,
        }
        save_checkpoint(self.checkpoint, content)
        write_curve(self.folder, self.curve, _PANELS)

    def _load(self) -> None:
        content = load_checkpoint(self.checkpoint, asdict(self.settings), _MAY_CHANGE)
        data = content.get("data")
        if data != self.data:
            raise ConfigError(
                f"{self.folder}: holds a training with other pairs ({data}, here {self.data}); choose another --folder"
            )
        self._network.load_state_dict(content["network"])
        self.network.load_state_dict(content["mean"])
        self.best.load_state_dict(content["best"])
        self._optimiser.load_state_dict(content["optimiser"])
        self._rng.bit_generator.state = content["rng"]
        self.iteration = content["iteration"]
        self.curve = [CurvePoint(**point) for point in content["curve"]]
        self._processor_s = content["processor_s"]


def batch_of(data: Sequence[Pairs], rng: np.random.Generator, count: int, side: int) -> tuple[F32, F32]:
    """Returns random cuttings of views: inputs (count, 9, side, side) and truth (count, 3, side, side), 0 to 1.

    Half of them are mirrored, and their colours are changed, input and truth alike.
    """
    examples = [_example(data[int(rng.integers(len(data)))], rng, side) for _ in range(count)]
    return np.concatenate([values for values, _ in examples]), np.stack([truth for _, truth in examples])


def _example(part: Pairs, rng: np.random.Generator, side: int) -> tuple[F32, F32]:
    """Returns (1, 9, side, side) and (3, side, side)."""
    view = int(rng.integers(len(part.hole)))
    top, left = (int(rng.integers(size - side + 1)) for size in part.hole.shape[1:])
    step = -1 if rng.random() < 0.5 else 1

    def cut(images: NDArray[Any]) -> NDArray[Any]:
        return np.ascontiguousarray(images[view, top : top + side, left : left + side][:, ::step])

    # A mirrored picture shows a mirrored world: its normals are mirrored, too.
    normals = normals_of(cut(part.normals))
    normals[:, :, 0] *= step
    values = packed(cut(part.filled), depth_of(cut(part.depth_mm)), normals, cut(part.hole))
    truth = cut(part.truth).transpose(2, 0, 1)
    order = rng.permutation(3) if rng.random() < _REORDERED else np.arange(3)
    gains = rng.uniform(*_GAINS, (3, 1, 1)).astype(np.float32)
    values[0, :3] = np.minimum(values[0, order] * gains, 1.0)
    return values, np.minimum(truth[order].astype(np.float32) * (gains / np.float32(255.0)), 1.0)


def loss_of(found: Tensor, truth: Tensor, hole: Tensor) -> Tensor:
    """Returns the mean error of pictures (B, 3, H, W), and of differences of neighbours in several sizes, which keep edges sharp.

    Args:
        found: pictures.
        truth: what they should be.
        hole: (B, 1, H, W), 1 = in a hole.
    """
    error = found - truth
    weight = 1.0 + _HOLES * hole
    loss = (weight * (torch.sqrt(error * error + _SOFT**2) - _SOFT)).mean() / weight.mean()
    for scale in _SCALES:
        small = functional.avg_pool2d(error, scale) if scale > 1 else error
        loss = loss + _EDGES / len(_SCALES) * (small.diff(dim=2).abs().mean() + small.diff(dim=3).abs().mean())
    return loss
