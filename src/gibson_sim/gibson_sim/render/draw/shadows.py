"""Shadows of the sun: one shadow map of the scene, redrawn only after geometry has moved."""

from __future__ import annotations

from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from gibson_sim.errors import RenderError
from gibson_sim.geometry.transforms import Mat4
from gibson_sim.render.context import GlContext, gl as GL

SHADOW_PX = 2048
"""Side of the shadow map, texels."""
_UNIT = 6
"""Texture unit."""
_STEP = 1.0 / 4.0
"""Step to which log2 of the map's side in metres is rounded up, so that motion at the scene's edge rarely shifts all texels."""
F64 = NDArray[np.float64]


class ShadowCasters(Protocol):
    """Geometry that casts shadows: a ``GlScene``."""

    def bounds(self, T_world_links: F64) -> F64:
        """Returns the bounding box of the scene, (2, 3), world frame, metres."""

    def moves(self) -> bool:
        """Returns whether any geometry belongs to a link."""

    def draw_depth(self, clip_from_world: Mat4, T_world_links: F64, texel: float, *, static: bool, moving: bool) -> None:
        """Draws the opaque pass into the bound depth buffer."""


def fit_sun(bounds: F64, to_sun: F64, size: int = SHADOW_PX) -> tuple[Mat4, float]:
    """Fits the sun's orthographic projection to a box.

    The axes of the map depend only on the sun and its offset is a multiple of a texel, so texels keep their positions while the box grows.

    Args:
        bounds: (2, 3), minimum and maximum corner, world frame, metres.
        to_sun: (3,), unit vector towards the sun.
        size: side of the map, texels.

    Returns:
        clip_from_world, (4, 4), with x and y in [-1, 1] and depth in [0, 1], 1 = nearest to the sun; and the size of a texel, metres.
    """
    z = np.asarray(to_sun, dtype=np.float64)
    x = np.cross((0.0, 0.0, 1.0) if abs(z[2]) < 0.99 else (1.0, 0.0, 0.0), z)
    x /= np.linalg.norm(x)
    R_sun_world = np.stack([x, np.cross(z, x), z])
    corners = (
        np.array([[bounds[i, 0], bounds[j, 1], bounds[k, 2]] for i in (0, 1) for j in (0, 1) for k in (0, 1)]) @ R_sun_world.T
    )
    low, high = corners.min(axis=0), corners.max(axis=0)
    # A border of three texels, so that filtering of shadows on geometry never leaves the map.
    side = max(float((high - low)[:2].max()), 1e-3) * size / (size - 6)
    side = 2.0 ** (np.ceil(np.log2(side) / _STEP) * _STEP)
    texel = side / size
    centre = np.round((low + high)[:2] / 2.0 / texel) * texel
    depth = max(float(high[2] - low[2]) * 1.02, 1e-3)
    clip = np.eye(4)
    clip[:2, :3] = R_sun_world[:2] * (2.0 / side)
    clip[:2, 3] = -centre * (2.0 / side)
    clip[2, :3] = R_sun_world[2] / depth
    clip[2, 3] = -((low[2] + high[2]) / 2.0 - depth / 2.0) / depth
    return clip, texel


