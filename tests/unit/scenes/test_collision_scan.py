"""Simplified collision geometry of a scan: exact planes for its floors, few triangles for the rest, close to the scan; and its cache."""

from __future__ import annotations

import logging
import sys
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from gibson_sim.errors import MeshError, SceneError
from gibson_sim.geometry.triangle_meshes import areas_of, distances, weld
from gibson_sim.scenes.collision import scan as scan_module
from gibson_sim.scenes.collision.cache import RECORD, default_folder
from gibson_sim.scenes.collision.planes import flatten_floors
from gibson_sim.scenes.collision.scan import MAX_ERROR, SimplifiedScan, scan_shapes, simplify_scan
from gibson_sim.scenes.load import load_scene
from gibson_sim_tools.convex_parts import convex_parts
from support.scans import ROOM, STEP, THRESHOLD, noisy_room

Mesh = tuple[NDArray[np.float64], NDArray[np.int64]]


@pytest.fixture(scope="module")
def scan() -> Mesh:
    return noisy_room(edge=0.08)


@pytest.fixture(scope="module")
def simple(scan: Mesh) -> SimplifiedScan:
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(scan_module, "_SAMPLES", 8_000)
        return simplify_scan(*scan)


def test_floor_and_stage_become_level_planes_at_their_heights(simple: SimplifiedScan) -> None:
    tops = np.array([slab.top for slab in simple.slabs])
    on_stage = tops > STEP / 2
    assert tops[~on_stage] == pytest.approx(0.0, abs=0.002)
    assert tops[on_stage] == pytest.approx(STEP, abs=0.002)
    area = sum((slab.high[0] - slab.low[0]) * (slab.high[1] - slab.low[1]) for slab in simple.slabs)
    assert 0.8 * ROOM[0] * ROOM[1] < area < ROOM[0] * ROOM[1] + 1.5 * 1.2


def test_slabs_do_not_overlap(simple: SimplifiedScan) -> None:
    slabs = simple.slabs
    for i, a in enumerate(slabs):
        for b in slabs[:i]:
            if abs(a.top - b.top) < 0.01:
                apart = [a.high[k] <= b.low[k] + 1e-9 or b.high[k] <= a.low[k] + 1e-9 for k in range(2)]
                assert any(apart)


def test_scan_needs_far_fewer_triangles_and_stays_within_3_cm(scan: Mesh, simple: SimplifiedScan) -> None:
    assert simple.before == len(scan[1])
    assert len(simple.triangles) < simple.before / 10
    assert simple.error < MAX_ERROR == 0.03


def test_threshold_on_the_floor_is_kept(simple: SimplifiedScan) -> None:
    corners = simple.vertices[simple.triangles]
    middle = corners.mean(axis=1)
    bar = (np.abs(middle[:, 0] - 4.0) < 0.03) & (middle[:, 1] > 1.0) & (middle[:, 1] < 4.0) & (np.abs(middle[:, 2]) < 0.1)
    top = np.average(middle[bar, 2], weights=areas_of(corners[bar]))
    assert top == pytest.approx(THRESHOLD, abs=0.008)


def test_stairs_stay_as_they_are() -> None:
    treads = [[(0.3 * i, 0.0, 0.17 * i), (0.3 * i + 0.3, 1.0, 0.17 * i)] for i in range(6)]
    points = np.array([[[x, y, z], [X, y, z], [X, Y, z], [x, Y, z]] for (x, y, z), (X, Y, _) in treads]).reshape(-1, 3)
    triangles = np.concatenate([np.array([[0, 1, 2], [0, 2, 3]]) + 4 * i for i in range(6)])
    flattened = flatten_floors(*weld(points, triangles))
    assert flattened.slabs == ()
    assert len(flattened.triangles) == len(triangles)


def test_cushion_is_no_floor() -> None:
    x, y = np.meshgrid(np.linspace(0, 2, 41), np.linspace(0, 2, 41), indexing="ij")
    points = np.stack([x, y, 0.08 * np.sin(np.pi * x / 2) * np.sin(np.pi * y / 2)], axis=-1).reshape(-1, 3)
    first = (np.arange(40)[:, None] * 41 + np.arange(40)).ravel()
    triangles = np.concatenate([np.stack([first, first + 41, first + 42], 1), np.stack([first, first + 42, first + 1], 1)])
    assert flatten_floors(points, triangles).slabs == ()


def test_distance_of_points_to_triangles() -> None:
    corners = np.array([[[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]]])
    points = np.array([[0.2, 0.2, 0.5], [0.5, -0.3, 0.0], [1.3, 0.0, 0.4], [1.0, 1.0, 0.0]])
    assert distances(points, corners, np.random.default_rng(0)) == pytest.approx([0.5, 0.3, 0.5, np.sqrt(0.5)])


