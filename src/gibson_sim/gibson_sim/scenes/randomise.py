"""Domain randomisation: other lights, colours, textures and materials for the same geometry, all from one seed.

Everything is drawn from PCG64 streams that are named: a visual has its own stream, from the seed and its name (or its class), so that
adding or removing one thing changes no other. docs/scenes.md says what may stand in a file of rules.
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
from gibson_sim.errors import SceneError, TextError
from gibson_sim.formats.textures import IMAGE_SUFFIXES
from gibson_sim.formats.yaml_map import YamlMap
from gibson_sim.geometry.colours import srgb_from_linear
from gibson_sim.quoting import quoted
from gibson_sim.reading import is_folder, read_yaml_file
from gibson_sim.scenes.spec import UNLABELLED, DrawnScene, LightSpec
from gibson_sim.types import Vec3

Range = tuple[float, float]
"""Smallest and largest value; everything between is equally likely."""
EVERY_CLASS = "*"
"""Rules for what no other rules name."""
NOISES = 16
"""How many clouds there are to choose from: each is a picture in GPU memory, while colours and sizes cost nothing."""
_NEUTRAL: Range = (1.0, 1.0)


@dataclass(frozen=True, slots=True)
class TextureRules:
    """How textures are replaced."""

    chance: float = 1.0
    """Part of the visuals that get another texture, 0 to 1."""
    patterns: tuple[PatternKind, ...] = ("noise", "stripes", "checker")
    """Generated textures to choose from; their colours are any."""
    images: tuple[str, ...] = ()
    """Image files to choose from, absolute paths; each is as likely as a pattern."""
    size: Range = (0.25, 1.0)
    """Metres after which a texture repeats; larger ones are as likely as smaller ones on a scale of ratios."""


@dataclass(frozen=True, slots=True)
class ClassRules:
    """What changes in the visuals of a semantic class."""

    hue: Range = (0.0, 0.0)
    """Turns of all colours, 1 = once around."""
    saturation: Range = _NEUTRAL
    """Factors."""
    value: Range = _NEUTRAL
    """Factors."""
    metallic: Range | None = None
    """None = as the material says."""
    roughness: Range | None = None
    texture: TextureRules | None = None
    """None = textures stay."""
    by: Literal["visual", "class"] = "visual"
    """Whether each visual changes for itself, or all of a class alike."""


@dataclass(frozen=True, slots=True)
class LightRules:
    """What changes in the light; None = as the scene says."""

    sun_azimuth: Range | None = None
    """Radians, counter-clockwise from +x: where the sun stands."""
    sun_elevation: Range | None = None
    """Radians above the horizon."""
    sun: Range | None = None
    """Strength, as ``LightSpec.sun``."""
    ambient: Range | None = None
    """Strength, as ``LightSpec.ambient``."""
    temperature_k: Range | None = None
    """Colour of the sun, and of each lamp for itself, kelvin."""
    point_strength: Range | None = None
    """Factor on each lamp's strength."""
    environment_yaw: Range | None = None
    """Radians."""
    environment_strength: Range | None = None
    """Factor."""


@dataclass(frozen=True, slots=True)
class Rules:
    """All rules: what is not named stays as it is."""

    classes: Mapping[str, ClassRules] = field(default_factory=dict)
    """By semantic class; ``unlabelled`` = without a class; ``*`` = all that are not named."""
    light: LightRules = field(default_factory=LightRules)


def randomise(scene: DrawnScene, seed: int, rules: Rules) -> DrawnScene:
    """Returns the scene with another appearance and the same geometry, classes and cameras.

    The same scene, seed and rules give the same result, wherever and whenever.
    """
    visuals = tuple(_visual(visual, seed, rules) for visual in scene.visuals)
    # Who keeps something for each hash must not take one appearance for another.
    digest = hashlib.sha256(f"{scene.content_hash} {seed} {quoted(rules)}".encode()).hexdigest() if scene.content_hash else ""
    return replace(scene, visuals=visuals, light=_light(scene.light, seed, rules.light), content_hash=digest)


def _stream(seed: int, *names: str) -> np.random.Generator:
    """Returns random numbers that depend on nothing but the seed and the names."""
    digest = hashlib.sha256("\0".join((str(seed), *names)).encode()).digest()
    return np.random.Generator(np.random.PCG64(int.from_bytes(digest[:16], "little")))


def _pick(rng: np.random.Generator, limits: Range) -> float:
    return float(rng.uniform(*limits))


