"""Reads the path-following network from its ONNX file, and runs it: relative poses of recorded images, and ranges of the nearest obstacles."""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from gibson_path_following.errors import ModelError
from gibson_path_following.localisation.pose_filter import OffsetCalibration
from gibson_path_following.obstacles.floor_plane import FloorPlane
from gibson_path_following.onnx_files import open_session, run
from gibson_path_following.types import Image

F64 = NDArray[np.float64]
DEFAULT_MODEL = Path(__file__).parents[1] / "models" / "path_following.onnx"
"""ONNX file of the network in the package."""
_INPUTS = ("present", "recorded", "earlier")
"""Inputs of the network; the last one is optional."""
_OUTPUTS = ("pose", "scale", "match", "hit")
"""Outputs of the network."""
_METADATA = ("hfov_deg", "free_edges", "offset_ratio", "offset_deviation")
"""Keys that the metadata of the file must have."""
_HFOV_DEG = (10.0, 179.0)
"""Least and largest horizontal field of view of its images, degrees."""
_MIN_RANGE, _MAX_RANGE = 0.5, 100.0
"""Limits of the last edge of the range bins, metres."""
_CAMERA_HEIGHT = "camera_height"
"""Key that they must have besides if the network has the input ``earlier``."""


@dataclass(frozen=True, slots=True)
class Prediction:
    """Outputs of the network for one view."""

    pose: F64
    """(K, 3), float64: poses of the recorded cameras in the present camera's frame: x ahead, y to the left, yaw; metres and radians."""
    scale: F64
    """(K, 3), float64: predicted mean absolute errors of ``pose``, metres and radians."""
    match: F64
    """(K,), float64: match probability, that a recorded image shows this place. Without a match its pose means nothing."""
    hit: F64
    """(D, B + 1), float64: probability that the first obstacle along each of ``PathModel.bearings`` lies in each range bin of
    ``PathModel.edges``; the last column: beyond the last edge."""


