"""Networks that fill holes, in ONNX files: ours, and MI-GAN as exported by its authors."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from gibson_sim.errors import ConfigError
from gibson_sim.filling.holes import MOVING, NOTHING, OUTSIDE, SURFACE, UNSEEN, Filled, is_hole
from gibson_sim.filling.inputs import CHANNELS, filled_colour, packed
from gibson_sim.filling.onnx_files import DeviceTensor, device_of, not_finite, open_session, run, run_on_device
from gibson_sim.filling.push_pull import push_pull_depth
from gibson_sim.quoting import clipped, quoted

F32 = NDArray[np.float32]
U8 = NDArray[np.uint8]
MULTIPLE = 16
"""Images are padded to multiples of this many pixels for our networks."""
VERSION = "1"
"""Value of ``gibson_filler`` in the metadata of a file: the version of the input format."""
FADE_PX = 16.0
"""Distance from the nearest hole at which the correction of a visible surface has fallen to 1/e, pixels. Scans are bad where they have holes; further
away, corrections do not bring an image nearer to the truth, and leave blotches (chosen on the validation scenes, see docs/filler_training.md)."""
_LEAST_INVERSE = np.float32(1e-3)
"""Smaller inverse depths, negative ones among them, are not used, 1/m: push-pull fills these pixels."""
_CONTRACTS = (
    f"ours, float input (1, {CHANNELS}, H, W) and float output (1, 3, H, W); MI-GAN's pipeline, image (1, 3, H, W) and mask (1, 1, H, W), uint8; or "
    "its generator, (1, 4, R, R) to (1, 3, R, R): see docs/filler.md"
)


def open_network(file: Path, cuda_device: int = 0) -> GibsonNetwork | MiGanPipeline | MiGanGenerator:
    """Returns the network in a file; its kind follows from the shapes of its inputs. For ``cuda_device`` see ``open_session``.

    Raises:
        ConfigError: onnxruntime is not installed, or the file has no network of a supported kind.
    """
    session = open_session(file, cuda_device)
    inputs, outputs = session.get_inputs(), session.get_outputs()
    kinds, results = ([(value.type, tuple(value.shape)) for value in values] for values in (inputs, outputs))
    names = [value.name for value in inputs]
    if len(kinds) == 1 and _fits(kinds[0], "tensor(float)", CHANNELS):
        version = session.get_modelmeta().custom_metadata_map.get("gibson_filler", VERSION)
        if version != VERSION:
            raise ConfigError(
                f"{file} is for version {quoted(version)} of the input format (metadata gibson_filler), must be for {VERSION}; train it again"
            )
        if any(isinstance(size, int) for size in kinds[0][1][2:]):
            raise ConfigError(
                f"{file} takes only images of {kinds[0][1][3]}x{kinds[0][1][2]} pixels, must take any size; export it with dynamic axes"
            )
        if _fits(results[0], "tensor(float)", 3):
            return GibsonNetwork(file, session)
    elif names == ["image", "mask"] and _fits(kinds[0], "tensor(uint8)", 3) and _fits(kinds[1], "tensor(uint8)", 1):
        return MiGanPipeline(file, session)
    elif len(kinds) == 1 and _fits(kinds[0], "tensor(float)", 4):
        side, other = kinds[0][1][2:]
        if isinstance(side, int) and side == other and 16 <= side <= 2048:
            return MiGanGenerator(file, session, side)
    raise ConfigError(
        f"{file} has {_described('input', inputs)} and {_described('output', outputs)}, must be one of: {_CONTRACTS}"
    )


def _described(what: str, values: Sequence[Any]) -> str:
    """Returns names, types and shapes of the inputs or outputs of a session."""
    found = ", ".join(f"{value.name} {value.type.removeprefix('tensor(').rstrip(')')} {list(value.shape)}" for value in values)
    return f"{what}{'s' * (len(values) != 1)} {clipped(found, 120)}"


def _fits(value: tuple[str, tuple[Any, ...]], kind: str, channels: int) -> bool:
    """Returns whether an input or output has the element type, four dimensions and the number of channels."""
    return (
        value[0] == kind
        and len(value[1]) == 4
        and value[1][1] == channels
        and value[1][0] in (1, None, *_named_sizes(value[1][:1]))
    )


def _named_sizes(sizes: tuple[Any, ...]) -> tuple[str, ...]:
    """Returns the dynamic sizes, which have a name."""
    return tuple(size for size in sizes if isinstance(size, str))


class GibsonNetwork:
    """Our network: fills holes, corrects the scan around them, and also fills depth if it has a second output."""

    def __init__(self, file: Path, session: Any) -> None:
        self._file, self._session = file, session
        self._name = session.get_inputs()[0].name
        self.has_depth = len(session.get_outputs()) > 1
        """Whether a second output is inverse depth."""

    @property
    def device(self) -> str:
        """Kind of device that the network runs on: ``cuda`` or ``cpu``."""
        return device_of(self._session)

    def run_on_device(self, ordinal: int, size: tuple[int, int], input_: int, image: int, inverse_depth: int | None) -> None:
        """Runs the network on memory of its own device; returns when all its work has ended.

        Args:
            ordinal: ordinal of the device.
            size: width and height, multiples of ``MULTIPLE``, pixels.
            input_: address of the input, (1, 9, H, W) float32, see ``filling.inputs.network_input``.
            image: address of the image, (1, 3, H, W) float32, 0 to 1.
            inverse_depth: address of the inverse depth, (1, 1, H, W) float32, 1/m; None = not requested.

        Raises:
            ConfigError: the network cannot be run, or its outputs have other shapes.
        """
        names = [value.name for value in self._session.get_outputs()]
        planes, (width, height) = (CHANNELS, 3, 1), size
        shapes = [(1, count, height, width) for count in planes]
        outputs = [DeviceTensor(names[0], shapes[1], image)]
        if inverse_depth is not None:
            outputs.append(DeviceTensor(names[1], shapes[2], inverse_depth))
        run_on_device(self._session, self._file, ordinal, [DeviceTensor(self._name, shapes[0], input_)], outputs)

    def not_finite(self) -> ConfigError:
        """Returns the error of an output with a NaN or an infinity."""
        return not_finite(self._file)

    def fill(self, colour: U8, depth: F32, normals: F32, hole: U8, *, with_depth: bool) -> Filled:
        """See ``Filler``."""
        height, width = hole.shape
        holes = is_hole(hole)
        # Trained on pinhole images of scans, the network knows no black rim and no robot: to it, these pixels are holes.
        moving = hole == MOVING
        known = np.where((hole == OUTSIDE) | moving, np.uint8(NOTHING), hole)
        seen_depth = np.where(moving, np.float32(np.inf), depth) if moving.any() else depth
        values = packed(filled_colour(colour, known), seen_depth, normals, known)
        padding = ((0, 0), (0, 0), (0, -height % MULTIPLE), (0, -width % MULTIPLE))
        values = np.pad(values, padding, mode="edge") if height % MULTIPLE or width % MULTIPLE else values
        outputs = run(self._session, self._file, {self._name: values})
        image = _planes(outputs[0], self._file, (1, 3, *values.shape[2:]))[0, :, :height, :width]
        out = _near_holes(_bytes(image), colour, holes)
        np.copyto(out, colour, where=((hole == UNSEEN) | (hole == OUTSIDE) | moving)[:, :, None])
        if not with_depth:
            return Filled(out)
        if not self.has_depth:
            return Filled(out, push_pull_depth(depth, holes, hole == SURFACE))
        inverse = _planes(outputs[1], self._file, (1, 1, *values.shape[2:]))[0, 0, :height, :width]
        usable = inverse > _LEAST_INVERSE
        filled = depth.copy() if usable[holes].all() else push_pull_depth(depth, holes, hole == SURFACE)
        np.divide(np.float32(1.0), inverse, out=filled, where=holes & usable)
        return Filled(out, filled)


def _near_holes(corrected: U8, colour: U8, holes: NDArray[np.bool_]) -> U8:
    """Returns the corrected image in holes, fading to the rendered one with the distance from them."""
    if not holes.any():
        return colour.copy()
    distance = cv2.distanceTransform((~holes).astype(np.uint8), cv2.DIST_L2, 5)
    share = np.exp(distance * np.float32(-1.0 / FADE_PX))
    blended = cv2.blendLinear(corrected, colour, share, np.float32(1.0) - share)
    return np.asarray(blended, dtype=np.uint8)


class MiGanPipeline:
    """MI-GAN with its pre- and postprocessing: colours and mask (255 = known) to colours, all uint8."""

    def __init__(self, file: Path, session: Any) -> None:
        self._file, self._session = file, session

    def fill(self, colour: U8, depth: F32, normals: F32, hole: U8, *, with_depth: bool) -> Filled:
        """See ``Filler``."""

        def inpainted() -> U8:
            known = np.where(is_hole(hole) | (hole == OUTSIDE) | (hole == MOVING), 0, 255).astype(np.uint8)
            feeds = {"image": np.ascontiguousarray(colour.transpose(2, 0, 1))[None], "mask": known[None, None]}
            image = run(self._session, self._file, feeds)[0]
            if image.shape != (1, 3, *hole.shape) or image.dtype != np.uint8:
                raise _wrong_output(self._file, image, (1, 3, *hole.shape), "uint8")
            return np.asarray(image[0].transpose(1, 2, 0), dtype=np.uint8)

        return _compose(inpainted, colour, depth, hole, with_depth=with_depth)


class MiGanGenerator:
    """MI-GAN's generator, of a fixed size: mask - 0.5 (mask 1 = known) and colours (-1 to 1) times the mask to colours (-1 to 1)."""

    def __init__(self, file: Path, session: Any, side: int) -> None:
        self._file, self._session, self._side = file, session, side
        self._name = session.get_inputs()[0].name

    def fill(self, colour: U8, depth: F32, normals: F32, hole: U8, *, with_depth: bool) -> Filled:
        """See ``Filler``."""
        size = (self._side, self._side)

        def inpainted() -> U8:
            known = cv2.resize((hole == SURFACE).astype(np.float32), size, interpolation=cv2.INTER_NEAREST)
            small = cv2.resize(colour, size, interpolation=cv2.INTER_LINEAR).astype(np.float32) / 127.5 - 1.0
            values = np.concatenate([known[None] - 0.5, small.transpose(2, 0, 1) * known]).astype(np.float32)[None]
            image = _planes(run(self._session, self._file, {self._name: values})[0], self._file, (1, 3, *size))[0]
            large = cv2.resize(_bytes(0.5 * image + 0.5), (hole.shape[1], hole.shape[0]), interpolation=cv2.INTER_LINEAR)
            return np.asarray(large, dtype=np.uint8)

        return _compose(inpainted, colour, depth, hole, with_depth=with_depth)


def _compose(inpainted: Callable[[], U8], colour: U8, depth: F32, hole: U8, *, with_depth: bool) -> Filled:
    """Returns an image with its holes inpainted and other pixels unchanged; a copy if there are no holes."""
    holes = is_hole(hole)
    out = np.where(holes[:, :, None], inpainted(), colour) if holes.any() else colour.copy()
    return Filled(out, push_pull_depth(depth, holes, hole == SURFACE) if with_depth else None)


def _bytes(image: F32) -> U8:
    """Returns planes (3, H, W), 0 to 1, as an image (H, W, 3)."""
    return np.ascontiguousarray(np.rint(np.clip(image, 0.0, 1.0) * np.float32(255.0)).astype(np.uint8).transpose(1, 2, 0))


def _planes(value: NDArray[Any], file: Path, shape: tuple[int, ...]) -> F32:
    if value.shape != shape or value.dtype != np.float32:
        raise _wrong_output(file, value, shape, "float32")
    return value


def _wrong_output(file: Path, value: NDArray[Any], shape: tuple[int, ...], kind: str) -> ConfigError:
    return ConfigError(f"{file}: its output is {value.dtype} {list(value.shape)}, must be {kind} {list(shape)}; export it again")
