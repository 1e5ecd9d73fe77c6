"""Draws pinhole pictures of a scene in GPU memory; the only module that converts the optical frame to OpenGL clip space."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gibson_sim.geometry.transforms import Mat4
from gibson_sim.render.batching.scene_geometry import SceneGeometry
from gibson_sim.render.context import GlContext, gl as GL
from gibson_sim.render.culling.draw_plan import DEPTH_KINDS, VIEW, DrawPlan, DrawPlanner, MultiDraw, PinholePicture, draw_table
from gibson_sim.render.culling.occlusion import Occluders
from gibson_sim.render.culling.visibility import Visibility
from gibson_sim.render.draw.light_maps import LightMaps
from gibson_sim.render.draw.lighting import Lighting
from gibson_sim.render.draw.material_maps import MaterialMaps
from gibson_sim.render.draw.programs import Programs
from gibson_sim.render.draw.scene_memory import SceneMemory
from gibson_sim.render.draw.shadows import SunShadow
from gibson_sim.render.draw.target import ATTACHMENT, Feature, RenderTarget
from gibson_sim.scenes.spec import LightSpec

F64 = NDArray[np.float64]
I64 = NDArray[np.int64]
U32 = NDArray[np.uint32]

_DRAW_BYTES = 20
_VIEWS = 0
"""Binding of the uniform block ``View``."""
_LINKS, _LINKS_BEFORE, _MATERIALS, _APPEARANCES = 0, 1, 2, 3
"""Bindings of the storage buffers."""
_NOTHING, _UNKNOWN = np.zeros(4, dtype=np.float32), np.full(4, np.nan, dtype=np.float32)
_SKY = np.array([1.0, 1.0, 1.0, 0.0], dtype=np.float32)
"""Cleared value of normals with a sky: neither a surface nor a hole."""
_OCCLUSION_FROM = 1_500
"""Minimum number of triangles for occlusion culling."""
_NEAR_FROM = 50_000
"""Minimum number of triangles for using the nearest triangles as occluders too, if the large ones leave gaps."""
_COVERED = 0.9
"""Minimum fraction of pixels covered by large occluders without counting as gaps."""
_BEHIND = -4.0
"""Polygon offset of occluders, in the smallest depth steps, so that the same triangle passes the depth test later."""


class GlScene:
    """The geometry of a scene on the GPU.

    Args:
        context: it must be current in every call.
        geometry: geometry to draw.
        light: lighting and background.
        detail_px: largest screen-space error of levels of detail, pixels; 0 = always draw all triangles.
        compress: store textures compressed.
        cull: frustum and occlusion culling; False only to verify that culling changes no image.
    """

    def __init__(
        self,
        context: GlContext,
        geometry: SceneGeometry,
        light: LightSpec,
        *,
        detail_px: float,
        compress: bool = False,
        cull: bool = True,
    ) -> None:
        self._context, self._gl = context, GL.Gl(context)
        self._geometry, self._light = geometry, light
        self._detail_px, self._cull = detail_px, cull
        self._occlusion = cull and context.device.software
        self._occluders = Occluders()
        self._programs = Programs(context)
        self._memory = SceneMemory(self._gl, compress=compress)
        self._buffers = [self._gl.create("glCreateBuffers") for _ in range(4)]
        self._links, self._links_before, self._views, self._draw_buffer = self._buffers
        self._lighting: Lighting | None = None
        self._material_maps: MaterialMaps | None = None
        self._light_maps: LightMaps | None = None
        self._shadow: SunShadow | None = None
        self._glossy = False
        self.warnings: tuple[str, ...] = ()
        """One line for each omitted group of lights."""
        self._drawn: list[U32] = []
        self._plans: list[DrawPlan] = []
        self._later: list[DrawPlan] = []
        try:
            self._load(geometry, 0, 0)
        except BaseException:
            self.close()
            raise

    def update(self, geometry: SceneGeometry, same_vertices: int, same_indices: int) -> None:
        """Replaces the geometry and keeps the lighting; the context must be current, and ``set_links`` must follow.

        Args:
            geometry: new geometry.
            same_vertices: number of its leading vertices that are unchanged.
            same_indices: number of its leading indices that are unchanged.
        """
        if self._shadow is not None:
            self._shadow.close()
            self._shadow = None
        self._load(geometry, same_vertices, same_indices)

    def _load(self, b: SceneGeometry, same_vertices: int, same_indices: int) -> None:
        old = self._geometry if self._material_maps is not None else None
        self._geometry, self._visibility = b, Visibility(b)
        self._planner = DrawPlanner(b, self._visibility, self._detail_px, cull=self._cull)
        self._moving = np.array([batch.moving for batch in b.batches], dtype=bool)
        self._closed = np.array([batch.closed for batch in b.batches], dtype=bool)
        self._memory.load(b, same_vertices, same_indices)
        if self._occlusion:
            self._occluders.update(b, same_indices)
            self._memory.load_occluders(self._occluders.indices)
            self._occluder_draws = draw_table(b, self._occluders.first, self._occluders.count)
        if old is None or old.map_sets != b.map_sets or not np.array_equal(old.patterns, b.patterns):
            if self._material_maps is not None:
                self._material_maps.close()
            self._material_maps = MaterialMaps(self._context, b)
        if old is None or old.light_maps != b.light_maps:
            if self._light_maps is not None:
                self._light_maps.close()
            self._light_maps = LightMaps(self._context, b.light_maps, self._light.environment_strength)
        glossy = any(batch.glossy for batch in b.batches)
        if self._lighting is None or (glossy and not self._glossy):
            if self._lighting is not None:
                self._lighting.close()
            self._lighting, self._glossy = Lighting(self._context, self._light, glossy=glossy), glossy
            self.warnings = self._lighting.warnings
        if self._light.shadows and b.batches:
            self._shadow = SunShadow(self._context, -np.asarray(self._light.sun_direction, dtype=np.float64))
        self._programs.prepare(b, self._lighting.defines)

    @property
    def texture_bytes(self) -> int:
        """GPU memory of the textures of materials, bytes."""
        return self._memory.texture_bytes + (self._light_maps.bytes if self._light_maps is not None else 0)

    @property
    def drawn_triangles(self) -> int:
        """Number of triangles drawn by the last call of ``draw``."""
        return sum(int(draws[:, 0].sum(dtype=np.int64)) for draws in self._drawn) // 3

    def _upload(self, buffer: int, data: NDArray[Any]) -> None:
        self._gl.glNamedBufferData(buffer, data.nbytes, data.ctypes.data, GL.STREAM_DRAW)

    def set_links(self, T_world_links: F64, T_previous: F64 | None = None) -> None:
        """Sets the link poses of the next pictures.

        Args:
            T_world_links: (L + 1, 4, 4): the identity for the world, then the pose of every link.
            T_previous: T_world_links of the previous state, for optical flow; None = no motion.
        """
        self._T_world_links = T_world_links
        if len(T_world_links) > 1:
            self._upload(self._links, np.ascontiguousarray(T_world_links[:, :3], dtype=np.float32))
            self._upload(
                self._links_before,
                np.ascontiguousarray((T_world_links if T_previous is None else T_previous)[:, :3], dtype=np.float32),
            )

    def draw(
        self, target: RenderTarget, pictures: Sequence[PinholePicture], *, color: bool = True, moving_later: bool = False
    ) -> None:
        """Clears a target and draws pictures into it, with all features of the target.

        Args:
            target: target to draw into.
            pictures: pictures, side by side.
            color: whether to draw colours.
            moving_later: leave translucent surfaces of moving links to ``draw_moving_translucent``.
        """
        if color:
            self._update_shadow()
        self._prepare_state()
        self._drawn = []
        views = np.zeros(len(pictures), dtype=VIEW)
        plans = [self._planner.plan(picture, self._T_world_links, views[k]) for k, picture in enumerate(pictures)]
        if pictures:
            self._upload(self._views, views)
            self._bind()
        occlusion = self._occlusion and sum(plan.triangles for plan in plans) >= _OCCLUSION_FROM
        if occlusion and target.samples == 1:
            plans = self._occlusion_culled(target, plans)
        elif occlusion:
            # The depth at a pixel's centre is no bound for its other samples, and multisampled depths cannot be read back.
            self._fill_occluders(target, plans)
            self._gl.glDisable(GL.POLYGON_OFFSET_FILL)
        self._plans = plans
        target.use(color=color)
        self._clear(target.features, color=color, depth=not occlusion)
        if plans:
            self._draw_pictures(target.features, plans, color, moving_later)

    def _prepare_state(self) -> None:
        gl = self._gl
        gl.glClipControl(GL.LOWER_LEFT, GL.ZERO_TO_ONE)
        gl.glEnable(GL.DEPTH_TEST)
        gl.glEnable(GL.FRAMEBUFFER_SRGB)
        for state in (GL.CULL_FACE, GL.BLEND, GL.PRIMITIVE_RESTART, GL.SCISSOR_TEST):
            gl.glDisable(state)
        gl.glDepthFunc(GL.GREATER)
        gl.glFrontFace(GL.CLOCKWISE)  # the vertical flip of the picture reverses the winding
        gl.glDepthMask(1)

    def _bind(self) -> None:
        gl = self._gl
        gl.glBindVertexArray(self._memory.array)
        gl.glBindBuffer(GL.DRAW_INDIRECT_BUFFER, self._draw_buffer)
        gl.glBindSampler(0, 0)
        assert self._lighting is not None and self._material_maps is not None
        self._lighting.bind()
        self._material_maps.bind()
        if self._shadow is not None:
            self._shadow.bind()
        if len(self._geometry.appearances):
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
            clear(GL.COLOR, ATTACHMENT[feature], self._nothing(feature).ctypes.data)

    def _nothing(self, feature: Feature) -> NDArray[np.float32]:
        """Returns the clear value of a feature."""
        if feature == "NORMALS" and self._lighting is not None and self._lighting.has_sky:
            return _SKY
        return _UNKNOWN if feature == "FLOW" else _NOTHING

    def _occlusion_culled(self, target: RenderTarget, plans: Sequence[DrawPlan]) -> list[DrawPlan]:
        """Returns the plans without draws hidden behind the occluders, and leaves the depth of the occluders in the target."""
        self._fill_occluders(target, plans)
        self._gl.glFlush()  # the driver renders while the queries are prepared
        queries = self._planner.occlusion_queries(plans)
        depth = self._read_depth(target)
        if sum(plan.triangles for plan in plans) >= _NEAR_FROM and np.count_nonzero(depth) < _COVERED * depth.size:
            self._fill_depth(plans, [plan.near for plan in plans], self._planner.table)
            depth = self._read_depth(target)
        self._gl.glDisable(GL.POLYGON_OFFSET_FILL)
        return [query.visible(plan.picture.crop(depth)) for query, plan in zip(queries, plans, strict=True)]

    def _fill_occluders(self, target: RenderTarget, plans: Sequence[DrawPlan]) -> None:
        """Clears the depth of a target and draws the large occluders into it; leaves polygon offset enabled."""
        gl = self._gl
        target.use_depth()
        gl.glClearBufferfv(GL.DEPTH, 0, _NOTHING.ctypes.data)
        gl.glEnable(GL.POLYGON_OFFSET_FILL)
        gl.glPolygonOffset(0.0, _BEHIND)
        gl.glBindVertexArray(self._memory.occluder_array)
        self._fill_depth(plans, [plan.clusters[: plan.opaque] for plan in plans], self._occluder_draws)
        gl.glBindVertexArray(self._memory.array)

    def _fill_depth(self, plans: Sequence[DrawPlan], selected: Sequence[I64], table: U32) -> None:
        """Draws the depth of the selected clusters of each picture, which have no alpha-tested holes, with draw commands of ``table``."""
        sent = [self._planner.depth_draws(clusters, table) for clusters in selected]
        self._upload_draws([draws for draws, _ in sent])
        first = 0
        for k, (plan, (_, counts)) in enumerate(zip(plans, sent, strict=True)):
            self._bind_picture(plan.picture, k)
            for (moving, closed), count in zip(DEPTH_KINDS, counts, strict=True):
                if count:
                    self._gl.glUseProgram(self._programs.depth(moving=moving).number)
                    self._draw_both_sides(not (plan.cull_back_faces and closed))
                    self._multi_draw(first, count)
                    first += count
        self._draw_both_sides(True)

    def _read_depth(self, target: RenderTarget) -> NDArray[np.float32]:
        """Returns the current depth of the target: near / depth, (H, W)."""
        out = np.empty((target.height, target.width), dtype=np.float32)
        self._gl.glReadPixels(0, 0, target.width, target.height, GL.DEPTH_COMPONENT, GL.FLOAT, out.ctypes.data)
        return out

    def _upload_draws(self, draws: Sequence[U32]) -> None:
        commands = np.concatenate(draws)
        if len(commands):
            self._upload(self._draw_buffer, commands)

    def _bind_picture(self, picture: PinholePicture, number: int) -> None:
        """Sets the viewport and the view uniforms of a picture."""
        self._gl.glViewport(picture.x, picture.y, picture.width, picture.height)
        self._gl.glBindBufferRange(GL.UNIFORM_BUFFER, _VIEWS, self._views, number * VIEW.itemsize, VIEW.itemsize)

    def _draw_both_sides(self, both: bool) -> None:
        (self._gl.glDisable if both else self._gl.glEnable)(GL.CULL_FACE)

    def _multi_draw(self, first: int, count: int) -> None:
        self._gl.glMultiDrawElementsIndirect(GL.TRIANGLES, GL.UNSIGNED_INT, first * _DRAW_BYTES, count, _DRAW_BYTES)

    def _draw_pictures(self, features: tuple[Feature, ...], plans: Sequence[DrawPlan], color: bool, moving_later: bool) -> None:
        """Draws each picture: the opaque pass, the sky, then the translucent pass."""
        if color:
            plans = self._sorted_translucent(plans)
        self._later = []
        if color and moving_later:
            later = [self._moving[plan.batch] & (np.arange(len(plan.batch)) >= plan.opaque) for plan in plans]
            self._later = [plan.subset(mask) for plan, mask in zip(plans, later, strict=True)]
            plans = [plan.subset(~mask) for plan, mask in zip(plans, later, strict=True)]
        self._drawn = [plan.draws if color else plan.draws[: plan.opaque] for plan in plans]
        self._upload_draws(self._drawn)
        first = 0
        for k, (plan, draws) in enumerate(zip(plans, self._drawn, strict=True)):
            self._bind_picture(plan.picture, k)
            self._draw_picture(plan, first, features, color)
            first += len(draws)

    def _sorted_translucent(self, plans: Sequence[DrawPlan]) -> list[DrawPlan]:
        """Returns the plans with translucent draws that read sorted indices, and uploads these indices."""
        out, sorted_indices, offset = [], [], 0
        for plan in plans:
            sorted_plan, indices = plan.sorted_translucent(self._geometry.indices, offset)
            out.append(sorted_plan)
            sorted_indices.append(indices)
            offset += len(indices)
        if offset:
            self._memory.load_sorted(np.concatenate(sorted_indices))
        return out

    def _draw_picture(self, plan: DrawPlan, first: int, features: tuple[Feature, ...], color: bool) -> None:
        gl = self._gl
        blending = False
        for multi_draw in plan.multi_draws(translucent=color):
            if multi_draw.translucent and not blending:
                blending = True
                self._draw_both_sides(True)
                self._draw_sky(features)
                gl.glBindVertexArray(self._memory.sorted_array)
                gl.glEnable(GL.BLEND)
                gl.glBlendFunc(GL.SRC_ALPHA, GL.ONE_MINUS_SRC_ALPHA)
                gl.glDepthMask(0)
                self._mask_features(features, 0)  # labels and normals, like depth, are those of the opaque surface behind
            self._bind_batch(multi_draw, features, color)
            self._draw_both_sides(not (plan.cull_back_faces and self._closed[multi_draw.batch]))
            self._multi_draw(first, multi_draw.draws)
            first += multi_draw.draws
        self._draw_both_sides(True)
        if blending:
            gl.glDepthMask(1)
            self._mask_features(features, 1)
            gl.glDisable(GL.BLEND)
            gl.glBindVertexArray(self._memory.array)
        elif color:
            self._draw_sky(features)

    def _bind_batch(self, multi_draw: MultiDraw, features: tuple[Feature, ...], color: bool) -> None:
        """Binds the program and the textures of a multi-draw."""
        batch = self._geometry.batches[multi_draw.batch]
        program = self._programs.of(multi_draw.batch, features, color=color)
        self._programs.set_uniforms(program, batch.material, translucent=multi_draw.translucent)
        if batch.texture >= 0:
            self._gl.glBindTextureUnit(0, self._memory.textures[batch.texture])
        if batch.maps >= 0 and self._material_maps is not None:
            self._material_maps.bind_maps(batch.maps)
        if batch.light_map >= 0 and color and self._light_maps is not None:
            self._light_maps.bind(batch.light_map)
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
        """Returns whether any geometry belongs to a link."""
        return bool(self._moving.any())

    def bounds(self, T_world_links: F64) -> F64:
        """Returns the bounding box of the scene, (2, 3), world frame, metres."""
        return self._visibility.bounds(T_world_links)

    def link_boxes(self) -> tuple[F64, F64]:
        """Returns T_world_links, (L + 1, 4, 4), the world first, and the box of each link in its frame, (L', 6), centre and half extents."""
        return self._T_world_links, self._visibility.link_box

    def draw_moving_depth(self, pictures: Sequence[PinholePicture]) -> None:
        """Draws the opaque depth of moving links into the bound framebuffer; the last call of ``draw`` must have drawn these pictures."""
        plans = [plan.subset(self._moving[plan.batch] & (np.arange(len(plan.batch)) < plan.opaque)) for plan in self._plans]
        if not any(len(plan.draws) for plan in plans):
            return
        assert len(plans) == len(pictures)
        self._prepare_state()
        self._bind()
        self._upload_draws([plan.draws for plan in plans])
        first = 0
        for number, (plan, picture) in enumerate(zip(plans, pictures, strict=True)):
            self._bind_picture(picture, number)
            for multi_draw in plan.multi_draws():
                self._bind_batch(multi_draw, (), color=False)
                self._draw_both_sides(not (plan.cull_back_faces and self._closed[multi_draw.batch]))
                self._multi_draw(first, multi_draw.draws)
                first += multi_draw.draws
        self._draw_both_sides(True)

    def draw_moving_translucent(self, target: RenderTarget) -> None:
        """Draws the translucent surfaces that ``draw`` left out into the colours of a target that has the depth of the same pictures."""
        plans = self._later
        if not any(len(plan.draws) for plan in plans):
            return
        gl = self._gl
        self._prepare_state()
        target.use()
        self._bind()
        gl.glBindVertexArray(self._memory.sorted_array)
        self._upload_draws([plan.draws for plan in plans])
        gl.glEnable(GL.BLEND)
        gl.glBlendFunc(GL.SRC_ALPHA, GL.ONE_MINUS_SRC_ALPHA)
        gl.glDepthMask(0)
        self._mask_features(target.features, 0)
        first = 0
        for number, plan in enumerate(plans):
            self._bind_picture(plan.picture, number)
            for multi_draw in plan.multi_draws():
                self._bind_batch(multi_draw, target.features, color=True)
                self._multi_draw(first, multi_draw.draws)
                first += multi_draw.draws
        gl.glDepthMask(1)
        self._mask_features(target.features, 1)
        gl.glDisable(GL.BLEND)
        gl.glBindVertexArray(self._memory.array)

    def draw_depth(self, clip_from_world: Mat4, T_world_links: F64, texel: float, *, static: bool, moving: bool) -> None:
        """Draws the opaque pass into the bound depth buffer; ``set_links`` must have been called with these poses.

        Args:
            clip_from_world: (4, 4), orthographic projection.
            T_world_links: (L + 1, 4, 4).
            texel: largest geometric error of surfaces, metres.
            static: draw static geometry.
            moving: draw geometry of links.
        """
        clusters = self._visibility.select_for_error(texel)
        plan = self._planner.opaque_plan(clusters[np.where(self._moving, moving, static)[self._visibility.batch_of[clusters]]])
        if not len(plan.draws):
            return
        view = np.zeros(1, dtype=VIEW)
        view["clip"][0] = clip_from_world.T
        self._upload(self._views, view)
        self._upload_draws([plan.draws])
        self._bind()
        self._gl.glBindBufferRange(GL.UNIFORM_BUFFER, _VIEWS, self._views, 0, VIEW.itemsize)
        first = 0
        for multi_draw in plan.multi_draws():
            self._bind_batch(multi_draw, (), color=False)
            self._multi_draw(first, multi_draw.draws)
            first += multi_draw.draws

    def _mask_features(self, features: tuple[Feature, ...], write: int) -> None:
        for feature in features:
            self._gl.glColorMaski(ATTACHMENT[feature], write, write, write, write)

    def close(self) -> None:
        """Frees all GPU resources; a second call does nothing."""
        buffers, self._buffers = self._buffers, []
        for part in (self._lighting, self._material_maps, self._light_maps, self._shadow, self._memory, self._programs):
            if part is not None:
                part.close()
        for buffer in buffers:
            self._gl.delete("glDeleteBuffers", buffer)
