"""Levels of detail: every selection represents each triangle once, has no cracks, and keeps its error."""

from __future__ import annotations

from collections.abc import Iterator
from functools import lru_cache

import numpy as np
import pytest
from numpy.typing import NDArray

from gibson_sim.formats.mesh import Material, Mesh, MeshPart
from gibson_sim.render.batching.scene_geometry import SceneGeometry
from gibson_sim.render.culling.visibility import Visibility
from gibson_sim.render.lod import clusters as module
from gibson_sim.render.lod.clusters import COARSEST, REDUCTION, SMALLEST, Clusters, build_clusters, split
from gibson_sim.render.lod.lod_selection import DetailLimits
from support.surfaces import bumpy_grid, bumpy_sphere, drawn_positions, geometry_of, in_two, open_edges, textured

SIZE = 256
needs_simplifier = pytest.mark.skipif(module.simplifier() is None, reason="meshoptimizer is not installed")


def _built(part: MeshPart, fixed: NDArray[np.bool_] | None = None) -> Clusters:
    assert part.uvs is not None
    return build_clusters(part.vertices, part.normals, part.uvs, part.triangles.astype(np.int64), SIZE, fixed)


@lru_cache(maxsize=1)
def _sphere() -> tuple[MeshPart, Clusters]:
    part = bumpy_sphere()
    return part, _built(part)


MESHES = {
    "sphere": lambda: Mesh((bumpy_sphere(material=textured("one")),)),
    "sphere of two textures": lambda: in_two(bumpy_sphere(material=textured("one")), textured("other")),
    "sphere of two materials": lambda: in_two(bumpy_sphere(material=textured("one")), textured("lit", unlit=False), axis=2),
}
"""Closed surfaces."""


@lru_cache(maxsize=4)
def _geometry(name: str) -> SceneGeometry:
    return geometry_of(Mesh((bumpy_grid(material=textured("one")),)) if name == "grid" else MESHES[name]())


def _choices(geometry: SceneGeometry, seed: int = 0) -> Iterator[NDArray[np.int64]]:
    """Yields selected clusters for many eyes and errors, from all at the finest to all at the coarsest level."""
    visibility, rng = Visibility(geometry), np.random.default_rng(seed)
    for _ in range(40):
        eye = rng.normal(size=(1, 3)) * rng.uniform(0.3, 6.0)
        yield visibility.select(eye, DetailLimits(float(10 ** rng.uniform(1.0, 3.5)), 0.5, 0.05))
    for error in np.geomspace(1e-6, 1.0, 12):
        yield visibility.select_for_error(float(error))


def _standing_for(geometry: SceneGeometry) -> NDArray[np.float64]:
    """Returns for each cluster (row) which part of each finest cluster (column) it represents; the clusters that a group made share its members."""
    group, following = geometry.cluster_group, geometry.cluster_next_group
    finest = np.flatnonzero(group < 0)
    parts = np.zeros((len(group), len(finest)))
    parts[finest, np.arange(len(finest))] = 1.0
    for number in range(len(geometry.group_error)):  # a group has a greater number than those that its members come from
        made = np.flatnonzero(group == number)
        parts[made] = parts[following == number].sum(axis=0) / max(len(made), 1)
    return parts


def test_every_triangle_given_is_at_the_finest_level_once() -> None:
    part, built = _sphere()
    finest = built.triangles[: built.ends[built.level == 0].max()]
    assert len(np.unique(built.triangles[: len(finest)], axis=0)) == len(part.triangles) == len(finest)
    np.testing.assert_array_equal(np.unique(finest, axis=0), np.unique(part.triangles, axis=0))


def test_no_cluster_is_empty_or_larger_than_requested() -> None:
    _, built = _sphere()
    sizes = built.ends - built.starts
    assert sizes.min() > 0
    assert sizes.max() <= SIZE
    assert built.ends[-1] == len(built.triangles)


