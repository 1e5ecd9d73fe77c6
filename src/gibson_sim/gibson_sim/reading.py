"""Reads untrusted files, YAML and XML within limits. All other modules use it to read files.

A path may be a pipe, which blocks, an endless device, or a YAML text of 500 bytes whose aliases expand to more values than fit into memory.
All limits are checked before any value is constructed.
"""

from __future__ import annotations

import errno
import os
import re
import stat
import sys
from collections.abc import Collection
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import yaml

from gibson_sim.errors import TextError
from gibson_sim.quoting import clipped, quoted

MAX_TEXT_BYTES = 32 * 2**20
"""Maximum size of a description, bytes."""
MAX_YAML_BYTES = 8 * 2**20
MAX_YAML_VALUES = 150_000
"""Maximum number of values of a YAML text; an alias counts as all values that it expands to."""
MAX_DEPTH = 100
"""Maximum nesting depth of lists and mappings of a YAML text."""
MAX_XML_TAGS = 300_000
"""Maximum number of tags of an XML text; an element has one or two."""
MAX_XML_ATTRIBUTES = 500_000
"""Maximum number of attributes of an XML text."""
MAX_XML_DEPTH = 200
"""Maximum nesting depth of elements of an XML text."""
_NO_DECLARATION = re.compile(rb"\s*(?:<\?xml(?![^<>]*\sversion\s*=)(?:\s[^<>]*)?\?>)?")
"""White space at the begin of an XML text, and a declaration without a version."""
YAML_LOADER: type = getattr(yaml, "CSafeLoader", yaml.SafeLoader)
"""The loader of libyaml if PyYAML has it, which is ten times as fast; else the pure Python loader."""
_LONGEST_REASON = 200
"""Maximum length of a quoted parser message, characters."""
_LONGEST_NUMBER = 200
"""Maximum length of a number in YAML, characters, so that it fits into a float in any base."""
_NUMBERS = frozenset(f"tag:yaml.org,2002:{kind}" for kind in ("int", "float", "timestamp"))
_NULL = ("~", "null", "Null", "NULL")
"""Spellings of null in YAML."""
_MEGA = 2**20
_CHUNK = 65536
"""Size of a read, bytes."""


def read_file(path: Path, most: int = MAX_TEXT_BYTES) -> bytes:
    """Returns the content of a regular file of at most ``most`` bytes.

    Raises:
        OSError: the path is not a regular file, or it is too large or cannot be read; ``strerror`` says which.
    """
    try:
        descriptor = os.open(path, os.O_RDONLY | os.O_NONBLOCK | os.O_NOCTTY | os.O_CLOEXEC)
    except ValueError as error:  # a NUL, or characters that cannot be encoded
        raise OSError(errno.EINVAL, "no file can have this name") from error
    try:
        status = os.fstat(descriptor)
        check_status(status, most)
    except OSError:
        os.close(descriptor)
        raise
    with open(descriptor, "rb") as file:
        parts = [file.read(status.st_size) or b""]
        size = len(parts[0])
        # Files of /proc report size 0, and a file that another process writes can grow.
        while more := file.read(_CHUNK):
            parts.append(more)
            size += len(more)
            if size > most:
                raise OSError(errno.EFBIG, _too_large("more", most))
    return parts[0] if len(parts) == 1 else b"".join(parts)


def read_head(path: Path, most: int) -> bytes:
    """Returns at most the first ``most`` bytes of a regular file of any size.

    Raises:
        OSError: the path is not a regular file, or cannot be read; ``strerror`` says which.
    """
    try:
        descriptor = os.open(path, os.O_RDONLY | os.O_NONBLOCK | os.O_NOCTTY | os.O_CLOEXEC)
    except ValueError as error:
        raise OSError(errno.EINVAL, "no file can have this name") from error
    with open(descriptor, "rb") as file:
        check_status(os.fstat(descriptor), sys.maxsize)
        return file.read(most)


def is_file(path: Path) -> bool:
    """Returns whether a path is a regular file that this process may access; False for invalid paths (a NUL in it, too long)."""
    try:
        return stat.S_ISREG(os.stat(path).st_mode)
    except (OSError, ValueError):
        return False


