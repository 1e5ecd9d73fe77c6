"""Trains the network of the filler: batches, losses, scores on the validation scenes. Needs PyTorch."""

from __future__ import annotations

import copy
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor
from torch.nn import functional

from gibson_sim.errors import ConfigError
from gibson_sim.filling.holes import is_hole
from gibson_sim.filling.inputs import packed
from gibson_sim_learn.filler.network import FillerNetwork
from gibson_sim_learn.filler.pairs import Pairs, depth_of, normals_of
from gibson_sim_learn.filler.scoring import Score, Scoring
from gibson_sim_learn.filler.settings import TrainingSettings
from gibson_sim_learn.training import CurvePoint, OptimiserSettings, Progress, Training

F32 = NDArray[np.float32]
U8 = NDArray[np.uint8]

_MEAN = 0.998
"""Decay per step of the running mean of the weights. The mean is exported, since it scores better than the weights of the last step."""
_EVERY = 4
"""Stride of the validation views for a point of the curve."""
_HOLES = 1.0
"""Additional weight of pixels in holes; 1 = twice the weight of others."""
_EDGES, _SCALES = 0.5, (1, 2, 4)
"""Weight of the gradient loss relative to that of the pixels; scales at which it is computed."""
HOLE = slice(7, 8)
"""Input channel that marks holes."""
_TURN, _ZOOM, _SHIFT_PX = 0.02, 0.04, 4.0
"""Maximum rotation, radians, zoom, share of the size, and shift, pixels, of the consistency loss."""
_MARGIN = 8
"""Width of the border that the consistency loss omits, pixels: a moved image shows other content there."""
_GAINS = (0.65, 1.15)
"""Smallest and largest gain of each colour channel of a crop (augmentation)."""
_REORDERED = 0.3
"""Probability that the colour channels of a crop are permuted (augmentation)."""


@dataclass(frozen=True, slots=True)
class FillerPoint(CurvePoint):
    """Similarity of filled images to the ground truth, on the validation scenes."""

    hole_psnr: float
    """PSNR in holes, dB."""
    seen_psnr: float
    """PSNR outside holes, dB."""
    gmsd: float

    @property
    def rank(self) -> float:
        """Criterion of the best point: the sum of both PSNRs, dB."""
        return self.hole_psnr + self.seen_psnr


