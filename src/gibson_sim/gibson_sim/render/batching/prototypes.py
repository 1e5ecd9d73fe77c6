"""Merges the geometry of a changing scene: the base, which was loaded, and a prototype for each kind of body added later.

The base and each prototype have their own numbers of links, labels, materials and clusters; ``GeometryMerger`` renumbers them. No OpenGL.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gibson_sim.render.batching.scene_geometry import (
    APPEARANCE,
    PLAIN_APPEARANCE,
    Batch,
    LightMap,
    MapSet,
    SceneGeometry,
    settings,
)
from gibson_sim.scenes.spec import DrawnScene

I64 = NDArray[np.int64]
BODY = "body"
"""Body name in every prototype, so that equal bodies have equal prototypes."""
_CLUSTER = (
    "cluster_first", "cluster_count", "cluster_box", "cluster_link", "cluster_placement", "cluster_group", "cluster_next_group",
)  # fmt: skip
_GROUP = ("group_error", "group_box", "group_link")
_CLOSED = ("closed_box", "closed_link")


@dataclass(frozen=True, slots=True, eq=False)
class BodyPrototype:
    """The geometry that equal bodies share; links and classes are numbered from 1, the instance is 1."""

    geometry: SceneGeometry
    links: tuple[str, ...]
    classes: tuple[str, ...]
    labelled: bool
    """Whether labels are stored in the vertices, because they differ within a link; else they are in the placements."""


@dataclass(frozen=True, slots=True, eq=False)
class SceneNumbers:
    """Numbers of links, classes and instances in one scene."""

    links: dict[str, int]
    """1 + index in the links of the scene; 0 = the world, whose name is empty."""
    classes: dict[str, int]
    instances: dict[str, int]

    @classmethod
    def of(cls, scene: DrawnScene) -> SceneNumbers:
        """Returns the numbers of a scene."""
        links, classes, instances = (
            {name: number for number, name in enumerate(names)}
            for names in (("", *scene.links), scene.semantic_classes, scene.instances)
        )
        return cls(links, classes, instances)


class LabelMap:
    """Maps class and instance numbers of one scene to those of another, by name."""

    def __init__(self, source: SceneNumbers, target: SceneNumbers) -> None:
        # Removed names are not drawn, so any number is correct; they keep theirs.
        self._columns = tuple(
            np.array([new.get(name, number) for name, number in old.items()], dtype=np.uint16)
            for old, new in ((source.classes, target.classes), (source.instances, target.instances))
        )

    def __eq__(self, other: object) -> bool:
        return isinstance(other, LabelMap) and all(map(np.array_equal, self._columns, other._columns))

    __hash__ = None  # type: ignore[assignment]

    def apply(self, rows: NDArray[np.void]) -> NDArray[np.void]:
        """Returns a copy of rows whose field ``label`` has the new numbers."""
        out = rows.copy()
        for k, column in enumerate(self._columns):
            out["label"][:, k] = column[rows["label"][:, k]]
        return out


@dataclass(frozen=True, slots=True, eq=False)
class PlacedBody:
    """A body of a scene that is drawn with the geometry of a prototype."""

    links: I64
    """(L + 1,), scene numbers of the world and of each link of the prototype."""
    classes: NDArray[np.uint16]
    """Scene number of each class of the prototype."""
    instance: int

    @classmethod
    def of(cls, prototype: BodyPrototype, name: str, numbers: SceneNumbers) -> PlacedBody:
        """Returns the body ``name`` of a scene as an instance of a prototype."""
        links = [0, *(numbers.links[name + link[len(BODY) :]] for link in prototype.links)]
        classes = [numbers.classes.get(label, 0) for label in prototype.classes]
        return cls(np.array(links), np.array(classes, dtype=np.uint16), numbers.instances[name])

    @property
    def key(self) -> bytes:
        """Key that is equal for bodies with equal ``labels``."""
        return self.classes.tobytes() + bytes(str(self.instance), "ascii")

    def labels(self, labels: NDArray[np.uint16]) -> NDArray[np.uint16]:
        """Returns the scene numbers of labels, (N, 2), of the prototype."""
        return np.stack([self.classes[labels[:, 0]], labels[:, 1] * np.uint16(self.instance)], axis=1)

    def relabelled(self, vertices: NDArray[np.void]) -> NDArray[np.void]:
        """Returns a copy of vertices of the prototype with the labels of the scene."""
        out = vertices.copy()
        out["label"] = self.labels(vertices["label"])
        return out


@dataclass(frozen=True, slots=True)
class MaterialNumbers:
    """Numbers of a prototype's materials and textures in the merged geometry."""

    first_material: int
    textures: tuple[int, ...]
    map_sets: tuple[int, ...]
    light_maps: tuple[int, ...]


