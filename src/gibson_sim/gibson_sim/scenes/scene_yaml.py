"""Reads and writes the project's own scene description, ``scene.yaml``: light, objects, rooms, bodies and start poses.

docs/scenes.md lists the keys; any other key is an error.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import yaml
from numpy.typing import NDArray

from gibson_sim.description.body import BodySpec
from gibson_sim.description.rigid_groups import MOVING_TYPES
from gibson_sim.description.shapes import Appearance, Shape, ShapeKind
from gibson_sim.description.urdf import UrdfJoint, UrdfModel
from gibson_sim.description.urdf_model import scaled_model
from gibson_sim.errors import MeshError, SceneError, TextError
from gibson_sim.formats.mesh import UpAxis
from gibson_sim.formats.yaml_map import ROS_NAME, YamlMap
from gibson_sim.geometry.transforms import matrix_from_pose, pose_from_xyz_rpy
from gibson_sim.quoting import quoted
from gibson_sim.reading import parse_yaml
from gibson_sim.scenes.builder import FAR_AWAY, SceneBuilder
from gibson_sim.scenes.room_spec import RoomSpec
from gibson_sim.scenes.spawning import load_spawnable
from gibson_sim.scenes.spec import SPLAT_SCALES, LightSpec, PointLight, StartPose
from gibson_sim.types import Pose, Rgba, Vec3
from gibson_sim.writing import write_file

F64 = NDArray[np.float64]

DESCRIPTION = "scene.yaml"
"""Name of the file."""
_SCENE_KEYS = (
    "name",
    "description",
    "gravity",
    "ground_z",
    "ground_friction",
    "floor_z",
    "floors",
    "rooms",
    "light",
    "visual",
    "starts",
    "objects",
    "bodies",
)
_LIGHT_KEYS = (
    "sun_direction", "sun", "sun_color", "shadows", "ambient", "background", "points",
    "environment", "environment_strength", "environment_yaw_deg", "environment_visible", "backdrop",
)  # fmt: skip
_VISUAL_KEYS = ("splats", "pose", "scale", "up_axis")
_POINT_KEYS = ("position", "color", "strength", "range", "attenuation", "direction", "inner_deg", "outer_deg")
_SHAPES: tuple[ShapeKind, ...] = ("mesh", "box", "sphere", "cylinder", "capsule", "ellipsoid", "cone")
_OBJECT_KEYS = (
    "name", *_SHAPES, "pose", "scale", "up_axis", "unit_m", "semantic_class", "collision", "visible", "color", "metallic", "roughness",
    "friction",
)  # fmt: skip
_ROOM_KEYS = ("name", "class", "floor", "polygon")
_BODY_KEYS = ("name", "model", "pose", "joints", "static", "scale", "semantic_class")
_START_KEYS = ("name", "xy", "xyz", "yaw_deg")

_UP_AXES: dict[str, UpAxis] = {"x": "x", "y": "y", "z": "z"}
_BODY_SCALES = (0.01, 100.0)
"""Minimum and maximum scale of a body."""


def write_scene_yaml(folder: Path, content: Mapping[str, Any], comment: str = "", *, width: int | None = 140) -> None:
    """Writes the scene.yaml of a folder; equal contents give identical files.

    Args:
        folder: folder of the scene.
        content: the keys with plain values, in their order in the file.
        comment: first line, without its ``#``; empty = none.
        width: preferred line width, characters, with innermost collections on one line; None = one line for each value.

    Raises:
        WriteError: the file cannot be written.
    """
    layout: dict[str, Any] = {} if width is None else {"default_flow_style": None, "width": width}
    text = yaml.safe_dump(dict(content), sort_keys=False, allow_unicode=True, **layout)
    write_file(folder / DESCRIPTION, f"# {comment}\n{text}" if comment else text)


def read_scene_yaml(builder: SceneBuilder, path: Path) -> None:
    """Adds the content of a scene.yaml to the builder.

    Raises:
        SceneError: a key or a value is invalid, or a mesh or a model cannot be used.
    """
    try:
        document = parse_yaml(builder.read_bytes(path))
    except TextError as e:
        raise SceneError(f"{path}: {e}").with_public(e.public) from e
    top = YamlMap(document if document is not None else {}, str(path), _SCENE_KEYS)
    builder.name = top.text("name", builder.name)
    builder.description = top.text("description", "")
    gravity = top.value("gravity")
    if gravity is not None:
        # A single number is the magnitude of gravity, which points down.
        builder.gravity = (0.0, 0.0, -top.number("gravity")) if isinstance(gravity, int | float) else top.vec3("gravity")
    builder.ground_z = top.number("ground_z") if top.has("ground_z") else None
    builder.ground_friction = top.number("ground_friction", 1.0, low=0.0, high=1.0)
    builder.floor_z = top.number("floor_z") if top.has("floor_z") else None
    builder.floors = top.floats("floors") if top.has("floors") else ()
    if builder.floors and builder.floor_z is None:
        builder.floor_z = min(builder.floors)
    _rooms(builder, top)
    builder.light = _light(builder, path, top.within(top.value("light") or {}, "light", _LIGHT_KEYS))
    if top.has("visual"):
        _splats(builder, path, top.within(top.value("visual"), "visual", _VISUAL_KEYS))
    for index, item in enumerate(top.items("objects")):
        _object(builder, path, top.within(item, f"objects[{index}]", _OBJECT_KEYS))
    _bodies(builder, path, top)
    floor = builder.floor_z if builder.floor_z is not None else builder.ground_z or 0.0
    names: set[str] = set()
    for index, item in enumerate(top.items("starts")):
        start = _start(top.within(item, f"starts[{index}]", _START_KEYS), floor)
        if start.name in names:
            raise SceneError(f"{path}: starts[{index}]: name {quoted(start.name)} is used twice; names must be unique")
        names.add(start.name)
        builder.starts.append(start)


def _light(builder: SceneBuilder, path: Path, light: YamlMap) -> LightSpec:
    default = LightSpec()
    environment, backdrop = (
        builder.environment_file(path.parent / image, light.where) if image else ""
        for image in (light.text("environment", ""), light.text("backdrop", ""))
    )
    return LightSpec(
        sun_direction=light.direction("sun_direction", default.sun_direction),
        sun=light.number("sun", default.sun, low=0.0),
        ambient=light.number("ambient", 0.0 if environment else default.ambient, low=0.0),
        background=light.vec3("background", default.background, low=0.0, high=1.0),
        sun_color=light.vec3("sun_color", default.sun_color, low=0.0, high=1.0),
        shadows=light.flag("shadows", default.shadows),
        points=tuple(_point(light.within(item, f"points[{k}]", _POINT_KEYS)) for k, item in enumerate(light.items("points"))),
        environment=environment,
        environment_strength=light.number("environment_strength", default.environment_strength, low=0.0),
        environment_yaw=math.radians(light.number("environment_yaw_deg", 0.0)),
        environment_visible=light.flag("environment_visible", default.environment_visible),
        backdrop=backdrop,
    )


def _point(point: YamlMap) -> PointLight:
    default = PointLight((0.0, 0.0, 0.0))
    attenuation = point.vec3("attenuation", default.attenuation, low=0.0)
    if not any(attenuation):
        raise SceneError(f"{point.where}: attenuation is {list(attenuation)}, one of the three must be above 0")
    outer = point.number("outer_deg", 180.0, low=0.0, high=180.0)
    return PointLight(
        position=point.vec3("position", low=-FAR_AWAY, high=FAR_AWAY),
        color=point.vec3("color", default.color, low=0.0, high=1.0),
        strength=point.number("strength", default.strength, low=0.0),
        range=point.number("range", default.range, low=0.0),
        attenuation=attenuation,
        direction=point.direction("direction", default.direction),
        inner_angle=math.radians(point.number("inner_deg", outer, low=0.0, high=outer)),
        outer_angle=math.radians(outer),
    )


def _object(builder: SceneBuilder, path: Path, item: YamlMap) -> None:
    shapes = [kind for kind in _SHAPES if item.has(kind)]
    if len(shapes) != 1:
        raise SceneError(f"{item.where}: has {', '.join(shapes) or 'no shape'}; give exactly one of {', '.join(_SHAPES)}")
    name = item.text("name", Path(str(item.value("mesh", shapes[0]))).stem)
    item.where = f"{path}: object {quoted(name)}"
    matrix = matrix_from_pose(_pose(item))
    if shapes[0] == "mesh":
        shape, T_world_shape = _mesh(builder, path, item, item.text("mesh", ""), matrix)
    else:
        for key in ("scale", "up_axis", "unit_m"):
            if item.has(key):
                raise SceneError(f"{item.where}: {key} is for meshes; a {shapes[0]} has its size in metres")
        shape, T_world_shape = _primitive(item, shapes[0]), matrix
    collision = "none" if item.value("collision", "same") is None else item.text("collision", "same")
    if item.flag("visible", True):
        builder.add_visual(name, shape, T_world_shape, _color(item), item.text("semantic_class", ""), _appearance(item))
    elif collision == "none":
        raise SceneError(f"{item.where}: visible is false and collision none, so it has no effect; leave it out")
    friction = item.number("friction", 1.0, low=0.0, high=1.0)
    if collision == "same":
        builder.add_collision(name, shape, T_world_shape, friction)
    elif collision == "simplified":
        if shape.kind != "mesh":
            raise SceneError(f"{item.where}: collision simplified is for meshes; a {shape.kind} is simple already")
        builder.add_simplified_collision(name, shape, T_world_shape, friction)
    elif collision != "none":
        builder.add_collision(name, *_mesh(builder, path, item, collision, matrix), friction)


def _splats(builder: SceneBuilder, path: Path, item: YamlMap) -> None:
    name = item.text("splats", "").strip()
    if not name:
        raise SceneError(f"{item.where}: has no key splats; give the name of a PLY or SPZ file in the scene's folder")
    pose, scale, up_axis = _pose(item), item.number("scale", 1.0, *SPLAT_SCALES), _up_axis(item)
    try:
        builder.set_splats(path.parent / name, matrix_from_pose(pose), scale, up_axis)
    except SceneError as e:
        raise SceneError(f"{item.where}: {e}") from e


def _up_axis(item: YamlMap) -> UpAxis | None:
    """Returns the value of ``up_axis``; None = the key is missing."""
    if not item.has("up_axis"):
        return None
    up_axis = _UP_AXES.get(item.text("up_axis", ""))
    if up_axis is None:
        raise SceneError(f"{item.where}: up_axis is {quoted(item.value('up_axis'))}, must be x, y or z")
    return up_axis


def _mesh(builder: SceneBuilder, path: Path, item: YamlMap, name: str, matrix: F64) -> tuple[Shape, F64]:
    scale = item.value("scale", 1.0)
    factors: Vec3 = (float(scale),) * 3 if isinstance(scale, int | float) else item.vec3("scale")
    if not (np.isfinite(factors).all() and all(factors)):
        raise SceneError(f"{item.where}: scale is {quoted(scale)}, must be a number or three numbers, none of them 0")
    up_axis = _up_axis(item)
    unit_m = item.number("unit_m", low=1e-9) if item.has("unit_m") else None
    try:
        return builder.mesh_shape(path.parent / name, matrix, factors, up_axis, unit_m)
    except MeshError as e:
        raise SceneError(f"{item.where}: {e}") from e


def _primitive(item: YamlMap, kind: ShapeKind) -> Shape:
    if kind in ("box", "ellipsoid"):
        return Shape(kind, item.vec3(kind, low=1e-6))
    if kind == "sphere":
        return Shape("sphere", (item.number("sphere", low=1e-6), 0.0, 0.0))
    sizes = item.within(item.value(kind), kind, ("radius", "length"))
    return Shape(kind, (sizes.number("radius", low=1e-6), sizes.number("length", low=1e-6), 0.0))


def _appearance(item: YamlMap) -> Appearance | None:
    if not (item.has("metallic") or item.has("roughness")):
        return None
    metallic, roughness = (item.number(k, low=0.0, high=1.0) if item.has(k) else None for k in ("metallic", "roughness"))
    return Appearance(metallic=metallic, roughness=roughness)


def _color(item: YamlMap) -> Rgba | None:
    if not item.has("color"):
        return None
    values = item.value("color")
    count = len(values) if isinstance(values, list) else 0
    r, g, b, *alpha = item.floats("color", 4 if count == 4 else 3, low=0.0, high=1.0)
    return (r, g, b, alpha[0] if alpha else 1.0)


def _rooms(builder: SceneBuilder, top: YamlMap) -> None:
    """Adds the rooms to the builder, whose floors must be set before."""
    floors = len({builder.floor_z, *builder.floors}) if builder.floors else 1
    names: set[str] = set()
    for index, content in enumerate(top.items("rooms")):
        item = top.within(content, f"rooms[{index}]", _ROOM_KEYS)
        room = _room(item, floors)
        if room.name in names:
            raise SceneError(f"{item.where}: name {quoted(room.name)} is used twice; names of rooms must be unique")
        names.add(room.name)
        builder.rooms.append(room)


def _room(item: YamlMap, floors: int) -> RoomSpec:
    name, room_class = (item.text(key, "").strip() for key in ("name", "class"))
    for key, text in (("name", name), ("class", room_class)):
        if not text:
            raise SceneError(f"{item.where}: has no {key}; give one, such as kitchen")
    floor = item.value("floor", 0)
    if not isinstance(floor, int) or isinstance(floor, bool) or not 0 <= floor < floors:
        known = (
            "0, the scene has one floor"
            if floors == 1
            else f"a whole number from 0 to {floors - 1}, the index of one of the floors"
        )
        raise SceneError(f"{item.where}: floor is {quoted(floor)}, must be {known}")
    corners = [
        item.within({"corner": corner}, f"polygon[{k}]").floats("corner", 2, -FAR_AWAY, FAR_AWAY)
        for k, corner in enumerate(item.items("polygon"))
    ]
    try:
        return RoomSpec(name, room_class, floor, tuple((x, y) for x, y in corners))
    except SceneError as error:
        raise SceneError(f"{item.where}: {error}") from error


def _bodies(builder: SceneBuilder, path: Path, top: YamlMap) -> None:
    """Adds the bodies of the scene.yaml at ``path`` to the builder; reads each model once."""
    models: dict[str, BodySpec] = {}
    for index, content in enumerate(top.items("bodies")):
        item = top.within(content, f"bodies[{index}]", _BODY_KEYS)
        model = item.text("model", "").strip()
        if not model:
            raise SceneError(
                f"{item.where}: has no model; give the name of an object, or a URDF, SDF or mesh in the scene's folder"
            )
        name = item.text("name", "") or _free_name(Path(model).stem, builder)
        _check_name(name, builder, item.where)
        item.where = f"{path}: body {quoted(name)}"
        if model not in models:
            models[model] = _read_model(builder, path, model, item.where)
        _add_body(builder, item, replace(models[model], name=name))


def _add_body(builder: SceneBuilder, item: YamlMap, body: BodySpec) -> None:
    model = scaled_model(body.model, item.number("scale", 1.0, *_BODY_SCALES))
    placed = replace(
        body,
        model=model,
        start=_pose(item),
        static=item.flag("static", False) or body.static,
        semantic_class=item.text("semantic_class", body.semantic_class),
        joints=_joints(item, model),
    )
    try:
        builder.add_body(placed, model.path)
    except MeshError as e:
        raise SceneError(f"{item.where}: {e}") from e


def _read_model(builder: SceneBuilder, path: Path, model: str, where: str) -> BodySpec:
    """Returns the body of a model at the origin; ``model``: name of an object, or path relative to the scene's folder."""
    is_file = "/" in model or "." in model
    if "://" in model or model.startswith(("/", "~")):
        raise SceneError(f"{where}: model is {quoted(model)}; give the name of an object, or a path below the scene's folder")
    uri = str((path.parent / model).absolute()) if is_file else model
    try:
        spec = load_spawnable(uri, "", name="body", pose=Pose(), roots=builder.roots or ())
    except SceneError as e:
        raise SceneError(f"{where}: {e}") from e
    if not isinstance(spec, BodySpec):
        raise SceneError(
            f"{where}: model {quoted(model)} is a robot; robots are not part of a scene: add it with --robot, or spawn it"
        )
    return spec


