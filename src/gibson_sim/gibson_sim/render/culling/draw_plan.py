"""Plans the draws of one picture and their order.

The order is determined by all clusters inside the image, including those culled later as hidden: of two surfaces at exactly the same
depth, the one drawn first is visible, and occlusion culling must not change which one that is.

A *draw* is one indirect draw command, a row of ``draw_table``. The draws of the opaque pass come first, batch by batch; those of the
translucent pass follow, from far to near.
"""

from __future__ import annotations

from bisect import insort
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from itertools import product
from typing import Any, NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from gibson_sim.geometry.compiling import CAN_COMPILE, fixed
from gibson_sim.geometry.projections import clip_from_optical, frustum_planes
from gibson_sim.geometry.transforms import Mat4
from gibson_sim.render.batching.scene_geometry import SceneGeometry
from gibson_sim.render.culling import occlusion_culling
from gibson_sim.render.culling.closed_surfaces import NearPlaneTest
from gibson_sim.render.culling.occlusion import DepthPyramid, ScreenBounds, Subclusters, pixels_from_links
from gibson_sim.render.culling.visibility import Visibility, link_frames
from gibson_sim.render.lod import lod_selection
from gibson_sim.render.lod.lod_selection import DetailLimits, DrawOrderRules

F64 = NDArray[np.float64]
F32 = NDArray[np.float32]
I64 = NDArray[np.int64]
U32 = NDArray[np.uint32]

VIEW = np.dtype(
    [("clip", "<f4", (4, 4)), ("clip_before", "<f4", (4, 4)), ("optical", "<f4", (4, 4)), ("eye", "<f4", 4), ("size", "<f4", 4), ("pad", "<f4", 8)]
)  # fmt: skip
"""Uniform block ``View`` of the shaders, column-major matrices, padded to the alignment of uniform buffers."""
DEPTH_KINDS = tuple(product((False, True), (False, True)))
"""Kinds of draws of the depth pass: (moving, closed), as in ``Batch``."""
_NEAR_PART = 0.25
"""Fraction of the triangles that counts as the nearest ones."""


@dataclass(frozen=True, slots=True, eq=False)
class PinholePicture:
    """One pinhole picture to draw into a rectangle of a target."""

    T_world_camera: Mat4
    """Pose of the optical frame."""
    intrinsics: F64
    """K, (3, 3), pixels, pixel centres at whole numbers."""
    width: int
    """Width, pixels."""
    height: int
    near: float
    """Depth of the near plane, metres."""
    x: int = 0
    """Left column in the target."""
    y: int = 0
    """Top row in the target."""
    T_world_camera_before: Mat4 | None = None
    """Camera pose in the previous state, for optical flow; None = no motion."""

    def crop(self, image: NDArray[np.float32]) -> NDArray[np.float32]:
        """Returns a view of the picture's rectangle in an image of the target."""
        return image[self.y : self.y + self.height, self.x : self.x + self.width]


class MultiDraw(NamedTuple):
    """Consecutive draws of one batch and one pass, sent by one OpenGL call."""

    batch: int
    draws: int
    translucent: bool
    """Whether they belong to the translucent pass instead of the opaque pass."""


