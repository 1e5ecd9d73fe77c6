"""Writes floor maps to files: for Nav2's map server, in the layout of the Gibson dataset, and as coloured images."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import cv2
import numpy as np
import yaml
from numpy.typing import NDArray

from gibson_sim.errors import SceneError
from gibson_sim.maps.floor_map import FloorMap
from gibson_sim.writing import write_file

Bytes = NDArray[np.uint8]

OCCUPIED, UNKNOWN, FREE = 0, 205, 254
"""Grey values of Nav2's map server in the mode "trinary"."""
FLOORS = "floors.txt"
"""File with the heights of all floors, metres, in the layout of Gibson's scenes."""
GIBSON_RESOLUTION = 0.01
"""Size of a pixel of ``floor_trav_N.png``, metres."""
_MAX_PIXELS = 12_000
"""Maximum width and height of ``floor_trav_N.png``, pixels."""
_COLOURS = {"unknown": (236, 239, 241), "occupied": (38, 50, 56), "free": (200, 230, 201), "near": (255, 224, 130)}


def write_nav2_map(floor: FloorMap, path: Path) -> tuple[Path, Path]:
    """Writes ``<path>.pgm`` and ``<path>.yaml`` for Nav2's map server; returns both paths.

    The format: https://docs.nav2.org/configuration/packages/configuring-map-server.html and ``nav2_map_server/map_io``.

    Raises:
        SceneError: a file cannot be written.
    """
    picture = np.full(floor.shape, UNKNOWN, dtype=np.uint8)
    picture[floor.occupied] = OCCUPIED
    picture[floor.free] = FREE
    image, description = path.with_name(f"{path.name}.pgm"), path.with_name(f"{path.name}.yaml")
    # Row 0 of the image is at the highest y.
    rows, columns = floor.shape
    write_file(image, f"P5\n{columns} {rows}\n255\n".encode() + np.ascontiguousarray(picture[::-1]).tobytes())
    meta = {
        "image": image.name,
        "mode": "trinary",
        "resolution": round(floor.resolution, 9),
        "origin": [round(floor.origin[0], 9), round(floor.origin[1], 9), 0.0],
        "negate": 0,
        "occupied_thresh": 0.65,
        "free_thresh": 0.25,
    }
    write_file(description, yaml.safe_dump(meta, sort_keys=False, default_flow_style=None).encode())
    return image, description


def write_gibson_maps(floors: Sequence[FloorMap], folder: Path) -> tuple[Path, ...]:
    """Writes ``floor_trav_N.png`` (255 = free) for every floor and ``floors.txt`` (heights); returns their paths.

    A pixel is 1 cm; the centre of the square image is the origin of the world; rows go along +y, columns along +x.

    Raises:
        SceneError: a file cannot be written, or a floor lies farther than 60 m from the origin.
    """
    paths = []
    for number, floor in enumerate(floors):
        paths.append(folder / f"floor_trav_{number}.png")
        write_file(paths[-1], _png(_gibson_picture(floor)))
    paths.append(folder / FLOORS)
    write_file(paths[-1], "".join(f"{floor.floor_z:g}\n" for floor in floors).encode())
    return tuple(paths)


def write_picture(floor: FloorMap, path: Path, radius: float, *, pixels: int = 3) -> None:
    """Writes a coloured PNG: green = free for the robot's centre, yellow = the robot would be in collision, dark = obstacles.

    Args:
        floor: the map.
        path: the PNG.
        radius: radius of the robot, metres.
        pixels: edge of a cell, pixels.

    Raises:
        SceneError: the file cannot be written.
    """
    picture = np.empty((*floor.shape, 3), dtype=np.uint8)
    picture[:] = _COLOURS["unknown"]
    picture[floor.occupied] = _COLOURS["occupied"]
    picture[floor.free] = _COLOURS["near"]
    picture[floor.inflate(radius)] = _COLOURS["free"]
    large = np.repeat(np.repeat(picture[::-1, :, ::-1], pixels, axis=0), pixels, axis=1)
    write_file(path, _png(large))


def _gibson_picture(floor: FloorMap) -> Bytes:
    """Returns the square image of a floor, (N, N) uint8, 255 = free."""
    rows, columns = floor.shape
    x, y = floor.origin
    half = max(abs(x), abs(y), abs(x + columns * floor.resolution), abs(y + rows * floor.resolution))
    size = 2 * int(np.ceil(half / GIBSON_RESOLUTION - 1e-6))
    if size > _MAX_PIXELS:
        raise SceneError(
            f"the floor reaches {half:.0f} m from the origin, its map would have {size} pixels; must be at most 60 m"
        )
    # Centres of the pixels, metres: the same along rows and columns.
    middles = (np.arange(size) + 0.5 - size / 2) * GIBSON_RESOLUTION
    across = np.floor((middles - x) / floor.resolution).astype(np.int64)
    along = np.floor((middles - y) / floor.resolution).astype(np.int64)
    inside = ((along >= 0) & (along < rows))[:, None] & ((across >= 0) & (across < columns))
    free = floor.free[np.clip(along, 0, rows - 1)[:, None], np.clip(across, 0, columns - 1)]
    return np.where(free & inside, 255, 0).astype(np.uint8)


def _png(picture: Bytes) -> bytes:
    """Returns an image (H, W) or (H, W, 3), BGR, as PNG."""
    encoded, data = cv2.imencode(".png", np.ascontiguousarray(picture), [cv2.IMWRITE_PNG_COMPRESSION, 9])
    if not encoded:
        raise SceneError(f"a picture of {picture.shape} cannot be encoded")
    return data.tobytes()
