"""Pictures of a scene without a display: from free places at eye height, from above, and its floor map, on one sheet."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import replace

import cv2
import numpy as np
from numpy.typing import NDArray

from gibson_sim.errors import SceneError
from gibson_sim.geometry.transforms import R_LINK_OPTICAL, matrix_from_pose, pose_from_xyz_rpy, quat_from_matrix, rotated
from gibson_sim.maps.bodies import still_visuals
from gibson_sim.maps.floor_map import FLOOR_TOLERANCE, FloorMap, make_floor_map
from gibson_sim.maps.traversability import scene_triangles
from gibson_sim.quoting import quoted
from gibson_sim.render.cache import default_folder
from gibson_sim.render.renderer import Renderer
from gibson_sim.scenes.scene_meshes import collision_triangles
from gibson_sim.scenes.spec import SceneSpec, drawn_scene
from gibson_sim.types import CameraSpec, Pose, SceneState

Rgb = NDArray[np.uint8]
F64 = NDArray[np.float64]
WIDTH, HEIGHT = 640, 480
"""Size of one picture, pixels."""
EYE_HEIGHT = 1.25
"""Metres above the floor."""
CUT_HEIGHT = 2.1
"""Height above the floor at which the top view cuts the building, metres."""
ROBOT_RADIUS, ROBOT_HEIGHT = 0.2, 0.5
_COLUMNS, _GAP, _CAPTION = 3, 6, 22
_PAPER, _INK = 250, (50, 50, 50)
_PLACES, _HEADINGS = 15, 8
_FAR_ENOUGH, _APART = 5.0, 2.0
"""Depth of a good view, and distance between views, metres."""
_FREE, _OCCUPIED, _UNKNOWN = (255, 255, 255), (40, 40, 40), (178, 178, 178)


def contact_sheet(scene: SceneSpec, views: int, *, floor_z: float | None = None) -> Rgb:
    """Returns pictures of a scene, (H, W, 3) uint8 sRGB.

    Args:
        scene: the scene.
        views: number of pictures at eye height, spread over the free floor.
        floor_z: height of the floor to show; None = the one that robots start on.

    Raises:
        SceneError: the scene has no free floor.
    """
    level = scene if floor_z is None else replace(scene, floor_z=floor_z)
    floor = _floor_with_bodies(level)
    with _still_renderer(scene) as renderer:
        eyes = _eyes(renderer, level, floor, views)
        pictures = [_drawn(renderer, scene, camera) for camera in (*eyes, _from_above(level))]
    places = np.array([eye.pose.position[:2] for eye in eyes])
    yaws = [_heading(eye) for eye in eyes]
    named = [
        (f"view {k + 1} at {x:.1f}, {y:.1f}", p) for k, ((x, y), p) in enumerate(zip(places.tolist(), pictures, strict=False))
    ]
    named.append(("from above", pictures[-1]))
    named.append((f"floor map, {floor.resolution:g} m a cell", map_picture(floor, places, yaws)))
    return sheet(named)


def gallery_of_scenes(scenes: Iterable[SceneSpec], views: int) -> Rgb:
    """Returns pictures at eye height of several scenes, a row for each, (H, W, 3) uint8 sRGB.

    Args:
        scenes: the scenes.
        views: pictures of each; the floors of a scene alternate, the lowest first.

    Raises:
        SceneError: a scene has no free floor.
    """
    named = []
    for scene in scenes:
        levels = [replace(scene, floor_z=z) for z in scene.floors] or [scene]
        counts = [len(range(k, views, len(levels))) for k in range(len(levels))]
        with _still_renderer(scene) as renderer:
            for number, (level, count) in enumerate(zip(levels, counts, strict=True)):
                if not count:
                    continue
                title = scene.name if len(levels) == 1 else f"{scene.name}, floor {number}"
                for eye in _eyes(renderer, level, _floor_with_bodies(level), count):
                    named.append((title, _drawn(renderer, scene, eye)))
    return sheet(named, views)


def _still_renderer(scene: SceneSpec) -> Renderer:
    """Returns a renderer of a scene with its bodies where they stand at load."""
    still = replace(scene, visuals=still_visuals(scene), robots=(), bodies=())
    return Renderer(drawn_scene(still, ()), cache=default_folder())


def _drawn(renderer: Renderer, scene: SceneSpec, camera: CameraSpec) -> Rgb:
    picture = renderer.render(SceneState.still(scene.revision), [camera])[0].rgb
    assert picture is not None
    return picture


def _eyes(renderer: Renderer, level: SceneSpec, floor: FloorMap, count: int) -> list[CameraSpec]:
    """Returns cameras at eye height that see much of a floor."""
    candidates = free_places(floor, _PLACES)
    if not len(candidates):
        raise SceneError(
            f"scene {quoted(level.name)}: nothing is free on the floor at z = {level.floor_z:.2f} m; look at `gibson-sim scene check`"
        )
    z = level.floor_z + EYE_HEIGHT
    places, yaws = _best(renderer, SceneState.still(level.revision), candidates, z, count)
    return [_eye(x, y, z, yaw) for (x, y), yaw in zip(places.tolist(), yaws, strict=True)]


def _heading(camera: CameraSpec) -> float:
    """Returns the heading of a level camera's picture, radians."""
    x, y, _ = rotated(camera.pose.quat_xyzw, (0.0, 0.0, 1.0))
    return math.atan2(y, x)


