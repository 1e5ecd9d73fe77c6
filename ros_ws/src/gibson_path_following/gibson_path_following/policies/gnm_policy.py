"""Follows a path with networks of the GNM, ViNT and NoMaD family, exported to ONNX by their authors' code. No PyTorch.

Supported files, recognised by the shapes of inputs and outputs; names do not matter::

    GNM, ViNT   one file     images (B, 3 (n + 1), 64, 85), sub-goal (B, 3, 64, 85)  ->  distance (B, 1), waypoints (B, T, 2 or 4)
    NoMaD       a folder     encoder.onnx   images (B, 3 (n + 1), 96, 96), sub-goal (B, 3, 96, 96), goal mask (B)  ->  features (B, E)
                             distance.onnx  features (B, E)  ->  distance (B, 1)
                             action.onnx    actions (N, T, 2), timestep, features (N, E)  ->  noise (N, T, 2)

Images are RGB with the mean 0 and deviation 1 of ImageNet, resized without regard to their aspect; n = 5 (GNM, ViNT) or 3 (NoMaD) earlier
ones come first, 0.25 s apart. Distances are numbers of steps; waypoints are x ahead and y to the left, in steps of the robot's top speed.
B and N may be fixed or free. Sources: https://github.com/robodhruv/visualnav-transformer (deployment), arXiv 2210.03370, 2306.14846,
2310.07896.
"""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Protocol

import cv2
import numpy as np
from numpy.typing import NDArray

from gibson_path_following.errors import ModelError, ViewError, check_ranges
from gibson_path_following.onnx_files import open_session, run
from gibson_path_following.types import Image, Place, RecordedPath, Velocity, View

F32 = NDArray[np.float32]
NOMAD_FILES = ("encoder.onnx", "distance.onnx", "action.onnx")
NS_PER_S = 1_000_000_000
_IMAGENET_MEAN = np.array([0.485, 0.456, 0.406], dtype=np.float32)
_IMAGENET_DEVIATION = np.array([0.229, 0.224, 0.225], dtype=np.float32)
_SIZE = (85, 64)
"""Width and height of images where a file leaves them free, pixels."""
_MAX_SIDE = 1024
_MAX_CONTEXT = 64
_MIN_ACTION = np.array([-2.5, -4.0], dtype=np.float32)
_MAX_ACTION = np.array([5.0, 4.0], dtype=np.float32)
"""Range of an action of NoMaD, x and y, in steps."""
_DIFFUSION_STEPS = 10


@dataclass(frozen=True, slots=True)
class GnmSettings:
    """Selection of the sub-goal, and driving to a waypoint."""

    max_linear: float = 0.5
    """Largest speed, m/s."""
    max_angular: float = 1.0
    """Largest yaw rate, rad/s."""
    rate_hz: float = 4.0
    """Rate that the network was trained with, of earlier images and of waypoints, Hz."""
    search_radius: int = 4
    """Nodes before and after the localiser's place that are candidates for the sub-goal."""
    close_threshold: float = 3.0
    """Temporal distance of the nearest node below which the node after it is the sub-goal, steps."""
    waypoint: int = 2
    """Index of the waypoint that is driven to, from 0."""
    samples: int = 8
    """Trajectories that NoMaD samples; the one nearest to their mean is driven."""
    seed: int = 0
    """Seed of NoMaD's noise."""

    def __post_init__(self) -> None:
        check_ranges(
            self,
            ("max_linear", 0.01, 10.0),
            ("max_angular", 0.01, 10.0),
            ("rate_hz", 0.1, 100.0),
            ("search_radius", 0, 100),
            ("close_threshold", 0.0, 1000.0),
            ("waypoint", 0, 100),
            ("samples", 1, 256),
            ("seed", 0, 2**63 - 1),
        )


class GnmNetwork(Protocol):
    """A network of the family."""

    frames: int
    """Images of the input: the present one and its context."""
    size: tuple[int, int]
    """Width and height of an image, pixels."""

    def predict(self, images: F32, goals: F32) -> tuple[F32, F32]:
        """Returns temporal distances (K,), float32, steps, and the encodings (K, ...), float32, of the sub-goals for ``waypoints``.

        Args:
            images: (3 frames, H, W), float32, normalised, the present one last.
            goals: (K, 3, H, W), float32, normalised.
        """

    def waypoints(self, encoding: F32, settings: GnmSettings, rng: np.random.Generator) -> F32:
        """Returns waypoints (T, 2), float32, to a sub-goal, robot frame: x ahead, y to the left, in steps of the top speed.

        Args:
            encoding: of the sub-goal, as ``predict`` returns it.
            settings: number of samples.
            rng: of the noise.
        """


