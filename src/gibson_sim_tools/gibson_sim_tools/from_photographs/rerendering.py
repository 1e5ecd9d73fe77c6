"""Re-renders photographs: images of the simulation at their poses, by the renderer of the robots' cameras, and contact sheets of both."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from typing import Protocol

import cv2
import numpy as np
from numpy.typing import NDArray

from gibson_sim.filling.holes import SURFACE, is_hole
from gibson_sim.geometry.transforms import pose_from_matrix
from gibson_sim.render.cache import default_folder
from gibson_sim.render.renderer import MeshFiles, Renderer
from gibson_sim.scenes.spec import SceneSpec
from gibson_sim.types import CameraSpec, Output, SceneState
from gibson_sim_tools.scanning.clean_scene import static_scene
from gibson_sim_tools.scanning.posed_images import Photographs
from gibson_sim_tools.texturing.evaluation import RenderedImage, exposure_matched

U8 = NDArray[np.uint8]

ALL, FRONTS, HOLES = "all", "fronts", "holes"
"""Regions of compared pixels, see ``RenderPhotograph``."""
_MAX_PAIRS, _COLUMNS, _IMAGE_WIDTH_PX, _GAP_PX, _CAPTION_PX = 6, 2, 400, 6, 20
_BACKGROUND, _TEXT_COLOR = 250, (50, 50, 50)


class RenderPhotograph(Protocol):
    """Renders the simulation at the pose of a photograph."""

    def __call__(self, number: int, fill: str = "", region: str = ALL) -> RenderedImage:
        """Returns the rendered image.

        Args:
            number: number of the photograph.
            fill: hole filler, as ``CameraSpec.fill``; empty = holes are not filled.
            region: compared pixels: ``ALL`` = observed surface; ``FRONTS`` = front faces of it; ``HOLES`` = pixels that a filler fills.
        """


@contextmanager
def photograph_renderer(scene: SceneSpec, photographs: Photographs, unseen: str) -> Iterator[RenderPhotograph]:
    """Yields a function that renders the scene at the pose of a photograph.

    Args:
        scene: scene in the frame of the poses.
        photographs: posed photographs.
        unseen: name of the object that no photograph shows; it is rendered, but is not part of the observed surface.
    """
    still = static_scene(scene)
    observed_instances = [number for number, name in enumerate(still.instances) if number and name != unseen]
    with Renderer(still, meshes=MeshFiles(cache=default_folder())) as renderer:

        def render(number: int, fill: str = "", region: str = ALL) -> RenderedImage:
            intrinsics = photographs.intrinsics(number)
            pose = pose_from_matrix(photographs.items[number].T_world_camera)
            outputs: tuple[Output, ...] = ("rgb", "instance") if region == ALL else ("rgb", "instance", "hole")
            matrix = tuple(intrinsics.matrix.ravel().tolist())
            camera = CameraSpec(
                "photograph", "", pose, intrinsics.width, intrinsics.height, matrix=matrix, outputs=outputs, samples=4, fill=fill
            )  # fmt: skip
            frame = renderer.render(SceneState.still(scene.revision), [camera])[0]
            assert frame.rgb is not None and frame.instance is not None
            rgb, visible = (frame.rgb / 255.0).astype(np.float32), np.isin(frame.instance, observed_instances)
            if frame.hole is None:
                return RenderedImage(rgb, visible)
            front_faces = visible & (frame.hole == SURFACE)
            return RenderedImage(rgb, front_faces, front_faces if region == FRONTS else is_hole(frame.hole))

        yield render


def contact_sheet(photographs: Photographs, render: Callable[[int], RenderedImage], numbers: Sequence[int], unused: str) -> U8:
    """Returns a contact sheet, (H, W, 3) uint8, sRGB: pairs of a photograph and its re-rendered image, at most ``_MAX_PAIRS``, spread evenly.

    Args:
        photographs: at their refined poses.
        render: returns the re-rendered image of a photograph, by number.
        numbers: numbers of the photographs.
        unused: held-out data of these photographs, such as colours, for the captions.
    """
    selected = [numbers[k] for k in np.unique(np.linspace(0, len(numbers) - 1, _MAX_PAIRS).round().astype(int))]
    cells = []
    for number in selected:
        photograph, rendered = photographs.image(number), render(number)
        matched = np.rint(np.clip(exposure_matched(rendered.rgb, photograph, rendered.visible), 0.0, 1.0) * 255.0).astype(
            np.uint8
        )
        matched[~rendered.visible] = np.rint(rendered.rgb[~rendered.visible] * 255.0)
        cells.append(
            np.concatenate(
                [
                    _cell(f"photograph ({unused} not used) {photographs.items[number].file.name}", photograph),
                    _cell("simulation", matched),
                ],
                axis=1,
            )
        )
    height = max(len(cell) for cell in cells)
    blank = np.full((height, cells[0].shape[1], 3), _BACKGROUND, dtype=np.uint8)
    cells = [np.concatenate([cell, blank[len(cell) :]]) for cell in cells]
    columns = min(_COLUMNS, len(cells))
    cells += [blank] * (-len(cells) % columns)
    return np.concatenate([np.concatenate(cells[k : k + columns], axis=1) for k in range(0, len(cells), columns)])


def _cell(title: str, image: U8) -> U8:
    height = max(round(image.shape[0] * _IMAGE_WIDTH_PX / image.shape[1]), 1)
    cell = np.full((height + _CAPTION_PX + _GAP_PX, _IMAGE_WIDTH_PX + _GAP_PX, 3), _BACKGROUND, dtype=np.uint8)
    cell[:height, :_IMAGE_WIDTH_PX] = cv2.resize(image, (_IMAGE_WIDTH_PX, height), interpolation=cv2.INTER_AREA)
    cv2.putText(cell, title[:60], (3, height + _CAPTION_PX - 6), cv2.FONT_HERSHEY_SIMPLEX, 0.45, _TEXT_COLOR, 1, cv2.LINE_AA)
    return cell
