"""Reads SDF worlds as Gazebo writes them: models, includes, gravity and a rough idea of the light."""

from __future__ import annotations

from pathlib import Path
from xml.etree import ElementTree

import numpy as np

from gibson_sim.errors import SceneError
from gibson_sim.scenes.builder import SceneBuilder
from gibson_sim.scenes.sdf_model import SdfModels, numbers, parse_xml
from gibson_sim.scenes.spec import LightSpec
from gibson_sim.scenes.uris import UriResolver
from gibson_sim.types import Vec3

Element = ElementTree.Element
_SUN = 0.7
"""Diffuse white of a directional light as strength of ours: Gazebo adds ambient and specular light on top."""


def read_sdf_world(builder: SceneBuilder, path: Path) -> None:
    """Puts everything of a world file into the builder.

    Raises:
        SceneError: the file is no SDF world.
    """
    root = parse_xml(builder, path)
    world = root.find("world") if root.tag in ("sdf", "gazebo") else None
    if world is None:
        raise SceneError(f"{path}: holds no <world>; name a world file or a mesh")
    if len(root.findall("world")) > 1:
        builder.warn(f"{path}: holds several worlds; the first, {world.get('name', '')!r}, is used")
    gravity = numbers(world.findtext("gravity"), (3,)) or numbers(world.findtext("physics/gravity"), (3,))
    if gravity is not None:
        builder.gravity = (gravity[0], gravity[1], gravity[2])
    builder.light = _light(world)
    models = SdfModels(builder, UriResolver(builder.root, path.parent))
    for child in world:
        if child.tag == "model":
            name = child.get("name", "model")
            models.model(child, models.placed(world, child, f"model {name}"), name, path.parent)
        elif child.tag == "include":
            _include(builder, models, world, child, path.parent)
        elif child.tag in ("actor", "population", "road"):
            builder.warn(f"<{child.tag}> {child.get('name', '')!r} is not supported; left out")


def _include(builder: SceneBuilder, models: SdfModels, world: Element, element: Element, base: Path) -> None:
    """Places an include of the world; Gazebo's own sun and ground plane need no files."""
    uri = (element.findtext("uri") or "").strip().rstrip("/")
    known = uri.rpartition("/")[2].lower().replace("_", " ")
    if known == "sun" and models.uris.find(uri, base) is None:
        return
    if known == "ground plane" and models.uris.find(uri, base) is None:
        height = float(models.placed(world, element, "ground_plane")[2, 3])
        builder.ground_z = height if builder.ground_z is None else max(height, builder.ground_z)
        return
    models.include(element, np.eye(4), (element.findtext("name") or "").strip(), base, 0, world)


def _light(world: Element) -> LightSpec:
    """Returns the first directional light, the ambient light and the background of a world; point lights count as ambient."""
    default = LightSpec()
    ambient_rgb = numbers(world.findtext("scene/ambient"), (3, 4))
    ambient = default.ambient if ambient_rgb is None else float(np.clip(np.mean(ambient_rgb[:3]), 0.0, 1.0))
    lights = [light for light in world.iterfind("light") if (light.findtext("diffuse") or "").strip()]
    if any(light.get("type") != "directional" for light in lights):
        ambient = max(ambient, default.ambient)
    # A scene lit by nothing would be a black image.
    ambient = max(ambient, 0.2)
    sun = next((light for light in lights if light.get("type") == "directional"), None)
    direction, strength = default.sun_direction, default.sun
    if sun is not None:
        values = numbers(sun.findtext("direction"), (3,))
        diffuse = numbers(sun.findtext("diffuse"), (3, 4)) or [0.8, 0.8, 0.8]
        if values is not None and any(values):
            direction = (values[0], values[1], values[2])
        strength = _SUN * float(np.clip(np.mean(diffuse[:3]), 0.0, 1.0))
    rgb = numbers(world.findtext("scene/background"), (3, 4))
    background: Vec3 = default.background
    if rgb is not None:
        r, g, b = (min(max(c, 0.0), 1.0) for c in rgb[:3])
        background = (r, g, b)
    return LightSpec(direction, strength, ambient, background)
