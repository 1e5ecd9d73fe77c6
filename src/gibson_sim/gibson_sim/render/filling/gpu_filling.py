"""Fills the holes of images in a target in place, on the GPU, by push-pull and by our networks: no pixel passes through the host.

The compute passes do what ``filling.push_pull``, ``filling.inputs`` and ``filling.network`` do on the host, in float32; colours differ by at most
a few steps of 255, where rounding or OpenCV's approximate distances do. onnxruntime reads the input of a network from an OpenGL buffer, and
writes its output into others, which CUDA maps (``readback.cuda``).
"""

from __future__ import annotations

import logging
from collections.abc import Callable, Mapping, Sequence
from functools import cached_property
from typing import Any

import moderngl
import numpy as np

from gibson_sim.errors import GraphicsUnavailableError, RenderError
from gibson_sim.filling.fillers import PushPull
from gibson_sim.filling.holes import Filler
from gibson_sim.filling.inputs import CHANNELS
from gibson_sim.filling.network import FADE_PX, MULTIPLE, GibsonNetwork
from gibson_sim.render.context import GlContext, gl as GL
from gibson_sim.render.draw.screen_pass import shader_text
from gibson_sim.render.draw.target import RenderTarget
from gibson_sim.render.readback.cuda import DLPACK_CUDA, CudaDriver, CudaLink, cuda_of
from gibson_sim.render.readback.frames import RAW_FORMATS, TargetImage
from gibson_sim.render.readback.pixel_buffers import GlBuffer

_log = logging.getLogger(__name__)
Level = tuple[int, tuple[int, int]]
"""First element of a level of the pyramid, and its width and height."""
_GROUP = 8
"""Width and height of a work group."""
_FADE_LIMIT_PX = int(8.0 * FADE_PX)
"""Distance from holes, pixels, beyond which a correction is below half a step of 255."""
_BUFFERS = ("codes", "pyramid", "input", "image", "inverse", "distances", "depth", "flags")
"""Buffers by their binding in the shaders."""
_SHARED = ("input", "image", "inverse")
"""Buffers that networks read and write."""
_STORED = {"color": GL.RGBA8UI, "NORMALS": GL.RGBA16UI}
"""Format of the views of textures that OpenGL would otherwise decode."""


