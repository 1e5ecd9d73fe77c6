"""Changes valid inputs: numbers within and beyond their type, trees, XML, lines of text, bytes. Everything follows from one seed."""

from __future__ import annotations

import copy
import math
import random
import re
import sys
from collections.abc import Callable, Sequence
from typing import Any
from xml.etree import ElementTree

SECRET = "hunter2"
"""Stands in files that no reply may quote."""
SECRET_NUMBER = 31415926
HARSH_NUMBERS: tuple[float | int, ...] = (
    math.nan, math.inf, -math.inf, 0, -0.0, -1, 1e-300, 5e-324, 1e-9, 1e9, 1e20, 1e38, 1e39, -1e300, 1.8e308, 2**31, 2**32, -(2**31),
    2**63, -(2**63) - 1, 10**40, SECRET_NUMBER, 0.5, 65535, 65536,
)  # fmt: skip
HARSH_TEXTS: tuple[str, ...] = (
    "", " ", SECRET, f"{SECRET}.obj", f"../{SECRET}.txt", f"/{SECRET}", "../../../../etc/passwd", "/etc/passwd", "file:///etc/passwd",
    "/dev/zero", "/dev/stdin", "/proc/self/environ", "pipe", "folder", "link.txt", ".", "/", "..", "a\0b", "\ud800", "\u202e", "𝔘" * 30,
    "%s%n%x", "${HOME}", "package://nothing/x", "model://nothing", "https://example.org/x.glb", "data:,x", "data:image/png;base64,AAAA",
    "a" * 300, "x" * 100_000, "nan", "1e999", "0x10", "1_000", "yes", "null", "-", "a/b", "a b", "A", "__class__", "\n", "é",
)  # fmt: skip
_NUMBER = re.compile(r"[-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?")
_MANY = (2, 3, 10, 100, 1000)
_DEEP = (2, 10, 90, 300)


