"""Trains the path-following network: losses, errors on the validation scenes, rounds of DAgger. Needs PyTorch."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import asdict, dataclass, fields
from pathlib import Path
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor
from torch.nn import functional

from gibson_path_following.localisation.pose_filter import OffsetCalibration, lateral_offset
from gibson_sim_learn.path_following.data import FREE_EDGES, MAX_FREE, distance_labels, median_distances
from gibson_sim_learn.path_following.distances.training import miss_rates
from gibson_sim_learn.path_following.network import Estimate, PathNetwork
from gibson_sim_learn.path_following.sampling import Batch, Sampler
from gibson_sim_learn.path_following.settings import TrainingSettings, as_dict
from gibson_sim_learn.training import CurvePoint, OptimiserSettings, Progress, Training

_EVALUATION = (320, 3)
"""Numbers of later images, and of recorded ones for each, for a point of the curve."""
_CALIBRATION, _CALIBRATION_RANGE = (1200, 3), 0.7
"""Numbers of later images, and of recorded ones for each, for the calibration of lateral offsets; largest distance of a pair, metres: the offset of
a farther one depends on the heading."""
_MIN_RATIO = 0.1
"""Least ratio of a calibration: below it, predicted offsets mean nothing, and their deviation is large."""
_FREE_WEIGHT, _MATCH_WEIGHT = 0.6, 1.0
"""Weights of the losses of free distances and of matches against that of poses."""


@dataclass(frozen=True, slots=True)
class PathPoint(CurvePoint):
    """Errors of poses, and of the first estimate of free distances."""

    ahead: float
    """Median absolute error of x, metres, of pairs of the same place."""
    beside: float
    """Median absolute error of y, metres, of the same pairs."""
    yaw_deg: float
    """Median absolute error of yaw, degrees, of the same pairs."""
    match: float
    """Share of the pairs whose match is classified correctly."""
    free: float
    """Median absolute error of free distances, metres."""
    too_far: float
    """Share of the bearings with an obstacle within 1 m whose predicted distance is at least 1.3 times the true one."""
    too_near: float
    """Share of the bearings that are free for 1 m whose predicted distance is below 1 / 1.3 m."""


class PathTraining(Training[PathNetwork, PathPoint]):
    """One training in one folder."""

    PANELS = (
        ("loss of training", ["loss"]),
        ("error of the pose, m", ["ahead", "beside"]),
        ("error of the heading, degrees", ["yaw_deg"]),
        ("one place or not: share right", ["match"]),
        ("error of free distances, m", ["free"]),
        ("missed near obstacles, false alarms: rates", ["too_far", "too_near"]),
    )
    COLUMNS = 3
    MAY_CHANGE = (
        "iterations",
        "dagger_rounds",
        "dagger_iterations",
        "last_iterations",
        "dagger_drives",
        "shards",
        "validation_shards",
        "distances",
    )

    def __init__(self, folder: Path, settings: TrainingSettings) -> None:
        """Begins, or resumes from the checkpoint in the folder.

        Raises:
            ConfigError: the checkpoint in the folder is of other settings, or cannot be read.
        """
        self.settings, self.round = settings, 0
        optimiser = OptimiserSettings(
            settings.seed,
            settings.learning_rate,
            settings.weight_decay,
            warm_up=100,
            max_gradient_norm=5.0,
            evaluate_every=settings.evaluate_every,
            bfloat16=settings.bfloat16,
        )
        super().__init__(folder, as_dict(settings), optimiser, PathNetwork)
        self._resume(PathPoint, total_iterations(settings))

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
        """Trains until an iteration, with a checkpoint and a point of the curve every ``evaluate_every``.

        The step size falls to 0 at ``until``.

        Args:
            data: training data.
            validation: data of the curve.
            until: number of the last iteration.
            progress: called with one line after each tenth iteration.
        """

        def loss() -> Tensor:
            return self._loss(data.batch(self._rng, self.settings.later, self.settings.recorded))

        def point(begun: CurvePoint) -> PathPoint:
            return self.evaluate(validation, begun)

        self._train(until, loss, point, progress, first=self.first_of_round)

    def evaluate(self, validation: Sampler, begun: CurvePoint) -> PathPoint:
        """Returns a point with the errors on the same images at each call."""
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
        error, correct, found = np.concatenate(errors), np.concatenate(rights), np.minimum(np.concatenate(free), MAX_FREE)
        ahead, beside, yaw = np.median(error, axis=0).tolist()
        too_far, too_near = miss_rates(found, batch.free)
        return PathPoint(
            **asdict(begun),
            ahead=ahead,
            beside=beside,
            yaw_deg=math.degrees(yaw),
            match=float(correct.mean()),
            free=float(np.median(np.abs(found - batch.free))),
            too_far=too_far,
            too_near=too_near,
        )

    def offsets(self, validation: Sampler) -> OffsetCalibration:
        """Returns the calibration of the network's lateral offsets from recorded images, over pairs up to ``_CALIBRATION_RANGE`` apart."""
        batch = validation.batch(np.random.default_rng(1), *_CALIBRATION, augment=False)
        self.network.eval()
        predicted, true = [], []
        with torch.inference_mode():
            for k in range(0, _CALIBRATION[0], 40):
                part = _part(batch, slice(k, k + 40))
                _, estimate, _ = self._forward(part)
                pose = part.pose.reshape(-1, 3).astype(np.float64)
                found = estimate.pose[: len(pose)].double().numpy()
                seen = (part.match & part.has_pairs[:, None]).ravel() & (estimate.match[: len(pose)] > 0.0).numpy()
                near = seen & (np.hypot(pose[:, 0], pose[:, 1]) < _CALIBRATION_RANGE)
                predicted.append(lateral_offset(found[near]))
                true.append(lateral_offset(pose[near]))
        self.network.train()
        return calibrate_offsets(np.concatenate(predicted), np.concatenate(true))

    def _loss(self, batch: Batch) -> Tensor:
        with torch.autocast("cpu", dtype=torch.bfloat16, enabled=self._bfloat16):
            _, estimate, distances = self._forward(batch)
        return _loss(batch, estimate, distances)

    def _forward(self, batch: Batch) -> tuple[Tensor, Estimate, Tensor]:
        """Returns features of the later images, estimates of L R pairs and then of L pairs of different images, and logits of distances."""
        count, each = batch.pose.shape[:2]
        images = torch.from_numpy(np.concatenate([batch.later, batch.recorded.reshape(-1, *batch.later.shape[1:])]))
        features = self.network.encode(images)
        present, recorded = features[:count], features[count:]
        # Each later image with a recorded one of another: nearly always different places.
        shifted = recorded[::each].roll(1, 0)
        pairs = torch.cat([present.repeat_interleave(each, 0), present])
        estimate = self.network.compare(pairs, torch.cat([recorded, shifted]))
        return present, estimate, self.network.free(present)

    def _summary(self, point: PathPoint) -> str:
        return (
            f"ahead {point.ahead:.3f} m, beside {point.beside:.3f} m, yaw {point.yaw_deg:.1f} degrees, match {point.match:.3f}, "
            f"free {point.free:.3f} m, too far {point.too_far:.3f}, too near {point.too_near:.3f}"
        )

    def _state(self) -> dict[str, Any]:
        return {"round": self.round}

    def _restore(self, content: Mapping[str, Any]) -> None:
        self.round = content["round"]


def total_iterations(settings: TrainingSettings) -> int:
    """Returns the number of iterations of a whole training, with its rounds of DAgger."""
    if not settings.dagger_rounds:
        return settings.iterations
    return settings.iterations + (settings.dagger_rounds - 1) * settings.dagger_iterations + settings.last_iterations


def calibrate_offsets(predicted: NDArray[np.float64], true: NDArray[np.float64]) -> OffsetCalibration:
    """Returns the calibration of predicted offsets (N,) against true ones (N,), metres: the least-squares fit through 0."""
    power = float(true @ true)
    ratio = max(_MIN_RATIO, float(predicted @ true) / power) if power > 0.0 else 1.0
    return OffsetCalibration(ratio, float(np.sqrt(np.mean(np.square(predicted - ratio * true)))) / ratio if len(true) else 0.0)


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
    log_probability = torch.log_softmax(distances.float(), dim=2)
    of_free = -(torch.from_numpy(distance_labels(batch.free)) * log_probability).sum(dim=2).mean()
    return of_pose + _MATCH_WEIGHT * of_match + _FREE_WEIGHT * of_free


def _part(batch: Batch, rows: slice) -> Batch:
    return Batch(*(getattr(batch, field.name)[rows] for field in fields(batch)))
