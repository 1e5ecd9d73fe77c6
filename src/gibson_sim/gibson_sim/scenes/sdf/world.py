"""Reads SDF worlds of Gazebo: models, includes, gravity and an approximation of the light."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np

from gibson_sim.description.omissions import OmissionKind
from gibson_sim.errors import SceneError
from gibson_sim.formats.uris import UriResolver
from gibson_sim.quoting import quoted
from gibson_sim.scenes.builder import SceneBuilder
from gibson_sim.scenes.sdf.elements import F64, Element, is_true, name_of, numbers, read_sdf, sdf_version, text_of
from gibson_sim.scenes.sdf.left_out import listed
from gibson_sim.scenes.sdf.model import SdfModels
from gibson_sim.scenes.sdf.scopes import Scope
from gibson_sim.scenes.spec import LightSpec, PointLight
from gibson_sim.types import Vec3

_SUN = 0.7
"""Strength of a directional light with white diffuse colour; below 1, since ambient and specular light are added."""
_LAMP = 0.25
"""Strength of a point or spot light with white diffuse colour; low, since without shadows it also lights adjacent rooms."""
_LIGHT_NUMBERS = (
    "intensity", "attenuation/range", "attenuation/constant", "attenuation/linear", "attenuation/quadratic", "spot/inner_angle",
    "spot/outer_angle",
)  # fmt: skip
"""Paths of the numbers of a light."""
_COLORS = ("diffuse", "ambient", "background")
_MIN_AMBIENT = 0.2
"""Minimum ambient light, so that a scene without lights is not black."""


def read_sdf_world(builder: SceneBuilder, path: Path) -> None:
    """Adds the content of a world file to the builder.

    Raises:
        SceneError: the file is not an SDF world.
    """
    place_world(builder, read_sdf(builder, path), path)


def place_world(builder: SceneBuilder, root: Element, path: Path) -> None:
    """Adds the content of a parsed world to the builder.

    Args:
        builder: the builder.
        root: the outermost element.
        path: path of the file, for messages and relative names; need not exist.

    Raises:
        SceneError: the document is not an SDF world.
    """
    world = root.find("world") if root.tag in ("sdf", "gazebo") else None
    if world is None and root.tag in ("sdf", "gazebo") and root.find("model") is not None:
        world = _world_of_models(root)
    if world is None:
        raise SceneError(f"{path}: holds no <world>; name a world file or a mesh")
    if len(root.findall("world")) > 1:
        text = f"{path}: holds several worlds; the first, {quoted(world.get('name', ''))}, is used"
        builder.warn(text, OmissionKind.UNSUPPORTED_ELEMENT)
    gravity = _vector(builder, world, "gravity", (3,)) or _vector(builder, world, "physics/gravity", (3,))
    if gravity is not None:
        builder.gravity = (gravity[0], gravity[1], gravity[2])
    models = SdfModels(builder, UriResolver(builder.root, path.parent))
    scope = models.scope(world, world.get("name", ""), path.parent, sdf_version(root), path)
    for child in world:
        frame = scope.nested.get(child)
        if frame is not None and frame.inner is not None:
            models.place(frame.inner, scope.origin(frame), frame.inner.name)
        elif child.tag in ("actor", "population", "road"):
            text = f"<{child.tag}> {quoted(child.get('name', ''))} is not supported; left out"
            builder.warn(text, OmissionKind.UNSUPPORTED_ELEMENT)
    models.left_out.visit(world, f"world {scope.name}")
    models.report()
    _name_moving(builder, scope)
    lights = [(light, scope.placed(light)) for light in world.iterfind("light")]
    lights += [(light, scope.placed(light, pose)) for light, pose in scope.lights] + models.lights
    for light, _ in lights:
        for tag, counts in (("diffuse", (3, 4)), ("direction", (3,)), *((tag, (1,)) for tag in _LIGHT_NUMBERS)):
            _vector(builder, light, tag, counts)
    for tag in ("scene/ambient", "scene/background"):
        _vector(builder, world, tag, (3, 4))
    builder.light = _light(world, lights, builder.sdf_lamps)


def _vector(builder: SceneBuilder, element: Element, path: str, counts: tuple[int, ...]) -> list[float] | None:
    """Returns the numbers in a descendant, None if it is not given or, with a warning, not as many finite numbers as one of ``counts``."""
    text = text_of(element, path)
    values = numbers(text, counts)
    if text and values is None:
        tag, count = path.rpartition("/")[2], " or ".join(map(str, counts))
        where = f"{element.tag} {name_of(element)}"
        builder.warn(
            f"{where}: <{tag}> is {quoted(text)}, must be {count} finite numbers; the default is used", OmissionKind.INVALID
        )
    if values is not None and path.rpartition("/")[2] in _COLORS and not all(0.0 <= value <= 1.0 for value in values):
        where = f"{element.tag} {name_of(element)}"
        builder.warn(f"{where}: <{path.rpartition('/')[2]}> is {quoted(text)}, must be 0 to 1; it is clipped")
    return values


def _name_moving(builder: SceneBuilder, scope: Scope) -> None:
    """Warns about the models of a world that move in Gazebo."""
    inner = [frame.inner for frame in scope.nested.values() if frame.inner is not None and not frame.inner.is_static]
    names = list(dict.fromkeys(model.name for model in inner))
    if names:
        builder.warn(f"{listed(names)}: not <static>, but fixed, as all models of a world; spawn what should move")


def _world_of_models(root: Element) -> Element:
    """Returns a <world> with the models of an SDF file, on Gazebo's ground plane."""
    world = ElementTree.Element("world", name=root.findall("model")[0].get("name", ""))
    ElementTree.SubElement(ElementTree.SubElement(world, "include"), "uri").text = "model://ground_plane"
    world.extend(root.findall("model"))
    return world


