"""Reads the ``cameras`` section of a ``robot.yaml``, or of a separate file."""

from __future__ import annotations

import math
from collections.abc import Callable, Collection
from dataclasses import fields
from pathlib import Path
from typing import Any, cast

import numpy as np

from gibson_sim.config import parse_fill
from gibson_sim.description.urdf import UrdfModel
from gibson_sim.errors import ConfigError, RobotError
from gibson_sim.formats.yaml_map import ROS_NAME, YamlMap, read_yaml_map
from gibson_sim.geometry.transforms import R_LINK_OPTICAL, Mat4, matrix_from_pose, pose_from_matrix, pose_from_xyz_rpy
from gibson_sim.quoting import quoted
from gibson_sim.types import (
    DEFAULT_OUTPUTS,
    DISTORTIONS,
    OUTPUTS,
    WORLD_FRAME,
    CameraSpec,
    DepthNoise,
    ImageEffects,
    Pose,
    Projection,
)

_OPTICS_KEYS = ("projection", "k", "fov_y_deg", "fov_deg", "distortion_model", "d")
_CAMERA_KEYS = (
    "name", "link", "pose", "width", "height", *_OPTICS_KEYS, "rate_hz", "near", "far", "outputs", "samples", "stereo_baseline",
    "effects", "depth_noise", "fill", "fill_depth",
)  # fmt: skip
_MATRIX_KEYS = ("fx", "fy", "cx", "cy", "skew")
_POSE_KEYS = ("xyz", "rpy_deg")
_ZERO = (0.0, 0.0, 0.0)


def read_cameras(robot: YamlMap, model: UrdfModel, name: str, folder: Path) -> tuple[CameraSpec, ...]:
    """Returns the cameras of the robot ``name``, in the order of the file; ``folder``: folder of the file."""
    entries = robot.values.get("cameras") or []
    if not isinstance(entries, list):
        raise RobotError(f"{robot.where}: cameras must be a list, is {type(entries).__name__}")
    return _cameras(_entries(robot, entries, folder), robot.where, lambda link: f"{name}/{model.link(link).name}")


def load_cameras(path: Path, links: Collection[str]) -> tuple[CameraSpec, ...]:
    """Returns the cameras in the section ``cameras`` of a ``robot.yaml`` or another YAML file.

    Args:
        path: The YAML file.
        links: ``<body>/<link>`` of all links that a camera may be fixed to. The file may omit the body if only one has such a link;
            ``map`` is the world.

    Returns:
        The cameras on links; those with a ``view`` are left out, see ``gibson_sim.scenes.load_views``.

    Raises:
        RobotError: the file cannot be read, or a key, a value or a link is invalid.
    """
    entries = [entry for entry in camera_entries(path) if "view" not in entry.values]

    def find(link: str) -> str:
        if link in (*links, WORLD_FRAME):
            return "" if link == WORLD_FRAME else link
        ends = [known for known in links if known.endswith(f"/{link}")]
        if len(ends) == 1:
            return ends[0]
        what = f"stands for {' and '.join(ends)}" if ends else "is not in the scene"
        raise RobotError(f"{path}: link {quoted(link)} {what}; there are: {WORLD_FRAME}, {', '.join(links)}")

    try:
        return _cameras(entries, str(path), find)
    except ConfigError as error:
        raise RobotError(f"{path}: {error}") from error


def camera_entries(path: Path) -> list[YamlMap]:
    """Returns the entries of the section ``cameras`` of a file, at least one.

    Raises:
        RobotError: the file cannot be read, or has no cameras.
    """
    document = read_yaml_map(path, error=RobotError)
    if "urdf" not in document.values:  # else it is a robot.yaml, whose other keys load_robot checks
        document.check_keys(("cameras",))
    entries = document.values.get("cameras") or []
    if not isinstance(entries, list) or not entries:
        raise RobotError(f"{path}: cameras is {quoted(entries)}, must be a list with at least one camera, as in a robot.yaml")
    return _entries(document, entries, path.parent)


def _entries(top: YamlMap, entries: list[Any], folder: Path) -> list[YamlMap]:
    return [_with_fill(top.within(entry, f"cameras[{i}]"), folder) for i, entry in enumerate(entries)]


def _with_fill(entry: YamlMap, folder: Path) -> YamlMap:
    """Returns an entry with ``fill`` as in ``CameraSpec``; the path of a network is relative to the folder of the YAML file."""
    if not entry.has("fill"):
        return entry
    value = entry.values["fill"]
    try:
        fill, with_depth = parse_fill("fill", "none" if value is False else value, folder)  # "off" is False in YAML
    except ConfigError as error:
        raise RobotError(f"{entry.where}: {error}") from error
    depth = {"fill_depth": True} if with_depth else {}
    return YamlMap({**entry.values, "fill": fill, **depth}, entry.where, error=RobotError)


def _cameras(entries: list[YamlMap], where: str, find_link: Callable[[str], str]) -> tuple[CameraSpec, ...]:
    cameras = tuple(read_camera(entry, find_link) for entry in entries)
    names = [camera.name for camera in cameras]
    if len(set(names)) != len(names):
        raise RobotError(f"{where}: cameras are named {', '.join(names)}; names must be unique")
    return cameras


