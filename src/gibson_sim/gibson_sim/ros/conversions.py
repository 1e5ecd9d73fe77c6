"""Messages from values and values from messages: the only place that knows what the messages look like inside.

``x_to_msg`` makes a message, ``x_from_msg`` reads one. Stamps are copied from the data that a message describes, never taken
from a clock. Large arrays are copied once, as bytes: a list or an ndarray in a message field costs tens of milliseconds.
"""

from __future__ import annotations

import math
from array import array
from dataclasses import asdict, fields
from typing import Any

import numpy as np
from builtin_interfaces.msg import Time
from geometry_msgs.msg import Point, Pose as RosPose, TransformStamped, Twist, Vector3
from nav_msgs.msg import Odometry as RosOdometry
from numpy.typing import NDArray
from sensor_msgs.msg import CameraInfo, Image, JointState, LaserScan
from std_msgs.msg import ColorRGBA, Header

from gibson_msgs.msg import (
    Camera as RosCamera,
    DepthNoise as RosDepthNoise,
    ImageEffects as RosImageEffects,
    Light as RosLight,
    Look as RosLook,
    PointLight as RosPointLight,
    Scene as RosScene,
    SceneState as RosSceneState,
    Visual as RosVisual,
)
from gibson_sim.errors import SceneError
from gibson_sim.geometry.transforms import quat_from_rpy
from gibson_sim.robots.spec import Look, Pattern, Shape, ShapeKind, VisualSpec
from gibson_sim.scenes.spec import UNLABELLED, WORLD_FRAME, DrawnScene, LightSpec, PointLight
from gibson_sim.sensors.lidar import Scan
from gibson_sim.types import (
    DISTORTIONS,
    NS_PER_S,
    OUTPUTS,
    CameraSpec,
    DepthNoise,
    Frame,
    ImageEffects,
    JointStates,
    Odometry,
    Output,
    Pose,
    SceneState,
    Vec3,
    VelocityCommand,
)

_SHAPES: dict[ShapeKind, int] = {
    "mesh": RosVisual.SHAPE_MESH,
    "box": RosVisual.SHAPE_BOX,
    "sphere": RosVisual.SHAPE_SPHERE,
    "cylinder": RosVisual.SHAPE_CYLINDER,
}
ENCODINGS: dict[Output, str] = {
    "rgb": "rgb8",
    "depth": "32FC1",
    "semantic": "16UC1",
    "instance": "16UC1",
    "normal": "32FC3",
    "normal_world": "32FC3",
    "position": "32FC3",
    "flow": "32FC2",
}
"""How the pixels of each output are written in an image message."""
_PIXELS: dict[str, tuple[type[np.generic], int]] = {
    "rgb8": (np.uint8, 3),
    "32FC1": (np.float32, 1),
    "16UC1": (np.uint16, 1),
    "32FC2": (np.float32, 2),
    "32FC3": (np.float32, 3),
}
"""Encoding -> type and number of channels."""
_SHAPE_KINDS = {number: kind for kind, number in _SHAPES.items()}


def time_to_msg(stamp_ns: int) -> Time:
    """Returns the stamp of a whole number of nanoseconds."""
    return Time(sec=stamp_ns // NS_PER_S, nanosec=stamp_ns % NS_PER_S)


def time_from_msg(msg: Time) -> int:
    """Returns nanoseconds."""
    return int(msg.sec) * NS_PER_S + int(msg.nanosec)


def header_to_msg(stamp_ns: int, frame_id: str) -> Header:
    """Returns a header with the stamp of the data and its frame."""
    return Header(stamp=time_to_msg(stamp_ns), frame_id=frame_id)


def _vector_to_msg(v: Any) -> Vector3:
    return Vector3(x=float(v[0]), y=float(v[1]), z=float(v[2]))


def _vector_from_msg(msg: Vector3) -> Vec3:
    return (msg.x, msg.y, msg.z)


def pose_to_msg(pose: Pose) -> RosPose:
    """Returns the pose as a message."""
    msg = RosPose()
    msg.position.x, msg.position.y, msg.position.z = pose.position
    msg.orientation.x, msg.orientation.y, msg.orientation.z, msg.orientation.w = pose.quat_xyzw
    return msg


def pose_from_msg(msg: RosPose) -> Pose:
    """Returns the pose of a message whose quaternion has length 1."""
    p, q = msg.position, msg.orientation
    return Pose((p.x, p.y, p.z), (q.x, q.y, q.z, q.w))


def transform_to_msg(stamp_ns: int, parent: str, child: str, pose: Pose) -> TransformStamped:
    """Returns T_parent_child for tf."""
    msg = TransformStamped(header=header_to_msg(stamp_ns, parent), child_frame_id=child)
    t, r = msg.transform.translation, msg.transform.rotation
    t.x, t.y, t.z = pose.position
    r.x, r.y, r.z, r.w = pose.quat_xyzw
    return msg


def velocity_from_msg(msg: Twist, stamp_ns: int) -> VelocityCommand:
    """Returns the command in a Twist that arrived at ``stamp_ns``.

    Raises:
        CommandError: a number is NaN or infinite.
    """
    return VelocityCommand(_vector_from_msg(msg.linear), _vector_from_msg(msg.angular), stamp_ns)


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
        visuals=[_visual_to_msg(v, link_index[v.link], class_index[v.semantic_class]) for v in scene.visuals],
        cameras=[_camera_to_msg(c, link_index[c.link]) for c in scene.cameras],
        semantic_classes=list(scene.semantic_classes),
        instances=list(scene.instances),
        light=_light_to_msg(scene.light),
    )


