"""The XML document of a COLLADA file: its elements by plain tag names, its numbers, and its warnings."""

from __future__ import annotations

import re
from collections.abc import Iterator
from pathlib import Path
from urllib.parse import unquote
from xml.etree import ElementTree

import numpy as np

from gibson_sim.errors import MeshError
from gibson_sim.formats.mesh import F64, I64
from gibson_sim.formats.textures import Warn
from gibson_sim.quoting import quoted
from gibson_sim.reading import parse_xml

Element = ElementTree.Element
_DECIMAL_COMMA = re.compile(r"[+-]?\d*,\d+([eE][+-]?\d+)?")


class DaeDocument:
    """One document.

    Args:
        path: the file, for messages.
        data: its content.
        warn: called with one line for each element that is left out or replaced.

    Raises:
        MeshError: the root is not that of a COLLADA file.
        TextError: the file is not XML, or too large.
    """

    def __init__(self, path: Path, data: bytes, warn: Warn) -> None:
        self.path = path
        self.warn_of_file = warn
        """Warns in one line that names the file itself."""
        if data[:4] == b"PK\x03\x04":
            raise MeshError(f"{path}: is a ZIP archive (ZAE), which is not read; unpack it and use the .dae file in it")
        self.root = parse_xml(data)
        namespace, _, tag = self.root.tag.rpartition("}")
        if tag != "COLLADA":
            raise MeshError(f"{path}: is not a COLLADA file: its root is <{self.root.tag[:60]}>")
        if namespace:
            # Elements in other namespaces, which extras may hold, keep theirs.
            prefix = namespace + "}"
            for element in self.root.iter():
                element.tag = element.tag.removeprefix(prefix)

    def warn(self, text: str) -> None:
        """Warns in one line that begins with the file."""
        self.warn_of_file(f"{self.path}: {text}")

    def error(self, text: str) -> MeshError:
        """Returns an error in one line that begins with the file."""
        return MeshError(f"{self.path}: {text}")

    def by_id(self, path: str) -> dict[str, Element]:
        """Returns id -> element of all elements at an ElementTree path."""
        return {element.get("id", ""): element for element in self.root.iterfind(path)}

    def numbers(self, text: str | None) -> F64:
        """Returns the numbers in a text, (N,) float64; decimal commas, which some exporters write, are read with a warning.

        Raises:
            MeshError: a word is not a number.
        """
        words = (text or "").split()
        try:
            return np.array(words, dtype=np.float64)
        except ValueError:
            # Whoever writes "1,5" writes no commas between numbers: in a list such as "1,2,3" no number can be told.
            pointed = [word.replace(",", ".") if _DECIMAL_COMMA.fullmatch(word) else word for word in words]
        try:
            values = np.array(pointed, dtype=np.float64)
        except ValueError:
            wrong = next(word for word in pointed if not _is_number(word))
            raise self.error(f"{quoted(wrong)} is not a number; must be numbers between spaces, such as 0.5 -2e-3") from None
        self.warn("has numbers with a decimal comma, which COLLADA does not allow; it is read as a decimal point")
        return values

    def integers(self, text: str | None) -> I64:
        """Returns the whole numbers in a text, (N,) int64.

        Raises:
            MeshError: a word is not a whole number.
        """
        words = (text or "").split()
        try:
            return np.array(words, dtype=np.int64)
        except (ValueError, OverflowError):
            wrong = next((word for word in words if not word.lstrip("+-").isdigit()), "a number of many digits")
            raise self.error(f"index {quoted(wrong)} is not a whole number that can be read; the file is broken") from None

    def whole(self, element: Element, name: str, default: int) -> int:
        """Returns an attribute that is a whole number.

        Raises:
            MeshError: it is another value.
        """
        text = element.get(name)
        if text is None:
            return default
        try:
            return int(text)
        except ValueError:
            raise self.error(f"{name}={quoted(text)} of <{element.tag}> must be a whole number") from None


def reference(element: Element, attribute: str = "url") -> str:
    """Returns the id that an attribute refers to: ``#id``, percent-encoded or not; a reference into another file as it is."""
    return unquote(element.get(attribute, "").strip().lstrip("#"))


def children(element: Element, *tags: str) -> Iterator[Element]:
    """Returns the children with one of several tags, in the order of the file."""
    return (child for child in element if child.tag in tags)


def _is_number(word: str) -> bool:
    try:
        float(word)
    except ValueError:
        return False
    return True
