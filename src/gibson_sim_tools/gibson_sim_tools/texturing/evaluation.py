"""Evaluates a texture on held-out photographs: re-renders the textured surface at their poses and measures PSNR and SSIM."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from gibson_sim.geometry.colours import srgb_from_linear
from gibson_sim.sensors.image_similarity import psnr, ssim_map
from gibson_sim_tools.scanning.posed_images import Intrinsics, Photographs
from gibson_sim_tools.scanning.triangle_mesh import TriangleMesh
from gibson_sim_tools.texturing.quality import LINEAR_FROM_SRGB8, sample_bilinear
from gibson_sim_tools.texturing.rasteriser import barycentric, perspective_correct_weights, rasterise
from gibson_sim_tools.texturing.surface import project
from gibson_sim_tools.texturing.texture import TexturedSurface

Bools = NDArray[np.bool_]
F32 = NDArray[np.float32]
F64 = NDArray[np.float64]
I64 = NDArray[np.int64]
U8 = NDArray[np.uint8]

SHEET_ROWS = 4
"""Largest number of photographs of a contact sheet."""
SHEET_WIDTH_PX = 320
"""Width of an image in it, pixels."""
USUAL_PSNR = 17.0
"""PSNR of held-out photographs below which a scene hardly resembles them, dB: scans with correct poses have 19 and more, with wrong ones 14."""
_MIN_LIGHT, _MAX_LIGHT = 0.004, 0.93
"""Range of linear light, 0 to 1, in which exposures are matched."""


@dataclass(frozen=True, slots=True)
class ImageSimilarity:
    """Similarity metrics over all compared pixels of a set of images."""

    psnr: float
    """Peak signal-to-noise ratio of RGB, dB."""
    ssim: float
    """Mean structural similarity of luma, 1 = equal."""
    pixels: int
    """Number of compared pixels."""

    def warning(self) -> str:
        """Returns a warning if the scene hardly resembles its held-out photographs; empty = it does."""
        if self.psnr >= USUAL_PSNR:
            return ""
        return (
            f"warning: the scene hardly resembles the held-out photographs (PSNR {self.psnr:.1f} dB; {USUAL_PSNR:g} and more are usual): check "
            "poses, depth scale and intrinsics before you use it"
        )


@dataclass(frozen=True, slots=True, eq=False)
class RenderedImage:
    """Rendered image of a surface."""

    rgb: F32
    """(H, W, 3), sRGB, 0 to 1."""
    visible: Bools
    """(H, W), mask of the pixels that show a textured triangle. Exposures are matched on this mask."""
    compared: Bools | None = None
    """(H, W), mask of the compared pixels; None = ``visible``."""


def render_textured(
    textured: TexturedSurface, intrinsics: Intrinsics, T_world_camera: F64, *, vertex_colors: U8 | None = None
) -> RenderedImage:
    """Returns a rendered image of a textured surface, with bilinear texture filtering.

    Args:
        textured: the surface, world frame.
        intrinsics: of the camera.
        T_world_camera: (4, 4), optical frame.
        vertex_colors: (V, 3) uint8, sRGB, replaces the texture; None = the texture.
    """
    surface, atlas = textured.surface, textured.atlas
    face, weights = _rasterised_weights(surface, intrinsics, T_world_camera)
    y, x = np.nonzero(face >= 0)
    triangle = face[y, x]
    colors = textured.vertex_colors if vertex_colors is None else vertex_colors
    rgb = np.einsum("nk,nkc->nc", weights, colors[surface.triangles[triangle]] / 255.0).astype(np.float32)
    row = np.full(len(surface.triangles), -1, dtype=np.int64)
    row[atlas.faces] = np.arange(len(atlas.faces))
    rows = row[triangle]
    if vertex_colors is None:
        page = np.where(rows >= 0, atlas.page[atlas.patch[rows]], -1) if len(atlas.page) else np.full(len(rows), -1)
        for number, image in enumerate(textured.pages):
            on_page = page == number
            points = np.einsum("nk,nkc->nc", weights[on_page], atlas.corners[rows[on_page]])
            rgb[on_page] = sample_bilinear(image.astype(np.float32) / 255.0, points.astype(np.float32))
    output, visible = np.zeros((*face.shape, 3), dtype=np.float32), np.zeros(face.shape, dtype=bool)
    output[y, x], visible[y, x] = rgb, rows >= 0
    return RenderedImage(output, visible)


def _rasterised_weights(surface: TriangleMesh, intrinsics: Intrinsics, T_world_camera: F64) -> tuple[NDArray[np.int32], F64]:
    """Returns the face image (H, W), -1 = none, and perspective-correct barycentric coordinates (N, 3) of its N covered pixels, row-major."""
    face = rasterise(surface, intrinsics, T_world_camera).face
    y, x = np.nonzero(face >= 0)
    uv, z = project(surface.vertices, intrinsics, T_world_camera)
    vertices = surface.triangles[face[y, x]]
    return face, perspective_correct_weights(barycentric(uv[vertices], np.stack([x, y], axis=1).astype(np.float64)), z[vertices])


def evaluate_held_out(textured: TexturedSurface, numbers: Sequence[int]) -> dict[str, ImageSimilarity]:
    """Returns the similarity metrics of held-out photographs, by variant: the texture and, if the mesh has any, its vertex colours.

    Args:
        textured: the surface.
        numbers: numbers of the held-out photographs; the surface is rendered at their refined poses.
    """
    held_out = textured.photographs.subset(numbers)

    def rendered(number: int, vertex_colors: U8 | None) -> RenderedImage:
        pose = held_out.items[number].T_world_camera
        return render_textured(textured, held_out.intrinsics(number), pose, vertex_colors=vertex_colors)

    metrics = {"texture": image_similarity(held_out, lambda number: rendered(number, None))}
    if textured.surface.colors is not None:
        metrics["colours of vertices"] = image_similarity(held_out, lambda number: rendered(number, textured.surface.colors))
    return metrics


def contact_sheet(textured: TexturedSurface, numbers: Sequence[int]) -> U8:
    """Returns a contact sheet, (H, W, 3) uint8, sRGB: in each row a photograph, the surface with vertex colours (if any), and textured.

    Args:
        textured: the surface.
        numbers: numbers of the photographs; at most ``SHEET_ROWS`` of them are shown, spread evenly.
    """
    selected = [numbers[k] for k in np.unique(np.linspace(0, len(numbers) - 1, SHEET_ROWS).round().astype(int))]
    variants = [None] if textured.surface.colors is None else [textured.surface.colors, None]
    rows = []
    for number in selected:
        photograph = textured.photographs.image(number)
        row = [photograph]
        for colors in variants:
            pose = textured.photographs.items[number].T_world_camera
            rendered = render_textured(textured, textured.photographs.intrinsics(number), pose, vertex_colors=colors)
            row.append(
                np.rint(np.clip(exposure_matched(rendered.rgb, photograph, rendered.visible), 0.0, 1.0) * 255.0).astype(np.uint8)
            )
        sheet = np.concatenate(row, axis=1)
        width = len(row) * SHEET_WIDTH_PX
        height = max(round(sheet.shape[0] * width / sheet.shape[1]), 1)
        rows.append(np.asarray(cv2.resize(sheet, (width, height), interpolation=cv2.INTER_AREA), dtype=np.uint8))
    return np.concatenate(rows)


def image_similarity(
    photographs: Photographs,
    render: Callable[[int], RenderedImage],
    *,
    match_exposure: bool = True,
    numbers: Sequence[int] | None = None,
) -> ImageSimilarity:
    """Returns the similarity metrics between photographs and rendered images over the compared pixels.

    Args:
        photographs: reference images.
        render: returns the rendered image at the pose of a photograph, by number.
        match_exposure: scale each rendered image by one factor per channel in linear light, because the exposure of a held-out
            photograph is unknown.
        numbers: numbers of the compared photographs; None = all.
    """
    squared_error, ssim_sum, count = 0.0, 0.0, 0
    for number in range(len(photographs)) if numbers is None else numbers:
        photograph, rendered = photographs.image(number), render(number)
        rgb = exposure_matched(rendered.rgb, photograph, rendered.visible) if match_exposure else rendered.rgb
        target = photograph.astype(np.float32) / np.float32(255.0)
        compared = rendered.visible if rendered.compared is None else rendered.compared
        squared_error += float(((rgb - target)[compared].astype(np.float64) ** 2).sum())
        ssim_sum += float(ssim_map(rgb, target, peak=1.0)[compared].sum())
        count += int(compared.sum())
    mse = squared_error / max(3 * count, 1)
    return ImageSimilarity(psnr(mse, peak=1.0), ssim_sum / max(count, 1), count)


def exposure_matched(rgb: F32, photograph: U8, visible: Bools) -> F32:
    """Returns a rendered image with the exposure and white balance of a photograph: the median ratio of linear light per channel.

    Args:
        rgb: (H, W, 3), rendered image, sRGB, 0 to 1.
        photograph: (H, W, 3) uint8, sRGB.
        visible: (H, W), mask of the pixels to match.
    """
    rendered_light = np.interp(rgb, np.arange(256) / 255.0, LINEAR_FROM_SRGB8).astype(np.float32)
    photograph_light = LINEAR_FROM_SRGB8[photograph]
    is_valid = visible & (
        (photograph_light > _MIN_LIGHT)
        & (photograph_light < _MAX_LIGHT)
        & (rendered_light > _MIN_LIGHT)
        & (rendered_light < _MAX_LIGHT)
    ).all(axis=2)
    if not is_valid.any():
        return rgb
    return np.asarray(
        srgb_from_linear(rendered_light * np.median(photograph_light[is_valid] / rendered_light[is_valid], axis=0)),
        dtype=np.float32,
    )