class GoalNetwork:
    """GNM or ViNT: temporal distance and waypoints of a sub-goal at once."""

    def __init__(self, file: Path) -> None:
        """Loads the network and runs it once.

        Raises:
            ModelError: onnxruntime is not installed, or the file holds no such network.
        """
        self._file, self._session = file, open_session(file)
        self._images, self._goal = _image_inputs(file, self._session, others=0)
        self.frames, self.size = _frames_and_size(file, self._images, self._goal)
        self._batch = _batch(file, self._images, self._goal)
        width, height = self.size
        distances, waypoints = self.predict(np.zeros((3 * self.frames, height, width), np.float32), _blank(2, self.size))
        if waypoints.ndim != 3 or len(distances) != 2:
            raise ModelError(f"{file}: its waypoints have shape {waypoints.shape}, must be (batch, waypoints, 2 or 4)")

    def predict(self, images: F32, goals: F32) -> tuple[F32, F32]:
        """See ``GnmNetwork``."""
        distances, waypoints = [], []
        for part, count in _parts(goals, self._batch):
            feeds = {self._images.name: np.repeat(images[None], len(part), axis=0), self._goal.name: part}
            found = [np.asarray(value) for value in run(self._session, self._file, feeds)]
            ways = [value for value in found if value.ndim == 3 and len(value) == len(part) and value.shape[2] in (2, 4)]
            steps = [value for value in found if value.size == len(part)]
            if len(ways) != 1 or len(steps) != 1 or not ways[0].shape[1]:
                raise ModelError(
                    f"{self._file}: its outputs have shapes {_shapes(found)}, must be a distance (batch, 1) and "
                    "waypoints (batch, waypoints, 2 or 4)"
                )
            distances.append(steps[0].reshape(-1)[:count])
            waypoints.append(ways[0][:count, :, :2])
        return _float32(np.concatenate(distances)), _float32(np.concatenate(waypoints))

    def waypoints(self, encoding: F32, settings: GnmSettings, rng: np.random.Generator) -> F32:
        """See ``GnmNetwork``."""
        return encoding