def test_corners_that_are_no_numbers_are_left_out() -> None:
    points = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [np.nan, 0, 0], [0, 0, 0]], dtype=float)
    vertices, triangles = weld(points, np.array([[0, 1, 2], [0, 1, 3], [0, 1, 4]]))
    assert len(vertices) == 3
    assert len(triangles) == 1


def test_scan_without_triangles_is_an_error() -> None:
    with pytest.raises(MeshError, match="no triangles"):
        simplify_scan(np.zeros((3, 3)), np.zeros((0, 3), dtype=int))


def test_second_start_uses_the_cache_of_the_first(
    scan: Mesh, simple: SimplifiedScan, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    made: list[int] = []
    monkeypatch.setattr(scan_module, "simplify_scan", lambda *_: (made.append(1), simple)[1])
    caplog.set_level(logging.INFO)
    first = scan_shapes(*scan, "room", folder=tmp_path)
    assert scan_shapes(*scan, "room", folder=tmp_path) == first
    assert len(made) == 1
    assert f"room collides as {len(simple.triangles)} triangles for {simple.before}" in caplog.text
    scan_shapes(scan[0] + 0.001, scan[1], "room", folder=tmp_path)
    assert len(made) == 2


def test_damaged_cache_is_recomputed(scan: Mesh, simple: SimplifiedScan, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(scan_module, "simplify_scan", lambda *_: simple)
    first = scan_shapes(*scan, "room", folder=tmp_path)
    (record,) = tmp_path.glob(f"*/{RECORD}")
    record.write_text("{")
    assert scan_shapes(*scan, "room", folder=tmp_path) == first


def test_cache_that_cannot_be_written_is_an_error_that_says_what_to_do(scan: Mesh, tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    with pytest.raises(SceneError, match="set XDG_CACHE_HOME"):
        scan_shapes(*scan, "room", folder=tmp_path / "file" / "cache")


def test_cache_lies_beside_that_of_the_renderer(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("XDG_CACHE_HOME", "/elsewhere")
    assert default_folder() == Path("/elsewhere/gibson-sim/collision")


def _scene(folder: Path, line: str) -> Path:
    (folder / "scene.yaml").write_text(f"name: scan\nobjects:\n  - {line}\n")
    return folder


def test_scene_requests_simplification_by_a_keyword(
    simple: SimplifiedScan, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    monkeypatch.setattr(scan_module, "simplify_scan", lambda *_: simple)
    (tmp_path / "scan").mkdir()
    (tmp_path / "scan/room.obj").write_text("v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n")
    scene = load_scene(_scene(tmp_path / "scan", "{name: room, mesh: room.obj, collision: simplified}"))
    assert [v.name for v in scene.visuals] == ["room"]
    assert [c.name for c in scene.collisions] == ["room"] * (1 + len(simple.slabs))
    assert {c.shape.kind for c in scene.collisions[1:]} == {"box"}
    assert scene.floor_z == pytest.approx(0.0, abs=0.01)


def test_primitive_cannot_be_simplified(tmp_path: Path) -> None:
    with pytest.raises(SceneError, match="collision simplified is for meshes"):
        load_scene(_scene(tmp_path, "{name: crate, box: [1, 1, 1], collision: simplified}"))


L_SHAPE = np.array(
    [[x, y, z] for z in (0, 1) for x, y in ((0, 0), (2, 0), (2, 1), (1, 1), (1, 2), (0, 2))], dtype=float
)  # fmt: skip
L_FACES = np.array(
    [[0, 2, 1], [0, 3, 2], [0, 4, 3], [0, 5, 4], [6, 7, 8], [6, 8, 9], [6, 9, 10], [6, 10, 11]]
    + [tri for a in range(6) for b in [(a + 1) % 6] for tri in ([a, b, b + 6], [a, b + 6, a + 6])]
)  # fmt: skip


def test_concave_object_becomes_convex_parts_that_fill_it(tmp_path: Path) -> None:
    pytest.importorskip("coacd", reason="SKIPPED: coacd is not installed; pip install gibson_sim_tools[collision]")
    from scipy.spatial import ConvexHull

    from gibson_sim.formats.load_mesh import load_mesh

    files = convex_parts(L_SHAPE, L_FACES, "corner", folder=tmp_path)
    assert len(files) >= 2
    volumes = [ConvexHull(load_mesh(file, [tmp_path]).merged()[0]).volume for file in files]
    assert sum(volumes) == pytest.approx(3.0, rel=0.1)


def test_without_the_library_another_maker_is_used(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "coacd", None)
    files = convex_parts(L_SHAPE, L_FACES, "corner", folder=tmp_path, otherwise=lambda v, t: [(v, t), (v, t)])
    assert [file.name for file in files] == ["part_0.obj", "part_1.obj"]
    with pytest.raises(MeshError, match="pip install coacd"):
        convex_parts(L_SHAPE * 2, L_FACES, "corner", folder=tmp_path)
