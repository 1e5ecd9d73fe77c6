"""Converts scenes, their states and floor maps to messages, and scenes and states back."""

from __future__ import annotations

import math
from array import array
from dataclasses import asdict, fields
from typing import TYPE_CHECKING, Any

import numpy as np
from geometry_msgs.msg import Point
from nav_msgs.msg import MapMetaData, OccupancyGrid
from std_msgs.msg import ColorRGBA

from gibson_msgs.msg import (
    Appearance as RosAppearance,
    Camera as RosCamera,
    DepthNoise as RosDepthNoise,
    ImageEffects as RosImageEffects,
    Light as RosLight,
    PointLight as RosPointLight,
    Scene as RosScene,
    SceneState as RosSceneState,
    Visual as RosVisual,
)
from gibson_sim.bags.stamps import time_from_msg
from gibson_sim.description.shapes import Appearance, Pattern, Shape, ShapeKind, VisualSpec
from gibson_sim.errors import SceneError
from gibson_sim.quoting import quoted
from gibson_sim.ros.conversions.basics import (
    header_to_msg,
    pose_from_msg,
    pose_to_msg,
    time_to_msg,
    vector_from_msg,
    vector_to_msg,
)
from gibson_sim.scenes.spec import UNLABELLED, DrawnScene, LightSpec, PointLight, SplatsSpec
from gibson_sim.types import OUTPUTS, WORLD_FRAME, CameraSpec, DepthNoise, ImageEffects, SceneState, Vec3

if TYPE_CHECKING:  # maps import SciPy: 0.4 s at each start of a render node, which needs no map
    from gibson_sim.maps.floor_map import FloorMap

_FREE, _OCCUPIED, _UNKNOWN = 0, 100, -1
_SHAPES: dict[ShapeKind, int] = {
    "mesh": RosVisual.SHAPE_MESH,
    "box": RosVisual.SHAPE_BOX,
    "sphere": RosVisual.SHAPE_SPHERE,
    "cylinder": RosVisual.SHAPE_CYLINDER,
    "capsule": RosVisual.SHAPE_CAPSULE,
    "ellipsoid": RosVisual.SHAPE_ELLIPSOID,
    "cone": RosVisual.SHAPE_CONE,
}
_FILL, _FILL_DEPTH = "fill:", "fill_depth"
"""Entries among the outputs of a camera in a message: prefix of the hole filling method, and flag that depth is filled, too."""
_SHAPE_KINDS = {number: kind for kind, number in _SHAPES.items()}


def scene_to_msg(scene: DrawnScene, stamp_ns: int) -> RosScene:
    """Returns the scene as a message."""
    link_index = {name: i for i, name in enumerate(scene.links)}
    link_index[""] = -1
    class_index = {name: i for i, name in enumerate(scene.semantic_classes)}
    class_index[""] = 0
    return RosScene(
        header=header_to_msg(stamp_ns, WORLD_FRAME),
        name=scene.name,
        revision=scene.revision,
        content_hash=scene.content_hash,
        links=list(scene.links),
        visuals=[
            *(_visual_to_msg(v, link_index[v.link], class_index[v.semantic_class]) for v in scene.visuals),
            *([] if scene.splats is None else [_splats_to_msg(scene.splats)]),
        ],
        cameras=[_camera_to_msg(c, link_index[c.link]) for c in scene.cameras],
        semantic_classes=list(scene.semantic_classes),
        instances=list(scene.instances),
        light=_light_to_msg(scene.light),
    )


def _splats_to_msg(splats: SplatsSpec) -> RosVisual:
    size = (splats.scale,) * 3
    return RosVisual(
        name="splats",
        link=-1,
        shape=RosVisual.SHAPE_SPLATS,
        mesh=splats.file,
        size=vector_to_msg(size),
        pose=pose_to_msg(splats.pose),
    )