def scene_from_msg(msg: RosScene) -> DrawnScene:
    """Returns the scene in a message.

    Raises:
        SceneError: an index points nowhere or a shape is unknown.
    """
    links = tuple(msg.links)

    def pick(names: tuple[str, ...], index: int, what: str) -> str:
        if not 0 <= index < len(names):
            raise SceneError(f"scene {msg.name!r}: {what} {index} is out of range, there are {len(names)}")
        return names[index]

    def link_name(index: int) -> str:
        return "" if index == -1 else pick(links, index, "link")

    classes = tuple(msg.semantic_classes)
    visuals = []
    for v in msg.visuals:
        if v.shape not in _SHAPE_KINDS:
            raise SceneError(f"scene {msg.name!r}: visual {v.name!r} has shape {v.shape}, known: {sorted(_SHAPE_KINDS)}")
        color = (v.color.r, v.color.g, v.color.b, v.color.a) if v.color.a > 0 else None
        semantic_class = pick(classes, v.semantic_class, "semantic class")
        visuals.append(
            VisualSpec(
                name=v.name,
                link=link_name(v.link),
                shape=Shape(_SHAPE_KINDS[v.shape], _vector_from_msg(v.size), v.mesh),
                pose=pose_from_msg(v.pose),
                color=color,
                semantic_class="" if semantic_class == UNLABELLED else semantic_class,
                look=_look_from_msg(v.look[0]) if v.look else None,
            )
        )
    cameras = tuple(_camera_from_msg(c, link_name(c.link)) for c in msg.cameras)
    light = _light_from_msg(msg.light)
    return DrawnScene(msg.name, msg.revision, msg.content_hash, links, tuple(visuals), cameras, light)


def _light_to_msg(light: LightSpec) -> RosLight:
    return RosLight(
        sun_direction=_vector_to_msg(light.sun_direction),
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
                direction=_vector_to_msg(p.direction),
                inner_angle=p.inner_angle,
                outer_angle=p.outer_angle,
            )
            for p in light.points
        ],
        environment=light.environment,
        environment_strength=light.environment_strength,
        environment_yaw=light.environment_yaw,
        environment_visible=light.environment_visible,
    )


def _light_from_msg(msg: RosLight) -> LightSpec:
    return LightSpec(
        sun_direction=_vector_from_msg(msg.sun_direction),
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
                direction=_vector_from_msg(p.direction),
                inner_angle=p.inner_angle,
                outer_angle=p.outer_angle,
            )
            for p in msg.points
        ),
        environment=msg.environment,
        environment_strength=msg.environment_strength,
        environment_yaw=msg.environment_yaw,
        environment_visible=msg.environment_visible,
    )


def _look_to_msg(look: Look) -> RosLook:
    msg = RosLook(hue=look.hue, saturation=look.saturation, value=look.value)
    msg.metallic = math.nan if look.metallic is None else look.metallic
    msg.roughness = math.nan if look.roughness is None else look.roughness
    if look.pattern is not None:
        first, second = look.pattern.colors
        msg.pattern, msg.pattern_seed, msg.pattern_colors = look.pattern.kind, look.pattern.seed, (*first, *second)
        msg.pattern_size, msg.pattern_image = look.pattern.size, look.pattern.image
    return msg


def _look_from_msg(msg: RosLook) -> Look:
    pattern = None
    if msg.pattern:
        colors = (_triple(msg.pattern_colors[:3]), _triple(msg.pattern_colors[3:]))
        pattern = Pattern(msg.pattern, int(msg.pattern_seed), colors, msg.pattern_size, msg.pattern_image)
    metallic, roughness = (None if math.isnan(v) else v for v in (msg.metallic, msg.roughness))
    return Look(msg.hue, msg.saturation, msg.value, pattern, metallic, roughness)


