"""Trains the network of Goggles: batches, losses, scores on the validation scenes. Needs PyTorch."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np
import torch
from torch import Tensor
from torch.nn import functional

from gibson_sim_learn.goggles.network import GogglesNetwork
from gibson_sim_learn.goggles.pairs import U8, Pairs
from gibson_sim_learn.goggles.scoring import score
from gibson_sim_learn.goggles.settings import GogglesSettings, as_dict
from gibson_sim_learn.training import CurvePoint, Descent, Progress, Training

_EVERY = 5
"""A point of the curve is made of every so many views."""
_EDGES = 0.5
"""Weight of the differences from one pixel to the next, relative to that of the pixels themselves."""


@dataclass(frozen=True, slots=True)
class GogglesPoint(CurvePoint):
    """How near images are to the simulator's."""

    psnr: float
    """dB."""
    ssim: float


class GogglesTraining(Training[GogglesNetwork, GogglesPoint]):
    """One training in one folder."""

    PANELS = (("loss of training", ["loss"]), ("PSNR, validation scenes, dB", ["psnr"]), ("SSIM, validation scenes", ["ssim"]))

    def __init__(self, folder: Path, settings: GogglesSettings) -> None:
        """Begins, or goes on from the checkpoint in the folder.

        Raises:
            ConfigError: the checkpoint in the folder is of other settings, or cannot be read.
        """
        self.settings = settings
        descent = Descent(
            settings.seed,
            settings.learning_rate,
            settings.weight_decay,
            warm_up=100,
            longest=1.0,
            evaluate_every=settings.evaluate_every,
        )
        super().__init__(folder, as_dict(settings), descent, GogglesNetwork)
        self._resume(GogglesPoint)

    def run(self, data: Sequence[Pairs], validation: Sequence[Pairs], progress: Progress = lambda text: None) -> None:
        """Trains until the iteration of the settings, with a checkpoint and a point of the curve every so many.

        Args:
            data: what it trains on.
            validation: what the curve is measured on.
            progress: called with one line after each tenth iteration.
        """

        def loss() -> Tensor:
            return self._loss(*_batch(data, self._rng, self.settings.batch))

        def point(begun: CurvePoint) -> GogglesPoint:
            found = score(validation, self.bring, _EVERY)
            return GogglesPoint(**asdict(begun), psnr=found.psnr, ssim=found.ssim)

        self._train(self.settings.iterations, loss, point, progress)

    def bring(self, image: U8) -> U8:
        """Returns an image (H, W, 3) of even size, up to twice as high as ``SMALL``, in the simulator's look."""
        self.network.eval()
        with torch.inference_mode():
            whole = torch.from_numpy(image.copy())[None]  # images of shards cannot be written to
            found = self.network(whole, whole)[0].permute(1, 2, 0).clamp(0.0, 1.0).mul(255.0).round()
        self.network.train()
        return np.asarray(found.to(torch.uint8).numpy())

    def _loss(self, seen: U8, clean: U8) -> Tensor:
        image, truth = torch.from_numpy(seen), torch.from_numpy(clean).permute(0, 3, 1, 2).to(torch.float32) / 255.0
        with torch.autocast("cpu", dtype=torch.bfloat16, enabled=self._half):
            found = self.network(image, image)
        return _loss(found.float(), truth)

    def _summary(self, point: GogglesPoint) -> str:
        return f"{point.psnr:.2f} dB, SSIM {point.ssim:.4f}"


def _batch(data: Sequence[Pairs], rng: np.random.Generator, count: int) -> tuple[U8, U8]:
    """Returns images as seen and as the simulator draws them, (count, 64, 96, 3) each; half of them mirrored."""
    seen, clean = [], []
    for _ in range(count):
        part = data[int(rng.integers(len(data)))]
        view = int(rng.integers(len(part.clean)))
        shot = part.seen[view, int(rng.integers(part.seen.shape[1]))]
        step = -1 if rng.random() < 0.5 else 1
        seen.append(shot[:, ::step])
        clean.append(part.clean[view][:, ::step])
    return np.stack(seen), np.stack(clean)


def _loss(found: Tensor, truth: Tensor) -> Tensor:
    """Returns the mean absolute error of pixels (B, 3, H, W), and of differences of neighbours, which keep edges sharp."""
    edges = functional.l1_loss(found.diff(dim=2), truth.diff(dim=2)) + functional.l1_loss(found.diff(dim=3), truth.diff(dim=3))
    return functional.l1_loss(found, truth) + _EDGES * edges
