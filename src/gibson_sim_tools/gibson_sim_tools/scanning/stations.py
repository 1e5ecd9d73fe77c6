"""Chooses the stations of a scanner: the fewest places that see nearly everything visible from free floor. Pure."""

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
from gibson_sim_tools.scanning.clean_scene import SurfacePoints
from gibson_sim_tools.scanning.posed_rgbd import ScanError
from gibson_sim_tools.scanning.settings import ScanCamera, TourSettings

F64 = NDArray[np.float64]
F32 = NDArray[np.float32]
Bools = NDArray[np.bool_]
logger = logging.getLogger(__name__)

Draw = Callable[[Sequence[CameraSpec]], list[F32]]
"""Returns the depth images of cameras fixed to the world."""

CANDIDATE_SPACING = 0.6
"""Distance between candidates, metres; larger in large scenes."""
MAX_CANDIDATES = 300
PANORAMA_WIDTH = 512
"""Width of a panorama, pixels."""
MAX_ANGLE_DEG = 78.0
"""Largest angle between the view ray and the normal of a visible surface, degrees."""
_AT_ONCE = 8
_HEADROOM = 0.1
_TOO_NEAR = 0.5
"""Fraction of the clearance within which an obstacle rules out a place: movable bodies are on no map."""


@dataclass(frozen=True, slots=True, eq=False)
class StoreyFloor:
    """The free floor of one storey."""

    floor_map: FloorMap
    floor_z: float
    allowed: Bools
    """(H, W), cells that the rig may be in."""


@dataclass(frozen=True, slots=True)
class Station:
    """A place where the rig makes a full turn."""

    storey: int
    x: float
    y: float
    height: float
    """Height of the cameras above the floor, metres."""


@dataclass(frozen=True, slots=True, eq=False)
class ChosenStations:
    """The chosen stations, and what they see."""

    stations: tuple[Station, ...]
    visible: Bools
    """(N,), surface points visible from any free place."""
    seen: Bools
    """(N,), surface points visible from the stations."""

    @property
    def coverage(self) -> float:
        """Fraction of the visible points that the stations see."""
        return float(self.seen.sum() / max(self.visible.sum(), 1))


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


def candidates(storeys: Sequence[StoreyFloor], tour: TourSettings) -> list[Station]:
    """Returns candidate places spread over the free floors, the most open first, each with a random camera height."""
    rng = np.random.default_rng([tour.seed, 1])
    area = sum(float(s.allowed.sum()) * s.floor_map.resolution**2 for s in storeys)
    spacing = max(CANDIDATE_SPACING, math.sqrt(area / MAX_CANDIDATES))
    found = []
    for number, storey in enumerate(storeys):
        cells = np.argwhere(storey.allowed)
        openness = storey.floor_map.distance_to_obstacle[tuple(cells.T)] + rng.uniform(0.0, 0.1, len(cells))
        points = storey.floor_map.centers(cells)[np.argsort(-openness, kind="stable")]
        kept: list[F64] = []
        while len(points):
            kept.append(points[0])
            points = points[np.sum((points - points[0]) ** 2, axis=1) >= spacing**2]
        heights = rng.uniform(tour.height_min, tour.height_max, len(kept))
        found += [Station(number, float(p[0]), float(p[1]), float(h)) for p, h in zip(kept, heights, strict=True)]
    return found


