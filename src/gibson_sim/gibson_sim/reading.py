"""Reads untrusted files, YAML and XML within limits. All other modules read through this one.

A path may lead to a pipe, which blocks, to an endless device, or to a text of 500 bytes whose aliases expand to more values than fit into
memory. All limits are checked before any value is built.
"""

from __future__ import annotations

import errno
import os
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
"""Size of a description that is read as text."""
MAX_YAML_BYTES = 8 * 2**20
MAX_YAML_VALUES = 150_000
"""Values of a YAML text; an alias counts as all values that it stands for."""
MAX_DEPTH = 100
"""Levels of nested lists and mappings of a YAML text."""
MAX_XML_TAGS = 300_000
"""Tags of an XML text; an element has one or two."""
MAX_XML_ATTRIBUTES = 500_000
"""Attributes of an XML text."""
MAX_XML_DEPTH = 200
"""Levels of nested elements of an XML text."""
YAML_LOADER: type = getattr(yaml, "CSafeLoader", yaml.SafeLoader)
"""The parser of libyaml, if PyYAML has it, which takes a tenth of the time; else PyYAML's own."""
_LONGEST_REASON = 200
"""Characters of a parser's message that are quoted."""
_LONGEST_NUMBER = 200
"""Characters of a number in YAML, which then fits into a float in any base."""
_NUMBERS = frozenset(f"tag:yaml.org,2002:{kind}" for kind in ("int", "float", "timestamp"))
_NOTHING = ("~", "null", "Null", "NULL")
"""Null values of YAML."""
_MEGA = 2**20
_CHUNK = 65536
"""Bytes that are read at once."""


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
        # A file of /proc reports no size, and a file that another process writes can grow.
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

    The suffix decides how a file is read, and files in a store of blobs, to which an installation can link, have none.
    """
    real = Path(os.path.realpath(path))
    if not path.suffix or path.suffix.lower() == real.suffix.lower() or not is_file(real):
        return real
    return Path(os.path.realpath(path.parent), path.name)


def check_status(status: os.stat_result, most: int) -> None:
    """Checks the status of a file before it is read.

    Raises:
        OSError: it is not a regular file, or has more than ``most`` bytes.
    """
    if not stat.S_ISREG(status.st_mode):
        raise OSError(errno.EINVAL, "is not a regular file")
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
        loader: a loader of PyYAML, for more tags.

    Raises:
        TextError: the text is not YAML, or too large; the message lacks the name of the file, which the caller adds.
    """
    if len(text) > MAX_YAML_BYTES:
        reason = f"has {len(text) / _MEGA:.0f} MB of YAML, must have at most {MAX_YAML_BYTES // _MEGA} MB"
        raise TextError(reason).with_public(reason)
    try:
        parser = loader(text)
    except (yaml.YAMLError, ValueError) as error:
        raise _no_yaml(error) from error
    try:
        node = _Composer(parser).document()
        return None if node is None else parser.construct_document(node)
    # A date with month 13, a number of 5000 digits, bytes that are not text.
    except (yaml.YAMLError, ValueError, OverflowError, TypeError, LookupError, AttributeError, RecursionError) as error:
        raise _no_yaml(error) from error
    finally:
        parser.dispose()


def yaml_texts(text: bytes, keys: Collection[str], *, cut: bool = False) -> dict[str, str]:
    """Returns the texts and numbers of some keys of the outermost mapping, as written, without building the document.

    It stops at the last of the keys; errors behind it are not found.

    Args:
        text: the YAML.
        keys: the keys.
        cut: whether the text may be cut off: at an error, the values before it are returned.

    Raises:
        TextError: the text is not YAML up to where it was read.
    """
    found: dict[str, str] = {}
    try:
        parser = YAML_LOADER(text)
    except (yaml.YAMLError, ValueError) as error:
        raise _no_yaml(error) from error
    depth, count, key = 0, 0, ""
    """Number of open lists and mappings; number of keys and values of the outermost mapping so far; its last key."""
    try:
        while len(found) < len(keys):
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
                if depth > MAX_DEPTH:  # libyaml checks all open collections at each further one
                    raise _too_deep(event)
            elif depth == 1 and isinstance(event, yaml.NodeEvent):
                scalar = event if isinstance(event, yaml.ScalarEvent) else None
                value = "" if scalar is None else scalar.value
                if count % 2 == 0:
                    key = value
                elif scalar is not None and key in keys and value and not (scalar.implicit[0] and value in _NOTHING):
                    found[key] = value
                count += 1
        return found
    except (yaml.YAMLError, ValueError) as error:
        if cut:
            return found
        raise _no_yaml(error) from error
    finally:
        parser.dispose()