def _triple(values: Any) -> Vec3:
    return (float(values[0]), float(values[1]), float(values[2]))


def _point_to_msg(v: Vec3) -> Point:
    return Point(x=float(v[0]), y=float(v[1]), z=float(v[2]))


def _visual_to_msg(visual: VisualSpec, link: int, semantic_class: int) -> RosVisual:
    return RosVisual(
        name=visual.name,
        link=link,
        shape=_SHAPES[visual.shape.kind],
        mesh=visual.shape.mesh,
        size=_vector_to_msg(visual.shape.size),
        pose=pose_to_msg(visual.pose),
        color=_color_to_msg(visual.color or (0.0, 0.0, 0.0, 0.0)),
        semantic_class=semantic_class,
        look=[] if visual.look is None else [_look_to_msg(visual.look)],
    )


def _color_to_msg(rgba: tuple[float, float, float, float]) -> ColorRGBA:
    return ColorRGBA(r=float(rgba[0]), g=float(rgba[1]), b=float(rgba[2]), a=float(rgba[3]))


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
        outputs=list(camera.outputs),
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
        effects=ImageEffects(**{f.name: getattr(msg.effects, f.name) for f in fields(ImageEffects)}),
        depth_noise=DepthNoise(**{f.name: getattr(msg.depth_noise, f.name) for f in fields(DepthNoise)}),
    )


def scene_state_to_msg(state: SceneState, due_cameras: tuple[int, ...]) -> RosSceneState:
    """Returns the state as a message."""
    msg = RosSceneState(header=header_to_msg(state.stamp_ns, WORLD_FRAME), revision=state.revision, step=state.step)
    msg.poses = array("d", np.hstack([state.positions, state.quats_xyzw]).tobytes())
    msg.twists = array("d", state.twists.tobytes())
    msg.due_cameras = array("I", due_cameras)
    return msg


def scene_state_from_msg(msg: RosSceneState, links: tuple[str, ...]) -> SceneState:
    """Returns the state in a message, whose links are those of its scene.

    Raises:
        ConfigError: the arrays do not have as many rows as there are links.
    """
    poses = np.array(msg.poses, dtype=np.float64).reshape(-1, 7)
    twists = np.array(msg.twists, dtype=np.float64).reshape(-1, 6) if msg.twists else np.zeros((len(poses), 6))
    return SceneState(
        stamp_ns=time_from_msg(msg.header.stamp),
        step=msg.step,
        revision=msg.revision,
        links=links,
        positions=poses[:, :3],
        quats_xyzw=poses[:, 3:],
        twists=twists,
    )


def odometry_to_msg(odometry: Odometry, stamp_ns: int, parent: str, child: str) -> RosOdometry:
    """Returns wheel odometry: pose in ``parent``, twist in ``child``. Covariances are those of good wheels on a hard floor."""
    msg = RosOdometry(header=header_to_msg(stamp_ns, parent), child_frame_id=child)
    msg.pose.pose = pose_to_msg(odometry_pose(odometry))
    msg.twist.twist.linear.x = odometry.linear
    msg.twist.twist.angular.z = odometry.angular
    # A planar base says nothing of z, roll and pitch: a filter must not trust them, nor divide by zero.
    msg.pose.covariance = _diagonal((1e-3, 1e-3, 1e6, 1e6, 1e6, 1e-3))
    msg.twist.covariance = _diagonal((1e-4, 1e-4, 1e6, 1e6, 1e6, 1e-4))
    return msg


def odometry_pose(odometry: Odometry) -> Pose:
    """Returns T_odom_base."""
    return Pose((odometry.x, odometry.y, 0.0), quat_from_rpy(0.0, 0.0, odometry.yaw))


def ground_truth_to_msg(pose: Pose, linear: Any, angular: Any, stamp_ns: int, child: str) -> RosOdometry:
    """Returns the true pose in the world frame and the true twist in the ``child`` frame; covariances are zero."""
    msg = RosOdometry(header=header_to_msg(stamp_ns, WORLD_FRAME), child_frame_id=child)
    msg.pose.pose = pose_to_msg(pose)
    msg.twist.twist.linear = _vector_to_msg(linear)
    msg.twist.twist.angular = _vector_to_msg(angular)
    return msg


def _diagonal(values: tuple[float, ...]) -> NDArray[np.float64]:
    return np.diag(np.array(values, dtype=np.float64)).ravel()


