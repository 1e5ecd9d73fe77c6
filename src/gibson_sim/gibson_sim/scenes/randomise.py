"""Domain randomisation: varies lights, colours, textures and materials of the same geometry, from one seed.

Every value is sampled from a named PCG64 stream. Each visual has its own stream, derived from the seed and its name (or its class), so that
adding or removing one visual does not change the others. docs/scenes.md lists the keys of a rules file.
"""

from __future__ import annotations

import hashlib
import math
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Literal

import numpy as np

from gibson_sim.description.shapes import PATTERN_KINDS, Appearance, Pattern, PatternKind, VisualSpec
from gibson_sim.errors import SceneError
from gibson_sim.formats.textures import IMAGE_SUFFIXES
from gibson_sim.formats.yaml_map import YamlMap, read_yaml_map
from gibson_sim.geometry.colours import srgb_from_linear
from gibson_sim.quoting import quoted
from gibson_sim.reading import is_folder
from gibson_sim.scenes.spec import UNLABELLED, DrawnScene, LightSpec
from gibson_sim.types import Vec3

Range = tuple[float, float]
"""Minimum and maximum of a uniform distribution."""
EVERY_CLASS = "*"
"""Key of the rules for all classes without their own rules."""
NOISES = 16
"""Number of noise textures to choose from: each of them takes GPU memory, unlike colours and sizes."""
_NEUTRAL: Range = (1.0, 1.0)
_MAX_STRENGTH = 1000.0
"""Maximum strength of light in rules."""

_CLASS_KEYS = ("hue", "saturation", "value", "metallic", "roughness", "texture", "by")
_TEXTURE_KEYS = ("chance", "patterns", "images", "size")
_LIGHT_KEYS = (
    "sun_azimuth_deg", "sun_elevation_deg", "sun", "ambient", "temperature_k", "point_strength", "environment_yaw_deg",
    "environment_strength",
)  # fmt: skip


@dataclass(frozen=True, slots=True)
class TextureRules:
    """Replacement of textures."""

    chance: float = 1.0
    """Probability that a visual gets another texture, 0 to 1."""
    patterns: tuple[PatternKind, ...] = ("noise", "stripes", "checker")
    """Generated textures to choose from, in random colours."""
    images: tuple[str, ...] = ()
    """Image files to choose from, absolute paths; each has the same probability as a pattern."""
    size: Range = (0.25, 1.0)
    """Period of a texture, metres, log-uniform."""


@dataclass(frozen=True, slots=True)
class ClassRules:
    """Changes to the visuals of a semantic class."""

    hue: Range = (0.0, 0.0)
    """Shift of the hue, 1 = a full circle."""
    saturation: Range = _NEUTRAL
    """Factor on the saturation."""
    value: Range = _NEUTRAL
    """Factor on the value (HSV)."""
    metallic: Range | None = None
    """Metalness, 0 to 1; None = no change."""
    roughness: Range | None = None
    """Roughness, 0 to 1; None = no change."""
    texture: TextureRules | None = None
    """Replacement of textures; None = no change."""
    by: Literal["visual", "class"] = "visual"
    """Whether values are sampled for each visual or once for the whole class."""


@dataclass(frozen=True, slots=True)
class LightRules:
    """Changes to the light; None = no change."""

    sun_azimuth: Range | None = None
    """Direction towards the sun, radians, counter-clockwise from +x of the world."""
    sun_elevation: Range | None = None
    """Elevation of the sun above the horizon, radians."""
    sun: Range | None = None
    """Strength of the sun, as ``LightSpec.sun``."""
    ambient: Range | None = None
    """Strength of the ambient light, as ``LightSpec.ambient``."""
    temperature_k: Range | None = None
    """Colour temperature of the sun, and of each lamp independently, kelvin."""
    point_strength: Range | None = None
    """Factor on each lamp's strength."""
    environment_yaw: Range | None = None
    """Rotation of the environment, as ``LightSpec.environment_yaw``, radians."""
    environment_strength: Range | None = None
    """Factor on the strength of the environment map."""


@dataclass(frozen=True, slots=True)
class Rules:
    """All rules; properties without a rule do not change."""

    classes: Mapping[str, ClassRules] = field(default_factory=dict)
    """Semantic class -> rules; ``unlabelled`` = visuals without a class; ``*`` = all other classes."""
    light: LightRules = field(default_factory=LightRules)


def randomise(scene: DrawnScene, seed: int, rules: Rules) -> DrawnScene:
    """Returns the scene with a randomised appearance and the same geometry, classes and cameras.

    The result is deterministic for a scene, seed and rules, on every machine.
    """
    visuals = tuple(_visual(visual, seed, rules) for visual in scene.visuals)
    # Caches keyed by content hash must not confuse two appearances.
    digest = hashlib.sha256(f"{scene.content_hash} {seed} {quoted(rules)}".encode()).hexdigest() if scene.content_hash else ""
    return replace(scene, visuals=visuals, light=_light(scene.light, seed, rules.light), content_hash=digest)


