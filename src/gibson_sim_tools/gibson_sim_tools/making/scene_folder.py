"""Writes a finished scene from a bake: meshes, tiles, light maps, scene.yaml, licence. Does not need Blender.

Meshes are small binary glTF 2.0 files with quantised positions and external textures: base colours that repeat, and light maps with coordinates of
their own (``GIBSON_light_map``). The panorama outside the windows (sky, trees, meadow) is drawn as a camera exposed for the room sees it.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import ArrayLike, NDArray

from gibson_sim.errors import SceneError
from gibson_sim.formats.glb import Z_UP_TO_Y_UP, GlbBuilder
from gibson_sim.geometry.colours import linear_from_srgb, srgb_from_linear
from gibson_sim.picture_files import write_picture
from gibson_sim.scenes.scene_yaml import write_scene_yaml
from gibson_sim.writing import write_file
from gibson_sim_tools.making.blender.shapes import WHITE
from gibson_sim_tools.making.building import Building, Quality
from gibson_sim_tools.making.light_maps import (
    dilate_charts,
    fill_hidden,
    sample_light,
    smooth_small_charts,
    stitch_seams,
    write_light,
)
from gibson_sim_tools.making.pictures import ASSETS, SURROUNDINGS, write_uniform_surroundings
from gibson_sim_tools.making.pixels import F32, exposure_factors, tone_map
from gibson_sim_tools.making.tiles import Tile, TileName, draw_tile, factors_of, tiles_of

OUTSIDE = "outside.jpg"
MAX_SCENE_BYTES = 12_000_000
"""Maximum total size of a scene folder."""
_GLASS_ALPHA = 0.16
_MIRROR_REFLECTANCE = 0.88
"""Reflectance of mirrors."""
_ROOM_CLASSES = {"living": "living_room", "meeting": "meeting_room"}
"""Room class for each room kind of plans that has another name."""
_LICENSE = """CC0 1.0 Universal (Public Domain Dedication)

To the extent possible under law, the makers of this scene have waived all copyright and related or neighbouring rights to all files in this
folder. The text of the dedication: https://creativecommons.org/publicdomain/zero/1.0/legalcode

