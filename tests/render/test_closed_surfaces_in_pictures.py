"""Back faces of closed surfaces are culled where they cannot be seen, and nowhere else."""

from __future__ import annotations

from dataclasses import fields, replace
from pathlib import Path

import cv2
import numpy as np
import pytest

from gibson_sim.config import DETAIL_PX
from gibson_sim.formats.load_mesh import primitive_mesh
from gibson_sim.formats.mesh import Mesh
from gibson_sim.render.batching.scene_geometry import Loader
from gibson_sim.render.culling.closed_surfaces import NearPlaneTest
from gibson_sim.render.renderer import MeshFiles, Renderer, RenderOptions
from gibson_sim.scenes.load import load_scene
from gibson_sim.scenes.spec import DrawnScene, drawn_scene
from gibson_sim.types import OUTPUTS, CameraSpec, Frame
from render.drawing import BLUE, DARK, EYE, GREEN, RED, box, draw, draw_mesh, eye_at, loader_of, mesh_visual, scene, state, where
from render.rooms import rooms, way

pytestmark = [pytest.mark.egl, pytest.mark.usefixtures("egl")]


def _assert_same_surfaces(some: Frame, other: Frame) -> None:
    """Few pixels in thousands may differ: where two surfaces touch, or at an edge whose two faces have almost equal depths."""
    np.testing.assert_allclose(some.depth, other.depth, rtol=0.01)
    for field in fields(Frame):
        a, b = getattr(some, field.name), getattr(other, field.name)
        if isinstance(a, np.ndarray):
            assert ((a == b) | ((a != a) & (b != b))).mean() > 0.9993, field.name


def _both_ways(
    drawn: DrawnScene,
    cameras: list[CameraSpec],
    monkeypatch: pytest.MonkeyPatch,
    meshes: MeshFiles | Loader,
    detail_px: float = DETAIL_PX,
) -> None:
    now = state(drawn.links, [(2.0 + 2.0 * k, 1.6, 0.7) for k in range(len(drawn.links))])
    with Renderer(drawn, meshes, RenderOptions(detail_px=detail_px)) as renderer:
        fronts = [renderer.render(now, [camera])[0] for camera in cameras]
        monkeypatch.setattr(NearPlaneTest, "touches", lambda *_: True)
        for camera, front in zip(cameras, fronts, strict=True):
            (all_sides,) = renderer.render(now, [camera])
            _assert_same_surfaces(front, all_sides)


@pytest.mark.parametrize("samples", [1, 4])
def test_images_equal_those_without_back_face_culling(samples: int, monkeypatch: pytest.MonkeyPatch) -> None:
    visuals, loader = rooms()
    pane = box((3.0, 1.6, 1.0), (0.2, 0.4, 0.9, 0.4), (0.02, 2.0, 2.0))
    drawn = scene(*visuals, pane, box((0, 0, 0), RED, link="a"), box((0, 0, 0), BLUE, link="b"), links=("a", "b"))
    cameras = [replace(EYE, pose=pose, width=120, height=90, outputs=OUTPUTS, samples=samples) for pose in way(5)]
    _both_ways(drawn, cameras, monkeypatch, loader)


def test_images_of_non_pinhole_cameras_equal_those_without_back_face_culling(monkeypatch: pytest.MonkeyPatch) -> None:
    visuals, loader = rooms()
    wide = [replace(EYE, pose=pose, width=128, height=64, projection="equirectangular") for pose in way(2)]
    _both_ways(scene(*visuals), wide, monkeypatch, loader)


def _box_without_front() -> Mesh:
    """Returns a box 2 m ahead, whose far side is 2.5 m away."""
    (part,) = primitive_mesh(box((0, 0, 0)).shape).parts
    there = (part.normals[part.triangles[:, 0]] @ np.array([-1.0, 0.0, 0.0])) < 0.5
    return Mesh((replace(part, vertices=part.vertices + np.float32([2.0, 0.0, 0.0]), triangles=part.triangles[there]),))


def test_half_of_the_triangles_of_a_box_are_not_filled() -> None:
    # Culled faces cannot be seen, so the test uses a box without a front that is marked as closed.
    with Renderer(scene(mesh_visual()), meshes=loader_of(_box_without_front())) as renderer:
        assert renderer._scene is not None
        (frame,) = renderer.render(state(), [EYE])
        assert frame.depth is not None
        assert frame.depth[32, 32] == pytest.approx(2.5)
        renderer._scene._closed[:] = True
        (frame,) = renderer.render(state(), [EYE])
        assert frame.depth is not None
        assert np.isinf(frame.depth).all()


def test_an_open_box_shows_its_inside() -> None:
    frame = draw_mesh(_box_without_front())
    assert frame.depth is not None
    assert frame.depth[32, 32] == pytest.approx(2.5)