@pytest.mark.parametrize("rings", [6, 12, 17, 24, 33])
def test_clusters_of_a_scene_are_those_clusters(rings: int) -> None:
    part = bumpy_sphere(rings)
    built = _built(part)
    assert (np.diff(built.level) >= 0).all()
    geometry = geometry_of(Mesh((part,)))
    every = np.arange(len(geometry.cluster_first))
    finest = drawn_positions(geometry, every[geometry.cluster_group < 0])
    expected = part.vertices[part.triangles]
    np.testing.assert_array_equal(*(t[np.lexsort(t.reshape(-1, 9).T)] for t in (finest, expected)))
    corners = {tuple(vertex) for vertex in part.vertices.tolist()}
    for cluster in every:
        positions = drawn_positions(geometry, every[cluster : cluster + 1]).reshape(-1, 3)
        assert {tuple(p) for p in positions.tolist()} <= corners
        low, high = positions.min(axis=0).astype(np.float64), positions.max(axis=0).astype(np.float64)
        np.testing.assert_allclose(geometry.cluster_box[cluster], [*(low + high) / 2, *(high - low) / 2], atol=1e-12)


@needs_simplifier
def test_coarser_clusters_have_fewer_triangles_than_those_they_replace() -> None:
    part, built = _sphere()
    sizes = built.ends - built.starts
    assert len(built.group_error) > 20
    for group in range(len(built.group_error)):
        assert 0 < sizes[built.group == group].sum() <= REDUCTION * sizes[built.next_group == group].sum()
    coarsest = sizes[built.next_group < 0].sum()
    assert coarsest < len(part.triangles) / 20


@needs_simplifier
@pytest.mark.parametrize("rings", [5, 6, 12])
def test_things_of_one_cluster_get_coarser_levels_too_down_to_a_few_triangles(rings: int) -> None:
    part = bumpy_grid(rings)
    count = 2 * rings**2
    assert len(part.triangles) == count
    built = _built(part)
    coarsest = (built.ends - built.starts)[built.next_group < 0].sum()
    if count < SMALLEST:
        assert coarsest == len(built.triangles) == count
    else:
        assert coarsest <= COARSEST


def _bar(around: int = 8) -> MeshPart:
    """Returns a bar of 0.6 x 0.4 x 2 m without ends, whose four long edges are round, 5 mm, with normals as smooth as a fridge door's."""
    angles = np.concatenate([np.linspace(k, k + 1, around + 1) * np.pi / 2 for k in range(4)])
    way = np.stack([np.cos(angles), np.sin(angles)], axis=1)
    corner = np.repeat(np.array([(1, 1), (-1, 1), (-1, -1), (1, -1)]), around + 1, axis=0) * (0.295, 0.195)
    ring, count = corner + 0.005 * way, len(way)
    vertices = np.array([(x, y, z) for z in (0.0, 2.0) for x, y in ring], dtype=np.float32)
    normals = np.array([(x, y, 0.0) for _ in range(2) for x, y in way], dtype=np.float32)
    quads = [(k, (k + 1) % count) for k in range(count)]
    triangles = [t for a, b in quads for t in ((a, b, b + count), (a, b + count, a + count))]
    return MeshPart(
        vertices, normals, np.zeros((len(vertices), 2), dtype=np.float32), np.array(triangles, dtype=np.uint32), Material()
    )


@needs_simplifier
@pytest.mark.parametrize("error", [0.01, 0.03, 0.1])
def test_flat_sides_keep_their_normals_when_the_round_edges_beside_them_go(error: float) -> None:
    part = _bar()
    built = _built(part)
    groups = np.append(built.group_error, np.inf) <= error
    shown = (groups[built.group] | (built.group < 0)) & ~groups[built.next_group]
    chosen = np.concatenate(
        [built.triangles[start:end] for start, end, use in zip(built.starts, built.ends, shown, strict=True) if use]
    )
    assert len(chosen) < len(part.triangles)
    a, b, c = np.moveaxis(part.vertices[chosen].astype(np.float64), 1, 0)
    across = np.cross(b - a, c - a)
    area = np.linalg.norm(across, axis=1)
    cosines = np.einsum("tkc,tc->tk", part.normals[chosen].astype(np.float64), across / area[:, None])
    turned = (np.degrees(np.arccos(np.clip(cosines, -1.0, 1.0))) > 20.0).any(axis=1)
    assert area[turned].sum() < 0.03 * area.sum()


@needs_simplifier
def test_errors_and_boxes_grow_towards_coarser_groups() -> None:
    part, built = _sphere()
    replaced = np.flatnonzero(built.next_group >= 0)
    for cluster in replaced:
        corners = part.vertices[built.triangles[built.starts[cluster] : built.ends[cluster]]].reshape(-1, 3)
        error, box = built.group_error[built.next_group[cluster]], built.group_box[built.next_group[cluster]]
        low, high = corners.min(axis=0), corners.max(axis=0)
        if built.group[cluster] >= 0:
            own = built.group_box[built.group[cluster]]
            assert error >= built.group_error[built.group[cluster]]
            assert (box[:3] <= own[:3]).all() and (box[3:] >= own[3:]).all()
        assert (box[:3] <= low).all() and (box[3:] >= high).all()
    assert built.group_error.min() > 0.0