def _joints(item: YamlMap, model: UrdfModel) -> tuple[tuple[str, float], ...]:
    """Returns the start positions of joints, radians or metres, in the order of the model."""
    moving = {joint.name: joint for joint in model.joints if joint.kind in MOVING_TYPES}
    positions = item.value("joints") or {}
    if positions and not moving:
        raise SceneError(f"{item.where}: joints are given, but {model.path.name} has no movable joints; leave them out")
    joints = item.within(positions, "joints", tuple(moving))
    return tuple((name, _position(joints, joint)) for name, joint in moving.items() if joints.has(name))


def _position(joints: YamlMap, joint: UrdfJoint) -> float:
    """Returns the start position of a joint, radians or metres; the file gives degrees, or metres for prismatic joints."""
    limited = joint.kind != "continuous" and joint.lower <= joint.upper
    low, high = (joint.lower, joint.upper) if limited else (-math.inf, math.inf)
    if joint.kind == "prismatic":
        return joints.number(joint.name, low=low, high=high)
    if limited:
        # Limits are often whole degrees, which are not exact in radians: round them outwards to a thousandth of a degree.
        lowest, highest = math.floor(math.degrees(low) * 1000) / 1000, math.ceil(math.degrees(high) * 1000) / 1000
        return min(max(math.radians(joints.number(joint.name, low=lowest, high=highest)), low), high)
    return math.radians(joints.number(joint.name))


