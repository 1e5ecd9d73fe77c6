"""Trains the network of free distances: steps of the optimiser, a curve on the validation scenes. Needs PyTorch.

It has a folder of its own within that of the whole training, and goes on from its last checkpoint as that does.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from gibson_sim_learn.path_following.data import FREE_EDGES, MAX_FREE, distance_labels, median_distances
from gibson_sim_learn.path_following.distances.network import DistanceNetwork
from gibson_sim_learn.path_following.sampling import Sampler, through_another_lens
from gibson_sim_learn.path_following.settings import TrainingSettings, as_dict
from gibson_sim_learn.training import (
    descend,
    has_bfloat16,
    load_checkpoint,
    save_checkpoint,
    set_step_size,
    step_size,
    write_curve,
)

Progress = Callable[[str], None]
_NEAR = 1.0
"""Free distance below which something counts as near, metres."""
_RATIO = 1.3
"""Ratio of distances from which a near thing counts as missed."""
_WARM_UP = 200
"""Iterations in which the step size rises."""
_EVALUATION = 1200
"""Images of each kind that a point of the curve is made of."""
_EVALUATE_EVERY = 1000
"""Iterations between two points of the curve, which are also checkpoints."""
_PANELS = (
    ("loss of training", ["loss"]),
    ("median error, m", ["free"]),
    ("on ways: shares told wrongly", ["too_far", "too_near"]),
    ("obstacles: shares told wrongly", ["obstacles_too_far", "obstacles_too_near"]),
)
"""Of the curve: title and fields of its points."""


@dataclass(frozen=True, slots=True)
class DistancePoint:
    """Errors on the validation scenes after some iterations."""

    iteration: int
    loss: float
    """Mean loss of training since the point before."""
    free: float
    """Median absolute error of free distances on ways, metres."""
    too_far: float
    """Share of the directions with something within 1 m, of which it says that 1.3 times as much or more is free."""
    too_near: float
    """Share of the directions that are free for 1 m, of which it says that something stands within 1 / 1.3 of that."""
    obstacles_too_far: float
    """The first share in images of obstacles from close by."""
    obstacles_too_near: float
    """The second one there."""
    processor_s: float
    """Processor time of the training so far, seconds."""


class DistanceTraining:
    """One training in one folder."""

    def __init__(self, folder: Path, settings: TrainingSettings) -> None:
        """Begins, or goes on from the checkpoint in the folder.

        Raises:
            ConfigError: the checkpoint in the folder is of other settings, or cannot be read.
        """
        self.folder, self.settings = folder, settings.distances
        self._kept = {"seed": settings.seed, "data": as_dict(settings)["data"], **as_dict(settings)["distances"]}
        torch.manual_seed(settings.seed)
        self.network = DistanceNetwork().to(memory_format=torch.channels_last)
        self._optimiser = torch.optim.AdamW(
            self.network.parameters(), lr=self.settings.learning_rate, weight_decay=self.settings.weight_decay
        )
        self._rng = np.random.default_rng(settings.seed)
        self._half = settings.bfloat16 and has_bfloat16()
        self.iteration = 0
        self.curve: list[DistancePoint] = []
        self._processor_s = 0.0
        if self.checkpoint.exists():
            self._load()

    @property
    def checkpoint(self) -> Path:
        """File of the newest checkpoint."""
        return self.folder / "checkpoint.pt"

    def run(
        self,
        ways: Sampler,
        obstacles: Sampler,
        validation: tuple[Sampler, Sampler],
        progress: Progress = lambda text: None,
        until: int | None = None,
    ) -> None:
        """Trains, with a checkpoint and a point of the curve every 1,000 iterations and at the end.

        Args:
            ways: images along ways.
            obstacles: images of obstacles.
            validation: images of both kinds, which the curve is measured on.
            progress: called with one line after each tenth iteration.
            until: number of the last iteration of this call; None = of the training.
        """
        settings, total = self.settings, self.settings.iterations
        until = total if until is None else until
        losses: list[float] = []
        began, before, start = time.monotonic(), time.process_time(), self.iteration
        close = round(settings.obstacle_share * settings.images)
        while self.iteration < until:
            set_step_size(self._optimiser, step_size(settings.learning_rate, self.iteration, total, _WARM_UP))
            parts = [
                data.batch(self._rng, count, 0) for data, count in ((ways, settings.images - close), (obstacles, close)) if count
            ]
            images, free = (np.concatenate([getattr(part, name) for part in parts]) for name in ("later", "free"))
            losses.append(self._step(through_another_lens(images, self._rng), free))
            self.iteration += 1
            if self.iteration % 10 == 0:
                left = (time.monotonic() - began) / (self.iteration - start) * (until - self.iteration) / 60.0
                progress(
                    f"distances: iteration {self.iteration} of {total}, loss {np.mean(losses[-50:]):.3f}, {left:.0f} min left"
                )
            if self.iteration % _EVALUATE_EVERY == 0 or self.iteration == until:
                self._processor_s += time.process_time() - before
                before = time.process_time()
                self.curve.append(self.evaluate(*validation, loss=float(np.mean(losses))))
                losses = []
                self._save()
                progress(_line(self.curve[-1]))

    def evaluate(self, ways: Sampler, obstacles: Sampler, loss: float = math.nan) -> DistancePoint:
        """Returns the errors on data, always of the same images."""
        rng = np.random.default_rng(0)
        batches = [data.batch(rng, _EVALUATION, 0, augment=False) for data in (ways, obstacles)]
        found = [self.distances(batch.later) for batch in batches]
        shares = [near_and_far(told, batch.free) for told, batch in zip(found, batches, strict=True)]
        error = float(np.median(np.abs(found[0] - batches[0].free)))
        return DistancePoint(self.iteration, loss, error, *shares[0], *shares[1], round(self._processor_s, 1))

    def distances(self, images: NDArray[np.uint8]) -> NDArray[np.float64]:
        """Returns (N, 24): the median free distances that it tells in images (N, 64, 96, 3), metres."""
        self.network.eval()
        found = []
        with torch.inference_mode():
            for k in range(0, len(images), 100):
                hit = torch.softmax(self.network(torch.from_numpy(images[k : k + 100])).float(), dim=2)
                found.append(median_distances(np.array(FREE_EDGES), hit.double().numpy()))
        self.network.train()
        return np.minimum(np.concatenate(found), MAX_FREE)

    def _step(self, images: NDArray[np.uint8], free: NDArray[np.float32]) -> float:
        with torch.autocast("cpu", dtype=torch.bfloat16, enabled=self._half):
            told: Tensor = self.network(torch.from_numpy(images))
        share = torch.log_softmax(told.float(), dim=2)
        loss = -(torch.from_numpy(distance_labels(free)) * share).sum(dim=2).mean()
        return descend(self.network, self._optimiser, loss, 5.0)

    def _save(self) -> None:
        content: dict[str, Any] = {
            "settings": self._kept,
            "network": self.network.state_dict(),
            "optimiser": self._optimiser.state_dict(),
            "rng": self._rng.bit_generator.state,
            "torch_rng": torch.get_rng_state(),
            "iteration": self.iteration,
            "curve": [asdict(point) for point in self.curve],
            "processor_s": self._processor_s,
        }
        save_checkpoint(self.checkpoint, content)
        write_curve(self.folder, self.curve, _PANELS, columns=2)

    def _load(self) -> None:
        content = load_checkpoint(self.checkpoint, self._kept, ("iterations",))
        self.network.load_state_dict(content["network"])
        self._optimiser.load_state_dict(content["optimiser"])
        self._rng.bit_generator.state = content["rng"]
        torch.set_rng_state(content["torch_rng"])
        self.iteration = content["iteration"]
        self.curve = [DistancePoint(**point) for point in content["curve"]]
        self._processor_s = content["processor_s"]


def near_and_far(told: NDArray[np.float64], free: NDArray[np.float32]) -> tuple[float, float]:
    """Returns the shares of near directions that are told as far, and of far ones that are told as near."""
    near, open_ = free < _NEAR, free >= _NEAR
    missed = float((told[near] > _RATIO * free[near]).mean()) if near.any() else 0.0
    return missed, float((told[open_] < _NEAR / _RATIO).mean()) if open_.any() else 0.0


def _line(point: DistancePoint) -> str:
    return (
        f"distances: iteration {point.iteration}: {point.free:.3f} m, too far {point.too_far:.3f}, too near {point.too_near:.3f}; "
        f"obstacles: too far {point.obstacles_too_far:.3f}, too near {point.obstacles_too_near:.3f}"
    )