def _visual(visual: VisualSpec, seed: int, rules: Rules) -> VisualSpec:
    semantic_class = visual.semantic_class or UNLABELLED
    rule = rules.classes.get(semantic_class, rules.classes.get(EVERY_CLASS))
    if rule is None:
        return visual
    name = visual.name if rule.by == "visual" else ""
    rng = _stream(seed, "look", semantic_class, name)
    # Each draw is made whether it is used or not: a rule that is added must not change what the others give.
    hue, saturation, value = _pick(rng, rule.hue), _pick(rng, rule.saturation), _pick(rng, rule.value)
    metallic, roughness = (_pick(_stream(seed, what, semantic_class, name), limits) if limits else None for what, limits in (
        ("metallic", rule.metallic), ("roughness", rule.roughness)))  # fmt: skip
    pattern = _pattern(_stream(seed, "texture", semantic_class, name), rule.texture)
    old = visual.appearance or Appearance()
    return replace(
        visual,
        appearance=Appearance(
            old.hue + hue,
            old.saturation * saturation,
            old.value * value,
            old.pattern if pattern is None else pattern,
            old.metallic if metallic is None else metallic,
            old.roughness if roughness is None else roughness,
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
    size = math.exp(_pick(rng, (math.log(low), math.log(high))))
    colors = (_color(rng), _color(rng))
    return Pattern(kind, int(rng.integers(NOISES)), colors, size, image)


def _color(rng: np.random.Generator) -> Vec3:
    r, g, b = (float(c) for c in rng.uniform(0.03, 0.97, 3))
    return (r, g, b)


def _light(light: LightSpec, seed: int, rules: LightRules) -> LightSpec:
    def value(what: str, limits: Range | None, default: float) -> float:
        return default if limits is None else _pick(_stream(seed, "light", what), limits)

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


def color_of_temperature(kelvin: float) -> Vec3:
    """Returns the sRGB colour, its brightest channel at 1, of a black body at 1667 to 25000 K.

    Chromaticity by the cubic approximation of the Planckian locus of Kim et al. (2002).
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


_CLASS_KEYS = ("hue", "saturation", "value", "metallic", "roughness", "texture", "by")
_TEXTURE_KEYS = ("chance", "patterns", "images", "size")
_LIGHT_KEYS = (
    "sun_azimuth_deg", "sun_elevation_deg", "sun", "ambient", "temperature_k", "point_strength", "environment_yaw_deg",
    "environment_strength",
)  # fmt: skip
_MAX_STRENGTH = 1000.0


def load_rules(path: Path) -> Rules:
    """Returns the rules in a YAML file.

    Raises:
        SceneError: the file cannot be read, or a key or a value is wrong.
    """
    try:
        document = read_yaml_file(path)
    except OSError as e:
        raise SceneError(f"{path}: cannot be read: {e.strerror or e}") from e
    except TextError as e:
        raise SceneError(f"{path}: {e}").telling(e.public) from e
    top = YamlMap(document if document is not None else {}, str(path), ("classes", "light"))
    classes = top.value("classes", {}) or {}
    if not isinstance(classes, dict):
        raise SceneError(f"{path}: classes is {quoted(classes)}, must be a mapping from class names (or '*') to rules")
    rules = {
        str(name): _class_rules(YamlMap(item or {}, f"{path}: class {quoted(name)}", _CLASS_KEYS), path)
        for name, item in classes.items()
    }
    return Rules(rules, _light_rules(YamlMap(top.value("light", {}) or {}, f"{path}: light", _LIGHT_KEYS)))


def _class_rules(item: YamlMap, path: Path) -> ClassRules:
    default = ClassRules()
    by = item.text("by", "visual")
    if by not in ("visual", "class"):
        raise SceneError(f"{item.where}: by is {quoted(by)}, must be visual or class")
    texture = item.value("texture", None)
    return ClassRules(
        hue=_range(item, "hue", -1.0, 1.0) or default.hue,
        saturation=_range(item, "saturation", 0.0, 10.0) or default.saturation,
        value=_range(item, "value", 0.0, 10.0) or default.value,
        metallic=_range(item, "metallic", 0.0, 1.0),
        roughness=_range(item, "roughness", 0.0, 1.0),
        texture=None if texture is None else _texture_rules(YamlMap(texture, f"{item.where}: texture", _TEXTURE_KEYS), path),
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
    """Returns the images of a folder beside the file of rules, in alphabetical order."""
    if not item.has("images"):
        return ()
    folder = path.parent / item.text("images", "")
    if not is_folder(folder):
        raise SceneError(f"{item.where}: images is {quoted(str(folder))}, must be a folder")
    found = tuple(str(p.resolve()) for p in sorted(folder.iterdir()) if p.suffix.lower() in IMAGE_SUFFIXES)
    if not found:
        raise SceneError(
            f"{item.where}: images is {quoted(str(folder))}, which holds no image; known: {', '.join(IMAGE_SUFFIXES)}"
        )
    return found


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
    """Returns [smallest, largest], or one number as both; None if the key is not there."""
    if not item.has(key):
        return None
    if not isinstance(item.value(key, None), list):
        only = item.number(key, 0.0, low, high)
        return (only, only)
    first, last = item.floats(key, 2, low, high)
    if first > last:
        raise SceneError(f"{item.where}: {key} is [{first:g}, {last:g}], the first must not be greater than the second")
    return (first, last)
