"""Reads our own scene description, ``scene.yaml``. docs/scenes.md says what may stand in it; anything else is an error."""

from __future__ import annotations

import difflib
import math
from pathlib import Path
from typing import Any

import numpy as np
import yaml
from numpy.typing import NDArray

from gibson_sim.errors import MeshError, SceneError
from gibson_sim.geometry.transforms import matrix_from_pose, pose_from_xyz_rpy
from gibson_sim.robots.spec import Shape
from gibson_sim.scenes.builder import FAR_AWAY, SceneBuilder
from gibson_sim.scenes.mesh_types import UpAxis
from gibson_sim.scenes.spec import LightSpec, StartPose
from gibson_sim.types import Pose, Rgba, Vec3

F64 = NDArray[np.float64]
_SCENE_KEYS = ("name", "description", "gravity", "ground_z", "floor_z", "light", "starts", "objects")
_LIGHT_KEYS = ("sun_direction", "sun", "ambient", "background")
_START_KEYS = ("name", "xy", "xyz", "yaw_deg")
_SHAPES = ("mesh", "box", "sphere", "cylinder")
_OBJECT_KEYS = (
    "name", *_SHAPES, "pose", "scale", "up_axis", "unit_m", "semantic_class", "collision", "color",
)  # fmt: skip
_UP: dict[str, UpAxis] = {"x": "x", "y": "y", "z": "z"}


def read_scene_yaml(builder: SceneBuilder, path: Path) -> None:
    """Puts everything of a scene.yaml into the builder.

    Raises:
        SceneError: a key or a value is wrong, or a mesh cannot be used.
    """
    try:
        document = yaml.safe_load(builder.read_bytes(path))
    except (yaml.YAMLError, UnicodeDecodeError) as e:
        raise SceneError(f"{path}: is no YAML: {' '.join(str(e).split())}") from e
    top = _Map(document if document is not None else {}, str(path), _SCENE_KEYS)
    builder.name = top.text("name", builder.name)
    builder.description = top.text("description", "")
    gravity = top.value("gravity", None)
    if gravity is not None:
        # One number is the strength of a gravity that points down.
        builder.gravity = (0.0, 0.0, -top.number("gravity", 0.0)) if isinstance(gravity, int | float) else top.vec3("gravity")
    builder.ground_z = None if top.value("ground_z", None) is None else top.number("ground_z", 0.0)
    builder.floor_z = None if top.value("floor_z", None) is None else top.number("floor_z", 0.0)
    builder.light = _light(_Map(top.value("light", {}) or {}, f"{path}: light", _LIGHT_KEYS))
    for index, item in enumerate(top.items("objects")):
        _object(builder, path, _Map(item, f"{path}: objects[{index}]", _OBJECT_KEYS))
    floor = builder.floor_z if builder.floor_z is not None else builder.ground_z or 0.0
    names: set[str] = set()
    for index, item in enumerate(top.items("starts")):
        start = _start(_Map(item, f"{path}: starts[{index}]", _START_KEYS), floor)
        if start.name in names:
            raise SceneError(f"{path}: starts[{index}]: name {start.name!r} is used twice; names must be unique")
        names.add(start.name)
        builder.starts.append(start)


def _light(light: _Map) -> LightSpec:
    default = LightSpec()
    direction = light.vec3("sun_direction", default.sun_direction)
    if not any(direction):
        raise SceneError(f"{light.where}: sun_direction is {list(direction)}, must not be zero")
    return LightSpec(
        direction,
        light.number("sun", default.sun, low=0.0),
        light.number("ambient", default.ambient, low=0.0),
        light.vec3("background", default.background, low=0.0, high=1.0),
    )


def _start(start: _Map, floor: float) -> StartPose:
    if start.has("xy") == start.has("xyz"):
        raise SceneError(f"{start.where}: give either xy (on the floor) or xyz, metres")
    x, y, z = (*start.floats("xy", 2), floor) if start.has("xy") else start.floats("xyz", 3)
    yaw = math.radians(start.number("yaw_deg", 0.0))
    return StartPose(start.text("name", "start"), pose_from_xyz_rpy((x, y, z), (0.0, 0.0, yaw)))


def _object(builder: SceneBuilder, path: Path, item: _Map) -> None:
    given = [kind for kind in _SHAPES if item.has(kind)]
    if len(given) != 1:
        raise SceneError(f"{item.where}: has {', '.join(given) or 'no shape'}; give exactly one of {', '.join(_SHAPES)}")
    name = item.text("name", Path(str(item.value("mesh", given[0]))).stem)
    item.where = f"{path}: object {name!r}"
    matrix = matrix_from_pose(_pose(item))
    if given[0] == "mesh":
        shape, at = _mesh(builder, path, item, item.text("mesh", ""), matrix)
    else:
        for key in ("scale", "up_axis", "unit_m"):
            if item.has(key):
                raise SceneError(f"{item.where}: {key} is for meshes; a {given[0]} has its size in metres")
        shape, at = _primitive(item, given[0]), matrix
    builder.add_visual(name, shape, at, _color(item), item.text("semantic_class", ""))
    collision = item.text("collision", "same")
    if collision == "same":
        builder.add_collision(name, shape, at)
    elif collision != "none":
        builder.add_collision(name, *_mesh(builder, path, item, collision, matrix))


