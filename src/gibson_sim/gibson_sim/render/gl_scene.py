"""A scene in GPU memory, and the drawing of it: the one place where the optical frame becomes OpenGL's clip space."""

from __future__ import annotations

import ctypes
from dataclasses import dataclass
from importlib.resources import files
from itertools import groupby
from typing import Any

import cv2
import moderngl
import numpy as np
from numpy.typing import NDArray

from gibson_sim.geometry.projections import clip_from_optical, frustum_planes
from gibson_sim.geometry.transforms import Mat4
from gibson_sim.render.batches import Batch, Batches, linear_from_srgb, visible_chunks
from gibson_sim.render.context import GlContext
from gibson_sim.render.readback import ATTACHMENT, Feature, features_of
from gibson_sim.scenes.mesh_types import TextureSource
from gibson_sim.scenes.spec import LightSpec
from gibson_sim.types import CameraSpec

MAX_TEXTURE = 4096
"""Longest side of a texture, pixels; larger images are made smaller."""
OPAQUE, CUT = 0, 1
"""The two programs: without and with the test of alpha, which costs time even where nothing is transparent."""

_SRGB8_ALPHA8, _FRAMEBUFFER_SRGB, _PRIMITIVE_RESTART = 0x8C43, 0x8DB9, 0x8F9D
_LOWER_LEFT, _ZERO_TO_ONE, _GREATER, _TRIANGLES, _UNSIGNED_INT = 0x8CA1, 0x935F, 0x0204, 0x0004, 0x1405
_COLOR, _DEPTH = 0x1800, 0x1801
_DEPTH_TEST, _CULL_FACE, _BLEND, _SRC_ALPHA, _ONE_MINUS_SRC_ALPHA = 0x0B71, 0x0B44, 0x0BE2, 0x0302, 0x0303
_VERTEX_FORMAT = "3f 3f 2f 4f2 4f1 2u2"
_VERTEX_NAMES = ("in_position", "in_normal", "in_uv", "in_color", "in_surface", "in_label")


def _shader(name: str) -> str:
    return files("gibson_sim.render").joinpath("shaders", name).read_text(encoding="utf-8")


