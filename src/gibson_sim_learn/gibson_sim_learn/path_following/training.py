"""Trains the path-following network: data, steps of the optimiser, a curve on the validation scenes, rounds of DAgger. Needs PyTorch.

Everything lies in one folder. An interrupted training goes on from its last checkpoint; with the same settings, seed, data and software on the
same kind of processor it gives what an uninterrupted one gives, up to the rounding of sums.
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
from torch import Tensor
from torch.nn import functional

from gibson_sim_learn.path_following.data import FREE_EDGES, MAX_FREE, distance_labels, median_distances
from gibson_sim_learn.path_following.distances.training import near_and_far
from gibson_sim_learn.path_following.network import Estimate, PathNetwork
from gibson_sim_learn.path_following.sampling import Batch, Sampler
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
_WARM_UP = 100
"""Iterations in which the step size rises."""
_EVALUATION = (320, 3)
"""Later images, and recorded ones for each, that a point of the curve is made of."""
_FREE_WEIGHT, _MATCH_WEIGHT = 0.6, 1.0
_PANELS = (
    ("loss of training", ["loss"]),
    ("error of the pose, m", ["ahead", "beside"]),
    ("error of the heading, degrees", ["yaw_deg"]),
    ("one place or not: share right", ["match"]),
    ("error of free distances, m", ["free"]),
    ("near, told as far; far, told as near: shares", ["too_far", "too_near"]),
)
"""Of the curve: title and fields of its points."""


@dataclass(frozen=True, slots=True)
class CurvePoint:
    """Errors on the validation scenes after some iterations."""

    iteration: int
    loss: float
    """Mean loss of training since the point before."""
    ahead: float
    """Median absolute error of x, metres, of pairs that show one place."""
    beside: float
    """The same of y, metres."""
    yaw_deg: float
    """The same of the yaw, degrees."""
    match: float
    """Share of the pairs of which it tells rightly whether they show one place."""
    free: float
    """Median absolute error of free distances, metres."""
    too_far: float
    """Share of the directions with something within 1 m, of which it says that 1.3 times as much or more is free."""
    too_near: float
    """Share of the directions that are free for 1 m, of which it says that something stands within 1 / 1.3 of that."""
    processor_s: float
    """Processor time of the training so far, seconds."""


class Training:
    """One training in one folder."""

    def __init__(self, folder: Path, settings: TrainingSettings) -> None:
        """Begins, or goes on from the checkpoint in the folder.

        Raises:
            ConfigError: the checkpoint in the folder is of other settings, or cannot be read.
        """
        torch.set_num_threads(max(1, torch.get_num_threads()))
        self.folder, self.settings = folder, settings
        torch.manual_seed(settings.seed)
        self.network = PathNetwork().to(memory_format=torch.channels_last)
        self._optimiser = torch.optim.AdamW(
            self.network.parameters(), lr=settings.learning_rate, weight_decay=settings.weight_decay
        )
        self._rng = np.random.default_rng(settings.seed)
        self._half = settings.bfloat16 and has_bfloat16()
        self.iteration, self.round = 0, 0
        self.curve: list[CurvePoint] = []
        self._processor_s = 0.0
        if self.checkpoint.exists():
            self._load()

    @property
    def checkpoint(self) -> Path:
        """File of the newest checkpoint."""
        return self.folder / "checkpoint.pt"

    @property
    def first_of_round(self) -> int:
        """Number of the first iteration of the present round; round 0 is the training before the first drives."""
        settings = self.settings
        return settings.iterations + (self.round - 1) * settings.dagger_iterations if self.round else 0

    def begin_round(self) -> None:
        """Begins the next round: the step size rises again."""
        self.round += 1
        self._save()

    def run(self, data: Sampler, validation: Sampler, until: int, progress: Progress = lambda text: None) -> None:
        """Trains until an iteration, with a checkpoint and a point of the curve every so many.

        The step size falls to 0 at ``until``.

        Args:
            data: what it trains on.
            validation: what the curve is measured on.
            until: number of the last iteration.
            progress: called with one line after each tenth iteration.
        """
        settings, losses = self.settings, []
        first = self.first_of_round
        began, before = time.monotonic(), time.process_time()
        start = self.iteration
        while self.iteration < until:
            set_step_size(self._optimiser, self._rate(self.iteration - first, until - first))
            losses.append(self._step(data.batch(self._rng, settings.later, settings.recorded)))
            self.iteration += 1
            if self.iteration % 10 == 0:
                left = (time.monotonic() - began) / (self.iteration - start) * (until - self.iteration)
                progress(f"iteration {self.iteration} of {until}, loss {np.mean(losses[-50:]):.3f}, {left / 60.0:.0f} min left")
            if self.iteration % settings.evaluate_every == 0 or self.iteration == until:
                self._processor_s += time.process_time() - before
                before = time.process_time()
                point = self.evaluate(validation, float(np.mean(losses)))
                losses = []
                self.curve.append(point)
                self._save()
                progress(_line(point))

    def evaluate(self, validation: Sampler, loss: float = math.nan) -> CurvePoint:
        """Returns the errors on data, always of the same images."""
        rng = np.random.default_rng(0)
        batch = validation.batch(rng, *_EVALUATION, augment=False)
        self.network.eval()
        errors: list[np.ndarray[Any, Any]] = []
        rights: list[np.ndarray[Any, Any]] = []
        free: list[np.ndarray[Any, Any]] = []
        with torch.inference_mode():
            for k in range(0, _EVALUATION[0], 40):
                part = _part(batch, slice(k, k + 40))
                present, estimate, distances = self._forward(part)
                del present
                pose = torch.from_numpy(part.pose).flatten(0, 1)
                match = torch.from_numpy(part.match & part.has_pairs[:, None]).flatten()
                known = torch.from_numpy(np.repeat(part.has_pairs, part.pose.shape[1]))
                count = len(pose)
                errors.append((estimate.pose[:count].float() - pose).abs()[match].numpy())
                rights.append(((estimate.match[:count] > 0.0) == match)[known].numpy())
                free.append(median_distances(np.array(FREE_EDGES), torch.softmax(distances.float(), dim=2).double().numpy()))
        self.network.train()
        error, told, found = np.concatenate(errors), np.concatenate(rights), np.minimum(np.concatenate(free), MAX_FREE)
        ahead, beside, yaw = np.median(error, axis=0).tolist()
        return CurvePoint(
            self.iteration,
            loss,
            ahead,
            beside,
            math.degrees(yaw),
            float(told.mean()),
            float(np.median(np.abs(found - batch.free))),
            *near_and_far(found, batch.free),
            round(self._processor_s, 1),
        )

    def _step(self, batch: Batch) -> float:
        with torch.autocast("cpu", dtype=torch.bfloat16, enabled=self._half):
            _, estimate, distances = self._forward(batch)
        loss = _loss(batch, estimate, distances)
        return descend(self.network, self._optimiser, loss, 5.0)

    def _forward(self, batch: Batch) -> tuple[Tensor, Estimate, Tensor]:
        """Returns features of the later images, the estimates of L R pairs and then of L pairs of different images, and the distances."""
        count, each = batch.pose.shape[:2]
        images = torch.from_numpy(np.concatenate([batch.later, batch.recorded.reshape(-1, *batch.later.shape[1:])]))
        features = self.network.encode(images)
        present, recorded = features[:count], features[count:]
        # Each later image with a recorded one of another: different places nearly always.
        shifted = recorded[::each].roll(1, 0)
        pairs = torch.cat([present.repeat_interleave(each, 0), present])
        estimate = self.network.compare(pairs, torch.cat([recorded, shifted]))
        return present, estimate, self.network.free(present)

    def _rate(self, done: int, total: int) -> float:
        return step_size(self.settings.learning_rate, done, total, _WARM_UP)

    def _save(self) -> None:
        content = {
            "settings": as_dict(self.settings),
            "network": self.network.state_dict(),
            "optimiser": self._optimiser.state_dict(),
            "rng": self._rng.bit_generator.state,
            "torch_rng": torch.get_rng_state(),
            "iteration": self.iteration,
            "round": self.round,
            "curve": [asdict(point) for point in self.curve],
            "processor_s": self._processor_s,
        }
        save_checkpoint(self.checkpoint, content)
        write_curve(self.folder, self.curve, _PANELS, columns=3)

    def _load(self) -> None:
        content = load_checkpoint(self.checkpoint, as_dict(self.settings), _MAY_CHANGE)
        self.network.load_state_dict(content["network"])
        self._optimiser.load_state_dict(content["optimiser"])
        self._rng.bit_generator.state = content["rng"]
        torch.set_rng_state(content["torch_rng"])
        self.iteration, self.round = content["iteration"], content["round"]
        self.curve = [CurvePoint(**point) for point in content["curve"]]
        self._processor_s = content["processor_s"]


_MAY_CHANGE = (
    "iterations",
    "dagger_rounds",
    "dagger_iterations",
    "last_iterations",
    "dagger_drives",
    "shards",
    "validation_shards",
    "distances",
)
"""Settings by which a training can be made longer, or that are another one's."""