def is_folder(path: Path) -> bool:
    """Returns whether a path is a folder that this process may access; False for invalid paths."""
    try:
        return stat.S_ISDIR(os.stat(path).st_mode)
    except (OSError, ValueError):
        return False


def exists(path: Path) -> bool:
    """Returns whether a path exists and this process may access it; False for invalid paths."""
    try:
        os.stat(path)
    except (OSError, ValueError):
        return False
    return True


def real_path(path: Path) -> Path:
    """Returns a path with symbolic links resolved, except for the link of a file whose target has another suffix.

    The suffix determines the format of a file, and the blobs to which an installation may link have no suffix.
    """
    real = Path(os.path.realpath(path))
    if not path.suffix or path.suffix.lower() == real.suffix.lower() or not is_file(real):
        return real
    return Path(os.path.realpath(path.parent), path.name)


def check_status(status: os.stat_result, most: int) -> None:
    """Checks the status of a file before reading.

    Raises:
        OSError: the file is not a regular file, or has more than ``most`` bytes.
    """
    if not stat.S_ISREG(status.st_mode):
        raise OSError(errno.EINVAL, "it is not a regular file")
    if status.st_size > most:
        raise OSError(errno.EFBIG, _too_large(f"{status.st_size / _MEGA:.0f} MB", most))


def read_yaml_file(path: Path, most: int = MAX_YAML_BYTES) -> Any:
    """Returns the document in a YAML file of at most ``most`` bytes, in Python's built-in types.

    Raises:
        OSError: as ``read_file``.
        TextError: as ``parse_yaml``.
    """
    return parse_yaml(read_file(path, most))


def parse_yaml(text: str | bytes, loader: type = YAML_LOADER) -> Any:
    """Returns the document in a YAML text, in Python's built-in types.

    Args:
        text: the YAML with one document.
        loader: a PyYAML loader, for additional tags.

    Raises:
        TextError: the text is not YAML, or too large; the caller adds the name of the file to the message.
    """
    if len(text) > MAX_YAML_BYTES:
        reason = f"has {len(text) / _MEGA:.0f} MB of YAML, must have at most {MAX_YAML_BYTES // _MEGA} MB"
        raise TextError(reason).with_public(reason)
    try:
        parser = loader(text)
    except (yaml.YAMLError, ValueError) as error:
        raise _yaml_error(error) from error
    try:
        node = _Composer(parser).document()
        return None if node is None else parser.construct_document(node)
    # A date with month 13, a number of 5000 digits, bytes that are not text.
    except (yaml.YAMLError, ValueError, OverflowError, TypeError, LookupError, AttributeError, RecursionError) as error:
        raise _yaml_error(error) from error
    finally:
        parser.dispose()


def yaml_texts(text: bytes, keys: Collection[str], *, cut: bool = False) -> dict[str, str]:
    """Returns the scalars of some keys of the outermost mapping, as strings, without constructing the document.

    It stops after the last of the keys; later errors are not detected.

    Args:
        text: the YAML.
        keys: the keys.
        cut: whether the text may be truncated: on an error, the values before it are returned.

    Raises:
        TextError: the part of the text that was read is not YAML.
    """
    texts: dict[str, str] = {}
    try:
        parser = YAML_LOADER(text)
    except (yaml.YAMLError, ValueError) as error:
        raise _yaml_error(error) from error
    depth, count, key = 0, 0, ""
    """Number of open lists and mappings; number of keys and values of the outermost mapping so far; its last key."""
    try:
        while len(texts) < len(keys):
            event = parser.get_event()
            if event is None or isinstance(event, yaml.StreamEndEvent):
                break
            if isinstance(event, yaml.CollectionEndEvent):
                depth -= 1
                count += depth == 1
                continue
            if depth == 0 and isinstance(event, yaml.NodeEvent) and not isinstance(event, yaml.MappingStartEvent):
                break
            if isinstance(event, yaml.CollectionStartEvent):
                key = "" if depth == 1 and count % 2 == 0 else key
                depth += 1
                if depth > MAX_DEPTH:  # the time of libyaml grows with the square of the depth
                    raise _too_deep(event)
            elif depth == 1 and isinstance(event, yaml.NodeEvent):
                scalar = event if isinstance(event, yaml.ScalarEvent) else None
                value = "" if scalar is None else scalar.value
                if count % 2 == 0:
                    key = value
                elif scalar is not None and key in keys and value and not (scalar.implicit[0] and value in _NULL):
                    texts[key] = value
                count += 1
        return texts
    except (yaml.YAMLError, ValueError) as error:
        if cut:
            return texts
        raise _yaml_error(error) from error
    finally:
        parser.dispose()


