"""Tiny scenes for tests, written to a folder."""

from __future__ import annotations

import json
import struct
from pathlib import Path

import numpy as np

ROOM = """\
name: tiny_room
ground_z: 0.0
starts: [{name: middle, xy: [0.0, 0.0], yaw_deg: 0.0}]
objects:
  - {name: front, box: [0.1, 4.0, 2.0], pose: {xyz: [2.0, 0.0, 1.0]}, color: [0.8, 0.2, 0.2], semantic_class: wall}
  - {name: back, box: [0.1, 4.0, 2.0], pose: {xyz: [-2.0, 0.0, 1.0]}, color: [0.2, 0.8, 0.2], semantic_class: wall}
  - {name: left, box: [4.0, 0.1, 2.0], pose: {xyz: [0.0, 2.0, 1.0]}, color: [0.2, 0.2, 0.8], semantic_class: wall}
  - {name: right, box: [4.0, 0.1, 2.0], pose: {xyz: [0.0, -2.0, 1.0]}, color: [0.8, 0.8, 0.2], semantic_class: wall}
"""

HOUSE = """\
floors: [0.0, 3.0]
objects:
  - {name: ground, box: [6, 4, 0.2], pose: {xyz: [3, 2, -0.1]}}
  - {name: upstairs, box: [6, 2, 0.2], pose: {xyz: [3, 1, 2.9]}}
  - {name: wall, box: [0.2, 4, 6], pose: {xyz: [-0.1, 2, 3]}}
starts:
  - {name: below, xy: [3, 3]}
  - {name: above, xyz: [3, 1, 3]}
"""


def write_room(folder: Path, extra: str = "") -> Path:
    """Writes a room of 4 m x 4 m with four walls of different colours; ``extra`` adds lines to its objects."""
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "scene.yaml").write_text(ROOM + extra)
    return folder


def write_house(folder: Path) -> Path:
    """Writes a house with floors at 0 m, 6 m x 4 m, and at 3 m, 6 m x 2 m, and with the starts `below` and `above`."""
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "scene.yaml").write_text(HOUSE)
    return folder


def write_triangle_glb(path: Path) -> Path:
    """Writes a GLB with one triangle."""
    points = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0]], dtype="<f4").tobytes()
    description = {
        "asset": {"version": "2.0"},
        "scene": 0,
        "scenes": [{"nodes": [0]}],
        "nodes": [{"mesh": 0}],
        "meshes": [{"primitives": [{"attributes": {"POSITION": 0}}]}],
        "accessors": [{"bufferView": 0, "componentType": 5126, "count": 3, "type": "VEC3", "min": [0, 0, 0], "max": [1, 1, 0]}],
        "bufferViews": [{"buffer": 0, "byteLength": len(points)}],
        "buffers": [{"byteLength": len(points)}],
    }
    text = json.dumps(description).encode()
    text += b" " * (-len(text) % 4)
    chunks = struct.pack("<II", len(text), 0x4E4F534A) + text + struct.pack("<II", len(points), 0x004E4942) + points
    path.write_bytes(struct.pack("<III", 0x46546C67, 2, 12 + len(chunks)) + chunks)
    return path


def write_square_obj(folder: Path, texture: str) -> Path:
    """Writes an OBJ square of 1 m in the y-z plane whose material names ``texture``."""
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "square.mtl").write_text(f"newmtl m\nKd 0.9 0.1 0.1\nmap_Kd {texture}\n")
    path = folder / "square.obj"
    path.write_text(
        "mtllib square.mtl\nv 0 -0.5 0\nv 0 0.5 0\nv 0 0.5 1\nv 0 -0.5 1\n"
        "vt 0 0\nvt 1 0\nvt 1 1\nvt 0 1\nusemtl m\nf 1/1 2/2 3/3 4/4\n"
    )
    return path