def parse_xml(text: bytes) -> ElementTree.Element:
    """Returns the outermost element of an XML text.

    Raises:
        TextError: the text is not XML, or too large; the message lacks the name of the file, which the caller adds.
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
    # Both let a few bytes expand to many: an entity at each reference, a default in every element without that attribute.
    plain = text.replace(b"\0", b"") if b"\0" in text[:4] else text
    for mark, what in ((b"<!ENTITY", "entities"), (b"<!ATTLIST", "defaults of attributes")):
        if mark in plain:
            reason = f"defines XML {what}, which are not read; write out what they stand for"
            raise TextError(reason).with_public(reason)
    try:
        top = ElementTree.fromstring(text)
    # A ValueError or LookupError: a declared encoding that the text does not have.
    except (ElementTree.ParseError, ValueError, LookupError) as error:
        raise TextError(f"is not well-formed XML: {clipped(str(error), _LONGEST_REASON)}").with_public(
            "is not well-formed XML"
        ) from error
    level, depth = [top], 0
    while level:
        depth += 1
        if depth > MAX_XML_DEPTH:
            reason = f"has elements within elements over more than {MAX_XML_DEPTH} levels"
            raise TextError(reason).with_public(reason)
        level = [child for element in level for child in element]
    return top


def _too_large(size: str, most: int) -> str:
    return f"is too large: it has {size}, must have at most {most / _MEGA:g} MB"


def _no_yaml(error: Exception) -> TextError:
    mark = getattr(error, "problem_mark", None)
    at = f"line {mark.line + 1}, column {mark.column + 1}: " if mark is not None else ""
    reason = clipped(str(getattr(error, "problem", None) or error), _LONGEST_REASON)
    if isinstance(error, _TooMuchError):
        return TextError(f"{at}{reason}").with_public(reason)
    return TextError(f"is not YAML: {at}{reason}").with_public("is not YAML that can be read")


class _OpenCollection:
    """A list or a mapping while its values are read."""

    def __init__(self, node: Any, anchor: str | None) -> None:
        self.node, self.anchor, self.size, self.height = node, anchor, 1, 1
        self.key: Any = None
        self.keys: set[tuple[str, str]] = set()


class _Composer:
    """Composes the nodes of a document from its events, as PyYAML's composer does, but without recursion and within limits.

    libyaml's own composer recurses in C, so that 200 KB of ``[`` crash the process.
    """

    def __init__(self, parser: Any) -> None:
        self._parser = parser
        self._anchors: dict[str, tuple[Any, int, int]] = {}
        """Anchor -> its node, the number of its values and of its levels."""
        self._open: list[_OpenCollection] = []

    def document(self) -> Any:
        """Returns the node of the only document, None if there is none."""
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
            done = self._compose(event)
            if done is not None and not self._open:
                root = done

    def _compose(self, event: Any) -> Any:
        """Handles an event; returns the node that it completes, which is part of its collection already, or None."""
        start, end = event.start_mark, event.end_mark
        anchor: Any = getattr(event, "anchor", None)
        if isinstance(event, yaml.AliasEvent):
            known = self._anchors.get(anchor)
            if known is None:
                within = any(entry.anchor == anchor for entry in self._open)
                reason = "holds itself" if within else "is not defined before"
                raise yaml.MarkedYAMLError(problem=f"alias {quoted(anchor)} {reason}", problem_mark=start)
            return self._put(*known, event)
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
        above = self._open[-1]
        above.size += size
        above.height = max(above.height, height + 1)
        if above.size > MAX_YAML_VALUES:
            raise _TooMuchError(
                f"holds more than {MAX_YAML_VALUES} values, each alias counted as what it stands for", event.start_mark
            )
        if len(self._open) + height > MAX_DEPTH:
            raise _too_deep(event)
        if isinstance(above.node, yaml.SequenceNode):
            above.node.value.append(node)
        elif above.key is None:
            above.key = node
            if isinstance(node, yaml.ScalarNode):
                if (node.tag, node.value) in above.keys:
                    problem = f"key {quoted(node.value)} is there twice"
                    raise yaml.MarkedYAMLError(problem=problem, problem_mark=event.start_mark)
                above.keys.add((node.tag, node.value))
        else:
            above.node.value.append((above.key, node))
            above.key = None
        return node


class _TooMuchError(yaml.MarkedYAMLError):
    def __init__(self, problem: str, mark: Any) -> None:
        super().__init__(problem=problem, problem_mark=mark)


def _too_deep(event: Any) -> _TooMuchError:
    return _TooMuchError(f"has lists and mappings within each other over more than {MAX_DEPTH} levels", event.start_mark)
