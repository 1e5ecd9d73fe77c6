"""What a scene that changes is put together from: the batches that it was loaded with, and parts for the bodies that came later.

Numbers of links, labels, materials and chunks are those of each piece, until they are joined here. No OpenGL here.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gibson_sim.render.batching.batches import APPEARANCE, PLAIN_APPEARANCE, Batch, Batches, MapSet, settings
from gibson_sim.scenes.spec import DrawnScene

I64 = NDArray[np.int64]
BODY = "body"
"""Name that the body of a part goes by, so that equal bodies are equal parts."""
_CHUNK = ("chunk_first", "chunk_count", "chunk_box", "chunk_link", "chunk_placement", "chunk_group", "chunk_next_group")
_GROUP = ("group_error", "group_box", "group_link")
_SOLID = ("solid_box", "solid_link")


@dataclass(frozen=True, slots=True, eq=False)
class Part:
    """The triangles of a body: its links are numbered from 1, its classes too, and its instance is 1."""

    batches: Batches
    links: tuple[str, ...]
    classes: tuple[str, ...]
    labelled: bool
    """Whether vertices carry labels, since those of a link differ; else placements do."""


@dataclass(frozen=True, slots=True, eq=False)
class Numbers:
    """What things are called in one scene."""

    links: dict[str, int]
    """1 + index."""
    classes: dict[str, int]
    instances: dict[str, int]

    @classmethod
    def of(cls, scene: DrawnScene) -> Numbers:
        """Returns the numbers of a scene."""
        links, classes, instances = (
            {name: number for number, name in enumerate(names)}
            for names in (("", *scene.links), scene.semantic_classes, scene.instances)
        )
        return cls(links, classes, instances)


class Labels:
    """Numbers of classes and instances of one scene in another one, by name."""

    def __init__(self, before: Numbers, now: Numbers) -> None:
        # What has gone is not drawn: any number will do, so its own one.
        self._columns = tuple(
            np.array([new.get(name, number) for name, number in old.items()], dtype=np.uint16)
            for old, new in ((before.classes, now.classes), (before.instances, now.instances))
        )

    def __eq__(self, other: object) -> bool:
        return isinstance(other, Labels) and all(map(np.array_equal, self._columns, other._columns))

    __hash__ = None  # type: ignore[assignment]

    def on(self, rows: NDArray[np.void]) -> NDArray[np.void]:
        """Returns a copy of rows with a field ``label`` that has the new numbers."""
        out = rows.copy()
        for k, column in enumerate(self._columns):
            out["label"][:, k] = column[rows["label"][:, k]]
        return out


@dataclass(frozen=True, slots=True, eq=False)
class Use:
    """A body that is drawn by a part."""

    links: I64
    """(L + 1,), number of each link of the part in the scene, the world first."""
    classes: NDArray[np.uint16]
    """Number of each class of the part in the scene."""
    instance: int

    @classmethod
    def of(cls, part: Part, name: str, numbers: Numbers) -> Use:
        """Returns what the body ``name`` of a scene needs to be drawn by a part."""
        links = [0, *(numbers.links[name + link[len(BODY) :]] for link in part.links)]
        classes = [numbers.classes.get(label, 0) for label in part.classes]
        return cls(np.array(links), np.array(classes, dtype=np.uint16), numbers.instances[name])

    @property
    def key(self) -> bytes:
        """Equal where ``labels`` are."""
        return self.classes.tobytes() + bytes(str(self.instance), "ascii")

    def labels(self, labels: NDArray[np.uint16]) -> NDArray[np.uint16]:
        """Returns (N, 2) labels of the part as the scene numbers them."""
        return np.stack([self.classes[labels[:, 0]], labels[:, 1] * np.uint16(self.instance)], axis=1)

    def on_vertices(self, vertices: NDArray[np.void]) -> NDArray[np.void]:
        """Returns a copy of vertices of the part with labels of the scene."""
        out = vertices.copy()
        out["label"] = self.labels(vertices["label"])
        return out


@dataclass(frozen=True, slots=True)
class Place:
    """Where what a part brings along stands in the joined lists."""

    material: int
    textures: tuple[int, ...]
    """Number of each of its textures."""
    map_sets: tuple[int, ...]


class Join:
    """Puts the batches of the base and of parts together, all but vertices and indices."""

    def __init__(self, base: Batches) -> None:
        self._base = base
        self._brought = [base]
        self._materials = len(base.materials)
        self._textures = {id(source): (k, source) for k, source in enumerate(base.textures)}
        self._map_sets: dict[tuple[int, ...], tuple[int, MapSet]] = {}
        for maps in base.map_sets:
            self._map_set(maps)
        self._placements: list[NDArray[np.void]] = []
        self._rows: dict[str, list[NDArray[Any]]] = {name: [] for name in (*_CHUNK, *_GROUP, *_SOLID)}
        self._batches: list[Batch] = []
        self._runs: list[tuple[Batch, dict[str, NDArray[Any]]]] = []
        self._chunk_count = self._placement_count = self._group_count = 0

    def add_base(self, labels: Labels, links: I64, drawn: NDArray[np.bool_]) -> None:
        """Takes what is still drawn of the base, whose links have the numbers ``links`` now."""
        b = self._base
        placements = labels.on(b.placements)
        placements["link"] = links[b.placements["link"]]
        self._placements.append(placements)
        self._placement_count = len(placements)
        keep = drawn[b.chunk_link]
        columns = {name: getattr(b, name)[keep] for name in _CHUNK}
        columns["chunk_link"] = links[columns["chunk_link"]]
        for name, column in columns.items():
            self._rows[name].append(column)
        self._add_groups(b, links[b.group_link])
        there = drawn[b.solid_link]
        self._add_solids(b.solid_box[there], links[b.solid_link[there]])
        before = np.concatenate([[0], np.cumsum(keep)])
        for batch in b.batches:
            first, end = int(before[batch.first_chunk]), int(before[batch.end_chunk])
            if end > first:
                self._batches.append(replace(batch, first_chunk=first, end_chunk=end))
        self._chunk_count = int(before[-1])

    def place(self, part: Part) -> Place:
        """Takes the materials and textures of a part."""
        material, b = self._materials, part.batches
        self._brought.append(b)
        self._materials += len(b.materials)
        textures = tuple(self._textures.setdefault(id(t), (len(self._textures), t))[0] for t in b.textures)
        return Place(material, textures, tuple(self._map_set(maps) for maps in b.map_sets))

    def _map_set(self, maps: MapSet) -> int:
        return self._map_sets.setdefault(tuple(map(id, maps)), (len(self._map_sets), maps))[0]

    def add(self, part: Part, place: Place, uses: Sequence[Use], first_index: int) -> None:
        """Takes bodies that share the triangles of a part, which begin at ``first_index`` of the indices."""
        b, count = part.batches, len(uses)
        links = np.stack([use.links for use in uses])  # (U, L + 1)
        own = b.placements
        placements = np.tile(own, count)
        placements["link"] = links[:, own["link"]].ravel()
        placements["material"] += place.material
        if not part.labelled:
            placements["label"] = np.concatenate([use.labels(own["label"]) for use in uses])
        of_use = np.arange(count)[:, None]
        groups, placed = self._group_count + of_use * len(b.group_error), self._placement_count + of_use * len(own)
        for batch in b.batches:
            chunks = slice(batch.first_chunk, batch.end_chunk)
            columns = {name: np.tile(getattr(b, name)[chunks], (count, 1) if name == "chunk_box" else count) for name in _CHUNK}
            columns["chunk_first"] = columns["chunk_first"] + np.uint32(first_index)
            columns["chunk_link"] = links[:, b.chunk_link[chunks]].ravel()
            columns["chunk_placement"] = (placed + b.chunk_placement[chunks]).ravel().astype(np.uint32)
            for name in ("chunk_group", "chunk_next_group"):
                columns[name] = np.where(getattr(b, name)[chunks] < 0, -1, groups + getattr(b, name)[chunks]).ravel()
            self._runs.append((self._moved(batch, place), columns))
        self._placements.append(placements)
        self._placement_count += len(placements)
        for use in uses:
            self._add_groups(b, use.links[b.group_link])
            self._add_solids(b.solid_box, use.links[b.solid_link])

    def _moved(self, batch: Batch, place: Place) -> Batch:
        return replace(
            batch,
            texture=-1 if batch.texture < 0 else place.textures[batch.texture],
            maps=-1 if batch.maps < 0 else place.map_sets[batch.maps],
            material=-1 if batch.material < 0 else batch.material + place.material,
        )

    def _add_groups(self, b: Batches, links: I64) -> None:
        self._rows["group_error"].append(b.group_error)
        self._rows["group_box"].append(b.group_box)
        self._rows["group_link"].append(links)
        self._group_count += len(b.group_error)

    def _add_solids(self, boxes: NDArray[np.float64], links: I64) -> None:
        self._rows["solid_box"].append(boxes)
        self._rows["solid_link"].append(links)

    def batches(self, vertices: NDArray[np.void], indices: NDArray[np.uint32]) -> Batches:
        """Returns all of it; runs of parts that are drawn with the same settings become one batch."""
        later = len(self._batches)
        for batch, columns in sorted(self._runs, key=lambda run: settings(run[0])):
            first, end = self._chunk_count, self._chunk_count + len(columns["chunk_first"])
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
                first = last.first_chunk
            self._batches.append(replace(batch, first_chunk=first, end_chunk=end))
            self._chunk_count = end
        joined = {name: np.concatenate(pieces) for name, pieces in self._rows.items()}
        appearances, patterns = self._appearances()
        finest = joined["chunk_count"][joined["chunk_group"] < 0]
        return replace(
            self._base,
            vertices=vertices,
            indices=indices,
            materials=np.concatenate([b.materials for b in self._brought]),
            appearances=appearances,
            patterns=patterns,
            map_sets=tuple(maps for _, maps in self._map_sets.values()),
            batches=tuple(self._batches),
            textures=tuple(source for _, source in self._textures.values()),
            placements=np.concatenate(self._placements),
            triangles=int(finest.sum(dtype=np.int64)) // 3,
            files=tuple(dict.fromkeys(file for b in self._brought for file in b.files)),
            warnings=tuple(dict.fromkeys(warning for b in self._brought for warning in b.warnings)),
            **joined,
        )

    def _appearances(self) -> tuple[NDArray[np.void], NDArray[np.uint8]]:
        """Returns the appearances of all materials and the pictures that they name."""
        patterns = [b.patterns for b in self._brought if len(b.patterns)]
        joined = np.concatenate(patterns) if patterns else self._base.patterns
        if not any(len(b.appearances) for b in self._brought):
            return self._base.appearances, joined
        appearances, layer = [], 0
        for b in self._brought:
            own = (
                b.appearances.copy()
                if len(b.appearances)
                else np.array([PLAIN_APPEARANCE] * len(b.materials), dtype=np.float32).reshape(-1, 20).view(APPEARANCE)[:, 0]
            )
            own["first"][:, 3] += np.where(own["first"][:, 3] >= 0.0, np.float32(layer), np.float32(0.0))
            appearances.append(own)
            layer += len(b.patterns)
        return np.concatenate(appearances), joined
