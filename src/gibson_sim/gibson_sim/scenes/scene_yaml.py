"""Reads our own scene description, ``scene.yaml``. docs/scenes.md says what may stand in it; anything else is an error."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from gibson_sim.errors import MeshError, SceneError, TextError
from gibson_sim.geometry.transforms import matrix_from_pose, pose_from_xyz_rpy
from gibson_sim.quoting import quoted
from gibson_sim.reading import parse_yaml
from gibson_sim.robots.spec import Look, Shape
from gibson_sim.scenes.builder import FAR_AWAY, SceneBuilder
from gibson_sim.scenes.mesh_types import UpAxis
from gibson_sim.scenes.scene_bodies import read_bodies, read_pose
from gibson_sim.scenes.scene_rooms import read_rooms
from gibson_sim.scenes.spec import LightSpec, PointLight, StartPose
from gibson_sim.scenes.yaml_map import YamlMap
from gibson_sim.types import Rgba, Vec3

F64 = NDArray[np.float64]
_SCENE_KEYS = ("name", "description", "gravity", "ground_z", "floor_z", "floors", "rooms", "light", "starts", "objects", "bodies")
_LIGHT_KEYS = (
    "sun_direction", "sun", "sun_color", "shadows", "ambient", "background", "points",
    "environment", "environment_strength", "environment_yaw_deg", "environment_visible", "backdrop",
)  # fmt: skip
_POINT_KEYS = ("position", "color", "strength", "range", "attenuation", "direction", "inner_deg", "outer_deg")
_START_KEYS = ("name", "xy", "xyz", "yaw_deg")
_SHAPES = ("mesh", "box", "sphere", "cylinder")
_OBJECT_KEYS = (
    "name", *_SHAPES, "pose", "scale", "up_axis", "unit_m", "semantic_class", "collision", "visible", "color", "metallic", "roughness",
)  # fmt: skip
_UP: dict[str, UpAxis] = {"x": "x", "y": "y", "z": "z"}


def read_scene_yaml(builder: SceneBuilder, path: Path) -> None:
    """Puts everything of a scene.yaml into the builder.

    Raises:
        SceneError: a key or a value is wrong, or a mesh cannot be used.
    """
    try:
        document = parse_yaml(builder.read_bytes(path))
    except TextError as e:
        raise SceneError(f"{path}: {e}").telling(e.public) from e
    top = YamlMap(document if document is not None else {}, str(path), _SCENE_KEYS)
    builder.name = top.text("name", builder.name)
    builder.description = top.text("description", "")
    gravity = top.value("gravity", None)
    if gravity is not None:
        # One number is the strength of a gravity that points down.
        builder.gravity = (0.0, 0.0, -top.number("gravity", 0.0)) if isinstance(gravity, int | float) else top.vec3("gravity")
    builder.ground_z = None if top.value("ground_z", None) is None else top.number("ground_z", 0.0)
    builder.floor_z = None if top.value("floor_z", None) is None else top.number("floor_z", 0.0)
    builder.floors = top.floats("floors", len(top.items("floors"))) if top.has("floors") else ()
    if builder.floors and builder.floor_z is None:
        builder.floor_z = min(builder.floors)
    read_rooms(builder, path, top.items("rooms"))
    builder.light = _light(builder, path, YamlMap(top.value("light", {}) or {}, f"{path}: light", _LIGHT_KEYS))
    for index, item in enumerate(top.items("objects")):
        _object(builder, path, YamlMap(item, f"{path}: objects[{index}]", _OBJECT_KEYS))
    read_bodies(builder, path, top.items("bodies"))
    floor = builder.floor_z if builder.floor_z is not None else builder.ground_z or 0.0
    names: set[str] = set()
    for index, item in enumerate(top.items("starts")):
        start = _start(YamlMap(item, f"{path}: starts[{index}]", _START_KEYS), floor)
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
        points=tuple(
            _point(YamlMap(item, f"{light.where}: points[{k}]", _POINT_KEYS)) for k, item in enumerate(light.items("points"))
        ),
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


def _start(start: YamlMap, floor: float) -> StartPose:
    if start.has("xy") == start.has("xyz"):
        raise SceneError(f"{start.where}: give either xy (on the floor) or xyz, metres")
    x, y, z = (*start.floats("xy", 2), floor) if start.has("xy") else start.floats("xyz", 3)
    yaw = math.radians(start.number("yaw_deg", 0.0))
    return StartPose(start.text("name", "start"), pose_from_xyz_rpy((x, y, z), (0.0, 0.0, yaw)))


def _object(builder: SceneBuilder, path: Path, item: YamlMap) -> None:
    given = [kind for kind in _SHAPES if item.has(kind)]
    if len(given) != 1:
        raise SceneError(f"{item.where}: has {', '.join(given) or 'no shape'}; give exactly one of {', '.join(_SHAPES)}")
    name = item.text("name", Path(str(item.value("mesh", given[0]))).stem)
    item.where = f"{path}: object {quoted(name)}"
    matrix = matrix_from_pose(read_pose(item))
    if given[0] == "mesh":
        shape, at = _mesh(builder, path, item, item.text("mesh", ""), matrix)
    else:
        for key in ("scale", "up_axis", "unit_m"):
            if item.has(key):
                raise SceneError(f"{item.where}: {key} is for meshes; a {given[0]} has its size in metres")
        shape, at = _primitive(item, given[0]), matrix
    collision = item.text("collision", "same")
    if item.flag("visible", True):
        builder.add_visual(name, shape, at, _color(item), item.text("semantic_class", ""), _look(item))
    elif collision == "none":
        raise SceneError(f"{item.where}: visible is false and collision none: nothing of it is left; leave it out")
    if collision == "same":
        builder.add_collision(name, shape, at)
    elif collision == "simplified":
        if shape.kind != "mesh":
            raise SceneError(f"{item.where}: collision is simplified, which is for meshes; a {shape.kind} is as simple as can be")
        builder.add_simplified_collision(name, shape, at)
    elif collision != "none":
        builder.add_collision(name, *_mesh(builder, path, item, collision, matrix))


def _mesh(builder: SceneBuilder, path: Path, item: YamlMap, name: str, matrix: F64) -> tuple[Shape, F64]:
    scale = item.value("scale", 1.0)
    factors: Vec3 = (float(scale),) * 3 if isinstance(scale, int | float) else item.vec3("scale")
    if not (np.isfinite(factors).all() and all(factors)):
        raise SceneError(f"{item.where}: scale is {quoted(scale)}, must be a number or three numbers, none of them 0")
    up_axis = None
    if item.has("up_axis"):
        up_axis = _UP.get(item.text("up_axis", ""))
        if up_axis is None:
            raise SceneError(f"{item.where}: up_axis is {quoted(item.value('up_axis', ''))}, must be x, y or z")
    unit_m = item.number("unit_m", 1.0, low=1e-9) if item.has("unit_m") else None
    try:
        return builder.mesh_shape(path.parent / name, matrix, factors, up_axis, unit_m)
    except MeshError as e:
        raise SceneError(f"{item.where}: {e}") from e


def _primitive(item: YamlMap, kind: str) -> Shape:
    if kind == "box":
        return Shape("box", item.vec3("box", low=1e-6))
    if kind == "sphere":
        return Shape("sphere", (item.number("sphere", 0.0, low=1e-6), 0.0, 0.0))
    sizes = YamlMap(item.value("cylinder", {}), f"{item.where}: cylinder", ("radius", "length"))
    return Shape("cylinder", (sizes.number("radius", 0.0, low=1e-6), sizes.number("length", 0.0, low=1e-6), 0.0))


def _look(item: YamlMap) -> Look | None:
    if not (item.has("metallic") or item.has("roughness")):
        return None
    metallic, roughness = (item.number(k, 0.0, 0.0, 1.0) if item.has(k) else None for k in ("metallic", "roughness"))
    return Look(metallic=metallic, roughness=roughness)


def _color(item: YamlMap) -> Rgba | None:
    if not item.has("color"):
        return None
    values = item.value("color", None)
    count = len(values) if isinstance(values, list) else 0
    r, g, b, *alpha = item.floats("color", 4 if count == 4 else 3, low=0.0, high=1.0)
    return (r, g, b, alpha[0] if alpha else 1.0)