def _pose(item: _Map) -> Pose:
    pose = _Map(item.value("pose", {}) or {}, f"{item.where}: pose", ("xyz", "rpy_deg"))
    xyz = pose.vec3("xyz", (0.0, 0.0, 0.0), low=-FAR_AWAY, high=FAR_AWAY)
    roll, pitch, yaw = (math.radians(angle) for angle in pose.vec3("rpy_deg", (0.0, 0.0, 0.0)))
    return pose_from_xyz_rpy(xyz, (roll, pitch, yaw))


def _mesh(builder: SceneBuilder, path: Path, item: _Map, name: str, matrix: F64) -> tuple[Shape, F64]:
    scale = item.value("scale", 1.0)
    factors: Vec3 = (float(scale),) * 3 if isinstance(scale, int | float) else item.vec3("scale")
    if not (np.isfinite(factors).all() and all(factors)):
        raise SceneError(f"{item.where}: scale is {scale!r}, must be a number or three numbers, none of them 0")
    up_axis = None
    if item.has("up_axis"):
        up_axis = _UP.get(item.text("up_axis", ""))
        if up_axis is None:
            raise SceneError(f"{item.where}: up_axis is {item.value('up_axis', '')!r}, must be x, y or z")
    unit_m = item.number("unit_m", 1.0, low=1e-9) if item.has("unit_m") else None
    try:
        return builder.mesh_shape(path.parent / name, matrix, factors, up_axis, unit_m)
    except MeshError as e:
        raise SceneError(f"{item.where}: {e}") from e


def _primitive(item: _Map, kind: str) -> Shape:
    if kind == "box":
        return Shape("box", item.vec3("box", low=1e-6))
    if kind == "sphere":
        return Shape("sphere", (item.number("sphere", 0.0, low=1e-6), 0.0, 0.0))
    sizes = _Map(item.value("cylinder", {}), f"{item.where}: cylinder", ("radius", "length"))
    return Shape("cylinder", (sizes.number("radius", 0.0, low=1e-6), sizes.number("length", 0.0, low=1e-6), 0.0))


def _color(item: _Map) -> Rgba | None:
    if not item.has("color"):
        return None
    values = item.value("color", None)
    count = len(values) if isinstance(values, list) else 0
    r, g, b, *alpha = item.floats("color", 4 if count == 4 else 3, low=0.0, high=1.0)
    return (r, g, b, alpha[0] if alpha else 1.0)


class _Map:
    """A mapping of the file that complains about keys and values in one line.

    Args:
        content: what the file has here.
        where: file and place, for messages.
        known: the keys that may stand here.
    """

    def __init__(self, content: Any, where: str, known: tuple[str, ...]) -> None:
        if not isinstance(content, dict):
            raise SceneError(f"{where}: is {content!r}, must be a mapping with {', '.join(known)}")
        for key in content:
            if key not in known:
                near = difflib.get_close_matches(str(key), known, n=1, cutoff=0.0)
                raise SceneError(f"{where}: key {key!r} is unknown, did you mean {near[0]!r}? known: {', '.join(known)}")
        self.content: dict[str, Any] = content
        self.where = where

    def has(self, key: str) -> bool:
        return self.content.get(key) is not None

    def value(self, key: str, default: Any) -> Any:
        return self.content.get(key, default)

    def text(self, key: str, default: str) -> str:
        value = self.content.get(key, default)
        if value is None and key == "collision":
            return "none"
        if not isinstance(value, str):
            raise SceneError(f"{self.where}: {key} is {value!r}, must be text")
        return value

    def items(self, key: str) -> list[Any]:
        value = self.content.get(key) or []
        if not isinstance(value, list):
            raise SceneError(f"{self.where}: {key} is {value!r}, must be a list")
        return value

    def number(self, key: str, default: float, low: float = -math.inf, high: float = math.inf) -> float:
        return self._checked(key, self.content.get(key, default), low, high)

    def floats(self, key: str, count: int, low: float = -math.inf, high: float = math.inf) -> tuple[float, ...]:
        value = self.content.get(key)
        if not isinstance(value, list) or len(value) != count:
            raise SceneError(f"{self.where}: {key} is {value!r}, must be a list of {count} numbers")
        return tuple(self._checked(key, v, low, high) for v in value)

    def vec3(self, key: str, default: Vec3 | None = None, low: float = -math.inf, high: float = math.inf) -> Vec3:
        if default is not None and not self.has(key):
            return default
        x, y, z = self.floats(key, 3, low, high)
        return (x, y, z)

    def _checked(self, key: str, value: Any, low: float, high: float) -> float:
        good = isinstance(value, int | float) and not isinstance(value, bool) and math.isfinite(value)
        if not good or not low <= value <= high:
            limits = "" if low == -math.inf and high == math.inf else f", from {low:g} to {high:g}"
            raise SceneError(f"{self.where}: {key} is {value!r}, must be a finite number{limits}")
        return float(value)