class SunShadow:
    """The shadow map of the sun.

    Args:
        context: it must be current in every call.
        to_sun: (3,), direction towards the sun, world frame.
        size: side of the map, texels.
    """

    def __init__(self, context: GlContext, to_sun: F64, size: int = SHADOW_PX) -> None:
        self._gl = gl = GL.Gl(context)
        self._to_sun = np.asarray(to_sun, dtype=np.float64) / max(float(np.linalg.norm(to_sun)), 1e-12)
        self.size = min(size, gl.integer(GL.MAX_TEXTURE_SIZE))
        """Side of the map, texels."""
        self._drawn_poses: bytes = b""
        self._fit: Mat4 | None = None
        self.texel = 1.0
        """Size of a texel, metres."""
        self.drawn = 0
        """Number of times the map was drawn."""
        # Static geometry has a separate map: moving geometry is drawn over a copy of it.
        self._static = self._texture()
        self._all = self._texture()
        self._framebuffers = [self._framebuffer(texture) for texture in (self._static, self._all)]

    def update(self, scene: ShadowCasters, T_world_links: F64) -> Mat4:
        """Redraws the map if geometry has moved; changes the framebuffer binding.

        Returns:
            shadow_from_world, (4, 4), to texture coordinates and depth, all 0 to 1.
        """
        moves = scene.moves()
        fit, texel = self._fit, self.texel
        if fit is None or moves:
            fit, texel = fit_sun(scene.bounds(T_world_links), self._to_sun, self.size)
        refit = self._fit is None or not np.array_equal(fit, self._fit)
        poses = T_world_links.tobytes() if moves else b"still"
        if refit or poses != self._drawn_poses:
            self._fit, self.texel, self._drawn_poses = fit, texel, poses
            self._draw(scene, T_world_links, refit, moves)
        to_unit = np.diag([0.5, 0.5, 1.0, 1.0])
        to_unit[:2, 3] = 0.5
        return np.asarray(to_unit @ fit)

    def _draw(self, scene: ShadowCasters, T_world_links: F64, refit: bool, moves: bool) -> None:
        gl = self._gl
        assert self._fit is not None
        self.drawn += 1
        static, everything = self._framebuffers
        if refit:
            self._begin(static if moves else everything)
            scene.draw_depth(self._fit, T_world_links, self.texel, static=True, moving=False)
        if moves:
            size = self.size
            gl.glCopyImageSubData(
                self._static, GL.TEXTURE_2D, 0, 0, 0, 0, self._all, GL.TEXTURE_2D, 0, 0, 0, 0, size, size, 1
            )  # fmt: skip
            self._begin(everything, clear=False)
            scene.draw_depth(self._fit, T_world_links, self.texel, static=False, moving=True)

    def _begin(self, framebuffer: int, *, clear: bool = True) -> None:
        gl = self._gl
        gl.glBindFramebuffer(GL.FRAMEBUFFER, framebuffer)
        gl.glViewport(0, 0, self.size, self.size)
        gl.glClipControl(GL.LOWER_LEFT, GL.ZERO_TO_ONE)
        gl.glEnable(GL.DEPTH_TEST)
        for state in (GL.CULL_FACE, GL.BLEND, GL.PRIMITIVE_RESTART, GL.SCISSOR_TEST):
            gl.glDisable(state)
        gl.glDepthFunc(GL.GREATER)
        gl.glDepthMask(1)
        if clear:
            nothing = np.zeros(1, dtype=np.float32)
            gl.glClearBufferfv(GL.DEPTH, 0, nothing.ctypes.data)

    def bind(self) -> None:
        """Binds the map to its texture unit."""
        self._gl.glBindTextureUnit(_UNIT, self._all)
        self._gl.glBindSampler(_UNIT, 0)

    def _texture(self) -> int:
        gl = self._gl
        texture = gl.create("glCreateTextures", GL.TEXTURE_2D)
        gl.glTextureStorage2D(texture, 1, GL.DEPTH_COMPONENT32F, self.size, self.size)
        for name, value in (
            (GL.TEXTURE_MIN_FILTER, GL.LINEAR), (GL.TEXTURE_MAG_FILTER, GL.LINEAR), (GL.TEXTURE_WRAP_S, GL.CLAMP_TO_EDGE),
            (GL.TEXTURE_WRAP_T, GL.CLAMP_TO_EDGE), (GL.TEXTURE_COMPARE_MODE, GL.COMPARE_REF_TO_TEXTURE),
            (GL.TEXTURE_COMPARE_FUNC, GL.GEQUAL),
        ):  # fmt: skip
            gl.glTextureParameteri(texture, name, value)
        return texture

    def _framebuffer(self, texture: int) -> int:
        gl = self._gl
        framebuffer = gl.create("glCreateFramebuffers")
        gl.glNamedFramebufferTexture(framebuffer, GL.DEPTH_ATTACHMENT, texture, 0)
        gl.glNamedFramebufferDrawBuffers(framebuffer, 0, 0)
        status = gl.glCheckNamedFramebufferStatus(framebuffer, GL.FRAMEBUFFER)
        if status != GL.FRAMEBUFFER_COMPLETE:
            raise RenderError(
                f"the driver does not support a shadow map of {self.size}x{self.size} texels (status 0x{status:x}); turn shadows off"
            )
        return framebuffer

    def close(self) -> None:
        """Frees the GPU resources; a second call does nothing."""
        framebuffers, self._framebuffers = self._framebuffers, []
        for framebuffer in framebuffers:
            self._gl.delete("glDeleteFramebuffers", framebuffer)
        for texture in (self._static, self._all) if framebuffers else ():
            self._gl.delete("glDeleteTextures", texture)
