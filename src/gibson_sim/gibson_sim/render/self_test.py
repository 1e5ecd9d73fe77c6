"""Self-test of a rendering device: draws four plates and compares the image with the expected pixels.

The edges of the plates lie halfway between pixel centres, their textures are unlit and the background is empty, so on every driver
colours and labels must be exact and depths accurate to 0.1 mm.
"""

from __future__ import annotations

import hashlib
import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from gibson_sim.description.shapes import Shape, VisualSpec
from gibson_sim.errors import RenderError
from gibson_sim.formats.mesh import Material, Mesh, MeshPart, TextureSource
from gibson_sim.geometry.transforms import R_LINK_OPTICAL, quat_from_matrix
from gibson_sim.render.renderer import Renderer, RenderOptions
from gibson_sim.scenes.spec import DrawnScene, LightSpec
from gibson_sim.types import CameraSpec, Frame, Pose, SceneState, Vec3

SIZE = 64
FOCAL = SIZE / 2.0
"""Focal length, pixels, of a field of view of 90 degrees."""
DEPTH_TOLERANCE = 1e-4
"""Largest depth error, metres."""
_CENTRE = (SIZE - 1) / 2.0
_BLEND_PX = 3
"""Rows on either side of the border between the halves of a texture where colours may be interpolated."""


@dataclass(frozen=True, slots=True)
class _Plate:
    """An upright rectangle that faces the camera."""

    name: str
    columns: tuple[int, int]
    """First covered column, and the first one after the plate."""
    rows: tuple[int, int]
    distance: float
    """Distance from the camera, metres."""
    upper: tuple[int, int, int]
    """Colour of the upper half of its texture, sRGB bytes."""
    lower: tuple[int, int, int]


# Their instances are 1 to 4 in this order; their classes are their names in alphabetical order: east, north, south, west.
_PLATES = (
    _Plate("south", (8, 32), (8, 32), 2.0, (200, 30, 40), (220, 180, 20)),
    _Plate("north", (32, 60), (4, 32), 2.5, (10, 160, 90), (30, 60, 210)),
    _Plate("west", (12, 32), (32, 52), 3.0, (255, 255, 255), (127, 128, 129)),
    _Plate("east", (32, 44), (32, 56), 4.25, (90, 0, 140), (1, 2, 3)),
)
_CLASSES = ("east", "north", "south", "west")


@dataclass(frozen=True, slots=True, eq=False)
class ExpectedFrame:
    """The expected images, (H, W)."""

    rgb: NDArray[np.uint8]
    depth: NDArray[np.float32]
    semantic: NDArray[np.uint16]
    instance: NDArray[np.uint16]
    exact: NDArray[np.bool_]
    """(H, W): whether the colour must match exactly."""


def self_test(device: int | str | None = None) -> str:
    """Returns a one-line description of the device if it draws correctly.

    Args:
        device: number or UUID; None = the default device.

    Raises:
        GraphicsUnavailableError: the device cannot draw.
        RenderError: the image differs from the expected one.
    """
    eye = CameraSpec(
        "eye", "", Pose((0.0, 0.0, 0.0), quat_from_matrix(R_LINK_OPTICAL)), SIZE, SIZE, math.pi / 2,
        outputs=("rgb", "depth", "semantic", "instance"),
    )  # fmt: skip
    visuals = tuple(VisualSpec(p.name, "", Shape("mesh", mesh=f"/{p.name}"), semantic_class=p.name) for p in _PLATES)
    state = SceneState.still()
    scene = DrawnScene("self test", 1, "", (), visuals, (eye,), LightSpec(background=(0.0, 0.0, 0.0)))
    with Renderer(scene, meshes=_loader(), options=RenderOptions(device=device)) as renderer:
        frame = renderer.render(state, (eye,))[0]
        info = renderer.info
    problems = compare(frame)
    if problems:
        raise RenderError(f"{info['renderer']} draws wrongly: {'; '.join(problems)}; try another device with --egl-device")
    kind = "software, no GPU" if info["software"] else "GPU"
    return f"pixel-exact ({digest(frame)}) on {info['renderer']} ({kind}), OpenGL {info['version']}"


