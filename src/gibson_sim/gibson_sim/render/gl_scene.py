"""A scene in GPU memory, and the drawing of it: the one place where the optical frame becomes OpenGL's clip space."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import moderngl
import numpy as np
from numpy.typing import NDArray

from gibson_sim.geometry.projections import clip_from_optical, frustum_planes
from gibson_sim.geometry.transforms import Mat4
from gibson_sim.render import gl as GL
from gibson_sim.render.batches import Batch, Batches
from gibson_sim.render.context import GlContext
from gibson_sim.render.dressing import Dressing
from gibson_sim.render.lighting import Lighting
from gibson_sim.render.occlusion import DepthPyramid, hidden
from gibson_sim.render.scene_memory import SceneMemory
from gibson_sim.render.screen_pass import shader_text
from gibson_sim.render.shadows import SunShadow
from gibson_sim.render.target import ATTACHMENT, Feature, Target
from gibson_sim.render.visibility import Detail, Visibility, link_frames
from gibson_sim.scenes.spec import LightSpec

F64 = NDArray[np.float64]
I64 = NDArray[np.int64]

_VIEW = np.dtype(
    [("clip", "<f4", (4, 4)), ("clip_before", "<f4", (4, 4)), ("optical", "<f4", (4, 4)), ("eye", "<f4", 4), ("size", "<f4", 4), ("pad", "<f4", 8)]
)  # fmt: skip
"""``View`` of the shaders, matrices by columns, padded to the alignment of uniform buffers."""
_COMMAND = np.dtype([("count", "<u4"), ("instances", "<u4"), ("first", "<u4"), ("base_vertex", "<i4"), ("base_instance", "<u4")])
_VIEWS = 0
_LINKS, _LINKS_BEFORE, _MATERIALS, _LOOKS = 0, 1, 2, 3
_NOTHING, _UNKNOWN = np.zeros(4, dtype=np.float32), np.full(4, np.nan, dtype=np.float32)
_OCCLUSION_FROM = 50_000
"""Fewer triangles than this are drawn without looking what is hidden."""
_NEAR_PART = 0.25
"""Part of the triangles, the nearest ones, that are drawn before that look."""


@dataclass(frozen=True, slots=True, eq=False)
class Picture:
    """One pinhole picture to draw into a rectangle of a target."""

    T_world_camera: Mat4
    """Optical frame."""
    intrinsics: F64
    """K, (3, 3), pixels, pixel centres at whole numbers."""
    width: int
    """Pixels."""
    height: int
    near: float
    """Metres."""
    x: int = 0
    """Left column in the target."""
    y: int = 0
    """Top row in the target."""
    T_world_camera_before: Mat4 | None = None
    """At the state before; for the flow."""


class GlScene:
    """Batches on the GPU.

    Args:
        context: where; it must be current in every call.
        batches: what.
        light: how surfaces are lit, and the background.
        detail_px: how far, pixels, levels of detail may put a surface from where it is; 0 = always draw all triangles.
        compress: keep textures compressed.
        cull: leave out what is outside the image; off only to check that nothing else changes.
    """

    def __init__(
        self,
        context: GlContext,
        batches: Batches,
        light: LightSpec,
        *,
        detail_px: float,
        compress: bool = False,
        cull: bool = True,
    ) -> None:
        self._context, self._gl = context, GL.Gl(context)
        self._batches, self._light = batches, light
        self._detail_px, self._cull = detail_px, cull
        self._occlusion = cull and context.device.software
        self._programs: dict[tuple[str, ...], moderngl.Program] = {}
        self._memory = SceneMemory(self._gl, compress=compress)
        self._buffers = [self._gl.create("glCreateBuffers") for _ in range(4)]
        self._links, self._links_before, self._views, self._command_buffer = self._buffers
        self._lighting: Lighting | None = None
        self._dressing: Dressing | None = None
        self._shadow: SunShadow | None = None
        self._glossy = False
        self.warnings: tuple[str, ...] = ()
        """What of the light was left out, one line each."""
        self.drawn_triangles = 0
        """Of the last call of ``draw``."""
        try:
            self._take(batches, 0, 0)
        except BaseException:
            self.close()
            raise

    def update(self, batches: Batches, same_vertices: int, same_indices: int) -> None:
        """Takes other batches under the same light; the context must be current, and ``set_links`` must follow.

        Args:
            batches: what to draw from now on.
            same_vertices: so many of its vertices, from the first on, are those of the batches before.
            same_indices: likewise.
        """
        if self._shadow is not None:
            self._shadow.close()
            self._shadow = None
        self._take(batches, same_vertices, same_indices)

    def _take(self, b: Batches, same_vertices: int, same_indices: int) -> None:
        before = self._batches if self._dressing is not None else None
        self._batches, self._visibility = b, Visibility(b)
        self._blend = np.array([batch.kind == "blend" for batch in b.batches], dtype=bool)[self._visibility.batch_of]
        self._memory.take(b, same_vertices, same_indices)
        if before is None or before.map_sets != b.map_sets or not np.array_equal(before.patterns, b.patterns):
            if self._dressing is not None:
                self._dressing.close()
            self._dressing = Dressing(self._context, b)
        glossy = any(batch.glossy for batch in b.batches)
        if self._lighting is None or (glossy and not self._glossy):
            if self._lighting is not None:
                self._lighting.close()
            self._lighting, self._glossy = Lighting(self._context, self._light, glossy=glossy), glossy
            self.warnings = self._lighting.warnings
        if self._light.shadows and b.batches:
            self._shadow = SunShadow(self._context, -np.asarray(self._light.sun_direction, dtype=np.float64))
        for batch in b.batches:
            self._program(batch, ())  # now, so that the first image does not wait for the compiler

    @property
    def texture_bytes(self) -> int:
        """What the textures of materials take."""
        return self._memory.texture_bytes

    def _upload(self, buffer: int, data: NDArray[Any]) -> None:
        self._gl.glNamedBufferData(buffer, data.nbytes, data.ctypes.data, GL.STREAM_DRAW)

    def _program(self, batch: Batch, features: tuple[Feature, ...], *, color: bool = True) -> moderngl.Program:
        """Returns the program for a batch, compiled at its first use; without colour it fills depth and features only."""
        cut = batch.kind != "opaque"
        lights = color and not batch.unlit
        flags = {
            "MOVING": batch.moving, "CUT": cut, "UNLIT": not lights, "TEXTURED": batch.texture >= 0 and (cut or color),
            "ONE_MATERIAL": batch.material >= 0, "NUMBERED": batch.material < 0 or batch.looked,
            "SURFACE": lights or "FLOW" in features, "TURNED": lights or "NORMALS" in features,
            "LOOKED": color and batch.looked, "COLORED": color and batch.colored,
        }  # fmt: skip
        assert self._lighting is not None
        lit = (
            ()
            if flags["UNLIT"]
            else (
                *self._lighting.defines,
                *(("GLOSS",) if batch.glossy else ()),
                *(("MATERIAL_MAPS",) if batch.maps >= 0 else ()),
            )
        )
        defines = (*(name for name, on in flags.items() if on), *lit, *features)
        if defines not in self._programs:
            before = (*(() if flags["UNLIT"] else ("lighting.glsl",)), *(("looks.glsl",) if flags["LOOKED"] else ()))
            program = self._context.gl.program(
                vertex_shader=shader_text("scene.vert", defines), fragment_shader=shader_text("scene.frag", defines, before)
            )
            if "u_texture" in program:
                program["u_texture"] = 0
            self._programs[defines] = program
        return self._programs[defines]

    def set_links(self, T_world_links: F64, before: F64 | None = None) -> None:
        """Takes the poses for the pictures that follow.

        Args:
            T_world_links: (L + 1, 4, 4): the identity for the world itself, then every link.
            before: the same of the state before, for the flow; None = nothing has moved.
        """
        self._T_world_links = T_world_links
        if len(T_world_links) > 1:
            self._upload(self._links, np.ascontiguousarray(T_world_links[:, :3], dtype=np.float32))
            self._upload(
                self._links_before, np.ascontiguousarray((T_world_links if before is None else before)[:, :3], dtype=np.float32)
            )

    def draw(self, target: Target, pictures: Sequence[Picture], *, color: bool = True) -> None:
        """Clears a target and draws pictures into it, with all features that the target has; colours only if asked for."""
        if color:
            self._update_shadow()
        target.use()
        self._begin(target.features)
        self.drawn_triangles = 0
        if not pictures or not (self._batches.batches or (self._lighting is not None and self._lighting.has_sky)):
            return
        views = np.zeros(len(pictures), dtype=_VIEW)
        plans = [self._plan(picture, views[k]) for k, picture in enumerate(pictures)]
        self._upload(self._views, views)
        self._bind()
        # The depth of a pixel's middle says nothing about its other samples, and those of several samples cannot be read.
        if self._occlusion and target.samples == 1 and sum(plan.triangles for plan in plans) >= _OCCLUSION_FROM:
            self._run(target, [self._commands(plan.near) for plan in plans], plans, color, last=False)
            depth = self._read_depth(target)
            late = [self._commands(self._not_hidden(plan, depth), plan.back if color else None) for plan in plans]
        else:
            late = [self._commands(np.concatenate([plan.near, plan.far]), plan.back if color else None) for plan in plans]
        self._run(target, late, plans, color, last=True)

    def _read_depth(self, target: Target) -> NDArray[np.float32]:
        """Returns what the target has so far: near / depth, (H, W)."""
        out = np.empty((target.height, target.width), dtype=np.float32)
        self._gl.glReadPixels(0, 0, target.width, target.height, GL.DEPTH_COMPONENT, GL.FLOAT, out.ctypes.data)
        return out

    def _not_hidden(self, plan: _Plan, depth: NDArray[np.float32]) -> I64:
        """Returns the far chunks that may be seen past the near ones."""
        p = plan.picture
        pyramid = DepthPyramid(depth[p.y : p.y + p.height, p.x : p.x + p.width])
        b = self._batches
        links = b.chunk_link[plan.far]
        T_camera_box = plan.T_camera_links[links] if links.any() else plan.T_camera_links[0]
        seen: I64 = plan.far[~hidden(pyramid, b.chunk_box[plan.far], T_camera_box, p.intrinsics, p.near)]
        return seen

    def _bind(self) -> None:
        gl = self._gl
        gl.glBindVertexArray(self._memory.array)
        gl.glBindBuffer(GL.DRAW_INDIRECT_BUFFER, self._command_buffer)
        assert self._lighting is not None and self._dressing is not None
        self._lighting.bind()
        self._dressing.bind()
        if self._shadow is not None:
            self._shadow.bind()
        if len(self._batches.looks):
            gl.glBindBufferBase(GL.SHADER_STORAGE_BUFFER, _LOOKS, self._memory.looks)
        for binding, buffer in ((_LINKS, self._links), (_LINKS_BEFORE, self._links_before), (_MATERIALS, self._memory.materials)):
            gl.glBindBufferBase(GL.SHADER_STORAGE_BUFFER, binding, buffer)

    def _begin(self, features: tuple[Feature, ...]) -> None:
        gl = self._gl
        gl.glClipControl(GL.LOWER_LEFT, GL.ZERO_TO_ONE)
        gl.glEnable(GL.DEPTH_TEST)
        gl.glEnable(GL.FRAMEBUFFER_SRGB)
        for state in (GL.CULL_FACE, GL.BLEND, GL.PRIMITIVE_RESTART, GL.SCISSOR_TEST):
            gl.glDisable(state)
        gl.glDepthFunc(GL.GREATER)
        gl.glFrontFace(GL.CLOCKWISE)  # the flip of the picture turns them round
        gl.glDepthMask(1)
        gl.glClearBufferfv(GL.DEPTH, 0, _NOTHING.ctypes.data)
        assert self._lighting is not None
        gl.glClearBufferfv(GL.COLOR, 0, self._lighting.background.ctypes.data)
        for feature in features:
            clear = gl.glClearBufferuiv if feature == "LABELS" else gl.glClearBufferfv
            clear(GL.COLOR, ATTACHMENT[feature], (_UNKNOWN if feature == "FLOW" else _NOTHING).ctypes.data)

    def _plan(self, picture: Picture, view: NDArray[np.void]) -> _Plan:
        """Chooses what to draw of one picture, and fills its ``view``."""
        T_camera_links, eyes = link_frames(picture.T_world_camera, self._T_world_links)
        # The flip: optical y points down and clip y points up, so row 0 of the image comes first in OpenGL's bottom-up memory.
        projection, planes = _lens(picture.intrinsics.tobytes(), picture.width, picture.height, picture.near)
        before = picture.T_world_camera if picture.T_world_camera_before is None else picture.T_world_camera_before
        view["clip"] = (projection @ T_camera_links[0]).T
        still = before is picture.T_world_camera
        view["clip_before"] = view["clip"] if still else (projection @ link_frames(before, self._T_world_links[:1])[0][0]).T
        view["optical"][:3, :3] = picture.T_world_camera[:3, :3]  # transposed once to turn, once to be by columns
        view["eye"][:3] = eyes[0]
        view["size"][:3] = picture.width, picture.height, picture.near
        focal = float(max(abs(picture.intrinsics[0, 0]), abs(picture.intrinsics[1, 1])))
        chunks = self._visibility.choose(eyes, Detail(focal, self._detail_px, picture.near))
        if self._cull:
            chunks = chunks[self._visibility.inside(chunks, planes, T_camera_links)]
        b = self._batches
        distance = self._visibility.distances(chunks, eyes)
        chunks = chunks[np.argsort(distance, kind="stable")]
        back = chunks[self._blend[chunks]][::-1]
        triangles = np.cumsum(b.chunk_count[chunks]) // 3
        total = int(triangles[-1]) if len(chunks) else 0
        split = int(np.searchsorted(triangles, total * _NEAR_PART))
        return _Plan(picture, T_camera_links, chunks[:split], chunks[split:], back, total)

    def _commands(self, solid: I64, back: I64 | None = None) -> _Commands:
        """Returns draws of solid things batch by batch, in the order given; then of what shines through, in the order given."""
        b, batch_of = self._batches, self._visibility.batch_of
        pieces: list[I64] = []
        runs: list[tuple[int, int, bool]] = []
        # The order of batches is that of their first chunk, but what has holes comes after what has none.
        present, first = np.unique(batch_of[solid], return_index=True)
        for k in sorted(present.tolist(), key=lambda k: (b.batches[k].kind != "opaque", first[np.searchsorted(present, k)])):
            pieces.append(solid[batch_of[solid] == k])
            runs.append((k, len(pieces[-1]), False))
        if back is not None and len(back):
            pieces.append(back)
            starts = np.flatnonzero(np.diff(batch_of[back], prepend=-1))
            counts = np.diff([*starts.tolist(), len(back)])
            runs += [(int(batch_of[back[s]]), int(n), True) for s, n in zip(starts, counts, strict=True)]
        every = np.concatenate(pieces) if pieces else solid
        commands = np.zeros(len(every), dtype=_COMMAND)
        commands["count"], commands["first"] = b.chunk_count[every], b.chunk_first[every]
        commands["instances"], commands["base_instance"] = 1, b.chunk_placement[every]
        return _Commands(commands, runs)

    def _run(self, target: Target, commands: Sequence[_Commands], plans: Sequence[_Plan], color: bool, *, last: bool) -> None:
        """Sends the draws of each picture; after the last solid ones come the sky and what shines through."""
        every = np.concatenate([c.draws for c in commands])
        if len(every):
            self._upload(self._command_buffer, every)
        self.drawn_triangles += int(every["count"].sum()) // 3
        first = 0
        for k, (c, plan) in enumerate(zip(commands, plans, strict=True)):
            p = plan.picture
            self._gl.glViewport(p.x, p.y, p.width, p.height)
            self._gl.glBindBufferRange(GL.UNIFORM_BUFFER, _VIEWS, self._views, k * _VIEW.itemsize, _VIEW.itemsize)
            self._run_picture(c, first, target.features, color, last)
            first += len(c.draws)

    def _run_picture(self, commands: _Commands, first: int, features: tuple[Feature, ...], color: bool, last: bool) -> None:
        gl = self._gl
        blending = False
        assert self._lighting is not None
        for number, count, translucent in commands.runs:
            batch = self._batches.batches[number]
            if translucent and not blending:
                blending = True
                self._draw_sky(features)
                gl.glEnable(GL.BLEND)
                gl.glBlendFunc(GL.SRC_ALPHA, GL.ONE_MINUS_SRC_ALPHA)
                gl.glDepthMask(0)
                self._mask_features(features, 0)  # labels and normals are those of the solid surface behind, as the depth is
            program = self._program(batch, features, color=color)
            self._prepare(program, batch, translucent)
            gl.glMultiDrawElementsIndirect(GL.TRIANGLES, GL.UNSIGNED_INT, first * _COMMAND.itemsize, count, _COMMAND.itemsize)
            first += count
        if blending:
            gl.glDepthMask(1)
            self._mask_features(features, 1)
            gl.glDisable(GL.BLEND)
        elif last and color:
            self._draw_sky(features)

    def _draw_sky(self, features: tuple[Feature, ...]) -> None:
        assert self._lighting is not None
        self._lighting.draw_sky(features)
        self._gl.glBindVertexArray(self._memory.array)

    def _update_shadow(self) -> None:
        if self._shadow is not None and self._lighting is not None:
            shadow_from_world = self._shadow.update(self, self._T_world_links)
            self._lighting.set_shadow(shadow_from_world, self._shadow.texel, self._shadow.size)

    def moves(self) -> bool:
        """Whether anything belongs to a link."""
        return any(batch.moving for batch in self._batches.batches)

    def bounds(self, T_world_links: F64) -> F64:
        """Returns the box of all that is there, (2, 3), world frame, metres."""
        return self._visibility.bounds(T_world_links)

    def draw_depth(self, clip_from_world: Mat4, T_world_links: F64, texel: float, *, static: bool, moving: bool) -> None:
        """Draws solid things into the depth buffer that is bound; ``set_links`` must have had these poses.

        Args:
            clip_from_world: (4, 4), parallel rays.
            T_world_links: (L + 1, 4, 4).
            texel: metres: surfaces may be so far from where they are.
            static: what belongs to the world.
            moving: what belongs to links.
        """
        b, batch_of = self._batches, self._visibility.batch_of
        wanted = np.array([moving if batch.moving else static for batch in b.batches], dtype=bool)
        chunks = self._visibility.choose_for(texel)
        commands = self._commands(chunks[wanted[batch_of[chunks]]])
        if not len(commands.draws):
            return
        view = np.zeros(1, dtype=_VIEW)
        view["clip"][0] = clip_from_world.T
        self._upload(self._views, view)
        self._upload(self._command_buffer, commands.draws)
        self._bind()
        self._gl.glBindBufferRange(GL.UNIFORM_BUFFER, _VIEWS, self._views, 0, _VIEW.itemsize)
        first = 0
        for number, count, _ in commands.runs:
            batch = b.batches[number]
            program = self._program(batch, (), color=False)
            self._prepare(program, batch, translucent=False)
            self._gl.glMultiDrawElementsIndirect(
                GL.TRIANGLES, GL.UNSIGNED_INT, first * _COMMAND.itemsize, count, _COMMAND.itemsize
            )
            first += count

    def _prepare(self, program: moderngl.Program, batch: Batch, translucent: bool) -> None:
        gl = self._gl
        if batch.kind != "opaque":
            program["u_translucent"] = translucent
        if batch.material >= 0:
            row = self._batches.materials[batch.material]
            for name, column in (("u_color", "color"), ("u_surface", "surface"), ("u_glow", "glow"), ("u_maps", "maps")):
                if name in program:
                    program[name].write(np.ascontiguousarray(row[column]))  # type: ignore[union-attr]
        if batch.texture >= 0:
            gl.glBindTextureUnit(0, self._memory.textures[batch.texture])
            gl.glBindSampler(0, 0)
        if batch.maps >= 0 and self._dressing is not None:
            self._dressing.bind_maps(batch.maps)
        gl.glUseProgram(program.glo)

    def _mask_features(self, features: tuple[Feature, ...], write: int) -> None:
        for feature in features:
            self._gl.glColorMaski(ATTACHMENT[feature], write, write, write, write)

    def close(self) -> None:
        """Frees everything; a second call does nothing."""
        programs, buffers = self._programs, self._buffers
        self._programs, self._buffers = {}, []
        for part in (self._lighting, self._dressing, self._shadow, self._memory):
            if part is not None:
                part.close()
        for buffer in buffers:
            self._gl.delete("glDeleteBuffers", buffer)
        for program in programs.values():
            program.release()


@lru_cache(maxsize=256)
def _lens(intrinsics: bytes, width: int, height: int, near: float) -> tuple[F64, F64]:
    """Returns the projection, (4, 4), and the planes of the frustum, (5, 4), of K, the bytes of (3, 3) float64."""
    k = np.frombuffer(intrinsics, dtype=np.float64).reshape(3, 3)
    return clip_from_optical(k, width, height, near), frustum_planes(k, width, height, near)


@dataclass(frozen=True, slots=True, eq=False)
class _Plan:
    """What to draw of one picture."""

    picture: Picture
    T_camera_links: F64
    near: I64
    """The nearest chunks, the nearest first."""
    far: I64
    """The others, the nearest first."""
    back: I64
    """Those that something may shine through, the farthest first."""
    triangles: int


@dataclass(frozen=True, slots=True, eq=False)
class _Commands:
    """Draw commands of one picture, and the runs of them that share their settings."""

    draws: NDArray[np.void]
    runs: list[tuple[int, int, bool]]
    """(batch, how many draws, draw what shines through), in the order of the draws."""
