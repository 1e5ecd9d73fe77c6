"""Effects of real cameras on colours, as passes over a rendered image: averaging of pictures, exposure, white balance, vignette, noise.

All effects are computed in linear light. They change neither depth, labels nor normals.
"""

from __future__ import annotations

import math
import zlib
from collections.abc import Sequence
from typing import Any

import moderngl
import numpy as np
from numpy.typing import NDArray

from gibson_sim.errors import RenderError
from gibson_sim.geometry.transforms import Mat3
from gibson_sim.render.context import GlContext, gl as GL
from gibson_sim.render.draw.screen_pass import FULL_SCREEN, ScreenPass, shader_text
from gibson_sim.render.draw.target import RenderTarget
from gibson_sim.types import CameraSpec, ImageEffects

DAYLIGHT_K = 6500.0
"""Colour temperature at which the white balance is the identity, kelvin."""

_XYZ_FROM_RGB: Mat3 = np.array(
    [[0.4123908, 0.3575843, 0.1804808], [0.2126390, 0.7151687, 0.0721923], [0.0193308, 0.1191948, 0.9505322]]
)
"""Linear sRGB to CIE XYZ (IEC 61966-2-1)."""
_CONES_FROM_XYZ: Mat3 = np.array([[0.8951, 0.2664, -0.1614], [-0.7502, 1.7135, 0.0367], [0.0389, -0.0685, 1.0296]])
"""The Bradford cone responses (Lam 1985; CIE 160:2004)."""
_MAX_DRAFTS = 4
"""Maximum number of cached intermediate targets."""


def changes_colors(effects: ImageEffects) -> bool:
    """Returns whether effects change colours; if not, the pass is skipped and pixels are bit-identical."""
    neutral = ImageEffects(shutter_s=effects.shutter_s, readout_s=effects.readout_s, seed=effects.seed)
    return effects != neutral


def planckian_xy(kelvin: float) -> tuple[float, float]:
    """Returns the CIE 1931 chromaticity of a black body, 1667 to 25000 K.

    The cubics of Kim et al., "Design of Advanced Color Temperature Control System for HDTV Applications", Journal of the Korean
    Physical Society 41 (6), 2002.
    """
    t = 1000.0 / kelvin
    if kelvin < 4000.0:
        x = ((-0.2661239 * t - 0.2343589) * t + 0.8776956) * t + 0.179910
    else:
        x = ((-3.0258469 * t + 2.1070379) * t + 0.2226347) * t + 0.240390
    if kelvin < 2222.0:
        y = ((-1.1063814 * x - 1.34811020) * x + 2.18555832) * x - 0.20219683
    elif kelvin < 4000.0:
        y = ((-0.9549476 * x - 1.37418593) * x + 2.09137015) * x - 0.16748867
    else:
        y = ((3.0817580 * x - 5.87338670) * x + 3.75112997) * x - 0.37001483
    return x, y


def white_balance_matrix(kelvin: float) -> Mat3:
    """Returns the (3, 3) matrix on linear sRGB under which a white surface lit by a black body of ``kelvin`` appears white.

    Von Kries adaptation of the Bradford cone responses, from that light to 6500 K, where the matrix is the identity.
    """
    if kelvin == DAYLIGHT_K:
        return np.eye(3)
    cones = [_CONES_FROM_XYZ @ (x / y, 1.0, (1.0 - x - y) / y) for x, y in (planckian_xy(kelvin), planckian_xy(DAYLIGHT_K))]
    to_cones = _CONES_FROM_XYZ @ _XYZ_FROM_RGB
    matrix: Mat3 = np.linalg.inv(to_cones) @ np.diag(cones[1] / cones[0]) @ to_cones
    return matrix


def noise_key(effects: ImageEffects, stamp_ns: int, camera: str) -> tuple[int, int]:
    """Returns the key of an image's noise, two 32-bit numbers; keys of different cameras and images differ."""
    first, second = np.random.SeedSequence([effects.seed, stamp_ns, zlib.crc32(camera.encode())]).generate_state(2)
    return int(first), int(second)


