"""What is changed: valid descriptions that use most of what may stand in them, and small meshes of every format."""

from __future__ import annotations

import json
import math
import random
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import yaml

from support.gltf import Gltf, png
from support.plys import ply

ROOT = Path(__file__).resolve().parents[2]
ROBOTS = (
    "gibson_bot",
    "gibson_bot_real",
    "gibson_bot_360",
    "gibson_bot_sensors",
    "arm_bot",
    "ackermann_bot",
    "omni_bot",
    "skid_bot",
)
OBJECTS = ("mug", "cabinet_doors", "door_80_left", "table_side", "ball", "vase", "window_casement", "basket", "fridge_body")
MESHES = ("a.glb", "a.gltf", "a.obj", "a.ply", "a.stl", "a.dae")
SIZE = 24
"""Pixels: width and height of cameras."""
CORNERS = [[0.0, 0.0, 0.0], [0.4, 0.0, 0.0], [0.4, 0.4, 0.0], [0.0, 0.4, 0.0], [0.2, 0.2, 0.3]]
FACES = [[0, 2, 1], [0, 3, 2], [0, 1, 4], [1, 2, 4], [2, 3, 4], [3, 0, 4]]
UVS = [[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0], [0.5, 0.5]]


def scene_document() -> dict[str, Any]:
    """Returns a scene.yaml: a room with furniture, meshes, lamps, bodies with joints, rooms and starts."""
    return {
        "name": "fuzzed", "description": "a room", "gravity": 9.81, "ground_z": 0.0, "floor_z": 0.0, "floors": [0.0],
        "rooms": [
            {"name": "hall", "class": "hall", "polygon": [[-2.0, -2.0], [2.0, -2.0], [2.0, 2.0], [-2.0, 2.0]]},
            {"name": "kitchen", "class": "kitchen", "floor": 0, "polygon": [[2.0, -2.0], [4.0, -2.0], [4.0, 2.0], [2.0, 2.0]]},
        ],
        "light": {
            "sun_direction": [0.4, 0.3, -0.85], "sun": 0.55, "sun_color": [1.0, 0.9, 0.8], "shadows": True, "ambient": 0.4,
            "background": [0.5, 0.6, 0.7], "environment": "sky.png", "environment_strength": 0.8, "environment_yaw_deg": 30.0,
            "environment_visible": True,
            "points": [
                {"position": [0.0, 0.0, 2.0], "color": [1.0, 0.9, 0.8], "strength": 2.0, "range": 6.0, "attenuation": [0.0, 0.0, 1.0]},
                {"position": [1.0, 0.0, 2.0], "direction": [0.0, 0.0, -1.0], "inner_deg": 20.0, "outer_deg": 40.0, "strength": 1.0},
            ],
        },
        "starts": [{"name": "middle", "xy": [0.0, 0.0], "yaw_deg": 0.0}, {"name": "other", "xyz": [0.5, 0.5, 0.0], "yaw_deg": 90.0}],
        "objects": [
            {"name": "front", "box": [0.1, 4.0, 2.0], "pose": {"xyz": [2.0, 0.0, 1.0], "rpy_deg": [0.0, 0.0, 0.0]}, "color": [0.8, 0.2, 0.2], "semantic_class": "wall"},
            {"name": "back", "box": [0.1, 4.0, 2.0], "pose": {"xyz": [-2.0, 0.0, 1.0]}, "color": [0.2, 0.8, 0.2, 0.5], "semantic_class": "wall", "metallic": 0.1, "roughness": 0.4},
            {"name": "left", "box": [4.0, 0.1, 2.0], "pose": {"xyz": [0.0, 2.0, 1.0]}, "collision": "none"},
            {"name": "pillar", "cylinder": {"radius": 0.1, "length": 2.0}, "pose": {"xyz": [1.2, -1.2, 1.0]}},
            {"name": "ball", "sphere": 0.2, "pose": {"xyz": [-1.0, -1.0, 0.2]}},
            {"name": "thing", "mesh": "a.glb", "pose": {"xyz": [1.0, 1.0, 0.0], "rpy_deg": [0.0, 0.0, 45.0]}, "scale": 1.5, "collision": "same"},
            {"name": "other", "mesh": "a.obj", "pose": {"xyz": [-1.0, 1.0, 0.0]}, "scale": [1.0, 1.0, 2.0], "up_axis": "z", "unit_m": 1.0, "collision": "a.stl"},
            {"name": "scan", "mesh": "a.ply", "pose": {"xyz": [-1.2, 0.0, 0.0]}, "collision": "simplified"},
        ],
        "bodies": [
            {"name": "cup", "model": "mug", "pose": {"xyz": [0.8, 0.0, 0.3], "rpy_deg": [0.0, 0.0, 90.0]}},
            {"name": "door", "model": "door_80_left", "pose": {"xyz": [-0.5, 1.2, 0.0]}, "joints": {"hinge": 30.0}, "static": True, "semantic_class": "door"},
            {"name": "own", "model": "./thing.urdf", "scale": 0.5, "pose": {"xyz": [0.5, -0.8, 0.3]}},
        ],
    }  # fmt: skip


