"""With levels of detail a picture equals that of all triangles to half a pixel, with fewer triangles."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from gibson_sim.formats.mesh import Mesh
from gibson_sim.geometry.projections import rays
from gibson_sim.render.batching import assembly
from gibson_sim.render.batching.scene_geometry import Loader
from gibson_sim.render.lod import clusters
from gibson_sim.render.renderer import Renderer, RenderOptions
from gibson_sim.scenes.spec import DrawnScene
from gibson_sim.types import OUTPUTS, CameraSpec, Frame
from render.drawing import EYE, eye_at, loader_of, mesh_visual, scene, state
from render.rooms import rooms, way
from support.surfaces import bumpy_grid, bumpy_sphere, detail_from

pytestmark = [
    pytest.mark.egl,
    pytest.mark.usefixtures("egl"),
    pytest.mark.skipif(clusters.simplifier() is None, reason="meshoptimizer is not installed"),
]

_LENS = {"width": 240, "height": 180, "fov_y": 0.9, "outputs": OUTPUTS}


def _relief() -> tuple[DrawnScene, Loader]:
    return scene(mesh_visual()), loader_of(Mesh((bumpy_grid(),)))


def _sphere() -> tuple[DrawnScene, Loader]:
    return scene(mesh_visual()), loader_of(Mesh((bumpy_sphere(),)))


def _rooms() -> tuple[DrawnScene, Loader]:
    visuals, loader = rooms()
    return scene(*visuals), loader


CASES: dict[str, tuple[Callable[[], tuple[DrawnScene, Loader]], list[CameraSpec]]] = {
    "sphere": (_sphere, [eye_at((-d, 0.0, 0.3 * d), look_at=(0.0, 0.0, 0.0), **_LENS) for d in (2.0, 2.7, 3.5)]),
    "relief": (_relief, [eye_at((-d, 0.0, 0.6 * d), look_at=(0.0, 0.0, 0.0), **_LENS) for d in (1.2, 2.0, 4.0)]),
    "rooms": (_rooms, [replace(EYE, pose=pose, **_LENS) for pose in way(6)]),
}
Pair = tuple[Frame, Frame, int, int]


@pytest.fixture(scope="module", params=CASES)
def pairs(request: pytest.FixtureRequest, egl: None) -> list[Pair]:
    """Each picture with and without levels of detail, and the number of triangles of each."""
    drawn, loader = CASES[request.param][0]()
    pairs = []
    with (
        detail_from(1),
        Renderer(drawn, meshes=loader, options=RenderOptions(detail_px=0.5)) as coarse,
        Renderer(drawn, meshes=loader, options=RenderOptions(detail_px=0.0)) as fine,
    ):
        for renderer in (coarse, fine):
            assert renderer._scene is not None
            renderer._scene._occlusion = False  # more of the fine levels is hidden
        for camera in CASES[request.param][1]:
            frames = [renderer.render(state(), [camera])[0] for renderer in (coarse, fine)]
            counts = [renderer.drawn_triangles for renderer in (coarse, fine)]
            pairs.append((*frames, *counts))
    return pairs


def _off_edges(frame: Frame) -> NDArray[np.bool_]:
    """Returns where one surface covers all within a pixel."""
    kernel = np.ones((3, 3), np.uint8)
    depth, label = np.where(np.isfinite(frame.depth), frame.depth, 0.0).astype(np.float32), frame.instance
    one = cv2.dilate(label, kernel) == cv2.erode(label, kernel)
    smooth = cv2.dilate(depth, kernel) - cv2.erode(depth, kernel) < 0.1 * depth
    return one & smooth


def _flat(frame: Frame) -> NDArray[np.bool_]:
    """Returns where no edge of a surface is within a pixel; a narrow face seen from the side is an edge too."""
    kernel = np.ones((3, 3), np.uint8)
    return (cv2.dilate(frame.normal, kernel) - cv2.erode(frame.normal, kernel)).max(axis=2) < 1.0


def test_levels_of_detail_draw_fewer_triangles(pairs: list[Pair]) -> None:
    for _, _, coarse, fine in pairs:
        assert 0 < coarse <= fine
    assert sum(coarse for _, _, coarse, _ in pairs) < 0.95 * sum(fine for _, _, _, fine in pairs)


def test_silhouettes_are_the_same(pairs: list[Pair]) -> None:
    for coarse, fine, _, _ in pairs:
        for label in np.unique(fine.instance):
            a, b = coarse.instance == label, fine.instance == label
            if b.sum() > 2_000:
                assert (a & b).sum() / (a | b).sum() > 0.99


def test_labels_differ_next_to_edges_only(pairs: list[Pair]) -> None:
    kernel = np.ones((3, 3), np.uint8)
    for coarse, fine, _, _ in pairs:
        for a, b in ((coarse.instance, fine.instance), (coarse.semantic, fine.semantic)):
            assert ((cv2.erode(b, kernel) == cv2.dilate(b, kernel)) <= (a == b)).all()


def test_surfaces_are_half_a_pixel_from_where_they_are(pairs: list[Pair]) -> None:
    for coarse, fine, _, _ in pairs:
        camera = fine.camera
        there = _off_edges(fine) & np.isfinite(coarse.depth) & np.isfinite(fine.depth)
        assert there.sum() > 3_000
        way = rays(camera)[there]
        along = np.abs(coarse.depth[there] - fine.depth[there]) * np.linalg.norm(way, axis=1)
        # A surface that moves by d along its normal is hit d / cos nearer or farther; seen from the side that is d f / z pixels.
        cos = np.abs((fine.normal[there] * way).sum(axis=1)) / np.linalg.norm(way, axis=1)
        px = along * cos * camera.intrinsics()[0, 0] / fine.depth[there]
        assert np.sqrt((px**2).mean()) < 0.3
        assert np.percentile(px, 99) < 0.65  # the error of a level is a mean around each vertex: single points may be farther off
        assert px[_flat(fine)[there]].max() < 1.5


def test_normals_stay_within_a_few_degrees(pairs: list[Pair]) -> None:
    for coarse, fine, _, _ in pairs:
        there = _off_edges(fine) & np.isfinite(coarse.depth)
        angle = np.degrees(np.arccos(np.clip((coarse.normal[there] * fine.normal[there]).sum(axis=1), -1.0, 1.0)))
        assert np.median(angle) < 4.0
        assert np.percentile(angle, 95) < 15.0


def _triangles(renderer: Renderer, camera: CameraSpec) -> int:
    renderer.render(state(), [camera])
    assert renderer._scene is not None
    return renderer.drawn_triangles


def test_distant_objects_have_fewer_triangles() -> None:
    drawn, loader = _sphere()
    with detail_from(1), Renderer(drawn, meshes=loader, options=RenderOptions(detail_px=0.5)) as renderer:
        counts = [_triangles(renderer, eye_at((-d, 0.0, 0.0), width=240, height=180)) for d in (1.5, 3.0, 6.0, 12.0)]
    assert counts[0] > 2 * counts[1] > 2 * counts[2]
    assert counts[2] >= counts[3]
    assert counts[3] < 1_000


def test_a_longer_lens_or_more_pixels_need_more_triangles() -> None:
    drawn, loader = _sphere()
    here = eye_at((-6.0, 0.0, 0.0), width=120, height=90)
    with detail_from(1), Renderer(drawn, meshes=loader, options=RenderOptions(detail_px=0.5)) as renderer:
        plain, long, large = (
            _triangles(renderer, c) for c in (here, replace(here, fov_y=0.35), replace(here, width=720, height=540))
        )
    assert long > 2 * plain
    assert large > 2 * plain


def test_levels_of_detail_follow_a_link() -> None:
    # The mesh's own frame is at the camera; the state brings it far away, so it may be coarse.
    drawn, loader = scene(mesh_visual("robot/base"), links=("robot/base",)), loader_of(Mesh((bumpy_sphere(),)))
    with detail_from(1), Renderer(drawn, meshes=loader, options=RenderOptions(detail_px=0.5)) as renderer:
        counts = []
        for x in (2.0, 12.0):
            renderer.render(state(["robot/base"], [(x, 0.0, 0.0)]), [replace(EYE, width=240, height=180)])
            counts.append(renderer.drawn_triangles)
    assert counts[0] > 2 * counts[1] > 0


def test_a_link_of_many_triangles_is_drawn_with_all_of_them(monkeypatch: pytest.MonkeyPatch) -> None:
    drawn, loader = scene(mesh_visual("robot/base"), links=("robot/base",)), loader_of(Mesh((bumpy_sphere(),)))
    counts = []
    for most in (19_880, 19_879):  # the sphere has 4 * 71 * 70
        monkeypatch.setattr(assembly, "MOVING_DETAIL_UPTO", most)
        with detail_from(1), Renderer(drawn, meshes=loader) as renderer:
            renderer.render(state(["robot/base"], [(50.0, 0.0, 0.0)]), [EYE])
            counts.append(renderer.drawn_triangles)
    assert counts[0] < 2_000
    assert counts[1] == 19_880


def test_scenes_of_few_triangles_are_drawn_with_all_of_them() -> None:
    drawn, loader = _sphere()
    far_away = eye_at((-50.0, 0.0, 0.0))
    counts = []
    for fewest in (19_880, 19_881):  # the sphere has 4 * 71 * 70
        with detail_from(fewest), Renderer(drawn, meshes=loader) as renderer:
            counts.append(_triangles(renderer, far_away))
    assert counts[0] < 2_000
    assert counts[1] == 19_880
