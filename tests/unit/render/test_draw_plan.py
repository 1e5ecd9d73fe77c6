"""Draw plans: subclusters, occluders, merged draws, and the order of the translucent pass."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from gibson_sim.description.shapes import Shape, VisualSpec
from gibson_sim.formats.load_mesh import primitive_mesh
from gibson_sim.geometry.transforms import R_LINK_OPTICAL
from gibson_sim.render.batching.building import build_geometry
from gibson_sim.render.batching.scene_geometry import SceneGeometry
from gibson_sim.render.culling.draw_plan import VIEW, DrawPlan, DrawPlanner, PinholePicture
from gibson_sim.render.culling.occlusion import LARGE_M2, SUBCLUSTER_TRIANGLES, Occluders, Subclusters
from gibson_sim.render.culling.visibility import Visibility
from gibson_sim.types import Pose, Rgba

GLASS: Rgba = (0.2, 0.4, 0.9, 0.4)


def _visual(name: str, shape: Shape, x: float, link: str = "", color: Rgba = (0.5, 0.5, 0.5, 1.0)) -> VisualSpec:
    return VisualSpec(name, link, shape, Pose((x, 0.0, 0.0)), color)


@pytest.fixture(scope="module")
def geometry() -> SceneGeometry:
    """A wall, a ball of many triangles, a moving one, and a ball of glass, along the x axis."""
    ball = Shape("sphere", (0.4, 0.4, 0.4))
    visuals = (
        _visual("wall", Shape("box", (0.1, 2.0, 2.0)), 2.0), _visual("ball", ball, 4.0),
        _visual("moving", ball, 6.0, "a"), _visual("glass", ball, 1.0, "", GLASS),
    )  # fmt: skip
    return build_geometry(visuals, ("a",), primitive_mesh)


def _plan(b: SceneGeometry) -> DrawPlan:
    T_world_camera = np.eye(4)
    T_world_camera[:3, :3] = R_LINK_OPTICAL
    K = np.array([[32.0, 0.0, 31.5], [0.0, 32.0, 31.5], [0.0, 0.0, 1.0]])
    planner, view = DrawPlanner(b, Visibility(b), 0.0, cull=True), np.zeros(1, dtype=VIEW)[0]
    return planner.plan(PinholePicture(T_world_camera, K, 64, 64, 0.05), np.stack([np.eye(4)] * 2), view)


def _indices(b: SceneGeometry, draws: np.ndarray) -> list[int]:
    return [int(i) for count, _, first, _, _ in draws.tolist() for i in b.indices[first : first + count]]


def test_subclusters_have_the_triangles_of_their_clusters_in_order_and_their_bounding_boxes(geometry: SceneGeometry) -> None:
    clusters = np.array([2, 0, 2, len(geometry.cluster_first) - 1])
    place, box, span = Subclusters(geometry).of(clusters)
    assert (np.diff(place) >= 0).all()
    for k, cluster in enumerate(clusters.tolist()):
        rows = np.flatnonzero(place == k)
        first, count = int(geometry.cluster_first[cluster]), int(geometry.cluster_count[cluster])
        found = np.concatenate([np.arange(f, f + n) for n, f in span[rows].tolist()])
        np.testing.assert_array_equal(found, np.arange(first, first + count))
        for row in rows:
            n, f = span[row].tolist()
            assert 0 < n <= 3 * SUBCLUSTER_TRIANGLES
            corners = geometry.vertices["position"][geometry.indices[f : f + n]]
            np.testing.assert_allclose(box[row, :3] - box[row, 3:], corners.min(axis=0), atol=1e-6)
            np.testing.assert_allclose(box[row, :3] + box[row, 3:], corners.max(axis=0), atol=1e-6)


def test_occluders_are_opaque_triangles_from_an_area_on(geometry: SceneGeometry) -> None:
    occluders = Occluders()
    occluders.update(geometry, 0)
    found = [
        tuple(geometry.vertices["position"][i].tolist())
        for first, count in zip(occluders.first, occluders.count, strict=True)
        for i in occluders.indices[first : first + count]
    ]
    # The two large sides of the wall, of two triangles of 2 m2 each, and its four edges, of 0.1 m2; nothing of the balls.
    assert 4 * 3 <= len(found) <= 12 * 3
    assert LARGE_M2 < 2.0
    assert {round(abs(x - 2.0), 4) for x, _, _ in found} == {0.05}


def test_known_occluders_are_not_searched_again(geometry: SceneGeometry) -> None:
    fresh, grown = Occluders(), Occluders()
    fresh.update(geometry, 0)
    half = geometry.cluster_first < np.median(geometry.cluster_first)
    names = ("cluster_first", "cluster_count", "cluster_link", "cluster_placement")
    fewer = replace(geometry, batches=(), **{name: getattr(geometry, name)[half] for name in names})
    grown.update(fewer, 0)
    same = int((geometry.cluster_first[half] + geometry.cluster_count[half]).max())
    grown.update(geometry, same)
    for first, count, of in zip(fresh.first, fresh.count, range(len(fresh.first)), strict=True):
        again = grown.indices[grown.first[of] : grown.first[of] + grown.count[of]]
        np.testing.assert_array_equal(fresh.indices[first : first + count], again)


def test_consecutive_draws_are_merged_and_draw_the_same_in_the_same_order(geometry: SceneGeometry) -> None:
    planner = DrawPlanner(geometry, Visibility(geometry), 0.0, cull=True)
    whole = _plan(geometry)
    cut = planner.subcluster_query(whole).plan
    joined = cut.merged()
    assert len(joined.draws) <= len(whole.draws) < len(cut.draws)
    for plan in (cut, joined):
        solid = [plan.draws[: plan.opaque], plan.draws[plan.opaque :]]
        expected = [whole.draws[: whole.opaque], whole.draws[whole.opaque :]]
        assert [_indices(geometry, draws) for draws in solid] == [_indices(geometry, draws) for draws in expected]
    expected = [(m.batch, m.translucent) for m in whole.multi_draws()]
    assert [(m.batch, m.translucent) for m in joined.multi_draws()] == expected
    assert sum(m.draws for m in joined.multi_draws()) == len(joined.draws)


def test_translucent_triangles_become_few_draws_from_far_to_near(geometry: SceneGeometry) -> None:
    whole = _plan(geometry)
    triangles = len(whole.draws) - whole.opaque
    assert triangles > 100  # the ball of glass, triangle by triangle
    gathered, indices = whole.sorted_translucent(geometry.indices, before=7)
    assert len(gathered.draws) - gathered.opaque == 1
    (count, _, first, _, placement) = gathered.draws[gathered.opaque].tolist()
    assert (count, first) == (len(indices), 7)
    assert placement == whole.draws[whole.opaque, 4]
    assert indices.tolist() == _indices(geometry, whole.draws[whole.opaque :])
    np.testing.assert_array_equal(gathered.draws[: gathered.opaque], whole.draws[: whole.opaque])
    assert [(m.batch, m.translucent) for m in gathered.multi_draws()] == [(m.batch, m.translucent) for m in whole.multi_draws()]
    assert [m.draws for m in gathered.multi_draws()][-1] == 1


def test_translucent_draws_keep_their_order_among_batches_and_placements() -> None:
    draws = np.array(
        [[3, 1, 0, 0, 0], [3, 1, 9, 0, 0], [3, 1, 3, 0, 0], [6, 1, 12, 0, 1], [3, 1, 6, 0, 1], [3, 1, 18, 0, 1]], dtype=np.uint32
    )
    picture = PinholePicture(np.eye(4), np.eye(3), 1, 1, 0.05)
    plan = DrawPlan(
        picture, np.zeros((0, 4, 4)), np.arange(6), draws, np.array([0, 1, 1, 1, 1, 2]), 1, np.arange(0), 7, cull_back_faces=False
    )
    gathered, indices = plan.sorted_translucent(np.arange(100, 130, dtype=np.uint32))
    assert gathered.draws[:, [0, 2, 4]].tolist() == [[3, 0, 0], [6, 0, 0], [9, 6, 1], [3, 15, 1]]
    assert gathered.batch.tolist() == [0, 1, 1, 2]
    assert indices.tolist() == [*range(109, 112), *range(103, 106), *range(112, 118), *range(106, 109), *range(118, 121)]


def test_without_translucent_draws_the_plan_stays_the_same() -> None:
    draws = np.array([[3, 1, 0, 0, 0]], dtype=np.uint32)
    picture = PinholePicture(np.eye(4), np.eye(3), 1, 1, 0.05)
    plan = DrawPlan(picture, np.zeros((0, 4, 4)), np.arange(1), draws, np.array([0]), 1, np.arange(0), 1, cull_back_faces=False)
    gathered, indices = plan.sorted_translucent(np.arange(3, dtype=np.uint32))
    assert gathered is plan
    assert len(indices) == 0


def test_gaps_and_other_placements_keep_draws_apart() -> None:
    draws = np.array(
        [[3, 1, 0, 0, 0], [3, 1, 3, 0, 0], [3, 1, 9, 0, 0], [3, 1, 12, 0, 1], [3, 1, 15, 0, 1], [3, 1, 18, 0, 1]], dtype=np.uint32
    )
    picture = PinholePicture(np.eye(4), np.eye(3), 1, 1, 0.05)
    plan = DrawPlan(
        picture, np.zeros((0, 4, 4)), np.arange(6), draws, np.array([0, 0, 0, 0, 0, 0]), 5, np.arange(0), 6, cull_back_faces=False
    )
    joined = plan.merged()
    assert joined.draws[:, [0, 2, 4]].tolist() == [[6, 0, 0], [3, 9, 0], [6, 12, 1], [3, 18, 1]]
    assert joined.opaque == 3


def test_glass_is_drawn_once_and_from_far_to_near(geometry: SceneGeometry) -> None:
    plan = _plan(geometry)
    glass = next(k for k, batch in enumerate(geometry.batches) if batch.alpha_mode == "blend")
    assert glass not in plan.batch[: plan.opaque]
    assert set(plan.batch[plan.opaque :].tolist()) == {glass}
    distance = geometry.cluster_box[plan.clusters[plan.opaque :], 0]
    assert distance[0] > distance[-1]