class Mutator:
    """Random changes. ``harsh`` = changes that a reader should refuse, beside those that it should take."""

    def __init__(self, rng: random.Random, *, harsh: bool) -> None:
        self.rng, self.harsh = rng, harsh
        self.most = sys.maxsize
        """So many changes are made; further ones leave everything as it is."""

    def _is_spent(self) -> bool:
        self.most -= 1
        return self.most < 0

    def chance(self, share: float) -> bool:
        """Returns True this often."""
        return self.rng.random() < share

    def times(self) -> int:
        """Returns how many changes a mutant gets."""
        return self.rng.choice((1, 1, 2, 3)) if self.harsh else self.rng.choice((1, 2, 3, 5, 8))

    def number(self, value: float | int) -> float | int:
        """Returns another number: near the old one, a thousandfold (the wrong unit), or, where harsh, an extreme of its type."""
        if self.harsh and self.chance(0.6):
            chosen = self.rng.choice(HARSH_NUMBERS)
            return chosen if isinstance(value, float) or self.chance(0.3) or not math.isfinite(chosen) else int(chosen)
        factor = self.rng.choice(
            (
                0.9,
                0.99,
                1.01,
                1.1,
                1.0 + 1e-7,
                2.0,
                0.5,
                -1.0,
                *((100.0, 1e-2, 57.3, 1e3, 1e-3) if self.harsh or self.chance(0.2) else ()),
            )
        )
        if isinstance(value, int):
            return int(value * factor) if self.chance(0.5) else value + self.rng.choice((-1, 1, 2))
        return value * factor + self.rng.choice((0.0, 0.0, 0.01, -0.01))

    def text(self, value: str, others: Sequence[str] = ()) -> str:
        """Returns another text: one that stands elsewhere in the same file, or what a reader hardly expects."""
        if self.harsh and self.chance(0.7):
            return self.rng.choice(HARSH_TEXTS)
        kind = self.rng.randrange(4)
        if kind == 0 and others:
            return self.rng.choice(others)
        if kind == 1 and _NUMBER.search(value):
            return self.numbers_in(value)
        if kind == 2 and value:
            k = self.rng.randrange(len(value))
            return value[:k] + self.rng.choice("abzAZ09_") + value[k + 1 :]
        return value

    def numbers_in(self, text: str) -> str:
        """Returns the text with one of its numbers changed."""
        found = list(_NUMBER.finditer(text))
        if not found:
            return text
        one = self.rng.choice(found)
        old = float(one[0]) if any(c in one[0] for c in ".eE") else int(one[0])
        return text[: one.start()] + _written(self.number(old)) + text[one.end() :]

    def scalar(self, value: Any, others: Sequence[str] = ()) -> Any:
        """Returns another value of the same type, or, where harsh, sometimes of another."""
        if self.harsh and self.chance(0.15):
            return self.rng.choice(
                (None, True, False, 0, 1, -1, 0.5, "text", [], {}, [1, 2, 3], {"a": 1}, [[]], SECRET, SECRET_NUMBER)
            )
        if isinstance(value, bool):
            return not value
        if isinstance(value, int | float):
            return self.number(value)
        if isinstance(value, str):
            return self.text(value, others)
        return value

    def tree(self, document: Any) -> Any:
        """Returns a copy of lists and mappings with one change."""
        if self._is_spent():
            return document
        document = copy.deepcopy(document)
        places = list(_places(document))
        if not places:
            return self.scalar(document)
        leaves = [place for place in places if not isinstance(place[0][place[1]], dict | list)]
        if leaves and self.chance(0.75 if self.harsh else 0.85):
            holder, key = self.rng.choice(leaves)
            texts = [h[k] for h, k in leaves if isinstance(h[k], str) and k == key]
            holder[key] = self.scalar(holder[key], texts)
            return document
        self._reshape(document, places)
        return document

    def _reshape(self, document: Any, places: list[tuple[Any, Any]]) -> None:
        holder, key = self.rng.choice(places)
        kinds = ("drop", "again", "reorder", "swap")
        kind = self.rng.choice((*kinds, "nest", "rename", "wrap", "many") if self.harsh else kinds)
        if kind == "drop":
            del holder[key]
        elif kind == "again" and isinstance(holder, list):
            holder.insert(self.rng.randrange(len(holder) + 1), copy.deepcopy(holder[key]))
        elif kind == "reorder":
            self._reorder(holder)
        elif kind == "swap":
            other, place = self.rng.choice(places)
            if not _within(holder[key], other) and not _within(other[place], holder):
                same = type(holder[key]) is type(other[place]) or self.harsh
                if same:
                    holder[key], other[place] = other[place], holder[key]
        elif kind == "nest":
            value = holder[key]
            for _ in range(self.rng.choice(_DEEP)):
                value = [value]
            holder[key] = value
        elif kind == "rename" and isinstance(holder, dict):
            holder[self.rng.choice((*HARSH_TEXTS, "name", "extra"))] = holder.pop(key)
        elif kind == "wrap":
            holder[key] = self.rng.choice(([holder[key]], {"a": holder[key]}))
        elif kind == "many" and isinstance(holder, list):
            holder.extend(copy.deepcopy(holder[key]) for _ in range(self.rng.choice(_MANY)))

    def _reorder(self, holder: Any) -> None:
        if isinstance(holder, list):
            self.rng.shuffle(holder)
            return
        items = list(holder.items())
        self.rng.shuffle(items)
        holder.clear()
        holder.update(items)

    def xml(self, text: str) -> str:
        """Returns an XML text with one change."""
        if self._is_spent():
            return text
        if self.harsh and self.chance(0.1):
            return self.lines(text)
        try:
            top = ElementTree.fromstring(text)
        except (ElementTree.ParseError, ValueError):
            return self.lines(text)
        parents = {child: parent for parent in top.iter() for child in parent}
        elements = list(top.iter())
        texts = [e for e in elements if e.text and e.text.strip()]
        attributes = [(e, name) for e in elements for name in e.attrib]
        if self.chance(0.8) and (texts or attributes):
            if attributes and (not texts or self.chance(len(attributes) / (len(attributes) + len(texts)))):
                element, name = self.rng.choice(attributes)
                others = [e.get(n, "") for e, n in attributes if n == name]
                element.set(name, self._field(element.get(name, ""), others))
            else:
                element = self.rng.choice(texts)
                element.text = self._field(element.text or "", [e.text or "" for e in texts if e.tag == element.tag])
        elif parents:
            self._reshape_xml(top, parents)
        return _xml_text(top)

    def _field(self, value: str, others: Sequence[str]) -> str:
        if _NUMBER.fullmatch(value.strip().split(" ")[0]):
            return self.numbers_in(value) if self.chance(0.9) else self.text(value, others)
        return self.text(value, others)

    def _reshape_xml(self, top: ElementTree.Element, parents: dict[ElementTree.Element, ElementTree.Element]) -> None:
        element = self.rng.choice(list(parents))
        parent = parents[element]
        kinds = ("drop", "again", "reorder")
        kind = self.rng.choice((*kinds, "move", "rename", "nest", "many") if self.harsh else kinds)
        if kind == "drop":
            parent.remove(element)
        elif kind == "again":
            parent.append(copy.deepcopy(element))
        elif kind == "reorder":
            parent[:] = self.rng.sample(list(parent), len(parent))
        elif kind == "move":
            other = self.rng.choice(list(top.iter()))
            other.append(copy.deepcopy(element))
        elif kind == "rename":
            element.tag = self.rng.choice([e.tag for e in top.iter()] + [SECRET])
        elif kind == "nest":
            inner = element
            for _ in range(self.rng.choice((*_DEEP, 3000))):
                inner = ElementTree.SubElement(inner, element.tag)
        else:
            parent.extend([copy.deepcopy(element) for _ in range(self.rng.choice(_MANY))])

    def lines(self, text: str) -> str:
        """Returns a text whose meaning lies in lines and words, with one change."""
        if self._is_spent():
            return text
        rows = text.split("\n")
        k = self.rng.randrange(len(rows))
        kind = self.rng.randrange(8)
        if kind < 5:
            with_numbers = [i for i, row in enumerate(rows) if _NUMBER.search(row)] or [k]
            k = self.rng.choice(with_numbers)
            rows[k] = self.numbers_in(rows[k])
        elif kind == 5:
            rows.insert(k, self.rng.choice(rows))
        elif not self.harsh:
            rows[k] = rows[k] + " "
        elif kind == 6:
            words = rows[k].split(" ")
            words[self.rng.randrange(len(words))] = self.rng.choice(HARSH_TEXTS)
            rows[k] = " ".join(words)
        else:
            change: Callable[[], None] = self.rng.choice(
                (
                    lambda: rows.pop(k),
                    lambda: rows.extend(rows[k : k + 3] * self.rng.choice(_MANY)),
                    lambda: self.rng.shuffle(rows),
                )
            )  # type: ignore[assignment]
            change()
        return "\n".join(rows)

    def data(self, data: bytes) -> bytes:
        """Returns bytes with one change."""
        if not data or self._is_spent():
            return data
        changed = bytearray(data)
        k = self.rng.randrange(len(changed))
        kind = self.rng.randrange(7 if self.harsh else 1)
        if kind == 0:
            changed[k] ^= 1 << self.rng.randrange(8)
        elif kind == 1:
            changed[k : k + 4] = self.rng.choice(
                (b"\xff\xff\xff\xff", b"\0\0\0\0", b"\0\0\0\x80", b"\xff\xff\xff\x7f", b"\0\0\xc0\x7f")
            )
        elif kind == 2:
            del changed[k:]
        elif kind == 3:
            del changed[k : k + self.rng.randrange(1, 64)]
        elif kind == 4:
            changed[k:k] = changed[k : k + self.rng.randrange(1, 256)]
        elif kind == 5:
            changed[k:k] = self.rng.randbytes(self.rng.randrange(1, 16))
        else:
            changed[k : k + 8] = self.rng.randbytes(8)
        return bytes(changed)

    def file_text(self, text: str) -> bytes:
        """Returns what a finished text becomes in its file: now and then with bytes that are wrong."""
        data = text.encode("utf-8", errors="surrogatepass")
        return self.data(data) if self.harsh and self.chance(0.1) else data