def robot_document(name: str) -> dict[str, Any]:
    """Returns the robot.yaml of a robot of ours, its URDF beside it, with small cameras that draw more than usual."""
    document: dict[str, Any] = yaml.safe_load((ROOT / "config/robots" / name / "robot.yaml").read_text())
    document["urdf"] = "robot.urdf"
    for camera in document.get("cameras", ()):
        camera.update({key: SIZE for key in ("width", "height") if key in camera})
    return document


def robot_urdf(name: str) -> str:
    """Returns the URDF of a robot of ours; its meshes by whole paths."""
    folder = ROOT / "config/robots" / name
    text = yaml.safe_load((folder / "robot.yaml").read_text())["urdf"]
    path = (folder / text).resolve()
    return path.read_text().replace('filename="', f'filename="{path.parent}/')


def object_urdf(name: str) -> str:
    """Returns the URDF of an object of ours; its meshes by whole paths."""
    folder = ROOT / "scenes/objects" / name
    return (folder / f"{name}.urdf").read_text().replace('filename="', f'filename="{folder}/')


THING = """<robot name="thing"><material name="m"><color rgba="0.2 0.4 0.6 1"/></material>
<link name="base"><inertial><origin xyz="0 0 0.1" rpy="0 0 0"/><mass value="1.5"/>
<inertia ixx="0.01" ixy="0" ixz="0" iyy="0.01" iyz="0" izz="0.01"/></inertial>
<visual><origin xyz="0 0 0" rpy="0 0 0"/><geometry><mesh filename="a.glb" scale="1 1 1"/></geometry><material name="m"/></visual>
<visual><geometry><cylinder radius="0.05" length="0.2"/></geometry></visual>
<collision><origin xyz="0 0 0.05"/><geometry><box size="0.2 0.2 0.1"/></geometry></collision>
<collision><geometry><mesh filename="a.stl"/></geometry></collision>
<contact><lateral_friction value="0.5"/><rolling_friction value="0.001"/></contact></link>
<link name="lid"><inertial><mass value="0.2"/><inertia ixx="0.001" ixy="0" ixz="0" iyy="0.001" iyz="0" izz="0.001"/></inertial>
<visual><geometry><sphere radius="0.08"/></geometry></visual><collision><geometry><sphere radius="0.08"/></geometry></collision></link>
<link name="slider"><inertial><mass value="0.2"/><inertia ixx="0.001" ixy="0" ixz="0" iyy="0.001" iyz="0" izz="0.001"/></inertial>
<visual><geometry><box size="0.05 0.05 0.05"/></geometry></visual></link>
<joint name="hinge" type="revolute"><parent link="base"/><child link="lid"/><origin xyz="0 0 0.2" rpy="0 0 0"/><axis xyz="0 1 0"/>
<limit lower="-1.0" upper="1.0" effort="5" velocity="2"/><dynamics damping="0.1" friction="0.05"/></joint>
<joint name="slide" type="prismatic"><parent link="base"/><child link="slider"/><origin xyz="0.2 0 0.1"/><axis xyz="1 0 0"/>
<limit lower="0" upper="0.2" effort="5" velocity="1"/><mimic joint="hinge" multiplier="0.1" offset="0"/></joint></robot>"""

