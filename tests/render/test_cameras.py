"""Every camera obeys its projection formula: all pixels are compared with rays cast at boxes and at a sphere, in NumPy.

The room is an open box of bars and plates around a camera that stands askew, so that edges cross every part of the images, the seams
between the faces of the cube included.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from gibson_sim.description.shapes import VisualSpec
from gibson_sim.formats.mesh import Material, Mesh, MeshPart
from gibson_sim.geometry.projections import back_project, project, rays, unproject
from gibson_sim.geometry.transforms import invert, matrix_from_pose, pose_from_matrix, transform_points
from gibson_sim.render.renderer import Renderer, RenderOptions
from gibson_sim.types import OUTPUTS, CameraSpec, Frame, Pose
from render.drawing import DARK, EYE, box, draw, loader_of, mesh_visual, scene, state

pytestmark = [pytest.mark.egl, pytest.mark.usefixtures("egl")]

Array = NDArray[np.float64]

_BOXES = [
    ((0.0, 0.0, -1.2), (5.0, 4.0, 0.2)), ((0.3, 0.2, 1.9), (2.0, 1.5, 0.2)), ((3.0, 0.4, 0.2), (0.4, 0.8, 1.2)),
    ((3.2, -1.4, -0.2), (0.6, 0.5, 1.5)), ((0.4, 2.4, 0.1), (3.0, 0.2, 0.5)), ((0.2, -2.2, 0.4), (3.6, 0.3, 0.3)),
    ((-2.4, 0.3, 0.3), (0.3, 1.6, 1.0)), ((1.8, 1.8, 0.2), (0.2, 0.2, 2.4)), ((1.7, -1.9, 0.0), (0.3, 0.3, 2.0)),
    ((-1.6, 1.7, 0.2), (0.3, 0.2, 2.2)), ((-1.5, -1.6, -0.1), (0.2, 0.4, 1.8)), ((4.2, 0.0, 0.4), (0.1, 5.0, 3.6)),
]  # fmt: skip
"""Centre and size, metres, world frame."""
_ASKEW = np.array([[0.25, -0.1, 1.0], [-1.0, 0.0, 0.2], [0.0, -1.0, -0.05]])
"""About forward along x and about upright; orthonormalised below."""


def _rotation(rough: Array) -> Array:
    u, _, vt = np.linalg.svd(rough)
    return u @ np.diag([1.0, 1.0, np.linalg.det(u @ vt)]) @ vt


def _pose(position: tuple[float, float, float], turn: float = 0.0) -> Pose:
    T = np.eye(4)
    spin = np.array([[math.cos(turn), -math.sin(turn), 0.0], [math.sin(turn), math.cos(turn), 0.0], [0.0, 0.0, 1.0]])
    T[:3, :3], T[:3, 3] = spin @ _rotation(_ASKEW), position
    return pose_from_matrix(T)


_HERE = replace(EYE, pose=_pose((0.1, -0.05, 0.1)), outputs=OUTPUTS)
_K = (105.0, 3.0, 96.5, 0.0, 98.0, 61.0, 0.0, 0.0, 1.0)
CAMERAS: dict[str, CameraSpec] = {
    "off-centre": replace(_HERE, width=200, height=140, matrix=_K),
    "plumb_bob": replace(_HERE, width=200, height=140, matrix=_K, distortion=(-0.28, 0.09, 0.0008, -0.0005, -0.012)),
    "rational": replace(_HERE, width=200, height=140, matrix=_K, distortion=(1.9, 0.7, 0.0003, -0.0002, 0.05, 2.1, 1.1, 0.12)),
    "fisheye 100": replace(_HERE, width=128, height=128, projection="fisheye", fov=math.radians(100.0)),
    "fisheye 180": replace(_HERE, width=192, height=192, projection="fisheye"),
    "fisheye lens": replace(_HERE, width=160, height=128, projection="fisheye", distortion=(0.02, -0.011, 0.004, -0.0007)),
    "fisheye 220": replace(_HERE, width=160, height=160, projection="fisheye", fov=math.radians(220.0)),
    "equirectangular": replace(_HERE, width=256, height=128, projection="equirectangular"),
}
BENT = [name for name in CAMERAS if name != "off-centre"]


def _cast(camera: CameraSpec, points: Array) -> tuple[NDArray[np.intp], Array, Array]:
    """Returns what rays towards points of the optical frame, (..., 3), hit: box and face, -1 = none; depth as a multiple of the point
    given; and the normal in the world frame.
    """
    T = matrix_from_pose(camera.pose)
    way = points.reshape(-1, 3) @ T[:3, :3].T
    best, which = np.full(len(way), np.inf), np.full(len(way), -1)
    with np.errstate(divide="ignore", invalid="ignore"):
        per_metre = 1.0 / way.T
        side = np.sign(way.T)
        for k, (centre, size) in enumerate(_BOXES):
            middle, half = np.subtract(centre, T[:3, 3])[:, None], np.array(size)[:, None] / 2
            enter = (middle - side * half) * per_metre
            at, leave = enter.max(axis=0), ((middle + side * half) * per_metre).min(axis=0)
            hit = (at < leave) & (at > 0.0) & (at < best)
            best[hit], which[hit] = at[hit], 6 * k + enter[:, hit].argmax(axis=0)
    normal = np.where(which[:, None] >= 0, np.eye(3)[which % 3] * -side.T, 0.0)
    shape = points.shape[:-1]
    return which.reshape(shape), best.reshape(shape), normal.reshape(points.shape)


def _around(camera: CameraSpec, radius: float, of: NDArray[np.bool_]) -> list[Array]:
    """Returns the rays of places ``radius`` pixels around each of N pixels of a mask (H, W), in eight directions, each (N, 3)."""
    v, u = np.nonzero(of)
    turns = np.arange(8) * math.pi / 4
    if camera.projection != "equirectangular":
        return [unproject(np.stack([u + radius * math.cos(t), v + radius * math.sin(t)], axis=-1), camera) for t in turns]
    # The columns of an equirectangular image draw together towards the poles: there it is the angle that counts.
    middle = rays(camera)[of]
    side = np.cross(middle, np.where(np.abs(middle[..., :1]) < 0.5, [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]))
    side /= np.linalg.norm(side, axis=-1, keepdims=True)
    up = np.cross(middle, side)
    angle = radius * 2 * math.pi / camera.width
    return [middle * math.cos(angle) + (side * math.cos(t) + up * math.sin(t)) * math.sin(angle) for t in turns]


def _whole(camera: CameraSpec, radius: float) -> NDArray[np.bool_]:
    """Returns a mask (H, W) of the pixels that the lens shows, with all ``radius`` pixels around them."""
    inside = np.isfinite(rays(camera)).all(axis=-1)
    inside[inside] = np.all([np.isfinite(near).all(axis=-1) for near in _around(camera, radius, inside)], axis=0)
    return inside


@pytest.fixture(scope="module")
def frames(egl: None) -> dict[str, Frame]:
    """Every camera's frame of the room."""
    with Renderer(scene(*(_labelled(k) for k in range(len(_BOXES))))) as renderer:
        drawn = renderer.render(state(), list(CAMERAS.values()))
    return dict(zip(CAMERAS, drawn, strict=True))


