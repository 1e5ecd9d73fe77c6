"""What is drawn of a picture: pieces of chunks, large triangles, and draws that are made one."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from gibson_sim.description.shapes import Shape, VisualSpec
from gibson_sim.formats.load_mesh import primitive_mesh
from gibson_sim.geometry.transforms import R_LINK_OPTICAL
from gibson_sim.render.batching.batches import Batches
from gibson_sim.render.batching.building import build_batches
from gibson_sim.render.culling.draw_plan import VIEW, Picture, Plan, Planner
from gibson_sim.render.culling.occluders import LARGE_M2, Occluders
from gibson_sim.render.culling.pieces import PIECE_TRIANGLES, Pieces
from gibson_sim.render.culling.visibility import Visibility
from gibson_sim.types import Pose, Rgba

GLASS: Rgba = (0.2, 0.4, 0.9, 0.4)


def _visual(name: str, shape: Shape, x: float, link: str = "", color: Rgba = (0.5, 0.5, 0.5, 1.0)) -> VisualSpec:
    return VisualSpec(name, link, shape, Pose((x, 0.0, 0.0)), color)


@pytest.fixture(scope="module")
def batches() -> Batches:
    """A wall, a ball of many triangles, a moving one, and a ball of glass, along the x axis."""
    ball = Shape("sphere", (0.4, 0.4, 0.4))
    visuals = (
        _visual("wall", Shape("box", (0.1, 2.0, 2.0)), 2.0), _visual("ball", ball, 4.0),
        _visual("moving", ball, 6.0, "a"), _visual("glass", ball, 1.0, "", GLASS),
    )  # fmt: skip
    return build_batches(visuals, ("a",), primitive_mesh)


def _plan(b: Batches) -> Plan:
    T_world_camera = np.eye(4)
    T_world_camera[:3, :3] = R_LINK_OPTICAL
    K = np.array([[32.0, 0.0, 31.5], [0.0, 32.0, 31.5], [0.0, 0.0, 1.0]])
    planner, view = Planner(b, Visibility(b), 0.0, cull=True), np.zeros(1, dtype=VIEW)[0]
    return planner.plan(Picture(T_world_camera, K, 64, 64, 0.05), np.stack([np.eye(4)] * 2), view)


def _indices(b: Batches, draws: np.ndarray) -> list[int]:
    return [int(i) for count, _, first, _, _ in draws.tolist() for i in b.indices[first : first + count]]


def test_pieces_have_the_triangles_of_their_chunks_in_their_order_and_boxes_about_them(batches: Batches) -> None:
    chunks = np.array([2, 0, 2, len(batches.chunk_first) - 1])
    place, box, span = Pieces(batches).of(chunks)
    assert (np.diff(place) >= 0).all()
    for k, chunk in enumerate(chunks.tolist()):
        rows = np.flatnonzero(place == k)
        first, count = int(batches.chunk_first[chunk]), int(batches.chunk_count[chunk])
        found = np.concatenate([np.arange(f, f + n) for n, f in span[rows].tolist()])
        np.testing.assert_array_equal(found, np.arange(first, first + count))
        for row in rows:
            n, f = span[row].tolist()
            assert 0 < n <= 3 * PIECE_TRIANGLES
            corners = batches.vertices["position"][batches.indices[f : f + n]]
            np.testing.assert_allclose(box[row, :3] - box[row, 3:], corners.min(axis=0), atol=1e-6)
            np.testing.assert_allclose(box[row, :3] + box[row, 3:], corners.max(axis=0), atol=1e-6)


def test_large_triangles_are_those_of_solid_things_from_an_area_on(batches: Batches) -> None:
    occluders = Occluders()
    occluders.take(batches, 0)
    found = [
        tuple(batches.vertices["position"][i].tolist())
        for first, count in zip(occluders.first, occluders.count, strict=True)
        for i in occluders.indices[first : first + count]
    ]
    # Of the wall the two large sides, of two triangles each, of 2 m2, and the four edges, of 0.1 m2; of the balls nothing.
    assert 4 * 3 <= len(found) <= 12 * 3
    assert LARGE_M2 < 2.0
    assert {round(abs(x - 2.0), 4) for x, _, _ in found} == {0.05}


def test_large_triangles_that_were_known_are_not_looked_at_again(batches: Batches) -> None:
    fresh, grown = Occluders(), Occluders()
    fresh.take(batches, 0)
    half = batches.chunk_first < np.median(batches.chunk_first)
    names = ("chunk_first", "chunk_count", "chunk_link", "chunk_placement")
    fewer = replace(batches, batches=(), **{name: getattr(batches, name)[half] for name in names})
    grown.take(fewer, 0)
    same = int((batches.chunk_first[half] + batches.chunk_count[half]).max())
    grown.take(batches, same)
    for first, count, of in zip(fresh.first, fresh.count, range(len(fresh.first)), strict=True):
        again = grown.indices[grown.first[of] : grown.first[of] + grown.count[of]]
        np.testing.assert_array_equal(fresh.indices[first : first + count], again)


def test_draws_that_follow_each_other_become_one_and_draw_the_same_in_the_same_order(batches: Batches) -> None:
    planner = Planner(batches, Visibility(batches), 0.0, cull=True)
    whole = _plan(batches)
    cut = planner.pieces(whole).cut
    joined = cut.joined()
    assert len(joined.draws) <= len(whole.draws) < len(cut.draws)
    for plan in (cut, joined):
        solid = [plan.draws[: plan.solid], plan.draws[plan.solid :]]
        expected = [whole.draws[: whole.solid], whole.draws[whole.solid :]]
        assert [_indices(batches, draws) for draws in solid] == [_indices(batches, draws) for draws in expected]
    runs = [(run.batch, run.translucent) for run in whole.runs()]
    assert [(run.batch, run.translucent) for run in joined.runs()] == runs
    assert sum(run.draws for run in joined.runs()) == len(joined.draws)


def test_what_shines_through_becomes_few_draws_of_the_same_triangles_from_far_to_near(batches: Batches) -> None:
    whole = _plan(batches)
    triangles = len(whole.draws) - whole.solid
    assert triangles > 100  # the ball of glass, triangle by triangle
    gathered, indices = whole.gathered(batches.indices, before=7)
    assert len(gathered.draws) - gathered.solid == 1
    (count, _, first, _, placement) = gathered.draws[gathered.solid].tolist()
    assert (count, first) == (len(indices), 7)
    assert placement == whole.draws[whole.solid, 4]
    assert indices.tolist() == _indices(batches, whole.draws[whole.solid :])
    np.testing.assert_array_equal(gathered.draws[: gathered.solid], whole.draws[: whole.solid])
    assert [(run.batch, run.translucent) for run in gathered.runs()] == [(run.batch, run.translucent) for run in whole.runs()]
    assert [run.draws for run in gathered.runs()][-1] == 1


def test_what_shines_through_keeps_its_order_among_batches_and_placements() -> None:
    draws = np.array(
        [[3, 1, 0, 0, 0], [3, 1, 9, 0, 0], [3, 1, 3, 0, 0], [6, 1, 12, 0, 1], [3, 1, 6, 0, 1], [3, 1, 18, 0, 1]], dtype=np.uint32
    )
    picture = Picture(np.eye(4), np.eye(3), 1, 1, 0.05)
    plan = Plan(picture, np.zeros((0, 4, 4)), np.arange(6), draws, np.array([0, 1, 1, 1, 1, 2]), 1, np.arange(0), 7, fronts=False)
    gathered, indices = plan.gathered(np.arange(100, 130, dtype=np.uint32))
    assert gathered.draws[:, [0, 2, 4]].tolist() == [[3, 0, 0], [6, 0, 0], [9, 6, 1], [3, 15, 1]]
    assert gathered.batch.tolist() == [0, 1, 1, 2]
    assert indices.tolist() == [*range(109, 112), *range(103, 106), *range(112, 118), *range(106, 109), *range(118, 121)]


def test_where_nothing_shines_through_nothing_is_gathered() -> None:
    draws = np.array([[3, 1, 0, 0, 0]], dtype=np.uint32)
    picture = Picture(np.eye(4), np.eye(3), 1, 1, 0.05)
    plan = Plan(picture, np.zeros((0, 4, 4)), np.arange(1), draws, np.array([0]), 1, np.arange(0), 1, fronts=False)
    gathered, indices = plan.gathered(np.arange(3, dtype=np.uint32))
    assert gathered is plan
    assert len(indices) == 0


def test_gaps_and_other_placements_keep_draws_apart() -> None:
    draws = np.array(
        [[3, 1, 0, 0, 0], [3, 1, 3, 0, 0], [3, 1, 9, 0, 0], [3, 1, 12, 0, 1], [3, 1, 15, 0, 1], [3, 1, 18, 0, 1]], dtype=np.uint32
    )
    picture = Picture(np.eye(4), np.eye(3), 1, 1, 0.05)
    plan = Plan(picture, np.zeros((0, 4, 4)), np.arange(6), draws, np.array([0, 0, 0, 0, 0, 0]), 5, np.arange(0), 6, fronts=False)
    joined = plan.joined()
    assert joined.draws[:, [0, 2, 4]].tolist() == [[6, 0, 0], [3, 9, 0], [6, 12, 1], [3, 18, 1]]
    assert joined.solid == 3


def test_glass_is_drawn_once_and_from_far_to_near(batches: Batches) -> None:
    plan = _plan(batches)
    glass = next(k for k, batch in enumerate(batches.batches) if batch.kind == "blend")
    assert glass not in plan.batch[: plan.solid]
    assert set(plan.batch[plan.solid :].tolist()) == {glass}
    distance = batches.chunk_box[plan.chunks[plan.solid :], 0]
    assert distance[0] > distance[-1]
