"""Collects the content of an XML description that has no effect: elements and attributes that its reader does not use. Pure.

URDF and SDF each have a ``Grammar``, which says what they read, and word the messages: one must not have to read a file to know what is
simulated.
"""

from __future__ import annotations

import xml.etree.ElementTree as ET
from collections import Counter
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field

Element = ET.Element
Row = tuple[str, tuple[str, ...]]
"""Why an element has no effect ("" = it has), and the values, lower case, at which that changes nothing."""


@dataclass(frozen=True, slots=True)
class Grammar:
    """What a format reads."""

    children: Mapping[str, Mapping[str, Row]]
    """Element -> its children. Keys with a slash are for elements that differ with their parent. Children of an element that is a key are looked
    at in turn."""
    attributes: Mapping[str, tuple[str, ...]]
    """Element that is read -> its attributes."""
    several: frozenset[str]
    """Elements of which all count; of others, the first."""
    separate: frozenset[str] = frozenset()
    """Elements that are not looked at in turn, since the reader looks at them by themselves."""
    foreign: bool = False
    """Whether elements with a namespace count as unknown; else they are no part of the format."""
    others_have_attributes: bool = True
    """Whether elements without a row in ``attributes`` may have any; else they have none."""
    place: Callable[[Element, str], str] = lambda element, where: where
    """Returns what the content of an element is part of, given what the element is part of."""
    name: Callable[[Element, str], str] = lambda element, where: where
    """Returns what an element that has no effect is called in a message."""
    title: Callable[[Element, str], str] = lambda element, where: where
    """Returns what an element is called in a message about its children."""
    check: Callable[[Unread, Element, str, str], None] | None = None
    """Further check of each element that is looked at, with its key and what it is part of; None = none."""


@dataclass(slots=True)
class Omitted:
    """Elements left out for one reason."""

    tags: Counter[str] = field(default_factory=Counter)
    names: dict[str, None] = field(default_factory=dict)


class Unread:
    """The content of a file that has no effect, in its order."""

    def __init__(self, grammar: Grammar) -> None:
        self._grammar = grammar
        self.omitted: dict[str, Omitted] = {}
        """Reason -> known elements that are not read."""
        self.unknown: Counter[tuple[str, str]] = Counter()
        """(Parent, element) -> number of elements that the format does not have."""
        self.attributes: Counter[tuple[str, str]] = Counter()
        """(Attribute, element) -> number of attributes that the format does not have; those with a prefix belong to others."""
        self.repeated: dict[str, None] = {}
        """Elements of which only the first counts, with their number and place."""
        self.same_names: dict[str, None] = {}
        """Elements whose names are not unique, with their number and place."""

    def visit(self, element: Element, where: str, key: str = "") -> None:
        """Collects the descendants of an element that have no effect.

        Args:
            element: the element.
            where: what it is part of, for the messages.
            key: key of its children in the grammar; empty = its tag.
        """
        grammar = self._grammar
        if not key:
            self._visit_attributes(element)
        key = key or element.tag
        rows = grammar.children[key]
        for tag, count in Counter(child.tag for child in element).items():
            if count > 1 and tag in rows and not rows[tag][0] and tag not in grammar.several:
                self.repeated[f"{count} <{tag}> in {grammar.title(element, where)}"] = None
        for child in element:
            tag = child.tag
            if not isinstance(tag, str) or (not grammar.foreign and (":" in tag or "{" in tag)):
                continue
            if tag not in rows:
                self.unknown[element.tag, tag] += 1
                continue
            reason, harmless = rows[tag]
            if reason:
                if " ".join((child.text or "").lower().split()) not in harmless:
                    self.add(tag, reason, grammar.name(child, where))
                continue
            if tag in grammar.separate:
                continue
            for read in child.iter() if tag == "geometry" else (child,):
                self._visit_attributes(read)
            inner = f"{key}/{tag}" if f"{key}/{tag}" in grammar.children else tag
            if inner in grammar.children:
                self.visit(child, grammar.place(child, where), inner)
        if grammar.check is not None:
            grammar.check(self, element, key, where)

    def add(self, tag: str, reason: str, name: str) -> None:
        """Adds an element that has no effect; ``name``: what it is called in a message."""
        omitted = self.omitted.setdefault(reason, Omitted())
        omitted.tags[tag] += 1
        omitted.names[name] = None

    def clear(self) -> None:
        """Forgets everything."""
        for found in (self.omitted, self.unknown, self.attributes, self.repeated, self.same_names):
            found.clear()

    def _visit_attributes(self, element: Element) -> None:
        known = self._grammar.attributes.get(element.tag)
        if known is None and self._grammar.others_have_attributes:
            return
        for name in element.attrib:
            if name not in (known or ()) and ":" not in name and "{" not in name:
                self.attributes[name, element.tag] += 1