def _written(value: float | int) -> str:
    return repr(value)


def _places(value: Any) -> Any:
    """Yields (holder, key) of every value in a tree."""
    items = value.items() if isinstance(value, dict) else enumerate(value) if isinstance(value, list) else ()
    for key, inner in list(items):
        yield value, key
        yield from _places(inner)


def _within(value: Any, holder: Any) -> bool:
    """Returns whether ``holder`` is a value, or lies in it."""
    return value is holder or any(inner[key] is holder for inner, key in _places(value))


def _xml_text(top: ElementTree.Element) -> str:
    """Returns the text of a tree, deep ones too: the usual writer recurses."""
    parts: list[str] = []
    waiting: list[ElementTree.Element | str] = [top]
    while waiting:
        item = waiting.pop()
        if isinstance(item, str):
            parts.append(item)
            continue
        attributes = "".join(f' {name}="{_escaped(value)}"' for name, value in item.attrib.items())
        parts.append(f"<{item.tag}{attributes}>{_escaped(item.text or '')}")
        waiting.append(f"</{item.tag}>{_escaped(item.tail or '')}")
        waiting.extend(reversed(list(item)))
    return "".join(parts)


def _escaped(text: str) -> str:
    return text.replace("&", "&amp;").replace("<", "&lt;").replace('"', "&quot;")