def scene_from_msg(msg: RosScene) -> DrawnScene:
    """Returns the scene in a message.

    Raises:
        SceneError: an index is out of range or a shape is unknown.
    """
    links = tuple(msg.links)

    def name_at(names: tuple[str, ...], index: int, kind: str) -> str:
        if not 0 <= index < len(names):
            raise SceneError(f"scene {quoted(msg.name)}: {kind} {index} is out of range, there are {len(names)}")
        return names[index]

    def link_name(index: int) -> str:
        return "" if index == -1 else name_at(links, index, "link")

    classes = tuple(msg.semantic_classes)
    visuals, splats = [], None
    for v in msg.visuals:
        if v.shape == RosVisual.SHAPE_SPLATS:
            splats = SplatsSpec(v.mesh, pose_from_msg(v.pose), v.size.x)
            continue
        if v.shape not in _SHAPE_KINDS:
            raise SceneError(
                f"scene {quoted(msg.name)}: visual {quoted(v.name)} has shape {v.shape}, known: {sorted(_SHAPE_KINDS)}"
            )
        color = (v.color.r, v.color.g, v.color.b, v.color.a) if v.color.a > 0 else None
        # Bags recorded before the field was renamed have ``look`` in their own definition of the type.
        appearance = v.appearance if hasattr(v, "appearance") else v.look
        semantic_class = name_at(classes, v.semantic_class, "semantic class")
        visuals.append(
            VisualSpec(
                name=v.name,
                link=link_name(v.link),
                shape=Shape(_SHAPE_KINDS[v.shape], vector_from_msg(v.size), v.mesh),
                pose=pose_from_msg(v.pose),
                color=color,
                semantic_class="" if semantic_class == UNLABELLED else semantic_class,
                appearance=_appearance_from_msg(appearance[0]) if appearance else None,
            )
        )
    cameras = tuple(_camera_from_msg(c, link_name(c.link)) for c in msg.cameras)
    light = _light_from_msg(msg.light)
    return DrawnScene(msg.name, msg.revision, msg.content_hash, links, tuple(visuals), cameras, light, splats)


def scene_state_to_msg(state: SceneState, due_cameras: tuple[int, ...], epoch: int = 0, epoch_step: int = 0) -> RosSceneState:
    """Returns the state as a message."""
    msg = RosSceneState(header=header_to_msg(state.stamp_ns, WORLD_FRAME), revision=state.revision, step=state.step)
    msg.poses = array("d", np.hstack([state.positions, state.quats_xyzw]).tobytes())
    msg.twists = array("d", state.twists.tobytes())
    msg.due_cameras = array("I", due_cameras)
    msg.epoch, msg.epoch_step = epoch, epoch_step
    return msg


def scene_state_from_msg(msg: RosSceneState, links: tuple[str, ...]) -> SceneState:
    """Returns the state in a message; ``links`` are the link names of its scene.

    Raises:
        ConfigError: the number of poses or twists is not the number of links.
    """
    poses = np.array(msg.poses, dtype=np.float64).reshape(-1, 7)
    twists = np.array(msg.twists, dtype=np.float64).reshape(-1, 6) if len(msg.twists) else np.zeros((len(poses), 6))
    return SceneState(
        stamp_ns=time_from_msg(msg.header.stamp),
        step=msg.step,
        revision=msg.revision,
        links=links,
        positions=poses[:, :3],
        quats_xyzw=poses[:, 3:],
        twists=twists,
    )


def floor_map_to_msg(floor: FloorMap, floor_z: float, stamp_ns: int, frame_id: str) -> OccupancyGrid:
    """Returns the occupancy grid of a floor: 0 = free, 100 = occupied, -1 = neither floor nor obstacle. Rows are ordered by increasing y."""
    cells = np.full(floor.shape, _UNKNOWN, dtype=np.int8)
    cells[floor.free] = _FREE
    cells[floor.occupied] = _OCCUPIED
    msg = OccupancyGrid(header=header_to_msg(stamp_ns, frame_id))
    msg.info = MapMetaData(map_load_time=time_to_msg(stamp_ns), resolution=floor.resolution)
    msg.info.height, msg.info.width = floor.shape
    msg.info.origin.position.x, msg.info.origin.position.y = floor.origin
    msg.info.origin.position.z = floor_z
    msg.data = array("b", cells.tobytes())
    return msg


def _visual_to_msg(visual: VisualSpec, link: int, semantic_class: int) -> RosVisual:
    return RosVisual(
        name=visual.name,
        link=link,
        shape=_SHAPES[visual.shape.kind],
        mesh=visual.shape.mesh,
        size=vector_to_msg(visual.shape.size),
        pose=pose_to_msg(visual.pose),
        color=_color_to_msg(visual.color or (0.0, 0.0, 0.0, 0.0)),
        semantic_class=semantic_class,
        appearance=[] if visual.appearance is None else [_appearance_to_msg(visual.appearance)],
    )


def _color_to_msg(rgba: tuple[float, float, float, float]) -> ColorRGBA:
    return ColorRGBA(r=float(rgba[0]), g=float(rgba[1]), b=float(rgba[2]), a=float(rgba[3]))


def _appearance_to_msg(appearance: Appearance) -> RosAppearance:
    msg = RosAppearance(hue=appearance.hue, saturation=appearance.saturation, value=appearance.value)
    msg.metallic = math.nan if appearance.metallic is None else appearance.metallic
    msg.roughness = math.nan if appearance.roughness is None else appearance.roughness
    if appearance.pattern is not None:
        first, second = appearance.pattern.colors
        msg.pattern, msg.pattern_seed, msg.pattern_colors = appearance.pattern.kind, appearance.pattern.seed, (*first, *second)
        msg.pattern_size, msg.pattern_image = appearance.pattern.size, appearance.pattern.image
    return msg