def _check_name(name: str, builder: SceneBuilder, where: str) -> None:
    if not ROS_NAME.fullmatch(name):
        raise SceneError(
            f"{where}: name is {quoted(name)}; it becomes part of ROS frame names: use letters, digits and _, a letter first"
        )
    if any(name == body.name for body in builder.bodies):
        raise SceneError(f"{where}: name {quoted(name)} is used twice; names of bodies must be unique")


def _free_name(base: str, builder: SceneBuilder) -> str:
    """Returns a unique name for a body: ``base``, or ``base`` with _2, _3, ... if other bodies have that name."""
    used = {body.name for body in builder.bodies}
    name, number = base, 1
    while name in used:
        number += 1
        name = f"{base}_{number}"
    return name


def _start(start: YamlMap, floor: float) -> StartPose:
    if start.has("xy") == start.has("xyz"):
        raise SceneError(f"{start.where}: give either xy (on the floor) or xyz, metres")
    x, y, z = (*start.floats("xy", 2), floor) if start.has("xy") else start.floats("xyz", 3)
    yaw = math.radians(start.number("yaw_deg", 0.0))
    return StartPose(start.text("name", "start"), pose_from_xyz_rpy((x, y, z), (0.0, 0.0, yaw)))


def _pose(item: YamlMap) -> Pose:
    """Returns the value of ``pose``: ``xyz`` in metres, ``rpy_deg`` about fixed axes; the identity if it is missing."""
    pose = item.within(item.value("pose") or {}, "pose", ("xyz", "rpy_deg"))
    xyz = pose.vec3("xyz", (0.0, 0.0, 0.0), low=-FAR_AWAY, high=FAR_AWAY)
    roll, pitch, yaw = (math.radians(angle) for angle in pose.vec3("rpy_deg", (0.0, 0.0, 0.0)))
    return pose_from_xyz_rpy(xyz, (roll, pitch, yaw))