def _labelled(k: int) -> VisualSpec:
    centre, size = _BOXES[k]
    return replace(box(centre, (0.2 + 0.05 * k, 0.9 - 0.06 * k, 0.3 + 0.25 * (k % 3), 1.0), size), name=f"box {k}")


def _instances(which: NDArray[np.intp]) -> NDArray[np.intp]:
    """Returns the instance numbers of boxes and faces: those of the boxes in order, from 1."""
    return np.where(which >= 0, which // 6 + 1, 0)


@pytest.fixture(scope="module")
def truth() -> dict[str, tuple[NDArray[np.intp], Array, Array, NDArray[np.bool_]]]:
    """Face, depth, normal, and whether all within 1.5 pixels is the same face."""
    out = {}
    for name, camera in CAMERAS.items():
        which, depth, normal = _cast(camera, rays(camera))
        off_edges = np.ones(which.shape, dtype=bool)
        for radius in (0.75, 1.5):
            here = which[off_edges]
            same = [
                (_cast(camera, near)[0] == here) & np.isfinite(near).all(axis=-1) for near in _around(camera, radius, off_edges)
            ]
            off_edges[off_edges] = np.all(same, axis=0)
        out[name] = which, depth, normal, off_edges
    return out


@pytest.mark.parametrize("name", CAMERAS)
def test_the_room_fills_the_image(name, truth):
    which, _, _, off_edges = truth[name]
    assert len(np.unique(which)) > 8
    seen = np.isfinite(rays(CAMERAS[name])).all(axis=-1)
    assert off_edges[seen].mean() > 0.6


@pytest.mark.parametrize("name", CAMERAS)
def test_no_pixel_shows_what_is_more_than_half_a_pixel_away(name, frames, truth):
    seen = frames[name].instance
    wrong = seen != _instances(truth[name][0])
    for radius in (0.25, 0.5):
        nearby = [_instances(_cast(CAMERAS[name], near)[0]) for near in _around(CAMERAS[name], radius, wrong)]
        wrong[wrong] = np.all(nearby != seen[wrong], axis=0)
    # Rays through the exact corner of a box may hit either face.
    assert wrong.sum() <= 2


@pytest.mark.parametrize("name", CAMERAS)
def test_ids_are_exact_off_edges(name, frames, truth):
    which, _, _, off_edges = truth[name]
    np.testing.assert_array_equal(frames[name].instance[off_edges], _instances(which)[off_edges])


@pytest.mark.parametrize("name", CAMERAS)
def test_depth_of_planes_is_exact_to_a_millimetre(name, frames, truth):
    which, depth, _, off_edges = truth[name]
    there = off_edges & (which >= 0)
    assert depth[there].max() > 4.0
    assert np.abs(frames[name].depth[there] - depth[there]).max() < 1e-3
    assert np.isposinf(frames[name].depth[off_edges & (which < 0)]).all()


@pytest.mark.parametrize("name", CAMERAS)
def test_normals_are_those_of_the_faces_in_both_frames(name, frames, truth):
    which, _, normal, off_edges = truth[name]
    there = off_edges & (which >= 0)
    np.testing.assert_allclose(frames[name].normal_world[there], normal[there], atol=2e-4)
    R = matrix_from_pose(CAMERAS[name].pose)[:3, :3]
    np.testing.assert_allclose(frames[name].normal[there], normal[there] @ R, atol=2e-4)


@pytest.mark.parametrize("name", CAMERAS)
def test_positions_are_those_of_the_depth(name, frames, truth):
    which, _, _, off_edges = truth[name]
    camera, there = CAMERAS[name], off_edges & (which >= 0)
    points = back_project(frames[name].depth, camera)[there]
    np.testing.assert_allclose(frames[name].position[there], transform_points(matrix_from_pose(camera.pose), points), atol=1e-3)


@pytest.mark.parametrize("name", ["plumb_bob", "fisheye 100", "fisheye 180", "fisheye 220"])
def test_nothing_is_drawn_where_the_lens_shows_nothing(name, frames):
    outside = np.isnan(rays(CAMERAS[name])).any(axis=-1)
    frame = frames[name]
    assert outside.any()
    assert not frame.rgb[outside].any()
    assert not frame.instance[outside].any() and not frame.semantic[outside].any() and not frame.normal[outside].any()
    assert np.isposinf(frame.depth[outside]).all()
    assert np.isnan(frame.position[outside]).all() and np.isnan(frame.flow[outside]).all()


@pytest.fixture(scope="module")
def from_a_rig(egl: None) -> Iterator[Renderer]:
    """Draws the room for cameras of a link."""
    with Renderer(scene(*(_labelled(k) for k in range(len(_BOXES))), links=("rig/head",))) as renderer:
        yield renderer


@pytest.mark.parametrize("name", CAMERAS)
def test_flow_is_where_a_point_is_minus_where_it_was(name, truth, from_a_rig):
    camera = replace(CAMERAS[name], link="rig/head", pose=Pose())
    now, before = CAMERAS[name].pose, _pose((0.16, -0.02, 0.08), turn=0.06)
    states = [state(("rig/head",), [p.position], [p.quat_xyzw]) for p in (now, before)]
    (frame,) = from_a_rig.render(states[0], [camera], previous=states[1])
    which, depth, _, off_edges = truth[name]
    there = off_edges & (which >= 0)
    points = transform_points(matrix_from_pose(now), back_project(depth, camera)[there])
    was, _ = project(transform_points(invert(matrix_from_pose(before)), points), camera)
    expected = np.argwhere(there)[:, ::-1] - was
    if camera.projection == "equirectangular":
        expected[:, 0] -= camera.width * np.rint(expected[:, 0] / camera.width)
        # Near the poles a neighbouring pixel has an entirely different direction.
        rows = np.abs(np.argwhere(there)[:, 0] - 63.5) < 45
        expected, found = expected[rows], frame.flow[there][rows]
    else:
        found = frame.flow[there]
    # What was outside the lens before has no flow.
    known = np.isfinite(expected).all(axis=1) & np.isfinite(found).all(axis=1)
    assert known.mean() > 0.9
    assert np.median(np.linalg.norm(expected[known], axis=1)) > 1.5
    away = np.linalg.norm(found - expected, axis=1)[known]
    assert away.max() < 0.01


def _ball(radius: float, centre: tuple[float, float, float], material: Material, rings: int = 200) -> Mesh:
    """Returns a sphere so fine that it is round to a tenth of a millimetre."""
    down, around = np.meshgrid(np.linspace(0, math.pi, rings + 1), np.linspace(0, 2 * math.pi, 2 * rings + 1), indexing="ij")
    normals = np.stack([np.sin(down) * np.cos(around), np.sin(down) * np.sin(around), np.cos(down)], axis=-1).reshape(-1, 3)
    corner = (np.arange(rings)[:, None] * (2 * rings + 1) + np.arange(2 * rings)).ravel()
    below = corner + 2 * rings + 1
    triangles = np.concatenate([np.stack([corner, below, below + 1], 1), np.stack([corner, below + 1, corner + 1], 1)])
    vertices = normals * radius + centre
    uvs = np.zeros((len(vertices), 2), dtype=np.float32)
    return Mesh((MeshPart(vertices.astype(np.float32), normals.astype(np.float32), uvs, triangles.astype(np.uint32), material),))


def _twice(camera: CameraSpec) -> CameraSpec:
    """Returns the camera with twice as many columns and rows."""
    if camera.matrix is not None:
        fx, skew, cx, _, fy, cy, *rest = camera.matrix
        camera = replace(camera, matrix=(2 * fx, 2 * skew, 2 * cx + 0.5, 0.0, 2 * fy, 2 * cy + 0.5, *rest))
    return replace(camera, width=2 * camera.width, height=2 * camera.height)


@contextmanager
def _drawn_exactly(mesh: Mesh) -> Iterator[Renderer]:
    """Draws a mesh with all its triangles."""
    with Renderer(scene(mesh_visual()), meshes=loader_of(mesh), options=RenderOptions(detail_px=0.0)) as renderer:
        yield renderer


@pytest.fixture(scope="module", params=[(5.0, 0.0, 0.0), (3.5, 3.5, 0.3)])
def far_ball(request: pytest.FixtureRequest, egl: None) -> Iterator[tuple[Array, Renderer]]:
    """Centre of a ball of 1 m radius, and what draws it."""
    with _drawn_exactly(_ball(1.0, request.param, Material())) as renderer:
        yield np.array(request.param), renderer


@pytest.mark.parametrize("name", CAMERAS)
def test_depth_of_a_ball_5_m_away_is_exact_to_a_millimetre(name, far_ball):
    centre, renderer = far_ball
    camera = replace(_twice(CAMERAS[name]), outputs=("depth",))
    (frame,) = renderer.render(state(), [camera])
    T = matrix_from_pose(camera.pose)
    there = rays(camera)
    way = there @ T[:3, :3].T
    from_centre = T[:3, 3] - centre
    a, b, c = (way * way).sum(-1), way @ from_centre, from_centre @ from_centre - 1.0
    with np.errstate(invalid="ignore"):
        depth = (-b - np.sqrt(b * b - a * c)) / a
    cosine = -((T[:3, 3] + way * depth[..., None] - centre) * way).sum(-1) / np.sqrt(a)
    facing = (cosine > 0.5) & (depth > 0.0)
    assert facing.sum() > 300
    assert np.abs(frame.depth[facing] - depth[facing]).max() < 1e-3
    assert np.isfinite(frame.depth[(cosine > 0.3) & (depth > 0.0)]).all()


@pytest.fixture(scope="module")
def inside_a_ball(egl: None) -> Iterator[Renderer]:
    """Draws a lit ball, from whose inside colours change slowly everywhere."""
    with _drawn_exactly(_ball(3.0, (0.0, 0.0, 0.0), Material(base_color=(0.9, 0.7, 0.5, 1.0)))) as renderer:
        yield renderer


@pytest.mark.parametrize("name", BENT)
@pytest.mark.parametrize("samples", [1, 4])
def test_a_smooth_surface_has_no_seam(name, samples, inside_a_ball):
    camera = replace(CAMERAS[name], samples=samples, outputs=("rgb",))
    image = inside_a_ball.render(state(), [camera])[0].rgb.astype(float)
    inside = _whole(camera, 1.5)
    assert image[inside].std() > 10.0
    bends = [np.abs(image[1:-1] - 0.5 * (image[:-2] + image[2:])), np.abs(image[:, 1:-1] - 0.5 * (image[:, :-2] + image[:, 2:]))]
    for bend, middle in zip(bends, (inside[1:-1], inside[:, 1:-1]), strict=True):
        assert bend[middle].max() <= 1.5


def _linear(image: NDArray[np.uint8]) -> Array:
    c = image / 255.0
    return np.where(c <= 0.04045, c / 12.92, ((c + 0.055) / 1.055) ** 2.4)


@pytest.mark.parametrize("name", BENT)
def test_an_edge_all_around_is_where_it_should_be_and_has_no_step(name):
    # Dark walls all around, a bright sky above and a bright ground below.
    camera = replace(CAMERAS[name], samples=4, outputs=("rgb",))
    walls = [
        ((2.5 * x, 2.5 * y, -1.6), (5.1 if y else 0.1, 5.1 if x else 0.1, 4.0)) for x, y in ((1, 0), (-1, 0), (0, 1), (0, -1))
    ]
    light = replace(DARK, background=(1.0, 1.0, 1.0))
    found = _linear(draw(*(box(c, (0.0, 0.0, 0.0, 1.0), s) for c, s in walls), camera=camera, light=light).rgb[..., 1])
    expected = np.zeros(found.shape)
    T = matrix_from_pose(camera.pose)
    v, u = np.mgrid[: camera.height, : camera.width]
    for part in np.ndindex(6, 6):
        way = unproject(np.stack([u + (part[1] - 2.5) / 6, v + (part[0] - 2.5) / 6], axis=-1), camera) @ T[:3, :3].T
        with np.errstate(divide="ignore", invalid="ignore"):
            sides = [(2.45 * s - T[axis, 3]) / way[..., axis] for axis in (0, 1) for s in (-1.0, 1.0)]
            height = T[2, 3] + np.min([np.where(side > 0, side, np.inf) for side in sides], axis=0) * way[..., 2]
        # From inside neither the top nor the bottom of a wall is seen.
        expected += ((height > 0.4) | (height < -3.6)) / 36
    inside = _whole(camera, 5.5)
    # An edge that is off by one pixel changes the sum over 7 x 7 pixels by at least 7.
    error = cv2.boxFilter(found - expected, -1, (7, 7), normalize=False)[inside] / 7
    assert (np.abs(cv2.boxFilter(expected, -1, (7, 7))[inside] - 0.5) < 0.3).mean() > 0.02
    assert np.abs(error).max() < 0.3
    assert abs(error.mean()) < 0.005


@pytest.mark.parametrize("size", [128, 620])
def test_two_half_spheres_meet_at_their_rims(size: int) -> None:
    front = replace(CAMERAS["fisheye 180"], width=size, height=size, outputs=("position", "instance"))
    T = matrix_from_pose(front.pose)
    T[:3, :3] = T[:3, :3] @ np.diag([-1.0, 1.0, -1.0])
    back = replace(front, name="back", pose=pose_from_matrix(T))
    with Renderer(scene(*(_labelled(k) for k in range(len(_BOXES))))) as renderer:
        ahead, behind = renderer.render(state(), [front, back])
    points = rays(front)
    off_axis = np.degrees(np.arctan2(np.hypot(points[..., 0], points[..., 1]), points[..., 2]))
    v, u = np.nonzero((off_axis > 90.0 - 180.0 / size) & (off_axis < 90.0))  # the last pixel of each radius
    assert len(v) > 2 * size
    way = points[v, u] * [1.0, 1.0, -1.0]  # as far behind the rim as it is ahead of it
    column, row = np.rint(project(way * [-1.0, 1.0, -1.0], back)[0]).astype(int).T
    same = ahead.instance[v, u] == behind.instance[row, column]
    assert same.mean() > 0.95, "but for edges that cross the rim"
    apart = np.linalg.norm(ahead.position[v, u] - behind.position[row, column], axis=1)[same & (ahead.instance[v, u] > 0)]
    assert np.median(apart) < 4.0 * 2.0 * math.pi / size, "two pixels of a wall 4 m away"


@pytest.mark.parametrize("name", CAMERAS)
def test_a_small_mark_is_where_the_formula_puts_it(name):
    camera = replace(_twice(CAMERAS[name]), outputs=("instance",))
    T = matrix_from_pose(camera.pose)
    v, u = np.mgrid[12.3 : camera.height - 9 : 39, 12.7 : camera.width - 9 : 39].reshape(2, -1)
    points = unproject(np.stack([u, v], axis=-1), camera)
    whole = [
        np.isfinite(unproject(np.stack([u + 9 * math.cos(t), v + 9 * math.sin(t)], axis=-1), camera)).all(axis=1)
        for t in range(7)
    ]
    points = points[np.all(whole, axis=0)]
    if camera.projection == "equirectangular":
        points = points[np.abs(points[:, 1]) < 0.8]
    points *= 2.5 / np.linalg.norm(points, axis=1)[:, None]
    expected, _ = project(points, camera)
    marks = [box(tuple(p), None, (0.1, 0.1, 0.1)) for p in transform_points(T, points)]
    image = draw(*(replace(m, name=f"mark {k}") for k, m in enumerate(marks)), camera=camera).instance
    errors = []
    for k, where in enumerate(expected):
        rows, columns = np.nonzero(image == k + 1)
        if (
            len(rows) < 9
            or rows.min() < 2
            or columns.min() < 2
            or rows.max() > camera.height - 3
            or columns.max() > camera.width - 3
        ):
            continue  # hidden by another, or cut by the edge
        errors.append(np.array([columns.mean(), rows.mean()]) - where)
    assert len(errors) >= 12
    assert np.abs(errors).max() < 0.5
    assert np.abs(np.mean(errors, axis=0)).max() < 0.15
