"""Message definitions as embedded in a bag: the text of a type, the texts of all nested types, and its RIHS01 hash.

Definitions are searched in those that the caller gives, in the ROS installations, in the source tree, and last in the Jazzy types of
`rosbags`. Must not import rclpy or a message package.
"""

from __future__ import annotations

import os
import re
import sys
from collections.abc import Iterator, Mapping
from functools import lru_cache
from pathlib import Path
from typing import Any

from rosbags.serde import SerdeError
from rosbags.typesys import Stores, TypesysError, get_types_from_msg, get_typestore
from rosbags.typesys.store import Typestore

from gibson_sim.errors import RecordError
from gibson_sim.quoting import quoted

_SEPARATOR = "=" * 80
_SERVICE_SEPARATOR = re.compile(r"^---[^\S\n]*$\n?", re.MULTILINE)
"""Separator line between request and response."""
_TYPE_NAME = re.compile(r"([a-zA-Z][a-zA-Z0-9_]*)/(?:msg/)?([a-zA-Z][a-zA-Z0-9_]*)")


def canonical_type(name: str) -> str:
    """Returns ``package/msg/Type`` for ``package/msg/Type`` or ``package/Type``.

    Raises:
        RecordError: the name is not that of a message type (services and actions cannot be recorded).
    """
    match = _TYPE_NAME.fullmatch(name)
    if not match:
        raise RecordError(
            f"type {quoted(name)} is not a message type; must be <package>/msg/<Type>, such as sensor_msgs/msg/Image"
        )
    return f"{match[1]}/msg/{match[2]}"


class MessageDefinitions:
    """Finds and caches definitions of message types.

    Args:
        given: text of the ``.msg`` file by type name; takes precedence over installed definitions.
    """

    def __init__(self, given: Mapping[str, str] | None = None) -> None:
        self._texts = {canonical_type(name): text for name, text in (given or {}).items()}
        self._full: dict[str, tuple[str, str]] = {}

    def full_text(self, type_name: str) -> str:
        """Returns the definition followed by those of all nested types, as rosbag2 writes it (encoding ``ros2msg``).

        Raises:
            RecordError: the definition, or that of a nested type, is not found or cannot be parsed.
        """
        return self._resolve(canonical_type(type_name))[0]

    def service_texts(self, type_name: str) -> tuple[str, str]:
        """Returns the definitions of request and response of a service type, ``std_srvs/srv/Trigger``, as ``full_text`` does.

        Raises:
            RecordError: the definition, or that of a nested type, is not found or cannot be parsed.
        """
        package, _, name = type_name.partition("/srv/")
        text = _installed_text(package, "srv", name)
        if text is None:
            raise RecordError(f"service type {quoted(type_name)}: no .srv file found; source the workspace that defines it")
        definitions = []
        for part, lines in zip(("Request", "Response"), [*_SERVICE_SEPARATOR.split(text, maxsplit=1), ""], strict=False):
            full = f"{package}/msg/{name}_{part}"
            self._texts[full] = lines.strip("\n") + "\n"
            definitions.append(self._resolve(full)[0])
        return definitions[0], definitions[1]

    def type_hash(self, type_name: str) -> str:
        """Returns the hash of the type, ``RIHS01_<64 hex digits>``.

        Raises:
            RecordError: the definition, or that of a nested type, is not found or cannot be parsed.
        """
        return self._resolve(canonical_type(type_name))[1]

    def _resolve(self, name: str) -> tuple[str, str]:
        if name not in self._full:
            text = self._text(name, wanted_by="")
            parts, seen, waiting = [text.rstrip("\n") + "\n"], {name}, [(name, text)]
            while waiting:
                outer, text = waiting.pop(0)
                for inner in _nested_types(outer, text):
                    if inner in seen:
                        continue
                    seen.add(inner)
                    text = self._text(inner, wanted_by=outer)
                    parts.append(f"{_SEPARATOR}\nMSG: {inner.replace('/msg/', '/')}\n{text.rstrip()}\n")
                    waiting.append((inner, text))
            full = "".join(parts)
            self._full[name] = full, _hash(name, full)
        return self._full[name]

    def _text(self, name: str, wanted_by: str) -> str:
        """Returns the text of a type without its nested types."""
        if name not in self._texts:
            package, _, short = name.partition("/msg/")
            text = _installed_text(package, "msg", short)
            if text is None:
                text = _jazzy_text(name)
            if text is None:
                of = f"type {quoted(name)}" + (f", which {wanted_by} contains" if wanted_by else "")
                raise RecordError(
                    f"{of}: no .msg file found under share/*/msg of {', '.join(map(str, _prefixes())) or 'any installation'}; "
                    "source the workspace that defines it before recording"
                )
            self._texts[name] = text
        return self._texts[name]


