"""Photographs beside the simulation: drawn by the renderer that robots see through, at the same places."""

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
from gibson_sim.render.renderer import Renderer
from gibson_sim.scenes.spec import SceneSpec
from gibson_sim.types import CameraSpec, Output, SceneState
from gibson_sim_tools.photographs.photographs import Photographs
from gibson_sim_tools.scanning.clean_scene import still_scene
from gibson_sim_tools.texturing.evaluation import RenderedImage, exposure_matched

U8 = NDArray[np.uint8]

ALL, FRONTS, HOLES = "all", "fronts", "holes"
"""Pixels that are compared, see ``DrawPhotograph``."""
_PAIRS, _COLUMNS, _WIDTH, _GAP, _CAPTION = 6, 2, 400, 6, 20
_PAPER, _INK = 250, (50, 50, 50)


class DrawPhotograph(Protocol):
    """Draws the simulation at the pose of a photograph."""

    def __call__(self, number: int, fill: str = "", region: str = ALL) -> RenderedImage:
        """Returns the image.

        Args:
            number: of the photograph.
            fill: how holes are filled, as ``CameraSpec.fill``; empty = they stay.
            region: pixels to compare: ``ALL``, those that show a surface of the scan; ``FRONTS``, of these the front faces; ``HOLES``, those that
                a filler fills.
        """


@contextmanager
def photograph_renderer(scene: SceneSpec, photographs: Photographs, unseen: str) -> Iterator[DrawPhotograph]:
    """Yields a function that draws what a simulated camera sees at the place of a photograph; nothing is kept.

    Args:
        scene: in the frame of the poses.
        photographs: their poses are those of the cameras.
        unseen: name of the object that no photograph shows; it is drawn, and does not count as seen.
    """
    still = still_scene(scene)
    others = [number for number, name in enumerate(still.instances) if number and name != unseen]
    with Renderer(still, cache=default_folder()) as renderer:

        def picture(number: int, fill: str = "", region: str = ALL) -> RenderedImage:
            lens = photographs.intrinsics(number)
            pose = pose_from_matrix(photographs.items[number].T_world_camera)
            outputs: tuple[Output, ...] = ("rgb", "instance") if region == ALL else ("rgb", "instance", "hole")
            camera = CameraSpec(
                "photograph", "", pose, lens.width, lens.height, matrix=tuple(lens.matrix.ravel().tolist()), outputs=outputs, samples=4,
                fill=fill,
            )  # fmt: skip
            frame = renderer.render(SceneState.still(scene.revision), [camera])[0]
            assert frame.rgb is not None and frame.instance is not None
            rgb, seen = (frame.rgb / 255.0).astype(np.float32), np.isin(frame.instance, others)
            if frame.hole is None:
                return RenderedImage(rgb, seen)
            fronts = seen & (frame.hole == SURFACE)
            return RenderedImage(rgb, fronts, fronts if region == FRONTS else is_hole(frame.hole))

        yield picture


def contact_sheet(photographs: Photographs, drawn: Callable[[int], RenderedImage], numbers: Sequence[int], unused: str) -> U8:
    """Returns pairs of a photograph and the simulation, (H, W, 3), sRGB; at most ``_PAIRS`` of the numbers, spread evenly.

    Args:
        photographs: at the poses that were found.
        drawn: what the simulation shows at the place of a photograph.
        numbers: of the photographs.
        unused: what of these photographs the scene was not made from, for their captions.
    """
    shown = [numbers[k] for k in np.unique(np.linspace(0, len(numbers) - 1, _PAIRS).round().astype(int))]
    cells = []
    for number in shown:
        truth, picture = photographs.image(number), drawn(number)
        simulated = np.rint(np.clip(exposure_matched(picture.rgb, truth, picture.visible), 0.0, 1.0) * 255.0).astype(np.uint8)
        simulated[~picture.visible] = np.rint(picture.rgb[~picture.visible] * 255.0)
        cells.append(
            np.concatenate(
                [
                    _cell(f"photograph ({unused} not used) {photographs.items[number].file.name}", truth),
                    _cell("simulation", simulated),
                ],
                axis=1,
            )
        )
    height = max(len(cell) for cell in cells)
    blank = np.full((height, cells[0].shape[1], 3), _PAPER, dtype=np.uint8)
    cells = [np.concatenate([cell, blank[len(cell) :]]) for cell in cells]
    columns = min(_COLUMNS, len(cells))
    cells += [blank] * (-len(cells) % columns)
    return np.concatenate([np.concatenate(cells[k : k + columns], axis=1) for k in range(0, len(cells), columns)])


def _cell(title: str, picture: U8) -> U8:
    height = max(round(picture.shape[0] * _WIDTH / picture.shape[1]), 1)
    out = np.full((height + _CAPTION + _GAP, _WIDTH + _GAP, 3), _PAPER, dtype=np.uint8)
    out[:height, :_WIDTH] = cv2.resize(picture, (_WIDTH, height), interpolation=cv2.INTER_AREA)
    cv2.putText(out, title[:60], (3, height + _CAPTION - 6), cv2.FONT_HERSHEY_SIMPLEX, 0.45, _INK, 1, cv2.LINE_AA)
    return out