def _light(world: Element, all_lights: list[tuple[Element, F64]], with_lamps: bool) -> LightSpec:
    """Returns the light of a world: the first directional light, point and spot lights, ambient light and background.

    Args:
        world: the <world>.
        all_lights: lights, each with T_world_light, (4, 4).
        with_lamps: whether point and spot lights are read.
    """
    default = LightSpec()
    ambient_rgb = numbers(world.findtext("scene/ambient"), (3, 4))
    ambient = default.ambient if ambient_rgb is None else float(np.clip(np.mean(ambient_rgb[:3]), 0.0, 1.0))
    lights = [(light, matrix) for light, matrix in all_lights if _is_on(light)]
    lamps: tuple[PointLight, ...] = ()
    if with_lamps:
        lamps = tuple(filter(None, (_lamp(*light) for light in lights if _type(light[0]) in ("point", "spot"))))
    elif any(_type(light) != "directional" for light, _ in lights):
        # Point and spot lights cast no shadows: each would light the whole house through its walls.
        ambient = max(ambient, default.ambient)
    ambient = max(ambient, _MIN_AMBIENT)
    sun, T_world_sun = next(((light, T) for light, T in lights if _type(light) == "directional"), (None, np.eye(4)))
    direction, strength, color = default.sun_direction, 0.0 if lamps else default.sun, default.sun_color
    if sun is not None:
        values = numbers(sun.findtext("direction"), (3,))
        if values is not None and any(values):
            x, y, z = (T_world_sun[:3, :3] @ values).tolist()
            direction = (x, y, z)
        color, diffuse = _color_and_strength(sun)
        strength = _SUN * diffuse
    rgb = numbers(world.findtext("scene/background"), (3, 4))
    background: Vec3 = default.background
    if rgb is not None:
        r, g, b = (min(max(c, 0.0), 1.0) for c in rgb[:3])
        background = (r, g, b)
    return LightSpec(direction, strength, ambient, background, color, points=lamps)


def _color_and_strength(light: Element) -> tuple[Vec3, float]:
    """Returns the colour of a light, normalised to a maximum channel of 1, and its strength, 0 to 1."""
    rgb = [min(max(c, 0.0), 1.0) for c in (numbers(light.findtext("diffuse"), (3, 4)) or [1.0, 1.0, 1.0])[:3]]
    brightest = max(rgb)
    intensity = numbers(light.findtext("intensity"), (1,)) or [1.0]
    mean = sum(rgb) / 3.0 * max(intensity[0], 0.0)
    return ((rgb[0] / brightest, rgb[1] / brightest, rgb[2] / brightest), mean) if brightest > 0.0 else ((1.0, 1.0, 1.0), 0.0)


def _type(light: Element) -> str:
    """Returns the type of a light: point, spot or directional."""
    return light.get("type", "").strip() or "point"


def _is_on(light: Element) -> bool:
    """Returns whether a light is switched on."""
    return not text_of(light, "light_on") or is_true(light.findtext("light_on"))


def _lamp(light: Element, matrix: F64) -> PointLight | None:
    """Returns a point or spot light at T_world_light, ``matrix`` (4, 4); None if it is off, or a number is invalid."""
    color, strength = _color_and_strength(light)
    parts = [numbers(light.findtext(f"attenuation/{part}"), (1,)) for part in ("constant", "linear", "quadratic")]
    a, b, c = (max(part[0], 0.0) if part else 0.0 for part in parts)
    if strength <= 0.0 or not (a or b or c or not any(parts)):
        return None
    light_range = numbers(light.findtext("attenuation/range"), (1,))
    spot: dict[str, Any] = {}
    if _type(light) == "spot":
        local_direction = numbers(light.findtext("direction"), (3,))
        direction = matrix[:3, :3] @ (
            local_direction if local_direction is not None and any(local_direction) else [0.0, 0.0, -1.0]
        )
        # SDF gives the full angles of the two cones.
        inner, outer = (numbers(light.findtext(f"spot/{name}_angle"), (1,)) for name in ("inner", "outer"))
        half = min(max(outer[0] / 2.0, 0.01), math.pi) if outer else math.pi
        spot = {"direction": tuple(map(float, direction)), "outer_angle": half}
        spot["inner_angle"] = min(max(inner[0] / 2.0, 0.0), half) if inner else half
    return PointLight(
        position=(float(matrix[0, 3]), float(matrix[1, 3]), float(matrix[2, 3])),
        color=color,
        strength=_LAMP * strength,
        range=max(light_range[0], 0.0) if light_range else 10.0,
        attenuation=(a, b, c) if a or b or c else (1.0, 0.0, 0.0),
        **spot,
    )
