"""Renders a scene without a display: views from free positions at eye height, from above, and its floor map, on one sheet."""

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
from gibson_sim.maps.floor_map import FLOOR_TOLERANCE, FloorMap, floor_name, make_floor_map
from gibson_sim.maps.traversability import scene_triangles
from gibson_sim.quoting import quoted
from gibson_sim.render.cache import default_folder
from gibson_sim.render.renderer import MeshFiles, Renderer
from gibson_sim.scenes.scene_meshes import collision_triangles
from gibson_sim.scenes.spec import SceneSpec, drawn_scene
from gibson_sim.types import CameraSpec, Pose, SceneState

Rgb = NDArray[np.uint8]
F64 = NDArray[np.float64]
WIDTH, HEIGHT = 640, 480
"""Size of one view, pixels."""
EYE_HEIGHT = 1.25
"""Height of the eye-height cameras above the floor, m."""
CUT_HEIGHT = 2.1
"""Height above the floor at which the top view cuts the building, m."""
ROBOT_RADIUS, ROBOT_HEIGHT = 0.2, 0.5
"""Size of the robot for which positions are free, m."""
_COLUMNS, _GAP, _CAPTION = 3, 6, 22
_BACKGROUND, _TEXT_COLOR = 250, (50, 50, 50)
_CANDIDATES, _HEADINGS_PER_CANDIDATE = 15, 8
"""Number of candidate positions, and of headings at each."""
_GOOD_DEPTH, _VIEW_DISTANCE = 5.0, 2.0
"""Median depth from which a view is good, and distance from which two views are independent, m."""
_FREE, _OCCUPIED, _UNKNOWN = (255, 255, 255), (40, 40, 40), (178, 178, 178)


def contact_sheet(scene: SceneSpec, views: int, *, floor_z: float | None = None) -> Rgb:
    """Returns a sheet of views of a scene, (H, W, 3) uint8 sRGB.

    Args:
        scene: the scene.
        views: number of views at eye height, spread over the free floor.
        floor_z: height of the floor to show; None = the one that robots start on.

    Raises:
        SceneError: the scene has no free floor, or nothing but the ground.
    """
    if scene.is_only_ground:
        raise SceneError(f"scene {quoted(scene.name)}: has nothing but the ground, so there is nothing to show")
    level = scene if floor_z is None else replace(scene, floor_z=floor_z, other_floors=scene.floors)
    floor = _floor_with_bodies(level)
    with _static_renderer(scene) as renderer:
        eyes = _eye_cameras(renderer, level, floor, views)
        pictures = [_rendered(renderer, scene, camera) for camera in (*eyes, _top_view_camera(level))]
    places = np.array([eye.pose.position[:2] for eye in eyes])
    yaws = [_heading(eye) for eye in eyes]
    where = f"{floor_name(level)}, " if floor_name(level) else ""
    titled = [
        (f"{where}view {k + 1} at {x:.1f}, {y:.1f}", p)
        for k, ((x, y), p) in enumerate(zip(places.tolist(), pictures, strict=False))
    ]
    titled.append((f"{where}from above", pictures[-1]))
    titled.append((f"{where}map, {floor.resolution:g} m per cell", map_picture(floor, places, yaws)))
    return sheet(titled)


def gallery_of_scenes(scenes: Iterable[SceneSpec], views: int) -> Rgb:
    """Returns views at eye height of several scenes, one row for each scene, (H, W, 3) uint8 sRGB.

    Args:
        scenes: the scenes.
        views: number of views of each scene; the floors of a scene alternate, the lowest first.

    Raises:
        SceneError: a scene has no free floor.
    """
    titled = []
    for scene in scenes:
        levels = [replace(scene, floor_z=z, other_floors=scene.floors) for z in scene.floors]
        counts = [len(range(k, views, len(levels))) for k in range(len(levels))]
        with _static_renderer(scene) as renderer:
            for level, count in zip(levels, counts, strict=True):
                if not count:
                    continue
                title = ", ".join(filter(None, (scene.name, floor_name(level))))
                for eye in _eye_cameras(renderer, level, _floor_with_bodies(level), count):
                    titled.append((title, _rendered(renderer, scene, eye)))
    return sheet(titled, views)


def _static_renderer(scene: SceneSpec) -> Renderer:
    """Returns a renderer of a scene with its bodies at their initial poses."""
    static_scene = replace(scene, visuals=still_visuals(scene), robots=(), bodies=())
    return Renderer(drawn_scene(static_scene, ()), meshes=MeshFiles(cache=default_folder()))