def expected() -> ExpectedFrame:
    """Returns the expected frame, computed without rendering."""
    shape = (SIZE, SIZE)
    out = ExpectedFrame(
        np.zeros((*shape, 3), np.uint8), np.full(shape, np.inf, np.float32), np.zeros(shape, np.uint16), np.zeros(shape, np.uint16),
        np.ones(shape, np.bool_),
    )  # fmt: skip
    for number, plate in enumerate(_PLATES, start=1):
        columns, rows = slice(*plate.columns), slice(*plate.rows)
        middle = sum(plate.rows) // 2
        out.rgb[plate.rows[0] : middle, columns] = plate.upper
        out.rgb[middle : plate.rows[1], columns] = plate.lower
        out.exact[middle - _BLEND_PX : middle + _BLEND_PX, columns] = False
        out.depth[rows, columns] = plate.distance
        out.semantic[rows, columns] = 1 + _CLASSES.index(plate.name)
        out.instance[rows, columns] = number
    return out


def compare(frame: Frame) -> list[str]:
    """Returns the differences from ``expected``, one message for each output."""
    assert frame.rgb is not None
    assert frame.depth is not None
    assert frame.semantic is not None
    assert frame.instance is not None
    right = expected()
    with np.errstate(invalid="ignore"):
        depth = (np.abs(frame.depth - right.depth) > DEPTH_TOLERANCE) | (np.isinf(frame.depth) != np.isinf(right.depth))
    wrong = {
        "colours": (frame.rgb != right.rgb).any(axis=2) & right.exact,
        "depths": depth,
        "classes": frame.semantic != right.semantic,
        "instances": frame.instance != right.instance,
    }
    problems = [f"{int(mask.sum())} of {mask.size} {name}" for name, mask in wrong.items() if mask.any()]
    if problems and not (frame.instance[::-1] != right.instance).any():
        problems.append("the image is upside down")
    return problems


def digest(frame: Frame) -> str:
    """Returns the first eight digits of a hash of the device-independent pixels: equal digits = equal images."""
    assert frame.rgb is not None
    assert frame.depth is not None
    assert frame.semantic is not None
    assert frame.instance is not None
    exact = np.where(expected().exact[:, :, None], frame.rgb, 0)
    whole_mm = np.where(np.isinf(frame.depth), -1.0, np.round(frame.depth.astype(np.float64) * 1e3))
    parts = (exact.astype(np.uint8), whole_mm.astype("<i4"), frame.semantic.astype("<u2"), frame.instance.astype("<u2"))
    return hashlib.sha256(b"".join(np.ascontiguousarray(part).tobytes() for part in parts)).hexdigest()[:8]


def _loader() -> Callable[[Shape], Mesh]:
    meshes = {f"/{plate.name}": _mesh(plate) for plate in _PLATES}
    return lambda shape: meshes[shape.mesh]


def _mesh(plate: _Plate) -> Mesh:
    """Returns the mesh of a plate, ``distance`` in front of the camera, which looks along +x: +y is left, +z is up."""

    def at(column: int, row: int) -> Vec3:
        # The edge of a pixel is half a pixel before its centre.
        u, v = column - 0.5, row - 0.5
        return (plate.distance, (_CENTRE - u) / FOCAL * plate.distance, (_CENTRE - v) / FOCAL * plate.distance)

    (left, right), (top, bottom) = plate.columns, plate.rows
    pixels = np.empty((16, 16, 3), dtype=np.uint8)
    pixels[:8], pixels[8:] = plate.upper, plate.lower
    low, high = 1 / 16, 15 / 16  # at 0 and 1 the filter would wrap around to the other half
    return Mesh(
        (
            MeshPart(
                np.array([at(left, top), at(right, top), at(right, bottom), at(left, bottom)], dtype=np.float32),
                np.tile(np.array([-1.0, 0.0, 0.0], dtype=np.float32), (4, 1)),
                np.array([[low, low], [high, low], [high, high], [low, high]], dtype=np.float32),
                np.array([[0, 2, 1], [0, 3, 2]], dtype=np.uint32),
                Material(base_color=(1.0, 1.0, 1.0, 1.0), texture=TextureSource(plate.name, pixels), unlit=True),
            ),
        )
    )
