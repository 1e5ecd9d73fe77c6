"""Fills the holes of images in a target in place: on the GPU if it can; else reads the pixels to the host, fills them and writes them back."""

from __future__ import annotations

import logging
from typing import Any, TypeVar

import cv2
import numpy as np
from numpy.typing import NDArray

from gibson_sim.errors import ConfigError
from gibson_sim.filling.fillers import open_filler, uses_network
from gibson_sim.filling.holes import MOVING, NOTHING, OUTSIDE, SURFACE, Filled, Filler, is_hole
from gibson_sim.quoting import quoted
from gibson_sim.render.context import GlContext, gl as GL
from gibson_sim.render.draw.effects import Average
from gibson_sim.render.draw.target import ATTACHMENT, RenderTarget
from gibson_sim.render.filling.gpu_filling import GpuFilling
from gibson_sim.render.readback.frames import RAW_FORMATS, TargetImage, depth_of, hole_of, moving_of, normals_of, outside_of
from gibson_sim.types import CameraSpec

_log = logging.getLogger(__name__)
F32 = NDArray[np.float32]
U8 = NDArray[np.uint8]
Value = TypeVar("Value", np.uint8, np.float32)
_NEIGHBOURS = np.ones((3, 3), dtype=np.uint8)


class HoleFilling:
    """Applies the hole filling of ``CameraSpec.fill``.

    Args:
        context: it must be current in every call.
        gpu: fills on the GPU; None = all images are filled on the host.
    """

    def __init__(self, context: GlContext, gpu: GpuFilling | None = None) -> None:
        self._gl = GL.Gl(context)
        self._gpu = gpu
        self._fillers: dict[str, Filler] = {}

    def prepare(self, fill: str) -> Filler:
        """Returns the filler of a method, a value of ``CameraSpec.fill``; a network is loaded at the first call.

        Raises:
            ConfigError: the network cannot be loaded.
        """
        if fill not in self._fillers:
            device = self._gpu.cuda_device if self._gpu is not None and uses_network(fill) else 0
            filler = self._fillers[fill] = open_filler(fill, device)
            if self._gpu is not None and not self._gpu.runs(filler):
                _log.warning(
                    "fill: %s works on copies of the images in host memory, and is slower; see 'On a GPU' in docs/filler.md", fill
                )
        return self._fillers[fill]

    def fill(self, target: RenderTarget, image: TargetImage, average: Average | None = None) -> None:
        """Fills the holes of an image.

        Args:
            target: target with the image and the feature ``NORMALS``, without multisampling.
            image: the image to fill.
            average: the average that the colours are from, which marks the pixels with a share of holes; None = they are not an average.

        Raises:
            ConfigError: the network cannot be run; names the camera.
        """
        try:
            self._fill(target, image, average)
        except ConfigError as error:
            camera = image.camera
            raise ConfigError(
                f"holes of camera {quoted(camera.name)}, {camera.width}x{camera.height}, are not filled: {error}"
            ) from error

    def _fill(self, target: RenderTarget, image: TargetImage, average: Average | None) -> None:
        camera = image.camera
        filler, colours = self.prepare(camera.fill), "rgb" in camera.outputs
        with_depth = camera.fill_depth and bool({"depth", "position"} & set(camera.outputs))
        if not (colours or with_depth):
            return
        if self._gpu is not None and self._gpu.can_fill(filler, image):
            blurred = None if average is None else average.texture
            self._gpu.fill(target, image, filler, colours=colours, with_depth=with_depth, average=blurred)
            return
        raw_normals = self._read(target, image, "NORMALS")
        hole = hole_of(raw_normals)
        in_colours = is_hole(hole) if average is None else is_hole(hole) | average.holes()
        if camera.fill == "push_pull" and not in_colours.any():
            return
        raw_color, raw_depth = self._read(target, image, "color"), self._read(target, image, "depth")
        depth, normals = depth_of(raw_depth, camera.near, camera.far), normals_of(raw_normals)
        colour = np.asarray(cv2.cvtColor(raw_color, cv2.COLOR_RGBA2RGB), dtype=np.uint8)
        holes = hole.copy()
        holes[moving_of(raw_normals)] = MOVING
        if camera.projection != "pinhole" or camera.distortion:
            holes[outside_of(raw_normals)] = OUTSIDE
        filled_depth = None
        if colours:
            marked = np.where(in_colours & ((holes == SURFACE) | (holes == MOVING)), np.uint8(NOTHING), holes)
            filled = _filled(filler, camera, colour, depth, normals, marked, with_depth=with_depth and average is None)
            filled_depth = filled.depth
            raw_color[:, :, :3] = filled.colour
            self._write(target, image, "color", raw_color)
        if with_depth and filled_depth is None:  # depth is never an average
            filled_depth = _filled(filler, camera, colour, depth, normals, holes, with_depth=True).depth
        if filled_depth is not None:
            np.divide(np.float32(camera.near), filled_depth, out=raw_depth, where=is_hole(hole))
            self._write(target, image, "depth", raw_depth)

    def close(self) -> None:
        """Frees all GPU resources; a second call does nothing. The context must be current."""
        if self._gpu is not None:
            self._gpu.close()

    def _read(self, target: RenderTarget, image: TargetImage, name: str) -> NDArray[Any]:
        raw, camera, gl = RAW_FORMATS[name], image.camera, self._gl
        shape = (camera.height, camera.width) if raw.channels == 1 else (camera.height, camera.width, raw.channels)
        out = np.empty(shape, dtype=raw.dtype)
        gl.glBindFramebuffer(GL.FRAMEBUFFER, target.framebuffer)
        gl.glReadBuffer(GL.COLOR_ATTACHMENT0 + ATTACHMENT.get(name, 0))
        gl.glPixelStorei(GL.PACK_ALIGNMENT, 1)
        gl.glReadPixels(image.x, image.y, camera.width, camera.height, raw.gl_format, raw.gl_type, out.ctypes.data)
        return out

    def _write(self, target: RenderTarget, image: TargetImage, name: str, pixels: NDArray[Any]) -> None:
        raw, camera, gl = RAW_FORMATS[name], image.camera, self._gl
        gl.glPixelStorei(GL.UNPACK_ALIGNMENT, 1)
        gl.glTextureSubImage2D(
            target.textures[name], 0, image.x, image.y, camera.width, camera.height, raw.gl_format, raw.gl_type, pixels.ctypes.data
        )  # fmt: skip