@needs_simplifier
def test_levels_are_as_near_to_the_surface_as_their_errors_say() -> None:
    # z of a relief at its own vertices, against the coarse triangles above or below them.
    part = bumpy_grid(60)
    built = _built(part)
    for group in range(len(built.group_error)):
        made = np.concatenate([part.vertices[built.triangles[s:e]] for s, e in _spans(built, built.group == group)])
        away = np.concatenate([_away(part.vertices, triangle.astype(np.float64)) for triangle in made])
        assert len(away) > 40
        # A quadric error is a mean over the surface around a vertex: single points may be a few times farther away.
        assert np.sqrt((away**2).mean()) <= built.group_error[group] + 1e-6
        assert away.max() <= 8.0 * built.group_error[group] + 1e-6


def _away(points: NDArray[np.float32], triangle: NDArray[np.float64]) -> NDArray[np.float64]:
    """Returns the distances, metres, of the points above and below a triangle from its plane."""
    low, high = triangle[:, :2].min(axis=0), triangle[:, :2].max(axis=0)
    a, u, v = triangle[0], triangle[1] - triangle[0], triangle[2] - triangle[0]
    area = u[0] * v[1] - u[1] * v[0]
    if abs(area) < 1e-9:  # upright, or a line
        return np.zeros(0)
    way = points[((points[:, :2] >= low) & (points[:, :2] <= high)).all(axis=1)].astype(np.float64) - a
    s, t = (way[:, 0] * v[1] - way[:, 1] * v[0]) / area, (u[0] * way[:, 1] - u[1] * way[:, 0]) / area
    inside = (s >= 0.0) & (t >= 0.0) & (s + t <= 1.0)
    slope = abs(area) / float(np.linalg.norm(np.cross(u, v)))
    away: NDArray[np.float64] = np.abs(way[:, 2] - s * u[2] - t * v[2])[inside] * slope
    return away


