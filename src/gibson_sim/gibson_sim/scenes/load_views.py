"""Reads views from a list such as ``follow,top,orbit:left`` or from a file of cameras."""

from __future__ import annotations

import math
import re
from collections.abc import Collection, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

from gibson_sim.errors import ConfigError, RobotError
from gibson_sim.formats.yaml_map import YamlMap
from gibson_sim.quoting import quoted
from gibson_sim.robots.loading.cameras import camera_entries, load_cameras, read_camera
from gibson_sim.scenes.views import Fixed, Follow, Motion, Orbit, Top, View
from gibson_sim.settings import nearest
from gibson_sim.types import WORLD_FRAME, CameraSpec, Pose

_KINDS: dict[str, type[Follow] | type[Orbit] | type[Top]] = {"follow": Follow, "orbit": Orbit, "top": Top}
_NUMBERS = {
    "follow": ("distance", "height", "look_at"),
    "orbit": ("distance", "height", "look_at", "period"),
    "top": ("span", "cut"),
}  # fmt: skip
_FOV_Y_DEG = {"follow": 60.0, "orbit": 60.0, "top": 30.0}
"""Default vertical field of view, degrees; narrow from the top, so that the sides of walls are hardly visible."""
_OPTICS = ("fov_y_deg", "fov_deg", "k", "projection")
_FILES = (".yaml", ".yml")


def read_views(text: str, size: tuple[int, int] = (640, 480), rate_hz: float = 30.0) -> tuple[View, ...]:
    """Returns the views of a comma-separated list, in its order.

    Args:
        text: parts separated by commas: ``follow``, ``orbit`` or ``top``, also with a target (``follow:left``), or files of cameras,
            each with a ``view`` or fixed to ``map``.
        size: default (width, height) of views, pixels.
        rate_hz: default rate of views, images per second of simulation time.

    Raises:
        ConfigError: a part is not valid, or two views have the same name.
        RobotError: a file cannot be read, or a key or a value in it is wrong.
    """
    defaults = {"width": size[0], "height": size[1], "rate_hz": rate_hz}
    views: list[View] = []
    for part in filter(None, (part.strip() for part in text.split(","))):
        if Path(part).suffix in _FILES:
            views += [_view(entry, defaults) for entry in camera_entries(Path(part))]
        else:
            views.append(_named_view(part, defaults))
    names = [view.camera.name for view in views]
    if len(set(names)) != len(names):
        raise ConfigError(f"views are named {', '.join(names)}; names must be unique")
    return tuple(views)


def load_camera_file(path: Path, links: Collection[str]) -> tuple[tuple[CameraSpec, ...], tuple[View, ...]]:
    """Returns the cameras on links and the views of a camera file; see ``load_cameras`` for the arguments.

    Raises:
        RobotError: the file cannot be read, or a key or a value is wrong.
    """
    views = tuple(_view(entry, {}) for entry in camera_entries(path) if "view" in entry.values)
    cameras = load_cameras(path, links)
    names = [*(camera.name for camera in cameras), *(view.camera.name for view in views)]
    if len(set(names)) != len(names):
        raise RobotError(f"{path}: cameras are named {', '.join(names)}; names must be unique")
    return cameras, views


def _named_view(part: str, defaults: Mapping[str, Any]) -> View:
    """Returns the view of one part of the list."""
    kind, colon, target = (word.strip() for word in part.partition(":"))
    if kind not in _KINDS or bool(colon) != bool(target):
        known, hint = ", ".join(_KINDS), nearest(kind, tuple(_KINDS))
        raise ConfigError(
            f"view {quoted(part)} is not known; {f'{hint} ' if hint else ''}"
            f"give {known}, one with a target (follow:left), or a file of cameras (.yaml)"
        )
    name = "_".join(["view", kind, *re.findall(r"[A-Za-z0-9_]+", target)])
    values = {"name": name, "view": {"kind": kind, **({"target": target} if target else {})}}
    return _view(YamlMap(values, f"view {quoted(part)}", error=RobotError), defaults)


def _view(entry: YamlMap, defaults: Mapping[str, Any]) -> View:
    """Returns the view of an entry of a camera file."""
    if "view" not in entry.values:
        if entry.values.get("link") != WORLD_FRAME:
            raise RobotError(
                f"{entry.where}: a view has the key 'view', or link: {WORLD_FRAME}; cameras on links belong in a robot.yaml"
            )
        camera = _camera(entry, {"outputs": ["rgb"], **defaults, **entry.values})
        return View(replace(camera, link=camera.name, pose=Pose()), Fixed(camera.pose), near_requested=True)
    for key in ("link", "pose"):
        if key in entry.values:
            raise RobotError(f"{entry.where}: a view has no {key}, its kind determines its pose; leave {key} or view out")
    section = _section(entry)
    kind = section.text("kind")
    values = {"outputs": ["rgb"], **defaults, **{k: v for k, v in entry.values.items() if k != "view"}, "link": WORLD_FRAME}
    if kind in _FOV_Y_DEG and not any(key in values for key in _OPTICS):
        values["fov_y_deg"] = _FOV_Y_DEG[kind]
    camera = _camera(entry, values)
    return View(replace(camera, link=camera.name, pose=Pose()), _motion(section, kind), near_requested="near" in entry.values)


def _camera(entry: YamlMap, values: Mapping[str, Any]) -> CameraSpec:
    """Returns a camera fixed to the world."""
    try:
        return read_camera(YamlMap(values, entry.where, error=RobotError), lambda link: "")
    except ConfigError as error:
        raise RobotError(f"{entry.where}: {error}") from error


def _section(entry: YamlMap) -> YamlMap:
    """Returns the mapping under ``view``, whose value may also be only the kind."""
    content = entry.values["view"]
    values = {"kind": content} if isinstance(content, str) else content
    return entry.within(values, "view")


def _motion(section: YamlMap, kind: str) -> Motion:
    if kind not in _KINDS:
        raise RobotError(f"{section.where}: kind is {quoted(kind)}, must be one of {', '.join(_KINDS)}")
    section.check_keys(("kind", "target", *(() if kind == "follow" else ("center",)), *_NUMBERS[kind], "yaw_deg"))
    values: dict[str, Any] = dict(section.numbers(_NUMBERS[kind]))
    if "target" in section.values:
        values["target"] = section.text("target")
    if "yaw_deg" in section.values:
        values["yaw"] = math.radians(section.number("yaw_deg"))
    if "center" in section.values:
        center, count = section.floats("center"), {"orbit": 3, "top": 2}[kind]
        if len(center) != count:
            raise RobotError(f"{section.where}: center has {len(center)} numbers, must have {count} for kind {quoted(kind)}")
        values["center"] = center
        if kind == "orbit":
            values.setdefault("target", "")
    try:
        return _KINDS[kind](**values)
    except ConfigError as error:
        raise RobotError(f"{section.where}: {error}") from error
