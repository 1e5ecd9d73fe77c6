"""Ambient occlusion of splats by moving links: without it, a robot seems to float over a floor of splats.

Rooms are mostly lit by ambient light, less of which reaches the floor below a robot. Each moving link is approximated by its box with
rounded upright edges, so that the occlusion does not depend on the part of the link that a camera sees.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
from numpy.typing import NDArray

from gibson_sim.geometry.transforms import invert
from gibson_sim.render.context import GlContext, gl as GL
from gibson_sim.render.culling.draw_plan import PinholePicture
from gibson_sim.render.draw.screen_pass import FULL_SCREEN, shader_text

F64 = NDArray[np.float64]
RADIUS_M = 0.25
"""Distance from a box beyond which there is no occlusion, metres."""
DARKEST = 0.6
"""Fraction of the light that is occluded where a box touches a surface."""
_ROUND = 0.7
"""Radius of the upright edges of a box, relative to the shorter horizontal half extent: most robots are round or have rounded corners."""
_MOST_BOXES = 128
"""Maximum number of boxes of a picture; the nearest ones are used."""
_BOX = np.dtype([("box_from_optical", "<f4", (4, 4)), ("half_size", "<f4", 4)])
"""Memory layout of ``Box`` in splat_contact.frag; the matrix is column-major."""
_ZERO, _SRC_COLOR = 0, 0x0300
_CORNERS = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)], dtype=np.float64)


class SplatContacts:
    """The pass that darkens splats. The context must be current in every call."""

    def __init__(self, context: GlContext) -> None:
        self._gl, self._buffer = GL.Gl(context), 0
        defines = (f"RADIUS {RADIUS_M:.6f}", f"DARKEST {DARKEST:.6f}")
        fragment = shader_text("splat_contact.frag", defines, ("splat_view.glsl", "splat_surface.glsl"))
        self._program = context.gl.program(vertex_shader=FULL_SCREEN, fragment_shader=fragment)
        self._program["u_depth"], self._program["u_hiding"] = 0, 1
        self._buffer = self._gl.create("glCreateBuffers")

    def darken(
        self, T_world_links: F64, link_boxes: F64, pictures: Sequence[PinholePicture], textures: tuple[int, int], framebuffer: int,
        bind: Callable[[PinholePicture, int], None],
    ) -> None:  # fmt: skip
        """Darkens the colours of splats.

        Args:
            T_world_links: (L + 1, 4, 4), the world first.
            link_boxes: (L', 6), centre and half extents of the box of each link in its frame, the world first, metres; 0 = no box.
            pictures: pictures in the target.
            textures: depth textures of all surfaces and of the occluders of splats.
            framebuffer: framebuffer of the splats' colours.
            bind: sets the viewport and the uniforms of a picture, given with its index. A vertex array without attributes must be bound.
        """
        gl, moving = self._gl, 1 + np.flatnonzero(link_boxes[1 : len(T_world_links), 3:].any(axis=1))
        if not len(moving):
            return
        T_world_boxes = T_world_links[moving].copy()
        T_world_boxes[:, :3, 3] += np.einsum("nij,nj->ni", T_world_boxes[:, :3, :3], link_boxes[moving, :3])
        T_world_boxes, half = upright(T_world_boxes, link_boxes[moving, 3:])
        affected = [
            (k, *boxes) for k, picture in enumerate(pictures) if (boxes := boxes_in(picture, T_world_boxes, half)) is not None
        ]
        if not affected:
            return
        gl.glBindFramebuffer(GL.FRAMEBUFFER, framebuffer)
        gl.glDisable(GL.DEPTH_TEST)
        gl.glEnable(GL.SCISSOR_TEST)
        gl.glEnable(GL.BLEND)
        gl.glBlendFunc(_ZERO, _SRC_COLOR)
        for unit, texture in enumerate(textures):
            gl.glBindSampler(unit, 0)
            gl.glBindTextureUnit(unit, texture)
        for number, rows, (left, top, width, height) in affected:
            gl.glNamedBufferData(self._buffer, rows.nbytes, rows.ctypes.data, GL.STREAM_DRAW)
            gl.glBindBufferBase(GL.SHADER_STORAGE_BUFFER, 0, self._buffer)
            self._program["u_boxes"] = len(rows)
            gl.glUseProgram(self._program.glo)
            bind(pictures[number], number)
            gl.glScissor(left, top, width, height)
            gl.glDrawArrays(GL.TRIANGLES, 0, 3)
        gl.glDisable(GL.SCISSOR_TEST)

    def close(self) -> None:
        """Frees all GPU resources."""
        self._program.release()
        self._gl.delete("glDeleteBuffers", self._buffer)


def upright(T_world_boxes: F64, half: F64) -> tuple[F64, F64]:
    """Permutes the axes of boxes, (N, 4, 4) with half extents (N, 3), so that the most upright axis is z."""
    last = np.abs(T_world_boxes[:, 2, :3]).argmax(axis=1)
    order = (last[:, None] + (1, 2, 3)) % 3
    permuted = T_world_boxes.copy()
    permuted[:, :3, :3] = np.take_along_axis(T_world_boxes[:, :3, :3], order[:, None], axis=2)
    return permuted, np.take_along_axis(half, order, axis=1)


def boxes_in(
    picture: PinholePicture, T_world_boxes: F64, half: F64
) -> tuple[NDArray[np.void], tuple[int, int, int, int]] | None:  # fmt: skip
    """Returns the boxes that may darken a picture, and the affected rectangle of the target, pixels: left, top, width, height.

    Args:
        picture: the picture.
        T_world_boxes: (N, 4, 4), poses of the boxes' centres.
        half: (N, 3), half extents, metres.

    Returns:
        (M,) of ``_BOX`` and the rectangle; None if no box affects the picture.
    """
    T_camera_boxes: F64 = invert(picture.T_world_camera) @ T_world_boxes
    reach = _CORNERS * (half[:, None] + RADIUS_M)
    corners = np.einsum("nij,nkj->nki", T_camera_boxes[:, :3, :3], reach) + T_camera_boxes[:, None, :3, 3]
    k, size = picture.intrinsics, np.array([picture.width, picture.height])
    low, high = np.zeros((len(half), 2)), np.tile(size.astype(np.float64), (len(half), 1))
    # A box that extends behind the eye may cover any part of the picture.
    ahead = corners[:, :, 2].min(axis=1) > picture.near
    pixels = corners[ahead] @ k.T
    pixels = pixels[:, :, :2] / pixels[:, :, 2:]
    low[ahead], high[ahead] = np.floor(pixels.min(axis=1)).clip(0, size), (np.ceil(pixels.max(axis=1)) + 1.0).clip(0, size)
    rows = np.flatnonzero((low < high).all(axis=1) & (corners[:, :, 2].max(axis=1) > picture.near))
    if not len(rows):
        return None
    if len(rows) > _MOST_BOXES:
        nearest = np.argsort(np.linalg.norm(T_camera_boxes[rows, :3, 3], axis=1), kind="stable")[:_MOST_BOXES]
        rows = rows[np.sort(nearest)]
    boxes = np.zeros(len(rows), dtype=_BOX)
    boxes["box_from_optical"] = np.stack([invert(T) for T in T_camera_boxes[rows]]).transpose(0, 2, 1)
    boxes["half_size"][:, :3], boxes["half_size"][:, 3] = half[rows], _ROUND * half[rows, :2].min(axis=1)
    left, top = low[rows].min(axis=0).astype(int).tolist()
    right, bottom = high[rows].max(axis=0).astype(int).tolist()
    return boxes, (picture.x + left, picture.y + top, right - left, bottom - top)