def _rendered(renderer: Renderer, scene: SceneSpec, camera: CameraSpec) -> Rgb:
    picture = renderer.render(SceneState.still(scene.revision), [camera])[0].rgb
    assert picture is not None
    return picture


def _eye_cameras(renderer: Renderer, level: SceneSpec, floor: FloorMap, count: int) -> list[CameraSpec]:
    """Returns ``count`` cameras at eye height that see much of a floor."""
    candidates = free_places(floor, _CANDIDATES)
    if not len(candidates):
        raise SceneError(
            f"scene {quoted(level.name)}: no free position on the floor at z = {level.floor_z:.2f} m; run `gibson-sim scene check`"
        )
    z = level.floor_z + EYE_HEIGHT
    places, yaws = _best_views(renderer, SceneState.still(level.revision), candidates, z, count)
    return [_eye_camera(x, y, z, yaw) for (x, y), yaw in zip(places.tolist(), yaws, strict=True)]


def _heading(camera: CameraSpec) -> float:
    """Returns the heading of a camera's optical axis, radians."""
    x, y, _ = rotated(camera.pose.quat_xyzw, (0.0, 0.0, 1.0))
    return math.atan2(y, x)


def _floor_with_bodies(scene: SceneSpec) -> FloorMap:
    """Returns the map of the floor that robots start on, with bodies at their initial poses."""
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
    """Returns free positions, (N, 2), world x, y, m, far from each other; two thirds of them in the largest free region."""
    in_largest_region = _spread(floor, floor.largest_free_region(ROBOT_RADIUS), count - count // 3)
    return np.concatenate([in_largest_region, _spread(floor, floor.inflate(ROBOT_RADIUS), count // 3)])


def _spread(floor: FloorMap, region: NDArray[np.bool_], count: int) -> F64:
    """Returns positions (N, 2) in a region by farthest-point sampling, starting at the largest clearance."""
    cells = np.argwhere(region)
    if not len(cells) or not count:
        return np.zeros((0, 2))
    clearance = floor.distance_to_obstacle[tuple(cells.T)]
    points = floor.centers(cells)
    # Close to a wall, a camera sees only the wall.
    is_open = clearance >= min(0.45, float(np.quantile(clearance, 0.6)))
    points, clearance = points[is_open], clearance[is_open]
    selected = [int(clearance.argmax())]
    distance = np.full(len(points), np.inf)
    while len(selected) < min(count, len(points)):
        distance = np.minimum(distance, np.linalg.norm(points - points[selected[-1]], axis=1))
        selected.append(int((distance * np.clip(clearance, 0.2, 1.0)).argmax()))
    return points[selected]


def _best_views(renderer: Renderer, state: SceneState, places: F64, z: float, count: int) -> tuple[F64, list[float]]:
    """Returns positions (N, 2) and headings, radians, far from each other, with large and varied depth.

    Each candidate is rendered as a thumbnail and scored by its depth image.
    """
    # Oblique to x and y, along which most walls run.
    headings = ((np.arange(_HEADINGS_PER_CANDIDATE) + 0.4) * 2 * math.pi / _HEADINGS_PER_CANDIDATE).tolist()
    positions = np.repeat(places, _HEADINGS_PER_CANDIDATE, axis=0)
    yaws = np.tile(headings, len(places))
    scores = np.zeros(len(positions))
    for k, ((x, y), yaw) in enumerate(zip(positions.tolist(), yaws.tolist(), strict=True)):
        thumbnail = replace(_eye_camera(x, y, z, yaw), width=WIDTH // 10, height=HEIGHT // 10, outputs=("depth",), samples=1)
        depth = renderer.render(state, [thumbnail])[0].depth
        assert depth is not None
        has_depth = np.isfinite(depth)
        if has_depth.any():
            # Depth varies where objects stand in front of walls; a view of a bare wall has little variation.
            median_depth, depth_deviation = (
                float(np.median(depth[has_depth])),
                float(np.std(np.minimum(depth[has_depth], 2 * _GOOD_DEPTH))),
            )
            scores[k] = float(has_depth.mean()) * min(median_depth / _GOOD_DEPTH, 1.0) * (0.5 + min(depth_deviation, 1.0))
    selected: list[int] = []
    novelty = np.ones(len(positions))
    while len(selected) < count:
        selected.append(int((scores * novelty).argmax()))
        distance = np.linalg.norm(positions - positions[selected[-1]], axis=1)
        turn = np.abs((yaws - yaws[selected[-1]] + math.pi) % (2 * math.pi) - math.pi)
        # The opposite heading at the same position is a different view.
        novelty = np.minimum(novelty, np.clip(distance / _VIEW_DISTANCE + 0.25 * turn / math.pi, 0.01, 1.0))
    return positions[selected], [float(yaws[k]) for k in selected]


def _eye_camera(x: float, y: float, z: float, yaw: float) -> CameraSpec:
    """Returns a camera at a position, m, with a heading, radians, tilted slightly down."""
    matrix = matrix_from_pose(pose_from_xyz_rpy((x, y, z), (0.0, math.radians(6.0), yaw)))
    pose = Pose((x, y, z), quat_from_matrix(matrix[:3, :3] @ R_LINK_OPTICAL))
    return CameraSpec("view", "", pose, WIDTH, HEIGHT, math.radians(62.0), outputs=("rgb",), samples=4)


def _top_view_camera(scene: SceneSpec) -> CameraSpec:
    """Returns a camera that sees the whole floor from above, the building cut at ``CUT_HEIGHT`` by its near plane."""
    vertices, _ = collision_triangles(scene)
    if not len(vertices):
        vertices = scene_triangles(scene).reshape(-1, 3)
    low, high = vertices[:, :2].min(axis=0), vertices[:, :2].max(axis=0)
    (width, depth), middle = (high - low).tolist(), (low + high) / 2
    fov = math.radians(30.0)
    distance = 1.05 * max(depth, width * HEIGHT / WIDTH) / 2 / math.tan(fov / 2) + CUT_HEIGHT
    # As in the map: x to the right, y up.
    rotation = np.diag([1.0, -1.0, -1.0])
    pose = Pose((float(middle[0]), float(middle[1]), scene.floor_z + distance), quat_from_matrix(rotation))
    return CameraSpec(
        "above", "", pose, WIDTH, HEIGHT, fov, near=distance - CUT_HEIGHT, far=distance + 100.0, outputs=("rgb",), samples=4
    )


def map_picture(floor: FloorMap, places: F64, yaws: Sequence[float]) -> Rgb:
    """Returns the floor map, (HEIGHT, WIDTH, 3) uint8, y up, with numbered views: free = white, occupied = dark, unknown = grey."""
    colors = np.empty((*floor.shape, 3), dtype=np.uint8)
    colors[:] = _UNKNOWN
    colors[floor.floor] = _FREE
    colors[floor.occupied] = _OCCUPIED
    rows, columns = floor.shape
    scale = min(WIDTH / columns, HEIGHT / rows)
    size = (max(1, int(columns * scale)), max(1, int(rows * scale)))
    image = cv2.resize(colors[::-1], size, interpolation=cv2.INTER_AREA if scale < 1 else cv2.INTER_NEAREST)
    for number, ((x, y), yaw) in enumerate(zip(places.tolist(), yaws, strict=True)):
        at = (np.array([x, y]) - floor.origin) / floor.resolution * scale
        tip = at + 14.0 * np.array([math.cos(yaw), math.sin(yaw)])
        start, end = ((round(float(p[0])), round(size[1] - float(p[1]))) for p in (at, tip))
        cv2.arrowedLine(image, start, end, (30, 110, 220), 2, cv2.LINE_AA, tipLength=0.4)
        cv2.putText(
            image, str(number + 1), (start[0] + 5, start[1] - 5), cv2.FONT_HERSHEY_SIMPLEX, 0.45, (200, 40, 30), 1, cv2.LINE_AA
        )
    out = np.full((HEIGHT, WIDTH, 3), _BACKGROUND, dtype=np.uint8)
    top, left = (HEIGHT - image.shape[0]) // 2, (WIDTH - image.shape[1]) // 2
    out[top : top + image.shape[0], left : left + image.shape[1]] = image
    return out


def sheet(pictures: Sequence[tuple[str, Rgb]], columns: int = _COLUMNS) -> Rgb:
    """Arranges captioned views in rows on one sheet."""
    rows = math.ceil(len(pictures) / columns)
    cell = (HEIGHT + _CAPTION + _GAP, WIDTH + _GAP)
    out = np.full((rows * cell[0] + _GAP, min(columns, len(pictures)) * cell[1] + _GAP, 3), _BACKGROUND, dtype=np.uint8)
    for k, (title, picture) in enumerate(pictures):
        top, left = _GAP + k // columns * cell[0], _GAP + k % columns * cell[1]
        out[top : top + HEIGHT, left : left + WIDTH] = picture
        position = (left + 4, top + HEIGHT + _CAPTION - 6)
        cv2.putText(out, title, position, cv2.FONT_HERSHEY_SIMPLEX, 0.5, _TEXT_COLOR, 1, cv2.LINE_AA)
    return out