def load_rules(path: Path) -> Rules:
    """Returns the rules in a YAML file.

    Raises:
        SceneError: the file cannot be read, or a key or a value is invalid.
    """
    top = read_yaml_map(path, ("classes", "light"))
    classes = top.value("classes") or {}
    if not isinstance(classes, dict):
        raise SceneError(f"{path}: classes is {quoted(classes)}, must be a mapping from class names (or '*') to rules")
    rules = {
        str(name): _class_rules(top.within(item or {}, f"class {quoted(name)}", _CLASS_KEYS), path)
        for name, item in classes.items()
    }
    return Rules(rules, _light_rules(top.within(top.value("light") or {}, "light", _LIGHT_KEYS)))


def color_of_temperature(kelvin: float) -> Vec3:
    """Returns the sRGB colour of a black body at 1667 to 25000 K, normalised to a maximum channel of 1.

    The chromaticity is the cubic approximation of the Planckian locus by Kim et al. (2002).
    """
    t = 1e3 / min(max(kelvin, 1667.0), 25000.0)
    if t > 1.0 / 4.0:
        x = ((-0.2661239 * t - 0.2343589) * t + 0.8776956) * t + 0.179910
    else:
        x = ((-3.0258469 * t + 2.1070379) * t + 0.2226347) * t + 0.240390
    if t > 1.0 / 2.222:
        y = ((-1.1063814 * x - 1.34811020) * x + 2.18555832) * x - 0.20219683
    elif t > 1.0 / 4.0:
        y = ((-0.9549476 * x - 1.37418593) * x + 2.09137015) * x - 0.16748867
    else:
        y = ((3.0817580 * x - 5.87338670) * x + 3.75112997) * x - 0.37001483
    xyz = np.array([x / y, 1.0, (1.0 - x - y) / y])
    # IEC 61966-2-1.
    linear = np.array([[3.2406, -1.5372, -0.4986], [-0.9689, 1.8758, 0.0415], [0.0557, -0.2040, 1.0570]]) @ xyz
    r, g, b = srgb_from_linear(linear / linear.max()).tolist()
    return (r, g, b)


def _stream(seed: int, *names: str) -> np.random.Generator:
    """Returns a random generator that depends only on the seed and the names."""
    digest = hashlib.sha256("\0".join((str(seed), *names)).encode()).digest()
    return np.random.Generator(np.random.PCG64(int.from_bytes(digest[:16], "little")))


def _sample(rng: np.random.Generator, limits: Range) -> float:
    return float(rng.uniform(*limits))


def _visual(visual: VisualSpec, seed: int, rules: Rules) -> VisualSpec:
    semantic_class = visual.semantic_class or UNLABELLED
    rule = rules.classes.get(semantic_class, rules.classes.get(EVERY_CLASS))
    if rule is None:
        return visual
    name = visual.name if rule.by == "visual" else ""
    rng = _stream(seed, "look", semantic_class, name)
    # Values without a rule are sampled too, so that adding a rule does not change the other values.
    hue, saturation, value = _sample(rng, rule.hue), _sample(rng, rule.saturation), _sample(rng, rule.value)
    metallic, roughness = (_sample(_stream(seed, what, semantic_class, name), limits) if limits else None for what, limits in (
        ("metallic", rule.metallic), ("roughness", rule.roughness)))  # fmt: skip
    pattern = _pattern(_stream(seed, "texture", semantic_class, name), rule.texture)
    previous = visual.appearance or Appearance()
    return replace(
        visual,
        appearance=Appearance(
            previous.hue + hue,
            previous.saturation * saturation,
            previous.value * value,
            previous.pattern if pattern is None else pattern,
            previous.metallic if metallic is None else metallic,
            previous.roughness if roughness is None else roughness,
        ),
    )


def _pattern(rng: np.random.Generator, rules: TextureRules | None) -> Pattern | None:
    if rules is None or rng.random() >= rules.chance:
        return None
    choices: list[tuple[PatternKind, str]] = [(kind, "") for kind in rules.patterns] + [("image", path) for path in rules.images]
    if not choices:
        return None
    kind, image = choices[int(rng.integers(len(choices)))]
    low, high = rules.size
    size = math.exp(_sample(rng, (math.log(low), math.log(high))))
    colors = (_color(rng), _color(rng))
    return Pattern(kind, int(rng.integers(NOISES)), colors, size, image)


def _color(rng: np.random.Generator) -> Vec3:
    r, g, b = (float(c) for c in rng.uniform(0.03, 0.97, 3))
    return (r, g, b)