def parse_xml(text: bytes) -> ElementTree.Element:
    """Returns the outermost element of an XML text.

    Raises:
        TextError: the text is not XML, or too large; the caller adds the name of the file to the message.
    """
    if len(text) > MAX_TEXT_BYTES:
        reason = f"has {len(text) / _MEGA:.0f} MB of XML, must have at most {MAX_TEXT_BYTES // _MEGA} MB"
        raise TextError(reason).with_public(reason)
    tags = text.count(b"<")
    if tags > MAX_XML_TAGS:
        reason = f"has about {tags} tags of XML, must have at most {MAX_XML_TAGS}; split it"
        raise TextError(reason).with_public(reason)
    attributes = text.count(b"=")
    if attributes > MAX_XML_ATTRIBUTES:
        reason = f"has about {attributes} attributes of XML, must have at most {MAX_XML_ATTRIBUTES}; split it"
        raise TextError(reason).with_public(reason)
    # Reject constructs that expand a few bytes to many: entities, and attribute defaults.
    plain = text.replace(b"\0", b"") if b"\0" in text[:4] else text
    for mark, what in ((b"<!ENTITY", "entities"), (b"<!ATTLIST", "defaults of attributes")):
        if mark in plain:
            reason = f"defines XML {what}, which are not supported; write out their values"
            raise TextError(reason).with_public(reason)
    try:
        # Gazebo and ROS (tinyxml2) allow white space before the XML declaration, and one without a version; files have both.
        begin = _NO_DECLARATION.match(text)
        top = ElementTree.fromstring(text[begin.end() :] if begin is not None else text)
    # ValueError, LookupError: wrong or unknown declared encoding.
    except (ElementTree.ParseError, ValueError, LookupError) as error:
        raise TextError(f"is not well-formed XML: {clipped(str(error), _LONGEST_REASON)}").with_public(
            "is not well-formed XML"
        ) from error
    level, depth = [top], 0
    while level:
        depth += 1
        if depth > MAX_XML_DEPTH:
            reason = f"has elements that are nested deeper than {MAX_XML_DEPTH} levels"
            raise TextError(reason).with_public(reason)
        level = [child for element in level for child in element]
    return top


def without_default_namespace(top: ElementTree.Element) -> ElementTree.Element:
    """Removes the namespace of the outermost element from all elements, and returns the outermost.

    Readers of formats that have no namespace ignore ``xmlns``, as tinyxml2 does.
    """
    namespace, _, _ = top.tag.rpartition("}")
    if namespace:
        for element in top.iter():
            element.tag = element.tag.removeprefix(f"{namespace}}}")
    return top


def _too_large(size: str, most: int) -> str:
    return f"it is too large: it has {size}, must have at most {most / _MEGA:g} MB"


def _yaml_error(error: Exception) -> TextError:
    mark = getattr(error, "problem_mark", None)
    at = f"line {mark.line + 1}, column {mark.column + 1}: " if mark is not None else ""
    reason = clipped(str(getattr(error, "problem", None) or error), _LONGEST_REASON)
    if isinstance(error, _TooMuchError):
        return TextError(f"{at}{reason}").with_public(reason)
    return TextError(f"is not YAML: {at}{reason}").with_public("is not YAML that can be read")


class _OpenCollection:
    """A list or a mapping whose values are being read."""

    def __init__(self, node: Any, anchor: str | None) -> None:
        self.node, self.anchor, self.size, self.height = node, anchor, 1, 1
        self.key: Any = None
        self.keys: set[tuple[str, str]] = set()


