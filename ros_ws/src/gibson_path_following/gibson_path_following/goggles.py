"""Goggles: bring images of a real camera to the look of the simulator, in which the networks of a robot were trained.

Three ways: a network of ``gibson-sim learn goggles`` (onnxruntime, no PyTorch), and two that need none: matching of histograms, and grey
world. All take images of any size, one at a time: an image in, an image of the same size out, which equal images always become.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Protocol

import cv2
import numpy as np
from numpy.typing import NDArray

from gibson_path_following.errors import ModelError, SettingError, ViewError, quoted
from gibson_path_following.onnx_files import open_session, run
from gibson_path_following.path_folder import load_path
from gibson_path_following.types import Image, RecordedPath

F64 = NDArray[np.float64]
MODES = ("learned", "histogram", "grey_world")
"""A network; each colour as often as in the reference; colours that are grey on average, as bright as the reference."""
DEFAULT_MODEL = Path(__file__).with_name("models") / "goggles.onnx"
"""The network in the package."""
SIMULATOR_LOOK = Path(__file__).with_name("models") / "simulator_look.csv"
"""How often each level is in the simulator's images of the training scenes."""
SMALL = (96, 64)
"""Width and height of the small copy of an image that the network sees, pixels."""
MAX_PIXELS = 2**21
"""Largest image that the network is run on: it needs about 0.5 KB for each pixel."""
_STEPS = 256
_LUMINANCE = np.array([0.2126, 0.7152, 0.0722])
_LARGEST_GAIN = 64.0
_CODES = np.arange(256, dtype=np.float64) / 255.0
_LINEAR = np.where(_CODES <= 0.04045, _CODES / 12.92, ((_CODES + 0.055) / 1.055) ** 2.4)
"""sRGB level -> linear light, 0 to 1."""
_INPUTS, _OUTPUTS = ("image", "small"), ("brought",)


class Goggles(Protocol):
    """Whatever brings images to the simulator's look."""

    def __call__(self, image: Image) -> Image:
        """Returns an image of the same size.

        Raises:
            PathFollowingError: it cannot be brought there.
        """


@dataclass(frozen=True, slots=True)
class Look:
    """How often each level of red, green and blue is in some images."""

    levels: F64
    """(256, 3): level, 0 to 255, that a share of (k + 0.5) / 256 of the pixels is below."""

    @classmethod
    def of_images(cls, images: Iterable[Image]) -> Look:
        """Returns the look of images (H, W, 3) of any sizes, of which there is at least one."""
        counts = np.sum([_counts(image) for image in images], axis=0)
        shares = (np.arange(_STEPS) + 0.5) / _STEPS
        return cls(np.stack([np.interp(shares, _places(channel), np.arange(256.0)) for channel in counts], axis=1))

    @classmethod
    def of_path(cls, path: RecordedPath) -> Look:
        """Returns the look of the images of a path."""
        return cls.of_images(image for node in path.nodes for image in node.view)

    @classmethod
    def load(cls, file: Path = SIMULATOR_LOOK) -> Look:
        """Returns the look in a file.

        Raises:
            ModelError: it holds none.
        """
        try:
            levels = np.loadtxt(file, delimiter=",", dtype=np.float64, ndmin=2)
        except (OSError, ValueError) as error:
            raise ModelError(f"cannot read {file}: {quoted(str(error))}; install the package anew") from error
        if levels.shape != (_STEPS, 3) or not ((levels >= 0.0) & (levels <= 255.0)).all():
            raise ModelError(
                f"{file} has {levels.shape} numbers, must be {_STEPS} lines of three, 0 to 255; install the package anew"
            )
        return cls(levels)

    def as_text(self) -> str:
        """Returns the look as the text of a file."""
        return "".join(f"{r:.1f},{g:.1f},{b:.1f}\n" for r, g, b in self.levels.tolist())

    @property
    def luminance(self) -> float:
        """Mean luminance, linear, 0 to 1."""
        return float(np.interp(self.levels, np.arange(256.0), _LINEAR).mean(axis=0) @ _LUMINANCE)


