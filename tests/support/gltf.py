"""Writes small glTF files for tests."""

from __future__ import annotations

import base64
import json
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import ArrayLike

from gibson_sim.formats.glb import glb_bytes

CORNERS = [[1.0, 2.0, 3.0], [4.0, 2.0, 3.0], [1.0, 5.0, 3.0]]
"""A triangle in the axes of glTF (y up), facing +z of the file."""


def png(rgb: tuple[int, int, int]) -> bytes:
    """Returns a PNG of 1 x 1 pixel."""
    ok, data = cv2.imencode(".png", np.array([[rgb[::-1]]], dtype=np.uint8))
    assert ok
    return data.tobytes()


class Gltf:
    """Builds a glTF document with full control over its JSON, also invalid ones."""

    def __init__(self) -> None:
        self.chunk = b""
        self.document: dict[str, Any] = {
            "asset": {"version": "2.0"}, "scene": 0, "scenes": [{"nodes": [0]}], "nodes": [{"mesh": 0}],
            "meshes": [{"primitives": []}], "accessors": [], "bufferViews": [], "buffers": [],
        }  # fmt: skip

    def view(self, data: bytes) -> int:
        """Adds bytes to the buffer and returns the index of their view."""
        self.chunk += b"\0" * (-len(self.chunk) % 4)
        self.document["bufferViews"].append({"buffer": 0, "byteOffset": len(self.chunk), "byteLength": len(data)})
        self.chunk += data
        return len(self.document["bufferViews"]) - 1

    def accessor(self, values: ArrayLike, dtype: str = "<f4") -> int:
        """Adds an accessor of numbers, (N,) or (N, width), and returns its index."""
        array = np.asarray(values, dtype=dtype)
        kind = "SCALAR" if array.ndim == 1 else f"VEC{array.shape[1]}"
        component = {"<f4": 5126, "<u2": 5123, "<u4": 5125}[dtype]
        view = self.view(array.tobytes())
        self.document["accessors"].append({"bufferView": view, "componentType": component, "count": len(array), "type": kind})
        return len(self.document["accessors"]) - 1

    def triangle(self, corners: ArrayLike = CORNERS, indices: ArrayLike | None = None, **more: Any) -> Gltf:
        """Adds a primitive with normals (file frame) to mesh 0; ``uvs`` and ``material`` may be given."""
        attributes = {"POSITION": self.accessor(corners)}
        a, b, c = (np.asarray(p, dtype=float) for p in np.asarray(corners)[:3])
        with np.errstate(invalid="ignore"):
            normal = np.cross(b - a, c - a)
        if np.isfinite(normal).all():
            attributes["NORMAL"] = self.accessor([normal / np.linalg.norm(normal)] * len(np.asarray(corners)))
        if "uvs" in more:
            attributes["TEXCOORD_0"] = self.accessor(more["uvs"])
        primitive: dict[str, Any] = {"attributes": attributes}
        if indices is not None:
            primitive["indices"] = self.accessor(indices, "<u2")
        if "material" in more:
            primitive["material"] = more["material"]
        self.document["meshes"][0]["primitives"].append(primitive)
        return self

    def image_material(self, image: dict[str, Any]) -> int:
        """Adds a material with ``image``, a glTF image object, and returns its index."""
        for key in ("images", "textures", "materials"):
            self.document.setdefault(key, [])
        self.document["images"].append(image)
        self.document["textures"].append({"source": len(self.document["images"]) - 1})
        info = {"index": len(self.document["textures"]) - 1}
        self.document["materials"].append({"pbrMetallicRoughness": {"baseColorTexture": info}})
        return len(self.document["materials"]) - 1

    def glb(self) -> bytes:
        """Returns the binary form."""
        return glb_bytes({**self.document, "buffers": [{"byteLength": len(self.chunk)}]}, self.chunk)

    def text(self) -> str:
        """Returns the text form with its buffer inside."""
        uri = "data:application/octet-stream;base64," + base64.b64encode(self.chunk).decode()
        return json.dumps({**self.document, "buffers": [{"byteLength": len(self.chunk), "uri": uri}]})

    def write(self, path: Path) -> Path:
        """Writes the form of the suffix and returns the path."""
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(self.glb() if path.suffix == ".glb" else self.text().encode())
        return path
