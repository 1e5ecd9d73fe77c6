"""Converts maps in Gibson's layout to Nav2's: 0.01 m per pixel, origin of the world in the middle, row 0 at the lowest y; 255 = free."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import yaml

from gibson_sim.errors import SceneError
from gibson_sim.formats.image_header import MAX_PIXELS, image_size
from gibson_sim.picture_files import write_picture
from gibson_sim.writing import write_file
from gibson_sim_tools.importing.document import FloorPicture

GIBSON_RESOLUTION = 0.01
"""Resolution of Gibson's maps, metres per pixel."""


def write_nav2_map(picture: FloorPicture, floor_z: float, folder: Path) -> None:
    """Writes ``floor_N.pgm``, row 0 at the highest y, and ``floor_N.yaml``.

    Args:
        picture: the map.
        floor_z: height of its floor, metres; written as a comment.
        folder: created if missing.

    Raises:
        SceneError: the image cannot be read.
    """
    data = picture.file.read_bytes()
    size = image_size(data)
    if size is None or size.pixels > MAX_PIXELS:
        problem = "is not an image" if size is None else f"has {size.width} x {size.height} pixels"
        raise SceneError(f"{picture.file}: {problem}; a map must be an image of at most {MAX_PIXELS // 2**20} million pixels")
    image = cv2.imdecode(np.frombuffer(data, dtype=np.uint8), cv2.IMREAD_GRAYSCALE)
    if image is None:
        raise SceneError(
            f"{picture.file}: is truncated or damaged; copy it again, or delete it: Gibson Sim computes its own maps"
        )
    name = f"floor_{picture.number}"
    # Nav2: 254 = free, 0 = occupied.
    free = np.where(image[::-1] == 255, 254, 0).astype(np.uint8)
    write_picture(folder / f"{name}.pgm", free)
    rows, columns = image.shape
    values = {
        "image": f"{name}.pgm", "mode": "trinary", "resolution": picture.resolution,
        "origin": [-columns / 2 * picture.resolution, -rows / 2 * picture.resolution, 0.0],
        "negate": 0, "occupied_thresh": 0.65, "free_thresh": 0.25,
    }  # fmt: skip
    header = f"# From {picture.file.name}, part of the source; floor at z = {floor_z:g} m\n"
    write_file(folder / f"{name}.yaml", header + yaml.safe_dump(values, sort_keys=False))