class HistogramGoggles:
    """Gives each channel the distribution of levels of a look."""

    def __init__(self, look: Look) -> None:
        self._look = look

    def __call__(self, image: Image) -> Image:
        """See ``Goggles``."""
        shares = (np.arange(_STEPS) + 0.5) / _STEPS
        tables = [
            np.interp(_places(counts), shares, levels) for counts, levels in zip(_counts(image), self._look.levels.T, strict=True)
        ]
        return _looked_up(image, tables)


class GreyWorldGoggles:
    """Makes an image grey on average, in linear light, and as bright as a look: the colour of the light is taken for that average."""

    def __init__(self, look: Look) -> None:
        self._luminance = look.luminance

    def __call__(self, image: Image) -> Image:
        """See ``Goggles``."""
        tables = []
        for counts in _counts(image):
            mean = float(counts @ _LINEAR) / float(counts.sum())
            gain = min(self._luminance / max(mean, 1e-6), _LARGEST_GAIN)
            tables.append(np.interp(np.minimum(gain * _LINEAR, 1.0), _LINEAR, np.arange(256.0)))
        return _looked_up(image, tables)


class LearnedGoggles:
    """The network in a file, run on one core."""

    def __init__(self, file: Path = DEFAULT_MODEL) -> None:
        """Loads the network, and tries it.

        Raises:
            ModelError: onnxruntime is not installed, or the file holds no such network.
        """
        self._file, self._session = file, open_session(file)
        inputs, outputs = self._session.get_inputs(), self._session.get_outputs()
        names = tuple(i.name for i in inputs), tuple(o.name for o in outputs)
        if names != (_INPUTS, _OUTPUTS):
            raise ModelError(
                f"{file}: its inputs are {quoted(', '.join(names[0]))} and its outputs {quoted(', '.join(names[1]))}; must be "
                f"{', '.join(_INPUTS)} and {', '.join(_OUTPUTS)}: use a file that gibson-sim learn goggles wrote"
            )
        for width, height in ((96, 64), (34, 22)):  # it must take any size
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


def make_goggles(mode: str, model: str = "", look: Look | None = None) -> Goggles:
    """Returns what brings images to the simulator's look.

    Args:
        mode: one of ``MODES``.
        model: ONNX file of ``learned``; empty = the network in the package.
        look: reference of the other modes; None = that of the simulator.

    Raises:
        PathFollowingError: there is no such mode, or the file cannot be used.
    """
    if mode == "learned":
        return LearnedGoggles(Path(model) if model else DEFAULT_MODEL)
    if mode == "histogram":
        return HistogramGoggles(look or Look.load())
    if mode == "grey_world":
        return GreyWorldGoggles(look or Look.load())
    raise SettingError(f"mode is {quoted(mode)}, must be {', '.join(MODES[:-1])} or {MODES[-1]}")


def look_of(folder: str) -> Look:
    """Returns the look of a path in a folder, or of the simulator if ``folder`` is empty.

    Raises:
        PathFollowingError: the folder holds no path.
    """
    return Look.of_path(load_path(Path(folder))) if folder else Look.load()


def _counts(image: Image) -> NDArray[np.int64]:
    """Returns (3, 256): how many pixels have each level, of each channel."""
    return np.stack([np.bincount(image[..., channel].reshape(-1), minlength=256) for channel in range(3)])


def _places(counts: NDArray[np.int64]) -> F64:
    """Returns (256,): share of the pixels that are darker than each level, those of the level itself counted half."""
    return (np.cumsum(counts) - 0.5 * counts) / max(1, int(counts.sum()))


def _looked_up(image: Image, tables: list[F64]) -> Image:
    """Returns an image whose channels are looked up in (256,) tables of levels."""
    table = np.clip(np.rint(np.stack(tables, axis=1)), 0.0, 255.0).astype(np.uint8)[None]
    return np.asarray(cv2.LUT(np.ascontiguousarray(image), table), dtype=np.uint8)