class FillerTraining(Training[FillerNetwork, FillerPoint]):
    """One training in one folder."""

    PANELS = (
        ("loss of training", ["loss"]),
        ("holes, validation scenes, PSNR dB", ["hole_psnr"]),
        ("seen, validation scenes, PSNR dB", ["seen_psnr"]),
        ("GMSD, validation scenes", ["gmsd"]),
    )
    MAY_CHANGE = ("iterations", "evaluate_every")

    def __init__(self, folder: Path, settings: TrainingSettings, data: str) -> None:
        """Starts a training, or resumes from the checkpoint in the folder.

        Args:
            folder: folder of the training.
            settings: settings of the training.
            data: hash of the pairs.

        Raises:
            ConfigError: the checkpoint in the folder has other settings, pairs or more iterations, or cannot be read.
        """
        self.settings, self.data = settings, data
        optimiser = OptimiserSettings(
            settings.seed,
            settings.learning_rate,
            settings.weight_decay,
            warm_up=200,
            max_gradient_norm=1.0,
            evaluate_every=settings.evaluate_every,
        )
        super().__init__(folder, asdict(settings), optimiser, FillerNetwork)
        self.mean = copy.deepcopy(self.network)
        """Network with the running mean of the weights."""
        self.best = copy.deepcopy(self.network)
        """The same at the best point of the curve: a long training overfits to its scenes."""
        self._resume(FillerPoint, settings.iterations)

    @property
    def best_point(self) -> FillerPoint:
        """Point of the curve with the highest ``rank``; the curve must have at least one point."""
        return max(self.curve, key=lambda point: point.rank)

    def run(
        self,
        data: Sequence[Pairs],
        validation: Sequence[Pairs],
        progress: Progress = lambda text: None,
        after_point: Callable[[], object] = lambda: None,
    ) -> None:
        """Trains for the iterations of the settings, with a checkpoint and a point of the curve every ``evaluate_every``.

        Args:
            data: training pairs.
            validation: pairs of the validation scenes, for the curve.
            progress: called with one line after each tenth iteration.
            after_point: called after each point of the curve.
        """

        def loss() -> Tensor:
            return self._loss(*batch_of(data, self._rng, self.settings.batch, self.settings.crop))

        def point(begun: CurvePoint) -> FillerPoint:
            found = self._scored(validation)
            psnrs = {name: round(getattr(found, name), 3) for name in ("hole_psnr", "seen_psnr")}
            new = FillerPoint(**asdict(begun), **psnrs, gmsd=round(found.gmsd, 4))
            if not self.curve or new.rank > self.best_point.rank:
                self.best.load_state_dict(self.mean.state_dict())
            return new

        self._train(self.settings.iterations, loss, point, progress, after_point=after_point)

    def fill(self, values: F32) -> U8:
        """Returns the filled image (H, W, 3), sRGB, for an input (1, 9, H, W)."""
        with torch.inference_mode(), torch.autocast("cpu", dtype=torch.bfloat16, enabled=self._bfloat16):
            found = self.mean(torch.from_numpy(values).contiguous(memory_format=torch.channels_last))
        image = found.float()[0].permute(1, 2, 0).clamp(0.0, 1.0).mul(255.0).round()
        return np.asarray(image.to(torch.uint8).numpy())

    def _scored(self, pairs: Sequence[Pairs]) -> Score:
        scoring = Scoring()
        for part in pairs:
            for k in range(0, len(part.hole), _EVERY):
                values = packed(
                    np.array(part.filled[k]), depth_of(part.depth_mm[k]), normals_of(part.normals[k]), np.array(part.hole[k])
                )
                scoring.add(self.fill(values), part.truth[k], is_hole(part.hole[k]))
        return scoring.score()

    def _loss(self, values: F32, truth: F32) -> Tensor:
        inputs, weight = torch.from_numpy(values), self.settings.consistency
        if not weight:
            return loss_of(self._filled(inputs), torch.from_numpy(truth), inputs[:, HOLE])
        some = inputs[: math.ceil(len(inputs) / 2)]
        grid = motion_grid(self._rng, len(some), inputs.shape[-1])
        moved = moved_inputs(some, grid)
        images, images_of_moved = self._filled(torch.cat([inputs, moved])).split([len(inputs), len(some)])
        inner = (..., slice(_MARGIN, -_MARGIN), slice(_MARGIN, -_MARGIN))
        difference = loss_of(images_of_moved[inner], resampled(images[: len(some)], grid)[inner], moved[:, HOLE][inner])
        return loss_of(images, torch.from_numpy(truth), inputs[:, HOLE]) + weight * difference

    def _filled(self, inputs: Tensor) -> Tensor:
        """Returns images (B, 3, H, W) for inputs (B, 9, H, W)."""
        with torch.autocast("cpu", dtype=torch.bfloat16, enabled=self._bfloat16):
            images: Tensor = self.network(inputs.contiguous(memory_format=torch.channels_last))
        return images.float()

    def _optimiser_step(self, loss: Tensor) -> float:
        value = super()._optimiser_step(loss)
        share = min(_MEAN, (1.0 + self.iteration) / (10.0 + self.iteration))
        with torch.no_grad():
            for mean, new in zip(self.mean.parameters(), self.network.parameters(), strict=True):
                mean.lerp_(new, 1.0 - share)
        return value

    def _summary(self, point: FillerPoint) -> str:
        return f"holes {point.hole_psnr:.2f} dB, seen {point.seen_psnr:.2f} dB, GMSD {point.gmsd:.4f}"

    def _state(self) -> dict[str, Any]:
        return {"data": self.data, "mean": self.mean.state_dict(), "best": self.best.state_dict()}

    def _restore(self, content: Mapping[str, Any]) -> None:
        if (data := content.get("data")) != self.data:
            raise ConfigError(
                f"{self.folder}: holds a training with other pairs ({data}, here {self.data}); choose another --folder"
            )
        self.mean.load_state_dict(content["mean"])
        self.best.load_state_dict(content["best"])


