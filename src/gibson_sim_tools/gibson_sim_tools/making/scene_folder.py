"""Makes a finished scene from a bake: meshes, atlases, scene.yaml, licence. Needs no Blender."""

from __future__ import annotations

import math
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import yaml
from numpy.typing import NDArray

from gibson_sim.errors import SceneError
from gibson_sim.geometry.colours import linear_from_srgb
from gibson_sim.picture_files import write_picture
from gibson_sim.writing import write_file
from gibson_sim_tools.making.building import Building
from gibson_sim_tools.making.building_file import Quality
from gibson_sim_tools.making.glb import BakedMaterial, Patch, write_boxes, write_glb
from gibson_sim_tools.making.outside import outside
from gibson_sim_tools.making.pixels import F32, doubled, exposure_of, filled, toned
from gibson_sim_tools.making.surroundings import ASSETS, SURROUNDINGS, plain_surroundings

OUTSIDE = "outside.jpg"
LIMIT_BYTES = 12_000_000
_GLASS_ALPHA = 0.16
_NARROW_PX = 22
_REFLECTED = 0.88
"""Reflectance of mirrors."""
_ROOM_CLASSES = {"living": "living_room", "meeting": "meeting_room"}
"""Room classes whose name differs from the kind in plans."""
_LICENSE = """CC0 1.0 Universal (Public Domain Dedication)

To the extent possible under law, the makers of this scene have waived all copyright and related or neighbouring rights to all files in this
folder. The text of the dedication: https://creativecommons.org/publicdomain/zero/1.0/legalcode

The scene was made by `{command}`; nothing in it was taken from elsewhere.
"""


def write_scene_folder(building: Building, quality: Quality, work: Path, folder: Path, command: str) -> float:
    """Writes all files of a scene but those that need a renderer (thumbnail, surroundings).

    Args:
        building: the plan.
        quality: quality of the bake.
        work: output folder of ``gibson_sim_tools.making.blender``.
        folder: of the scene; existing files are replaced.
        command: command line recorded in scene.yaml.

    Returns:
        The typical brightness of a white surface in the scene, linear.

    Raises:
        SceneError: something was not baked, or the scene is too large.
    """
    mesh = _load(work / "mesh.npz")
    assets = folder / ASSETS
    assets.mkdir(parents=True, exist_ok=True)
    for old in [*assets.glob("*.glb"), *assets.glob("*.jpg"), *assets.glob("*.hdr")]:
        old.unlink()
    white = _write_atlases(mesh, work, assets, sorted({int(k) for k in mesh["atlas"] if k >= 0}), quality)
    plain_surroundings(assets / SURROUNDINGS, white)
    _write_image(assets / OUTSIDE, outside(building.seed), quality.jpeg)
    objects = _write_objects(mesh, assets)
    text = yaml.dump(
        _description(building, objects, command), sort_keys=False, default_flow_style=None, width=160, allow_unicode=True
    )
    write_file(folder / "scene.yaml", f"# Made by: {command}\n{text}")
    write_file(folder / "LICENSE", _LICENSE.format(command=command))
    size = sum(f.stat().st_size for f in folder.rglob("*") if f.is_file())
    if size > LIMIT_BYTES:
        raise SceneError(f"{folder}: has {size / 1e6:.1f} MB, more than {LIMIT_BYTES / 1e6:.0f}; take a lower quality")
    return white


def _load(path: Path) -> dict[str, NDArray[Any]]:
    try:
        with np.load(path) as file:
            return {name: file[name] for name in file.files}
    except (OSError, ValueError) as e:
        raise SceneError(f"{path}: cannot be read: {e}; bake the scene again") from e