def corner_cosine(camera: CameraSpec) -> float:
    """Returns the cosine between the optical axis and the ray through the farthest corner pixel, without distortion."""
    inverse = np.linalg.inv(camera.intrinsics())
    corners = np.array([[u, v, 1.0] for u in (0, camera.width - 1) for v in (0, camera.height - 1)])
    farthest = float(np.linalg.norm((corners @ inverse.T)[:, :2], axis=1).max())
    return math.cos(min(farthest, math.pi / 2)) if camera.projection == "fisheye" else 1.0 / math.hypot(1.0, farthest)


def uniforms_of(camera: CameraSpec, stamp_ns: int) -> dict[str, Any]:
    """Returns the uniforms of effects.frag; matrices are float32, column-major."""
    effects = camera.effects
    falloff = 1.0 - corner_cosine(camera) ** 4
    return {
        "u_exposure": 2.0**effects.exposure_ev,
        "u_white_balance": white_balance_matrix(effects.white_balance_k).T.astype(np.float32),
        "u_ray_from_pixel": np.linalg.inv(camera.intrinsics()).T.astype(np.float32),
        "u_vignette": effects.vignette / falloff if falloff > 0.0 else 0.0,
        "u_variance": (effects.read_noise**2, effects.shot_noise**2),
        "u_key": noise_key(effects, stamp_ns, camera.name),
    }


def copy_image(
    context: GlContext,
    source: RenderTarget,
    target: RenderTarget,
    names: Sequence[str],
    rectangle: tuple[int, int, int, int],
    place: tuple[int, int],
) -> None:
    """Copies a rectangle (x, y, width, height) of attachments of one target to position (x, y) in another, bit by bit."""
    gl = GL.Gl(context)
    x, y, width, height = rectangle
    for name in names:
        gl.glCopyImageSubData(
            source.textures[name], GL.TEXTURE_2D, 0, x, y, 0, target.textures[name], GL.TEXTURE_2D, 0, *place, 0, width, height, 1
        )


class EffectsPass:
    """Applies the colour effects of ``CameraSpec.effects``.

    Args:
        context: it must be current in every call.
    """

    def __init__(self, context: GlContext) -> None:
        self._context = context
        self._passes: dict[tuple[str, ...], ScreenPass] = {}
        self._drafts: dict[tuple[int, int], RenderTarget] = {}
        self._average: Average | None = None

    def begin(self, width: int, height: int) -> None:
        """Starts averaging pictures of the given size, pixels."""
        if self._average is not None and (self._average.width, self._average.height) != (width, height):
            self._average.close()
            self._average = None
        if self._average is None:
            self._average = Average(self._context, width, height)
        self._average.clear()

    def add(self, color: int, rows: slice, weight: float, first: int | None = None, normals: int | None = None) -> None:
        """Adds rows of a picture to the average.

        Args:
            color: OpenGL name of a texture that is linear when sampled, as wide as given to ``begin``.
            rows: rows of the image; start and stop are given.
            weight: weight of the picture; the weights of a row sum to 1.
            first: row of the texture with the first of these rows; None = ``rows.start``.
            normals: OpenGL name of the picture's normals, which mark its holes for ``Average.holes``; None = no holes.
        """
        self.average.add(color, rows, weight, rows.start if first is None else first, normals)

    @property
    def average(self) -> Average:
        """The average."""
        if self._average is None:
            raise RenderError("averaging has not begun; call begin first")
        return self._average

    def run(
        self, camera: CameraSpec, stamp_ns: int, color: int | None, out: RenderTarget, origin: tuple[int, int] = (0, 0)
    ) -> None:
        """Fills the colours of ``out``; its depth is overwritten, further outputs are undefined.

        Args:
            camera: camera whose effects, size and intrinsics are used.
            stamp_ns: stamp of the image; it keys the noise.
            color: OpenGL name of the source texture, linear when sampled; None = the average.
            out: target of the camera's size; ``color`` must not be one of its textures.
            origin: column and row of the image's top left corner in ``color``.
        """
        color = self.average.texture if color is None else color
        noisy = camera.effects.read_noise > 0.0 or camera.effects.shot_noise > 0.0
        defines = (*(("NOISE",) if noisy else ()), *(("ANGULAR",) if camera.projection == "fisheye" else ()))
        if defines not in self._passes:
            self._passes[defines] = ScreenPass(self._context, "effects.frag", ("u_color",), defines)
        self._passes[defines].run(out, (color,), {**uniforms_of(camera, stamp_ns), "u_origin": origin})

    def apply(self, camera: CameraSpec, stamp_ns: int, target: RenderTarget, x: int, y: int, *, average: bool = False) -> None:
        """Applies the effects to an image in a target, in place.

        Args:
            camera: camera of the image.
            stamp_ns: stamp of the image.
            target: target with the image, without multisampling.
            x: column of the image's left edge.
            y: row of its top edge.
            average: apply the effects to the average instead of the image.
        """
        size = (camera.width, camera.height)
        if size not in self._drafts:
            if len(self._drafts) >= _MAX_DRAFTS:
                self._drafts.pop(next(iter(self._drafts))).close()
            self._drafts[size] = RenderTarget(self._context, *size)
        draft = self._drafts[size]
        self.run(camera, stamp_ns, None if average else target.textures["color"], draft, (0, 0) if average else (x, y))
        copy_image(self._context, draft, target, ("color",), (0, 0, *size), (x, y))

    def close(self) -> None:
        """Frees all GPU resources; a second call does nothing. The context must be current."""
        passes, drafts, average = self._passes, self._drafts, self._average
        self._passes, self._drafts, self._average = {}, {}, None
        for screen_pass in passes.values():
            screen_pass.close()
        for draft in drafts.values():
            draft.close()
        if average is not None:
            average.close()