def _light(light: LightSpec, seed: int, rules: LightRules) -> LightSpec:
    def value(what: str, limits: Range | None, default: float) -> float:
        return default if limits is None else _sample(_stream(seed, "light", what), limits)

    def color(what: str, default: Vec3) -> Vec3:
        return default if rules.temperature_k is None else color_of_temperature(value(what, rules.temperature_k, 6500.0))

    x, y, z = light.sun_direction
    azimuth = value("sun_azimuth", rules.sun_azimuth, math.atan2(-y, -x))
    elevation = value("sun_elevation", rules.sun_elevation, math.atan2(-z, math.hypot(x, y)))
    direction = light.sun_direction
    if rules.sun_azimuth is not None or rules.sun_elevation is not None:
        flat = math.cos(elevation)
        direction = (-flat * math.cos(azimuth), -flat * math.sin(azimuth), -math.sin(elevation))
    return replace(
        light,
        sun_direction=direction,
        sun=value("sun", rules.sun, light.sun),
        ambient=value("ambient", rules.ambient, light.ambient),
        sun_color=color("sun_color", light.sun_color),
        points=tuple(
            replace(
                point,
                color=color(f"point_color {k}", point.color),
                strength=point.strength * value(f"point_strength {k}", rules.point_strength, 1.0),
            )
            for k, point in enumerate(light.points)
        ),
        environment_yaw=value("environment_yaw", rules.environment_yaw, light.environment_yaw),
        environment_strength=light.environment_strength * value("environment_strength", rules.environment_strength, 1.0),
    )


def _class_rules(item: YamlMap, path: Path) -> ClassRules:
    default = ClassRules()
    by = item.text("by", "visual")
    if by not in ("visual", "class"):
        raise SceneError(f"{item.where}: by is {quoted(by)}, must be visual or class")
    texture = item.value("texture")
    return ClassRules(
        hue=_range(item, "hue", -1.0, 1.0) or default.hue,
        saturation=_range(item, "saturation", 0.0, 10.0) or default.saturation,
        value=_range(item, "value", 0.0, 10.0) or default.value,
        metallic=_range(item, "metallic", 0.0, 1.0),
        roughness=_range(item, "roughness", 0.0, 1.0),
        texture=None if texture is None else _texture_rules(item.within(texture, "texture", _TEXTURE_KEYS), path),
        by="visual" if by == "visual" else "class",
    )


def _texture_rules(item: YamlMap, path: Path) -> TextureRules:
    default = TextureRules()
    images = _images(item, path)
    generated = [kind for kind in PATTERN_KINDS if kind != "image"]
    names = item.items("patterns") if item.has("patterns") else () if images else default.patterns
    for name in names:
        if name not in generated:
            raise SceneError(f"{item.where}: patterns has {quoted(name)}, must be of {', '.join(generated)}")
    if not names and not images:
        raise SceneError(f"{item.where}: names neither patterns nor images; give one, or leave texture out")
    return TextureRules(
        chance=item.number("chance", default.chance, 0.0, 1.0),
        patterns=tuple(kind for kind in PATTERN_KINDS if kind in names),
        images=images,
        size=_range(item, "size", 1e-3, 1e3) or default.size,
    )


def _images(item: YamlMap, path: Path) -> tuple[str, ...]:
    """Returns the image files in the folder ``images``, a path relative to the rules file, in alphabetical order."""
    if not item.has("images"):
        return ()
    folder = path.parent / item.text("images", "")
    if not is_folder(folder):
        raise SceneError(f"{item.where}: images is {quoted(str(folder))}, must be a folder")
    files = tuple(str(p.resolve()) for p in sorted(folder.iterdir()) if p.suffix.lower() in IMAGE_SUFFIXES)
    if not files:
        raise SceneError(
            f"{item.where}: images is {quoted(str(folder))}, which holds no image; known: {', '.join(IMAGE_SUFFIXES)}"
        )
    return files


def _light_rules(item: YamlMap) -> LightRules:
    return LightRules(
        sun_azimuth=_degrees(_range(item, "sun_azimuth_deg", -360.0, 360.0)),
        sun_elevation=_degrees(_range(item, "sun_elevation_deg", -90.0, 90.0)),
        sun=_range(item, "sun", 0.0, _MAX_STRENGTH),
        ambient=_range(item, "ambient", 0.0, _MAX_STRENGTH),
        temperature_k=_range(item, "temperature_k", 1667.0, 25000.0),
        point_strength=_range(item, "point_strength", 0.0, _MAX_STRENGTH),
        environment_yaw=_degrees(_range(item, "environment_yaw_deg", -360.0, 360.0)),
        environment_strength=_range(item, "environment_strength", 0.0, _MAX_STRENGTH),
    )


def _degrees(limits: Range | None) -> Range | None:
    return None if limits is None else (math.radians(limits[0]), math.radians(limits[1]))


def _range(item: YamlMap, key: str, low: float, high: float) -> Range | None:
    """Returns the minimum and maximum in the value of a key, which may be a single number; None = the key has no value."""
    if not item.has(key):
        return None
    if not isinstance(item.value(key), list):
        number = item.number(key, low=low, high=high)
        return (number, number)
    first, last = item.floats(key, 2, low, high)
    if first > last:
        raise SceneError(f"{item.where}: {key} is [{first:g}, {last:g}], the first must not be greater than the second")
    return (first, last)
