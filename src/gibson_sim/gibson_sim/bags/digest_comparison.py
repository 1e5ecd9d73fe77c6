"""Compares two runs by the digests of their ticks and determines the first difference. Pure."""

from __future__ import annotations

from array import array
from collections import Counter, defaultdict
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass, field
from typing import Any, TypeAlias

from gibson_sim.types import NS_PER_S

Tick: TypeAlias = tuple[int, int]
"""Epoch, and number of steps since it began."""
_STATE_TOPIC, _FLOW_TOPIC = "scene_state", "/flow/image_raw"


@dataclass(frozen=True, slots=True)
class TickDigests:
    """Digests of the data that one node published at a tick."""

    stamp_ns: int
    topics: tuple[str, ...]
    digests: array[int]

    @property
    def is_physics(self) -> bool:
        """Whether they are from the physics node; else they are digests of images."""
        return any(topic.rpartition("/")[2] == _STATE_TOPIC for topic in self.topics)

    def values(self) -> dict[str, int]:
        """Returns the digest of each topic."""
        return dict(zip(self.topics, self.digests, strict=True))


@dataclass(frozen=True, slots=True)
class Difference:
    """A tick at which two runs differ."""

    epoch: int
    step: int
    stamp_ns: int
    topics: tuple[str, ...]

    def text(self) -> str:
        """Returns the tick and its topics as text."""
        return f"epoch {self.epoch}, step {self.step}, {self.stamp_ns / NS_PER_S:.4f} s, on {', '.join(self.topics)}"


@dataclass(frozen=True, slots=True)
class Verification:
    """Result of a comparison."""

    ticks: int = 0
    """Compared ticks of physics."""
    missing_ticks: int = 0
    """Ticks of physics that only the first run has."""
    unknown_ticks: int = 0
    """Ticks of physics that only the second run has, up to the last one of the first run."""
    images: int = 0
    """Compared ticks with images."""
    missing_images: int = 0
    """Number of (tick, topic) pairs with images that only the first run has; they are not compared."""
    unknown_images: int = 0
    """Number of (tick, topic) pairs with images that only the second run has."""
    without_images: bool = False
    """Whether the second run renders no images, so that only physics is compared."""
    first: Difference | None = None
    differing: Mapping[str, int] = field(default_factory=dict)
    """Topic -> number of ticks at which it differs."""
    compared: Mapping[str, int] = field(default_factory=dict)
    """Topic -> number of ticks at which it was compared."""

    @property
    def is_equal(self) -> bool:
        """Whether the compared data of both runs are bit-equal."""
        nothing_drawn = bool(self.missing_images) and not self.images and not self.without_images
        return self.ticks > 0 and not self.missing_ticks and not self.differing and not nothing_drawn

    def lines(self) -> list[str]:
        """Returns the result as lines of text."""
        images = "" if self.without_images else f" and {self.images} ticks with images"
        lines = [f"compared {self.ticks} ticks of physics{images}, {len(self.compared)} topics"]
        if self.missing_ticks:
            lines.append(f"{self.missing_ticks} ticks of the bag are missing from the replay")
        if self.unknown_ticks:
            lines.append(f"{self.unknown_ticks} ticks are not in the bag and were not compared")
        if self.missing_images or self.unknown_images:
            lines.append(f"not compared: {self.missing_images} images only in the bag, {self.unknown_images} only in the replay")
        if self.first is not None:
            lines.append(f"first difference: {self.first.text()}")
        for topic, number in sorted(self.differing.items()):
            lines.append(f"  {topic}: {number} of {self.compared[topic]} ticks differ")
        lines.append("equal to the bit" if self.is_equal else "NOT equal")
        return lines

    def to_json(self) -> dict[str, Any]:
        """Returns the result as values for JSON."""
        return {**asdict(self), "is_equal": self.is_equal}


def verification_from_json(values: Mapping[str, Any]) -> Verification:
    """Inverts ``Verification.to_json``."""
    given = {key: value for key, value in values.items() if key != "is_equal"}
    if given["first"] is not None:
        given["first"] = Difference(**{**given["first"], "topics": tuple(given["first"]["topics"])})
    return Verification(**given)


