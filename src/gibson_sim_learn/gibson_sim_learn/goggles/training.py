"""Trains the network of Goggles: steps of the optimiser, a curve on the validation scenes, checkpoints. Needs PyTorch.

Everything lies in one folder. An interrupted training goes on from its last checkpoint; with the same settings, pairs and software on the
same kind of processor it gives what an uninterrupted one gives, up to the rounding of sums.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
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
from gibson_sim_learn.training import (
    descend,
    has_bfloat16,
    load_checkpoint,
    save_checkpoint,
    set_step_size,
    step_size,
    write_curve,
)

_WARM_UP = 100
"""Iterations in which the step size rises."""
_EVERY = 5
"""A point of the curve is made of every so many views."""
_EDGES = 0.5
"""Weight of the differences from one pixel to the next, relative to that of the pixels themselves."""
_MAY_CHANGE = ("iterations",)
"""Settings by which a training can be made longer."""
_PANELS = (("loss of training", ["loss"]), ("PSNR, validation scenes, dB", ["psnr"]), ("SSIM, validation scenes", ["ssim"]))
"""Of the curve: title and fields of its points."""


@dataclass(frozen=True, slots=True)
class CurvePoint:
    """How near images are to the simulator's after some iterations, on the validation scenes."""

    iteration: int
    loss: float
    """Mean loss of training since the point before."""
    psnr: float
    """dB."""
    ssim: float
    processor_s: float
    """Processor time of the training so far, seconds."""


class Training:
    """One training in one folder."""

    def __init__(self, folder: Path, settings: GogglesSettings) -> None:
        """Begins, or goes on from the checkpoint in the folder.

        Raises:
            ConfigError: the checkpoint in the folder is of other settings, or cannot be read.
        """
        self.folder, self.settings = folder, settings
        torch.manual_seed(settings.seed)
        self.network = GogglesNetwork().to(memory_format=torch.channels_last)
        self._optimiser = torch.optim.AdamW(
            self.network.parameters(), lr=settings.learning_rate, weight_decay=settings.weight_decay
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

    def run(
        self, data: Sequence[Pairs], validation: Sequence[Pairs], progress: Callable[[str], None] = lambda text: None
    ) -> None:
        """Trains until the iteration of the settings, with a checkpoint and a point of the curve every so many.

        Args:
            data: what it trains on.
            validation: what the curve is measured on.
            progress: called with one line after each tenth iteration.
        """
        settings, losses, until = self.settings, [], self.settings.iterations
        began, before, start = time.monotonic(), time.process_time(), self.iteration
        while self.iteration < until:
            set_step_size(self._optimiser, step_size(settings.learning_rate, self.iteration, until, _WARM_UP))
            losses.append(self._step(*_batch(data, self._rng, settings.batch)))
            self.iteration += 1
            if self.iteration % 10 == 0:
                left = (time.monotonic() - began) / (self.iteration - start) * (until - self.iteration)
                progress(f"iteration {self.iteration} of {until}, loss {np.mean(losses[-50:]):.4f}, {left / 60.0:.0f} min left")
            if self.iteration % settings.evaluate_every == 0 or self.iteration == until:
                self._processor_s += time.process_time() - before
                found = score(validation, self.bring, _EVERY)
                point = CurvePoint(self.iteration, float(np.mean(losses)), found.psnr, found.ssim, round(self._processor_s, 1))
                before, losses = time.process_time(), []
                self.curve.append(point)
                self._save()
                progress(f"iteration {self.iteration}: {found}")

    def bring(self, image: U8) -> U8:
        """Returns an image (H, W, 3) of even size, up to twice as high as ``SMALL``, in the simulator's look."""
        self.network.eval()
        with torch.inference_mode():
            whole = torch.from_numpy(image.copy())[None]  # images of shards cannot be written to
            found = self.network(whole, whole)[0].permute(1, 2, 0).clamp(0.0, 1.0).mul(255.0).round()
        self.network.train()
        return np.asarray(found.to(torch.uint8).numpy())

    def _step(self, seen: U8, clean: U8) -> float:
        image, truth = torch.from_numpy(seen), torch.from_numpy(clean).permute(0, 3, 1, 2).to(torch.float32) / 255.0
        with torch.autocast("cpu", dtype=torch.bfloat16, enabled=self._half):
            found = self.network(image, image)
        loss = _loss(found.float(), truth)
        return descend(self.network, self._optimiser, loss, 1.0)

    def _save(self) -> None:
        content = {
            "settings": as_dict(self.settings),
            "network": self.network.state_dict(),
            "optimiser": self._optimiser.state_dict(),
            "rng": self._rng.bit_generator.state,
            "iteration": self.iteration,
            "curve": [asdict(point) for point in self.curve],
            "processor_s": self._processor_s,
        }
        save_checkpoint(self.checkpoint, content)
        write_curve(self.folder, self.curve, _PANELS)

    def _load(self) -> None:
        content = load_checkpoint(self.checkpoint, as_dict(self.settings), _MAY_CHANGE)
        self.network.load_state_dict(content["network"])
        self._optimiser.load_state_dict(content["optimiser"])
        self._rng.bit_generator.state = content["rng"]
        self.iteration = content["iteration"]
        self.curve = [CurvePoint(**point) for point in content["curve"]]
        self._processor_s = content["processor_s"]


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
