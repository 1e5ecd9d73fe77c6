"""Compiled loops equal NumPy to the bit."""

from __future__ import annotations

import warnings

import numpy as np
import pytest
from numpy.typing import NDArray

from gibson_sim.description.shapes import Shape, VisualSpec
from gibson_sim.formats.load_mesh import primitive_mesh
from gibson_sim.formats.mesh import Mesh
from gibson_sim.geometry.compiling import CAN_COMPILE
from gibson_sim.geometry.transforms import R_LINK_OPTICAL, matrix_from_quat
from gibson_sim.render.batching.building import build_geometry
from gibson_sim.render.batching.scene_geometry import SceneGeometry
from gibson_sim.render.culling.draw_plan import DEPTH_KINDS, VIEW, DrawPlan, DrawPlanner, PinholePicture
from gibson_sim.render.culling.visibility import Visibility, link_frames, world_from_links
from gibson_sim.render.readback.frames import depth_of, normals_of, positions_of, rotated
from gibson_sim.types import Pose, Rgba
from support.surfaces import bumpy_sphere, detail_from

if not CAN_COMPILE:
    message = "SKIPPED: no Numba in this Python, so there is nothing to compare; run `make setup`"
    warnings.warn(message, stacklevel=1)
    pytest.skip(message, allow_module_level=True)

K = np.array([[40.0, 0.0, 31.5], [0.0, 42.0, 23.5], [0.0, 0.0, 1.0]])
COLORS: tuple[Rgba, ...] = ((0.5, 0.5, 0.5, 1.0), (0.2, 0.4, 0.9, 0.4))


def _rotation(rng: np.random.Generator) -> NDArray[np.float64]:
    quat = rng.normal(size=4)
    return np.asarray(matrix_from_quat(quat / np.linalg.norm(quat)))


def _geometry(rng: np.random.Generator, links: tuple[str, ...]) -> SceneGeometry:
    """Returns boxes and balls, some of glass, some on links, in several levels of detail."""
    shapes = (Shape("box", (0.8, 0.6, 1.5)), Shape("sphere", (0.4, 0.4, 0.4)))
    ball = Mesh((bumpy_sphere(40, 0.4),))
    visuals = tuple(
        VisualSpec(
            f"v{k}", str(rng.choice(["", *links])), shapes[k % 2], Pose(tuple(rng.uniform(-4, 4, 3))), COLORS[int(k % 5 == 0)]
        )
        for k in range(40)
    )
    with detail_from(1):
        geometry = build_geometry(visuals, links, lambda shape: ball if shape.kind == "sphere" else primitive_mesh(shape))
    assert len(geometry.group_error) > 10, "balls have coarser levels"
    return geometry


def _plans(planner: DrawPlanner, rng: np.random.Generator, links: int) -> list[tuple[DrawPlan, DrawPlan]]:
    """Returns some plans, each with what remains of it after occlusion culling."""
    found = []
    for _ in range(6):
        T_world_links = np.stack([np.eye(4)] * (links + 1))
        for T in T_world_links[1:]:
            T[:3, :3], T[:3, 3] = _rotation(rng), rng.uniform(-2, 2, 3)
        camera = np.eye(4)
        camera[:3, :3], camera[:3, 3] = _rotation(rng) @ R_LINK_OPTICAL, rng.uniform(-3, 3, 3)
        plan = planner.plan(PinholePicture(camera, K, 64, 48, 0.05), T_world_links, np.zeros(1, dtype=VIEW)[0])
        depth = np.zeros((48, 64), dtype=np.float32)
        depth[rng.integers(0, 20) :, : rng.integers(10, 64)] = 0.05 / rng.uniform(0.5, 4.0)
        found.append((plan, planner.occlusion_queries([plan])[0].visible(depth)))
    return found


@pytest.mark.parametrize("links", [(), ("a", "b", "c")], ids=["standing", "moving"])
@pytest.mark.parametrize(("detail_px", "cull"), [(0.0, True), (2.0, True), (0.0, False)])
def test_plans_are_the_same(links: tuple[str, ...], detail_px: float, cull: bool) -> None:
    geometry = _geometry(np.random.default_rng(3), links)
    pairs = [
        _plans(
            DrawPlanner(geometry, Visibility(geometry), detail_px, cull=cull, loops=loops), np.random.default_rng(4), len(links)
        )
        for loops in (False, True)
    ]
    drawn, left = 0, 0
    for numpy, loops in zip(*pairs, strict=True):
        for ours, theirs in zip(numpy, loops, strict=True):
            for name in ("clusters", "draws", "batch", "near"):
                np.testing.assert_array_equal(getattr(ours, name), getattr(theirs, name))
            assert (ours.opaque, ours.triangles, ours.cull_back_faces) == (
                theirs.opaque,
                theirs.triangles,
                theirs.cull_back_faces,
            )
            assert ours.T_camera_links.tobytes() == theirs.T_camera_links.tobytes()
        drawn += int(numpy[0].draws[:, 0].sum())
        left += int(numpy[1].draws[:, 0].sum())
    assert 0 < left < drawn, "something must be drawn, and something hidden"
    finest = geometry.cluster_group < 0
    coarse = [bool((~finest[plan.clusters]).any()) for plan, _ in pairs[1]]
    assert any(coarse) == (detail_px > 0.0), "coarser clusters are drawn where they may be, and there alone"


