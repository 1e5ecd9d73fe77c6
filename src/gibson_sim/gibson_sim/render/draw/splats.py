"""Draws Gaussian splats over pictures of the mesh.

The depth of the mesh, moved back a little, and the unchanged depth of moving bodies occlude splats. Potentially visible splats are sorted
on the CPU, projected on the GPU, and blended into a separate layer in single precision, which is then composited over the picture of the
mesh. OpenGL blends from far to near; with a software renderer the loops of ``splat_raster`` do it in less than half the time. All blending
is done in sRGB, as in training. Only colours change.
"""

from __future__ import annotations

from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from typing import Any

import moderngl
import numpy as np
from numpy.typing import NDArray

from gibson_sim.formats.splats import Splats
from gibson_sim.geometry.compiling import CAN_COMPILE, fixed
from gibson_sim.geometry.transforms import Mat4
from gibson_sim.render.context import GlContext, gl as GL
from gibson_sim.render.context.cores import drawing_threads
from gibson_sim.render.culling.draw_plan import PinholePicture
from gibson_sim.render.culling.splat_chunks import SplatChunks, projected_limits
from gibson_sim.render.draw.gl_scene import GlScene
from gibson_sim.render.draw.screen_pass import FULL_SCREEN, shader_text
from gibson_sim.render.draw.splat_contacts import SplatContacts
from gibson_sim.render.draw.splat_raster import COLUMNS, blend_tiles, place_in_tiles
from gibson_sim.render.draw.target import RenderTarget

F32 = NDArray[np.float32]
TOLERANCE_M = 0.06
"""Distance behind the mesh, along its normal, beyond which splats are hidden, metres."""
_FARTHEST_M = 0.5
"""Upper limit of that distance measured along the ray, metres."""
_SPLAT_VIEW = np.dtype(
    [
        ("optical", "<f4", (4, 4)), ("eye", "<f4", 4), ("lens", "<f4", 4), ("limits", "<f4", 4), ("place", "<f4", 4),
        ("file", "<f4", (3, 4)), ("first", "<u4"), ("count", "<u4"), ("skew", "<f4"), ("pad", "<f4", 17),
    ]
)  # fmt: skip
"""Uniform block ``SplatView``, column-major matrices, padded to the alignment of uniform buffers."""
_VIEW_BINDING = 1
_PROJECTED_BYTES = 64
_GROUP = 64
_MAX_LAYERS = 4
_NOTHING = np.zeros(4, dtype=np.float32)