class PathModel:
    """Network of an ONNX file, run on one core."""

    def __init__(self, file: Path) -> None:
        """Loads the network and runs it once.

        Raises:
            ModelError: onnxruntime is not installed, or the file holds no such network.
        """
        self._file, self._session = file, open_session(file)
        self._check_ports(file)
        required = (*_METADATA, _CAMERA_HEIGHT) if len(self._session.get_inputs()) == len(_INPUTS) else _METADATA
        _, self.height, self.width, _ = self._session.get_inputs()[0].shape
        metadata: dict[str, str] = self._session.get_modelmeta().custom_metadata_map
        try:
            hfov_deg = float(metadata["hfov_deg"])
            self.hfov = math.radians(hfov_deg)
            """Horizontal field of view of its images, radians."""
            self.edges: F64 = np.array([float(edge) for edge in metadata["free_edges"].split(",")])
            """(B + 1,), float64: edges of the range bins, metres, from 0."""
            self.offsets = OffsetCalibration(float(metadata["offset_ratio"]), float(metadata["offset_deviation"]))
            """Calibration of its lateral offsets."""
            camera_height = float(metadata[_CAMERA_HEIGHT]) if _CAMERA_HEIGHT in required else None
        except (KeyError, ValueError) as error:
            raise ModelError(f"{file}: its metadata lack one of {', '.join(required)} as numbers; export it again") from error
        bearing_count, bins = self._session.get_outputs()[3].shape
        self._check_metadata(file, bins, hfov_deg, camera_height)
        self._floor = None if camera_height is None else FloorPlane(self.width, self.height, self.hfov, camera_height)
        """Warps earlier images onto the present one; None = the network has no such input."""
        across = 1.0 - (np.arange(bearing_count) + 0.5) * 2.0 / bearing_count
        self.bearings: F64 = np.arctan(across * math.tan(self.hfov / 2.0))
        """(D,), float64: bearings of the rows of ``Prediction.hit``, camera frame, radians, positive to the left, leftmost first."""
        grey = np.full((3, self.height, self.width, 3), 128, dtype=np.uint8)
        for count in (1, 2):
            self.estimate(grey[0], grey[:count], (grey[2], np.zeros(3)))

    def estimate(self, present: Image, recorded: NDArray[np.uint8], earlier: tuple[Image, F64] | None = None) -> Prediction:
        """Returns the outputs for a view.

        Args:
            present: (height, width, 3), uint8, as ``resample`` returns it.
            recorded: (K, height, width, 3), uint8, the same of recorded images.
            earlier: earlier image of the same camera, (height, width, 3), uint8, and its camera's pose (3,) in the present camera's frame: x ahead,
                y to the left, yaw; metres and radians. None = there is none.

        Raises:
            ModelError: the network cannot be run, or its outputs are not those of our networks.
        """
        images = {"present": present[None], "recorded": recorded}
        if self._floor is not None:
            warped = np.zeros_like(present) if earlier is None else self._floor.warp(*earlier)
            images["earlier"] = warped[None]
        values = run(self._session, self._file, images)
        count = len(recorded)
        needed = [(count, 3), (count, 3), (count,), (len(self.bearings), len(self.edges))]
        found = [value.shape for value in values]
        if found != needed:
            raise ModelError(
                f"{self._file}: for {count} recorded images its outputs {', '.join(_OUTPUTS)} have shapes {', '.join(map(str, found))}, must be "
                f"{', '.join(map(str, needed))}; use a file that gibson-sim learn path-following wrote"
            )
        return Prediction(*(np.asarray(value, dtype=np.float64) for value in values))

    def resample(self, image: Image, hfov: float) -> Image:
        """Returns (height, width, 3), uint8: an image as the network's camera would see it; beyond the image its edge is repeated.

        Args:
            image: (H, W, 3), uint8, of a pinhole camera with square pixels.
            hfov: horizontal field of view of the image, radians.
        """
        height, width = image.shape[:2]
        scale = (self.width / math.tan(self.hfov / 2.0)) / (width / math.tan(hfov / 2.0))
        if (width, height) == (self.width, self.height) and abs(scale - 1.0) < 0.02:
            return np.ascontiguousarray(image)
        size = max(1, round(width * scale)), max(1, round(height * scale))
        resized = cv2.resize(image, size, interpolation=cv2.INTER_AREA if scale < 1.0 else cv2.INTER_LINEAR)
        across, down = max(0, self.width - size[0]), max(0, self.height - size[1])
        borders = (down // 2, down - down // 2, across // 2, across - across // 2)
        padded = cv2.copyMakeBorder(resized, *borders, cv2.BORDER_REPLICATE)
        top, left = (padded.shape[0] - self.height) // 2, (padded.shape[1] - self.width) // 2
        return np.ascontiguousarray(padded[top : top + self.height, left : left + self.width], dtype=np.uint8)

    def _check_ports(self, file: Path) -> None:
        """Raises ModelError if inputs and outputs are not those of our networks."""
        inputs, outputs = self._session.get_inputs(), self._session.get_outputs()
        names = tuple(i.name for i in inputs), tuple(o.name for o in outputs)
        if names not in ((_INPUTS, _OUTPUTS), (_INPUTS[:2], _OUTPUTS)):
            raise ModelError(
                f"{file}: its inputs are {', '.join(names[0])} and its outputs {', '.join(names[1])}; must be "
                f"{', '.join(_INPUTS)} (the last one may be missing) and {', '.join(_OUTPUTS)}: use a file that gibson-sim learn path-following wrote"
            )
        if not all(_is_image(each.shape) for each in (inputs[0], *inputs[2:])) or not _is_fixed(outputs[3].shape, 2):
            raise ModelError(
                f"{file}: its images have shape {inputs[0].shape}, hit has {outputs[3].shape}; must be (1, height, width, 3) and "
                "(directions, bins), with fixed sizes"
            )

    def _check_metadata(self, file: Path, bins: int, hfov_deg: float, camera_height: float | None) -> None:
        """Raises ModelError if a number of the metadata is not possible; ``bins``: columns of ``hit``."""
        least, most = _HFOV_DEG
        if not least <= hfov_deg <= most:
            raise ModelError(f"{file}: its hfov_deg is {hfov_deg:g}, must be {least:g} to {most:g}; export it again")
        grows = bool(np.isfinite(self.edges).all()) and self.edges[0] == 0.0 and bool((np.diff(self.edges) > 0.0).all())
        if bins != len(self.edges) or not grows or not _MIN_RANGE <= self.edges[-1] <= _MAX_RANGE:
            raise ModelError(
                f"{file}: its free_edges are {len(self.edges)} numbers, {self.edges[0]:g} to {self.edges[-1]:g}, must be {bins} that grow from "
                f"0 m to at least {_MIN_RANGE:g} m and at most {_MAX_RANGE:g} m; export it again"
            )
        if not (0.05 <= self.offsets.ratio <= 2.0 and 0.0 <= self.offsets.deviation <= 10.0):
            raise ModelError(
                f"{file}: its offset_ratio is {self.offsets.ratio:g} and its offset_deviation {self.offsets.deviation:g}, must be 0.05 to 2 "
                "and 0 to 10 m; export it again"
            )
        if camera_height is not None and not 0.01 <= camera_height <= 100.0:
            raise ModelError(f"{file}: its {_CAMERA_HEIGHT} is {camera_height:g}, must be 0.01 to 100 m; export it again")


def _is_fixed(shape: list[Any], dimensions: int) -> bool:
    return len(shape) == dimensions and all(isinstance(size, int) for size in shape)


def _is_image(shape: list[Any]) -> bool:
    return len(shape) == 4 and shape[0] == 1 and shape[3] == 3 and all(isinstance(size, int) for size in shape)