@dataclass(frozen=True, slots=True, eq=False)
class DrawPlan:
    """The draws of one picture, in drawing order."""

    picture: PinholePicture
    T_camera_links: F64
    """(L + 1, 4, 4): optical frame from the world, then from each link."""
    clusters: I64
    """(N,), cluster of each draw."""
    draws: U32
    """(N, 5), rows of ``draw_table``, of these clusters or of their subclusters."""
    batch: I64
    """(N,), batch of each draw."""
    opaque: int
    """Number of draws of the opaque pass, which come first."""
    near: I64
    """The nearest clusters without alpha-tested holes, about a quarter of all triangles."""
    triangles: int
    """Number of triangles of all clusters inside the image, including hidden ones."""
    cull_back_faces: bool
    """Whether back faces of closed surfaces are culled, because none is visible in the picture."""

    def multi_draws(self, *, translucent: bool = True) -> list[MultiDraw]:
        """Returns the draws grouped by batch and pass.

        Args:
            translucent: include the translucent pass.
        """
        end = len(self.batch) if translucent else self.opaque
        if not end:
            return []
        batch = self.batch[:end]
        starts = (np.flatnonzero(batch[1:] != batch[:-1]) + 1).tolist()
        if 0 < self.opaque < end and self.opaque not in starts:
            insort(starts, self.opaque)
        starts.insert(0, 0)
        ends = [*starts[1:], end]
        return [MultiDraw(k, e - s, s >= self.opaque) for k, s, e in zip(batch[starts].tolist(), starts, ends, strict=True)]

    def subset(self, keep: NDArray[np.bool_]) -> DrawPlan:
        """Returns the plan with only the draws to keep, (N,), in the same order."""
        return replace(
            self,
            clusters=self.clusters[keep],
            draws=self.draws[keep],
            batch=self.batch[keep],
            opaque=int(np.count_nonzero(keep[: self.opaque])),
        )

    def merged(self) -> DrawPlan:
        """Returns the plan with consecutive draws merged if their indices are consecutive and they differ only in these."""
        if not len(self.draws):
            return self
        count, first = self.draws[:, 0], self.draws[:, 2]
        begins = self._changes()
        begins[1:] |= first[1:] != first[:-1] + count[:-1]
        return self._merged(begins)

    def sorted_translucent(self, indices: U32, before: int = 0) -> tuple[DrawPlan, U32]:
        """Returns the plan with few translucent draws, and the index array that these read instead of ``indices``.

        Translucent triangles are drawn one by one, from far to near, and a draw costs more than its triangle. Sorted indices reduce
        them to a few draws.

        Args:
            indices: index array read by the draws of this plan.
            before: number of indices that precede the returned ones in the buffer.
        """
        back = self.draws[self.opaque :]
        if not len(back):
            return self, np.zeros(0, dtype=np.uint32)
        count = back[:, 0].astype(np.int64)
        begin = np.cumsum(count) - count
        rows = np.arange(int(count.sum())) + np.repeat(back[:, 2] - begin, count)
        draws = self.draws.copy()
        draws[self.opaque :, 2] = begin + before
        begins = self._changes()
        begins[: self.opaque] = True
        return replace(self, draws=draws)._merged(begins), indices[rows]

    def _changes(self) -> NDArray[np.bool_]:
        """Returns a mask, (N,), of the draws that differ from the preceding one in more than their triangles."""
        placement, changes = self.draws[:, 4], np.ones(len(self.draws), dtype=bool)
        changes[1:] = (placement[1:] != placement[:-1]) | (self.batch[1:] != self.batch[:-1])
        changes[self.opaque : self.opaque + 1] = True
        return changes

    def _merged(self, begins: NDArray[np.bool_]) -> DrawPlan:
        """Returns the plan with each draw merged into the preceding one unless ``begins``, (N,), is set."""
        starts = np.flatnonzero(begins)
        draws = self.draws[starts]
        draws[:, 0] = np.add.reduceat(self.draws[:, 0], starts)
        return replace(
            self,
            clusters=self.clusters[starts],
            draws=draws,
            batch=self.batch[starts],
            opaque=int(np.searchsorted(starts, self.opaque)),
        )


