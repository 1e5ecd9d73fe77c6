"""Reads rules of randomisation. docs/scenes.md says what may stand in the file; anything else is an error."""

from __future__ import annotations

import math
from pathlib import Path

from gibson_sim.errors import SceneError, TextError
from gibson_sim.quoting import quoted
from gibson_sim.reading import is_folder, read_yaml_file
from gibson_sim.robots.spec import PATTERN_KINDS
from gibson_sim.scenes.randomise import ClassRules, LightRules, Range, Rules, TextureRules
from gibson_sim.scenes.textures import IMAGE_SUFFIXES
from gibson_sim.scenes.yaml_map import YamlMap

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
