"""Goggles: adapt images of a real camera to the appearance of the simulator, in which the networks of a robot were trained.

Three modes: a network of ``gibson-sim learn goggles`` (onnxruntime, no PyTorch), and two without a network: histogram matching, and grey-world
white balance. All are stateless: an image of any size gives an image of the same size, and equal images give equal results.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Protocol

import cv2
import numpy as np
from numpy.typing import NDArray

from gibson_path_following.errors import ModelError, SettingError, ViewError, quoted
from gibson_path_following.onnx_files import open_session, run
from gibson_path_following.paths.path_folder import load_path
from gibson_path_following.types import Image, RecordedPath

F64 = NDArray[np.float64]
MODES = ("learned", "histogram", "grey_world")
"""A network; histogram matching to a reference; grey-world white balance with the brightness of a reference."""
DEFAULT_MODEL = Path(__file__).parents[1] / "models" / "goggles.onnx"
"""ONNX file of the network in the package."""
SIMULATOR_LOOK = Path(__file__).parents[1] / "models" / "simulator_look.csv"
"""Colour reference of the simulator: quantiles of its images of the training scenes."""
SMALL = (96, 64)
"""Width and height of the input ``small``, a downscaled copy of the image, pixels."""
MAX_PIXELS = 2**21
"""Pixels of the largest image that the network is run on: it needs about 0.5 KB for each."""
_STEPS = 256
"""Quantiles of a colour reference."""
_LUMINANCE = np.array([0.2126, 0.7152, 0.0722])
_LARGEST_GAIN = 64.0
_CODES = np.arange(256, dtype=np.float64) / 255.0
_LINEAR = np.where(_CODES <= 0.04045, _CODES / 12.92, ((_CODES + 0.055) / 1.055) ** 2.4)
"""sRGB level -> linear light, 0 to 1."""
_INPUTS = {"image": (1, None, None, 3), "small": (1, SMALL[1], SMALL[0], 3)}
"""Inputs of the network, all uint8 -> shape; None = any size."""


class Goggles(Protocol):
    """Adapts images to the appearance of the simulator."""

    def __call__(self, image: Image) -> Image:
        """Returns the adapted image, (H, W, 3), uint8, of the same size.

        Args:
            image: (H, W, 3), uint8, RGB.

        Raises:
            PathFollowingError: the image cannot be adapted.
        """


@dataclass(frozen=True, slots=True)
class ColourReference:
    """Distribution of the levels of red, green and blue in some images."""

    quantiles: F64
    """(256, 3), float64: level, 0 to 255, below which a share (k + 0.5) / 256 of the pixels lies, of each channel."""

    @classmethod
    def of_images(cls, images: Iterable[Image]) -> ColourReference:
        """Returns the reference of one or more images (H, W, 3), uint8, of any sizes."""
        counts = np.sum([_histograms(image) for image in images], axis=0)
        shares = (np.arange(_STEPS) + 0.5) / _STEPS
        return cls(np.stack([np.interp(shares, _cdf(channel), np.arange(256.0)) for channel in counts], axis=1))

    @classmethod
    def of_path(cls, path: RecordedPath) -> ColourReference:
        """Returns the reference of the images of a path."""
        return cls.of_images(image for node in path.nodes for image in node.view)

    @classmethod
    def load(cls, file: Path = SIMULATOR_LOOK) -> ColourReference:
        """Returns the reference in a file.

        Raises:
            ModelError: the file holds none.
        """
        try:
            levels = np.loadtxt(file, delimiter=",", dtype=np.float64, ndmin=2)
        except (OSError, ValueError) as error:
            raise ModelError(f"cannot read {file}: {quoted(str(error))}; install the package again") from error
        if levels.shape != (_STEPS, 3) or not ((levels >= 0.0) & (levels <= 255.0)).all():
            raise ModelError(
                f"{file} has {levels.shape} numbers, must be {_STEPS} lines of three, 0 to 255; install the package again"
            )
        return cls(levels)

    def as_text(self) -> str:
        """Returns the content of a file: a line for each quantile, red, green, blue."""
        return "".join(f"{r:.1f},{g:.1f},{b:.1f}\n" for r, g, b in self.quantiles.tolist())

    @property
    def luminance(self) -> float:
        """Mean luminance of the images, linear, 0 to 1."""
        return float(np.interp(self.quantiles, np.arange(256.0), _LINEAR).mean(axis=0) @ _LUMINANCE)


class HistogramGoggles:
    """Histogram matching of each channel to a reference."""

    def __init__(self, reference: ColourReference) -> None:
        self._reference = reference

    def __call__(self, image: Image) -> Image:
        """See ``Goggles``."""
        shares = (np.arange(_STEPS) + 0.5) / _STEPS
        tables = [
            np.interp(_cdf(counts), shares, levels)
            for counts, levels in zip(_histograms(image), self._reference.quantiles.T, strict=True)
        ]
        return _apply_tables(image, tables)


class GreyWorldGoggles:
    """Grey-world white balance in linear light, with the mean luminance of a reference: it takes the mean colour for that of the light."""

    def __init__(self, reference: ColourReference) -> None:
        self._luminance = reference.luminance

    def __call__(self, image: Image) -> Image:
        """See ``Goggles``."""
        tables = []
        for counts in _histograms(image):
            mean = float(counts @ _LINEAR) / float(counts.sum())
            gain = min(self._luminance / max(mean, 1e-6), _LARGEST_GAIN)
            tables.append(np.interp(np.minimum(gain * _LINEAR, 1.0), _LINEAR, np.arange(256.0)))
        return _apply_tables(image, tables)


class LearnedGoggles:
    """Network of an ONNX file, run on one core."""

    def __init__(self, file: Path = DEFAULT_MODEL) -> None:
        """Loads the network, and runs it once.

        Raises:
            ModelError: onnxruntime is not installed, or the file holds no such network.
        """
        self._file, self._session = file, open_session(file)
        inputs, number = self._session.get_inputs(), len(self._session.get_outputs())
        if {each.name for each in inputs} != set(_INPUTS) or not all(map(_fits, inputs)) or number != 1:
            found = ", ".join(_described(each.name, each.type, each.shape) for each in inputs)
            required = " and ".join(_described(name, "uint8", shape) for name, shape in _INPUTS.items())
            raise ModelError(
                f"{file} has the inputs {quoted(found)} and {number} output{'s' * (number != 1)}, must have the inputs {required} and one output; "
                "use a file that gibson-sim learn goggles wrote"
            )
        for width, height in ((96, 64), (34, 22)):  # it must accept any size
            self(np.zeros((height, width, 3), np.uint8))

    def __call__(self, image: Image) -> Image:
        """See ``Goggles``."""
        height, width = image.shape[:2]
        if height * width > MAX_PIXELS:
            raise ViewError(
                f"an image has {width}x{height} pixels, Goggles take up to {MAX_PIXELS}; let the camera's driver send smaller ones"
            )
        even = cv2.copyMakeBorder(image, 0, height % 2, 0, width % 2, cv2.BORDER_REPLICATE)
        small = cv2.resize(image, SMALL, interpolation=cv2.INTER_AREA)
        (found,) = run(self._session, self._file, {"image": even[None], "small": small[None]})
        if found.shape != (1, *even.shape) or found.dtype != np.uint8:
            raise ModelError(
                f"{self._file}: its output is {found.dtype} {found.shape}, must be uint8 {(1, *even.shape)}, as its image"
            )
        return np.ascontiguousarray(found[0, :height, :width])


def _fits(found: Any) -> bool:
    """Returns whether an input of a network has the required type and shape; a size that the file leaves free fits any."""
    required = _INPUTS[found.name]
    if found.type != "tensor(uint8)" or len(found.shape) not in (0, len(required)):  # 0 = the file leaves the shape free
        return False
    sizes = zip(found.shape, required, strict=False)
    return all(not isinstance(size, int) or size == must for size, must in sizes)


def _described(name: str, kind: str, shape: Iterable[Any]) -> str:
    """Returns name, type and shape of an input in one text: ``small uint8 (1, 64, 96, 3)``."""
    sizes = ", ".join(str(size) if isinstance(size, int) else "any" for size in shape)
    return f"{name} {kind.removeprefix('tensor(').rstrip(')')} ({sizes})"


def make_goggles(mode: str, model: str = "", reference: ColourReference | None = None) -> Goggles:
    """Returns the Goggles of a mode.

    Args:
        mode: one of ``MODES``.
        model: ONNX file of ``learned``; empty = the network in the package.
        reference: colour reference of the other modes; None = that of the simulator.

    Raises:
        PathFollowingError: there is no such mode, or the file cannot be used.
    """
    if mode == "learned":
        return LearnedGoggles(Path(model) if model else DEFAULT_MODEL)
    if mode == "histogram":
        return HistogramGoggles(reference or ColourReference.load())
    if mode == "grey_world":
        return GreyWorldGoggles(reference or ColourReference.load())
    raise SettingError(f"mode is {quoted(mode)}, must be {', '.join(MODES[:-1])} or {MODES[-1]}")


def load_reference(folder: str) -> ColourReference:
    """Returns the reference of a path in a folder, or of the simulator if ``folder`` is empty.

    Raises:
        PathFollowingError: the folder holds no path.
    """
    return ColourReference.of_path(load_path(Path(folder))) if folder else ColourReference.load()


def _histograms(image: Image) -> NDArray[np.int64]:
    """Returns (3, 256), int64: histogram of each channel of an image (H, W, 3), uint8."""
    return np.stack([np.bincount(image[..., channel].reshape(-1), minlength=256) for channel in range(3)])


def _cdf(counts: NDArray[np.int64]) -> F64:
    """Returns (256,), float64: share of the pixels below each level of a histogram (256,); those of the level itself count half."""
    return (np.cumsum(counts) - 0.5 * counts) / max(1, int(counts.sum()))


def _apply_tables(image: Image, tables: list[F64]) -> Image:
    """Returns an image with a lookup table (256,), 0 to 255, applied to each channel."""
    table = np.clip(np.rint(np.stack(tables, axis=1)), 0.0, 255.0).astype(np.uint8)[None]
    return np.asarray(cv2.LUT(np.ascontiguousarray(image), table), dtype=np.uint8)