def hole_filling_of(context: GlContext) -> HoleFilling:
    """Returns the hole filling of a context: on the GPU if the context draws on one."""
    return HoleFilling(context, None if context.device.software else GpuFilling(context))


def _filled(filler: Filler, camera: CameraSpec, colour: U8, depth: F32, normals: F32, hole: U8, *, with_depth: bool) -> Filled:
    """Returns the filled image of a camera; for the other arguments see ``Filler.fill``."""
    # A panorama is a full turn: what is beyond its left edge is at its right edge.
    turn = camera.width // 2 if camera.projection == "equirectangular" else 0
    if turn:
        colour, depth, normals, hole = (
            _wrapped(colour, turn),
            _wrapped(depth, turn),
            _wrapped(normals, turn),
            _wrapped(hole, turn),
        )
    blended = camera.samples > 1 or camera.projection != "pinhole" or bool(camera.distortion)
    filled = filler.fill(colour, depth, normals, _dilate(hole) if blended else hole, with_depth=with_depth)
    inner = slice(turn, turn + camera.width)
    return Filled(filled.colour[:, inner], None if filled.depth is None else filled.depth[:, inner])


def _wrapped(values: NDArray[Value], columns: int) -> NDArray[Value]:
    """Returns an image (H, W) or (H, W, C) with columns of its right edge added at its left, and of its left edge at its right."""
    return np.concatenate([values[:, -columns:], values, values[:, :columns]], axis=1)


def _dilate(hole: U8) -> U8:
    """Returns a hole image with holes dilated by one pixel: colours of these pixels are partly blended with the background."""
    out = hole.copy()
    rim = (cv2.dilate(is_hole(hole).astype(np.uint8), _NEIGHBOURS) != 0) & (hole == SURFACE)
    out[rim] = NOTHING
    return out