class SplatPass:
    """The splats of a scene on the GPU.

    Args:
        context: it must be current in every call.
        splats: splats in the frame of their file.
        T_world_file: (4, 4), a rigid transform times a scale.
        cull: frustum and occlusion culling; False only to verify that culling changes no image.
    """

    def __init__(self, context: GlContext, splats: Splats, T_world_file: Mat4, *, cull: bool = True) -> None:
        self._context, self._gl, self._cull = context, GL.Gl(context), cull
        self._chunks = SplatChunks(splats, T_world_file)
        self._occlusion = cull and context.device.software
        self._loops = CAN_COMPILE and context.device.software
        self._threads: ThreadPoolExecutor | None = None
        self._thread_count = max(len(drawing_threads()), 1) if self._loops else 1
        self._layers: dict[tuple[int, int], _Layer] = {}
        self._programs: list[Any] = []
        self._contacts: SplatContacts | None = None
        self._buffers: list[int] = []
        self._arrays: list[int] = []
        self.drawn = 0
        """Number of splats drawn by the last call of ``draw``."""
        try:
            self._create(splats.degree)
        except BaseException:
            self.close()
            raise

    def _create(self, degree: int) -> None:
        gl, ctx = self._gl, self._context.gl
        self._buffers = [gl.create("glCreateBuffers") for _ in range(5)]
        self._bodies, self._harmonics, self._order, self._projected, self._views = self._buffers
        chunks = self._chunks
        bodies = np.zeros((max(len(chunks), 1), 12), dtype=np.float32)
        bodies[: len(chunks), :3], bodies[: len(chunks), 3] = chunks.positions, chunks.opacities
        bodies[: len(chunks), 4:10] = chunks.covariances
        harmonics = np.ascontiguousarray(chunks.sh) if len(chunks) else np.zeros(48, dtype=np.float32)
        for buffer, data in ((self._bodies, bodies), (self._harmonics, harmonics)):
            gl.glNamedBufferData(buffer, data.nbytes, data.ctypes.data, GL.STATIC_DRAW)
        self._projected_size = 0
        self._compute = ctx.compute_shader(shader_text("splats.comp", (f"SH_DEGREE {degree}",), ("splat_view.glsl",)))
        self._programs.append(self._compute)
        self._depth = self._screen("splat_depth.frag", ("splat_view.glsl", "splat_surface.glsl"), "u_depth")
        self._contacts = SplatContacts(self._context)
        self._blend = self._screen("splat_blend.frag", (), "u_splats")
        self._splat = ctx.program(vertex_shader=shader_text("splats.vert"), fragment_shader=shader_text("splats.frag"))
        self._programs.append(self._splat)
        self._arrays = [gl.create("glCreateVertexArrays") for _ in range(2)]
        self._array, self._empty_array = self._arrays
        for location in range(4):
            gl.glVertexArrayAttribFormat(self._array, location, 4, GL.FLOAT, 0, 16 * location)
            gl.glVertexArrayAttribBinding(self._array, location, 0)
            gl.glEnableVertexArrayAttrib(self._array, location)
        gl.glVertexArrayBindingDivisor(self._array, 0, 1)

    def _screen(self, fragment: str, includes: tuple[str, ...], sampler: str) -> moderngl.Program:
        defines = (f"TOLERANCE {TOLERANCE_M:.6f}", f"FARTHEST {_FARTHEST_M:.6f}")
        program = self._context.gl.program(vertex_shader=FULL_SCREEN, fragment_shader=shader_text(fragment, defines, includes))
        program[sampler] = 0
        self._programs.append(program)
        return program

    def draw(self, scene: GlScene, target: RenderTarget, pictures: Sequence[PinholePicture]) -> None:
        """Draws the splats over pictures that ``scene`` has just drawn into ``target``, which has one sample per pixel."""
        self.drawn = 0
        if not pictures or not len(self._chunks):
            return
        gl, layer = self._gl, self._layer(target.width, target.height)
        views = np.concatenate([_view(picture, self._chunks.R_world_file) for picture in pictures])
        self._upload(self._views, views)
        self._fill_depth(scene, target, layer, pictures)
        depth = layer.read_depth() if self._occlusion or self._loops else None
        occluders = depth if self._occlusion else None
        orders = [self._chunks.select(p, None if occluders is None else p.crop(occluders), cull=self._cull) for p in pictures]
        counts = [len(order) for order in orders]
        views["count"], views["first"] = counts, np.cumsum([0, *counts[:-1]])
        self.drawn = sum(counts)
        if not self.drawn:
            return
        self._upload(self._views, views)
        self._upload(self._order, np.concatenate(orders))
        self._project(counts)
        if self._loops and depth is not None:
            self._blend_by_loops(layer, pictures, counts, depth)
        else:
            gl.glBindFramebuffer(GL.FRAMEBUFFER, layer.framebuffer)
            gl.glClearBufferfv(GL.COLOR, 0, _NOTHING.ctypes.data)
            self._blend_splats(pictures, counts)
        gl.glBindVertexArray(self._empty_array)
        textures = (target.textures["depth"], layer.depth)
        assert self._contacts is not None
        self._contacts.darken(*scene.link_boxes(), pictures, textures, layer.framebuffer, self._bind_picture)
        self._composite(target, layer, pictures)

    def _layer(self, width: int, height: int) -> _Layer:
        layer = self._layers.pop((width, height), None)
        if layer is None:
            if len(self._layers) >= _MAX_LAYERS:
                self._layers.pop(next(iter(self._layers))).close()  # the least recently used
            layer = _Layer(self._gl, width, height)
        self._layers[width, height] = layer
        return layer

    def _fill_depth(self, scene: GlScene, target: RenderTarget, layer: _Layer, pictures: Sequence[PinholePicture]) -> None:
        """Fills the depth of the occluders of splats: the mesh, moved back, and moving links."""
        gl = self._gl
        gl.glBindFramebuffer(GL.FRAMEBUFFER, layer.depth_framebuffer)
        for state in (GL.BLEND, GL.CULL_FACE, GL.SCISSOR_TEST):
            gl.glDisable(state)
        gl.glClipControl(GL.LOWER_LEFT, GL.ZERO_TO_ONE)
        gl.glEnable(GL.DEPTH_TEST)
        gl.glDepthFunc(GL.ALWAYS)
        gl.glDepthMask(1)
        gl.glBindSampler(0, 0)
        gl.glBindTextureUnit(0, target.textures["depth"])
        gl.glUseProgram(self._depth.glo)
        gl.glBindVertexArray(self._empty_array)
        for number, picture in enumerate(pictures):
            self._bind_picture(picture, number)
            gl.glDrawArrays(GL.TRIANGLES, 0, 3)
        scene.draw_moving_depth(pictures)

    def _bind_picture(self, picture: PinholePicture, number: int) -> None:
        self._gl.glViewport(picture.x, picture.y, picture.width, picture.height)
        self._bind_view(number)

    def _bind_view(self, number: int) -> None:
        size = _SPLAT_VIEW.itemsize
        self._gl.glBindBufferRange(GL.UNIFORM_BUFFER, _VIEW_BINDING, self._views, number * size, size)

    def _project(self, counts: Sequence[int]) -> None:
        """Projects the splats of all pictures."""
        gl = self._gl
        needed = sum(counts) * _PROJECTED_BYTES
        if needed > self._projected_size:
            self._projected_size = needed * 3 // 2
            gl.glNamedBufferData(self._projected, self._projected_size, None, GL.STREAM_DRAW)
        for binding, buffer in enumerate((self._bodies, self._harmonics, self._order, self._projected)):
            gl.glBindBufferBase(GL.SHADER_STORAGE_BUFFER, binding, buffer)
        for number, count in enumerate(counts):
            if count:
                self._bind_view(number)
                self._compute.run(-(-count // _GROUP))
        gl.glMemoryBarrier(GL.ALL_BARRIERS)

    def _blend_splats(self, pictures: Sequence[PinholePicture], counts: Sequence[int]) -> None:
        """Blends the projected splats into the bound layer."""
        gl = self._gl
        gl.glDepthFunc(GL.GREATER)
        gl.glDepthMask(0)
        gl.glEnable(GL.DEPTH_TEST)
        gl.glEnable(GL.BLEND)
        gl.glBlendFunc(GL.ONE, GL.ONE_MINUS_SRC_ALPHA)
        gl.glUseProgram(self._splat.glo)
        gl.glBindVertexArray(self._array)
        first = 0
        for number, (picture, count) in enumerate(zip(pictures, counts, strict=True)):
            self._bind_picture(picture, number)
            gl.glVertexArrayVertexBuffer(self._array, 0, self._projected, first * _PROJECTED_BYTES, _PROJECTED_BYTES)
            gl.glDrawArraysInstanced(GL.TRIANGLE_STRIP, 0, 4, count)
            first += count

    def _blend_by_loops(self, layer: _Layer, pictures: Sequence[PinholePicture], counts: Sequence[int], depth: F32) -> None:
        """Blends the projected splats into the layer on the CPU."""
        gl = self._gl
        projected = np.empty((sum(counts), COLUMNS), dtype=np.float32)
        gl.glGetNamedBufferSubData(self._projected, 0, projected.nbytes, projected.ctypes.data)
        first = 0
        for picture, count in zip(pictures, counts, strict=True):
            out = np.zeros((picture.height, picture.width, 4), dtype=np.float32)
            if count:
                tiled = place_in_tiles(fixed(projected[first : first + count]), picture.width, picture.height)
                self._in_threads(*tiled, fixed(picture.crop(depth)), out)
            gl.glTextureSubImage2D(
                layer.color, 0, picture.x, picture.y, picture.width, picture.height, GL.RGBA, GL.FLOAT, out.ctypes.data
            )
            first += count

    def _in_threads(self, splats: F32, starts: NDArray[np.int64], listed: NDArray[np.int32], depth: F32, out: F32) -> None:
        """Calls ``blend_tiles`` in as many threads as the software renderer has; each blends a share of the tiles."""
        number = self._thread_count
        if number == 1:
            blend_tiles(splats, starts, listed, depth, out, 0, 1)
            return
        if self._threads is None:
            self._threads = ThreadPoolExecutor(number, thread_name_prefix="splats")
        for future in [self._threads.submit(blend_tiles, splats, starts, listed, depth, out, k, number) for k in range(number)]:
            future.result()

    def _composite(self, target: RenderTarget, layer: _Layer, pictures: Sequence[PinholePicture]) -> None:
        """Composites the layer over the colours of the target."""
        gl = self._gl
        gl.glBindFramebuffer(GL.FRAMEBUFFER, target.color_framebuffer)
        gl.glDisable(GL.DEPTH_TEST)
        gl.glEnable(GL.BLEND)
        gl.glBlendFunc(GL.ONE, GL.ONE_MINUS_SRC_ALPHA)
        gl.glDisable(GL.FRAMEBUFFER_SRGB)  # the bytes of the target are sRGB, and so are the splats
        gl.glBindTextureUnit(0, layer.color)
        gl.glUseProgram(self._blend.glo)
        gl.glBindVertexArray(self._empty_array)
        for number, picture in enumerate(pictures):
            self._bind_picture(picture, number)
            gl.glDrawArrays(GL.TRIANGLES, 0, 3)
        gl.glEnable(GL.FRAMEBUFFER_SRGB)
        gl.glEnable(GL.DEPTH_TEST)
        gl.glDisable(GL.BLEND)
        gl.glDepthMask(1)

    def _upload(self, buffer: int, data: NDArray[Any]) -> None:
        self._gl.glNamedBufferData(buffer, data.nbytes, data.ctypes.data, GL.STREAM_DRAW)

    def close(self) -> None:
        """Frees all GPU resources; a second call does nothing. The context must be current."""
        if self._threads is not None:
            self._threads.shutdown()
            self._threads = None
        layers, self._layers = self._layers, {}
        for layer in layers.values():
            layer.close()
        contacts, self._contacts = self._contacts, None
        if contacts is not None:
            contacts.close()
        while self._programs:
            self._programs.pop().release()
        while self._buffers:
            self._gl.delete("glDeleteBuffers", self._buffers.pop())
        arrays, self._arrays = self._arrays, []
        for array in arrays:
            self._gl.delete("glDeleteVertexArrays", array)


class _Layer:
    """A picture of splats in single precision, and the depth of their occluders."""

    def __init__(self, gl: GL.Gl, width: int, height: int) -> None:
        self._gl, self._width, self._height = gl, width, height
        self.color, self.depth = (self._texture(f) for f in (GL.RGBA32F, GL.DEPTH_COMPONENT32F))
        self.framebuffer, self.depth_framebuffer = (gl.create("glCreateFramebuffers") for _ in range(2))
        gl.glNamedFramebufferTexture(self.framebuffer, GL.COLOR_ATTACHMENT0, self.color, 0)
        for framebuffer in (self.framebuffer, self.depth_framebuffer):
            gl.glNamedFramebufferTexture(framebuffer, GL.DEPTH_ATTACHMENT, self.depth, 0)

    def _texture(self, internal_format: int) -> int:
        texture = self._gl.create("glCreateTextures", GL.TEXTURE_2D)
        self._gl.glTextureStorage2D(texture, 1, internal_format, self._width, self._height)
        for name in (GL.TEXTURE_MIN_FILTER, GL.TEXTURE_MAG_FILTER):
            self._gl.glTextureParameteri(texture, name, GL.NEAREST)
        return texture

    def read_depth(self) -> F32:
        """Returns the depth, ``near / depth``, (H, W); its framebuffer must be bound."""
        out = np.empty((self._height, self._width), dtype=np.float32)
        self._gl.glReadPixels(0, 0, self._width, self._height, GL.DEPTH_COMPONENT, GL.FLOAT, out.ctypes.data)
        return out

    def close(self) -> None:
        """Frees the framebuffers and textures."""
        for framebuffer in (self.framebuffer, self.depth_framebuffer):
            self._gl.delete("glDeleteFramebuffers", framebuffer)
        for texture in (self.color, self.depth):
            self._gl.delete("glDeleteTextures", texture)


def _view(picture: PinholePicture, R_world_file: NDArray[np.float64]) -> NDArray[np.void]:
    """Returns the uniforms of a picture, (1,) of ``_SPLAT_VIEW``, except for the range of its splats."""
    view, k = np.zeros(1, dtype=_SPLAT_VIEW), picture.intrinsics
    view["optical"][0] = np.linalg.inv(picture.T_world_camera).T
    view["eye"][0] = (*picture.T_world_camera[:3, 3], picture.near)
    view["lens"][0] = (k[0, 0], k[1, 1], k[0, 2], k[1, 2])
    low, high = projected_limits(k, picture.width, picture.height)
    view["limits"][0] = (*low, *high)
    view["place"][0] = (picture.width, picture.height, picture.x, picture.y)
    view["file"][0, :, :3] = R_world_file  # transposed twice: inverted, and stored column-major
    view["skew"] = k[0, 1]
    return view
