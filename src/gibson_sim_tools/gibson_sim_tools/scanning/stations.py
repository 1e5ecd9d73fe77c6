"""Selects the stations of a scanner by greedy set cover: few positions that cover the surface visible from free floor. Pure."""

from __future__ import annotations

import logging
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from gibson_sim.geometry.transforms import R_LINK_OPTICAL, quat_from_matrix
from gibson_sim.maps.floor_map import FloorMap, scene_floor_map
from gibson_sim.scenes.spec import SceneSpec
from gibson_sim.types import CameraSpec, Pose
from gibson_sim_tools.scanning.clean_scene import SurfaceSamples
from gibson_sim_tools.scanning.posed_images import ScanError
from gibson_sim_tools.scanning.settings import ScanCamera, TourSettings

F64 = NDArray[np.float64]
F32 = NDArray[np.float32]
Bools = NDArray[np.bool_]
logger = logging.getLogger(__name__)

RenderDepth = Callable[[Sequence[CameraSpec]], list[F32]]
"""Returns the depth images of cameras fixed to the world."""

CANDIDATE_SPACING = 0.6
"""Distance between candidate stations, metres; larger in large scenes."""
MAX_CANDIDATES = 300
PANORAMA_WIDTH = 512
"""Width of a panorama, pixels."""
MAX_ANGLE_DEG = 78.0
"""Largest angle between the view ray and the normal of a visible surface, degrees."""
_BATCH_SIZE = 8
_HEADROOM = 0.1
_MIN_CLEARANCE_FRACTION = 0.5
"""Fraction of the clearance within which an obstacle in the panorama rejects a candidate, because movable bodies are on no map."""


@dataclass(frozen=True, slots=True, eq=False)
class StoreyFloor:
    """The free floor of one storey."""

    floor_map: FloorMap
    floor_z: float
    allowed: Bools
    """(H, W), mask of the cells in which the rig may be."""


@dataclass(frozen=True, slots=True)
class Station:
    """A position where the rig makes a full turn."""

    storey: int
    x: float
    y: float
    height: float
    """Height of the cameras above the floor, metres."""


@dataclass(frozen=True, slots=True, eq=False)
class SelectedStations:
    """The selected stations, and their coverage of N surface samples."""

    stations: tuple[Station, ...]
    visible: Bools
    """(N,), mask of the samples visible from any candidate."""
    covered: Bools
    """(N,), mask of the samples visible from the stations."""

    @property
    def coverage(self) -> float:
        """Fraction of the visible samples that are covered, 0 to 1."""
        return float(self.covered.sum() / max(self.visible.sum(), 1))


def find_storeys(scene: SceneSpec, tour: TourSettings) -> tuple[StoreyFloor, ...]:
    """Returns the storeys of a scene with room for the rig.

    Raises:
        ScanError: there are none.
    """
    storeys = []
    for floor_z in scene.floors:
        floor_map = scene_floor_map(replace(scene, floor_z=floor_z), robot_height=tour.height_max + _HEADROOM)
        allowed = floor_map.inflate(tour.clearance)
        if floor_map.covered is not None and (allowed & floor_map.covered).any():
            allowed = allowed & floor_map.covered
        else:
            allowed = floor_map.largest_free_region(tour.clearance)
        if allowed.any():
            storeys.append(StoreyFloor(floor_map, floor_z, allowed))
    if not storeys:
        raise ScanError(
            f"scene {scene.name!r}: no position on the floor has a clearance of {tour.clearance:g} m; "
            "give a smaller --clearance, or the right floor_z in scene.yaml"
        )
    return tuple(storeys)


def candidate_stations(storeys: Sequence[StoreyFloor], tour: TourSettings) -> list[Station]:
    """Returns candidate stations spread over the free floors, farthest from obstacles first, each with a random camera height."""
    rng = np.random.default_rng([tour.seed, 1])
    area = sum(float(s.allowed.sum()) * s.floor_map.resolution**2 for s in storeys)
    spacing = max(CANDIDATE_SPACING, math.sqrt(area / MAX_CANDIDATES))
    stations = []
    for number, storey in enumerate(storeys):
        cells = np.argwhere(storey.allowed)
        openness = storey.floor_map.distance_to_obstacle[tuple(cells.T)] + rng.uniform(0.0, 0.1, len(cells))
        points = storey.floor_map.centers(cells)[np.argsort(-openness, kind="stable")]
        selected: list[F64] = []
        while len(points):
            selected.append(points[0])
            points = points[np.sum((points - points[0]) ** 2, axis=1) >= spacing**2]
        heights = rng.uniform(tour.height_min, tour.height_max, len(selected))
        stations += [Station(number, float(p[0]), float(p[1]), float(h)) for p, h in zip(selected, heights, strict=True)]
    return stations