class GpuFilling:
    """Fills holes on the GPU.

    Args:
        context: it must be current in every call.
        cuda: returns the CUDA functions of the context, or None if CUDA is not available; called once, for the first network.
    """

    def __init__(self, context: GlContext, cuda: Callable[[GlContext], CudaDriver | None] = cuda_of) -> None:
        self._context, self._cuda = context, cuda
        self._gl = GL.Gl(context)
        self._checked = False
        self._shaders: dict[tuple[str, tuple[str, ...]], moderngl.ComputeShader] = {}
        self._buffers: dict[str, GlBuffer] = {}

    @cached_property
    def _limit(self) -> int:
        """Maximum size of a buffer, bytes; read at the first image, since it is 0 without a current context."""
        return self._gl.integer(GL.MAX_SHADER_STORAGE_BLOCK_SIZE)

    @cached_property
    def _link(self) -> CudaLink | None:
        try:
            driver = self._cuda(self._context)
            return None if driver is None else CudaLink(self._context, driver)
        except GraphicsUnavailableError as error:
            _log.warning("hole-filling networks are run on copies of the images in host memory: %s", error)
            return None

    @property
    def cuda_device(self) -> int:
        """CUDA device ordinal of the GPU; 0 without CUDA."""
        return 0 if self._link is None else self._link.device.ordinal

    def runs(self, filler: Filler) -> bool:
        """Returns whether the GPU runs a filler: push-pull, or a network of ours on CUDA."""
        if isinstance(filler, GibsonNetwork) and self._link is not None:
            return filler.device == ("cuda" if self._link.driver.dlpack_type == DLPACK_CUDA else "cpu")
        return isinstance(filler, PushPull)

    def can_fill(self, filler: Filler, image: TargetImage) -> bool:
        """Returns whether the GPU runs the filler, and the image is not too large for its buffers."""
        width, height = _canvas(image)
        largest = max(16 * -(-width * height * 3 // 2), 4 * CHANNELS * _padded(width) * _padded(height))
        return largest <= self._limit and self.runs(filler)

    def fill(
        self, target: RenderTarget, image: TargetImage, filler: Filler, *, colours: bool, with_depth: bool, average: int | None
    ) -> None:
        """Fills the holes of an image; see ``HoleFilling.fill``.

        Args:
            target: target with the image and the feature ``NORMALS``, without multisampling.
            image: the image to fill.
            filler: a filler for which ``can_fill`` returns True.
            colours: fill colours.
            with_depth: fill depth.
            average: OpenGL name of a texture, as large as the image, whose alpha is above 0 where colours are an average with those of
                holes; None = the colours are not an average.

        Raises:
            ConfigError: the network cannot be run.
            RenderError: the driver rejects the passes, or does not have enough memory.
        """
        network = filler if isinstance(filler, GibsonNetwork) else None
        if not self._checked:
            self._gl.glGetError()
        views = {name: self._gl.view(target.textures[name], number) for name, number in _STORED.items()}
        try:
            work = _Work(self, target, image, network, views)
            # Depth is never an average: its holes are those of the image alone. Networks see the image as it was drawn, so nothing is
            # written to it before the last of them has run.
            apart = with_depth and (average is not None or not colours)
            if apart:
                work.compute(None)
                work.compute_depth()
            if colours:
                work.compute(average)
                work.write_colours()
            if with_depth:
                if not apart:
                    work.compute_depth()
                work.write_depth()
            self._check()
        finally:
            for view in views.values():
                self._gl.delete("glDeleteTextures", view)

    def _check(self) -> None:
        """Raises an error if the driver has rejected a call; only at the first image: glGetError makes some drivers wait."""
        error = 0 if self._checked else self._gl.glGetError()
        if error:
            raise RenderError(f"{self._context.device.renderer} cannot fill holes (error 0x{error:x}); update its driver")
        self._checked = True

    def shader(self, name: str, *defines: str) -> moderngl.ComputeShader:
        """Returns a compute pass, compiled at the first call."""
        key = (name, defines)
        if key not in self._shaders:
            self._shaders[key] = self._context.gl.compute_shader(shader_text(f"{name}.comp", defines, ("fill.glsl",)))
        return self._shaders[key]

    def reserve(self, name: str, nbytes: int) -> GlBuffer:
        """Returns a buffer of at least a size."""
        buffer = self._buffers.get(name)
        if buffer is None or buffer.size < nbytes:
            self._free(name)
            buffer = self._buffers[name] = GlBuffer(self._context, nbytes, GL.DYNAMIC_COPY)
        return buffer

    def dispatch(self, shader: moderngl.ComputeShader, size: tuple[int, int], uniforms: Mapping[str, Any]) -> None:
        """Runs a pass for each pixel of a size; later passes see what it writes."""
        for binding, name in enumerate(_BUFFERS):
            buffer = self._buffers.get(name)
            self._gl.glBindBufferBase(GL.SHADER_STORAGE_BUFFER, binding, 0 if buffer is None else buffer.name)
        for name, value in uniforms.items():
            if name in shader:  # the compiler removes unused uniforms
                shader[name] = value
        shader.run(-(-size[0] // _GROUP), -(-size[1] // _GROUP))
        self._gl.glMemoryBarrier(GL.ALL_BARRIERS)

    def run_network(self, network: GibsonNetwork, size: tuple[int, int]) -> None:
        """Runs a network on the shared buffers; for the size see ``GibsonNetwork.run_on_device``."""
        assert self._link is not None
        names = _SHARED if network.has_depth else _SHARED[:2]
        with self._link.mapped([self._buffers[name] for name in names]) as addresses:
            input_, image, *inverse = addresses
            network.run_on_device(self.cuda_device, size, input_, image, inverse[0] if inverse else None)

    def is_flagged(self) -> bool:
        """Returns whether a pass has found a value that is not finite."""
        flag = np.zeros(1, dtype=np.uint32)
        self._gl.glGetNamedBufferSubData(self._buffers["flags"].name, 0, flag.nbytes, flag.ctypes.data)
        return bool(flag[0])

    def upload_depth(self, target: RenderTarget, image: TargetImage) -> None:
        """Copies the buffer ``depth`` to the image, within the GPU."""
        gl, raw, camera = self._gl, RAW_FORMATS["depth"], image.camera
        gl.glPixelStorei(GL.UNPACK_ALIGNMENT, 1)
        gl.glBindBuffer(GL.PIXEL_UNPACK_BUFFER, self._buffers["depth"].name)
        gl.glTextureSubImage2D(
            target.textures["depth"], 0, image.x, image.y, camera.width, camera.height, raw.gl_format, raw.gl_type, None
        )  # fmt: skip
        gl.glBindBuffer(GL.PIXEL_UNPACK_BUFFER, 0)

    def _free(self, name: str) -> None:
        buffer = self._buffers.pop(name, None)
        if buffer is not None:
            if name in _SHARED and self._link is not None:
                self._link.forget(buffer)
            buffer.close()

    def close(self) -> None:
        """Frees all GPU resources; a second call does nothing. The context must be current."""
        for name in list(self._buffers):
            self._free(name)
        link: CudaLink | None = self.__dict__.pop("_link", None)  # absent if no network was run
        if link is not None:
            link.close()
        while self._shaders:
            self._shaders.popitem()[1].release()


class _Work:
    """The passes over one image."""

    def __init__(
        self, owner: GpuFilling, target: RenderTarget, image: TargetImage, network: GibsonNetwork | None, views: Mapping[str, int]
    ) -> None:
        self._owner, self._target, self._image, self._network, self._views = owner, target, image, network, views
        self._gl = owner._gl
        camera = image.camera
        self._canvas = _canvas(image)
        self._padded = (_padded(self._canvas[0]), _padded(self._canvas[1]))
        self._levels = levels_of(*self._canvas)
        last = self._levels[-1][0]
        self._defines = () if network is None else ("NETWORK",)
        self._uniforms: dict[str, Any] = {
            "u_rect": (image.x, image.y, camera.width, camera.height),
            "u_turn": (self._canvas[0] - camera.width) // 2,
            "u_near": camera.near,
            "u_far": camera.far,
            "u_last": last,
            "u_padded": self._padded,
            "u_fade_limit_px": _FADE_LIMIT_PX,
            "u_fade_px": FADE_PX,
            "u_has_lens": camera.projection != "pinhole" or bool(camera.distortion),
            "u_blended": camera.samples > 1 or camera.projection != "pinhole" or bool(camera.distortion),
        }
        pixels = self._canvas[0] * self._canvas[1]
        owner.reserve("codes", 4 * pixels)
        owner.reserve("pyramid", 16 * (last + 1))
        owner.reserve("depth", 4 * self._size[0] * self._size[1])
        owner.reserve("flags", 4).write(np.zeros(1, dtype=np.uint32))
        if network is not None:
            plane = 4 * self._padded[0] * self._padded[1]
            owner.reserve("distances", 4 * pixels)
            owner.reserve("input", CHANNELS * plane)
            owner.reserve("image", 3 * plane)
            if network.has_depth:
                owner.reserve("inverse", plane)

    def compute(self, average: int | None) -> None:
        """Finds the holes, fills the colours by push-pull in the pyramid, and runs the network on them if there is one."""
        self._push_pull(average, of_depth=False)
        if self._network is not None:
            self._dispatch(("fill_input",), self._padded)
            self._owner.run_network(self._network, self._padded)

    def write_colours(self) -> None:
        """Writes colours to the target."""
        if self._network is not None:
            self._dispatch(("fill_distance",), self._canvas)
        self._gl.glBindImageTexture(0, self._views["color"], 0, 0, 0, GL.READ_WRITE, GL.RGBA8UI)
        self._dispatch(("fill_color", *self._defines), self._size)
        self._check()

    def compute_depth(self) -> None:
        """Writes filled depth to the buffer ``depth``."""
        self._push_pull(None, of_depth=True)
        by_network = self._network is not None and self._network.has_depth
        self._dispatch(("fill_depth", *(self._defines if by_network else ())), self._size)
        self._check()

    def write_depth(self) -> None:
        """Writes depth to the target."""
        self._owner.upload_depth(self._target, self._image)

    @property
    def _size(self) -> tuple[int, int]:
        return self._image.camera.width, self._image.camera.height

    def _push_pull(self, average: int | None, *, of_depth: bool) -> None:
        self._dispatch(("fill_pixels",), self._canvas, average, u_blurred=average is not None, u_of_depth=of_depth)
        pairs = list(zip(self._levels, self._levels[1:], strict=False))
        for fine, coarse in pairs:
            self._dispatch(("fill_pyramid", "PULL"), coarse[1], **_level_uniforms(fine, coarse))
        for fine, coarse in reversed(pairs):
            self._dispatch(("fill_pyramid",), fine[1], **_level_uniforms(fine, coarse))

    def _dispatch(self, shader: Sequence[str], size: tuple[int, int], average: int | None = None, **uniforms: Any) -> None:
        textures = (self._views["color"], self._target.textures["depth"], self._views["NORMALS"], average or 0)
        for unit, texture in enumerate(textures):
            self._gl.glBindSampler(unit, 0)
            self._gl.glBindTextureUnit(unit, texture)
        self._owner.dispatch(self._owner.shader(*shader), size, {**self._uniforms, **uniforms})

    def _check(self) -> None:
        if self._network is not None and self._owner.is_flagged():
            raise self._network.not_finite()


def levels_of(width: int, height: int) -> list[Level]:
    """Returns the levels of the pyramid of a canvas: each half the size of the finer one, rounded up, down to one pixel."""
    levels: list[Level] = [(0, (width, height))]
    while levels[-1][1] != (1, 1):
        first, (width, height) = levels[-1]
        levels.append((first + width * height, (-(-width // 2), -(-height // 2))))
    return levels


def _level_uniforms(fine: Level, coarse: Level) -> dict[str, Any]:
    return {"u_fine": fine[0], "u_fine_size": fine[1], "u_coarse": coarse[0], "u_coarse_size": coarse[1]}


def _canvas(image: TargetImage) -> tuple[int, int]:
    """Returns width and height of the image; of a panorama with half a turn more at its left and its right edge."""
    camera = image.camera
    turn = camera.width // 2 if camera.projection == "equirectangular" else 0
    return camera.width + 2 * turn, camera.height


def _padded(size: int) -> int:
    return -(-size // MULTIPLE) * MULTIPLE
