"""Trains the network of free distances, with a curve on the validation scenes. Needs PyTorch.

It has its own folder within that of the whole training, and resumes from its last checkpoint.
"""

from __future__ import annotations

from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from gibson_path_following.obstacles.floor_plane import FloorPlane
from gibson_sim_learn.path_following.data import FREE_EDGES, MAX_FREE, distance_labels, median_distances
from gibson_sim_learn.path_following.distances.network import DistanceNetwork
from gibson_sim_learn.path_following.drawing import CAMERA_HEIGHT, HEIGHT, HFOV, WIDTH
from gibson_sim_learn.path_following.sampling import Sampler, augment_lens
from gibson_sim_learn.path_following.settings import TrainingSettings, as_dict
from gibson_sim_learn.training import CurvePoint, OptimiserSettings, Progress, Training

_NEAR = 1.0
"""Free distance below which an obstacle is near, metres."""
_RATIO = 1.3
"""Predicted per true distance above which a near obstacle is missed, and below whose inverse a far one is a false alarm."""
_EVALUATION = 1200
"""Number of images of each kind for a point of the curve."""
_NO_EARLIER_SHARE = 0.15
"""Share of the images without an earlier one: a robot that begins, or stands, has none."""
_ODOMETRY_NOISE = 0.1, 0.01, 0.01
"""Standard deviations of the estimated motion since the earlier image: share of distance and of turn; heading, radians; sideways, metres."""
_FLOOR = FloorPlane(WIDTH, HEIGHT, HFOV, CAMERA_HEIGHT)


@dataclass(frozen=True, slots=True)
class DistancePoint(CurvePoint):
    """The errors of free distances."""

    free: float
    """Median absolute error of free distances along paths, metres."""
    too_far: float
    """Share of the bearings with an obstacle within 1 m whose predicted distance is at least 1.3 times the true one."""
    too_near: float
    """Share of the bearings that are free for 1 m whose predicted distance is below 1 / 1.3 m."""
    obstacles_too_far: float
    """``too_far`` in images of obstacles from close by."""
    obstacles_too_near: float
    """``too_near`` in the same images."""