class DiffusionNetwork:
    """NoMaD: features of a sub-goal, their temporal distance, and actions sampled by diffusion."""

    def __init__(self, folder: Path) -> None:
        """Loads the three networks and runs them once.

        Raises:
            ModelError: onnxruntime is not installed, or the folder holds no such networks.
        """
        self._files = tuple(folder / name for name in NOMAD_FILES)
        self._encoder, self._distance, self._action = (open_session(file) for file in self._files)
        file = self._files[0]
        self._images, self._goal = _image_inputs(file, self._encoder, others=1)
        self.frames, self.size = _frames_and_size(file, self._images, self._goal)
        self._batch = _batch(file, self._images, self._goal)
        (self._mask,) = (i for i in self._encoder.get_inputs() if i.name not in (self._images.name, self._goal.name))
        self._features = _only_input(self._files[1], self._distance)
        self._sample, self._timestep, self._condition = _action_inputs(self._files[2], self._action)
        length = self._sample.shape[1]
        self._length = length if isinstance(length, int) else 8
        """Number of actions of a trajectory."""
        width, height = self.size
        _, encodings = self.predict(np.zeros((3 * self.frames, height, width), np.float32), _blank(2, self.size))
        self.waypoints(encodings[0], GnmSettings(samples=2), np.random.default_rng(0))

    def predict(self, images: F32, goals: F32) -> tuple[F32, F32]:
        """See ``GnmNetwork``."""
        file = self._files[0]
        kind = np.int64 if "int64" in self._mask.type else np.int32 if "int32" in self._mask.type else np.float32
        features, distances = [], []
        for part, count in _parts(goals, self._batch):
            feeds = {
                self._images.name: np.repeat(images[None], len(part), axis=0),
                self._goal.name: part,
                self._mask.name: np.zeros(len(part), dtype=kind),  # 0 = the sub-goal counts
            }
            found = np.asarray(run(self._encoder, file, feeds)[0])
            if found.ndim != 2 or len(found) != len(part):
                raise ModelError(f"{file}: its output has shape {found.shape}, must be features ({len(part)}, size)")
            features.append(found[:count])
        encodings = _float32(np.concatenate(features))
        for part, count in _parts(encodings, _fixed(self._features.shape[0])):
            found = np.asarray(run(self._distance, self._files[1], {self._features.name: part})[0])
            if found.size != len(part):
                raise ModelError(f"{self._files[1]}: its output has shape {found.shape}, must be distances ({len(part)}, 1)")
            distances.append(found.reshape(-1)[:count])
        return _float32(np.concatenate(distances)), encodings

    def waypoints(self, encoding: F32, settings: GnmSettings, rng: np.random.Generator) -> F32:
        """See ``GnmNetwork``."""
        file = self._files[2]
        count = _fixed(self._sample.shape[0]) or settings.samples
        actions = rng.standard_normal((count, self._length, 2), dtype=np.float32)
        condition = np.repeat(encoding[None], count, axis=0)
        scheduler = Diffusion(_DIFFUSION_STEPS)
        rank = len(self._timestep.shape)
        for step in range(_DIFFUSION_STEPS - 1, -1, -1):
            number = np.full(
                (count if _fixed(self._timestep.shape[0]) is None else self._timestep.shape[0],) if rank else (), step
            )
            time = number.astype(np.int64 if "int64" in self._timestep.type else np.float32)
            feeds = {self._sample.name: actions, self._timestep.name: time, self._condition.name: condition}
            noise = np.asarray(run(self._action, file, feeds)[0])
            if noise.shape != actions.shape:
                raise ModelError(f"{file}: its output has shape {noise.shape}, must be noise {actions.shape}")
            actions = scheduler.previous_sample(actions, _float32(noise), step, rng)
        ways = np.cumsum(_MIN_ACTION + (actions + 1.0) / 2.0 * (_MAX_ACTION - _MIN_ACTION), axis=1)
        away = np.abs(ways - ways.mean(axis=0)).sum(axis=(1, 2))
        return np.asarray(ways[int(away.argmin())], dtype=np.float32)


class Diffusion:
    """Denoising diffusion with a squared-cosine schedule, which predicts noise and clips the sample to [-1, 1] (arXiv 2006.11239)."""

    def __init__(self, steps: int) -> None:
        share = (np.arange(steps + 1) / steps + 0.008) / 1.008
        schedule = np.cos(share * math.pi / 2.0) ** 2
        self.beta = np.minimum(1.0 - schedule[1:] / schedule[:-1], 0.999)
        self.alpha_bar = np.cumprod(1.0 - self.beta)
        """(steps,), float64: cumulative product of 1 - beta, the share of the signal that is left after each step."""

    def previous_sample(self, noisy: F32, noise: F32, step: int, rng: np.random.Generator) -> F32:
        """Returns the sample before a diffusion step, (N, T, 2), float32 (equations 7 and 15 of the paper).

        Args:
            noisy: (N, T, 2), sample after the step.
            noise: (N, T, 2), predicted noise in it.
            step: number of the step; 0 is the last one that is undone.
            rng: of the noise that is added unless ``step`` is 0.
        """
        alpha_bar, previous = self.alpha_bar[step], self.alpha_bar[step - 1] if step else 1.0
        clean = np.clip((noisy - math.sqrt(1.0 - alpha_bar) * noise) / math.sqrt(alpha_bar), -1.0, 1.0)
        mean = math.sqrt(previous) * self.beta[step] / (1.0 - alpha_bar) * clean
        mean += math.sqrt(1.0 - self.beta[step]) * (1.0 - previous) / (1.0 - alpha_bar) * noisy
        if step:
            deviation = math.sqrt(max((1.0 - previous) / (1.0 - alpha_bar) * self.beta[step], 1e-20))
            mean += deviation * rng.standard_normal(mean.shape, dtype=np.float32)
        return np.asarray(mean, dtype=np.float32)