class _Composer:
    """Composes the nodes of a document from its events, like PyYAML's composer, but without recursion and within limits.

    The composer of libyaml recurses in C, so that 200 KB of ``[`` crash the process.
    """

    def __init__(self, parser: Any) -> None:
        self._parser = parser
        self._anchors: dict[str, tuple[Any, int, int]] = {}
        """Anchor -> (node, number of values, number of levels)."""
        self._open: list[_OpenCollection] = []

    def document(self) -> Any:
        """Returns the node of the only document, None for an empty text."""
        parser = self._parser
        root: Any = None
        documents = 0
        while True:
            event = parser.get_event()
            if event is None or isinstance(event, yaml.StreamEndEvent):
                return root
            start = event.start_mark
            if isinstance(event, yaml.DocumentStartEvent):
                documents += 1
                if documents > 1:
                    raise yaml.MarkedYAMLError(problem="there is a second document", problem_mark=start)
                self._anchors.clear()
            completed = self._compose(event)
            if completed is not None and not self._open:
                root = completed

    def _compose(self, event: Any) -> Any:
        """Handles an event; returns the node that it completes, which is already added to its collection, or None."""
        start, end = event.start_mark, event.end_mark
        anchor: Any = getattr(event, "anchor", None)
        if isinstance(event, yaml.AliasEvent):
            anchored = self._anchors.get(anchor)
            if anchored is None:
                within = any(entry.anchor == anchor for entry in self._open)
                reason = "holds itself" if within else "is not defined before"
                raise yaml.MarkedYAMLError(problem=f"alias {quoted(anchor)} {reason}", problem_mark=start)
            return self._put(*anchored, event)
        if isinstance(event, yaml.ScalarEvent):
            node: Any = yaml.ScalarNode(self._tag(yaml.ScalarNode, event, event.value), event.value, start, end)
            if node.tag in _NUMBERS and len(event.value) > _LONGEST_NUMBER:
                problem = f"a number has {len(event.value)} characters, must have at most {_LONGEST_NUMBER}"
                raise yaml.MarkedYAMLError(problem=problem, problem_mark=start)
            if "\0" in event.value:
                raise yaml.MarkedYAMLError(problem="a text holds a NUL", problem_mark=start)
            if anchor is not None:
                self._anchors[anchor] = (node, 1, 0)
            return self._put(node, 1, 0, event)
        if isinstance(event, yaml.CollectionStartEvent):
            kind = yaml.SequenceNode if isinstance(event, yaml.SequenceStartEvent) else yaml.MappingNode
            node = kind(self._tag(kind, event, None), [], start, None, flow_style=event.flow_style)
            self._open.append(_OpenCollection(node, anchor))
            if len(self._open) > MAX_DEPTH:
                raise _too_deep(event)
            return None
        if isinstance(event, yaml.CollectionEndEvent):
            entry = self._open.pop()
            entry.node.end_mark = end
            if entry.anchor is not None:
                self._anchors[entry.anchor] = (entry.node, entry.size, entry.height)
            return self._put(entry.node, entry.size, entry.height, event)
        return None

    def _tag(self, kind: type, event: Any, value: str | None) -> Any:
        return self._parser.resolve(kind, value, event.implicit) if event.tag is None or event.tag == "!" else event.tag

    def _put(self, node: Any, size: int, height: int, event: Any) -> Any:
        """Adds a node to the innermost open list or mapping."""
        if not self._open:
            return node
        parent = self._open[-1]
        parent.size += size
        parent.height = max(parent.height, height + 1)
        if parent.size > MAX_YAML_VALUES:
            raise _TooMuchError(f"holds more than {MAX_YAML_VALUES} values, with aliases expanded", event.start_mark)
        if len(self._open) + height > MAX_DEPTH:
            raise _too_deep(event)
        if isinstance(parent.node, yaml.SequenceNode):
            parent.node.value.append(node)
        elif parent.key is None:
            parent.key = node
            if isinstance(node, yaml.ScalarNode):
                if (node.tag, node.value) in parent.keys:
                    problem = f"key {quoted(node.value)} is given twice"
                    raise yaml.MarkedYAMLError(problem=problem, problem_mark=event.start_mark)
                parent.keys.add((node.tag, node.value))
        else:
            parent.node.value.append((parent.key, node))
            parent.key = None
        return node


class _TooMuchError(yaml.MarkedYAMLError):
    def __init__(self, problem: str, mark: Any) -> None:
        super().__init__(problem=problem, problem_mark=mark)


def _too_deep(event: Any) -> _TooMuchError:
    return _TooMuchError(f"has lists and mappings that are nested deeper than {MAX_DEPTH} levels", event.start_mark)