The scene was made by `{command}`; nothing in it was taken from elsewhere.
"""
F64 = NDArray[np.float64]
_MAX_QUANTISED = 65535
_SAMPLES = 100_000
"""Number of points on surfaces whose lit colours determine the exposure."""
_MAX_RADIANCE = 16.0
"""Largest radiance of white in a light map, in units of the exposure: brighter surfaces are white."""
_WIDTH, _HEIGHT = 2048, 1024
"""Size of the panorama, pixels."""


def write_scene_folder(building: Building, quality: Quality, work: Path, folder: Path, command: str) -> float:
    """Writes all files of a scene except those that need a renderer (thumbnail, surroundings).

    Args:
        building: the plan.
        quality: quality of the bake.
        work: output folder of ``gibson_sim_tools.making.blender``.
        folder: folder of the scene; existing files are replaced.
        command: command line recorded in scene.yaml.

    Returns:
        The median brightness of a white surface in the scene, linear.

    Raises:
        SceneError: a light map was not baked, or the scene is too large.
    """
    mesh = _load_arrays(work / "mesh.npz")
    assets = folder / ASSETS
    assets.mkdir(parents=True, exist_ok=True)
    for old in [file for kind in ("glb", "jpg", "png", "hdr") for file in assets.glob(f"*.{kind}")]:
        old.unlink()
    lights = _load_lights(mesh, work)
    surfaces = _Surfaces(mesh)
    white, intensity = _write_light_maps(mesh, surfaces, lights, work, assets, quality)
    for name, tile in zip(surfaces.names, surfaces.tiles, strict=True):
        _write_image(assets / f"{name.file}.jpg", tile.pixels[::-1], quality.jpeg)
    write_uniform_surroundings(assets / SURROUNDINGS, white)
    _write_image(assets / OUTSIDE, outside_panorama(building.seed), quality.jpeg)
    objects = _write_objects(mesh, surfaces, intensity, assets)
    write_scene_yaml(folder, _description(building, objects, command), f"Made by: {command}", width=160)
    write_file(folder / "LICENSE", _LICENSE.format(command=command))
    size = sum(f.stat().st_size for f in folder.rglob("*") if f.is_file())
    if size > MAX_SCENE_BYTES:
        raise SceneError(f"{folder}: has {size / 1e6:.1f} MB, more than {MAX_SCENE_BYTES / 1e6:.0f}; choose a lower quality")
    return white


def _load_arrays(path: Path) -> dict[str, NDArray[Any]]:
    try:
        with np.load(path) as file:
            return {name: file[name] for name in file.files}
    except (OSError, ValueError) as e:
        raise SceneError(f"{path}: cannot be read: {e}; bake the scene again") from e


class _Surfaces:
    """Tiles and colours of the triangles of a bake."""

    def __init__(self, mesh: dict[str, NDArray[Any]]) -> None:
        self.names: list[TileName]
        self.names, self.tile = tiles_of(mesh["patterns"].tolist(), mesh["pattern"], mesh["tint"], mesh["pattern_coords"])
        """Index of the tile of each triangle, (F,); -1 = none."""
        self.tiles: list[Tile] = [draw_tile(name) for name in self.names]
        self.factor = np.asarray(linear_from_srgb(mesh["tint"]))
        """Linear colour of each triangle, relative to its tile, (F, 3)."""
        self.color = self.factor.copy()
        """Mean linear colour of each triangle, (F, 3)."""
        self.uv = np.zeros((len(self.tile), 3, 2))
        """Coordinates of the corners in the tile, (F, 3, 2), from the lower left."""
        for k, (name, tile) in enumerate(zip(self.names, self.tiles, strict=True)):
            rows = np.flatnonzero(self.tile == k)
            self.factor[rows] = factors_of(tile, name.pattern, mesh["tint"][rows])
            self.color[rows] = self.factor[rows] * tile.mean
            self.uv[rows] = tile.coords(mesh["pattern_coords"][rows])


def _load_lights(mesh: dict[str, NDArray[Any]], work: Path) -> list[F32]:
    """Returns the light maps of a bake, (H, W, 4), linear, row 0 at the bottom."""
    lights = []
    for k in range(int(mesh["atlas"].max()) + 1):
        try:
            lights.append(np.load(work / f"light_{k}.npy"))
        except (OSError, ValueError) as e:
            raise SceneError(f"{work}: light map {k} was not baked: {e}; run the generator again, finished ones are kept") from e
    return lights


def _write_light_maps(
    mesh: dict[str, NDArray[Any]], surfaces: _Surfaces, lights: list[F32], work: Path, assets: Path, quality: Quality
) -> tuple[float, float]:
    """Writes light maps and mirrors; returns the median brightness of a lit white surface, linear, and the radiance of the largest code."""
    charts = [mesh["charts"][mesh["charts"][:, 0] == k, 1:] for k in range(len(lights))]
    for light, own_charts in zip(lights, charts, strict=True):
        smooth_small_charts(light, own_charts)
        fill_hidden(light)
    stitch_seams(lights, *(mesh[name] for name in ("corners", "atlas", "uv", "charts")))
    for light, own_charts in zip(lights, charts, strict=True):
        dilate_charts(light, own_charts)
    light_on_samples, colors = _lit_samples(mesh, surfaces, lights)
    exposure = exposure_factors([light_on_samples * colors])
    brightest = max(float((light[..., :3] * exposure).max()) for light in lights)
    intensity = round(min(brightest, _MAX_RADIANCE), 4)
    for k, light in enumerate(lights):
        write_light(assets / f"light_{k}.png", light[..., :3] * exposure, intensity)
    for number, image in enumerate(_mirrors(work)):
        _write_image(assets / f"mirror_{number}.jpg", tone_map(_MIRROR_REFLECTANCE * image * exposure)[::-1], quality.jpeg)
    lit = linear_from_srgb(tone_map(light_on_samples * colors * exposure) / 255)
    return float(np.median(_white_brightness(lit, colors))), intensity


def _lit_samples(mesh: dict[str, NDArray[Any]], surfaces: _Surfaces, lights: Sequence[F32]) -> tuple[F32, F32]:
    """Returns light and colour, linear, (N, 3) each, of random points, as many on each triangle as it has texels in the light maps."""
    rng = np.random.default_rng(0)
    a, b, c = (mesh["uv"][:, k] for k in range(3))
    texels = np.abs((b - a)[:, 0] * (c - a)[:, 1] - (b - a)[:, 1] * (c - a)[:, 0]) * (mesh["atlas"] >= 0)
    rows = rng.choice(len(texels), _SAMPLES, p=texels / texels.sum())
    weights = rng.dirichlet(np.ones(3), _SAMPLES)
    uv = np.einsum("nk,nkc->nc", weights, mesh["uv"][rows])
    light = np.zeros((_SAMPLES, 3), dtype=np.float32)
    for k, image in enumerate(lights):
        chosen = mesh["atlas"][rows] == k
        light[chosen] = sample_light(image, uv[chosen])
    return light, surfaces.color[rows].astype(np.float32)


def _white_brightness(lit: NDArray[np.float64], colors: F32) -> NDArray[np.float64]:
    """Returns the brightness that white would have, at the pixels (N, 3) that are neither dark nor in shadow."""
    reflectance, brightness = colors.mean(axis=1), lit.mean(axis=1)
    return np.asarray((brightness / np.maximum(reflectance, 1e-6))[(reflectance > 0.2) & (brightness > 0.05)])


def _write_image(path: Path, rgb: NDArray[np.uint8], jpeg: int) -> None:
    sampling = (cv2.IMWRITE_JPEG_SAMPLING_FACTOR, cv2.IMWRITE_JPEG_SAMPLING_FACTOR_444)
    write_picture(path, cv2.cvtColor(np.ascontiguousarray(rgb), cv2.COLOR_RGB2BGR), (cv2.IMWRITE_JPEG_QUALITY, jpeg, *sampling))


def _mirrors(work: Path) -> Iterable[F32]:
    """Yields the reflection of each mirror, (h, w, 3), linear, row 0 at the bottom."""
    content = _load_arrays(work / "mirrors.npz")
    for number in range(len(content)):
        yield content[f"image_{number}"].astype(np.float32)


def _write_objects(mesh: dict[str, NDArray[Any]], surfaces: _Surfaces, intensity: float, assets: Path) -> list[dict[str, Any]]:
    """Writes the mesh and the collision shapes of each object; returns the entries for scene.yaml."""
    objects = []
    for number, name in enumerate(mesh["names"].tolist()):
        rows = np.flatnonzero(mesh["owner"] == number)
        if not mesh["exported"][number] or not len(rows):
            continue
        write_glb(assets / f"{name}.glb", list(_patches(mesh, surfaces, intensity, rows)))
        boxes = mesh["boxes"][mesh["box_owner"] == number]
        entry: dict[str, Any] = {"name": name, "mesh": f"{ASSETS}/{name}.glb", "semantic_class": mesh["classes"].tolist()[number]}
        if len(boxes):
            write_boxes(assets / f"{name}_collision.glb", boxes)
            entry["collision"] = f"{ASSETS}/{name}_collision.glb"
        else:
            entry["collision"] = "none"
        objects.append(entry)
    return objects


def _patches(
    mesh: dict[str, NDArray[Any]], surfaces: _Surfaces, intensity: float, object_rows: NDArray[np.int64]
) -> Iterable[Patch]:
    patterns = mesh["patterns"].tolist()
    keys = np.column_stack([mesh["atlas"][object_rows], surfaces.tile[object_rows]])
    for atlas, tile in np.unique(keys, axis=0).tolist():
        rows = object_rows[(keys == (atlas, tile)).all(axis=1)]
        if atlas >= 0:
            texture = f"{surfaces.names[tile].file}.jpg" if tile >= 0 else ""
            factor = surfaces.factor[rows]
            is_uniform = bool((factor == factor[0]).all())
            red, green, blue = srgb_from_linear(factor[0]).tolist() if is_uniform else WHITE
            material = BakedMaterial(texture, (red, green, blue, 1.0), f"light_{atlas}.png", intensity)
            yield Patch(
                material,
                mesh["corners"][rows].astype(float),
                surfaces.uv[rows] if texture else None,
                mesh["uv"][rows],
                None if is_uniform else factor,
            )
            continue
        appearances = np.column_stack([mesh["tint"][rows], mesh["pattern"][rows]])
        for appearance in np.unique(appearances, axis=0):
            plain_rows = rows[(appearances == appearance).all(axis=1)]
            corners = mesh["corners"][plain_rows].astype(float)
            pattern = patterns[int(appearance[3])]
            if pattern == "mirror":
                yield from _mirror_patches(mesh, plain_rows, patterns.index("mirror"))
                continue
            alpha = _GLASS_ALPHA if pattern == "glass" else 1.0
            yield Patch(BakedMaterial(color=(float(appearance[0]), float(appearance[1]), float(appearance[2]), alpha)), corners)


def _mirror_patches(mesh: dict[str, NDArray[Any]], rows: NDArray[np.int64], pattern: int) -> Iterable[Patch]:
    """Yields a patch for each mirror, which consists of two triangles that start at the lower left."""
    numbers = np.flatnonzero(mesh["pattern"] == pattern).tolist()
    square = np.array([[(0, 0), (1, 0), (1, 1)], [(0, 0), (1, 1), (0, 1)]], dtype=float)
    for first, second in rows.reshape(-1, 2).tolist():
        material = BakedMaterial(f"mirror_{numbers.index(first) // 2}.jpg")
        yield Patch(material, mesh["corners"][[first, second]].astype(float), square)


def _description(building: Building, objects: list[dict[str, Any]], command: str) -> dict[str, Any]:
    """Returns the content of scene.yaml."""
    rooms = [room for storey in building.storeys for room in storey.rooms]
    article_and_kind = {"flat": "A flat", "house": "A house", "office": "An office", "shop": "A shop"}[building.kind]
    starts = [
        {"name": s.name, "xyz": [round(v, 3) for v in s.position], "yaw_deg": round(math.degrees(s.yaw), 1)}
        for s in building.starts
    ]
    document: dict[str, Any] = {
        "name": building.name,
        "description": f"{article_and_kind} of {len(rooms)} rooms, its light baked in",
        "ground_z": building.storeys[0].floor_z,
        "floor_z": building.storeys[0].floor_z,
        "floors": [storey.floor_z for storey in building.storeys],
        "rooms": rooms_document(building),
        "light": {
            "sun_direction": list(building.sun_direction), "sun": 0.0, "ambient": 0.0, "background": [0.93, 0.96, 0.98],
            "environment": f"{ASSETS}/{SURROUNDINGS}", "backdrop": f"{ASSETS}/{OUTSIDE}",
        },
        "starts": starts,
        "objects": objects,
    }  # fmt: skip
    if building.bodies:
        document["bodies"] = [_body(body) for body in building.bodies]
    return document


def rooms_document(building: Building) -> list[dict[str, Any]]:
    """Returns the content of ``rooms`` in scene.yaml; polygons follow the centre lines of the walls."""
    return [
        {
            "name": room.name,
            "class": _ROOM_CLASSES.get(room.kind, room.kind),
            "floor": number,
            "polygon": [[round(float(x), 3), round(float(y), 3)] for x, y in room.corners],
        }
        for number, storey in enumerate(building.storeys)
        for room in storey.rooms
    ]


def _body(body: Any) -> dict[str, Any]:
    entry: dict[str, Any] = {
        "name": body.name,
        "model": body.model,
        "pose": {"xyz": [round(v, 4) for v in body.position], "rpy_deg": [0.0, 0.0, round(math.degrees(body.yaw), 3)]},
    }
    if body.joints:
        # Revolute joints in degrees, prismatic joints in metres.
        slides = ("slide", "drawer")
        entry["joints"] = {k: round(v if k.startswith(slides) else math.degrees(v), 3) for k, v in body.joints.items()}
    return entry


@dataclass(frozen=True)
class BakedMaterial:
    """A material with baked light."""

    texture: str = ""
    """File name, beside the mesh, of the base colour, which is repeated; empty = plain colour."""
    color: tuple[float, float, float, float] = (1.0, 1.0, 1.0, 1.0)
    """sRGB colour and opacity, 0 to 1."""
    light: str = ""
    """File name of the light map; empty = the colours include the light."""
    intensity: float = 1.0
    """Radiance of the largest code in the light map."""


@dataclass(frozen=True)
class Patch:
    """Triangles of one material."""

    material: BakedMaterial
    corners: F64
    """Corners, (F, 3, 3), m, z up."""
    uv: F64 | None = None
    """Texture coordinates, (F, 3, 2), from the lower left; None without a texture."""
    light_uv: F64 | None = None
    """Coordinates in the light map, (F, 3, 2), 0 to 1 from the lower left; None without a light map."""
    factor: F64 | None = None
    """Linear colour by which texture and colour of the material are multiplied, (F, 3), 0 to 1; None = 1."""


def write_glb(path: Path, patches: Sequence[Patch]) -> None:
    """Writes an object; corners with equal values of all attributes share a vertex."""
    all_corners = np.concatenate([p.corners.reshape(-1, 3) for p in patches])
    low, size = all_corners.min(axis=0), np.maximum(np.ptp(all_corners, axis=0), 1e-4)
    builder = GlbBuilder()
    builder.require("KHR_mesh_quantization")
    for patch in patches:
        columns: dict[str, NDArray[Any]] = {
            "POSITION": np.round((patch.corners.reshape(-1, 3) - low) / size * _MAX_QUANTISED).astype(np.uint16)
        }
        if patch.uv is not None:
            columns["TEXCOORD_0"] = _from_upper_left(patch.uv).astype(np.float32)
        if patch.light_uv is not None:
            columns["TEXCOORD_1"] = _codes(_from_upper_left(patch.light_uv))
        if patch.factor is not None:
            columns["COLOR_0"] = _codes(np.repeat(patch.factor, 3, axis=0))
        table = np.concatenate([values.astype(np.float64) for values in columns.values()], axis=1)
        _, first, index = np.unique(table, axis=0, return_index=True, return_inverse=True)
        triangles = np.asarray(index).reshape(-1, 3)
        triangles = triangles[(triangles != np.roll(triangles, 1, axis=1)).all(axis=1)]
        attributes = {
            name: builder.attribute(
                values[first],
                values.dtype.str[1:],
                normalized=values.dtype == np.uint16 and name != "POSITION",
                bounds=name == "POSITION",
            )
            for name, values in columns.items()
        }
        indices = builder.indices(triangles, "u2" if not len(triangles) or triangles.max() < _MAX_QUANTISED else "u4")
        builder.primitive(attributes, indices, _material(patch.material, builder))
    # Quantised positions range from 0 to 65535 along the axes of the z-up frame.
    T_zup_quantised = np.block([[np.diag(size / _MAX_QUANTISED), low[:, None]], [np.zeros((1, 3)), np.ones((1, 1))]])
    write_file(path, builder.to_bytes(path.stem, Z_UP_TO_Y_UP @ T_zup_quantised), durable=False)


def _from_upper_left(uv: F64) -> F64:
    """Converts texture coordinates, (F, 3, 2), to those of glTF, (3 F, 2)."""
    return np.asarray(uv.reshape(-1, 2) * [1.0, -1.0] + [0.0, 1.0])


def _codes(values: F64) -> NDArray[np.uint16]:
    """Returns values from 0 to 1 as normalised integers."""
    return np.round(np.clip(values, 0, 1) * _MAX_QUANTISED).astype(np.uint16)


def write_boxes(path: Path, boxes: ArrayLike) -> None:
    """Writes boxes, lower and upper corners (B, 2, 3), m, as one collision mesh."""
    pairs = np.asarray(boxes, dtype=float).reshape(-1, 2, 3)
    unit_corners = np.array([[x, y, z] for x in (0, 1) for y in (0, 1) for z in (0, 1)])
    quads = [(4, 6, 7, 5), (0, 1, 3, 2), (2, 3, 7, 6), (0, 4, 5, 1), (1, 5, 7, 3), (0, 2, 6, 4)]
    triangles = np.array([t for q in quads for t in ((q[0], q[1], q[2]), (q[0], q[2], q[3]))])
    corners = np.where(unit_corners[None], pairs[:, 1:2], pairs[:, :1])
    write_glb(path, [Patch(BakedMaterial(), corners[:, triangles].reshape(-1, 3, 3))])


def _material(material: BakedMaterial, builder: GlbBuilder) -> int:
    pbr: dict[str, Any] = {
        "baseColorFactor": [*linear_from_srgb(material.color[:3]).tolist(), material.color[3]],
        "metallicFactor": 0.0,
        "roughnessFactor": 1.0,
    }
    if material.texture:
        pbr["baseColorTexture"] = {"index": builder.texture_file(material.texture)}
    gltf_material: dict[str, Any] = {"pbrMetallicRoughness": pbr, "doubleSided": True, "extensions": {"KHR_materials_unlit": {}}}
    if material.color[3] < 1.0:
        gltf_material["alphaMode"] = "BLEND"
    if material.light:
        return builder.light_mapped_material(gltf_material, builder.texture_file(material.light), material.intensity)
    return builder.material(gltf_material)


def outside_panorama(seed: int) -> NDArray[np.uint8]:
    """Returns an equirectangular image, (1024, 2048, 3) uint8 sRGB; row 0 is the zenith."""
    rng = np.random.default_rng((seed, 21))
    elevation = (0.5 - (np.arange(_HEIGHT) + 0.5) / _HEIGHT) * 180.0
    sky_share = np.clip(elevation / 70.0, 0, 1)[:, None, None] ** 0.7
    image = (1 - sky_share) * np.array([0.955, 0.97, 0.985]) + sky_share * np.array([0.70, 0.83, 0.96])
    image = np.repeat(image, _WIDTH, axis=1)
    clouds = np.clip((_noise(rng, 5, 1.0) - 0.48) * 3.2, 0, 0.8) * np.clip(elevation / 20.0, 0, 1)[:, None]
    image += clouds[..., None] * (np.array([0.99, 0.99, 0.99]) - image)
    meadow = np.array([0.68, 0.74, 0.56]) * (0.82 + 0.36 * _noise(rng, 9, 0.9))[..., None]
    ground_share = np.clip(-elevation / 1.2, 0, 1)[:, None, None]
    image += ground_share * (meadow - image)
    picture = np.ascontiguousarray(image, dtype=np.float32)
    for haze, top, tone in ((0.6, 15.0, (0.50, 0.60, 0.52)), (0.35, 11.0, (0.36, 0.47, 0.28)), (0.12, 6.0, (0.30, 0.42, 0.20))):
        _trees(picture, rng, top * (0.35 + 0.9 * _outline(rng)), tone, haze)
    image = cv2.GaussianBlur(picture, (0, 0), 1.6)
    # The exposure is for the room, so the outside is overexposed.
    return np.asarray(np.clip(np.round((1 - (1 - np.clip(image, 0, 1)) * 0.62) * 255), 0, 255), dtype=np.uint8)


def _noise(rng: np.random.Generator, octaves: int, falloff: float) -> F64:
    """Returns smooth noise around 0.5, (_HEIGHT, _WIDTH), seamless across the left and right edges."""
    result, total = np.zeros((_HEIGHT, _WIDTH), dtype=np.float32), 0.0
    for k in range(octaves):
        rows, columns, weight = 2 ** (k + 1), 2 ** (k + 2), falloff**k
        grid = rng.random((rows, columns), dtype=np.float32)
        wrapped = np.concatenate([grid[:, -2:], grid, grid[:, :2]], axis=1)
        step = _WIDTH // columns
        enlarged = cv2.resize(wrapped, (_WIDTH + 4 * step, _HEIGHT), interpolation=cv2.INTER_CUBIC)
        result += weight * enlarged[:, 2 * step : 2 * step + _WIDTH]
        total += weight
    return np.asarray(result / total, dtype=np.float64)


def _trees(
    picture: NDArray[np.float32], rng: np.random.Generator, top: F64, tone: tuple[float, float, float], haze: float
) -> None:
    """Draws a line of trees, their crowns as clusters of leaves lit from above. ``top``: elevation, degrees, (_WIDTH,)."""
    per_degree = _HEIGHT / 180.0
    for x in np.sort(rng.uniform(0, _WIDTH, 150)):
        height = float(top[int(x)]) * rng.uniform(0.7, 1.1) * per_degree
        color = np.array(tone) * rng.uniform(0.75, 1.25)
        ground = _HEIGHT / 2 + per_degree * (0.6 + 1.2 * (1 - haze))
        for _ in range(50):
            up, sideways = rng.uniform(0, 1), rng.normal(0, 0.28)
            center = (round(x + sideways * height * (1.1 - up) * 1.4), round(ground - up * height))
            light = (0.55 + 0.75 * up + rng.uniform(-0.2, 0.2)) * color
            color_in_haze = light + haze * (np.array([0.90, 0.93, 0.95]) - light)
            radius = max(2, round(rng.uniform(0.06, 0.15) * height))
            for turn in (-_WIDTH, 0, _WIDTH):  # wrap around the left and right edges
                cv2.circle(picture, (center[0] + turn, center[1]), radius, color_in_haze.tolist(), -1, cv2.LINE_AA)


def _outline(rng: np.random.Generator) -> F64:
    """Returns the relative height of a line of trees in each column, (_WIDTH,), 0 to 1."""
    angle, heights = np.linspace(0, 2 * np.pi, _WIDTH, endpoint=False), np.full(_WIDTH, 0.5)
    for k in (2, 3, 5, 9, 17, 31, 53, 97, 160):
        heights += 0.32 / k**0.55 * np.sin(k * angle + rng.uniform(0, 6.3))
    return np.asarray(np.clip(heights, 0, 1))
