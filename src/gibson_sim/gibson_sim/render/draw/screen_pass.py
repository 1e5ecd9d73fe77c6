"""Full-screen passes: run a fragment shader for each pixel of a target, to process images on the GPU."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from importlib.resources import files
from typing import Any

import moderngl
import numpy as np

from gibson_sim.errors import RenderError
from gibson_sim.render.context import GlContext, gl as GL
from gibson_sim.render.draw.target import RenderTarget

FULL_SCREEN = """#version 450 core
void main() {
    gl_Position = vec4(gl_VertexID == 1 ? 3.0 : -1.0, gl_VertexID == 2 ? 3.0 : -1.0, 0.5, 1.0);
}
"""
"""Vertex shader of one triangle that covers the whole target."""


def shader_text(name: str, defines: Sequence[str] = (), includes: Sequence[str] = ()) -> str:
    """Returns the source of a shader in ``render/shaders``, preceded by a version line, ``#define``s and the files ``includes``."""
    folder = files("gibson_sim.render").joinpath("shaders")
    text = "".join(folder.joinpath(file).read_text(encoding="utf-8") for file in (*includes, name))
    return "#version 450 core\n" + "".join(f"#define {d}\n" for d in defines) + text


class ScreenPass:
    """A fragment shader that fills a ``RenderTarget``.

    Args:
        context: it must be current in every call.
        fragment: file in ``render/shaders`` whose outputs have the locations of the target's attachments.
        samplers: names of its samplers, for the texture units 0, 1, ...
        defines: preprocessor macros, ``NAME`` or ``NAME value``.
    """

    def __init__(self, context: GlContext, fragment: str, samplers: Sequence[str], defines: Sequence[str] = ()) -> None:
        self._gl = GL.Gl(context)
        self._program: moderngl.Program | None = context.gl.program(
            vertex_shader=FULL_SCREEN, fragment_shader=shader_text(fragment, defines)
        )
        self._array = context.gl.vertex_array(self._program, [])
        self._samplers = tuple(samplers)
        for unit, name in enumerate(samplers):
            if name in self._program:  # the compiler removes unused uniforms
                self._program[name] = unit

    def run(self, target: RenderTarget, textures: Sequence[int], uniforms: Mapping[str, Any] = {}) -> None:
        """Fills all of ``target``.

        Args:
            target: target to fill; none of the textures may belong to it.
            textures: OpenGL names, one for each sampler.
            uniforms: values by name: numbers, tuples, or float32 arrays; matrices are column-major.
        """
        if self._program is None:
            raise RenderError("the screen pass is closed; create a new one")
        assert len(textures) == len(self._samplers)
        for name, value in uniforms.items():
            if name not in self._program:
                continue
            if isinstance(value, np.ndarray):
                self._program[name].write(np.ascontiguousarray(value))  # type: ignore[union-attr]
            else:
                self._program[name] = value
        target.use()
        gl = self._gl
        for state in (GL.BLEND, GL.CULL_FACE):
            gl.glDisable(state)
        for state in (GL.DEPTH_TEST, GL.FRAMEBUFFER_SRGB):
            gl.glEnable(state)
        gl.glClipControl(GL.LOWER_LEFT, GL.ZERO_TO_ONE)
        gl.glDepthFunc(GL.ALWAYS)
        gl.glDepthMask(1)
        for unit, texture in enumerate(textures):
            gl.glBindSampler(unit, 0)
            gl.glBindTextureUnit(unit, texture)
        gl.glUseProgram(self._program.glo)
        gl.glBindVertexArray(self._array.glo)
        gl.glDrawArrays(GL.TRIANGLES, 0, 3)

    def close(self) -> None:
        """Frees the GPU resources; a second call does nothing. The context must be current."""
        if self._program is not None:
            self._array.release()
            self._program.release()
            self._program = None