class GlScene:
    """Batches on the GPU.

    Args:
        context: where; it must be current in every call.
        batches: what.
        light: how surfaces are lit, and the background.
        cull: leave out what is outside the image; off only to check that nothing else changes.
    """

    def __init__(self, context: GlContext, batches: Batches, light: LightSpec, *, cull: bool = True) -> None:
        gl = context.gl
        self._batches = batches
        self._cull = cull
        self._gl: moderngl.Context = gl
        self._light = light
        self._passes: dict[tuple[Feature, ...], _Pass] = {}
        self._load_functions(context)
        # An empty buffer is an error; one vertex and one index that no chunk names are not.
        self._vertex_buffer = gl.buffer(batches.vertices.tobytes() or bytes(batches.vertices.dtype.itemsize))
        self._index_buffer = gl.buffer(batches.indices.tobytes() or bytes(4))
        self.texture_bytes = 0
        self.textures = [self._upload(gl, t) for t in batches.textures]
        white = TextureSource("", np.full((1, 1, 4), 255, dtype=np.uint8))
        self.textures.append(self._upload(gl, white))  # number -1
        to_sun = -np.asarray(light.sun_direction, dtype=np.float64)
        self._to_sun = to_sun / max(float(np.linalg.norm(to_sun)), 1e-12)
        self._background = [linear_from_srgb(c) for c in light.background]
        self._pass(())  # the usual shaders now, so that the first image does not wait for them

    def _pass(self, features: tuple[Feature, ...]) -> _Pass:
        """Returns the programs that fill these further outputs; makes them at their first use."""
        if features not in self._passes:
            defines = "".join(f"#define {name}\n" for name in features)
            programs = []
            for cut in ("", "#define CUT\n"):
                vertex, fragment = (f"#version 330 core\n{defines}{cut}{_shader(f'scene.{kind}')}" for kind in ("vert", "frag"))
                programs.append(self._gl.program(vertex_shader=vertex, fragment_shader=fragment))
                programs[-1]["u_sun"] = self._light.sun
                programs[-1]["u_ambient"] = self._light.ambient
                programs[-1]["u_texture"] = 0
            content = [(self._vertex_buffer, _VERTEX_FORMAT, *_VERTEX_NAMES)]
            arrays = [self._gl.vertex_array(p, content, self._index_buffer, skip_errors=True) for p in programs]
            self._passes[features] = _Pass(features, tuple(programs), tuple(arrays))
        return self._passes[features]

    def _load_functions(self, context: GlContext) -> None:
        u, i, p = ctypes.c_uint, ctypes.c_int, ctypes.c_void_p
        load = context.egl.function
        self._clip_control = load("glClipControl", None, u, u)
        self._enable = load("glEnable", None, u)
        self._disable = load("glDisable", None, u)
        self._depth_func = load("glDepthFunc", None, u)
        self._depth_mask = load("glDepthMask", None, ctypes.c_ubyte)
        self._blend_func = load("glBlendFunc", None, u, u)
        self._clear_floats = load("glClearBufferfv", None, u, i, p)
        self._clear_integers = load("glClearBufferuiv", None, u, i, p)
        self._color_mask = load("glColorMaski", None, u, *[ctypes.c_ubyte] * 4)
        self._use_program = load("glUseProgram", None, u)
        self._bind_vertex_array = load("glBindVertexArray", None, u)
        # ModernGL has no call that draws many pieces of one index buffer at once from host memory.
        self._multi_draw = load("glMultiDrawElements", None, u, p, u, p, i)

    def _upload(self, gl: moderngl.Context, source: TextureSource) -> moderngl.Texture:
        pixels = source.pixels
        height, width = pixels.shape[:2]
        shrink = MAX_TEXTURE / max(height, width)
        if shrink < 1.0:
            width, height = max(1, round(width * shrink)), max(1, round(height * shrink))
            pixels = np.asarray(cv2.resize(pixels, (width, height), interpolation=cv2.INTER_AREA), dtype=np.uint8)
        if pixels.shape[2] == 3:
            pixels = np.asarray(cv2.cvtColor(pixels, cv2.COLOR_RGB2RGBA), dtype=np.uint8)
        # Row 0 goes where t = 0 is, so v counts downwards from the top row, as MeshPart has it.
        texture = gl.texture((width, height), 4, np.ascontiguousarray(pixels).tobytes(), internal_format=_SRGB8_ALPHA8)
        texture.build_mipmaps()
        texture.filter = (moderngl.LINEAR_MIPMAP_LINEAR, moderngl.LINEAR)
        self.texture_bytes += width * height * 4 * 4 // 3
        return texture

    def draw(self, camera: CameraSpec, T_world_camera: Mat4, T_world_links: NDArray[np.float64]) -> None:
        """Draws what a camera sees into the framebuffer that is bound, with an attachment for each output of the camera.

        Args:
            camera: size, intrinsics, near.
            T_world_camera: (4, 4), optical frame.
            T_world_links: (L + 1, 4, 4): the identity for the world itself, then every link.
        """
        passes = self._pass(features_of(camera.outputs))
        self._begin(passes.features)
        if not self._batches.batches:
            return
        intrinsics = camera.intrinsics()
        R, t = T_world_camera[:3, :3], T_world_camera[:3, 3]
        T_camera_links = np.zeros_like(T_world_links)
        T_camera_links[:, :3] = R.T @ T_world_links[:, :3]
        T_camera_links[:, :3, 3] -= R.T @ t
        T_camera_links[:, 3, 3] = 1.0
        rotations = T_world_links[:, :3, :3]
        eyes = np.einsum("lji,lj->li", rotations, t - T_world_links[:, :3, 3])
        planes = frustum_planes(intrinsics, camera.width, camera.height, camera.near)
        visible, distance = visible_chunks(self._batches, planes, T_camera_links, eyes)
        # The flip: optical y points down and clip y points up, so row 0 of the image comes first in OpenGL's bottom-up memory.
        clip_from_links = clip_from_optical(intrinsics, camera.width, camera.height, camera.near) @ T_camera_links
        frames = _LinkFrames(
            clip_from_links, eyes, np.einsum("lji,j->li", rotations, self._to_sun), rotations[:, 2, :], R.T @ rotations
        )
        self._draw_chunks(visible, distance, _Drawer(self, passes, frames))

    def _begin(self, features: tuple[Feature, ...]) -> None:
        self._clip_control(_LOWER_LEFT, _ZERO_TO_ONE)
        self._enable(_DEPTH_TEST)
        self._enable(_FRAMEBUFFER_SRGB)
        for state in (_CULL_FACE, _BLEND, _PRIMITIVE_RESTART):
            self._disable(state)
        self._depth_func(_GREATER)
        self._depth_mask(1)
        nothing = np.zeros(4, dtype=np.float32)
        self._clear_floats(_DEPTH, 0, nothing.ctypes.data)
        self._clear_floats(_COLOR, 0, np.array([*self._background, 1.0], dtype=np.float32).ctypes.data)
        for feature in features:
            clear = self._clear_integers if feature == "LABELS" else self._clear_floats
            clear(_COLOR, ATTACHMENT[feature], nothing.ctypes.data)

    def _draw_chunks(self, visible: NDArray[np.bool_], distance: NDArray[np.float64], drawer: _Drawer) -> None:
        """Draws solid things front to back, then what shines through, back to front and without depth."""
        batches = self._batches.batches
        # The order does not depend on what is visible, so culling cannot change a pixel.
        nearest = np.minimum.reduceat(distance, [b.first_chunk for b in batches])
        order = [batches[i] for i in np.argsort(nearest, kind="stable")]
        for kinds, variant in ((("opaque",), OPAQUE), (("mask", "blend"), CUT)):
            for batch in order:
                if batch.kind in kinds:
                    chunks = np.arange(batch.first_chunk, batch.end_chunk)
                    chunks = chunks[np.argsort(distance[chunks], kind="stable")]
                    drawer.draw(batch, chunks[visible[chunks]] if self._cull else chunks, variant)
        if any(batch.kind == "blend" for batch in batches):
            self._draw_translucent(visible, distance, drawer)

    def _draw_translucent(self, visible: NDArray[np.bool_], distance: NDArray[np.float64], drawer: _Drawer) -> None:
        pieces = [
            (chunk, batch)
            for batch in self._batches.batches
            if batch.kind == "blend"
            for chunk in range(batch.first_chunk, batch.end_chunk)
        ]
        pieces = [p for p in pieces if visible[p[0]] or not self._cull]
        self._enable(_BLEND)
        self._blend_func(_SRC_ALPHA, _ONE_MINUS_SRC_ALPHA)
        self._depth_mask(0)
        self._mask_features(drawer.features, 0)  # labels and normals are those of the solid surface behind, as the depth is
        drawer.set_translucent(True)
        pieces.sort(key=lambda p: -float(distance[p[0]]))
        for batch, run in groupby(pieces, key=lambda p: p[1]):
            drawer.draw(batch, np.array([chunk for chunk, _ in run]), CUT)
        self._depth_mask(1)
        self._mask_features(drawer.features, 1)
        self._disable(_BLEND)

    def _mask_features(self, features: tuple[Feature, ...], write: int) -> None:
        for feature in features:
            self._color_mask(ATTACHMENT[feature], write, write, write, write)

    def draw_elements(self, passes: _Pass, variant: int, chunks: NDArray[np.int64]) -> None:
        """Draws chunks with what is set."""
        counts = np.ascontiguousarray(self._batches.chunk_count[chunks])
        offsets = self._batches.chunk_first[chunks].astype(np.uintp) * self._batches.indices.itemsize
        self._use_program(passes.programs[variant].glo)
        self._bind_vertex_array(passes.arrays[variant].glo)
        self._multi_draw(_TRIANGLES, counts.ctypes.data, _UNSIGNED_INT, offsets.ctypes.data, len(chunks))

    def close(self) -> None:
        """Frees everything; a second call does nothing."""
        arrays = [a for p in self._passes.values() for a in p.arrays]
        programs = [program for p in self._passes.values() for program in p.programs]
        handles: tuple[Any, ...] = (*arrays, self._vertex_buffer, self._index_buffer, *self.textures, *programs)
        self._passes, self.textures = {}, []
        for handle in handles:
            handle.release()