def read_camera(settings: YamlMap, find_link: Callable[[str], str]) -> CameraSpec:
    """Returns the camera of an entry; ``find_link`` returns the full name of a link, empty = the world.

    Raises:
        RobotError: a key or a value is invalid.
        ConfigError: the values are not a valid camera.
    """
    settings.check_keys(_CAMERA_KEYS)
    camera_name = settings.text("name")
    if not ROS_NAME.fullmatch(camera_name):
        raise RobotError(f"{settings.where}: name is {quoted(camera_name)}; use letters, digits and _, a letter first")
    link = find_link(settings.text("link"))
    values: dict[str, Any] = {
        **settings.integers(("width", "height", "samples")),
        **settings.numbers(("near", "far", "rate_hz", "stereo_baseline")),
        **_optics(settings),
    }
    for key, kind in (("effects", ImageEffects), ("depth_noise", DepthNoise)):
        if (section := settings.section(key)) is not None:
            values[key] = _numeric_spec(section, kind)
    outputs = settings.values.get("outputs", list(DEFAULT_OUTPUTS))
    if not isinstance(outputs, list) or not all(isinstance(item, str) for item in outputs):
        raise RobotError(f"{settings.where}: outputs is {quoted(outputs)}, must be a list of {', '.join(OUTPUTS)}")
    values["fill"] = settings.value("fill", "")
    values["fill_depth"] = settings.flag("fill_depth", False)
    if values["fill_depth"] and "hole" not in outputs:
        outputs = [*outputs, "hole"]  # it marks the filled depths
    pose = _camera_pose(settings, link)
    return CameraSpec(name=camera_name, link=link, pose=pose, outputs=tuple(outputs), **values)


def _optics(settings: YamlMap) -> dict[str, Any]:
    """Returns the fields of ``CameraSpec`` that define its projection."""
    projection = cast(Projection, settings.text("projection", "pinhole"))
    if projection not in DISTORTIONS:
        raise RobotError(f"{settings.where}: projection is {quoted(projection)}, must be one of {', '.join(DISTORTIONS)}")
    out: dict[str, Any] = {"projection": projection}
    # Reject angles of another projection, which would be ignored silently.
    for key, field, owner in (("fov_y_deg", "fov_y", "pinhole"), ("fov_deg", "fov", "fisheye")):
        if key in settings.values:
            if projection != owner:
                other = {"pinhole": "a pinhole camera has fov_y_deg", "fisheye": "a fisheye has fov_deg"}.get(projection, "")
                raise RobotError(f"{settings.where}: {key} is for a {owner} camera; {other or 'an equirectangular one sees all'}")
            out[field] = math.radians(settings.number(key))
    if "k" in settings.values:
        if "fov_y_deg" in settings.values:
            raise RobotError(f"{settings.where}: k and fov_y_deg both say how wide the image is; leave one out")
        out["matrix"] = _matrix(settings)
    if ("d" in settings.values) != ("distortion_model" in settings.values):
        raise RobotError(f"{settings.where}: d and distortion_model belong together; give both, as in a camera_info")
    if "d" in settings.values:
        d, model, models = settings.floats("d"), settings.text("distortion_model"), DISTORTIONS[projection]
        if model not in models:
            known = " or ".join(models) or "none at all"
            raise RobotError(
                f"{settings.where}: distortion_model is {quoted(model)}, that of a {projection} camera must be {known}"
            )
        if len(d) not in models[model]:
            counts = " or ".join(map(str, models[model]))
            raise RobotError(f"{settings.where}: d has {len(d)} numbers, {model} has {counts}")
        out["distortion"] = d
    return out


def _matrix(settings: YamlMap) -> tuple[float, ...]:
    """Returns K from nine numbers, row-major, or from a mapping of focal lengths and principal point."""
    if isinstance(settings.values["k"], list):
        return settings.floats("k")
    section = settings.section("k")
    if section is None:
        raise RobotError(f"{settings.where}: k is empty, must be nine numbers, or fx, fy, cx, cy and, if any, skew")
    section.check_keys(_MATRIX_KEYS)
    values = section.numbers(_MATRIX_KEYS)
    missing = [key for key in _MATRIX_KEYS[:4] if key not in values]
    if missing:
        raise RobotError(f"{section.where}: {', '.join(missing)} is missing; give fx, fy, cx and cy, pixels")
    return (values["fx"], values.get("skew", 0.0), values["cx"], 0.0, values["fy"], values["cy"], 0.0, 0.0, 1.0)


def _numeric_spec(section: YamlMap, kind: type[ImageEffects] | type[DepthNoise]) -> ImageEffects | DepthNoise:
    """Returns a specification with numeric fields, with the values in the file."""
    whole = tuple(f.name for f in fields(kind) if isinstance(f.default, int))
    names = tuple(f.name for f in fields(kind))
    section.check_keys(names)
    return kind(**section.integers(whole), **section.numbers(tuple(n for n in names if n not in whole)))  # type: ignore[arg-type]


def _camera_pose(settings: YamlMap, link: str) -> Pose:
    """Returns T_link_optical. A link with ``_optical`` in its name already has optical axes (REP 103)."""
    place = settings.section("pose")
    if "_optical" in link.rpartition("/")[2]:
        if place is not None:
            raise RobotError(
                f"{settings.where}: link {quoted(link)} is optical, so a pose is not allowed; name the link that it is fixed to instead"
            )
        return Pose()
    T_link_camera: Mat4 = np.eye(4)
    if place is not None:
        place.check_keys(_POSE_KEYS)
        roll, pitch, yaw = (math.radians(angle) for angle in place.vec3("rpy_deg", _ZERO))
        T_link_camera = matrix_from_pose(pose_from_xyz_rpy(place.vec3("xyz", _ZERO), (roll, pitch, yaw)))
    T_link_camera[:3, :3] = T_link_camera[:3, :3] @ R_LINK_OPTICAL
    return pose_from_matrix(T_link_camera)