SDF_MODEL = """<model name="crate"><static>false</static><pose>0.5 0.5 0.2 0 0 0.3</pose>
<link name="body"><pose>0 0 0 0 0 0</pose><inertial><mass>2.0</mass><inertia><ixx>0.02</ixx><iyy>0.02</iyy><izz>0.02</izz></inertia></inertial>
<visual name="v"><geometry><box><size>0.3 0.3 0.3</size></box></geometry><material><diffuse>0.8 0.4 0.1 1</diffuse></material></visual>
<visual name="w"><pose>0 0 0.2 0 0 0</pose><geometry><mesh><uri>a.dae</uri><scale>1 1 1</scale></mesh></geometry></visual>
<collision name="c"><geometry><box><size>0.3 0.3 0.3</size></box></geometry>
<surface><friction><ode><mu>0.6</mu></ode></friction></surface></collision></link>
<link name="arm"><pose>0 0 0.4 0 0 0</pose><inertial><mass>0.4</mass></inertial>
<visual name="v"><geometry><cylinder><radius>0.05</radius><length>0.3</length></cylinder></geometry></visual>
<collision name="c"><geometry><sphere><radius>0.05</radius></sphere></geometry></collision></link>
<joint name="j" type="revolute"><parent>body</parent><child>arm</child><axis><xyz>0 0 1</xyz><limit><lower>-1</lower><upper>1</upper></limit></axis></joint>
</model>"""

SDF_WORLD = f"""<sdf version="1.7"><world name="yard"><gravity>0 0 -9.8</gravity>
<light type="point" name="lamp"><pose>0 0 3 0 0 0</pose><diffuse>1 1 1 1</diffuse><attenuation><range>10</range><linear>0.1</linear></attenuation></light>
<light type="directional" name="sun"><direction>0.2 0.3 -0.9</direction><cast_shadows>true</cast_shadows></light>
<model name="ground"><static>true</static><link name="l"><collision name="c"><geometry><plane><normal>0 0 1</normal><size>10 10</size></plane></geometry></collision>
<visual name="v"><geometry><plane><normal>0 0 1</normal><size>10 10</size></plane></geometry></visual></link></model>
<include><uri>model://chair</uri><name>chair_1</name><pose>1 0 0 0 0 1</pose></include>{SDF_MODEL}</world></sdf>"""

SDF_CHAIR = """<sdf version="1.6"><model name="chair"><static>true</static><link name="l"><visual name="v"><geometry><box><size>0.4 0.4 0.4</size></box></geometry></visual>
<collision name="c"><geometry><box><size>0.4 0.4 0.4</size></box></geometry></collision></link></model></sdf>"""

DIRECTIVES: dict[str, Any] = {
    "directives": [
        {"add_model": {"name": "chair", "file": "package://drake_models/chair.sdf"}},
        {"add_frame": {"name": "place", "X_PF": {"base_frame": "world", "translation": [1.0, 0.5, 0.0], "rotation": {"deg": [0.0, 0.0, 30.0]}}}},
        {"add_weld": {"parent": "place", "child": "chair::l"}},
    ]
}  # fmt: skip


def mesh_files(folder: Path) -> None:
    """Writes a small pyramid in every format, textured where the format has that."""
    folder.mkdir(parents=True, exist_ok=True)
    cv2.imwrite(str(folder / "wood.png"), np.random.default_rng(1).integers(0, 255, (8, 8, 3), dtype=np.uint8))
    sky = np.full((8, 16, 3), (200, 150, 100), dtype=np.uint8)
    cv2.imwrite(str(folder / "sky.png"), sky)
    gltf_document().write(folder / "a.glb")
    (folder / "a.gltf").write_text(gltf_document().text())
    (folder / "a.obj").write_text(obj_text())
    (folder / "a.mtl").write_text(MTL)
    (folder / "a.ply").write_bytes(ply(CORNERS, FACES, [[255, 0, 0], [0, 255, 0], [0, 0, 255], [9, 9, 9], [200, 200, 200]]))
    (folder / "a.stl").write_bytes(stl_bytes())
    (folder / "a.dae").write_text(dae_text())


