"""Reads the list ``bodies`` of a scene.yaml: things that move, each a model of ours or a file in the scene's folder."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path
from typing import Any

from gibson_sim.errors import MeshError, SceneError
from gibson_sim.geometry.transforms import pose_from_xyz_rpy
from gibson_sim.quoting import quoted
from gibson_sim.robots.body import BodySpec
from gibson_sim.robots.rigid import MOVING_TYPES
from gibson_sim.robots.scaling import scaled_model
from gibson_sim.robots.urdf import UrdfJoint, UrdfModel
from gibson_sim.scenes.builder import FAR_AWAY, SceneBuilder
from gibson_sim.scenes.spawning import load_spawnable
from gibson_sim.scenes.yaml_map import YamlMap
from gibson_sim.types import Pose

_KEYS = ("name", "model", "pose", "joints", "static", "scale", "semantic_class")
_NAME_RULE = "use letters, digits and _, a letter first"
_SCALES = (0.01, 100.0)


def read_bodies(builder: SceneBuilder, path: Path, items: list[Any]) -> None:
    """Puts the bodies of a scene.yaml at ``path`` into the builder.

    Raises:
        SceneError: a key or a value is wrong, or a model cannot be used.
    """
    models: dict[str, BodySpec] = {}
    for index, content in enumerate(items):
        item = YamlMap(content, f"{path}: bodies[{index}]", _KEYS)
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
        _add(builder, item, replace(models[model], name=name))


def read_pose(item: YamlMap) -> Pose:
    """Returns the pose that stands under ``pose``: ``xyz`` in metres, ``rpy_deg`` about fixed axes; the origin where there is none."""
    pose = YamlMap(item.value("pose", {}) or {}, f"{item.where}: pose", ("xyz", "rpy_deg"))
    xyz = pose.vec3("xyz", (0.0, 0.0, 0.0), low=-FAR_AWAY, high=FAR_AWAY)
    roll, pitch, yaw = (math.radians(angle) for angle in pose.vec3("rpy_deg", (0.0, 0.0, 0.0)))
    return pose_from_xyz_rpy(xyz, (roll, pitch, yaw))


def _add(builder: SceneBuilder, item: YamlMap, body: BodySpec) -> None:
    model = scaled_model(body.model, item.number("scale", 1.0, *_SCALES))
    placed = replace(
        body,
        model=model,
        start=read_pose(item),
        static=item.flag("static", False) or body.static,
        semantic_class=item.text("semantic_class", body.semantic_class),
        joints=_joints(item, model),
    )
    try:
        builder.add_body(placed, model.path)
    except MeshError as e:
        raise SceneError(f"{item.where}: {e}") from e


def _read_model(builder: SceneBuilder, path: Path, model: str, where: str) -> BodySpec:
    """Returns the body that a model describes, at the origin."""
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
            f"{where}: model {quoted(model)} is a robot; robots are not part of a scene: give it as --robot, or spawn it"
        )
    return spec


def _joints(item: YamlMap, model: UrdfModel) -> tuple[tuple[str, float], ...]:
    """Returns where joints start, radians or metres, in the order of the model."""
    moving = {joint.name: joint for joint in model.joints if joint.kind in MOVING_TYPES}
    given = item.value("joints", {}) or {}
    if given and not moving:
        raise SceneError(f"{item.where}: joints are given, but {model.path.name} has none that moves; leave them out")
    joints = YamlMap(given, f"{item.where}: joints", tuple(moving))
    return tuple((name, _position(joints, joint)) for name, joint in moving.items() if joints.has(name))


def _position(joints: YamlMap, joint: UrdfJoint) -> float:
    """Returns where a joint starts; the file gives degrees, or metres for what slides."""
    limited = joint.kind != "continuous" and joint.lower <= joint.upper
    low, high = (joint.lower, joint.upper) if limited else (-math.inf, math.inf)
    if joint.kind == "prismatic":
        return joints.number(joint.name, 0.0, low, high)
    if limited:
        # Limits are often round degrees, which no radian is exactly: they are rounded outwards to a thousandth.
        lowest, highest = math.floor(math.degrees(low) * 1000) / 1000, math.ceil(math.degrees(high) * 1000) / 1000
        return min(max(math.radians(joints.number(joint.name, 0.0, lowest, highest)), low), high)
    return math.radians(joints.number(joint.name, 0.0))


def _check_name(name: str, builder: SceneBuilder, where: str) -> None:
    if not (name.isascii() and name[:1].isalpha() and name.replace("_", "a").isalnum()):
        raise SceneError(f"{where}: name is {quoted(name)}; it becomes part of frames in ROS: {_NAME_RULE}")
    if any(name == body.name for body in builder.bodies):
        raise SceneError(f"{where}: name {quoted(name)} is used twice; names of bodies must differ")


def _free_name(base: str, builder: SceneBuilder) -> str:
    """Returns the name of a body that was given none: that of its model, with _2, _3, ... if there are several."""
    taken = {body.name for body in builder.bodies}
    name, number = base, 1
    while name in taken:
        number += 1
        name = f"{base}_{number}"
    return name