class DigestComparison:
    """Compares a run in progress with a recorded one.

    All ticks and topics of physics are compared. Only images that both runs have are compared, since the rendered images depend on subscribers
    and on the speed of the machine. Optical flow is compared only if the previous image was of the same tick in both runs.

    Args:
        expected: digests of the recorded run.
        images: whether to compare images.
    """

    def __init__(self, expected: Mapping[Tick, Sequence[TickDigests]], *, images: bool = True) -> None:
        self._physics: dict[Tick, TickDigests] = {}
        self._images: dict[Tick, dict[str, int]] = defaultdict(dict)
        self._has_images = images
        for tick, digests in expected.items():
            for item in digests:
                if item.is_physics:
                    self._physics[tick] = item
                elif images:
                    self._images[tick].update(item.values())
        self.last = max(self._physics, default=None)
        """Last tick of physics; None = no ticks."""
        self._before = _previous_ticks(self._images)
        self._latest: dict[str, Tick] = {}
        self._seen_physics: set[Tick] = set()
        self._seen_images: set[tuple[Tick, str]] = set()
        self._image_ticks: set[Tick] = set()
        self._unknown_ticks = self._unknown_images = 0
        self._compared: Counter[str] = Counter()
        self._differing: Counter[str] = Counter()
        self._first: Difference | None = None

    @property
    def image_topics(self) -> tuple[str, ...]:
        """Topics of the compared images."""
        return tuple(sorted({topic for by_topic in self._images.values() for topic in by_topic}))

    def is_complete(self, tick: Tick) -> bool:
        """Returns whether all expected digests of a tick have arrived."""
        images = self._images.get(tick, {})
        physics = tick not in self._physics or tick in self._seen_physics
        return physics and all((tick, topic) in self._seen_images for topic in images)

    def add(self, tick: Tick, digests: TickDigests) -> None:
        """Compares the digests of one node at a tick; ignores ticks after the last tick of the recorded run."""
        if self.last is None or tick > self.last:
            return
        if digests.is_physics:
            self._add_physics(tick, digests)
        elif self._has_images:
            self._add_images(tick, digests)

    def _add_physics(self, tick: Tick, digests: TickDigests) -> None:
        expected = self._physics.get(tick)
        if expected is None:
            self._unknown_ticks += 1
            return
        self._seen_physics.add(tick)
        before, now = expected.values(), digests.values()
        self._compare(tick, digests.stamp_ns, [(topic, before.get(topic), now.get(topic)) for topic in {**before, **now}])

    def _add_images(self, tick: Tick, digests: TickDigests) -> None:
        expected, pairs = self._images.get(tick, {}), []
        for topic, digest in digests.values().items():
            previous, self._latest[topic] = self._latest.get(topic), tick
            if topic not in expected:
                self._unknown_images += 1
                continue
            self._seen_images.add((tick, topic))
            if not topic.endswith(_FLOW_TOPIC) or self._before.get((tick, topic)) == previous:
                pairs.append((topic, expected[topic], digest))
        if pairs:
            self._image_ticks.add(tick)
        self._compare(tick, digests.stamp_ns, pairs)

    def _compare(self, tick: Tick, stamp_ns: int, pairs: Iterable[tuple[str, int | None, int | None]]) -> None:
        """Counts differences; stores the earliest tick with a difference, and the topics that differ at it."""
        differing = []
        for topic, before, now in pairs:
            self._compared[topic] += 1
            if before != now:
                differing.append(topic)
        self._differing.update(differing)
        if not differing:
            return
        first = self._first
        if first is None or tick < (first.epoch, first.step):
            self._first = Difference(*tick, stamp_ns, tuple(sorted(differing)))
        elif tick == (first.epoch, first.step):
            self._first = Difference(*tick, stamp_ns, tuple(sorted({*first.topics, *differing})))

    def result(self) -> Verification:
        """Returns the result so far."""
        images = sum(len(found) for found in self._images.values())
        return Verification(
            ticks=len(self._seen_physics),
            missing_ticks=len(self._physics) - len(self._seen_physics),
            unknown_ticks=self._unknown_ticks,
            images=len(self._image_ticks),
            missing_images=images - len(self._seen_images),
            unknown_images=self._unknown_images,
            without_images=not self._has_images,
            first=self._first,
            differing=dict(self._differing),
            compared=dict(self._compared),
        )


def comparison_line(first: Mapping[Tick, Sequence[TickDigests]], second: Mapping[Tick, Sequence[TickDigests]]) -> str:
    """Returns one line about two recorded runs: the number of ticks that both have, and whether these are equal; empty if one has no digests."""
    if not (first and second):
        return ""
    comparison = DigestComparison(first)
    for tick in sorted(second):
        for digests in second[tick]:
            comparison.add(tick, digests)
    result = comparison.result()
    if not result.ticks:
        return "digests: no tick is in both bags"
    images = f" ({result.images} with images)" if result.images else ""
    verdict = "equal to the bit" if result.first is None else f"first difference: {result.first.text()}"
    lengths = [sum(any(item.is_physics for item in digests) for digests in run.values()) for run in (first, second)]
    more = [
        f"; {n - result.ticks} only in the {which} bag"
        for n, which in zip(lengths, ("first", "second"), strict=True)
        if n > result.ticks
    ]
    return f"digests: {result.ticks} tick{'s' if result.ticks > 1 else ''}{images}, {verdict}{''.join(more)}"


def _previous_ticks(images: Mapping[Tick, Mapping[str, int]]) -> dict[tuple[Tick, str], Tick]:
    """Returns the tick of the previous image for each image of optical flow."""
    latest: dict[str, Tick] = {}
    previous: dict[tuple[Tick, str], Tick] = {}
    for tick in sorted(images):
        for topic in images[tick]:
            if topic.endswith(_FLOW_TOPIC):
                if topic in latest:
                    previous[tick, topic] = latest[topic]
                latest[topic] = tick
    return previous
