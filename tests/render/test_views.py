"""Non-pinhole cameras are resampled from views that cover them densely enough."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from gibson_sim.errors import ConfigError
from gibson_sim.geometry.projections import project, unproject
from gibson_sim.render.draw.pinhole_views import GUARD, lookup, views_of
from gibson_sim.types import CameraSpec, Pose

PINHOLE = CameraSpec("eye", "", width=320, height=240, matrix=(155.0, 2.0, 150.5, 0.0, 148.0, 124.0, 0.0, 0.0, 1.0))
FISHEYE = CameraSpec("eye", "", width=128, height=128, projection="fisheye")
SPHERE = CameraSpec("eye", "", width=128, height=64, projection="equirectangular")
BENT = {
    "barrel": replace(PINHOLE, distortion=(-0.28, 0.09, 0.0008, -0.0005, -0.012)),
    "pincushion": replace(PINHOLE, distortion=(0.12, 0.03, -0.001, 0.002, 0.004)),
    "rational": replace(PINHOLE, distortion=(1.9, 0.7, 0.0003, -0.0002, 0.05, 2.1, 1.1, 0.12)),
    "fisheye 100": replace(FISHEYE, fov=math.radians(100.0)),
    "fisheye 180": FISHEYE,
    "fisheye lens": replace(FISHEYE, distortion=(0.02, -0.011, 0.004, -0.0007)),
    "fisheye 220": replace(FISHEYE, fov=math.radians(220.0)),
    "smooth fisheye": replace(FISHEYE, samples=4),
    "equirectangular": SPHERE,
}


def pixels(camera: CameraSpec) -> np.ndarray:
    v, u = np.mgrid[: camera.height, : camera.width]
    return np.stack([u, v], axis=-1).astype(float)


def test_a_pinhole_is_its_own_view():
    (view,) = views_of(PINHOLE)
    assert (view.width, view.height, view.R_camera_view.tolist()) == (320, 240, np.eye(3).tolist())
    np.testing.assert_array_equal(view.intrinsics, PINHOLE.intrinsics())
    assert len(views_of(replace(PINHOLE, distortion=(0.0,) * 5))) == 1


@pytest.mark.parametrize(
    ("name", "count"), [("barrel", 1), ("fisheye 100", 1), ("fisheye 180", 5), ("fisheye 220", 5), ("equirectangular", 6)]
)
def test_only_the_faces_that_are_seen_are_drawn(name, count):
    assert len(views_of(BENT[name])) == count


@pytest.mark.parametrize("name", BENT)
def test_every_pixel_has_its_place_in_a_view_with_neighbours_around(name):
    camera = BENT[name]
    views = views_of(camera)
    number, place, scale = lookup(camera, views, pixels(camera))
    assert (number >= 0).mean() > 0.7
    for k, view in enumerate(views):
        mine = place[number == k]
        assert mine.min() >= GUARD - 1
        assert (mine <= np.array([view.width, view.height]) - GUARD).all()
        assert np.linalg.det(view.R_camera_view) == pytest.approx(1.0)
    assert (scale[number >= 0] > 0.2).all()


@pytest.mark.parametrize("name", BENT)
def test_the_nearest_texel_is_less_than_half_a_pixel_away(name):
    camera = BENT[name]
    views = views_of(camera)
    number, place, _ = lookup(camera, views, pixels(camera))
    for k, view in enumerate(views):
        texels = np.rint(place[number == k])
        rays = np.column_stack([texels, np.ones(len(texels))]) @ np.linalg.inv(view.intrinsics).T @ view.R_camera_view.T
        here = pixels(camera)[number == k]
        if camera.projection == "equirectangular":
            # Towards the poles columns converge: the angle is compared, 128 px for a revolution.
            across = np.cross(rays / np.linalg.norm(rays, axis=1)[:, None], unproject(here, camera))
            away = np.arcsin(np.linalg.norm(across, axis=1))[:, None] * 64 / math.pi
        else:
            away = project(rays, camera)[0] - here
        known = np.isfinite(away).all(axis=1)  # a texel may be outside the lens
        assert known.mean() > 0.95
        assert np.linalg.norm(away[known], axis=1).max() < 0.5


@pytest.mark.parametrize("name", BENT)
def test_views_are_not_much_larger_than_the_image(name):
    camera = BENT[name]
    assert sum(view.width * view.height for view in views_of(camera)) < 6 * camera.width * camera.height + 2000


def test_a_camera_that_moves_keeps_its_views():
    assert views_of(FISHEYE) is views_of(replace(FISHEYE, pose=Pose((1.0, 2.0, 3.0)), outputs=("rgb", "flow")))


def test_a_distorted_pinhole_of_180_degrees_is_refused():
    wide = replace(PINHOLE, matrix=(2.0, 0.0, 160.0, 0.0, 2.0, 120.0, 0.0, 0.0, 1.0), distortion=(0.001, 0.0, 0.0, 0.0))
    with pytest.raises(ConfigError, match=r"camera 'eye': a pixel .* must be less than 87.5; .* use projection fisheye"):
        views_of(wide)


def test_a_camera_without_a_pixel_inside_its_lens_is_refused():
    beside = replace(FISHEYE, matrix=(50.0, 0.0, 900.0, 0.0, 50.0, 64.0, 0.0, 0.0, 1.0))
    with pytest.raises(ConfigError, match="no pixel of the image"):
        views_of(beside)


def test_a_view_that_is_too_large_is_refused():
    with pytest.raises(ConfigError, match=r"needs a view of \d+x\d+ pixels"):
        views_of(
            replace(
                PINHOLE,
                width=16384,
                height=2,
                matrix=(5000.0, 0.0, 8192.0, 0.0, 5000.0, 0.5, 0.0, 0.0, 1.0),
                distortion=(0.05, 0.0, 0.0, 0.0),
            )
        )
