"""A scene in GPU memory, and the drawing of it: the one place where the optical frame becomes OpenGL's clip space."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gibson_sim.geometry.transforms import Mat4
from gibson_sim.render.batching.batches import Batches
from gibson_sim.render.context import GlContext, gl as GL
from gibson_sim.render.culling.draw_plan import KINDS, VIEW, Picture, Plan, Planner, Run, draw_table
from gibson_sim.render.culling.occluders import Occluders
from gibson_sim.render.culling.visibility import Visibility
from gibson_sim.render.draw.lighting import Lighting
from gibson_sim.render.draw.material_maps import MaterialMaps
from gibson_sim.render.draw.programs import Programs
from gibson_sim.render.draw.scene_memory import SceneMemory
from gibson_sim.render.draw.shadows import SunShadow
from gibson_sim.render.draw.target import ATTACHMENT, Feature, Target
from gibson_sim.scenes.spec import LightSpec

F64 = NDArray[np.float64]
I64 = NDArray[np.int64]
U32 = NDArray[np.uint32]

_COMMAND_BYTES = 20
_VIEWS = 0
_LINKS, _LINKS_BEFORE, _MATERIALS, _APPEARANCES = 0, 1, 2, 3
_NOTHING, _UNKNOWN = np.zeros(4, dtype=np.float32), np.full(4, np.nan, dtype=np.float32)
_OCCLUSION_FROM = 1_500
"""Fewer triangles than this are drawn without looking what is hidden."""
_NEAR_FROM = 50_000
"""Of as many triangles as this the nearest ones are drawn before that appearance, too, where the large ones leave gaps."""
_COVERED = 0.9
"""Part of the pixels that the large ones must cover."""
_BEHIND = -4.0
"""How far behind its place that is drawn, in the smallest steps of a depth, so that the same triangle passes in front of it later."""


class GlScene:
    """Batches on the GPU.

    Args:
        context: where; it must be current in every call.
        batches: what.
        light: how surfaces are lit, and the background.
        detail_px: how far, pixels, levels of detail may put a surface from where it is; 0 = always draw all triangles.
        compress: keep textures compressed.
        cull: leave out what is outside the image, or hidden; off only to check that nothing else changes.
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
        self._occluders = Occluders()
        self._programs = Programs(context)
        self._memory = SceneMemory(self._gl, compress=compress)
        self._buffers = [self._gl.create("glCreateBuffers") for _ in range(4)]
        self._links, self._links_before, self._views, self._command_buffer = self._buffers
        self._lighting: Lighting | None = None
        self._material_maps: MaterialMaps | None = None
        self._shadow: SunShadow | None = None
        self._glossy = False
        self.warnings: tuple[str, ...] = ()
        """What of the light was left out, one line each."""
        self._drawn: list[U32] = []
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
        before = self._batches if self._material_maps is not None else None
        self._batches, self._visibility = b, Visibility(b)
        self._planner = Planner(b, self._visibility, self._detail_px, cull=self._cull)
        self._moving = np.array([batch.moving for batch in b.batches], dtype=bool)
        self._closed = np.array([batch.closed for batch in b.batches], dtype=bool)
        self._memory.take(b, same_vertices, same_indices)
        if self._occlusion:
            self._occluders.take(b, same_indices)
            self._memory.take_occluders(self._occluders.indices)
            self._occluder_draws = draw_table(b, self._occluders.first, self._occluders.count)
        if before is None or before.map_sets != b.map_sets or not np.array_equal(before.patterns, b.patterns):
            if self._material_maps is not None:
                self._material_maps.close()
            self._material_maps = MaterialMaps(self._context, b)
        glossy = any(batch.glossy for batch in b.batches)
        if self._lighting is None or (glossy and not self._glossy):
            if self._lighting is not None:
                self._lighting.close()
            self._lighting, self._glossy = Lighting(self._context, self._light, glossy=glossy), glossy
            self.warnings = self._lighting.warnings
        if self._light.shadows and b.batches:
            self._shadow = SunShadow(self._context, -np.asarray(self._light.sun_direction, dtype=np.float64))
        self._programs.take(b, self._lighting.defines)

    @property
    def texture_bytes(self) -> int:
        """What the textures of materials take."""
        return self._memory.texture_bytes

    @property
    def drawn_triangles(self) -> int:
        """Of the last call of ``draw``."""
        return sum(int(draws[:, 0].sum(dtype=np.int64)) for draws in self._drawn) // 3

    def _upload(self, buffer: int, data: NDArray[Any]) -> None:
        self._gl.glNamedBufferData(buffer, data.nbytes, data.ctypes.data, GL.STREAM_DRAW)

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
        self._prepare_state()
        self._drawn = []
        views = np.zeros(len(pictures), dtype=VIEW)
        plans = [self._planner.plan(picture, self._T_world_links, views[k]) for k, picture in enumerate(pictures)]
        if pictures:
            self._upload(self._views, views)
            self._bind()
        appearance = self._occlusion and sum(plan.triangles for plan in plans) >= _OCCLUSION_FROM
        if appearance and target.samples == 1:
            plans = self._without_hidden(target, plans)
        elif appearance:
            # The depth of a pixel's middle says nothing about its other samples, and those of several samples cannot be read.
            self._fill_large(target, plans)
            self._gl.glDisable(GL.POLYGON_OFFSET_FILL)
        target.use(color=color)
        self._clear(target.features, color=color, depth=not appearance)
        if plans:
            self._run(target.features, plans, color)

    def _prepare_state(self) -> None:
        gl = self._gl
        gl.glClipControl(GL.LOWER_LEFT, GL.ZERO_TO_ONE)
        gl.glEnable(GL.DEPTH_TEST)
        gl.glEnable(GL.FRAMEBUFFER_SRGB)
        for state in (GL.CULL_FACE, GL.BLEND, GL.PRIMITIVE_RESTART, GL.SCISSOR_TEST):
            gl.glDisable(state)
        gl.glDepthFunc(GL.GREATER)
        gl.glFrontFace(GL.CLOCKWISE)  # the flip of the picture turns them round
        gl.glDepthMask(1)

    def _bind(self) -> None:
        gl = self._gl
        gl.glBindVertexArray(self._memory.array)
        gl.glBindBuffer(GL.DRAW_INDIRECT_BUFFER, self._command_buffer)
        gl.glBindSampler(0, 0)
        assert self._lighting is not None and self._material_maps is not None
        self._lighting.bind()
        self._material_maps.bind()
        if self._shadow is not None:
            self._shadow.bind()
        if len(self._batches.appearances):
            gl.glBindBufferBase(GL.SHADER_STORAGE_BUFFER, _APPEARANCES, self._memory.appearances)
        for binding, buffer in ((_LINKS, self._links), (_LINKS_BEFORE, self._links_before), (_MATERIALS, self._memory.materials)):
            gl.glBindBufferBase(GL.SHADER_STORAGE_BUFFER, binding, buffer)

    def _clear(self, features: tuple[Feature, ...], *, color: bool, depth: bool) -> None:
        gl = self._gl
        if depth:
            gl.glClearBufferfv(GL.DEPTH, 0, _NOTHING.ctypes.data)
        if color:
            assert self._lighting is not None
            gl.glClearBufferfv(GL.COLOR, 0, self._lighting.background.ctypes.data)
        for feature in features:
            clear = gl.glClearBufferuiv if feature == "LABELS" else gl.glClearBufferfv
            clear(GL.COLOR, ATTACHMENT[feature], (_UNKNOWN if feature == "FLOW" else _NOTHING).ctypes.data)

    def _without_hidden(self, target: Target, plans: Sequence[Plan]) -> list[Plan]:
        """Fills the depth with what hides most, a little behind its place; returns the plans without what cannot be seen past it."""
        self._fill_large(target, plans)
        self._gl.glFlush()  # it is drawn while the following is worked out
        queries = self._planner.occlusion_queries(plans)
        depth = self._read_depth(target)
        if sum(plan.triangles for plan in plans) >= _NEAR_FROM and np.count_nonzero(depth) < _COVERED * depth.size:
            self._fill_depth(plans, [plan.near for plan in plans], self._planner.table)
            depth = self._read_depth(target)
        self._gl.glDisable(GL.POLYGON_OFFSET_FILL)
        return [query.unhidden(_part(depth, plan.picture)) for query, plan in zip(queries, plans, strict=True)]

    def _fill_large(self, target: Target, plans: Sequence[Plan]) -> None:
        """Clears the depth of a target and fills it with the large triangles, a little behind their places; leaves that offset on."""
        gl = self._gl
        target.use_depth()
        gl.glClearBufferfv(GL.DEPTH, 0, _NOTHING.ctypes.data)
        gl.glEnable(GL.POLYGON_OFFSET_FILL)
        gl.glPolygonOffset(0.0, _BEHIND)
        gl.glBindVertexArray(self._memory.occluder_array)
        self._fill_depth(plans, [plan.chunks[: plan.solid] for plan in plans], self._occluder_draws)
        gl.glBindVertexArray(self._memory.array)

    def _fill_depth(self, plans: Sequence[Plan], chosen: Sequence[I64], table: U32) -> None:
        """Sends draws of chosen chunks of each picture that have no holes, by rows of ``table``."""
        sent = [self._planner.by_kind(chunks, table) for chunks in chosen]
        self._send([draws for draws, _ in sent])
        first = 0
        for k, (plan, (_, counts)) in enumerate(zip(plans, sent, strict=True)):
            self._look_at(plan.picture, k)
            for (moving, closed), count in zip(KINDS, counts, strict=True):
                if count:
                    self._gl.glUseProgram(self._programs.depth(moving=moving).number)
                    self._draw_both_sides(not (plan.fronts and closed))
                    self._multi_draw(first, count)
                    first += count
        self._draw_both_sides(True)

    def _read_depth(self, target: Target) -> NDArray[np.float32]:
        """Returns what the target has so far: near / depth, (H, W)."""
        out = np.empty((target.height, target.width), dtype=np.float32)
        self._gl.glReadPixels(0, 0, target.width, target.height, GL.DEPTH_COMPONENT, GL.FLOAT, out.ctypes.data)
        return out

    def _send(self, commands: Sequence[U32]) -> None:
        every = np.concatenate(commands)
        if len(every):
            self._upload(self._command_buffer, every)

    def _look_at(self, picture: Picture, number: int) -> None:
        """Takes the rectangle and the view of a picture for the draws that follow."""
        self._gl.glViewport(picture.x, picture.y, picture.width, picture.height)
        self._gl.glBindBufferRange(GL.UNIFORM_BUFFER, _VIEWS, self._views, number * VIEW.itemsize, VIEW.itemsize)

    def _draw_both_sides(self, both: bool) -> None:
        (self._gl.glDisable if both else self._gl.glEnable)(GL.CULL_FACE)

    def _multi_draw(self, first: int, count: int) -> None:
        self._gl.glMultiDrawElementsIndirect(GL.TRIANGLES, GL.UNSIGNED_INT, first * _COMMAND_BYTES, count, _COMMAND_BYTES)

    def _run(self, features: tuple[Feature, ...], plans: Sequence[Plan], color: bool) -> None:
        """Sends the draws of each picture; after the last solid ones come the sky and what shines through."""
        if color:
            plans = self._gathered(plans)
        self._drawn = [plan.draws if color else plan.draws[: plan.solid] for plan in plans]
        self._send(self._drawn)
        first = 0
        for k, (plan, commands) in enumerate(zip(plans, self._drawn, strict=True)):
            self._look_at(plan.picture, k)
            self._run_picture(plan, first, features, color)
            first += len(commands)

    def _gathered(self, plans: Sequence[Plan]) -> list[Plan]:
        """Returns the plans with what shines through drawn by indices of its own, which are sent."""
        gathered, sent, before = [], [], 0
        for plan in plans:
            less, indices = plan.gathered(self._batches.indices, before)
            gathered.append(less)
            sent.append(indices)
            before += len(indices)
        if before:
            self._memory.take_sorted(np.concatenate(sent))
        return gathered

    def _run_picture(self, plan: Plan, first: int, features: tuple[Feature, ...], color: bool) -> None:
        gl = self._gl
        blending = False
        for run in plan.runs(translucent=color):
            if run.translucent and not blending:
                blending = True
                self._draw_both_sides(True)
                self._draw_sky(features)
                gl.glBindVertexArray(self._memory.sorted_array)
                gl.glEnable(GL.BLEND)
                gl.glBlendFunc(GL.SRC_ALPHA, GL.ONE_MINUS_SRC_ALPHA)
                gl.glDepthMask(0)
                self._mask_features(features, 0)  # labels and normals are those of the solid surface behind, as the depth is
            self._prepare(run, features, color)
            self._draw_both_sides(not (plan.fronts and self._closed[run.batch]))
            self._multi_draw(first, run.draws)
            first += run.draws
        self._draw_both_sides(True)
        if blending:
            gl.glDepthMask(1)
            self._mask_features(features, 1)
            gl.glDisable(GL.BLEND)
            gl.glBindVertexArray(self._memory.array)
        elif color:
            self._draw_sky(features)

    def _prepare(self, run: Run, features: tuple[Feature, ...], color: bool) -> None:
        """Makes the draws that follow those of a run."""
        batch = self._batches.batches[run.batch]
        program = self._programs.of(run.batch, features, color=color)
        self._programs.tell(program, batch.material, translucent=run.translucent)
        if batch.texture >= 0:
            self._gl.glBindTextureUnit(0, self._memory.textures[batch.texture])
        if batch.maps >= 0 and self._material_maps is not None:
            self._material_maps.bind_maps(batch.maps)
        self._gl.glUseProgram(program.number)

    def _draw_sky(self, features: tuple[Feature, ...]) -> None:
        assert self._lighting is not None
        if self._lighting.has_sky:
            self._lighting.draw_sky(features)
            self._gl.glBindVertexArray(self._memory.array)

    def _update_shadow(self) -> None:
        if self._shadow is not None and self._lighting is not None:
            shadow_from_world = self._shadow.update(self, self._T_world_links)
            self._lighting.set_shadow(shadow_from_world, self._shadow.texel, self._shadow.size)

    def moves(self) -> bool:
        """Whether anything belongs to a link."""
        return bool(self._moving.any())

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
        chunks = self._visibility.choose_for(texel)
        plan = self._planner.solid(chunks[np.where(self._moving, moving, static)[self._visibility.batch_of[chunks]]])
        if not len(plan.draws):
            return
        view = np.zeros(1, dtype=VIEW)
        view["clip"][0] = clip_from_world.T
        self._upload(self._views, view)
        self._send([plan.draws])
        self._bind()
        self._gl.glBindBufferRange(GL.UNIFORM_BUFFER, _VIEWS, self._views, 0, VIEW.itemsize)
        first = 0
        for run in plan.runs():
            self._prepare(run, (), color=False)
            self._multi_draw(first, run.draws)
            first += run.draws

    def _mask_features(self, features: tuple[Feature, ...], write: int) -> None:
        for feature in features:
            self._gl.glColorMaski(ATTACHMENT[feature], write, write, write, write)

    def close(self) -> None:
        """Frees everything; a second call does nothing."""
        buffers, self._buffers = self._buffers, []
        for part in (self._lighting, self._material_maps, self._shadow, self._memory, self._programs):
            if part is not None:
                part.close()
        for buffer in buffers:
            self._gl.delete("glDeleteBuffers", buffer)


def _part(image: NDArray[np.float32], picture: Picture) -> NDArray[np.float32]:
    return image[picture.y : picture.y + picture.height, picture.x : picture.x + picture.width]
