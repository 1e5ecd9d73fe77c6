"""What to draw of one picture, and in which order.

The order is that of all chunks inside the image, whatever is left out of them later because something hides it: of two surfaces at the
very same depth the one that is drawn first is seen, and which one that is must not depend on anything else.
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
from gibson_sim.render.batching.batches import Batches
from gibson_sim.render.culling import occlusion_culling
from gibson_sim.render.culling.closed_solids import Insides
from gibson_sim.render.culling.occlusion import DepthPyramid, Outlines, pixels_from_links
from gibson_sim.render.culling.pieces import Pieces
from gibson_sim.render.culling.visibility import Visibility, link_frames
from gibson_sim.render.lod import lod_selection
from gibson_sim.render.lod.lod_selection import Detail, Rules

F64 = NDArray[np.float64]
F32 = NDArray[np.float32]
I64 = NDArray[np.int64]
U32 = NDArray[np.uint32]

VIEW = np.dtype(
    [("clip", "<f4", (4, 4)), ("clip_before", "<f4", (4, 4)), ("optical", "<f4", (4, 4)), ("eye", "<f4", 4), ("size", "<f4", 4), ("pad", "<f4", 8)]
)  # fmt: skip
"""``View`` of the shaders, matrices by columns, padded to the alignment of uniform buffers."""
KINDS = tuple(product((False, True), (False, True)))
"""Of draws that fill the depth: whether they move, and whether all of their triangles belong to closed solids."""
_NEAR_PART = 0.25
"""Part of the triangles that count as the nearest ones."""


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


class Run(NamedTuple):
    """Draws that follow each other and share their settings."""

    batch: int
    draws: int
    translucent: bool
    """Draw what shines through of them, instead of what is solid."""


@dataclass(frozen=True, slots=True, eq=False)
class Plan:
    """What to draw of one picture."""

    picture: Picture
    T_camera_links: F64
    """(L + 1, 4, 4): optical frame from the world, then from each link."""
    chunks: I64
    """(N,), in the order in which they are drawn: first what is solid of them, batch by batch, then what shines through, from far to near."""
    draws: U32
    """(N, 5), rows of ``draw_table``, of these chunks or of pieces of them."""
    batch: I64
    """(N,), batch of each."""
    solid: int
    """How many of the first ones are solid."""
    near: I64
    """The nearest chunks without holes, about a quarter of all."""
    triangles: int
    """Of all solid chunks inside the image, hidden or not."""
    fronts: bool
    """Of closed solids only the fronts are drawn: they are all that is seen."""

    def runs(self, *, translucent: bool = True) -> list[Run]:
        """Returns the draws by their settings; what shines through only if asked for."""
        end = len(self.batch) if translucent else self.solid
        if not end:
            return []
        batch = self.batch[:end]
        starts = (np.flatnonzero(batch[1:] != batch[:-1]) + 1).tolist()
        if 0 < self.solid < end and self.solid not in starts:
            insort(starts, self.solid)
        starts.insert(0, 0)
        ends = [*starts[1:], end]
        return [Run(k, e - s, s >= self.solid) for k, s, e in zip(batch[starts].tolist(), starts, ends, strict=True)]

    def only(self, keep: NDArray[np.bool_]) -> Plan:
        """Returns the plan of some of the draws, (N,), in the same order."""
        return replace(
            self,
            chunks=self.chunks[keep],
            draws=self.draws[keep],
            batch=self.batch[keep],
            solid=int(np.count_nonzero(keep[: self.solid])),
        )

    def joined(self) -> Plan:
        """Returns the plan with draws made one that follow each other in the indices, too, and differ in nothing else."""
        if not len(self.draws):
            return self
        count, first = self.draws[:, 0], self.draws[:, 2]
        begins = self._unlike()
        begins[1:] |= first[1:] != first[:-1] + count[:-1]
        return self._joined(begins)

    def gathered(self, indices: U32, before: int = 0) -> tuple[Plan, U32]:
        """Returns the plan with few draws of what shines through, and the indices that these read instead of ``indices``.

        What shines through is drawn triangle by triangle, from far to near. Each of these draws costs more than its triangle does.

        Args:
            indices: that the draws of this plan read.
            before: so many others come before the ones returned.
        """
        back = self.draws[self.solid :]
        if not len(back):
            return self, np.zeros(0, dtype=np.uint32)
        count = back[:, 0].astype(np.int64)
        begin = np.cumsum(count) - count
        rows = np.arange(int(count.sum())) + np.repeat(back[:, 2] - begin, count)
        draws = self.draws.copy()
        draws[self.solid :, 2] = begin + before
        begins = self._unlike()
        begins[: self.solid] = True
        return replace(self, draws=draws)._joined(begins), indices[rows]

    def _unlike(self) -> NDArray[np.bool_]:
        """Returns which draws, (N,), differ from the one before in more than what triangles they have."""
        placement, begins = self.draws[:, 4], np.ones(len(self.draws), dtype=bool)
        begins[1:] = (placement[1:] != placement[:-1]) | (self.batch[1:] != self.batch[:-1])
        begins[self.solid : self.solid + 1] = True
        return begins

    def _joined(self, begins: NDArray[np.bool_]) -> Plan:
        """Returns the plan with each draw that does not begin a new one, (N,), made one with those before it."""
        starts = np.flatnonzero(begins)
        draws = self.draws[starts]
        draws[:, 0] = np.add.reduceat(self.draws[:, 0], starts)
        return replace(
            self,
            chunks=self.chunks[starts],
            draws=draws,
            batch=self.batch[starts],
            solid=int(np.searchsorted(starts, self.solid)),
        )


class Planner:
    """Makes plans for one scene.

    Args:
        batches: of the scene.
        visibility: of the same batches.
        detail_px: how far, pixels, levels of detail may put a surface from where it is; 0 = always draw all triangles.
        cull: leave out what is outside the image.
        loops: by compiled loops instead of NumPy; the plans are the same.
    """

    def __init__(
        self, batches: Batches, visibility: Visibility, detail_px: float, *, cull: bool, loops: bool = CAN_COMPILE
    ) -> None:
        self._b, self._visibility, self._detail_px, self._cull, self._loops = batches, visibility, detail_px, cull, loops
        self._table, self._pieces = draw_table(batches, batches.chunk_first, batches.chunk_count), Pieces(batches)
        self._insides = Insides(batches.solid_box, batches.solid_link, loops=loops)
        self._kinds = np.array([KINDS.index((batch.moving, batch.closed)) for batch in batches.batches], dtype=np.int64)
        cut = np.array([batch.kind != "opaque" for batch in batches.batches], dtype=bool)
        has_solid, has_back = _what_shines_through(batches)
        self._rules = Rules(fixed(visibility.batch_of), fixed(cut), fixed(has_solid), fixed(has_back), fixed(self._table))

    @property
    def table(self) -> U32:
        """(C, 5), as ``draw_table`` returns it."""
        return self._table

    def plan(self, picture: Picture, T_world_links: F64, view: NDArray[np.void]) -> Plan:
        """Chooses what to draw of one picture, and fills its ``view``."""
        T_camera_links, eyes = link_frames(picture.T_world_camera, T_world_links, loops=self._loops)
        # The flip: optical y points down and clip y points up, so row 0 of the image comes first in OpenGL's bottom-up memory.
        projection, planes, near_corners = _lens(picture.intrinsics.tobytes(), picture.width, picture.height, picture.near)
        before = picture.T_world_camera if picture.T_world_camera_before is None else picture.T_world_camera_before
        view["clip"] = (projection @ T_camera_links[0]).T
        still = before is picture.T_world_camera
        view["clip_before"] = (
            view["clip"] if still else (projection @ link_frames(before, T_world_links[:1], loops=self._loops)[0][0]).T
        )
        view["optical"][:3, :3] = picture.T_world_camera[:3, :3]  # transposed once to turn, once to be by columns
        view["eye"][:3] = eyes[0]
        view["size"][:3] = picture.width, picture.height, picture.near
        focal = float(max(abs(picture.intrinsics[0, 0]), abs(picture.intrinsics[1, 1])))
        detail = Detail(focal, self._detail_px, picture.near)
        planes = planes if self._cull else planes[:0]
        if not self._loops:
            chunks = self._visibility.nearest_first(eyes, detail, planes, T_camera_links)
            return self._ordered(
                picture, T_camera_links, chunks, fronts=not self._insides.may_hold(eyes, T_camera_links, near_corners)
            )
        v = self._visibility
        found = lod_selection.planned(
            eyes, T_camera_links, planes, near_corners, detail, v.groups, v.chunks, v.link_box, self._insides.solids, self._rules, _NEAR_PART
        )  # fmt: skip
        return Plan(picture, T_camera_links, *found)

    def solid(self, chunks: I64) -> Plan:
        """Returns a plan that draws what is solid of these chunks, for a picture of no camera."""
        plan = self._ordered(Picture(np.eye(4), np.eye(3), 0, 0, 0.0), np.zeros((0, 4, 4)), chunks, fronts=False)
        return plan.only(np.arange(len(plan.chunks)) < plan.solid)

    def _ordered(self, picture: Picture, T_camera_links: F64, chunks: I64, *, fronts: bool) -> Plan:
        """Returns the plan for chunks that come the nearest first."""
        batch = self._visibility.batch_of
        every, solid, near, total = self._order(chunks, batch[chunks])
        drawn = chunks[every]
        return Plan(picture, T_camera_links, drawn, self._table[drawn], batch[drawn], solid, near, total, fronts)

    def _order(self, chunks: I64, batch: I64) -> tuple[I64, int, I64, int]:
        """The same as ``lod_selection.drawing_order``, of chunks and the batch of each."""
        # The order of batches is that of their first chunk, but what has holes comes after what has none.
        rank = np.zeros(len(self._rules.cut), dtype=np.int64)
        rank[batch[::-1]] = np.arange(len(chunks) - 1, -1, -1)  # of several numbers the last one stays: that of the first chunk
        rank += len(chunks) * self._rules.cut
        order = np.argsort(rank[batch], kind="stable")
        order = order[self._rules.has_solid[chunks[order]]]
        back = np.flatnonzero(self._rules.has_back[chunks])[::-1]
        triangles = np.cumsum(self._b.chunk_count[chunks], dtype=np.int64) // 3
        total = int(triangles[-1]) if len(chunks) else 0
        split = int(np.searchsorted(triangles, total * _NEAR_PART))
        return np.concatenate([order, back]), len(order), chunks[:split][~self._rules.cut[batch[:split]]], total

    def by_kind(self, chunks: I64, table: U32) -> tuple[U32, list[int]]:
        """Returns the draws of chunks, (N,), by rows of ``table``, (C, 5), those of a kind together; and how many each of ``KINDS`` has."""
        if self._loops:
            draws, count = lod_selection.by_kind(chunks, fixed(table), self._rules.batch_of, self._kinds, len(KINDS))
            return draws, count.tolist()
        chunks = chunks[table[chunks, 0] > 0]
        kind = self._kinds[self._rules.batch_of[chunks]]
        return table[chunks[np.argsort(kind, kind="stable")]], np.bincount(kind, minlength=len(KINDS)).tolist()

    def occlusion_queries(self, plans: Sequence[Plan]) -> list[OcclusionQuery]:
        """Returns, of each plan, what finds out which parts of it are hidden; it does what can be done before there is a depth image."""
        return [
            CompiledOcclusionQuery(plan, self._visibility.chunks.link, self._pieces) if self._loops else self.pieces(plan)
            for plan in plans
        ]

    def pieces(self, plan: Plan) -> NumpyOcclusionQuery:
        """Returns the plan cut into smaller draws, and where each of them lies."""
        place, box, span = self._pieces.of(plan.chunks)
        draws = plan.draws[place]
        draws[:, 0], draws[:, 2] = span[:, 0], span[:, 1]
        chunks, p = plan.chunks[place], plan.picture
        matrices = pixels_from_links(plan.T_camera_links, p.intrinsics)[self._b.chunk_link[chunks]]
        first_back = int(np.searchsorted(place, plan.solid))
        cut = replace(plan, chunks=chunks, draws=draws, batch=plan.batch[place], solid=first_back)
        return NumpyOcclusionQuery(cut, Outlines(box, matrices, (p.width, p.height), p.near))


class OcclusionQuery(Protocol):
    """Finds out what of a plan is hidden."""

    def unhidden(self, depth: F32) -> Plan:
        """Returns the plan of what may be seen past a depth image of the picture, (H, W), ``near / depth``, 0 = nothing."""


@dataclass(frozen=True, slots=True)
class NumpyOcclusionQuery:
    """A plan cut into pieces, and where each of them lies."""

    cut: Plan
    outlines: Outlines

    def unhidden(self, depth: F32) -> Plan:
        """As ``OcclusionQuery`` says."""
        return self.cut.only(~self.outlines.hidden(DepthPyramid(depth))).joined()


class CompiledOcclusionQuery:
    """The same by compiled loops, which need no preparation but that the pieces are known."""

    def __init__(self, plan: Plan, chunk_link: I64, pieces: Pieces) -> None:
        self._plan, self._chunk_link, self._pieces = plan, chunk_link, pieces
        pieces.prepare(plan.chunks)

    def unhidden(self, depth: F32) -> Plan:
        """As ``OcclusionQuery`` says."""
        plan, p = self._plan, self._plan.picture
        chunks, batch, draws, solid = occlusion_culling.without_hidden(
            fixed(depth), plan.chunks, plan.batch, plan.draws, plan.solid, self._pieces.table, self._chunk_link,
            plan.T_camera_links, fixed(p.intrinsics), float(p.near),
        )  # fmt: skip
        return replace(plan, chunks=chunks, draws=draws, batch=batch, solid=solid)


def draw_table(b: Batches, first: NDArray[Any], count: NDArray[Any]) -> U32:
    """Returns the indirect draw of each chunk, (C, 5): indices, instances, first index, base vertex, base instance."""
    table = np.zeros((len(first), 5), dtype=np.uint32)
    table[:, 0], table[:, 1], table[:, 2], table[:, 4] = count, 1, first, b.chunk_placement
    return table


def _what_shines_through(b: Batches) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
    """Returns of which chunks something may be solid, and through which of them something may shine, (C,) each."""
    solid, back = np.ones(len(b.chunk_first), dtype=bool), np.zeros(len(b.chunk_first), dtype=bool)
    for batch in b.batches:
        if batch.kind == "blend":
            chunks = slice(batch.first_chunk, batch.end_chunk)
            back[chunks] = True
            if batch.texture < 0:  # else each texel decides
                solid[chunks], back[chunks] = _solidity(b, chunks)
    return solid, back


def _solidity(b: Batches, chunks: slice) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
    """Returns of which chunks some material is solid, and of which some is not; they have no textures."""
    count = b.chunk_count[chunks].astype(np.int64)
    starts = np.cumsum(count) - count
    rows = np.arange(int(count.sum())) + np.repeat(b.chunk_first[chunks] - starts, count)
    placed = b.placements["material"][b.chunk_placement[chunks]]
    material = b.materials[b.vertices["material"][b.indices[rows]] + np.repeat(placed, count)]
    solid = material["color"][:, 3] >= material["surface"][:, 2]
    return np.logical_or.reduceat(solid, starts), np.logical_or.reduceat(~solid, starts)


@lru_cache(maxsize=256)
def _lens(intrinsics: bytes, width: int, height: int, near: float) -> tuple[F64, F64, F64]:
    """Returns the projection, (4, 4), the planes of the frustum, (5, 4), and the corners of the picture at the near distance, (4, 3), metres.

    Args:
        intrinsics: the bytes of K, (3, 3) float64.
        width: pixels.
        height: pixels.
        near: metres.
    """
    k = np.frombuffer(intrinsics, dtype=np.float64).reshape(3, 3)
    pixels = np.array([[u, v, 1.0] for u in (-0.5, width - 0.5) for v in (-0.5, height - 0.5)])
    return (
        clip_from_optical(k, width, height, near),
        frustum_planes(k, width, height, near),
        near * np.linalg.solve(k, pixels.T).T,
    )