class GnmPolicy:
    """A ``Policy`` with a network of the family: the sub-goal is a node near the localiser's place, selected by temporal distance."""

    def __init__(self, path: RecordedPath, model: Path | GnmNetwork, settings: GnmSettings | None = None) -> None:
        """Loads the network and prepares the images of the path.

        Args:
            path: a path of one pinhole camera.
            model: the network; or its file, or NoMaD's folder.
            settings: None = the defaults.

        Raises:
            ModelError: the network cannot be used.
            ViewError: the path is of another kind of camera.
        """
        if path.camera != "pinhole":
            raise ViewError(f"networks of the GNM family need a pinhole camera, the path is of a {path.camera}; use teach_repeat")
        self.settings = settings or GnmSettings()
        self.network = open_network(model) if isinstance(model, Path) else model
        self._goals = np.stack([self._preprocess(node.view[0]) for node in path.nodes])
        self._context: deque[tuple[int, F32]] = deque()
        self._rng = np.random.default_rng(self.settings.seed)
        self.sub_goal: int | None = None
        """Node index of the sub-goal; None before the first view."""

    def reset(self) -> None:
        """Drops all earlier views."""
        self._context.clear()
        self._rng = np.random.default_rng(self.settings.seed)
        self.sub_goal = None

    def act(self, view: View, stamp_ns: int, place: Place) -> Velocity:
        """Returns the velocity to a waypoint towards the sub-goal."""
        settings = self.settings
        images = self._with_context(stamp_ns, self._preprocess(view[0]))
        here = round(place.index)
        first = max(0, here - settings.search_radius)
        goals = self._goals[first : here + settings.search_radius + 1]
        distances, encodings = self.network.predict(images, goals)
        nearest = int(distances.argmin())
        chosen = min(nearest + int(distances[nearest] < settings.close_threshold), len(goals) - 1)
        self.sub_goal = first + chosen
        ways = self.network.waypoints(encodings[chosen], settings, self._rng)
        number = min(settings.waypoint, len(ways) - 1)
        return velocity_to(ways[number], number + 1, settings)

    def _preprocess(self, image: Image) -> F32:
        """Returns (3, H, W), float32: an image (height, width, 3), uint8, resized and normalised for the network."""
        small = cv2.resize(image, self.network.size, interpolation=cv2.INTER_AREA).astype(np.float32)
        return np.ascontiguousarray(((small / np.float32(255.0) - _IMAGENET_MEAN) / _IMAGENET_DEVIATION).transpose(2, 0, 1))

    def _with_context(self, stamp_ns: int, image: F32) -> F32:
        """Returns (3 frames, H, W), float32: the present image, last, and those one, two, ... steps before; the oldest one stands for older ones."""
        step_ns = NS_PER_S / self.settings.rate_hz
        frames = self.network.frames
        self._context.append((stamp_ns, image))
        while len(self._context) > 2 and self._context[1][0] <= stamp_ns - (frames - 1) * step_ns:
            self._context.popleft()
        chosen = []
        for back in range(frames - 1, -1, -1):
            requested_ns = stamp_ns - back * step_ns
            chosen.append(min(self._context, key=lambda each: abs(each[0] - requested_ns))[1])
        return np.concatenate(chosen)


def velocity_to(waypoint: F32, steps: int, settings: GnmSettings) -> Velocity:
    """Returns the velocity of the arc to a waypoint.

    Args:
        waypoint: (2,), robot frame, x ahead and y to the left, in steps of the top speed.
        steps: number of steps until the robot is to reach it.
        settings: limits and rate.
    """
    x, y = (float(value) * settings.max_linear / settings.rate_hz for value in waypoint)
    seconds = steps / settings.rate_hz
    heading = math.atan2(y, x)
    # An arc to a point turns by twice its bearing.
    angular = min(max(2.0 * heading / seconds, -settings.max_angular), settings.max_angular)
    if abs(heading) >= math.pi / 2.0 or x <= 0.0:
        return Velocity(0.0, angular if abs(y) > 1e-6 else 0.0)
    return Velocity(min(math.hypot(x, y) / seconds, settings.max_linear), angular)


def open_network(place: Path) -> GnmNetwork:
    """Returns the network in a file (GNM, ViNT), or in a folder (NoMaD).

    Raises:
        ModelError: there is none, or it cannot be used.
    """
    if place.is_dir():
        missing = [name for name in NOMAD_FILES if not (place / name).is_file()]
        if missing:
            raise ModelError(f"{place}: {', '.join(missing)} missing; a folder of NoMaD has {', '.join(NOMAD_FILES)}")
        return DiffusionNetwork(place)
    return GoalNetwork(place)