def _write_atlases(mesh: dict[str, NDArray[Any]], work: Path, assets: Path, atlases: Iterable[int], quality: Quality) -> float:
    """Writes the atlases; returns the typical brightness of a white surface in them, linear."""
    images = []
    for k in atlases:
        try:
            color, light = (np.load(work / f"{what}_{k}.npy").astype(np.float32) for what in ("color", "light"))
        except (OSError, ValueError) as e:
            raise SceneError(f"{work}: atlas {k} was not baked: {e}; start again, what is finished is kept") from e
        calm_small_charts(light, mesh["charts"][mesh["charts"][:, 0] == k, 1:] / 2)
        image = compose(color, light)
        for uv, reflected in _mirrors(work, k):
            put_mirror(image, uv, reflected)
        some = np.flatnonzero(color[..., 3] > 0.5)[:: max(1, image[..., 0].size // 50_000)]
        images.append((k, image, image.reshape(-1, 3)[some], color[..., :3].reshape(-1, 3)[some]))
    exposure = exposure_of([seen for _, _, seen, _ in images])
    for k, image, _, _ in images:
        _write_image(assets / f"atlas_{k}.jpg", toned(image * exposure)[::-1], quality.jpeg)
    white = [_white(linear_from_srgb(toned(seen * exposure) / 255), colors) for _, _, seen, colors in images]
    return float(np.median(np.concatenate(white)))


def _white(shown: NDArray[np.float64], colors: F32) -> NDArray[np.float64]:
    """Returns the brightness of white at the N pixels that are neither dark nor in shadow."""
    own, there = colors.mean(axis=1), shown.mean(axis=1)
    return np.asarray((there / np.maximum(own, 1e-6))[(own > 0.2) & (there > 0.05)])


def _write_image(path: Path, rgb: NDArray[np.uint8], jpeg: int) -> None:
    write_picture(path, cv2.cvtColor(rgb, cv2.COLOR_RGB2BGR), (cv2.IMWRITE_JPEG_QUALITY, jpeg))


def calm_small_charts(light: F32, charts: NDArray[np.float64]) -> None:
    """Smooths the light along narrow charts, which have too few pixels for the denoiser.

    Args:
        light: (H, W, 4); the last channel is 1 on surfaces; changed in place.
        charts: (C, 4): low corner and size of each chart, pixels.
    """
    for x, y, width, height in charts:
        if min(width, height) >= _NARROW_PX:
            continue
        rows = slice(math.floor(y), math.ceil(y + height))
        columns = slice(math.floor(x), math.ceil(x + width))
        part = light[rows, columns]
        known = (part[..., 3:] > 0.5).astype(np.float32)
        across, along = min(1.2, min(width, height) / 6), 4.0
        sigma_x, sigma_y = (along, across) if width >= height else (across, along)
        mixed = cv2.GaussianBlur(
            np.concatenate([part[..., :3] * known, known], axis=2), (0, 0), sigma_x, None, sigma_y, cv2.BORDER_CONSTANT
        )
        part[..., :3] = np.where(known > 0, mixed[..., :3] / np.maximum(mixed[..., 3:], 1e-3), part[..., :3])


def _mirrors(work: Path, atlas: int) -> Iterable[tuple[NDArray[np.float64], F32]]:
    """Yields the corners (4, 2) and the reflection of each mirror in an atlas."""
    content = _load(work / "mirrors.npz")
    for name in content:
        number = name.removeprefix("image_")
        if name != number and int(content[f"atlas_{number}"]) == atlas:
            yield content[f"uv_{number}"], content[name].astype(np.float32)


def put_mirror(image: F32, uv: NDArray[np.float64], reflected: F32) -> None:
    """Draws the reflection of a mirror into its atlas.

    Args:
        image: (H, W, 3), row 0 at the bottom; changed in place.
        uv: (4, 2): lower left, lower right, upper right, upper left corner of the mirror, 0 to 1.
        reflected: (h, w, 3), row 0 at the bottom.
    """
    height, width = image.shape[:2]
    corners = uv * [width, height]
    low = np.maximum(np.floor(corners.min(axis=0)).astype(int) - 1, 0)
    high = np.ceil(corners.max(axis=0)).astype(int) + 1
    x, y = np.meshgrid(np.arange(low[0], min(high[0], width)), np.arange(low[1], min(high[1], height)))
    across = np.stack([corners[1] - corners[0], corners[3] - corners[0]], axis=1)
    place = (np.stack([x + 0.5, y + 0.5], axis=-1) - corners[0]) @ np.linalg.inv(across).T
    columns = np.clip(place[..., 0] * reflected.shape[1], 0, reflected.shape[1] - 1).astype(int)
    rows = np.clip(place[..., 1] * reflected.shape[0], 0, reflected.shape[0] - 1).astype(int)
    image[y, x] = _REFLECTED * reflected[rows, columns]


def compose(color: F32, light: F32) -> F32:
    """Returns the lit colours (H, W, 3), linear.

    Args:
        color: (H, W, 4), linear; the last channel is 1 on surfaces.
        light: (H / 2, W / 2, 4), light on white.
    """
    whole = filled(color[..., :3], color[..., 3] > 0.5)
    return np.asarray(whole * doubled(np.maximum(light[..., :3], 0.0)), dtype=np.float32)


def _write_objects(mesh: dict[str, NDArray[Any]], assets: Path) -> list[dict[str, Any]]:
    """Writes the mesh of each object, and the collision shapes; returns the entries of scene.yaml."""
    objects = []
    for number, name in enumerate(mesh["names"].tolist()):
        chosen = np.flatnonzero(mesh["owner"] == number)
        if not mesh["exported"][number] or not len(chosen):
            continue
        write_glb(assets / f"{name}.glb", list(_patches(mesh, chosen)))
        boxes = mesh["boxes"][mesh["box_owner"] == number]
        entry: dict[str, Any] = {"name": name, "mesh": f"{ASSETS}/{name}.glb", "semantic_class": mesh["classes"].tolist()[number]}
        if len(boxes):
            write_boxes(assets / f"{name}_collision.glb", boxes)
            entry["collision"] = f"{ASSETS}/{name}_collision.glb"
        else:
            entry["collision"] = "none"
        objects.append(entry)
    return objects


def _patches(mesh: dict[str, NDArray[Any]], chosen: NDArray[np.int64]) -> Iterable[Patch]:
    atlas = mesh["atlas"][chosen]
    for k in sorted(set(atlas.tolist())):
        rows = chosen[atlas == k]
        if k >= 0:
            yield Patch(BakedMaterial(f"atlas_{k}.jpg"), mesh["corners"][rows].astype(float), mesh["uv"][rows].astype(float))
            continue
        looks = np.column_stack([mesh["tint"][rows], mesh["pattern"][rows]])
        for look in np.unique(looks, axis=0):
            same = rows[(looks == look).all(axis=1)]
            glass = mesh["patterns"].tolist()[int(look[3])] == "glass"
            color = (float(look[0]), float(look[1]), float(look[2]), _GLASS_ALPHA if glass else 1.0)
            yield Patch(BakedMaterial(color=color), mesh["corners"][same].astype(float))


def _description(building: Building, objects: list[dict[str, Any]], command: str) -> dict[str, Any]:
    """Returns the content of scene.yaml."""
    rooms = [room for storey in building.storeys for room in storey.rooms]
    described = {"flat": "A flat", "house": "A house", "office": "An office", "shop": "A shop"}[building.kind]
    starts = [
        {"name": s.name, "xyz": [round(v, 3) for v in s.position], "yaw_deg": round(math.degrees(s.yaw), 1)}
        for s in building.starts
    ]
    document: dict[str, Any] = {
        "name": building.name,
        "description": f"{described} of {len(rooms)} rooms, its light baked in",
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
    """Returns the content of ``rooms`` in scene.yaml: every room up to the centre lines of its walls."""
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
        # Hinges in degrees, slides in metres.
        slides = ("slide", "drawer")
        entry["joints"] = {k: round(v if k.startswith(slides) else math.degrees(v), 3) for k, v in body.joints.items()}
    return entry
