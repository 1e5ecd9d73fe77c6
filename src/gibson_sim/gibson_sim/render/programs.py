"""The shader programs of a scene: one for each set of what a batch and a target need, compiled at its first use."""

from __future__ import annotations

import moderngl
import numpy as np

from gibson_sim.render.batches import Batch, Batches
from gibson_sim.render.context import GlContext
from gibson_sim.render.screen_pass import shader_text
from gibson_sim.render.target import Feature

_UNIFORMS = (("u_color", "color"), ("u_surface", "surface"), ("u_glow", "glow"), ("u_maps", "maps"))
"""Of a program whose triangles all have one material: name, and field of ``MATERIAL``."""


class Programs:
    """Programs of one context; it must be current in every call."""

    def __init__(self, context: GlContext) -> None:
        self._context = context
        self._made: dict[tuple[str, ...], moderngl.Program] = {}
        self._of_batch: dict[tuple[int, tuple[Feature, ...], bool], moderngl.Program] = {}
        self._batches: Batches | None = None
        self._light: tuple[str, ...] = ()
        self._settings: dict[int, tuple[int, bool]] = {}

    def take(self, batches: Batches, light: tuple[str, ...]) -> None:
        """Makes the programs that pictures of these batches need, so that the first image does not wait for the compiler.

        Args:
            batches: what is drawn from now on.
            light: what ``Lighting.defines`` says.
        """
        self._batches, self._light = batches, light
        self._of_batch, self._settings = {}, {}
        for number, batch in enumerate(batches.batches):
            self.of(number, ())
            self.depth(moving=batch.moving)

    def of(self, number: int, features: tuple[Feature, ...], *, color: bool = True) -> moderngl.Program:
        """Returns the program for a batch; without colour it fills depth and features only."""
        key = (number, features, color)
        if key not in self._of_batch:
            assert self._batches is not None
            self._of_batch[key] = self._find(self._batches.batches[number], features, color)
        return self._of_batch[key]

    def depth(self, *, moving: bool) -> moderngl.Program:
        """Returns the program that fills the depth with what has no holes."""
        return self._program(("MOVING",) if moving else (), "depth.frag", ())

    def _find(self, batch: Batch, features: tuple[Feature, ...], color: bool) -> moderngl.Program:
        cut = batch.kind != "opaque"
        if not (color or features or cut):
            return self.depth(moving=batch.moving)
        lights = color and not batch.unlit
        flags = {
            "MOVING": batch.moving, "CUT": cut, "UNLIT": not lights, "TEXTURED": batch.texture >= 0 and (cut or color),
            "MATERIALS": batch.material < 0,
            "SURFACE": lights or "FLOW" in features, "TURNED": lights or "NORMALS" in features,
            "LOOKED": color and batch.looked, "COLORED": color and batch.colored,
        }  # fmt: skip
        lit: tuple[str, ...] = ()
        if lights:
            lit = (*self._light, *(("GLOSS",) if batch.glossy else ()), *(("MATERIAL_MAPS",) if batch.maps >= 0 else ()))
        before = ("view.glsl", *(("lighting.glsl",) if lights else ()), *(("looks.glsl",) if flags["LOOKED"] else ()))
        return self._program((*(name for name, on in flags.items() if on), *lit, *features), "scene.frag", before)

    def _program(self, defines: tuple[str, ...], fragment: str, before: tuple[str, ...]) -> moderngl.Program:
        key = (fragment, *defines)
        if key not in self._made:
            program = self._context.gl.program(
                vertex_shader=shader_text("scene.vert", defines, ("view.glsl",)),
                fragment_shader=shader_text(fragment, defines, before),
            )
            if "u_texture" in program:
                program["u_texture"] = 0
            self._made[key] = program
        return self._made[key]

    def set(self, program: moderngl.Program, batch: Batch, *, translucent: bool) -> None:
        """Tells a program what it must know of a batch, unless it was the last thing that it was told."""
        settings = batch.material, translucent
        if self._settings.get(program.glo) == settings:
            return
        self._settings[program.glo] = settings
        if "u_translucent" in program:
            program["u_translucent"] = translucent
        if batch.material >= 0:
            assert self._batches is not None
            row = self._batches.materials[batch.material]
            for name, column in _UNIFORMS:
                if name in program:
                    program[name].write(np.ascontiguousarray(row[column]))  # type: ignore[union-attr]

    def close(self) -> None:
        """Frees them; a second call does nothing."""
        programs, self._made, self._of_batch = self._made, {}, {}
        for program in programs.values():
            program.release()
