"""Checks that the JSON of a glTF 2.0 file has the kinds of values that the specification requires, so that the reader need not.

Only the properties that the reader uses are checked; all others may hold anything.
"""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from gibson_sim.errors import MeshError
from gibson_sim.formats.light_maps import EXTENSION as LIGHT_MAP
from gibson_sim.quoting import quoted


@dataclass(frozen=True, slots=True)
class _Value:
    """A value that is neither an object nor a list of values of any length."""

    what: str
    """Description of the allowed values, for messages."""
    fits: Callable[[Any], bool]


_Kind = Any
"""A ``_Value``; [kind] = a list of these; {property: kind} = an object, where ``!`` after a name marks a required property."""


def _is_whole(value: Any) -> bool:
    return isinstance(value, int) and not isinstance(value, bool)


def _is_number(value: Any) -> bool:
    return isinstance(value, (int, float)) and not isinstance(value, bool) and -1e300 < value < 1e300


def _one_of(*allowed: Any) -> _Value:
    names = ", ".join(json.dumps(value) for value in allowed)
    return _Value(f"one of {names}", lambda value: not isinstance(value, (bool, list, dict)) and value in allowed)


def _numbers(*lengths: int) -> _Value:
    """Returns the kind of a list of numbers of one of these lengths."""
    return _Value(
        f"a list of {' or '.join(map(str, lengths))} numbers",
        lambda value: isinstance(value, list) and len(value) in lengths and all(map(_is_number, value)),
    )


_COUNT = _Value("a whole number, at least 0", lambda value: _is_whole(value) and 0 <= value < 2**53)
_NUMBER = _Value("a finite number", _is_number)
_AMOUNT = _Value("a finite number, at least 0", lambda value: _is_number(value) and value >= 0)
_TEXT = _Value("text", lambda value: isinstance(value, str))
_FLAG = _Value("true or false", lambda value: isinstance(value, bool))
_COUNTS_BY_NAME = _Value(
    "an object of whole numbers", lambda value: isinstance(value, dict) and all(map(_COUNT.fits, value.values()))
)
_INDEX_TYPES = _one_of(5121, 5123, 5125)