@needs_simplifier
@pytest.mark.parametrize("name", [*MESHES, "grid"])
def test_selected_clusters_represent_every_triangle_exactly_once(name: str) -> None:
    geometry = _geometry(name)
    parts = _standing_for(geometry)
    drawn = set()
    for chosen in _choices(geometry):
        np.testing.assert_allclose(parts[chosen].sum(axis=0), 1.0, atol=1e-9)
        drawn.add(int(geometry.cluster_count[chosen].sum()) // 3)
    assert len(drawn) > 8
    assert max(drawn) == geometry.triangles
    assert min(drawn) < geometry.triangles / 8


@needs_simplifier
@pytest.mark.parametrize("name", MESHES)
def test_a_closed_surface_stays_closed_at_any_detail(name: str) -> None:
    geometry = _geometry(name)
    for chosen in _choices(geometry):
        assert len(open_edges(drawn_positions(geometry, chosen))) == 0


@needs_simplifier
def test_an_open_surface_is_open_along_its_border_only() -> None:
    geometry = _geometry("grid")
    for chosen in _choices(geometry):
        edges = open_edges(drawn_positions(geometry, chosen))
        # The square reaches from -2 to 2: both ends of an open edge are on the same side of it.
        assert (np.isclose(np.abs(edges[:, :, :2]), 2.0, atol=1e-6).all(axis=1)).any(axis=1).all()
        along = np.abs(edges[:, 1, :2] - edges[:, 0, :2]).sum()
        assert along == pytest.approx(16.0, abs=1e-3), "the border goes round once"


def test_a_surface_with_a_hole_is_called_open() -> None:
    part = bumpy_sphere(20)
    assert len(open_edges(part.vertices[part.triangles])) == 0
    assert len(open_edges(part.vertices[part.triangles[1:]])) == 3


@needs_simplifier
def test_fixed_vertices_stay_at_every_level() -> None:
    part = bumpy_grid(60)
    fixed = np.zeros(len(part.vertices), dtype=bool)
    fixed[np.random.default_rng(2).choice(len(fixed), 40, replace=False)] = True
    with_fixed, without = _built(part, fixed), _built(part)
    coarsest = np.concatenate([with_fixed.triangles[s:e] for s, e in _spans(with_fixed, with_fixed.next_group < 0)])
    for level in range(int(with_fixed.level.max()) + 1):
        # Clusters that are not replaced represent their triangles at all coarser levels too.
        there = (with_fixed.level == level) | ((with_fixed.level < level) & (with_fixed.next_group < 0))
        assert np.isin(
            np.flatnonzero(fixed), np.concatenate([with_fixed.triangles[s:e] for s, e in _spans(with_fixed, there)])
        ).all()
    assert np.isin(np.flatnonzero(fixed), coarsest).all()
    assert len(coarsest) < len(part.triangles) / 10
    free = np.concatenate([without.triangles[s:e] for s, e in _spans(without, without.next_group < 0)])
    assert not np.isin(np.flatnonzero(fixed), free).all()


def _spans(built: Clusters, which: NDArray[np.bool_]) -> list[tuple[int, int]]:
    return list(zip(built.starts[which].tolist(), built.ends[which].tolist(), strict=True))


@needs_simplifier
def test_a_flat_surface_with_a_straight_texture_loses_nothing() -> None:
    built = _built(bumpy_grid(80, height=0.0))
    # Squares of distances are summed in 32 bits: about 1 mm of 4 m is lost by rounding.
    assert built.group_error.max() < 2e-3
    assert (built.ends - built.starts)[built.next_group < 0].sum() < 200


@needs_simplifier
def test_a_distorted_texture_mapping_on_a_flat_surface_counts_as_an_error() -> None:
    flat = bumpy_grid(80, height=0.0)
    x, y, _ = flat.vertices.T
    bent = np.stack([x / 4 + 0.5 + 0.05 * np.sin(6 * y) * np.sin(6 * x), y / 4 + 0.5], axis=1).astype(np.float32)
    built = _built(MeshPart(flat.vertices, flat.normals, bent, flat.triangles))
    # The texture is 4 m wide, so 0.05 of it is 20 cm: coarse triangles slide it by centimetres, which are weighted by SLIDE_WEIGHT.
    assert built.group_error.max() > 0.005


def test_without_a_simplifier_there_is_one_level_with_everything(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(module, "simplifier", lambda: None)
    geometry = geometry_of(Mesh((bumpy_grid(40),)))
    assert (geometry.cluster_group == -1).all()
    assert (geometry.cluster_next_group == -1).all()
    for chosen in _choices(geometry):
        assert geometry.cluster_count[chosen].sum() == 3 * 2 * 40**2


def test_a_large_scene_without_a_simplifier_says_what_to_install(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("gibson_sim.render.batching.assembly.simplifier", lambda: None)
    (warning,) = geometry_of(Mesh((bumpy_grid(40),))).warnings
    assert "3200 triangles" in warning
    assert "pip install meshoptimizer" in warning


@needs_simplifier
def test_triangles_without_area_do_not_keep_it_busy_for_ever(monkeypatch: pytest.MonkeyPatch) -> None:
    simplify = module.simplifier()
    assert simplify is not None
    calls = []

    def counted(*arguments: object) -> int:
        calls.append(1)
        assert len(calls) < 10_000
        return simplify(*arguments)

    monkeypatch.setattr(module, "simplifier", lambda: counted)
    relief, rng = bumpy_grid(40), np.random.default_rng(7)
    dots = np.repeat(rng.uniform(-2.0, 2.0, (4000, 3)), 3, axis=0).astype(np.float32)
    vertices = np.concatenate([relief.vertices, dots])
    triangles = np.concatenate([relief.triangles, len(relief.vertices) + np.arange(12_000).reshape(-1, 3)]).astype(np.uint32)
    normals = np.tile(np.array([0.0, 0.0, 1.0], dtype=np.float32), (len(vertices), 1))
    built = _built(MeshPart(vertices, normals, np.zeros((len(vertices), 2), dtype=np.float32), triangles))
    assert built.ends[built.level == 0].max() == len(triangles)
    assert built.ends[-1] == len(built.triangles)


def test_splitting_puts_every_point_into_one_neighbourhood() -> None:
    points = np.random.default_rng(1).normal(size=(5000, 3))
    order, ends = split(points, 64)
    np.testing.assert_array_equal(np.sort(order), np.arange(5000))
    assert np.diff(ends, prepend=0).max() <= 64
    boxes = [np.ptp(points[rows], axis=0).prod() for rows in np.split(order, ends[:-1])]
    assert np.median(boxes) < np.ptp(points, axis=0).prod() / 20