def choose_stations(
    places: Sequence[Station], storeys: Sequence[StoreyFloor], surface: SurfacePoints, camera: ScanCamera, tour: TourSettings,
    reach: tuple[float, float], most: int, draw: Draw, progress: Callable[[float], None],
) -> ChosenStations:  # fmt: skip
    """Chooses stations greedily by newly seen points, until the coverage is reached.

    Args:
        places: candidates.
        storeys: storeys of the candidates.
        surface: surface samples.
        camera: its field of view limits what is seen.
        tour: coverage, clearance and pitches.
        reach: least and greatest range, metres.
        most: limit of stations.
        draw: renders panoramas.
        progress: called with the fraction that is done, 0 to 1.

    Raises:
        ScanError: no candidate sees anything.
    """
    seen = np.zeros((len(places), len(surface)), dtype=bool)
    for first in range(0, len(places), _AT_ONCE):
        part = places[first : first + _AT_ONCE]
        eyes = [np.array([p.x, p.y, storeys[p.storey].floor_z + p.height]) for p in part]
        for k, (eye, panorama) in enumerate(zip(eyes, draw([panorama_camera(eye) for eye in eyes]), strict=True)):
            if nearest_beside(panorama) >= _TOO_NEAR * tour.clearance:
                seen[first + k] = visible_from(eye, panorama, surface, _elevations(camera, tour), reach)
        progress(min(first + _AT_ONCE, len(places)) / len(places))
    visible = seen.any(axis=0)
    if not visible.any():
        raise ScanError(
            "no surface is in range of any free position; check range_max, the heights of the cameras and floor_z of the scene"
        )
    covered = np.zeros(len(surface), dtype=bool)
    chosen: list[int] = []
    while len(chosen) < most and covered.sum() < tour.coverage * visible.sum():
        gain = seen[:, ~covered].sum(axis=1)
        best = int(gain.argmax())
        if not gain[best]:
            break
        chosen.append(best)
        covered |= seen[best]
    return ChosenStations(tuple(places[k] for k in chosen), np.asarray(visible), np.asarray(covered))


def panorama_camera(eye: F64, width: int = PANORAMA_WIDTH) -> CameraSpec:
    """Returns an upright equirectangular depth camera, fixed to the world."""
    return CameraSpec(
        "panorama", "", Pose((float(eye[0]), float(eye[1]), float(eye[2])), quat_from_matrix(R_LINK_OPTICAL)), width, width // 2,
        near=0.03, outputs=("depth",), projection="equirectangular",
    )  # fmt: skip


def nearest_beside(panorama: F32) -> float:
    """Returns the distance, metres, to the nearest surface near the horizon of an equirectangular depth image."""
    rows = len(panorama)
    return float(panorama[3 * rows // 8 : 5 * rows // 8].min())


def visible_from(
    eye: F64, panorama: F32, surface: SurfacePoints, elevations: Sequence[tuple[float, float]], reach: tuple[float, float]
) -> Bools:
    """Returns which points, (N,), cameras see that turn about a vertical axis at a place.

    Args:
        eye: (3,), metres.
        panorama: (H, W), distances in an upright equirectangular image from there, metres.
        surface: samples in the world frame.
        elevations: least and greatest angle above the horizon of each camera, radians.
        reach: least and greatest range, metres.
    """
    ray = surface.points - eye
    distance = np.linalg.norm(ray, axis=1)
    ray /= np.maximum(distance, 1e-9)[:, None]
    elevation = np.arcsin(np.clip(ray[:, 2], -1.0, 1.0))
    cosine = np.abs(np.sum(ray * surface.normals, axis=1))
    seen = (distance >= reach[0]) & (distance <= reach[1]) & (cosine > math.cos(math.radians(MAX_ANGLE_DEG)))
    seen &= np.any([(elevation >= low) & (elevation <= high) for low, high in elevations], axis=0)
    height, width = panorama.shape
    angle = 2.0 * math.pi / width
    # Azimuth grows to the left in the image; +x is its middle.
    u = np.rint(-np.arctan2(ray[:, 1], ray[:, 0]) / angle + (width - 1) / 2).astype(np.int64) % width
    v = np.clip(np.rint(-elevation / angle + (height - 1) / 2).astype(np.int64), 0, height - 1)
    # A pixel covers a patch of a slanted surface whose far end is this much farther.
    slack = 0.03 + angle * distance * np.sqrt(1.0 - np.minimum(cosine, 1.0) ** 2) / np.maximum(cosine, 0.1)
    return np.asarray(seen & (np.abs(panorama[v, u] - distance) < slack))


def _elevations(camera: ScanCamera, tour: TourSettings) -> list[tuple[float, float]]:
    half = math.radians(camera.fov_y_deg) / 2
    return [(math.radians(pitch) - half, math.radians(pitch) + half) for pitch in tour.pitches]