class DrawPlanner:
    """Plans the draws of pictures of one scene.

    Args:
        geometry: geometry of the scene.
        visibility: cluster selection for the same geometry.
        detail_px: largest screen-space error of levels of detail, pixels; 0 = always draw all triangles.
        cull: view-frustum culling.
        loops: use compiled loops instead of NumPy; the plans are equal.
    """

    def __init__(
        self, geometry: SceneGeometry, visibility: Visibility, detail_px: float, *, cull: bool, loops: bool = CAN_COMPILE
    ) -> None:
        self._geometry, self._visibility, self._detail_px, self._cull, self._loops = geometry, visibility, detail_px, cull, loops
        self._table = draw_table(geometry, geometry.cluster_first, geometry.cluster_count)
        self._subclusters = Subclusters(geometry)
        self._near_plane = NearPlaneTest(geometry.closed_box, geometry.closed_link, loops=loops)
        self._depth_kind = np.array(
            [DEPTH_KINDS.index((batch.moving, batch.closed)) for batch in geometry.batches], dtype=np.int64
        )
        has_holes = np.array([batch.alpha_mode != "opaque" for batch in geometry.batches], dtype=bool)
        has_opaque, has_translucent = _passes(geometry)
        self._rules = DrawOrderRules(
            fixed(visibility.batch_of), fixed(has_holes), fixed(has_opaque), fixed(has_translucent), fixed(self._table)
        )

    @property
    def table(self) -> U32:
        """Draw table of all clusters, (C, 5), see ``draw_table``."""
        return self._table

    def plan(self, picture: PinholePicture, T_world_links: F64, view: NDArray[np.void]) -> DrawPlan:
        """Returns the plan of one picture, and fills its ``view``, one element of ``VIEW``."""
        T_camera_links, eyes = link_frames(picture.T_world_camera, T_world_links, loops=self._loops)
        # Flips y: optical y points down and clip y points up, so row 0 of the image comes first in OpenGL's bottom-up memory.
        projection, planes, near_corners = _lens(picture.intrinsics.tobytes(), picture.width, picture.height, picture.near)
        previous = picture.T_world_camera if picture.T_world_camera_before is None else picture.T_world_camera_before
        view["clip"] = (projection @ T_camera_links[0]).T
        still = previous is picture.T_world_camera
        view["clip_before"] = (
            view["clip"] if still else (projection @ link_frames(previous, T_world_links[:1], loops=self._loops)[0][0]).T
        )
        view["optical"][:3, :3] = picture.T_world_camera[:3, :3]  # transposed twice: inverted, and stored column-major
        view["eye"][:3] = eyes[0]
        view["size"][:3] = picture.width, picture.height, picture.near
        focal = float(max(abs(picture.intrinsics[0, 0]), abs(picture.intrinsics[1, 1])))
        detail = DetailLimits(focal, self._detail_px, picture.near)
        planes = planes if self._cull else planes[:0]
        if not self._loops:
            clusters = self._visibility.nearest_first(eyes, detail, planes, T_camera_links)
            cull_back_faces = not self._near_plane.touches(eyes, T_camera_links, near_corners)
            return self._ordered(picture, T_camera_links, clusters, cull_back_faces=cull_back_faces)
        v = self._visibility
        columns = lod_selection.plan_picture(
            eyes, T_camera_links, planes, near_corners, detail, v.groups, v.clusters, v.link_box, self._near_plane.table, self._rules, _NEAR_PART
        )  # fmt: skip
        return DrawPlan(picture, T_camera_links, *columns)

    def opaque_plan(self, clusters: I64) -> DrawPlan:
        """Returns a plan of the opaque pass of clusters, without a camera."""
        no_picture = PinholePicture(np.eye(4), np.eye(3), 0, 0, 0.0)
        plan = self._ordered(no_picture, np.zeros((0, 4, 4)), clusters, cull_back_faces=False)
        return plan.subset(np.arange(len(plan.clusters)) < plan.opaque)

    def _ordered(self, picture: PinholePicture, T_camera_links: F64, clusters: I64, *, cull_back_faces: bool) -> DrawPlan:
        """Returns the plan for clusters sorted nearest first."""
        batch = self._visibility.batch_of
        order, opaque, near, total = self._order(clusters, batch[clusters])
        drawn = clusters[order]
        return DrawPlan(picture, T_camera_links, drawn, self._table[drawn], batch[drawn], opaque, near, total, cull_back_faces)

    def _order(self, clusters: I64, batch: I64) -> tuple[I64, int, I64, int]:
        """Computes ``lod_selection.draw_order`` in NumPy, for clusters and the batch of each."""
        # Batches are sorted by their nearest cluster; batches with alpha-tested holes come after the others.
        rank = np.zeros(len(self._rules.has_holes), dtype=np.int64)
        rank[batch[::-1]] = np.arange(
            len(clusters) - 1, -1, -1
        )  # the last of repeated assignments holds: that of the nearest cluster
        rank += len(clusters) * self._rules.has_holes
        order = np.argsort(rank[batch], kind="stable")
        order = order[self._rules.has_opaque[clusters[order]]]
        back = np.flatnonzero(self._rules.has_translucent[clusters])[::-1]
        triangles = np.cumsum(self._geometry.cluster_count[clusters], dtype=np.int64) // 3
        total = int(triangles[-1]) if len(clusters) else 0
        split = int(np.searchsorted(triangles, total * _NEAR_PART))
        near = clusters[:split][~self._rules.has_holes[batch[:split]]]
        return np.concatenate([order, back]), len(order), near, total

    def depth_draws(self, clusters: I64, table: U32) -> tuple[U32, list[int]]:
        """Returns the draws of the depth pass, sorted by ``DEPTH_KINDS``, and the number of each kind.

        Args:
            clusters: (N,).
            table: (C, 5), see ``draw_table``; draws without indices are omitted.
        """
        if self._loops:
            draws, count = lod_selection.depth_draws(
                clusters, fixed(table), self._rules.batch_of, self._depth_kind, len(DEPTH_KINDS)
            )
            return draws, count.tolist()
        clusters = clusters[table[clusters, 0] > 0]
        kind = self._depth_kind[self._rules.batch_of[clusters]]
        return table[clusters[np.argsort(kind, kind="stable")]], np.bincount(kind, minlength=len(DEPTH_KINDS)).tolist()

    def occlusion_queries(self, plans: Sequence[DrawPlan]) -> list[OcclusionQuery]:
        """Returns an occlusion query for each plan, prepared as far as possible without a depth image."""
        return [
            CompiledOcclusionQuery(plan, self._visibility.clusters.link, self._subclusters)
            if self._loops
            else self.subcluster_query(plan)
            for plan in plans
        ]

    def subcluster_query(self, plan: DrawPlan) -> NumpyOcclusionQuery:
        """Returns the plan split into draws of subclusters, with their screen-space bounds."""
        place, box, span = self._subclusters.of(plan.clusters)
        draws = plan.draws[place]
        draws[:, 0], draws[:, 2] = span[:, 0], span[:, 1]
        clusters, p = plan.clusters[place], plan.picture
        matrices = pixels_from_links(plan.T_camera_links, p.intrinsics)[self._geometry.cluster_link[clusters]]
        opaque = int(np.searchsorted(place, plan.opaque))
        split = replace(plan, clusters=clusters, draws=draws, batch=plan.batch[place], opaque=opaque)
        return NumpyOcclusionQuery(split, ScreenBounds(box, matrices, (p.width, p.height), p.near))