def _loss(batch: Batch, estimate: Estimate, distances: Tensor) -> Tensor:
    count = batch.pose.shape[0] * batch.pose.shape[1]
    pose = torch.from_numpy(batch.pose).flatten(0, 1)
    has = torch.from_numpy(np.repeat(batch.has_pairs, batch.pose.shape[1]))
    match = torch.from_numpy(batch.match).flatten() & has
    found, scale, odds = estimate.pose.float(), estimate.scale.float(), estimate.match.float()
    errors = ((found[:count] - pose).abs() / scale[:count] + scale[:count].log()).mean(dim=1)
    of_pose = (errors * match).sum() / match.sum().clamp(min=1)
    # The shifted pairs are of different places; those whose recorded image is a blank are none.
    shifted = torch.from_numpy(batch.has_pairs & np.roll(batch.has_pairs, 1))
    truth = torch.cat([match, torch.zeros(len(batch.later), dtype=torch.bool)]).float()
    counts = torch.cat([has, shifted]).float()
    of_match = (functional.binary_cross_entropy_with_logits(odds, truth, reduction="none") * counts).sum() / counts.sum().clamp(
        min=1
    )
    told = torch.log_softmax(distances.float(), dim=2)
    of_free = -(torch.from_numpy(distance_labels(batch.free)) * told).sum(dim=2).mean()
    return of_pose + _MATCH_WEIGHT * of_match + _FREE_WEIGHT * of_free


def _part(batch: Batch, rows: slice) -> Batch:
    return Batch(*(getattr(batch, name)[rows] for name in ("later", "recorded", "pose", "match", "free", "has_pairs")))


def _line(point: CurvePoint) -> str:
    return (
        f"iteration {point.iteration}: ahead {point.ahead:.3f} m, beside {point.beside:.3f} m, yaw {point.yaw_deg:.1f} degrees, "
        f"match {point.match:.3f}, free {point.free:.3f} m, too far {point.too_far:.3f}, too near {point.too_near:.3f}"
    )
