"""The shader programs of a scene: one for each set of what a batch and a target need, compiled at its first use."""

from __future__ import annotations

from dataclasses import dataclass

import moderngl
import numpy as np

from gibson_sim.render.batching.batches import MATERIAL, Batch, Batches
from gibson_sim.render.context import GlContext, gl as GL
from gibson_sim.render.draw.screen_pass import shader_text
from gibson_sim.render.draw.target import Feature

_UNIFORMS = (("u_color", "color"), ("u_surface", "surface"), ("u_glow", "glow"), ("u_maps", "maps"))
"""Of a program whose triangles all have one material: name, and field of ``MATERIAL``."""


@dataclass(slots=True, eq=False)
class Program:
    """A program, and where it takes what differs from batch to batch."""

    made: moderngl.Program
    number: int
    """OpenGL's."""
    translucent: int
    """Location of ``u_translucent``; -1 = it has none."""
    material: tuple[tuple[int, int], ...]
    """Location, and offset in ``MATERIAL``, bytes, of each part of a material that it takes."""
    told: tuple[int, bool] | None = None
    """What it was told last: row of the material, -1 = none, and whether it draws what shines through."""


class Programs:
    """Programs of one context; it must be current in every call."""

    def __init__(self, context: GlContext) -> None:
        self._context, self._gl = context, GL.Gl(context)
        self._made: dict[tuple[str, ...], Program] = {}
        self._of_batch: dict[tuple[int, tuple[Feature, ...], bool], Program] = {}
        self._batches: Batches | None = None
        self._light: tuple[str, ...] = ()
        self._materials = np.zeros(0, dtype=MATERIAL)
        self._rows = 0  # where they lie in memory

    def take(self, batches: Batches, light: tuple[str, ...]) -> None:
        """Makes the programs that pictures of these batches need, so that the first image does not wait for the compiler.

        Args:
            batches: what is drawn from now on.
            light: what ``Lighting.defines`` says.
        """
        self._batches, self._light = batches, light
        self._materials = np.ascontiguousarray(batches.materials)
        self._rows = self._materials.ctypes.data
        self._of_batch = {}
        for program in self._made.values():
            program.told = None
        for number, batch in enumerate(batches.batches):
            self.of(number, ())
            self.depth(moving=batch.moving)

    def of(self, number: int, features: tuple[Feature, ...], *, color: bool = True) -> Program:
        """Returns the program for a batch; without colour it fills depth and features only."""
        key = (number, features, color)
        if key not in self._of_batch:
            assert self._batches is not None
            self._of_batch[key] = self._find(self._batches.batches[number], features, color)
        return self._of_batch[key]

    def depth(self, *, moving: bool) -> Program:
        """Returns the program that fills the depth with what has no holes."""
        return self._program(("MOVING",) if moving else (), "depth.frag", ())

    def _find(self, batch: Batch, features: tuple[Feature, ...], color: bool) -> Program:
        cut = batch.kind != "opaque"
        if not (color or features or cut):
            return self.depth(moving=batch.moving)
        lights = color and not batch.unlit
        flags = {
            "MOVING": batch.moving, "CUT": cut, "UNLIT": not lights, "TEXTURED": batch.texture >= 0 and (cut or color),
            "MATERIALS": batch.material < 0,
            "SURFACE": lights or "FLOW" in features, "TURNED": lights or "NORMALS" in features,
            "APPEARANCE": color and batch.has_appearance, "COLORED": color and batch.colored,
        }  # fmt: skip
        lit: tuple[str, ...] = ()
        if lights:
            lit = (*self._light, *(("GLOSS",) if batch.glossy else ()), *(("MATERIAL_MAPS",) if batch.maps >= 0 else ()))
        before = ("view.glsl", *(("lighting.glsl",) if lights else ()), *(("appearances.glsl",) if flags["APPEARANCE"] else ()))
        return self._program((*(name for name, on in flags.items() if on), *lit, *features), "scene.frag", before)

    def _program(self, defines: tuple[str, ...], fragment: str, before: tuple[str, ...]) -> Program:
        key = (fragment, *defines)
        if key not in self._made:
            made = self._context.gl.program(
                vertex_shader=shader_text("scene.vert", defines, ("view.glsl",)),
                fragment_shader=shader_text(fragment, defines, before),
            )
            if "u_texture" in made:
                made["u_texture"] = 0
            parts = tuple((_location(made, name), MATERIAL.fields[part][1]) for name, part in _UNIFORMS)  # type: ignore[index]
            taken = tuple((location, offset) for location, offset in parts if location >= 0)
            self._made[key] = Program(made, made.glo, _location(made, "u_translucent"), taken)
        return self._made[key]

    def tell(self, program: Program, material: int, *, translucent: bool) -> None:
        """Tells a program what it must know of a batch, unless it was the last thing that it was told.

        Args:
            program: of the batch.
            material: of all its triangles, its row in ``Batches.materials``; -1 = they have several.
            translucent: whether what shines through is drawn, instead of what is solid.
        """
        told = material, translucent
        if program.told == told:
            return
        program.told = told
        if program.translucent >= 0:
            self._gl.glProgramUniform1i(program.number, program.translucent, translucent)
        if material >= 0:
            row = self._rows + material * MATERIAL.itemsize
            for location, offset in program.material:
                self._gl.glProgramUniform4fv(program.number, location, 1, row + offset)

    def close(self) -> None:
        """Frees them; a second call does nothing."""
        programs, self._made, self._of_batch = self._made, {}, {}
        for program in programs.values():
            program.made.release()


def _location(program: moderngl.Program, name: str) -> int:
    """Returns where a program takes a number; -1 = it does not."""
    member = program.get(name, None)
    return member.location if isinstance(member, moderngl.Uniform) else -1