class OcclusionQuery(Protocol):
    """Removes hidden draws from a plan."""

    def visible(self, depth: F32) -> DrawPlan:
        """Returns the plan without draws hidden behind a depth image of the picture, (H, W), ``near / depth``, 0 = nothing."""


@dataclass(frozen=True, slots=True)
class NumpyOcclusionQuery:
    """Occlusion query in NumPy: a plan split into subclusters, and their screen-space bounds."""

    plan: DrawPlan
    bounds: ScreenBounds

    def visible(self, depth: F32) -> DrawPlan:
        """See ``OcclusionQuery.visible``."""
        return self.plan.subset(~self.bounds.hidden(DepthPyramid(depth))).merged()


class CompiledOcclusionQuery:
    """Occlusion query in compiled loops, prepared only by the boxes of the subclusters."""

    def __init__(self, plan: DrawPlan, cluster_link: I64, subclusters: Subclusters) -> None:
        self._plan, self._cluster_link, self._subclusters = plan, cluster_link, subclusters
        subclusters.prepare(plan.clusters)

    def visible(self, depth: F32) -> DrawPlan:
        """See ``OcclusionQuery.visible``."""
        plan, p = self._plan, self._plan.picture
        clusters, batch, draws, opaque = occlusion_culling.cull_hidden(
            fixed(depth), plan.clusters, plan.batch, plan.draws, plan.opaque, self._subclusters.table, self._cluster_link,
            plan.T_camera_links, fixed(p.intrinsics), float(p.near),
        )  # fmt: skip
        return replace(plan, clusters=clusters, draws=draws, batch=batch, opaque=opaque)


def draw_table(b: SceneGeometry, first: NDArray[Any], count: NDArray[Any]) -> U32:
    """Returns the indirect draw of each cluster, (C, 5): indices, instances, first index, base vertex, base instance."""
    table = np.zeros((len(first), 5), dtype=np.uint32)
    table[:, 0], table[:, 1], table[:, 2], table[:, 4] = count, 1, first, b.cluster_placement
    return table


def _passes(b: SceneGeometry) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
    """Returns masks, (C,), of the clusters drawn in the opaque pass and in the translucent pass; a cluster may be in both."""
    opaque, translucent = np.ones(len(b.cluster_first), dtype=bool), np.zeros(len(b.cluster_first), dtype=bool)
    for batch in b.batches:
        if batch.alpha_mode == "blend":
            clusters = slice(batch.first_cluster, batch.end_cluster)
            translucent[clusters] = True
            if batch.texture < 0 and not batch.colored:  # else shaders decide by the alpha of each pixel
                opaque[clusters], translucent[clusters] = _passes_of_untextured(b, clusters)
    return opaque, translucent


def _passes_of_untextured(b: SceneGeometry, clusters: slice) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
    """Returns masks of the clusters with an opaque material and with a translucent material; the clusters have no textures."""
    count = b.cluster_count[clusters].astype(np.int64)
    starts = np.cumsum(count) - count
    rows = np.arange(int(count.sum())) + np.repeat(b.cluster_first[clusters] - starts, count)
    placed = b.placements["material"][b.cluster_placement[clusters]]
    material = b.materials[b.vertices["material"][b.indices[rows]] + np.repeat(placed, count)]
    opaque = material["color"][:, 3] >= material["surface"][:, 2]
    return np.logical_or.reduceat(opaque, starts), np.logical_or.reduceat(~opaque, starts)


@lru_cache(maxsize=256)
def _lens(intrinsics: bytes, width: int, height: int, near: float) -> tuple[F64, F64, F64]:
    """Returns the projection, (4, 4), the planes of the frustum, (5, 4), and the corners of the near plane, (4, 3), metres.

    Args:
        intrinsics: bytes of K, (3, 3) float64.
        width: width, pixels.
        height: height, pixels.
        near: depth of the near plane, metres.
    """
    k = np.frombuffer(intrinsics, dtype=np.float64).reshape(3, 3)
    pixels = np.array([[u, v, 1.0] for u in (-0.5, width - 0.5) for v in (-0.5, height - 0.5)])
    return (
        clip_from_optical(k, width, height, near),
        frustum_planes(k, width, height, near),
        near * np.linalg.solve(k, pixels.T).T,
    )