class GeometryMerger:
    """Merges the base and prototypes into one geometry, except for vertices and indices."""

    def __init__(self, base: SceneGeometry) -> None:
        self._base = base
        self._sources = [base]
        self._materials = len(base.materials)
        self._textures = {id(source): (k, source) for k, source in enumerate(base.textures)}
        self._map_sets: dict[tuple[int, ...], tuple[int, MapSet]] = {}
        for maps in base.map_sets:
            self._map_set(maps)
        self._light_maps: dict[tuple[int, float], tuple[int, LightMap]] = {}
        for light_map in base.light_maps:
            self._light_map(light_map)
        self._placements: list[NDArray[np.void]] = []
        self._rows: dict[str, list[NDArray[Any]]] = {name: [] for name in (*_CLUSTER, *_GROUP, *_CLOSED)}
        self._batches: list[Batch] = []
        self._body_batches: list[tuple[Batch, dict[str, NDArray[Any]]]] = []
        self._cluster_count = self._placement_count = self._group_count = 0

    def add_base(self, labels: LabelMap, links: I64, drawn: NDArray[np.bool_]) -> None:
        """Adds the part of the base that is still drawn.

        Args:
            labels: maps label numbers of the base to those of the scene.
            links: (L + 1,), scene number of each link of the base.
            drawn: (L + 1,), whether the link is still drawn.
        """
        b = self._base
        placements = labels.apply(b.placements)
        placements["link"] = links[b.placements["link"]]
        self._placements.append(placements)
        self._placement_count = len(placements)
        keep = drawn[b.cluster_link]
        columns = {name: getattr(b, name)[keep] for name in _CLUSTER}
        columns["cluster_link"] = links[columns["cluster_link"]]
        for name, column in columns.items():
            self._rows[name].append(column)
        self._add_groups(b, links[b.group_link])
        keep_closed = drawn[b.closed_link]
        self._add_closed(b.closed_box[keep_closed], links[b.closed_link[keep_closed]])
        new_offset = np.concatenate([[0], np.cumsum(keep)])
        for batch in b.batches:
            first, end = int(new_offset[batch.first_cluster]), int(new_offset[batch.end_cluster])
            if end > first:
                self._batches.append(replace(batch, first_cluster=first, end_cluster=end))
        self._cluster_count = int(new_offset[-1])

    def add_materials(self, prototype: BodyPrototype) -> MaterialNumbers:
        """Adds the materials and textures of a prototype."""
        first_material, geometry = self._materials, prototype.geometry
        self._sources.append(geometry)
        self._materials += len(geometry.materials)
        textures = tuple(self._textures.setdefault(id(t), (len(self._textures), t))[0] for t in geometry.textures)
        map_sets, light_maps = map(self._map_set, geometry.map_sets), map(self._light_map, geometry.light_maps)
        return MaterialNumbers(first_material, textures, tuple(map_sets), tuple(light_maps))

    def _map_set(self, maps: MapSet) -> int:
        return self._map_sets.setdefault(tuple(map(id, maps)), (len(self._map_sets), maps))[0]

    def _light_map(self, light_map: LightMap) -> int:
        return self._light_maps.setdefault((id(light_map[0]), light_map[1]), (len(self._light_maps), light_map))[0]

    def add_bodies(
        self, prototype: BodyPrototype, numbers: MaterialNumbers, bodies: Sequence[PlacedBody], first_index: int
    ) -> None:
        """Adds bodies that share the triangles of a prototype, whose indices begin at ``first_index``."""
        b, count = prototype.geometry, len(bodies)
        links = np.stack([body.links for body in bodies])  # (U, L + 1)
        placements = np.tile(b.placements, count)
        placements["link"] = links[:, b.placements["link"]].ravel()
        placements["material"] += numbers.first_material
        if not prototype.labelled:
            placements["label"] = np.concatenate([body.labels(b.placements["label"]) for body in bodies])
        body_index = np.arange(count)[:, None]
        groups, placed = (
            self._group_count + body_index * len(b.group_error),
            self._placement_count + body_index * len(b.placements),
        )
        for batch in b.batches:
            clusters = slice(batch.first_cluster, batch.end_cluster)
            columns = {
                name: np.tile(getattr(b, name)[clusters], (count, 1) if name == "cluster_box" else count) for name in _CLUSTER
            }
            columns["cluster_first"] = columns["cluster_first"] + np.uint32(first_index)
            columns["cluster_link"] = links[:, b.cluster_link[clusters]].ravel()
            columns["cluster_placement"] = (placed + b.cluster_placement[clusters]).ravel().astype(np.uint32)
            for name in ("cluster_group", "cluster_next_group"):
                columns[name] = np.where(getattr(b, name)[clusters] < 0, -1, groups + getattr(b, name)[clusters]).ravel()
            self._body_batches.append((self._renumbered(batch, numbers), columns))
        self._placements.append(placements)
        self._placement_count += len(placements)
        for body in bodies:
            self._add_groups(b, body.links[b.group_link])
            self._add_closed(b.closed_box, body.links[b.closed_link])

    def _renumbered(self, batch: Batch, numbers: MaterialNumbers) -> Batch:
        return replace(
            batch,
            texture=-1 if batch.texture < 0 else numbers.textures[batch.texture],
            maps=-1 if batch.maps < 0 else numbers.map_sets[batch.maps],
            light_map=-1 if batch.light_map < 0 else numbers.light_maps[batch.light_map],
            material=-1 if batch.material < 0 else batch.material + numbers.first_material,
        )

    def _add_groups(self, b: SceneGeometry, links: I64) -> None:
        self._rows["group_error"].append(b.group_error)
        self._rows["group_box"].append(b.group_box)
        self._rows["group_link"].append(links)
        self._group_count += len(b.group_error)

    def _add_closed(self, boxes: NDArray[np.float64], links: I64) -> None:
        self._rows["closed_box"].append(boxes)
        self._rows["closed_link"].append(links)

    def merged(self, vertices: NDArray[np.void], indices: NDArray[np.uint32]) -> SceneGeometry:
        """Returns the merged geometry; batches of prototypes with equal settings become one."""
        later = len(self._batches)
        for batch, columns in sorted(self._body_batches, key=lambda item: settings(item[0])):
            first, end = self._cluster_count, self._cluster_count + len(columns["cluster_first"])
            for name, column in columns.items():
                self._rows[name].append(column)
            if len(self._batches) > later and settings(self._batches[-1]) == settings(batch):
                last = self._batches.pop()
                batch = replace(
                    batch,
                    material=batch.material if batch.material == last.material else -1,
                    glossy=batch.glossy or last.glossy,
                    has_appearance=batch.has_appearance or last.has_appearance,
                )
                first = last.first_cluster
            self._batches.append(replace(batch, first_cluster=first, end_cluster=end))
            self._cluster_count = end
        rows = {name: np.concatenate(arrays) for name, arrays in self._rows.items()}
        appearances, patterns = self._appearances()
        finest = rows["cluster_count"][rows["cluster_group"] < 0]
        return replace(
            self._base,
            vertices=vertices,
            indices=indices,
            materials=np.concatenate([b.materials for b in self._sources]),
            appearances=appearances,
            patterns=patterns,
            map_sets=tuple(maps for _, maps in self._map_sets.values()),
            light_maps=tuple(light_map for _, light_map in self._light_maps.values()),
            batches=tuple(self._batches),
            textures=tuple(source for _, source in self._textures.values()),
            placements=np.concatenate(self._placements),
            triangles=int(finest.sum(dtype=np.int64)) // 3,
            files=tuple(dict.fromkeys(file for b in self._sources for file in b.files)),
            warnings=tuple(dict.fromkeys(warning for b in self._sources for warning in b.warnings)),
            **rows,
        )

    def _appearances(self) -> tuple[NDArray[np.void], NDArray[np.uint8]]:
        """Returns the appearances of all materials, and the pattern images that they reference."""
        patterns = [b.patterns for b in self._sources if len(b.patterns)]
        joined = np.concatenate(patterns) if patterns else self._base.patterns
        if not any(len(b.appearances) for b in self._sources):
            return self._base.appearances, joined
        appearances, layer = [], 0
        for b in self._sources:
            rows = (
                b.appearances.copy()
                if len(b.appearances)
                else np.array([PLAIN_APPEARANCE] * len(b.materials), dtype=np.float32).reshape(-1, 20).view(APPEARANCE)[:, 0]
            )
            rows["first"][:, 3] += np.where(rows["first"][:, 3] >= 0.0, np.float32(layer), np.float32(0.0))
            appearances.append(rows)
            layer += len(b.patterns)
        return np.concatenate(appearances), joined
