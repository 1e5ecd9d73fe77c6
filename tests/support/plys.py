"""Writes small PLY files for tests."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

CORNERS = [[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [1.0, 1.0, 0.0], [0.0, 1.0, 0.0]]
"""A square on the floor, counter-clockwise from above."""
COLORS = [[255, 0, 0], [0, 255, 0], [0, 0, 255], [255, 255, 255]]


def ply(
    corners: ArrayLike = CORNERS,
    faces: list[list[int]] | None = None,
    colors: ArrayLike | None = COLORS,
    *,
    order: str = "<",
    objects: list[int] | None = None,
) -> bytes:
    """Returns the bytes of a file; ``order`` "" = text, "<" or ">" = binary; ``objects`` = a number for each face."""
    points = np.asarray(corners, dtype=np.float64)
    polygons = [[0, 1, 2, 3]] if faces is None else faces
    fmt = {"": "ascii", "<": "binary_little_endian", ">": "binary_big_endian"}[order]
    lines = ["ply", f"format {fmt} 1.0", f"element vertex {len(points)}", *(f"property float {axis}" for axis in "xyz")]
    fields: list[Any] = [("p", f"{order or '<'}f4", 3)]
    if colors is not None:
        lines += [f"property uchar {name}" for name in ("red", "green", "blue")]
        fields.append(("c", "u1", 3))
    lines += [f"element face {len(polygons)}", "property list uchar int vertex_indices"]
    lines += ["property int object_id"] if objects is not None else []
    header = ("\n".join([*lines, "end_header"]) + "\n").encode()
    table: NDArray[Any] = np.zeros(len(points), dtype=fields)
    table["p"] = points
    if colors is not None:
        table["c"] = colors
    ids = [[] if objects is None else [objects[k]] for k in range(len(polygons))]
    if order == "":
        rows = [" ".join(map(str, (*row["p"].tolist(), *(row["c"].tolist() if colors is not None else ())))) for row in table]
        rows += [" ".join(map(str, (len(f), *f, *n))) for f, n in zip(polygons, ids, strict=True)]
        return header + ("\n".join(rows) + "\n").encode()
    body = b"".join(
        bytes([len(f)]) + np.array([*f, *n], dtype=f"{order}i4").tobytes() for f, n in zip(polygons, ids, strict=True)
    )
    return header + table.tobytes() + body
