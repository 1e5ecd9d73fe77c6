"""Stations and route of a scanner, in an empty room of 6 m x 4 m with computed depths."""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence

import numpy as np
import pytest

from gibson_sim.maps.floor_map import FloorMap
from gibson_sim.types import CameraSpec
from gibson_sim_tools.scanning.clean_scene import SurfaceSamples, sample_surface, visible_points
from gibson_sim_tools.scanning.posed_images import ScanError
from gibson_sim_tools.scanning.route import plan_views, short_tour
from gibson_sim_tools.scanning.settings import ScanCamera, TourSettings
from gibson_sim_tools.scanning.stations import Station, StoreyFloor, candidate_stations, select_stations, visible_from

SIZE = np.array([6.0, 4.0, 2.5])
TOUR = TourSettings(pitches_deg="-40,0,40")
WIDE = ScanCamera(fov_y_deg=60.0)


def empty_storey(*, wall: bool = False) -> StoreyFloor:
    floor = np.ones((80, 120), dtype=bool)
    occupied = np.zeros_like(floor)
    if wall:
        occupied[:50, 60] = True
    floor_map = FloorMap(0.05, (0.0, 0.0), occupied, floor)
    return StoreyFloor(floor_map, 0.0, floor_map.inflate(0.3))


def room() -> SurfaceSamples:
    """Points on all six sides."""
    corners = np.array([[x, y, z] for x in (0, 1) for y in (0, 1) for z in (0, 1)]) * SIZE
    quads = [(0, 1, 3, 2), (4, 5, 7, 6), (0, 1, 5, 4), (2, 3, 7, 6), (0, 2, 6, 4), (1, 3, 7, 5)]
    triangles = np.array([t for a, b, c, d in quads for t in ((a, b, c), (a, c, d))], dtype=np.int32)
    return sample_surface(corners, triangles, 3000, np.random.default_rng(0))


def panoramas(cameras: Sequence[CameraSpec]) -> list[np.ndarray]:
    """Distances to the sides of the room along the rays of upright equirectangular pictures."""
    out = []
    for camera in cameras:
        eye = np.array(camera.pose.position)
        yaw = -(np.arange(camera.width) - (camera.width - 1) / 2) * 2 * math.pi / camera.width
        up = -(np.arange(camera.height) - (camera.height - 1) / 2) * math.pi / camera.height
        with np.errstate(divide="ignore"):
            x, y = np.cos(yaw), np.sin(yaw)
            level = np.minimum(
                np.where(x > 0, (SIZE[0] - eye[0]) / x, -eye[0] / x), np.where(y > 0, (SIZE[1] - eye[1]) / y, -eye[1] / y)
            )
            upward = np.where(up > 0, (SIZE[2] - eye[2]) / np.sin(up), -eye[2] / np.sin(up))
        out.append(np.minimum(level / np.cos(up)[:, None], upward[:, None]).astype(np.float32))
    return out


def select(
    tour: TourSettings = TOUR,
    max_stations: int = 100,
    ranges: tuple[float, float] = (0.1, 10.0),
    surface: SurfaceSamples | None = None,
):
    storeys = [empty_storey()]
    return select_stations(
        candidate_stations(storeys, tour), storeys, surface or room(), WIDE, tour, ranges, max_stations, panoramas, lambda _: None
    )


def test_samples_are_uniform():
    z = room().points[:, 2]
    assert (z == 0.0).mean() == pytest.approx(24.0 / 98.0, abs=0.03)


def test_a_room_is_visible_from_its_centre():
    eye = np.array([3.0, 2.0, 1.25])
    (panorama,) = panoramas([CameraSpec("", "", width=512, height=256, pose=_pose(eye))])
    surface = room()
    assert visible_from(eye, panorama, surface, [(-1.6, 1.6)], (0.1, 10.0)).mean() > 0.99
    seen = visible_from(eye, panorama, surface, [(-0.2, 0.2)], (0.1, 10.0))
    elevation = np.arcsin((surface.points - eye)[:, 2] / np.linalg.norm(surface.points - eye, axis=1))
    assert not seen[np.abs(elevation) > 0.2].any()
    behind = SurfaceSamples(surface.points + 0.5 * np.sign(surface.points - eye), surface.normals)
    assert visible_from(eye, panorama, behind, [(-1.6, 1.6)], (0.1, 10.0)).mean() < 0.01


