"""Follows a path with a network that was trained in simulation: where the recorded images ahead are from here, and how far the floor is free.

The network perceives; where to drive is geometry (``arcs.py``). It needs onnxruntime, and no PyTorch.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from gibson_path_following.arcs import ArcPlanner, ArcSettings
from gibson_path_following.errors import ModelError, SettingError, ViewError, quoted
from gibson_path_following.types import STOP, Image, Place, RecordedPath, Velocity, View

F64 = NDArray[np.float64]
DEFAULT_MODEL = Path(__file__).with_name("models") / "path_following.onnx"
"""The network in the package."""
_INPUTS = ("present", "recorded")
_OUTPUTS = ("pose", "scale", "match", "free")


@dataclass(frozen=True, slots=True)
class Sighting:
    """What the network tells about a view."""

    pose: F64
    """(K, 3): the recorded cameras in the frame of the present one: x ahead, y to the left, yaw; metres and radians."""
    scale: F64
    """(K, 3): mean absolute errors that it expects."""
    match: F64
    """(K,): probability that a recorded image shows this place, so that its pose means something."""
    free: F64
    """(D,): free distances from the camera, metres, in the directions of ``PathModel.bearings``."""


class PathModel:
    """The network in a file, run on one core."""

    def __init__(self, file: Path) -> None:
        """Loads the network.

        Raises:
            ModelError: onnxruntime is not installed, or the file holds no such network.
        """
        try:
            import onnxruntime
        except ImportError as error:
            raise ModelError(
                "the learned policy needs onnxruntime, which is not installed: pip install gibson_path_following[onnx]"
            ) from error
        if not file.is_file():
            raise ModelError(f"{file}: there is no such file; give an ONNX file that gibson-sim learn path-following wrote")
        options = onnxruntime.SessionOptions()
        options.intra_op_num_threads = options.inter_op_num_threads = 1
        options.log_severity_level = 3
        try:
            self._session = onnxruntime.InferenceSession(str(file), options, providers=["CPUExecutionProvider"])
        except Exception as error:  # of a type that onnxruntime does not export
            first = (str(error).splitlines() or [""])[0]
            raise ModelError(f"{file}: not a network that onnxruntime reads: {quoted(first)}") from error
        self._check(file)
        _, self.height, self.width, _ = self._session.get_inputs()[0].shape
        metadata: dict[str, str] = self._session.get_modelmeta().custom_metadata_map
        try:
            self.hfov = math.radians(float(metadata["hfov_deg"]))
            """Horizontal field of view that it was trained for, radians."""
            self.max_free = float(metadata["max_free"])
            """Free distance at which it saw nothing, metres."""
        except (KeyError, ValueError) as error:
            raise ModelError(f"{file}: its metadata lack hfov_deg or max_free as numbers; export it anew") from error
        count = int(self._session.get_outputs()[3].shape[0])
        across = 1.0 - (np.arange(count) + 0.5) * 2.0 / count
        self.bearings: F64 = np.arctan(across * math.tan(self.hfov / 2.0))
        """Directions of the free distances, radians, positive to the left, left first."""

    def estimate(self, present: Image, recorded: NDArray[np.uint8]) -> Sighting:
        """Returns what the network tells.

        Args:
            present: image of the model's size and field of view, as ``fitted`` returns it.
            recorded: (K, height, width, 3).
        """
        pose, scale, match, free = self._session.run(list(_OUTPUTS), {"present": present[None], "recorded": recorded})
        return Sighting(*(np.asarray(value, dtype=np.float64) for value in (pose, scale, match, free)))

    def fitted(self, image: Image, hfov: float) -> Image:
        """Returns an image as the camera that the network was trained for would see it.

        Args:
            image: of a pinhole camera with square pixels.
            hfov: its horizontal field of view, radians.
        """
        height, width = image.shape[:2]
        scale = (self.width / math.tan(self.hfov / 2.0)) / (width / math.tan(hfov / 2.0))
        if (width, height) == (self.width, self.height) and abs(scale - 1.0) < 0.02:
            return np.ascontiguousarray(image)
        size = max(1, round(width * scale)), max(1, round(height * scale))
        shrunk = cv2.resize(image, size, interpolation=cv2.INTER_AREA if scale < 1.0 else cv2.INTER_LINEAR)
        # What is beyond the image's edge repeats the edge.
        across, down = max(0, self.width - size[0]), max(0, self.height - size[1])
        sides = (down // 2, down - down // 2, across // 2, across - across // 2)
        wide = cv2.copyMakeBorder(shrunk, *sides, cv2.BORDER_REPLICATE)
        top, left = (wide.shape[0] - self.height) // 2, (wide.shape[1] - self.width) // 2
        return np.ascontiguousarray(wide[top : top + self.height, left : left + self.width], dtype=np.uint8)

    def _check(self, file: Path) -> None:
        inputs, outputs = self._session.get_inputs(), self._session.get_outputs()
        names = tuple(i.name for i in inputs), tuple(o.name for o in outputs)
        if names != (_INPUTS, _OUTPUTS):
            raise ModelError(
                f"{file}: its inputs are {', '.join(names[0])} and its outputs {', '.join(names[1])}; must be "
                f"{', '.join(_INPUTS)} and {', '.join(_OUTPUTS)}: use a file that gibson-sim learn path-following wrote"
            )
        if not _is_image(inputs[0].shape) or not isinstance(outputs[3].shape[0], int):
            raise ModelError(f"{file}: its images have shape {inputs[0].shape}, must be (1, height, width, 3) with fixed sizes")


@dataclass(frozen=True, slots=True)
class LearnedSettings:
    """Where the sub-goals are, and how the robot drives."""

    ahead: tuple[float, ...] = (0.4, 0.6, 0.8, 1.0)
    """Distances of the sub-goals from the believed place along the path, metres; the farthest that is seen well is driven to."""
    least_match: float = 0.5
    """Probability below which a sub-goal is not seen."""
    camera_ahead: float = 0.12
    """Of the camera in front of the middle of the robot, metres."""
    correction: float = 0.5
    """Share of the difference between the localiser's place and the network's that is corrected, 0 to 1."""
    unseen_views: int = 3
    """Views in a row without a sub-goal, after which the robot stops; until then it goes for the last one."""
    arcs: ArcSettings = field(default_factory=ArcSettings)
    """The local planner."""

    def __post_init__(self) -> None:
        if not self.ahead or not all(0.0 < a <= 3.0 for a in self.ahead) or list(self.ahead) != sorted(self.ahead):
            raise SettingError(f"ahead is {quoted(self.ahead)}, must be distances in metres, above 0, at most 3, nearest first")
        for name, least, most in (
            ("least_match", 0.0, 1.0),
            ("camera_ahead", -5.0, 5.0),
            ("correction", 0.0, 1.0),
            ("unseen_views", 0, 1000),
        ):
            value = getattr(self, name)
            if not least <= value <= most:
                raise SettingError(f"{name} is {value:g}, must be {least:g} to {most:g}")


class LearnedPolicy:
    """A ``Policy`` with a network."""

    def __init__(
        self, path: RecordedPath, model: Path | PathModel = DEFAULT_MODEL, settings: LearnedSettings | None = None
    ) -> None:
        """Loads the network and prepares the images of the path.

        Args:
            path: a path of one pinhole camera.
            model: the network, or its file.
            settings: None = the defaults.

        Raises:
            ModelError: the network cannot be used.
            ViewError: the path is of another kind of camera.
        """
        if path.camera != "pinhole":
            raise ViewError(f"the learned policy needs a pinhole camera, the path is of a {path.camera}; use teach_repeat")
        self.settings = settings or LearnedSettings()
        self.model = model if isinstance(model, PathModel) else PathModel(model)
        self._hfov = path.hfov
        self._images = np.stack([self.model.fitted(node.view[0], path.hfov) for node in path.nodes])
        self._distances = np.array([node.distance for node in path.nodes])
        self._planner = ArcPlanner(self.settings.arcs)
        self._goal: tuple[float, float, float] | None = None
        self._unseen = 0
        self.sighting: Sighting | None = None
        """What the network told about the last view."""

    def reset(self) -> None:
        """Forgets all earlier views."""
        self._planner.reset()
        self._goal, self._unseen, self.sighting = None, 0, None

    def act(self, view: View, stamp_ns: int, place: Place) -> Velocity:
        """Returns the velocity towards the farthest sub-goal that is seen well, around what stands in the way."""
        settings = self.settings
        here = float(np.interp(place.index, np.arange(len(self._distances)), self._distances))
        nodes = self._nodes(here)
        self.sighting = sighting = self.model.estimate(self.model.fitted(view[0], self._hfov), self._images[nodes])
        shift = self._shift(sighting, nodes, here)
        if abs(shift) > 0.1:
            nodes = self._nodes(here + settings.correction * shift)
            self.sighting = sighting = self.model.estimate(self.model.fitted(view[0], self._hfov), self._images[nodes])
        seen = np.flatnonzero(sighting.match >= settings.least_match)
        if len(seen):
            self._goal, self._unseen = self._in_base(sighting.pose[seen[-1]]), 0
        else:
            self._unseen += 1
        if self._goal is None or self._unseen > settings.unseen_views:
            return STOP
        return self._planner.velocity(self._goal, self._obstacles(sighting.free))

    def _nodes(self, here: float) -> NDArray[np.intp]:
        """Returns the nodes of the sub-goals, nearest first, each once."""
        wanted = here + np.array(self.settings.ahead)
        return np.unique(np.abs(self._distances[:, None] - wanted).argmin(axis=0))

    def _shift(self, sighting: Sighting, nodes: NDArray[np.intp], here: float) -> float:
        """Returns how much farther along the path the robot is than believed, metres, as the network sees it; 0 = it sees nothing."""
        seen = sighting.match >= self.settings.least_match
        if not seen.any():
            return 0.0
        away = np.sign(sighting.pose[seen, 0]) * np.hypot(sighting.pose[seen, 0], sighting.pose[seen, 1])
        return float(np.clip(np.median(self._distances[nodes[seen]] - away - here), -0.6, 0.6))

    def _in_base(self, pose: F64) -> tuple[float, float, float]:
        """Returns the pose of the robot that recorded the camera, in the frame of this robot."""
        x, y, yaw = (float(value) for value in pose)
        ahead = self.settings.camera_ahead
        return ahead + x - ahead * math.cos(yaw), y - ahead * math.sin(yaw), yaw

    def _obstacles(self, free: F64) -> F64:
        """Returns (M, 2): points in the frame of the robot at which free distances end."""
        ends = free < 0.95 * self.model.max_free
        bearings = self.model.bearings[ends]
        return np.stack([self.settings.camera_ahead + free[ends] * np.cos(bearings), free[ends] * np.sin(bearings)], axis=-1)


def _is_image(shape: list[Any]) -> bool:
    return len(shape) == 4 and shape[0] == 1 and shape[3] == 3 and all(isinstance(size, int) for size in shape)