def gltf_document() -> Gltf:
    """Returns a glTF with two nodes, an image inside and a material that has most of what one may have."""
    made = Gltf()
    made.triangle(np.array(CORNERS)[:, [1, 2, 0]], np.array(FACES).ravel(), uvs=UVS, material=0)
    made.triangle(np.array(CORNERS)[:3, [1, 2, 0]] + 0.1, material=1)
    view = made.view(png((200, 100, 50)))
    made.document.update(
        images=[{"bufferView": view, "mimeType": "image/png"}, {"uri": "wood.png"}],
        samplers=[{"magFilter": 9729, "minFilter": 9987, "wrapS": 10497, "wrapT": 33071}],
        textures=[{"source": 0, "sampler": 0}, {"source": 1}],
        materials=[
            {
                "pbrMetallicRoughness": {"baseColorTexture": {"index": 0, "texCoord": 0}, "metallicFactor": 0.2, "roughnessFactor": 0.7, "baseColorFactor": [1.0, 0.9, 0.8, 1.0]},
                "normalTexture": {"index": 1, "scale": 0.5}, "emissiveFactor": [0.1, 0.0, 0.0], "alphaMode": "MASK", "alphaCutoff": 0.4, "doubleSided": True,
            },
            {"extensions": {"KHR_materials_unlit": {}}, "alphaMode": "BLEND", "pbrMetallicRoughness": {"baseColorFactor": [0.1, 0.2, 0.3, 0.5]}},
        ],
        scenes=[{"nodes": [0, 2]}],
        nodes=[
            {"name": "top", "children": [1], "translation": [0.0, 0.1, 0.0], "rotation": [0.0, 0.3826834, 0.0, 0.9238795], "scale": [1.0, 1.0, 1.0]},
            {"name": "inner", "mesh": 0},
            {"name": "other", "matrix": [1.0, 0.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.1, 0.0, 0.0, 1.0], "mesh": 0, "extras": {"note": "x"}},
        ],
    )  # fmt: skip
    return made


def glb_of(document: dict[str, Any], chunk: bytes) -> bytes:
    """Returns a GLB of a document that need not make sense."""
    made = Gltf()
    made.document, made.chunk = document, chunk
    text = json.dumps(document).encode()
    if len(text) > 2**22:
        return text
    return made.glb() if "buffers" not in document or document["buffers"] in ([], None) else _glb_as_is(document, chunk)


def _glb_as_is(document: dict[str, Any], chunk: bytes) -> bytes:
    made = Gltf()
    made.chunk, made.document = chunk, {}
    head = made.glb()
    text = json.dumps(document).encode()
    text += b" " * (-len(text) % 4)
    body = chunk + b"\0" * (-len(chunk) % 4)
    import struct

    chunks = struct.pack("<II", len(text), 0x4E4F534A) + text + struct.pack("<II", len(body), 0x004E4942) + body
    return head[:8] + struct.pack("<I", 12 + len(chunks)) + chunks


MTL = "newmtl m\nKa 0 0 0\nKd 0.8 0.7 0.6\nKs 0.1 0.1 0.1\nNs 20\nd 1.0\nmap_Kd wood.png\nnewmtl n\nKd 0.1 0.2 0.9\nd 0.5\n"


def obj_text() -> str:
    """Returns an OBJ with texture coordinates, normals, groups and two materials."""
    lines = [
        "mtllib a.mtl",
        *(f"v {x} {y} {z}" for x, y, z in CORNERS),
        *(f"vt {u} {v}" for u, v in UVS),
        "vn 0 0 1",
        "o pyramid",
        "usemtl m",
    ]
    lines += [" ".join(["f", *(f"{k + 1}/{k + 1}/1" for k in face)]) for face in FACES[:3]]
    lines += ["g rest", "usemtl n", "s off", *(" ".join(["f", *(f"{k - 5}" for k in face)]) for face in FACES[3:]), "f 1 2 3 4"]
    return "\n".join(lines) + "\n"