def _pose(eye):
    from gibson_sim_tools.scanning.stations import panorama_camera

    return panorama_camera(eye).pose


def test_one_or_two_stations_are_enough_for_an_empty_room():
    found = select()
    assert 1 <= len(found.stations) <= 3
    assert found.coverage >= 0.98


def test_a_short_range_needs_more_stations_and_a_limit_holds():
    many = select(ranges=(0.1, 2.2))
    assert len(many.stations) > len(select().stations)
    assert len(select(ranges=(0.1, 2.2), max_stations=1).stations) == 1


def test_the_same_seed_gives_the_same_stations_and_another_one_others():
    assert select().stations == select().stations
    assert select(TourSettings(seed=1)).stations != select().stations


def test_stations_keep_their_distance_and_height():
    for station in candidate_stations([empty_storey()], TOUR):
        assert 0.3 <= station.x <= 5.7 and 0.3 <= station.y <= 3.7
        assert 1.2 <= station.height <= 1.6


def test_nothing_in_range_is_an_error():
    with pytest.raises(ScanError, match="range_max"):
        select(ranges=(0.01, 0.02))


def test_a_tour_has_no_crossing():
    """Corners of a square, given crosswise."""
    points = np.array([[0, 0], [1, 1], [1, 0], [0, 1]], dtype=float)
    lengths = np.linalg.norm(points[:, None] - points[None], axis=2)
    order = short_tour(lengths)
    assert sum(lengths[a, b] for a, b in itertools.pairwise(order)) == pytest.approx(3.0)


def stations() -> list[Station]:
    return [Station(0, 1.0, 1.0, 1.3), Station(0, 5.0, 1.0, 1.5)]


def test_the_route_goes_around_a_wall_and_looks_ahead():
    storey = empty_storey(wall=True)
    views = plan_views(stations(), [storey], TOUR, 4, 1000)
    way = [v for v in views if v.velocity_x or v.velocity_y]
    assert len(views) - len(way) == 8
    assert len(way) >= 9  # 6.4 m around the wall
    for view in views:
        row, column = storey.floor_map.cells((view.x, view.y))
        assert storey.allowed[row, column]
    assert all(1.3 <= v.z <= 1.5 for v in way)
    stamps = [v.stamp_s for v in views]
    assert stamps == sorted(set(stamps))
    assert sum(math.hypot(v.velocity_x, v.velocity_y) for v in way) == pytest.approx(0.4 * len(way))


def test_a_rig_turns_all_around_at_a_station():
    views = plan_views(stations()[:1], [empty_storey()], TOUR, 4, 1000)
    assert np.allclose(np.degrees([v.yaw for v in views]), [0, 90, 180, -90])
    assert views[0].yaw_rate == pytest.approx(math.radians(30.0))
    before = views[0].earlier(0.1)
    assert math.atan2(before[1, 0], before[0, 0]) == pytest.approx(math.radians(-3.0))


def test_views_between_stations_are_thinned_out_first():
    views = plan_views(stations(), [empty_storey()], TOUR, 4, 10)
    assert len(views) == 10
    assert sum(v.yaw_rate > 0 for v in views) == 8
    assert len(plan_views(stations(), [empty_storey()], TOUR, 4, 3)) == 3


def test_visible_points_agree_with_the_depth():
    surface = SurfaceSamples(
        np.array([[0.0, 0.0, 2.0], [0.0, 0.0, 3.0], [0.0, 0.0, -2.0], [9.0, 0.0, 2.0]]), np.tile([0.0, 0.0, 1.0], (4, 1))
    )
    K = np.array([[10.0, 0, 5], [0, 10.0, 5], [0, 0, 1]])
    depth = np.full((11, 11), 2.0, dtype=np.float32)
    assert visible_points(surface, depth, K, np.eye(4), 0.05).tolist() == [True, False, False, False]
    assert not visible_points(surface, np.full((11, 11), np.nan, np.float32), K, np.eye(4), 0.05).any()