def test_frames_of_links_are_the_same() -> None:
    rng = np.random.default_rng(6)
    quats = rng.normal(size=(40, 4))
    quats /= np.linalg.norm(quats, axis=1)[:, None]
    positions = rng.normal(size=(40, 3))
    links = [world_from_links(positions, quats, loops=loops) for loops in (False, True)]
    assert links[0].tobytes() == links[1].tobytes()
    camera = np.eye(4)
    camera[:3, :3], camera[:3, 3] = _rotation(rng) @ R_LINK_OPTICAL, rng.uniform(-3, 3, 3)
    (ours, our_eyes), (theirs, their_eyes) = (link_frames(camera, links[0], loops=loops) for loops in (False, True))
    assert (ours.tobytes(), our_eyes.tobytes()) == (theirs.tobytes(), their_eyes.tobytes())
    np.testing.assert_allclose(ours, np.linalg.inv(camera) @ links[0], atol=1e-12)
    np.testing.assert_allclose(our_eyes, (np.linalg.inv(links[0]) @ camera[:, 3])[:, :3], atol=1e-12)


@pytest.mark.parametrize("loops", [False, True], ids=["NumPy", "loops"])
def test_depth_draws_are_sorted_by_kind_in_their_order(loops: bool) -> None:
    geometry = _geometry(np.random.default_rng(3), ("a", "b", "c"))
    planner = DrawPlanner(geometry, Visibility(geometry), 0.0, cull=True, loops=loops)
    table = planner.table.copy()
    table[::3, 0] = 0  # these clusters are not in the depth pass
    clusters = np.random.default_rng(1).permutation(len(table))
    draws, counts = planner.depth_draws(clusters, table)
    batch_of = np.repeat(np.arange(len(geometry.batches)), [b.end_cluster - b.first_cluster for b in geometry.batches])
    expected = [
        [
            table[cluster].tolist()
            for cluster in clusters.tolist()
            if table[cluster, 0] and DEPTH_KINDS[kind] == (geometry.batches[batch_of[cluster]].moving, geometry.batches[batch_of[cluster]].closed)
        ]
        for kind in range(len(DEPTH_KINDS))
    ]  # fmt: skip
    assert counts == [len(rows) for rows in expected]
    assert sum(count > 0 for count in counts) > 2
    assert draws.tolist() == [row for rows in expected for row in rows]


def _pixels(rng: np.random.Generator) -> NDArray[np.float32]:
    raw = rng.uniform(0.0, 1.0, (31, 47)).astype(np.float32)
    raw[rng.random(raw.shape) < 0.2] = 0.0
    raw[rng.random(raw.shape) < 0.2] *= np.float32(1e-4)
    return raw


def test_depths_and_positions_are_the_same() -> None:
    rng = np.random.default_rng(0)
    raw = _pixels(rng)
    depths = [depth_of(raw, 0.05, 20.0, loops=loops) for loops in (False, True)]
    assert np.isinf(depths[0]).any()
    assert depths[0].tobytes() == depths[1].tobytes()
    rays = rng.normal(size=(31, 47, 3)).astype(np.float32)
    rays[0, 0] = np.nan
    depths[0][0, 0] = np.inf
    R, t = _rotation(rng).astype(np.float32), rng.normal(size=3).astype(np.float32)
    places = [positions_of(rays, depths[0], R, t, loops=loops) for loops in (False, True)]
    assert places[0].tobytes() == places[1].tobytes()


def test_normals_are_the_same_in_both_frames_and_in_a_part_of_a_larger_image() -> None:
    rng = np.random.default_rng(1)
    raw = rng.integers(0, 65536, (31, 47, 4), dtype=np.uint16)
    raw[rng.random(raw.shape[:2]) < 0.3] = 0
    for part in (raw, raw[3:20, 5:33]):
        normals = [normals_of(part, loops=loops) for loops in (False, True)]
        assert normals[0].tobytes() == normals[1].tobytes()
        R = _rotation(rng).astype(np.float32)
        ours, theirs = (rotated(R, normals[0], loops=loops) for loops in (False, True))
        assert ours.tobytes() == theirs.tobytes()
