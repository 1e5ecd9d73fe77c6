"""The shader programs of a scene: one for each combination of settings of a batch and a target, compiled at first use."""

from __future__ import annotations

from dataclasses import dataclass

import moderngl
import numpy as np

from gibson_sim.render.batching.scene_geometry import MATERIAL, Batch, SceneGeometry
from gibson_sim.render.context import GlContext, gl as GL
from gibson_sim.render.draw.screen_pass import shader_text
from gibson_sim.render.draw.target import Feature

_MATERIAL_UNIFORMS = (("u_color", "color"), ("u_surface", "surface"), ("u_emission", "emission"), ("u_maps", "maps"))
"""Uniforms of a program whose triangles all have one material: name, and field of ``MATERIAL``."""


@dataclass(slots=True, eq=False)
class Program:
    """A program, and the locations of its uniforms that differ between batches."""

    handle: moderngl.Program
    number: int
    """OpenGL name of the program."""
    translucent: int
    """Location of ``u_translucent``; -1 = unused."""
    material: tuple[tuple[int, int], ...]
    """Location of each material uniform, and offset of its value in ``MATERIAL``, bytes."""
    current: tuple[int, bool] | None = None
    """Current uniforms: row of the material, -1 = none, and whether the translucent pass is drawn."""


class Programs:
    """Programs of one context; it must be current in every call."""

    def __init__(self, context: GlContext) -> None:
        self._context, self._gl = context, GL.Gl(context)
        self._programs: dict[tuple[str, ...], Program] = {}
        self._of_batch: dict[tuple[int, tuple[Feature, ...], bool], Program] = {}
        self._geometry: SceneGeometry | None = None
        self._light: tuple[str, ...] = ()
        self._materials = np.zeros(0, dtype=MATERIAL)
        self._materials_address = 0

    def prepare(self, geometry: SceneGeometry, light: tuple[str, ...]) -> None:
        """Compiles the programs needed for a geometry, so that the first image does not wait for the compiler.

        Args:
            geometry: geometry of the next pictures.
            light: ``Lighting.defines``.
        """
        self._geometry, self._light = geometry, light
        self._materials = np.ascontiguousarray(geometry.materials)
        self._materials_address = self._materials.ctypes.data
        self._of_batch = {}
        for program in self._programs.values():
            program.current = None
        for number, batch in enumerate(geometry.batches):
            self.of(number, ())
            self.depth(moving=batch.moving)

    def of(self, number: int, features: tuple[Feature, ...], *, color: bool = True) -> Program:
        """Returns the program of a batch; without ``color`` it writes only depth and features."""
        key = (number, features, color)
        if key not in self._of_batch:
            assert self._geometry is not None
            self._of_batch[key] = self._find(self._geometry.batches[number], features, color)
        return self._of_batch[key]

    def depth(self, *, moving: bool) -> Program:
        """Returns the program that writes the depth of surfaces without alpha-tested holes."""
        return self._program(("MOVING",) if moving else (), "depth.frag", ())

    def _find(self, batch: Batch, features: tuple[Feature, ...], color: bool) -> Program:
        has_holes = batch.alpha_mode != "opaque"
        if not (color or features or has_holes):
            return self.depth(moving=batch.moving)
        lights = color and not batch.unlit
        flags = {
            "MOVING": batch.moving, "ALPHA_TEST": has_holes, "UNLIT": not lights, "TEXTURED": batch.texture >= 0 and (has_holes or color),
            "MATERIALS": batch.material < 0,
            "WORLD_POSITION": lights or "FLOW" in features, "WORLD_NORMAL": lights or "NORMALS" in features,
            "LIGHT_MAP": color and batch.light_map >= 0,
            "APPEARANCE": color and batch.has_appearance, "VERTEX_COLORS": (color or has_holes) and batch.colored,
            "COLORS_BESIDE_UVS": (color or has_holes) and batch.colored and max(batch.texture, batch.maps) >= 0,
        }  # fmt: skip
        lit: tuple[str, ...] = ()
        if lights:
            lit = (*self._light, *(("GLOSS",) if batch.glossy else ()), *(("MATERIAL_MAPS",) if batch.maps >= 0 else ()))
        includes = ["view.glsl"]
        includes += ["lighting.glsl"] if lights else []
        includes += ["appearances.glsl"] if flags["APPEARANCE"] else []
        includes += ["tone.glsl"] if flags["LIGHT_MAP"] else []
        return self._program((*(name for name, on in flags.items() if on), *lit, *features), "scene.frag", tuple(includes))

    def _program(self, defines: tuple[str, ...], fragment: str, includes: tuple[str, ...]) -> Program:
        key = (fragment, *defines)
        if key not in self._programs:
            handle = self._context.gl.program(
                vertex_shader=shader_text("scene.vert", defines, ("view.glsl",)),
                fragment_shader=shader_text(fragment, defines, includes),
            )
            if "u_texture" in handle:
                handle["u_texture"] = 0
            uniforms = tuple((_location(handle, name), MATERIAL.fields[part][1]) for name, part in _MATERIAL_UNIFORMS)  # type: ignore[index]
            used = tuple((location, offset) for location, offset in uniforms if location >= 0)
            self._programs[key] = Program(handle, handle.glo, _location(handle, "u_translucent"), used)
        return self._programs[key]

    def set_uniforms(self, program: Program, material: int, *, translucent: bool) -> None:
        """Sets the uniforms of a program that differ between batches, unless they are current.

        Args:
            program: program of the batch.
            material: row in ``SceneGeometry.materials`` of the material of all its triangles; -1 = several materials.
            translucent: draw the translucent pass instead of the opaque pass.
        """
        uniforms = material, translucent
        if program.current == uniforms:
            return
        program.current = uniforms
        if program.translucent >= 0:
            self._gl.glProgramUniform1i(program.number, program.translucent, translucent)
        if material >= 0:
            row = self._materials_address + material * MATERIAL.itemsize
            for location, offset in program.material:
                self._gl.glProgramUniform4fv(program.number, location, 1, row + offset)

    def close(self) -> None:
        """Frees the programs; a second call does nothing."""
        programs, self._programs, self._of_batch = self._programs, {}, {}
        for program in programs.values():
            program.handle.release()


def _location(program: moderngl.Program, name: str) -> int:
    """Returns the location of a uniform; -1 = the program does not have it."""
    member = program.get(name, None)
    return member.location if isinstance(member, moderngl.Uniform) else -1