def _image_inputs(file: Path, session: Any, others: int) -> tuple[Any, Any]:
    """Returns the inputs for the images and for the sub-goal."""
    inputs = session.get_inputs()
    images = [i for i in inputs if len(i.shape) == 4 and isinstance(i.shape[1], int) and "float" in i.type]
    goals = [i for i in images if i.shape[1] == 3]
    rest = [i for i in images if i.shape[1] > 3 and i.shape[1] % 3 == 0]
    if len(inputs) != 2 + others or len(goals) != 1 or len(rest) != 1:
        shapes = ", ".join(f"{i.name} {i.shape}" for i in inputs[:6])
        mask = ", and a goal mask (batch)" if others else ""
        raise ModelError(
            f"{file}: its inputs are {shapes}; must be images (batch, 3 frames, height, width) and a sub-goal (batch, 3, "
            f"height, width) of float32{mask}: see docs/path_following.md"
        )
    return rest[0], goals[0]


def _frames_and_size(file: Path, images: Any, goal: Any) -> tuple[int, tuple[int, int]]:
    height, width = (side if isinstance(side, int) else free for side, free in zip(images.shape[2:], _SIZE[::-1], strict=True))
    frames = images.shape[1] // 3
    if not (8 <= height <= _MAX_SIDE and 8 <= width <= _MAX_SIDE and frames <= _MAX_CONTEXT):
        raise ModelError(
            f"{file}: its images are {frames} of {width}x{height} pixels; must be at most {_MAX_CONTEXT} of 8 to {_MAX_SIDE} a side"
        )
    if any(isinstance(side, int) and side != of for side, of in zip(goal.shape[2:], (height, width), strict=True)):
        raise ModelError(f"{file}: its sub-goal is {goal.shape[2:]}, its images are [{height}, {width}]; must be of one size")
    return frames, (width, height)


def _batch(file: Path, images: Any, goal: Any) -> int | None:
    first, second = _fixed(images.shape[0]), _fixed(goal.shape[0])
    if first is not None and second is not None and first != second:
        raise ModelError(f"{file}: batches of {first} images and {second} sub-goals; export both with one batch")
    batch = first if first is not None else second
    if batch is not None and not 1 <= batch <= 256:
        raise ModelError(f"{file}: a batch of {batch}, must be 1 to 256, or free")
    return batch


def _only_input(file: Path, session: Any) -> Any:
    inputs = session.get_inputs()
    if len(inputs) != 1 or len(inputs[0].shape) != 2:
        raise ModelError(f"{file}: its inputs are {[i.shape for i in inputs[:6]]}; must be one, features (batch, size)")
    return inputs[0]


def _action_inputs(file: Path, session: Any) -> tuple[Any, Any, Any]:
    by_rank = {len(i.shape): i for i in session.get_inputs()}
    time = by_rank.get(0) or by_rank.get(1)
    if len(session.get_inputs()) != 3 or time is None or 2 not in by_rank or 3 not in by_rank or by_rank[3].shape[2] != 2:
        raise ModelError(
            f"{file}: its inputs are {[i.shape for i in session.get_inputs()[:6]]}; must be actions (samples, length, 2), a "
            "timestep, and features (samples, size)"
        )
    length = by_rank[3].shape[1]
    if isinstance(length, int) and not 1 <= length <= 1000:
        raise ModelError(f"{file}: trajectories of {length} actions, must be 1 to 1000")
    return by_rank[3], time, by_rank[2]


def _fixed(size: Any) -> int | None:
    """Returns a fixed size of a file; None = it is dynamic."""
    return size if isinstance(size, int) and size > 0 else None


def _parts(values: F32, batch: int | None) -> list[tuple[F32, int]]:
    """Returns values (N, ...) in batches, the last one padded with its last value, and the number of values in each."""
    if batch is None:
        return [(values, len(values))]
    parts = []
    for start in range(0, len(values), batch):
        part = values[start : start + batch]
        filled = np.concatenate([part, np.repeat(part[-1:], batch - len(part), axis=0)])
        parts.append((filled, len(part)))
    return parts


def _blank(count: int, size: tuple[int, int]) -> F32:
    """Returns (count, 3, H, W), float32: zeros."""
    return np.zeros((count, 3, size[1], size[0]), dtype=np.float32)


def _float32(values: Any) -> F32:
    return np.asarray(values, dtype=np.float32)


def _shapes(values: list[Any]) -> str:
    return ", ".join(str(value.shape) for value in values[:6])