def stl_bytes(*, text: bool = False) -> bytes:
    """Returns an STL, binary or text."""
    corners = np.array(CORNERS, dtype=np.float32)[np.array(FACES)]
    if text:
        rows = ["solid a"]
        for triangle in corners:
            rows += ["facet normal 0 0 1", "outer loop", *(f"vertex {x} {y} {z}" for x, y, z in triangle), "endloop", "endfacet"]
        return ("\n".join([*rows, "endsolid a"]) + "\n").encode()
    table = np.zeros(len(corners), dtype=[("n", "<f4", 3), ("v", "<f4", (3, 3)), ("a", "<u2")])
    table["v"] = corners
    return b"\0" * 80 + len(corners).to_bytes(4, "little") + table.tobytes()


def dae_text() -> str:
    """Returns a COLLADA file with a material, nested nodes, and polygons."""
    points = " ".join(str(c) for corner in CORNERS for c in corner)
    uvs = " ".join(str(c) for uv in UVS for c in uv)
    corners = " ".join(f"{k} {k}" for face in FACES for k in face)
    return f"""<COLLADA version="1.4.1">
<asset><unit name="u" meter="1"/><up_axis>Z_UP</up_axis></asset>
<library_images><image id="i"><init_from>wood.png</init_from></image></library_images>
<library_effects><effect id="e"><profile_COMMON><newparam sid="surface"><surface type="2D"><init_from>i</init_from></surface></newparam>
<newparam sid="sampler"><sampler2D><source>surface</source></sampler2D></newparam>
<technique sid="c"><phong><emission><color>0 0 0 1</color></emission><diffuse><texture texture="sampler" texcoord="UV"/></diffuse>
<transparency><float>1</float></transparency></phong></technique></profile_COMMON></effect></library_effects>
<library_materials><material id="m"><instance_effect url="#e"/></material></library_materials>
<library_geometries><geometry id="g"><mesh>
<source id="p"><float_array id="pa" count="15">{points}</float_array><technique_common><accessor source="#pa" count="5" stride="3"/></technique_common></source>
<source id="t"><float_array id="ta" count="10">{uvs}</float_array><technique_common><accessor source="#ta" count="5" stride="2"/></technique_common></source>
<vertices id="v"><input semantic="POSITION" source="#p"/></vertices>
<triangles count="6" material="s"><input semantic="VERTEX" source="#v" offset="0"/><input semantic="TEXCOORD" source="#t" offset="1" set="0"/><p>{corners}</p></triangles>
<polylist count="1" material="s"><input semantic="VERTEX" source="#v" offset="0"/><input semantic="TEXCOORD" source="#t" offset="1" set="0"/><vcount>4</vcount><p>0 0 1 1 2 2 3 3</p></polylist>
</mesh></geometry></library_geometries>
<library_visual_scenes><visual_scene id="vs"><node><translate>0 0 0.1</translate><rotate>0 0 1 30</rotate><scale>1 1 1</scale>
<node><matrix>1 0 0 0 0 1 0 0 0 0 1 0 0 0 0 1</matrix><instance_geometry url="#g"><bind_material><technique_common>
<instance_material symbol="s" target="#m"/></technique_common></bind_material></instance_geometry></node></node></visual_scene></library_visual_scenes>
<scene><instance_visual_scene url="#vs"/></scene></COLLADA>"""


def yaml_text(value: Any) -> str:
    """Returns a document as YAML in one line, deep ones too."""
    if isinstance(value, dict):
        return "{" + ", ".join(f"{yaml_text(str(k))}: {yaml_text(v)}" for k, v in value.items()) + "}"
    if isinstance(value, list):
        return "[" + ", ".join(yaml_text(v) for v in value) + "]"
    if isinstance(value, float):
        return ".nan" if math.isnan(value) else f"{'-' if value < 0 else ''}.inf" if math.isinf(value) else _float(value)
    return json.dumps(value)


def _float(value: float) -> str:
    text = repr(value)
    return text if "e" not in text or "." in text else text.replace("e", ".0e")


def pick(rng: random.Random, *choices: Any) -> Any:
    """Returns one of several."""
    return rng.choice(choices)
