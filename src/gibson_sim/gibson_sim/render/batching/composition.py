"""Scenes that change while they are drawn: loaded geometry is kept, and bodies added later are drawn with prototypes.

A change costs the new geometry and a few arrays of one number per cluster: no mesh is read or split into clusters twice, and equal bodies
share their triangles. No OpenGL.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gibson_sim.description.shapes import VisualSpec
from gibson_sim.errors import ConfigError
from gibson_sim.render.batching.building import build_geometry
from gibson_sim.render.batching.prototypes import BODY, BodyPrototype, GeometryMerger, LabelMap, PlacedBody, SceneNumbers
from gibson_sim.render.batching.scene_geometry import MAX_LABEL, Loader, SceneGeometry, joined_dtype, with_dtype
from gibson_sim.scenes.spec import DrawnScene

I64 = NDArray[np.int64]
_UNUSED_PROTOTYPES = 32
"""Number of unused prototypes that are kept: deleted bodies are often spawned again."""


@dataclass(frozen=True, slots=True, eq=False)
class SceneChange:
    """The geometry after a change, and the unchanged part of its large arrays."""

    geometry: SceneGeometry
    same_vertices: int
    """Number of leading rows of ``vertices`` that are unchanged."""
    same_indices: int
    """Number of leading ``indices`` that are unchanged."""
    warnings: tuple[str, ...]
    """One line for each item of the new bodies that could not be loaded."""


_Key = tuple[VisualSpec, ...]
_Stored = tuple[_Key, bytes]
"""Key of a prototype, and the labels in its vertices; empty if the labels are in the placements."""


class Composition:
    """The geometry of a scene that changes.

    Args:
        scene: the scene as loaded.
        base: its geometry.
        loader: returns the loader for the meshes of a scene.
        levels_of_detail: build levels of detail of new bodies.
    """

    def __init__(
        self, scene: DrawnScene, base: SceneGeometry, loader: Callable[[DrawnScene], Loader], *, levels_of_detail: bool
    ) -> None:
        self._scene, self._base, self._loader, self._levels_of_detail = scene, base, loader, levels_of_detail
        self._bodies = _by_body(scene.visuals)
        self._prototypes: dict[_Key, BodyPrototype] = {}
        self._vertices, self._indices = _Rows(base.vertices), _Rows(base.indices)
        self._stored: list[_Stored] = []
        self._numbers = SceneNumbers.of(scene)
        self._labels = LabelMap(self._numbers, self._numbers)

    def change(self, scene: DrawnScene) -> SceneChange | None:
        """Returns the geometry of another revision of the scene, or None if more than its bodies changed, so that it must be reloaded.

        Raises:
            ConfigError: there are more classes or instances than numbers for them.
        """
        if (scene.content_hash, scene.splats) != (self._scene.content_hash, self._scene.splats):
            return None  # under another content hash, the same names may refer to other files
        bodies, numbers = _by_body(scene.visuals), SceneNumbers.of(scene)
        if scene.light != self._scene.light or bodies.get("", ()) != self._bodies.get("", ()):
            return None
        if max(len(numbers.classes), len(numbers.instances)) > MAX_LABEL + 1:
            raise ConfigError(f"the scene has {len(numbers.instances)} instances, an image can distinguish at most {MAX_LABEL}")
        kept = {
            name for name, visuals in self._bodies.items() if not name or self._is_unchanged(visuals, bodies.get(name), numbers)
        }
        later: dict[_Key, list[str]] = {}
        warnings: list[str] = []
        for name, visuals in bodies.items():
            if name and name not in kept:
                unlinked = [visual for visual in visuals if visual.link not in numbers.links]
                warnings += (f"visual {v.name!r}: link {v.link!r} is not in the scene; it is not drawn" for v in unlinked)
                key = _canonical(name, [visual for visual in visuals if visual not in unlinked])
                if key not in self._prototypes:
                    self._prototypes[key] = self._load(key, scene)
                    warnings += (f"{name}: {warning}" for warning in self._prototypes[key].geometry.warnings)
                later.setdefault(key, []).append(name)
        self._forget_unused(later)
        return self._compose(numbers, kept, later, tuple(warnings))

    def _is_unchanged(self, old: Sequence[VisualSpec], new: Sequence[VisualSpec] | None, numbers: SceneNumbers) -> bool:
        links = (numbers.links, self._numbers.links)
        return new == old and all((visual.link in links[0]) == (visual.link in links[1]) for visual in old)

    def _load(self, key: _Key, scene: DrawnScene) -> BodyPrototype:
        links = tuple(dict.fromkeys(visual.link for visual in key))
        classes = ("", *sorted({visual.semantic_class for visual in key} - {""}))
        labels = [(classes.index(visual.semantic_class), 1) for visual in key]
        geometry = build_geometry(key, links, self._loader(scene), labels, levels_of_detail=self._levels_of_detail)
        return BodyPrototype(geometry, links, classes, bool(geometry.vertices["label"].any()))

    def _forget_unused(self, later: dict[_Key, list[str]]) -> None:
        unused = [key for key in self._prototypes if key not in later]
        for key in unused[: max(0, len(unused) - _UNUSED_PROTOTYPES)]:
            del self._prototypes[key]

    def _compose(
        self, numbers: SceneNumbers, kept: set[str], later: dict[_Key, list[str]], warnings: tuple[str, ...]
    ) -> SceneChange:
        """Returns the geometry of the kept bodies of the base and of the later bodies, given by prototype."""
        labels = LabelMap(self._numbers, numbers)
        merger = GeometryMerger(self._base)
        merger.add_base(labels, *self._links_of_base(numbers, kept))
        same_vertices, same_indices = self._vertices.base, self._indices.base
        if labels != self._labels:
            same_vertices = 0
            self._vertices.write_base(labels.apply(self._base.vertices))
            self._labels = labels
        stored: list[_Stored] = []
        vertex, index = self._vertices.base, self._indices.base
        unchanged = True  # as long as all rows so far equal those of the last change
        for key, names in sorted(later.items(), key=lambda item: self._order(item[0])):
            prototype = self._prototypes[key]
            material_numbers = merger.add_materials(prototype)
            by_label: dict[bytes, list[PlacedBody]] = {}
            for body in (PlacedBody.of(prototype, name, numbers) for name in names):
                by_label.setdefault(body.key if prototype.labelled else b"", []).append(body)
            for label, equal_bodies in by_label.items():
                entry = (key, label)
                unchanged = unchanged and self._stored[len(stored) : len(stored) + 1] == [entry]
                stored.append(entry)
                vertices, indices = prototype.geometry.vertices, prototype.geometry.indices
                if not unchanged:
                    relabelled = equal_bodies[0].relabelled(vertices) if prototype.labelled else vertices
                    self._vertices.write(vertex, relabelled)
                    self._indices.write(index, indices + np.uint32(vertex))
                elif same_vertices:
                    same_vertices, same_indices = vertex + len(vertices), index + len(indices)
                merger.add_bodies(prototype, material_numbers, equal_bodies, index)
                vertex, index = vertex + len(vertices), index + len(indices)
        self._stored = stored
        geometry = merger.merged(self._vertices.first(vertex), self._indices.first(index))
        return SceneChange(geometry, same_vertices, same_indices, warnings)

    def _links_of_base(self, numbers: SceneNumbers, kept: set[str]) -> tuple[I64, NDArray[np.bool_]]:
        """Returns, (L + 1,), the new number of each link of the base, and whether it is still drawn."""
        names = self._numbers.links
        new_numbers = np.array([numbers.links.get(name, 0) for name in names])
        return new_numbers, np.array([name.partition("/")[0] in kept or not name for name in names])

    def _order(self, key: _Key) -> int:
        """Returns the position of a prototype in the last change, to keep the order; new prototypes come last."""
        return next((k for k, (other, _) in enumerate(self._stored) if other == key), len(self._stored))


def _by_body(visuals: Sequence[VisualSpec]) -> dict[str, tuple[VisualSpec, ...]]:
    """Returns the visuals of each body; the name of the static world is empty."""
    bodies: dict[str, list[VisualSpec]] = {}
    for visual in visuals:
        bodies.setdefault(visual.link.partition("/")[0], []).append(visual)
    return {name: tuple(body) for name, body in bodies.items()}


def _canonical(name: str, visuals: Sequence[VisualSpec]) -> _Key:
    """Returns the visuals of a body under canonical names, which are the same for equal bodies."""
    return tuple(replace(visual, name=str(k), link=BODY + visual.link[len(name) :]) for k, visual in enumerate(visuals))


class _Rows:
    """A growing array whose first ``base`` rows are the loaded ones."""

    def __init__(self, base: NDArray[Any]) -> None:
        self.base = len(base)
        self._rows = base

    def write_base(self, rows: NDArray[Any]) -> None:
        self._reserve(self.base)
        self._rows[: self.base] = self._fitted(rows)

    def write(self, at: int, rows: NDArray[Any]) -> None:
        self._reserve(at + len(rows))
        self._rows[at : at + len(rows)] = self._fitted(rows)

    def _fitted(self, rows: NDArray[Any]) -> NDArray[Any]:
        """Returns rows in the type of the array, which gets the fields that vertices among the rows have in addition."""
        if not rows.dtype.names or rows.dtype == self._rows.dtype:
            return rows
        self._rows = with_dtype(self._rows, joined_dtype((self._rows.dtype, rows.dtype)))
        return with_dtype(rows, self._rows.dtype)

    def first(self, count: int) -> NDArray[Any]:
        return self._rows[:count]

    def _reserve(self, count: int) -> None:
        # The loaded array belongs to the caller, and may be a read-only memory-mapped file.
        if len(self._rows) < count or len(self._rows) == self.base:
            rows = np.zeros(max(count + 4096, count + count // 4), dtype=self._rows.dtype)
            rows[: len(self._rows)] = self._rows
            self._rows = rows
