"""What was drawn comes back to memory, and becomes the arrays of a ``Frame``."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from gibson_sim.geometry import projections
from gibson_sim.geometry.transforms import Mat4
from gibson_sim.render import gl as GL
from gibson_sim.render.context import GlContext
from gibson_sim.render.grouping import Remembered
from gibson_sim.render.target import ATTACHMENT, Target, features_of
from gibson_sim.render.unpacking import depth_of, normals_of, positions_of, turned
from gibson_sim.types import CameraSpec, Frame, Output

_RAW: dict[str, tuple[int, int, int, type[np.generic]]] = {
    # Four bytes a pixel is what drivers store and copy at once; dropping alpha on the host takes far less than their conversion.
    "color": (GL.RGBA, GL.UNSIGNED_BYTE, 4, np.uint8),
    "depth": (GL.DEPTH_COMPONENT, GL.FLOAT, 1, np.float32),
    "LABELS": (GL.RG_INTEGER, GL.UNSIGNED_SHORT, 2, np.uint16),
    "NORMALS": (GL.RGBA, GL.UNSIGNED_SHORT, 4, np.uint16),
    "FLOW": (GL.RG, GL.FLOAT, 2, np.float32),
}
"""OpenGL's format and type, numbers a pixel, their type."""


@dataclass(frozen=True, slots=True, eq=False)
class Shot:
    """One camera's image in a target."""

    camera: CameraSpec
    stamp_ns: int
    T_world_camera: Mat4
    x: int = 0
    """Column of its left edge in the target."""
    y: int = 0
    """Row of its top edge."""


class Readback:
    """Reads targets of one context into memory."""

    def __init__(self, context: GlContext) -> None:
        self._gl = GL.Gl(context)
        self._memory: dict[tuple[str, int, int], tuple[NDArray[Any], int]] = {}  # and where it begins

    def frames(self, target: Target, shots: Sequence[Shot]) -> list[Frame]:
        """Returns the frames of images that a target holds; the arrays belong to the caller."""
        raw = {name: self._read(target, name) for name in needed(target, shots)}
        return [frame_from_raw(shot, raw) for shot in shots]

    def _read(self, target: Target, name: str) -> NDArray[Any]:
        """Returns an attachment, (H, W, ...); the memory is used again by the next call."""
        form, kind, numbers, dtype = _RAW[name]
        key = (name, target.width, target.height)
        if key not in self._memory:
            if len(self._memory) > 64:
                self._memory.clear()
            shape = (target.height, target.width) if numbers == 1 else (target.height, target.width, numbers)
            made = np.empty(shape, dtype=dtype)
            self._memory[key] = made, made.ctypes.data
        out, begin = self._memory[key]
        gl = self._gl
        gl.glBindFramebuffer(GL.FRAMEBUFFER, target.framebuffer)
        gl.glReadBuffer(GL.COLOR_ATTACHMENT0 + ATTACHMENT.get(name, 0))
        gl.glPixelStorei(GL.PACK_ALIGNMENT, 1)
        gl.glReadPixels(0, 0, target.width, target.height, form, kind, begin)
        return out


def needed(target: Target, shots: Sequence[Shot]) -> list[str]:
    """Returns which textures of a target the frames of its images are made from."""
    asked = [_made_from(shot.camera.outputs) for shot in shots]
    return [name for name in ("color", "depth", *target.features) if any(name in names for names in asked)]


def _textures(outputs: tuple[Output, ...]) -> frozenset[str]:
    """Returns which textures outputs are made from; a target has those of features that are asked for, and no others."""
    color, depth = "rgb" in outputs, bool({"depth", "position"} & set(outputs))
    return frozenset([*(["color"] if color else []), *(["depth"] if depth else []), *features_of(outputs)])


_made_from = Remembered(_textures)


def frame_from_raw(shot: Shot, raw: dict[str, NDArray[Any]]) -> Frame:
    """Returns the frame of an image in attachments as they were read; nothing of them is kept.

    Args:
        shot: which image.
        raw: "color" (H, W, 4) uint8; "depth" (H, W) float32, near / depth, 0 = nothing; "LABELS" (H, W, 2) uint16; "NORMALS"
            (H, W, 4) uint16, fractions; "FLOW" (H, W, 2) float32. Row 0 = top.
    """
    camera = shot.camera
    outputs = camera.outputs
    part = {name: a[shot.y : shot.y + camera.height, shot.x : shot.x + camera.width] for name, a in raw.items()}
    R = shot.T_world_camera[:3, :3].astype(np.float32)
    made_from = _made_from(outputs)
    depth = depth_of(part["depth"], camera.near, camera.far) if "depth" in made_from else None
    normal = normals_of(part["NORMALS"]) if "NORMALS" in made_from else None
    position = None
    if "position" in outputs:
        assert depth is not None
        position = positions_of(rays_f32(camera), depth, R, shot.T_world_camera[:3, 3].astype(np.float32))
    return Frame(
        camera,
        shot.stamp_ns,
        shot.T_world_camera,
        rgb=np.asarray(cv2.cvtColor(part["color"], cv2.COLOR_RGBA2RGB)) if "rgb" in outputs else None,
        depth=depth if "depth" in outputs else None,
        semantic=np.ascontiguousarray(part["LABELS"][:, :, 0]) if "semantic" in outputs else None,
        instance=np.ascontiguousarray(part["LABELS"][:, :, 1]) if "instance" in outputs else None,
        normal=normal if "normal" in outputs else None,
        normal_world=turned(R, normal) if normal is not None and "normal_world" in outputs else None,
        position=position,
        flow=part["FLOW"].copy() if "flow" in outputs else None,
    )


@lru_cache(maxsize=64)
def rays_f32(camera: CameraSpec) -> NDArray[np.float32]:
    """Returns what a pixel's depth is multiplied with to give its point in the optical frame, (H, W, 3); NaN = nothing is seen there."""
    return projections.rays(camera).astype(np.float32)