def test_a_camera_inside_of_a_box_sees_its_walls() -> None:
    frame = draw(box((0.2, 0.0, 0.0), RED), box((3.0, 0.0, 0.0), GREEN))
    assert frame.depth is not None
    assert frame.depth[32, 32] == pytest.approx(0.7)
    assert where(frame, 0).all()


def test_a_camera_that_touches_a_box_sees_its_inside_and_not_what_is_behind_it() -> None:
    near = replace(EYE, near=0.05)
    frame = draw(box((0.53, 0.0, 0.0), RED), box((3.0, 0.0, 0.0), GREEN), camera=near)  # the front lies at 0.03 m
    assert frame.depth is not None
    assert frame.depth[32, 32] == pytest.approx(1.03)
    assert not where(frame, 1).any()


def test_a_camera_in_its_housing_sees_past_it_and_culls_back_faces() -> None:
    housing = box((0.0, 0.0, 0.0), RED, (0.06, 0.06, 0.06))
    with Renderer(scene(housing, box((3.0, 0.0, 0.0), GREEN))) as renderer:
        assert renderer._scene is not None
        plans = []
        kept = renderer._scene._planner.plan
        renderer._scene._planner.plan = lambda *a: plans.append(kept(*a)) or plans[-1]  # type: ignore[method-assign,func-returns-value]
        (frame,) = renderer.render(state(), [replace(EYE, near=0.05)])
        assert where(frame, 1).any()
        assert not where(frame, 0).any()
        assert plans[0].cull_back_faces
        renderer.render(state(), [replace(EYE, near=0.02)])
        assert not plans[1].cull_back_faces


def test_a_closed_surface_that_moves_around_the_eye_is_seen_from_within() -> None:
    with Renderer(scene(box((0, 0, 0), RED, link="a"), links=("a",))) as renderer:
        for x, depth in ((3.0, 2.5), (0.2, 0.7), (4.0, 3.5)):
            (frame,) = renderer.render(state(("a",), [(x, 0.0, 0.0)]), [EYE])
            assert frame.depth is not None
            assert frame.depth[32, 32] == pytest.approx(depth)


def test_a_mirrored_mesh_is_seen_from_outside() -> None:
    (part,) = primitive_mesh(box((0, 0, 0)).shape).parts
    mirrored = Mesh((part,)).transformed(np.diag([1.0, -2.0, 1.0, 1.0]))
    frame = draw_mesh(mirrored, camera=eye_at((-2.0, 0.0, 0.0)))
    assert frame.depth is not None
    assert frame.depth[32, 32] == pytest.approx(1.5)


@pytest.mark.parametrize("glass", [False, True])
def test_the_sky_is_behind_closed_surfaces_and_glass(glass: bool, tmp_path: Path) -> None:
    sky = tmp_path / "sky.hdr"
    assert cv2.imwrite(str(sky), np.full((32, 64, 3), (0.0, 1.0, 0.0), dtype=np.float32))
    pane = box((1.0, 0.0, 0.0), (0.0, 0.0, 1.0, 0.5), (0.01, 0.5, 0.5))
    things = (box((2.0, 0.0, 0.0), RED, (0.2, 0.2, 0.2)), *([pane] if glass else []))
    frame = draw(*things, light=replace(DARK, backdrop=str(sky)))
    assert frame.rgb is not None
    assert where(frame, 1)[[0, 0, -1, -1], [0, -1, 0, -1]].all()
    assert (frame.rgb[32, 38, 2] > 60) == glass


@pytest.mark.parametrize(
    "world",
    [
        "aws_small_house/worlds/small_house.world",
        "drake_living_room/models/furnished_living_room.dmd.yaml",
        "playcanvas_vr_gallery/examples/assets/models/vr-gallery.glb",
    ],
)
def test_third_party_worlds_look_as_without_back_face_culling(
    data_dir: Path, world: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    spec = load_scene(data_dir / world)
    drawn = replace(drawn_scene(spec, ()), visuals=tuple(v for v in spec.visuals if not v.link))
    rng = np.random.default_rng(0)
    eyes = rng.uniform((-4.0, -4.0, 0.3), (4.0, 4.0, 1.7), (12, 3)).tolist()
    ahead = rng.uniform(-4.0, 4.0, (12, 2)).tolist()
    cameras = [
        eye_at((x, y, z), look_at=(u, v, 1.0), width=160, height=120, outputs=("rgb", "depth"))
        for (x, y, z), (u, v) in zip(eyes, ahead, strict=True)
    ]
    _both_ways(drawn, cameras, monkeypatch, MeshFiles(), detail_px=0.0)