class DistanceTraining(Training[DistanceNetwork, DistancePoint]):
    """One training in one folder."""

    PANELS = (
        ("loss of training", ["loss"]),
        ("median error, m", ["free"]),
        ("along paths: error rates", ["too_far", "too_near"]),
        ("obstacles: error rates", ["obstacles_too_far", "obstacles_too_near"]),
    )
    COLUMNS = 2

    def __init__(self, folder: Path, settings: TrainingSettings) -> None:
        """Begins, or resumes from the checkpoint in the folder.

        Raises:
            ConfigError: the checkpoint in the folder is of other settings, or cannot be read.
        """
        self.settings = own = settings.distances
        kept = {"seed": settings.seed, "data": as_dict(settings)["data"], **as_dict(settings)["distances"]}
        optimiser = OptimiserSettings(
            settings.seed,
            own.learning_rate,
            own.weight_decay,
            warm_up=200,
            max_gradient_norm=5.0,
            evaluate_every=1000,
            bfloat16=settings.bfloat16,
        )
        super().__init__(folder, kept, optimiser, DistanceNetwork)
        self._resume(DistancePoint, own.iterations)

    def run(
        self,
        paths: Sampler,
        obstacles: Sampler,
        validation: tuple[Sampler, Sampler],
        progress: Progress = lambda text: None,
        until: int | None = None,
    ) -> None:
        """Trains, with a checkpoint and a point of the curve every 1,000 iterations and at the end.

        Args:
            paths: images along paths.
            obstacles: images of obstacles.
            validation: images of both kinds, for the curve.
            progress: called with one line after each tenth iteration.
            until: number of the last iteration of this call; None = of the training.
        """
        settings = self.settings
        close = round(settings.obstacle_share * settings.images)
        shares = [(data, count) for data, count in ((paths, settings.images - close), (obstacles, close)) if count]

        def loss() -> Tensor:
            parts = [data.batch(self._rng, count, 0) for data, count in shares]
            images, earlier, poses, free = (
                np.concatenate([getattr(part, name) for part in parts]) for name in ("later", "earlier", "earlier_pose", "free")
            )
            images, earlier = augment_lens(images, self._rng, earlier)
            earlier[self._rng.random(len(earlier)) < _NO_EARLIER_SHARE] = 0
            return self._loss(images, warp_to_present(earlier, poses, self._rng), free)

        def point(begun: CurvePoint) -> DistancePoint:
            return self.evaluate(*validation, begun)

        self._train(settings.iterations if until is None else until, loss, point, progress, last=settings.iterations)

    def evaluate(self, paths: Sampler, obstacles: Sampler, begun: CurvePoint) -> DistancePoint:
        """Returns a point with the errors on the same images at each call."""
        rng = np.random.default_rng(0)
        batches = [data.batch(rng, _EVALUATION, 0, augment=False) for data in (paths, obstacles)]
        found = [self.distances(batch.later, warp_to_present(batch.earlier, batch.earlier_pose, rng)) for batch in batches]
        shares = [miss_rates(predicted, batch.free) for predicted, batch in zip(found, batches, strict=True)]
        error = float(np.median(np.abs(found[0] - batches[0].free)))
        return DistancePoint(
            **asdict(begun),
            free=error,
            too_far=shares[0][0],
            too_near=shares[0][1],
            obstacles_too_far=shares[1][0],
            obstacles_too_near=shares[1][1],
        )

    def distances(self, images: NDArray[np.uint8], earlier: NDArray[np.uint8]) -> NDArray[np.float64]:
        """Returns (N, 24), float64: predicted median free distances, metres, in images (N, 64, 96, 3), uint8, with warped earlier ones."""
        self.network.eval()
        found = []
        with torch.inference_mode():
            for k in range(0, len(images), 100):
                some = (torch.from_numpy(each[k : k + 100]) for each in (images, earlier))
                hit = torch.softmax(self.network(*some).float(), dim=2)
                found.append(median_distances(np.array(FREE_EDGES), hit.double().numpy()))
        self.network.train()
        return np.minimum(np.concatenate(found), MAX_FREE)

    def _loss(self, images: NDArray[np.uint8], earlier: NDArray[np.uint8], free: NDArray[np.float32]) -> Tensor:
        with torch.autocast("cpu", dtype=torch.bfloat16, enabled=self._bfloat16):
            logits: Tensor = self.network(torch.from_numpy(images), torch.from_numpy(earlier))
        share = torch.log_softmax(logits.float(), dim=2)
        return -(torch.from_numpy(distance_labels(free)) * share).sum(dim=2).mean()

    def _summary(self, point: DistancePoint) -> str:
        return (
            f"{point.free:.3f} m, too far {point.too_far:.3f}, too near {point.too_near:.3f}; "
            f"obstacles: too far {point.obstacles_too_far:.3f}, too near {point.obstacles_too_near:.3f}"
        )


def warp_to_present(earlier: NDArray[np.uint8], poses: NDArray[np.float32], rng: np.random.Generator) -> NDArray[np.uint8]:
    """Returns earlier images (N, 64, 96, 3), uint8, warped onto the present ones by a motion with odometry noise, see ``_ODOMETRY_NOISE``.

    Args:
        earlier: (N, 64, 96, 3), uint8; black = there is none.
        poses: (N, 3), true poses of the earlier cameras in the present cameras' frames, metres and radians.
        rng: of the noise.
    """
    out = np.zeros_like(earlier)
    ratio, heading, sideways = _ODOMETRY_NOISE
    for k in np.flatnonzero(earlier.any(axis=(1, 2, 3))):
        x, y, yaw = poses[k]
        scale, turned = 1.0 + ratio * rng.standard_normal(2)
        pose = (scale * x, scale * y + sideways * rng.standard_normal(), turned * yaw + heading * rng.standard_normal())
        out[k] = _FLOOR.warp(earlier[k], np.array(pose))
    return out


def miss_rates(predicted: NDArray[np.float64], free: NDArray[np.float32]) -> tuple[float, float]:
    """Returns the shares of missed near obstacles and of false alarms, of predicted and true free distances (N, 24), metres."""
    near, open_ = free < _NEAR, free >= _NEAR
    missed = float((predicted[near] > _RATIO * free[near]).mean()) if near.any() else 0.0
    return missed, float((predicted[open_] < _NEAR / _RATIO).mean()) if open_.any() else 0.0