def _floor_with_bodies(scene: SceneSpec) -> FloorMap:
    """Returns the map of the floor that robots start on, with bodies where they stand at load."""
    corners = scene_triangles(scene)
    ground = scene.ground_z is not None and abs(scene.ground_z - scene.floor_z) <= FLOOR_TOLERANCE
    return make_floor_map(
        corners.reshape(-1, 3),
        np.arange(3 * len(corners)).reshape(-1, 3),
        floor_z=scene.floor_z,
        robot_height=ROBOT_HEIGHT,
        ground_plane=ground,
    )


def free_places(floor: FloorMap, count: int) -> F64:
    """Returns free places, (N, 2), world x, y, far from each other; two thirds of them are in the largest free region."""
    inside = _spread(floor, floor.largest_free_region(ROBOT_RADIUS), count - count // 3)
    return np.concatenate([inside, _spread(floor, floor.inflate(ROBOT_RADIUS), count // 3)])


def _spread(floor: FloorMap, region: NDArray[np.bool_], count: int) -> F64:
    """Returns places in a region by farthest-point sampling, beginning at the most open one."""
    cells = np.argwhere(region)
    if not len(cells) or not count:
        return np.zeros((0, 2))
    room = floor.distance_to_obstacle[tuple(cells.T)]
    points = floor.centers(cells)
    # Close to a wall, a camera sees nothing but the wall.
    roomy = room >= min(0.45, float(np.quantile(room, 0.6)))
    points, room = points[roomy], room[roomy]
    chosen = [int(room.argmax())]
    distance = np.full(len(points), np.inf)
    while len(chosen) < min(count, len(points)):
        distance = np.minimum(distance, np.linalg.norm(points - points[chosen[-1]], axis=1))
        chosen.append(int((distance * np.clip(room, 0.2, 1.0)).argmax()))
    return points[chosen]


def _best(renderer: Renderer, state: SceneState, places: F64, z: float, count: int) -> tuple[F64, list[float]]:
    """Returns places (N, 2) and headings, far from each other, that see much of the scene and nothing too near.

    Each candidate is rendered as a thumbnail and scored by its depth.
    """
    # Not parallel to the walls, most of which run along x or y.
    headings = ((np.arange(_HEADINGS) + 0.4) * 2 * math.pi / _HEADINGS).tolist()
    at = np.repeat(places, _HEADINGS, axis=0)
    yaws = np.tile(headings, len(places))
    worth = np.zeros(len(at))
    for k, ((x, y), yaw) in enumerate(zip(at.tolist(), yaws.tolist(), strict=True)):
        stamp = replace(_eye(x, y, z, yaw), width=WIDTH // 10, height=HEIGHT // 10, outputs=("depth",), samples=1)
        depth = renderer.render(state, [stamp])[0].depth
        assert depth is not None
        seen = np.isfinite(depth)
        if seen.any():
            # Depth varies where objects stand before walls; a view along or onto a wall shows neither.
            far, varied = float(np.median(depth[seen])), float(np.std(np.minimum(depth[seen], 2 * _FAR_ENOUGH)))
            worth[k] = float(seen.mean()) * min(far / _FAR_ENOUGH, 1.0) * (0.5 + min(varied, 1.0))
    chosen: list[int] = []
    apart = np.ones(len(at))
    while len(chosen) < count:
        chosen.append(int((worth * apart).argmax()))
        distance = np.linalg.norm(at - at[chosen[-1]], axis=1)
        turn = np.abs((yaws - yaws[chosen[-1]] + math.pi) % (2 * math.pi) - math.pi)
        # The opposite heading at the same place is another picture.
        apart = np.minimum(apart, np.clip(distance / _APART + 0.25 * turn / math.pi, 0.01, 1.0))
    return at[chosen], [float(yaws[k]) for k in chosen]


def _eye(x: float, y: float, z: float, yaw: float) -> CameraSpec:
    matrix = matrix_from_pose(pose_from_xyz_rpy((x, y, z), (0.0, math.radians(6.0), yaw)))
    pose = Pose((x, y, z), quat_from_matrix(matrix[:3, :3] @ R_LINK_OPTICAL))
    return CameraSpec("view", "", pose, WIDTH, HEIGHT, math.radians(62.0), outputs=("rgb",), samples=4)


def _from_above(scene: SceneSpec) -> CameraSpec:
    """Returns a top-view camera of the whole floor, the building cut at ``CUT_HEIGHT``."""
    vertices, _ = collision_triangles(scene)
    low, high = vertices[:, :2].min(axis=0), vertices[:, :2].max(axis=0)
    (width, depth), middle = (high - low).tolist(), (low + high) / 2
    fov = math.radians(30.0)
    above = 1.05 * max(depth, width * HEIGHT / WIDTH) / 2 / math.tan(fov / 2) + CUT_HEIGHT
    # As the map is drawn: x to the right, y up.
    rotation = np.diag([1.0, -1.0, -1.0])
    pose = Pose((float(middle[0]), float(middle[1]), scene.floor_z + above), quat_from_matrix(rotation))
    return CameraSpec(
        "above", "", pose, WIDTH, HEIGHT, fov, near=above - CUT_HEIGHT, far=above + 100.0, outputs=("rgb",), samples=4
    )


def map_picture(floor: FloorMap, places: F64, yaws: Sequence[float]) -> Rgb:
    """Returns the floor map, (HEIGHT, WIDTH, 3), north up, with the views: free = white, occupied = dark, unknown = grey."""
    colors = np.empty((*floor.shape, 3), dtype=np.uint8)
    colors[:] = _UNKNOWN
    colors[floor.floor] = _FREE
    colors[floor.occupied] = _OCCUPIED
    rows, columns = floor.shape
    scale = min(WIDTH / columns, HEIGHT / rows)
    size = (max(1, int(columns * scale)), max(1, int(rows * scale)))
    small = cv2.resize(colors[::-1], size, interpolation=cv2.INTER_AREA if scale < 1 else cv2.INTER_NEAREST)
    for number, ((x, y), yaw) in enumerate(zip(places.tolist(), yaws, strict=True)):
        at = (np.array([x, y]) - floor.origin) / floor.resolution * scale
        tip = at + 14.0 * np.array([math.cos(yaw), math.sin(yaw)])
        start, end = ((round(float(p[0])), round(size[1] - float(p[1]))) for p in (at, tip))
        cv2.arrowedLine(small, start, end, (30, 110, 220), 2, cv2.LINE_AA, tipLength=0.4)
        cv2.putText(
            small, str(number + 1), (start[0] + 5, start[1] - 5), cv2.FONT_HERSHEY_SIMPLEX, 0.45, (200, 40, 30), 1, cv2.LINE_AA
        )
    out = np.full((HEIGHT, WIDTH, 3), _PAPER, dtype=np.uint8)
    top, left = (HEIGHT - small.shape[0]) // 2, (WIDTH - small.shape[1]) // 2
    out[top : top + small.shape[0], left : left + small.shape[1]] = small
    return out


def sheet(pictures: Sequence[tuple[str, Rgb]], columns: int = _COLUMNS) -> Rgb:
    """Returns pictures of one size with captions, in rows."""
    rows = math.ceil(len(pictures) / columns)
    cell = (HEIGHT + _CAPTION + _GAP, WIDTH + _GAP)
    out = np.full((rows * cell[0] + _GAP, min(columns, len(pictures)) * cell[1] + _GAP, 3), _PAPER, dtype=np.uint8)
    for k, (title, picture) in enumerate(pictures):
        top, left = _GAP + k // columns * cell[0], _GAP + k % columns * cell[1]
        out[top : top + HEIGHT, left : left + WIDTH] = picture
        where = (left + 4, top + HEIGHT + _CAPTION - 6)
        cv2.putText(out, title, where, cv2.FONT_HERSHEY_SIMPLEX, 0.5, _INK, 1, cv2.LINE_AA)
    return out