@dataclass(frozen=True, slots=True)
class _Pass:
    """The two programs that fill one set of outputs, and the vertex arrays that feed them."""

    features: tuple[Feature, ...]
    programs: tuple[moderngl.Program, ...]
    arrays: tuple[moderngl.VertexArray, ...]


class _LinkFrames:
    """What the shaders need to know of each link, ready to be sent."""

    def __init__(
        self,
        clip: NDArray[np.float64],
        eyes: NDArray[np.float64],
        to_sun: NDArray[np.float64],
        up: NDArray[np.float64],
        optical: NDArray[np.float64],
    ) -> None:
        self.clip = np.ascontiguousarray(clip.transpose(0, 2, 1), dtype=np.float32)  # OpenGL takes columns
        self.optical = np.ascontiguousarray(optical.transpose(0, 2, 1), dtype=np.float32)
        self.vectors = {"u_eye": eyes.astype(np.float32), "u_to_sun": to_sun.astype(np.float32), "u_up": up.astype(np.float32)}


class _Drawer:
    """Sends draw calls for one image, and remembers what is set already."""

    def __init__(self, scene: GlScene, passes: _Pass, frames: _LinkFrames) -> None:
        self._scene, self._passes, self._frames = scene, passes, frames
        self.features = passes.features
        self._texture: int | None = None
        self._link_of: list[int | None] = [None, None]
        self.set_translucent(False)

    def set_translucent(self, translucent: bool) -> None:
        """Chooses which part of masked and blended surfaces is drawn: the solid one, or the one that shines through."""
        self._passes.programs[CUT]["u_translucent"] = translucent

    def draw(self, batch: Batch, chunks: NDArray[np.int64], variant: int) -> None:
        """Draws chunks of a batch with one of the two programs."""
        if not len(chunks):
            return
        scene, program = self._scene, self._passes.programs[variant]
        if self._link_of[variant] != batch.link:
            self._link_of[variant] = batch.link
            program["u_clip_from_link"].write(self._frames.clip[batch.link])  # type: ignore[union-attr]
            for name, vectors in self._frames.vectors.items():
                program[name].write(vectors[batch.link])  # type: ignore[union-attr]
            if "NORMALS" in self.features:
                program["u_optical_from_link"].write(self._frames.optical[batch.link])  # type: ignore[union-attr]
        if self._texture != batch.texture:
            self._texture = batch.texture
            scene.textures[batch.texture].use(0)
        scene.draw_elements(self._passes, variant, chunks)
