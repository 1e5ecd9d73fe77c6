"""A contact sheet that shows the renderer's features on a scene: outputs, cameras, effects, lighting. No ROS, no physics."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from gibson_sim.description.shapes import Appearance, Shape, VisualSpec
from gibson_sim.geometry.transforms import R_LINK_OPTICAL, matrix_from_pose, pose_from_xyz_rpy, quat_from_matrix
from gibson_sim.render.renderer import MeshFiles, Renderer
from gibson_sim.scenes.randomise import Rules, randomise
from gibson_sim.scenes.spec import DrawnScene, LightSpec, PointLight
from gibson_sim.sensors.depth_noise import apply_depth_noise
from gibson_sim.sensors.false_colours import colourise_depth, colourise_labels
from gibson_sim.sensors.rendered_lidar import LidarPattern, RenderedLidar, even_elevations
from gibson_sim.types import NS_PER_S, OUTPUTS, CameraSpec, DepthNoise, Frame, ImageEffects, Output, Pose, SceneState

Rgb = NDArray[np.uint8]
WIDTH, HEIGHT = 400, 300
"""Size of a picture, pixels."""
COLUMNS = 4
EYE_HEIGHT = 1.25
"""Height of the cameras above the floor, metres."""
_CAPTION, _GAP = 26, 8
"""Height of a caption, and gap between panels, pixels."""
_INK, _PAPER = (40, 40, 40), 250
"""Colours of text and background."""
_RIG = "gallery/rig"
"""Link on which the cameras are mounted."""
_FAR_SHOWN_M = 6.0
"""Depth at the end of the colour scale, metres."""
_HOLE_COLOURS = np.array([[205, 205, 205], [30, 30, 30], [200, 60, 160], [110, 160, 220]], dtype=np.uint8)
"""Colours of the values of ``Frame.hole``: surface, nothing, back face, outside the field of view or sky."""
_INTERVAL_S = 1.0 / 30.0
"""Simulation time between the two states for optical flow and motion blur, seconds."""


@dataclass(frozen=True, slots=True)
class _Panel:
    title: str
    picture: Rgb


def gallery(scene: DrawnScene, position: Pose, rules: Rules, cache: Path | None = None) -> Rgb:
    """Returns pictures of a scene with captions, (H, W, 3) uint8 sRGB.

    Args:
        scene: scene to draw; moving links are omitted.
        position: T_world_eye of the cameras; x forward, z up.
        rules: rules of the randomised pictures.
        cache: folder of the scene cache, as for ``Renderer``.
    """
    rigged = replace(scene, links=(_RIG,), visuals=tuple(v for v in scene.visuals if not v.link), cameras=())
    state, previous = _states(position, rigged.revision)
    with Renderer(rigged, meshes=MeshFiles(cache=cache)) as renderer:
        rows = [
            list(_outputs(renderer, state, previous)),
            list(_cameras(renderer, state)),
            list(_effects(renderer, state, previous)),
        ]
    rows.append(list(_light(rigged, state, rules)))
    return _sheet(rows)


def _states(position: Pose, revision: int) -> tuple[SceneState, SceneState]:
    """Returns the current and the previous state of the rig, which turns left and moves forward."""
    current = matrix_from_pose(position)
    previous = current @ matrix_from_pose(pose_from_xyz_rpy((-0.03, 0.0, 0.0), (0.0, 0.0, -0.035)))

    def state(T: NDArray[np.float64], stamp_ns: int) -> SceneState:
        quat = np.array([quat_from_matrix(T[:3, :3])])
        return SceneState(stamp_ns, 0, revision, (_RIG,), T[None, :3, 3].copy(), quat, np.zeros((1, 6)))

    return state(current, NS_PER_S), state(previous, NS_PER_S - round(_INTERVAL_S * NS_PER_S))


def _camera(**changes: object) -> CameraSpec:
    camera = CameraSpec("gallery", _RIG, Pose(quat_xyzw=quat_from_matrix(R_LINK_OPTICAL)), WIDTH, HEIGHT, math.radians(62.0))
    return replace(camera, **{"outputs": ("rgb",), "samples": 4, **changes})  # type: ignore[arg-type]


def _outputs(renderer: Renderer, state: SceneState, previous: SceneState) -> Iterator[_Panel]:
    frame = renderer.render(state, [_camera(outputs=OUTPUTS)], previous)[0]
    titles: dict[Output, str] = {
        "rgb": "rgb, 4 samples", "depth": "depth, 0 to 6 m", "semantic": "semantic class", "instance": "instance",
        "normal": "normal, camera frame", "normal_world": "normal, world frame", "position": "position, world frame", "flow": "optical flow",
        "hole": "holes",
    }  # fmt: skip
    for output in OUTPUTS:
        yield _Panel(titles[output], picture_of_output(frame, output))


def _cameras(renderer: Renderer, state: SceneState) -> Iterator[_Panel]:
    focal = 0.62 * WIDTH
    k = (focal, 0.0, 0.42 * WIDTH, 0.0, focal, 0.6 * HEIGHT, 0.0, 0.0, 1.0)
    fisheye = {"projection": "fisheye", "width": HEIGHT, "height": HEIGHT}
    turn = pose_from_xyz_rpy((0.0, 0.0, 0.0), (0.0, 0.0, math.pi))
    behind = Pose(quat_xyzw=quat_from_matrix(matrix_from_pose(turn)[:3, :3] @ R_LINK_OPTICAL))
    named = {
        "pinhole, off-centre K": _camera(matrix=k),
        "plumb_bob distortion": _camera(matrix=(focal, 0.0, WIDTH / 2, 0.0, focal, HEIGHT / 2, 0.0, 0.0, 1.0), distortion=(-0.33, 0.11, 0, 0, -0.02)),
        "fisheye 180, in front": _camera(**fisheye),
        "fisheye 180, behind": _camera(**fisheye, pose=behind),
        "equirectangular": _camera(projection="equirectangular", width=2 * WIDTH + _GAP, height=WIDTH),
    }  # fmt: skip
    frames = renderer.render(state, list(named.values()))
    for title, frame in zip(named, frames, strict=True):
        assert frame.rgb is not None
        yield _Panel(title, frame.rgb)
    lidar = RenderedLidar(_RIG, LidarPattern(even_elevations(64, math.radians(-40.0), math.radians(25.0)), 1024))
    scan = lidar.measure(state, renderer)
    yield _Panel("lidar, 64 beams x 1024", _lidar_picture(scan.points))
    noisy = _camera(outputs=("depth", "normal"))
    noise = DepthNoise(quadratic=0.004, disparity_step_px=0.125, hole_angle_deg=78.0, hole_fraction=0.004)
    frame = apply_depth_noise(renderer.render(state, [noisy])[0], noise)
    yield _Panel("depth camera: noise, steps, holes", picture_of_output(frame, "depth"))


def _effects(renderer: Renderer, state: SceneState, previous: SceneState) -> Iterator[_Panel]:
    effects = {
        "exposure +1 EV": ImageEffects(exposure_ev=1.0),
        "white balance 3500 K": ImageEffects(white_balance_k=3500.0),
        "vignette, sensor noise": ImageEffects(vignette=0.8, shot_noise=0.06, read_noise=0.015),
        "motion blur, 33 ms": ImageEffects(shutter_s=_INTERVAL_S),
    }
    for title, effect in effects.items():
        frame = renderer.render(state, [_camera(samples=1, effects=effect)], previous)[0]
        assert frame.rgb is not None
        yield _Panel(title, frame.rgb)


def _light(scene: DrawnScene, state: SceneState, rules: Rules) -> Iterator[_Panel]:
    eye = state.positions[0]
    lamp = PointLight((float(eye[0]), float(eye[1]), float(eye[2]) + 0.7), (1.0, 0.86, 0.66), 1.6, range=9.0)
    lamps = replace(scene, light=replace(scene.light, sun=0.0, ambient=0.12, points=(lamp,)))
    yield _panel("a lamp by night", lamps, state, _camera())
    for seed in range(2):
        yield _panel(f"randomised, seed {seed}", randomise(scene, seed, rules), state, _camera())
    studio, camera = _studio(scene)
    yield _panel("metal and matt, sun shadows", studio, state, camera)


def _panel(title: str, scene: DrawnScene, state: SceneState, camera: CameraSpec) -> _Panel:
    with Renderer(scene) as renderer:
        rgb = renderer.render(state, [camera])[0].rgb
    assert rgb is not None
    return _Panel(title, rgb)


def _studio(scene: DrawnScene) -> tuple[DrawnScene, CameraSpec]:
    """Returns a scene of metal and plastic balls, from polished to matte, on a floor in the sun, and its camera."""
    columns, spacing = 5, 0.5
    visuals = [
        VisualSpec("floor", "", Shape("box", (9.0, 9.0, 0.2)), pose_from_xyz_rpy((0.0, 0.0, -0.1)), (0.62, 0.6, 0.57, 1.0))
    ]
    for row, (metallic, color) in enumerate(((1.0, (1.0, 0.78, 0.34, 1.0)), (0.0, (0.72, 0.1, 0.09, 1.0)))):
        for column in range(columns):
            position = (row * 0.55, (column - (columns - 1) / 2) * -spacing, 0.22)
            appearance = Appearance(metallic=metallic, roughness=0.12 + 0.8 * column / (columns - 1))
            visuals.append(
                VisualSpec(
                    f"ball {row} {column}",
                    "",
                    Shape("sphere", (0.22, 0.0, 0.0)),
                    pose_from_xyz_rpy(position),
                    color,
                    appearance=appearance,
                )
            )
    light = LightSpec(
        (0.35, -0.5, -0.62), 0.9, 0.28, (0.66, 0.74, 0.84), shadows=True, points=(PointLight((-1.2, 1.2, 2.0), strength=1.2),)
    )
    tilt = pose_from_xyz_rpy((-2.1, 0.0, 1.15), (0.0, math.radians(22.0), 0.0))
    optical = matrix_from_pose(tilt)[:3, :3] @ R_LINK_OPTICAL
    camera = replace(_camera(), link="", pose=Pose(tilt.position, quat_from_matrix(optical)), fov_y=math.radians(48.0))
    return replace(scene, visuals=tuple(visuals), light=light), camera


def picture_of_output(frame: Frame, output: Output) -> Rgb:
    """Returns a visualisation of an output, (H, W, 3) uint8: labels in distinct colours, directions and positions as RGB."""
    pictures: dict[Output, Callable[[Frame], Rgb]] = {
        "rgb": lambda f: _required(f.rgb).copy(),
        "depth": lambda f: np.ascontiguousarray(colourise_depth(_required(f.depth), _FAR_SHOWN_M)[:, :, ::-1]),
        "semantic": lambda f: colourise_labels(_required(f.semantic))[:, :, ::-1],
        "instance": lambda f: colourise_labels(_required(f.instance))[:, :, ::-1],
        "normal": lambda f: _direction_picture(_required(f.normal)),
        "normal_world": lambda f: _direction_picture(_required(f.normal_world)),
        "position": lambda f: _position_picture(_required(f.position)),
        "flow": lambda f: _flow_picture(_required(f.flow)),
        "hole": lambda f: _HOLE_COLOURS[_required(f.hole)],
    }
    return pictures[output](frame)


def _required(array: NDArray[Any] | None) -> NDArray[Any]:
    if array is None:
        raise ValueError("the frame does not have this output")
    return array


def _direction_picture(normals: NDArray[Any]) -> Rgb:
    return np.asarray(np.rint(127.5 * (normals + 1.0)), dtype=np.uint8)


def _position_picture(points: NDArray[Any]) -> Rgb:
    flat = points.reshape(-1, 3)
    low, high = np.nanpercentile(flat, 1, axis=0), np.nanpercentile(flat, 99, axis=0)
    fraction = np.clip((points - low) / np.maximum(high - low, 1e-6), 0.0, 1.0)
    return np.asarray(np.nan_to_num(255.0 * fraction), dtype=np.uint8)


def _flow_picture(flow: NDArray[Any]) -> Rgb:
    """Returns a picture of flow with direction as hue and length as brightness."""
    x, y = np.nan_to_num(flow[..., 0]), np.nan_to_num(flow[..., 1])
    length, angle = np.hypot(x, y), np.arctan2(y, x)
    hsv = np.stack(
        [(angle / np.pi + 1.0) * 90.0, np.full(x.shape, 200.0), 255.0 * np.clip(length / np.percentile(length, 99), 0, 1)],
        axis=-1,
    )
    return np.asarray(cv2.cvtColor(hsv.astype(np.uint8), cv2.COLOR_HSV2RGB), dtype=np.uint8)


def _lidar_picture(points: NDArray[Any]) -> Rgb:
    """Returns an oblique view of points, (N, 3), from above and behind, coloured by height."""
    picture = np.full((HEIGHT, WIDTH, 3), 20, dtype=np.uint8)
    tilt = math.radians(52.0)
    x, y, z = points[:, 0], points[:, 1], points[:, 2]
    up = z * math.cos(tilt) + x * math.sin(tilt)
    scale = min(WIDTH, HEIGHT) / 6.5
    column = np.rint(WIDTH / 2 - y * scale).astype(int)
    row = np.rint(0.62 * HEIGHT - up * scale).astype(int)
    inside = (column >= 0) & (column < WIDTH) & (row >= 0) & (row < HEIGHT)
    level = np.clip((z + EYE_HEIGHT) / 2.6, 0.0, 1.0)
    colors = np.asarray(cv2.applyColorMap((255 * level).astype(np.uint8)[:, None], cv2.COLORMAP_TURBO))[:, 0, ::-1]
    order = np.argsort(z[inside], kind="stable")
    picture[row[inside][order], column[inside][order]] = colors[inside][order]
    return np.asarray(cv2.dilate(picture, np.ones((2, 2), np.uint8)), dtype=np.uint8)


def _sheet(rows: Sequence[Sequence[_Panel]]) -> Rgb:
    """Returns pictures with captions arranged in rows of equal width; a picture may be two columns wide."""
    lines: list[Rgb] = []
    width = COLUMNS * WIDTH + (COLUMNS + 1) * _GAP
    for panels in rows:
        line: list[Rgb] = []
        x = _GAP
        for panel in panels:
            cell = _cell(panel)
            if x + cell.shape[1] > width:
                lines.append(_line(line, width))
                line, x = [], _GAP
            line.append(cell)
            x += cell.shape[1] + _GAP
        lines.append(_line(line, width))
    return np.concatenate(lines)


def _cell(panel: _Panel) -> Rgb:
    """Returns a picture with its caption, scaled to one column, or to two if it is wide."""
    height, width = panel.picture.shape[:2]
    wide = 2 * WIDTH + _GAP if width > 1.8 * height else WIDTH
    scale = min(wide / width, HEIGHT / height)
    size = (round(width * scale), round(height * scale))
    picture = panel.picture if size == (width, height) else cv2.resize(panel.picture, size, interpolation=cv2.INTER_AREA)
    cell = np.full((HEIGHT + _CAPTION, wide, 3), _PAPER, dtype=np.uint8)
    x = (wide - size[0]) // 2
    cell[: size[1], x : x + size[0]] = picture
    cv2.putText(cell, panel.title, (x + 2, HEIGHT + 18), cv2.FONT_HERSHEY_SIMPLEX, 0.5, _INK, 1, cv2.LINE_AA)
    return cell


def _line(cells: Sequence[Rgb], width: int) -> Rgb:
    line = np.full((HEIGHT + _CAPTION + _GAP, width, 3), _PAPER, dtype=np.uint8)
    x = _GAP
    for cell in cells:
        line[_GAP : _GAP + cell.shape[0], x : x + cell.shape[1]] = cell
        x += cell.shape[1] + _GAP
    return line