_TRANSFORM = {"offset": _numbers(2), "rotation": _NUMBER, "scale": _numbers(2), "texCoord": _COUNT}
_TEXTURE = {
    "index!": _COUNT, "texCoord": _COUNT, "scale": _NUMBER, "strength": _NUMBER, "extensions": {"KHR_texture_transform": _TRANSFORM},
}  # fmt: skip
_PACKED = {
    "buffer!": _COUNT, "byteOffset": _COUNT, "byteLength!": _COUNT, "byteStride!": _COUNT, "count!": _COUNT, "mode!": _TEXT, "filter": _TEXT,
}  # fmt: skip
_PRIMITIVE = {
    "attributes!": _COUNTS_BY_NAME,
    "indices": _COUNT,
    "material": _COUNT,
    "mode": _one_of(0, 1, 2, 3, 4, 5, 6),
    "targets": [_COUNTS_BY_NAME],
    "extensions": {"KHR_draco_mesh_compression": {"bufferView!": _COUNT, "attributes!": _COUNTS_BY_NAME}},
}
_MATERIAL = {
    "name": _TEXT,
    "pbrMetallicRoughness": {
        "baseColorFactor": _numbers(4), "baseColorTexture": _TEXTURE, "metallicFactor": _NUMBER, "roughnessFactor": _NUMBER,
        "metallicRoughnessTexture": _TEXTURE,
    },
    "normalTexture": _TEXTURE,
    "occlusionTexture": _TEXTURE,
    "emissiveTexture": _TEXTURE,
    "emissiveFactor": _numbers(3),
    "alphaMode": _one_of("OPAQUE", "MASK", "BLEND"),
    "alphaCutoff": _NUMBER,
    "doubleSided": _FLAG,
    "extensions": {
        "KHR_materials_unlit": {},
        "KHR_materials_emissive_strength": {"emissiveStrength": _NUMBER},
        "KHR_materials_pbrSpecularGlossiness": {
            "diffuseFactor": _numbers(4), "diffuseTexture": _TEXTURE, "specularFactor": _numbers(3), "glossinessFactor": _NUMBER,
            "specularGlossinessTexture": _TEXTURE,
        },
        LIGHT_MAP: {**_TEXTURE, "intensity": _AMOUNT},
    },
}  # fmt: skip
_DOCUMENT = {
    "asset!": {"version!": _TEXT, "minVersion": _TEXT},
    "extensionsUsed": [_TEXT],
    "extensionsRequired": [_TEXT],
    "scene": _COUNT,
    "scenes": [{"nodes": [_COUNT]}],
    "nodes": [
        {
            "children": [_COUNT], "mesh": _COUNT, "skin": _COUNT, "matrix": _numbers(16), "rotation": _numbers(4),
            "translation": _numbers(3), "scale": _numbers(3), "weights": [_NUMBER],
            "extensions": {
                "EXT_mesh_gpu_instancing": {"attributes!": _COUNTS_BY_NAME},
                "KHR_node_visibility": {"visible": _FLAG},
            },
        }
    ],
    "meshes": [{"primitives!": [_PRIMITIVE], "weights": [_NUMBER]}],
    "skins": [{"joints!": [_COUNT], "inverseBindMatrices": _COUNT}],
    "accessors": [
        {
            "bufferView": _COUNT, "byteOffset": _COUNT, "componentType!": _one_of(5120, 5121, 5122, 5123, 5125, 5126),
            "normalized": _FLAG, "count!": _COUNT, "type!": _one_of("SCALAR", "VEC2", "VEC3", "VEC4", "MAT2", "MAT3", "MAT4"),
            "sparse": {
                "count!": _COUNT,
                "indices!": {"bufferView!": _COUNT, "byteOffset": _COUNT, "componentType!": _INDEX_TYPES},
                "values!": {"bufferView!": _COUNT, "byteOffset": _COUNT},
            },
        }
    ],
    "bufferViews": [
        {
            "buffer!": _COUNT, "byteOffset": _COUNT, "byteLength!": _COUNT, "byteStride": _COUNT,
            "extensions": {"EXT_meshopt_compression": _PACKED, "KHR_meshopt_compression": _PACKED},
        }
    ],
    "buffers": [{"uri": _TEXT, "byteLength": _COUNT}],
    "materials": [_MATERIAL],
    "textures": [
        {
            "source": _COUNT, "sampler": _COUNT,
            "extensions": {"EXT_texture_webp": {"source!": _COUNT}, "KHR_texture_basisu": {"source!": _COUNT}},
        }
    ],
    "samplers": [
        {
            "magFilter": _one_of(9728, 9729), "minFilter": _one_of(9728, 9729, 9984, 9985, 9986, 9987),
            "wrapS": _one_of(33071, 33648, 10497), "wrapT": _one_of(33071, 33648, 10497),
        }
    ],
    "images": [{"uri": _TEXT, "bufferView": _COUNT, "mimeType": _TEXT}],
    "animations": [
        {
            "channels!": [{"sampler!": _COUNT, "target!": {"node": _COUNT, "path!": _TEXT}}],
            "samplers!": [{"input!": _COUNT, "output!": _COUNT, "interpolation": _TEXT}],
        }
    ],
}  # fmt: skip


def check_document(where: str, document: Any) -> None:
    """Checks the JSON of a glTF file.

    Args:
        where: the file, for messages.
        document: the decoded JSON.

    Raises:
        MeshError: a value has another kind than the specification requires, or a required one is missing; one line.
    """
    _check(where, document, _DOCUMENT, "")


def _check(where: str, value: Any, kind: _Kind, path: str) -> None:
    if isinstance(kind, _Value):
        if not kind.fits(value):
            raise _wrong(where, path, value, kind.what)
    elif isinstance(kind, list):
        if not isinstance(value, list):
            raise _wrong(where, path, value, "a list")
        for number, item in enumerate(value):
            _check(where, item, kind[0], f"{path}[{number}]")
    else:
        if not isinstance(value, dict):
            raise _wrong(where, path, value, "an object")
        for name, inner in kind.items():
            key = name.rstrip("!")
            at = f"{path}.{key}" if path else key
            if key in value:
                _check(where, value[key], inner, at)
            elif name.endswith("!"):
                raise MeshError(f"{where}: {at} is missing; the file is broken, export it again")
        if path and "extensions" in value and not isinstance(value["extensions"], dict):
            raise _wrong(where, f"{path}.extensions", value["extensions"], "an object")


def _wrong(where: str, path: str, value: Any, what: str) -> MeshError:
    subject = path or "the JSON"
    return MeshError(f"{where}: {subject} is {quoted(value, 60)}, must be {what}; the file is broken, export it again")
