"""Scenes that change while they are drawn: what was loaded stays as it is, and each body that comes later is a part of its own.

A change costs what is new and some arrays of one number a chunk: no mesh is read or cut twice, and equal bodies share their triangles.
No OpenGL here.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gibson_sim.description.shapes import VisualSpec
from gibson_sim.errors import ConfigError
from gibson_sim.render.batching.batches import MAX_LABEL, Batches, Loader
from gibson_sim.render.batching.building import build_batches
from gibson_sim.render.batching.parts import BODY, Join, Labels, Numbers, Part, Use
from gibson_sim.scenes.spec import DrawnScene

I64 = NDArray[np.int64]
_UNUSED_PARTS = 32
"""So many parts that nothing uses any more are kept: what was deleted often comes back."""


@dataclass(frozen=True, slots=True, eq=False)
class Change:
    """A scene after a change, and what of its large arrays is as it was before."""

    batches: Batches
    same_vertices: int
    """So many rows of ``vertices`` from the first on."""
    same_indices: int
    warnings: tuple[str, ...]
    """What of the new bodies could not be loaded."""


_Key = tuple[VisualSpec, ...]
_Geometry = tuple[_Key, bytes]
"""Part, and the labels that stand in its vertices, if any do."""


class Composition:
    """The batches of a scene through its changes.

    Args:
        scene: as it was loaded.
        base: the batches of it.
        loader: returns what reads the meshes of a scene.
        coarser: make levels of detail of what is new.
    """

    def __init__(self, scene: DrawnScene, base: Batches, loader: Callable[[DrawnScene], Loader], *, coarser: bool) -> None:
        self._scene, self._base, self._loader, self._coarser = scene, base, loader, coarser
        self._bodies = _by_body(scene.visuals)
        self._parts: dict[_Key, Part] = {}
        self._vertices, self._indices = _Rows(base.vertices), _Rows(base.indices)
        self._geometries: list[_Geometry] = []
        self._numbers = Numbers.of(scene)
        self._labels = Labels(self._numbers, self._numbers)

    def change(self, scene: DrawnScene) -> Change | None:
        """Returns the batches of another revision of the scene; None where more than bodies has changed: it must be loaded anew."""
        bodies, numbers = _by_body(scene.visuals), Numbers.of(scene)
        if scene.light != self._scene.light or bodies.get("", ()) != self._bodies.get("", ()):
            return None
        if max(len(numbers.classes), len(numbers.instances)) > MAX_LABEL + 1:
            raise ConfigError(
                f"the scene has {len(numbers.instances)} instances, at most {MAX_LABEL} can be told apart in an image"
            )
        kept = {name for name, visuals in self._bodies.items() if not name or self._stays(visuals, bodies.get(name), numbers)}
        uses: dict[_Key, list[str]] = {}
        warnings: list[str] = []
        for name, visuals in bodies.items():
            if name and name not in kept:
                lost = [visual for visual in visuals if visual.link not in numbers.links]
                warnings += (f"visual {v.name!r}: link {v.link!r} is not in the scene; it is not drawn" for v in lost)
                key = _canonical(name, [visual for visual in visuals if visual not in lost])
                if key not in self._parts:
                    self._parts[key] = self._read(key, scene)
                    warnings += (f"{name}: {warning}" for warning in self._parts[key].batches.warnings)
                uses.setdefault(key, []).append(name)
        self._forget_unused(uses)
        return self._composed(numbers, kept, uses, tuple(warnings))

    def _stays(self, before: Sequence[VisualSpec], now: Sequence[VisualSpec] | None, numbers: Numbers) -> bool:
        links = (numbers.links, self._numbers.links)
        return now == before and all((visual.link in links[0]) == (visual.link in links[1]) for visual in before)

    def _read(self, key: _Key, scene: DrawnScene) -> Part:
        links = tuple(dict.fromkeys(visual.link for visual in key))
        classes = ("", *sorted({visual.semantic_class for visual in key} - {""}))
        labels = [(classes.index(visual.semantic_class), 1) for visual in key]
        batches = build_batches(key, links, self._loader(scene), labels, coarser=self._coarser)
        return Part(batches, links, classes, bool(batches.vertices["label"].any()))

    def _forget_unused(self, uses: dict[_Key, list[str]]) -> None:
        unused = [key for key in self._parts if key not in uses]
        for key in unused[: max(0, len(unused) - _UNUSED_PARTS)]:
            del self._parts[key]

    def _composed(self, numbers: Numbers, kept: set[str], uses: dict[_Key, list[str]], warnings: tuple[str, ...]) -> Change:
        labels = Labels(self._numbers, numbers)
        join = Join(self._base)
        join.add_base(labels, *self._links_of_base(numbers, kept))
        same_vertices, same_indices = self._vertices.base, self._indices.base
        if labels != self._labels:
            same_vertices = 0
            self._vertices.write_base(labels.on(self._base.vertices))
            self._labels = labels
        geometries: list[_Geometry] = []
        vertex, index = self._vertices.base, self._indices.base
        still = True  # as long as everything stands where it stood
        for key, names in sorted(uses.items(), key=lambda use: self._order(use[0])):
            part = self._parts[key]
            place = join.place(part)
            groups: dict[bytes, list[Use]] = {}
            for use in (Use.of(part, name, numbers) for name in names):
                groups.setdefault(use.key if part.labelled else b"", []).append(use)
            for text, alike in groups.items():
                geometry = (key, text)
                still = still and self._geometries[len(geometries) : len(geometries) + 1] == [geometry]
                geometries.append(geometry)
                vertices, indices = part.batches.vertices, part.batches.indices
                if not still:
                    own = alike[0].on_vertices(vertices) if part.labelled else vertices
                    self._vertices.write(vertex, own)
                    self._indices.write(index, indices + np.uint32(vertex))
                elif same_vertices:
                    same_vertices, same_indices = vertex + len(vertices), index + len(indices)
                join.add(part, place, alike, index)
                vertex, index = vertex + len(vertices), index + len(indices)
        self._geometries = geometries
        batches = join.batches(self._vertices.first(vertex), self._indices.first(index))
        return Change(batches, same_vertices, same_indices, warnings)

    def _links_of_base(self, numbers: Numbers, kept: set[str]) -> tuple[I64, NDArray[np.bool_]]:
        """Returns the number that each link of the base has now, and whether it is still drawn, (L + 1,)."""
        names = self._numbers.links
        now = np.array([numbers.links.get(name, 0) for name in names])
        return now, np.array([name.partition("/")[0] in kept or not name for name in names])

    def _order(self, key: _Key) -> int:
        """Returns where a part stood, so that it stays there; new ones come last."""
        return next((k for k, (other, _) in enumerate(self._geometries) if other == key), len(self._geometries))


def _by_body(visuals: Sequence[VisualSpec]) -> dict[str, tuple[VisualSpec, ...]]:
    """Returns the visuals of each body; those of the standing world under the empty name."""
    found: dict[str, list[VisualSpec]] = {}
    for visual in visuals:
        found.setdefault(visual.link.partition("/")[0], []).append(visual)
    return {name: tuple(of) for name, of in found.items()}


def _canonical(name: str, visuals: Sequence[VisualSpec]) -> _Key:
    """Returns the visuals of a body under names that are the same for equal bodies."""
    return tuple(replace(visual, name=str(k), link=BODY + visual.link[len(name) :]) for k, visual in enumerate(visuals))


class _Rows:
    """An array that begins with rows that stay and has room for more."""

    def __init__(self, base: NDArray[Any]) -> None:
        self.base = len(base)
        self._rows = base

    def write_base(self, rows: NDArray[Any]) -> None:
        self._reserve(self.base)
        self._rows[: self.base] = rows

    def write(self, at: int, rows: NDArray[Any]) -> None:
        self._reserve(at + len(rows))
        self._rows[at : at + len(rows)] = rows

    def first(self, count: int) -> NDArray[Any]:
        return self._rows[:count]

    def _reserve(self, count: int) -> None:
        # What was loaded belongs to somebody else, and may be a file that cannot be written to.
        if len(self._rows) < count or len(self._rows) == self.base:
            rows = np.zeros(max(count + 4096, count + count // 4), dtype=self._rows.dtype)
            rows[: len(self._rows)] = self._rows
            self._rows = rows
