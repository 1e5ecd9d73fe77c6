"""Measures a texture: photographs that it was not made from, drawn again from the textured surface, and compared where geometry is seen."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from gibson_sim.geometry.colours import srgb_from_linear
from gibson_sim_tools.photographs.photographs import Photographs
from gibson_sim_tools.scanning.posed_rgbd import Intrinsics
from gibson_sim_tools.texturing.drawing import barycentric, draw, true_weights
from gibson_sim_tools.texturing.quality import LINEAR, sampled
from gibson_sim_tools.texturing.surface import Surface, project
from gibson_sim_tools.texturing.texture import Textured

Bools = NDArray[np.bool_]
F32 = NDArray[np.float32]
F64 = NDArray[np.float64]
I64 = NDArray[np.int64]
U8 = NDArray[np.uint8]

SHEET_ROWS = 4
"""Most photographs of a contact sheet."""
SHEET_PX = 320
"""Width of a picture in it, pixels."""
_C1, _C2 = 0.01**2, 0.03**2
_SSIM_PX = 1.5
"""Standard deviation of the window of SSIM, pixels (Wang et al., IEEE TIP 2004)."""
_DARKEST, _BRIGHTEST = 0.004, 0.93
"""Range of linear light by which exposures are matched."""


@dataclass(frozen=True, slots=True)
class Likeness:
    """How alike pictures are, over all compared pixels."""

    psnr: float
    """dB."""
    ssim: float
    """Structural similarity of luma, 1 = equal."""
    pixels: int


@dataclass(frozen=True, slots=True, eq=False)
class Drawn:
    """A picture of a surface."""

    rgb: F32
    """(H, W, 3), sRGB, 0 to 1."""
    seen: Bools
    """(H, W): whether a pixel shows a triangle that photographs texture."""
    compared: Bools | None = None
    """(H, W): pixels that count in a comparison; None = those of ``seen``. Exposures are matched by ``seen`` alone."""


def draw_textured(textured: Textured, intrinsics: Intrinsics, T_world_camera: F64, *, vertex_colors: U8 | None = None) -> Drawn:
    """Returns a picture of a textured surface, of its texture between four pixels.

    Args:
        textured: the surface.
        intrinsics: of the camera.
        T_world_camera: (4, 4), optical frame.
        vertex_colors: (V, 3), sRGB, to be drawn in place of the texture.
    """
    surface, plan = textured.surface, textured.atlas
    face, weights = _weights(surface, intrinsics, T_world_camera)
    y, x = np.nonzero(face >= 0)
    shown = face[y, x]
    colors = textured.vertex_colors if vertex_colors is None else vertex_colors
    rgb = np.einsum("nk,nkc->nc", weights, colors[surface.triangles[shown]] / 255.0).astype(np.float32)
    row = np.full(len(surface.triangles), -1, dtype=np.int64)
    row[plan.faces] = np.arange(len(plan.faces))
    rows = row[shown]
    if vertex_colors is None:
        page = np.where(rows >= 0, plan.page[plan.patch[rows]], -1) if len(plan.page) else np.full(len(rows), -1)
        for number, picture in enumerate(textured.pages):
            on = page == number
            points = np.einsum("nk,nkc->nc", weights[on], plan.corners[rows[on]])
            rgb[on] = sampled(picture.astype(np.float32) / 255.0, points.astype(np.float32))
    out, seen = np.zeros((*face.shape, 3), dtype=np.float32), np.zeros(face.shape, dtype=bool)
    out[y, x], seen[y, x] = rgb, rows >= 0
    return Drawn(out, seen)


def _weights(surface: Surface, intrinsics: Intrinsics, T_world_camera: F64) -> tuple[NDArray[np.int32], F64]:
    """Returns the triangle of each pixel (H, W), -1 = none, and the weights (N, 3) of its corners for all others by rows."""
    face = draw(surface, intrinsics, T_world_camera).face
    y, x = np.nonzero(face >= 0)
    uv, z = project(surface.vertices, intrinsics, T_world_camera)
    corners = surface.triangles[face[y, x]]
    return face, true_weights(barycentric(uv[corners], np.stack([x, y], axis=1).astype(np.float64)), z[corners])


def held_out_likeness(textured: Textured, numbers: Sequence[int]) -> dict[str, Likeness]:
    """Returns how alike photographs and the surface are, with its texture and, if the mesh has any, with the colours of its vertices.

    Args:
        textured: the surface.
        numbers: of the photographs that were held out; they are drawn at the poses that were found.
    """
    held_out = textured.photographs.only(numbers)

    def drawn(number: int, vertex_colors: U8 | None) -> Drawn:
        pose = held_out.items[number].T_world_camera
        return draw_textured(textured, held_out.intrinsics(number), pose, vertex_colors=vertex_colors)

    out = {"texture": compare(held_out, lambda number: drawn(number, None))}
    if textured.surface.colors is not None:
        out["colours of vertices"] = compare(held_out, lambda number: drawn(number, textured.surface.colors))
    return out


def contact_sheet(textured: Textured, numbers: Sequence[int]) -> U8:
    """Returns a picture (H, W, 3), sRGB: in each row a photograph, the surface in the colours of its vertices if it has any, and textured.

    Args:
        textured: the surface.
        numbers: of the photographs; at most ``SHEET_ROWS`` of them are shown, spread evenly.
    """
    shown = [numbers[k] for k in np.unique(np.linspace(0, len(numbers) - 1, SHEET_ROWS).round().astype(int))]
    variants = [None] if textured.surface.colors is None else [textured.surface.colors, None]
    rows = []
    for number in shown:
        truth = textured.photographs.picture(number)
        row = [truth]
        for colors in variants:
            pose = textured.photographs.items[number].T_world_camera
            drawn = draw_textured(textured, textured.photographs.intrinsics(number), pose, vertex_colors=colors)
            row.append(np.rint(np.clip(matched(drawn.rgb, truth, drawn.seen), 0.0, 1.0) * 255.0).astype(np.uint8))
        sheet = np.concatenate(row, axis=1)
        width = len(row) * SHEET_PX
        height = max(round(sheet.shape[0] * width / sheet.shape[1]), 1)
        rows.append(np.asarray(cv2.resize(sheet, (width, height), interpolation=cv2.INTER_AREA), dtype=np.uint8))
    return np.concatenate(rows)


def compare(
    photographs: Photographs,
    picture: Callable[[int], Drawn],
    *,
    match_exposure: bool = True,
    numbers: Sequence[int] | None = None,
) -> Likeness:
    """Compares photographs with drawn pictures where these show a textured triangle.

    Args:
        photographs: the truth.
        picture: draws the picture at the pose of a photograph.
        match_exposure: multiply each drawn picture by one factor for each channel, in linear light: nobody can know the exposure of a
            photograph that was held out.
        numbers: of the photographs; None = all.
    """
    squares, similar, count = 0.0, 0.0, 0
    for number in range(len(photographs)) if numbers is None else numbers:
        truth, drawn = photographs.picture(number), picture(number)
        rgb = matched(drawn.rgb, truth, drawn.seen) if match_exposure else drawn.rgb
        real = truth.astype(np.float32) / np.float32(255.0)
        compared = drawn.seen if drawn.compared is None else drawn.compared
        squares += float(((rgb - real)[compared].astype(np.float64) ** 2).sum())
        similar += float(ssim(rgb, real)[compared].astype(np.float64).sum())
        count += int(compared.sum())
    mean = squares / max(3 * count, 1)
    return Likeness(float(-10.0 * np.log10(max(mean, 1e-12))), similar / max(count, 1), count)


def matched(rgb: F32, truth: U8, seen: Bools) -> F32:
    """Returns a picture (H, W, 3), sRGB, with the exposure and white balance of a photograph, by the medians of both."""
    light = np.interp(rgb, np.arange(256) / 255.0, LINEAR).astype(np.float32)
    real = LINEAR[truth]
    used = seen & ((real > _DARKEST) & (real < _BRIGHTEST) & (light > _DARKEST) & (light < _BRIGHTEST)).all(axis=2)
    if not used.any():
        return rgb
    return np.asarray(srgb_from_linear(light * np.median(real[used] / light[used], axis=0)), dtype=np.float32)


def ssim(a: F32, b: F32) -> F32:
    """Returns the structural similarity (H, W) of the luma of two pictures (H, W, 3), 0 to 1."""
    x, y = (np.asarray(cv2.cvtColor(np.ascontiguousarray(image), cv2.COLOR_RGB2GRAY), dtype=np.float32) for image in (a, b))

    def mean(values: F32) -> F32:
        return np.asarray(cv2.GaussianBlur(values, (0, 0), _SSIM_PX))

    mx, my = mean(x), mean(y)
    xx, yy, xy = mean(x * x) - mx * mx, mean(y * y) - my * my, mean(x * y) - mx * my
    return np.asarray((2 * mx * my + _C1) * (2 * xy + _C2) / ((mx * mx + my * my + _C1) * (xx + yy + _C2)), dtype=np.float32)