class Average:
    """A weighted sum of pictures in 32-bit floats."""

    def __init__(self, context: GlContext, width: int, height: int) -> None:
        self._gl = GL.Gl(context)
        gl = context.gl
        self.width, self.height = width, height
        self._texture: moderngl.Texture = gl.texture((width, height), 4, dtype="f4")
        self._framebuffer = gl.framebuffer([self._texture])
        self._program = gl.program(vertex_shader=FULL_SCREEN, fragment_shader=shader_text("accumulate.frag"))
        self._program["u_color"], self._program["u_normals"] = 0, 1
        self._array = gl.vertex_array(self._program, [])

    @property
    def texture(self) -> int:
        """OpenGL name of the texture with the sum; alpha is above 0 where at least one picture has a hole."""
        return int(self._texture.glo)

    def clear(self) -> None:
        """Sets the sum to 0."""
        self._framebuffer.clear()

    def holes(self) -> NDArray[np.bool_]:
        """Returns the mask, (H, W), of the pixels that are holes in at least one picture."""
        sums = np.frombuffer(self._texture.read(), dtype=np.float32).reshape(self.height, self.width, 4)
        return np.asarray(sums[:, :, 3] > 0.0)

    def add(self, color: int, rows: slice, weight: float, first: int, normals: int | None) -> None:
        """See ``EffectsPass.add``."""
        gl = self._gl
        self._framebuffer.use()
        for state in (GL.DEPTH_TEST, GL.CULL_FACE):
            gl.glDisable(state)
        for state in (GL.BLEND, GL.SCISSOR_TEST):
            gl.glEnable(state)
        gl.glBlendFunc(GL.ONE, GL.ONE)
        gl.glScissor(0, rows.start, self.width, rows.stop - rows.start)
        for unit, texture in enumerate((color, color if normals is None else normals)):
            gl.glBindSampler(unit, 0)
            gl.glBindTextureUnit(unit, texture)
        self._program["u_marks_holes"] = normals is not None
        self._program["u_weight"] = weight
        self._program["u_shift"] = first - rows.start
        self._array.render(GL.TRIANGLES, 3)
        for state in (GL.BLEND, GL.SCISSOR_TEST):
            gl.glDisable(state)

    def close(self) -> None:
        """Frees all GPU resources. The context must be current."""
        for handle in (self._array, self._program, self._framebuffer, self._texture):
            handle.release()