def joint_states_to_msg(joints: JointStates, stamp_ns: int) -> JointState:
    """Returns joint states; names are those of the URDF."""
    return JointState(
        header=header_to_msg(stamp_ns, ""),
        name=list(joints.names),
        position=array("d", joints.positions.tobytes()),
        velocity=array("d", joints.velocities.tobytes()),
        effort=array("d", joints.efforts.tobytes()),
    )


def scan_to_msg(scan: Scan, frame_id: str, scan_time: float) -> LaserScan:
    """Returns a scan whose rays were all cast at its stamp (``time_increment`` 0)."""
    msg = LaserScan(header=header_to_msg(scan.stamp_ns, frame_id))
    msg.angle_min = scan.angle_min
    msg.angle_increment = scan.angle_increment
    msg.angle_max = scan.angle_max
    msg.time_increment = 0.0
    msg.scan_time = scan_time
    msg.range_min = scan.range_min
    msg.range_max = scan.range_max
    msg.ranges = array("f", scan.ranges.astype(np.float32).tobytes())
    return msg


def camera_info_to_msg(camera: CameraSpec, stamp_ns: int) -> CameraInfo:
    """Returns the calibration of a camera, whose image is not rectified: R is the identity and P begins with K.

    In the right camera of a stereo pair P has Tx = -fx baseline. ROS has no model of an equirectangular camera: its name stands in
    ``distortion_model`` and all matrices are zero, which says "no calibration" to whoever looks for a pinhole.
    """
    info = CameraInfo(header=header_to_msg(stamp_ns, camera.optical_frame), height=camera.height, width=camera.width)
    if camera.projection == "equirectangular":
        info.distortion_model = camera.projection
        info.r = np.zeros(9)
        return info
    k = camera.intrinsics()
    p = np.zeros((3, 4))
    p[:, :3] = k
    p[0, 3] = -k[0, 0] * camera.stereo_baseline
    info.distortion_model = camera.distortion_model
    info.d = camera.distortion or [0.0] * DISTORTIONS[camera.projection][info.distortion_model][-1]
    info.k, info.r, info.p = k.ravel(), np.eye(3).ravel(), p.ravel()
    return info


def image_to_msg(pixels: NDArray[Any], encoding: str, stamp_ns: int, frame_id: str) -> Image:
    """Returns an image of C-contiguous ``pixels``, shape (H, W) or (H, W, C), row 0 at the top."""
    height, width = pixels.shape[:2]
    data = array("B")
    data.frombytes(pixels.data.cast("B"))
    msg = Image(header=header_to_msg(stamp_ns, frame_id))
    msg.height, msg.width, msg.encoding = height, width, encoding
    msg.is_bigendian = 0
    msg.step = pixels.strides[0]
    msg.data = data
    return msg


def frame_to_image_msgs(frame: Frame) -> dict[str, Image | CameraInfo]:
    """Returns the messages of a frame by what they carry (see ``names.camera_topics``), all with the frame's stamp."""
    camera, stamp = frame.camera, frame.stamp_ns
    msgs: dict[str, Image | CameraInfo] = {}
    for output, encoding in ENCODINGS.items():
        pixels = getattr(frame, output)
        if pixels is not None:
            msgs[output] = image_to_msg(pixels, encoding, stamp, camera.optical_frame)
    info = camera_info_to_msg(camera, stamp)
    msgs.update({f"{kind}_info": info for kind in tuple(msgs)})
    return msgs


def array_from_image(msg: Image) -> NDArray[Any]:
    """Returns the pixels of an image in one of our encodings, (H, W), (H, W, 2) or (H, W, 3); they share the message's memory."""
    if msg.encoding not in _PIXELS:
        raise SceneError(f"image has encoding {msg.encoding!r}, known: {', '.join(_PIXELS)}")
    kind, channels = _PIXELS[msg.encoding]
    rows = np.frombuffer(msg.data, kind).reshape(msg.height, -1)[:, : msg.width * channels]
    return rows if channels == 1 else rows.reshape(msg.height, msg.width, channels)


def planar_from_odometry(msg: RosOdometry) -> tuple[float, float, float, int]:
    """Returns x, y (m), yaw (rad) and stamp (ns) of an odometry message."""
    q = msg.pose.pose.orientation
    yaw = math.atan2(2 * (q.w * q.z + q.x * q.y), 1 - 2 * (q.y * q.y + q.z * q.z))
    return msg.pose.pose.position.x, msg.pose.pose.position.y, yaw, time_from_msg(msg.header.stamp)
