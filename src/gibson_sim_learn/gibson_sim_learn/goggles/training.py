"""Trains the network of Goggles: batches, loss, metrics on the validation scenes. Needs PyTorch."""

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
from gibson_sim_learn.training import CurvePoint, OptimiserSettings, Progress, Training

_EVERY = 5
"""Stride of the validation views of a point of the curve."""
_GRADIENT_WEIGHT = 0.5
"""Weight of the L1 loss of image gradients, relative to that of the pixels."""


@dataclass(frozen=True, slots=True)
class GogglesPoint(CurvePoint):
    """Metrics of adapted images relative to those of the simulator."""

    psnr: float
    """PSNR, dB."""
    ssim: float
    """SSIM of the luma."""


class GogglesTraining(Training[GogglesNetwork, GogglesPoint]):
    """One training in one folder."""

    PANELS = (("training loss", ["loss"]), ("PSNR, validation scenes, dB", ["psnr"]), ("SSIM, validation scenes", ["ssim"]))

    def __init__(self, folder: Path, settings: GogglesSettings) -> None:
        """Starts a training, or resumes from the checkpoint in the folder.

        Raises:
            ConfigError: the checkpoint in the folder has other settings, or cannot be read.
        """
        self.settings = settings
        optimiser = OptimiserSettings(
            settings.seed,
            settings.learning_rate,
            settings.weight_decay,
            warm_up=100,
            max_gradient_norm=1.0,
            evaluate_every=settings.evaluate_every,
        )
        super().__init__(folder, as_dict(settings), optimiser, GogglesNetwork)
        self._resume(GogglesPoint, settings.iterations)

    def run(self, data: Sequence[Pairs], validation: Sequence[Pairs], progress: Progress = lambda text: None) -> None:
        """Trains for the iterations of the settings, with a point of the curve and a checkpoint every ``evaluate_every``.

        Args:
            data: training pairs.
            validation: pairs of the validation scenes, for the curve.
            progress: called with one line after each tenth iteration.
        """

        def loss() -> Tensor:
            return self._loss(*_batch(data, self._rng, self.settings.batch))

        def point(base: CurvePoint) -> GogglesPoint:
            found = score(validation, self.adapt, _EVERY)
            return GogglesPoint(**asdict(base), psnr=found.psnr, ssim=found.ssim)

        self._train(self.settings.iterations, loss, point, progress)

    def adapt(self, image: U8) -> U8:
        """Returns an image (H, W, 3), sRGB, of even size, up to twice as high as ``SMALL``, adapted to the simulator's appearance."""
        self.network.eval()
        with torch.inference_mode():
            batch = torch.from_numpy(image.copy())[None]  # memory-mapped arrays are read-only
            found = self.network(batch, batch)[0].permute(1, 2, 0).clamp(0.0, 1.0).mul(255.0).round()
        self.network.train()
        return np.asarray(found.to(torch.uint8).numpy())

    def _loss(self, seen: U8, clean: U8) -> Tensor:
        image, truth = torch.from_numpy(seen), torch.from_numpy(clean).permute(0, 3, 1, 2).to(torch.float32) / 255.0
        with torch.autocast("cpu", dtype=torch.bfloat16, enabled=self._bfloat16):
            found = self.network(image, image)
        return _loss(found.float(), truth)

    def _summary(self, point: GogglesPoint) -> str:
        return f"{point.psnr:.2f} dB, SSIM {point.ssim:.4f}"


def _batch(data: Sequence[Pairs], rng: np.random.Generator, count: int) -> tuple[U8, U8]:
    """Returns camera images and the simulator's images, (count, 64, 96, 3) each; half of the pairs are flipped horizontally."""
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
    """Returns the L1 loss of images (B, 3, H, W), plus the weighted L1 loss of their gradients, which keeps edges sharp."""
    gradients = functional.l1_loss(found.diff(dim=2), truth.diff(dim=2)) + functional.l1_loss(
        found.diff(dim=3), truth.diff(dim=3)
    )
    return functional.l1_loss(found, truth) + _GRADIENT_WEIGHT * gradients