def select_stations(
    places: Sequence[Station], storeys: Sequence[StoreyFloor], surface: SurfaceSamples, camera: ScanCamera, tour: TourSettings,
    ranges: tuple[float, float], max_stations: int, render_depth: RenderDepth, progress: Callable[[float], None],
) -> SelectedStations:  # fmt: skip
    """Selects stations greedily by newly covered samples until the required coverage is reached.

    Args:
        places: candidate stations.
        storeys: storeys of the candidates.
        surface: surface samples, world frame.
        camera: its field of view limits the visible samples.
        tour: coverage, clearance and pitches.
        ranges: least and greatest range, metres.
        max_stations: largest number of stations.
        render_depth: renders the panoramas.
        progress: called with the fraction that is done, 0 to 1.

    Raises:
        ScanError: no sample is visible from a candidate.
    """
    is_visible = np.zeros((len(places), len(surface)), dtype=bool)
    for first in range(0, len(places), _BATCH_SIZE):
        batch = places[first : first + _BATCH_SIZE]
        positions = [np.array([p.x, p.y, storeys[p.storey].floor_z + p.height]) for p in batch]
        for k, (position, panorama) in enumerate(
            zip(positions, render_depth([panorama_camera(position) for position in positions]), strict=True)
        ):
            if nearest_at_horizon(panorama) >= _MIN_CLEARANCE_FRACTION * tour.clearance:
                is_visible[first + k] = visible_from(position, panorama, surface, _elevations(camera, tour), ranges)
        progress(min(first + _BATCH_SIZE, len(places)) / len(places))
    visible = is_visible.any(axis=0)
    if not visible.any():
        raise ScanError(
            "no surface is in range of any free position; check range_max, the heights of the cameras and floor_z of the scene"
        )
    covered = np.zeros(len(surface), dtype=bool)
    selected: list[int] = []
    while len(selected) < max_stations and covered.sum() < tour.coverage * visible.sum():
        gain = is_visible[:, ~covered].sum(axis=1)
        best = int(gain.argmax())
        if not gain[best]:
            break
        selected.append(best)
        covered |= is_visible[best]
    return SelectedStations(tuple(places[k] for k in selected), np.asarray(visible), np.asarray(covered))


def panorama_camera(position: F64, width: int = PANORAMA_WIDTH) -> CameraSpec:
    """Returns an upright equirectangular depth camera, fixed to the world."""
    return CameraSpec(
        "panorama", "", Pose((float(position[0]), float(position[1]), float(position[2])), quat_from_matrix(R_LINK_OPTICAL)), width, width // 2,
        near=0.03, outputs=("depth",), projection="equirectangular",
    )  # fmt: skip


def nearest_at_horizon(panorama: F32) -> float:
    """Returns the distance, metres, to the nearest surface near the horizon of an equirectangular depth image."""
    rows = len(panorama)
    return float(panorama[3 * rows // 8 : 5 * rows // 8].min())


def visible_from(
    position: F64, panorama: F32, surface: SurfaceSamples, elevations: Sequence[tuple[float, float]], ranges: tuple[float, float]
) -> Bools:
    """Returns the mask (N,) of the samples visible from cameras that turn about the vertical axis at a position.

    Args:
        position: (3,), world frame, metres.
        panorama: (H, W), distances in an upright equirectangular image at that position, metres.
        surface: samples, world frame.
        elevations: least and greatest angle above the horizon of each camera, radians.
        ranges: least and greatest range, metres.
    """
    ray = surface.points - position
    distance = np.linalg.norm(ray, axis=1)
    ray /= np.maximum(distance, 1e-9)[:, None]
    elevation = np.arcsin(np.clip(ray[:, 2], -1.0, 1.0))
    cosine = np.abs(np.sum(ray * surface.normals, axis=1))
    is_visible = (distance >= ranges[0]) & (distance <= ranges[1]) & (cosine > math.cos(math.radians(MAX_ANGLE_DEG)))
    is_visible &= np.any([(elevation >= low) & (elevation <= high) for low, high in elevations], axis=0)
    height, width = panorama.shape
    pixel_angle = 2.0 * math.pi / width
    # Azimuth grows to the left in the image; +x is at its centre.
    u = np.rint(-np.arctan2(ray[:, 1], ray[:, 0]) / pixel_angle + (width - 1) / 2).astype(np.int64) % width
    v = np.clip(np.rint(-elevation / pixel_angle + (height - 1) / 2).astype(np.int64), 0, height - 1)
    # Within one pixel, the distance to a slanted surface varies by this much.
    tolerance = 0.03 + pixel_angle * distance * np.sqrt(1.0 - np.minimum(cosine, 1.0) ** 2) / np.maximum(cosine, 0.1)
    return np.asarray(is_visible & (np.abs(panorama[v, u] - distance) < tolerance))


def _elevations(camera: ScanCamera, tour: TourSettings) -> list[tuple[float, float]]:
    half = math.radians(camera.fov_y_deg) / 2
    return [(math.radians(pitch) - half, math.radians(pitch) + half) for pitch in tour.pitches]
