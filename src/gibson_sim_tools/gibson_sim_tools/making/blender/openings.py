"""Models the frames of windows and doors. NumPy only."""

from __future__ import annotations

import numpy as np

from gibson_sim_tools.making.blender.appearances import surface_of
from gibson_sim_tools.making.blender.shapes import F64, ObjectBuilder, Surface
from gibson_sim_tools.making.building import Opening, Wall

_FRAME = 0.055
_TRIM = (0.06, 0.014)
"""Width and thickness of the boards around a door, m."""


class _OpeningFrame:
    """Local frame of an opening, m: along the wall from its centre, to the left from the wall's centre plane, up from the lower edge."""

    def __init__(self, wall: Wall, opening: Opening, floor_z: float) -> None:
        u = np.subtract(wall.end, wall.start)
        self.u = u / np.linalg.norm(u)
        self.n = np.array([-self.u[1], self.u[0]])
        self.middle = np.asarray(wall.start) + self.u * opening.middle
        self.z = floor_z + opening.sill

    def at(self, along: float, out: float, up: float) -> F64:
        return np.array([*(self.middle + self.u * along + self.n * out), self.z + up])


def _reveal(s: ObjectBuilder, frame: _OpeningFrame, wall: Wall, opening: Opening, surface: Surface, below: bool) -> None:
    """Adds the reveals of an opening."""
    a, t, h = opening.width / 2, wall.thickness / 2, opening.height
    s.quad([frame.at(-a, t, 0), frame.at(-a, -t, 0), frame.at(-a, -t, h), frame.at(-a, t, h)][::-1], surface)
    s.quad([frame.at(a, -t, 0), frame.at(a, t, 0), frame.at(a, t, h), frame.at(a, -t, h)][::-1], surface)
    s.quad([frame.at(-a, -t, h), frame.at(a, -t, h), frame.at(a, t, h), frame.at(-a, t, h)][::-1], surface)
    if below:
        s.quad([frame.at(-a, -t, 0), frame.at(a, -t, 0), frame.at(a, t, 0), frame.at(-a, t, 0)], surface)


def window(s: ObjectBuilder, wall: Wall, opening: Opening, floor_z: float) -> None:
    """Adds frame, mullions, handles and inner sill of a window; the frame is near the outside."""
    frame, a, h = _OpeningFrame(wall, opening, floor_z), opening.width / 2, opening.height
    inside = 1.0 if wall.left else -1.0
    _reveal(s, frame, wall, opening, surface_of("plaster_white"), below=True)
    if opening.sill > 0.2:
        s.box(
            frame.at(-a - 0.04, inside * wall.thickness / 2, -0.025),
            frame.at(a + 0.04, inside * (wall.thickness / 2 + 0.035), 0.004),
            surface_of("wood_white"),
            0.004,
        )
        s.box(frame.at(-a, inside * wall.thickness / 2, 0.001), frame.at(a, 0, 0.004), surface_of("wood_white"), 0)
    if opening.body:
        return
    white, out = surface_of("plastic_white"), -inside * (wall.thickness / 2 - 0.07)
    front, back = out - 0.03, out + 0.03
    s.box(frame.at(-a, front, 0), frame.at(-a + _FRAME, back, h), white, 0.005)
    s.box(frame.at(a, front, 0), frame.at(a - _FRAME, back, h), white, 0.005)
    s.box(frame.at(-a + _FRAME, front, 0), frame.at(a - _FRAME, back, _FRAME), white, 0.005)
    s.box(frame.at(-a + _FRAME, front, h - _FRAME), frame.at(a - _FRAME, back, h), white, 0.005)
    count = max(1, round(opening.width / 0.9))
    for k in range(1, count):
        x = -a + opening.width * k / count
        s.box(frame.at(x - 0.045, front, _FRAME), frame.at(x + 0.045, back, h - _FRAME), white, 0.005)
    for k in range(count):
        x0, x1 = -a + opening.width * k / count, -a + opening.width * (k + 1) / count
        handle = x1 - 0.03 if k % 2 == 0 else x0 + 0.03
        grip = out + inside * 0.05
        if opening.sill < 1.4:
            s.tube(
                [frame.at(handle, out, h * 0.45), frame.at(handle, grip, h * 0.45), frame.at(handle, grip, h * 0.45 - 0.11)],
                0.008,
                surface_of("metal_steel"),
                6,
            )
    low, high = frame.at(-a, -0.04, 0), frame.at(a, 0.04, h)
    s.collide(low, high)


def door_frame(s: ObjectBuilder, wall: Wall, opening: Opening, floor_z: float) -> None:
    """Adds the lining and the trim of a door, or the reveals of a passage; the clear opening keeps its planned width."""
    frame, a, h = _OpeningFrame(wall, opening, floor_z), opening.width / 2, opening.height
    if opening.kind == "passage":
        _reveal(s, frame, wall, opening, surface_of("plaster_white"), below=False)
        return
    white = surface_of("wood_white")
    _reveal(s, frame, wall, opening, white, below=False)
    for side, room in ((1.0, wall.left), (-1.0, wall.right)):
        if not room:
            continue
        t0, t1 = side * wall.thickness / 2, side * (wall.thickness / 2 + _TRIM[1])
        for k in (-1, 1):
            s.box(frame.at(k * a, t0, 0), frame.at(k * (a + _TRIM[0]), t1, h + _TRIM[0]), white, 0.004)
        s.box(frame.at(-a, t0, h), frame.at(a, t1, h + _TRIM[0]), white, 0.004)