def settled(type_name: str, text: str, recorded_hash: str) -> tuple[str, str, str]:
    """Settles a full definition and a hash that do not agree, by the installed definition of the type.

    Args:
        type_name: name of the type.
        text: full definition in encoding ``ros2msg``, as a bag has it.
        recorded_hash: hash as the bag has it; empty = none.

    Returns:
        The definition, the hash, and one line that says which of the two was changed; empty if they agree.
    """
    installed = MessageDefinitions()
    try:
        own = _hash(type_name, text)
    except (RecordError, ValueError, RecursionError):
        own = ""
    if own == recorded_hash or (own and not recorded_hash):
        return text, recorded_hash, ""
    try:
        known = installed.type_hash(type_name)
    except RecordError:
        known = ""
    if known and (known == recorded_hash or not own):
        return (
            installed.full_text(type_name),
            known,
            f"the description of type {type_name} was damaged; in its place: the installed one",
        )
    return text, own, f"the hash of type {type_name} did not match its description: the description counts"


@lru_cache(maxsize=1024)
def _nested_types(name: str, text: str) -> tuple[str, ...]:
    """Returns the message types of the fields in order, without repetition."""
    try:
        fields = get_types_from_msg(text, name)[name][1]
    except (TypesysError, KeyError) as error:
        raise RecordError(f"type {quoted(name)}: its definition is not understood ({error}); it cannot be recorded") from error
    return tuple(dict.fromkeys(_message_types(desc) for _, desc in fields if _message_types(desc)))


def _message_types(desc: Any) -> str:
    """Returns the message type of a field or of an array's elements; empty for primitive types."""
    kind, rest = desc
    if kind.name in ("ARRAY", "SEQUENCE"):
        return _message_types(rest[0])
    return str(rest) if kind.name == "NAME" else ""


@lru_cache(maxsize=1024)
def _hash(name: str, full_text: str) -> str:
    """Returns the hash of a type from its full definition."""
    store = get_typestore(Stores.EMPTY)
    try:
        store.register(get_types_from_msg(full_text, name))
        return str(store.hash_rihs01(name))
    except (TypesysError, SerdeError, KeyError) as error:
        raise RecordError(f"type {quoted(name)}: its definition is not understood ({error}); it cannot be recorded") from error


def _prefixes() -> tuple[Path, ...]:
    """Returns the roots of the ROS installations in order of precedence."""
    entries = [*os.environ.get("AMENT_PREFIX_PATH", "").split(os.pathsep), sys.prefix]
    return tuple(dict.fromkeys(Path(entry) for entry in entries if entry))


def _candidates(package: str, kind: str, name: str) -> Iterator[Path]:
    for prefix in _prefixes():
        yield prefix / "share" / package / kind / f"{name}.{kind}"
    for parent in Path(__file__).resolve().parents:
        for source in ("src", "ros_ws/src/compat"):
            yield parent / source / package / kind / f"{name}.{kind}"


def _installed_text(package: str, kind: str, name: str) -> str | None:
    """Returns the definition of a type; ``kind``: msg or srv."""
    for path in _candidates(package, kind, name):
        if path.is_file():
            return path.read_text(encoding="utf-8")
    return None


def _jazzy_text(type_name: str) -> str | None:
    store = _jazzy_store()
    if type_name not in store.fielddefs:
        return None
    return str(store.generate_msgdef(type_name, ros_version=2)[0].partition(_SEPARATOR)[0])


@lru_cache(maxsize=1)
def _jazzy_store() -> Typestore:
    return get_typestore(Stores.ROS2_JAZZY)