def batch_of(data: Sequence[Pairs], rng: np.random.Generator, count: int, side: int) -> tuple[F32, F32]:
    """Returns random crops of views: inputs (count, 9, side, side) and truth (count, 3, side, side), 0 to 1.

    Half of them are mirrored, and their colours are augmented, in the same way in input and truth.
    """
    examples = [_example(data[int(rng.integers(len(data)))], rng, side) for _ in range(count)]
    return np.concatenate([values for values, _ in examples]), np.stack([truth for _, truth in examples])


def _example(part: Pairs, rng: np.random.Generator, side: int) -> tuple[F32, F32]:
    """Returns the input (1, 9, side, side) and the truth (3, side, side) of a random crop."""
    view = int(rng.integers(len(part.hole)))
    top, left = (int(rng.integers(size - side + 1)) for size in part.hole.shape[1:])
    step = -1 if rng.random() < 0.5 else 1

    def cut(images: NDArray[Any]) -> NDArray[Any]:
        return np.ascontiguousarray(images[view, top : top + side, left : left + side][:, ::step])

    # A mirrored image shows a mirrored world, so its normals are mirrored, too.
    normals = normals_of(cut(part.normals))
    normals[:, :, 0] *= step
    values = packed(cut(part.filled), depth_of(cut(part.depth_mm)), normals, cut(part.hole))
    truth = cut(part.truth).transpose(2, 0, 1)
    order = rng.permutation(3) if rng.random() < _REORDERED else np.arange(3)
    gains = rng.uniform(*_GAINS, (3, 1, 1)).astype(np.float32)
    values[0, :3] = np.minimum(values[0, order] * gains, 1.0)
    return values, np.minimum(truth[order].astype(np.float32) * (gains / np.float32(255.0)), 1.0)


def motion_grid(rng: np.random.Generator, count: int, side: int) -> Tensor:
    """Returns random small motions of square images as sampling grids (count, side, side, 2): rotation, zoom, shift."""
    angle, zoom = rng.uniform(-_TURN, _TURN, count), rng.uniform(1.0 - _ZOOM, 1.0 + _ZOOM, count)
    shift = rng.uniform(-_SHIFT_PX, _SHIFT_PX, (count, 2)) * 2.0 / side
    cosine, sine = zoom * np.cos(angle), zoom * np.sin(angle)
    matrices = np.stack([cosine, -sine, shift[:, 0], sine, cosine, shift[:, 1]], axis=1).reshape(count, 2, 3)
    return functional.affine_grid(torch.from_numpy(matrices.astype(np.float32)), [count, 1, side, side], align_corners=False)


def resampled(images: Tensor, grid: Tensor) -> Tensor:
    """Returns images (B, C, H, W), sampled bilinearly at a grid (B, H, W, 2)."""
    return functional.grid_sample(images, grid, mode="bilinear", padding_mode="border", align_corners=False)


def moved_inputs(inputs: Tensor, grid: Tensor) -> Tensor:
    """Returns inputs (B, 9, H, W), sampled at a grid; masks stay 0 or 1, and normals 0 in holes."""
    values = resampled(inputs, grid)
    masks = (values[:, 7:] >= 0.5).float()
    return torch.cat([values[:, :4], values[:, 4:7] * (1.0 - masks[:, :1]), masks], dim=1)


def loss_of(found: Tensor, truth: Tensor, hole: Tensor) -> Tensor:
    """Returns the mean squared error of images (B, 3, H, W) plus that of their gradients at several scales, which keeps edges sharp.

    Args:
        found: predicted images.
        truth: ground truth.
        hole: (B, 1, H, W), 1 = in a hole.
    """
    error = found - truth
    weight = 1.0 + _HOLES * hole
    loss = (weight * error.square()).mean() / weight.mean()
    for scale in _SCALES:
        small = functional.avg_pool2d(error, scale) if scale > 1 else error
        loss = loss + _EDGES / len(_SCALES) * (small.diff(dim=2).square().mean() + small.diff(dim=3).square().mean())
    return loss