def _appearance_from_msg(msg: RosAppearance) -> Appearance:
    pattern = None
    if msg.pattern:
        colors = (_triple(msg.pattern_colors[:3]), _triple(msg.pattern_colors[3:]))
        pattern = Pattern(msg.pattern, int(msg.pattern_seed), colors, msg.pattern_size, msg.pattern_image)
    metallic, roughness = (None if math.isnan(v) else v for v in (msg.metallic, msg.roughness))
    return Appearance(msg.hue, msg.saturation, msg.value, pattern, metallic, roughness)


def _camera_to_msg(camera: CameraSpec, link: int) -> RosCamera:
    return RosCamera(
        name=camera.name,
        link=link,
        pose=pose_to_msg(camera.pose),
        frame_id=camera.optical_frame,
        width=camera.width,
        height=camera.height,
        projection=camera.projection,
        k=camera.matrix or (),
        d=camera.distortion,
        fov_y=camera.fov_y,
        fov=camera.fov,
        near=camera.near,
        far=camera.far,
        rate=camera.rate_hz,
        outputs=[
            *camera.outputs,
            *([f"{_FILL}{camera.fill}"] if camera.fill else []),
            *([_FILL_DEPTH] if camera.fill_depth else []),
        ],
        samples=camera.samples,
        stereo_baseline=camera.stereo_baseline,
        effects=RosImageEffects(**asdict(camera.effects)),
        depth_noise=RosDepthNoise(**asdict(camera.depth_noise)),
    )


def _camera_from_msg(msg: RosCamera, link: str) -> CameraSpec:
    return CameraSpec(
        name=msg.name,
        link=link,
        pose=pose_from_msg(msg.pose),
        width=msg.width,
        height=msg.height,
        fov_y=msg.fov_y,
        near=msg.near,
        far=msg.far,
        rate_hz=msg.rate,
        outputs=tuple(o for o in OUTPUTS if o in msg.outputs),
        projection=msg.projection,
        matrix=tuple(msg.k) or None,
        distortion=tuple(msg.d),
        fov=msg.fov,
        samples=msg.samples,
        stereo_baseline=msg.stereo_baseline,
        frame_id="" if msg.frame_id == f"{msg.name}_optical_frame" else msg.frame_id,
        effects=ImageEffects(**{f.name: getattr(msg.effects, f.name) for f in fields(ImageEffects)}),
        depth_noise=DepthNoise(**{f.name: getattr(msg.depth_noise, f.name) for f in fields(DepthNoise)}),
        fill=next((word.removeprefix(_FILL) for word in msg.outputs if word.startswith(_FILL)), ""),
        fill_depth=_FILL_DEPTH in msg.outputs,
    )


def _light_to_msg(light: LightSpec) -> RosLight:
    return RosLight(
        sun_direction=vector_to_msg(light.sun_direction),
        sun=light.sun,
        sun_color=light.sun_color,
        shadows=light.shadows,
        ambient=light.ambient,
        background=light.background,
        points=[
            RosPointLight(
                position=_point_to_msg(p.position),
                color=p.color,
                strength=p.strength,
                range=p.range,
                attenuation=p.attenuation,
                direction=vector_to_msg(p.direction),
                inner_angle=p.inner_angle,
                outer_angle=p.outer_angle,
            )
            for p in light.points
        ],
        environment=light.environment,
        environment_strength=light.environment_strength,
        environment_yaw=light.environment_yaw,
        environment_visible=light.environment_visible,
        backdrop=light.backdrop,
    )


def _light_from_msg(msg: RosLight) -> LightSpec:
    return LightSpec(
        sun_direction=vector_from_msg(msg.sun_direction),
        sun=msg.sun,
        ambient=msg.ambient,
        background=_triple(msg.background),
        sun_color=_triple(msg.sun_color),
        shadows=msg.shadows,
        points=tuple(
            PointLight(
                position=(p.position.x, p.position.y, p.position.z),
                color=_triple(p.color),
                strength=p.strength,
                range=p.range,
                attenuation=_triple(p.attenuation),
                direction=vector_from_msg(p.direction),
                inner_angle=p.inner_angle,
                outer_angle=p.outer_angle,
            )
            for p in msg.points
        ),
        environment=msg.environment,
        environment_strength=msg.environment_strength,
        environment_yaw=msg.environment_yaw,
        environment_visible=msg.environment_visible,
        backdrop=msg.backdrop,
    )


def _point_to_msg(v: Vec3) -> Point:
    return Point(x=float(v[0]), y=float(v[1]), z=float(v[2]))


def _triple(values: Any) -> Vec3:
    return (float(values[0]), float(values[1]), float(values[2]))
