"""Value types of a scenario file: each parses a YAML value and describes itself as JSON schema. ``keys`` declares the file with them.

Each mistake is recorded with the path of its key, and parsing continues, so that all mistakes of a file are reported at once.
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Mapping
from dataclasses import MISSING, Field, dataclass, field, fields
from typing import Any, Protocol

from gibson_sim.field_docs import field_docs
from gibson_sim.quoting import quoted
from gibson_sim.settings import nearest, setting_fields
from gibson_sim.trials.scenario.spec import SAMPLED

Schema = dict[str, Any]
_MAX_TEXT_LENGTH = 4096
"""Largest length of a text, characters."""
_MAX_KEY_LENGTH = 80
"""Length from which a message quotes and clips an unknown key, characters."""
_MAX_MISTAKES = 20
"""Largest number of mistakes recorded for a file."""


@dataclass(frozen=True, slots=True)
class Location:
    """A location in a file, and the mistakes recorded for the file."""

    path: str
    """Path of the key, such as ``obstacles.people[1].path``; empty = the file itself."""
    mistakes: list[str]

    def key(self, name: str) -> Location:
        """Returns the location of a key of the mapping at this location."""
        return Location(f"{self.path}.{name}" if self.path else name, self.mistakes)

    def item(self, number: int) -> Location:
        """Returns the location of an item of the list at this location."""
        return Location(f"{self.path}[{number}]", self.mistakes)

    def note(self, text: str) -> None:
        """Records a mistake; ``text`` does not name the location."""
        if len(self.mistakes) < _MAX_MISTAKES:
            self.mistakes.append(f"{self.path} {text}" if self.path else text)
        elif len(self.mistakes) == _MAX_MISTAKES:
            self.mistakes.append(f"has more than {_MAX_MISTAKES} mistakes: fix these first")

    def refuse(self, value: object, required: str) -> None:
        """Records that a value is not allowed."""
        self.note(f"is {quoted(value)}, must be {required}" if value is not None else f"has no value, must be {required}")


class Kind(Protocol):
    """A type of value."""

    def read(self, value: Any, at: Location) -> Any:
        """Returns the parsed value; any value after a mistake, which is recorded."""

    def schema(self) -> Schema:
        """Returns the JSON schema of the accepted values."""

    @property
    def allowed(self) -> str:
        """Description of the allowed values, for messages."""


@dataclass(frozen=True, slots=True)
class Number:
    """A finite number within limits; the limits may be infinite."""

    low: float
    high: float
    whole: bool = False

    def read(self, value: Any, at: Location) -> Any:
        """Returns a float, or an int if ``whole``."""
        if not _is_number(value) or not self.low <= value <= self.high or (self.whole and value != int(value)):
            return at.refuse(value, self.allowed)
        return int(value) if self.whole else float(value)

    def schema(self) -> Schema:
        """See ``Kind``."""
        limits = {name: limit for name, limit in (("minimum", self.low), ("maximum", self.high)) if math.isfinite(limit)}
        return {"type": "integer" if self.whole else "number", **limits}

    @property
    def allowed(self) -> str:
        """See ``Kind``."""
        to = f"to {_number_text(self.high)}" if math.isfinite(self.high) else "on"
        return f"a {'whole ' if self.whole else ''}number from {_number_text(self.low)} {to}"


@dataclass(frozen=True, slots=True)
class Flag:
    """True or false."""

    def read(self, value: Any, at: Location) -> Any:
        """See ``Kind``."""
        return value if isinstance(value, bool) else at.refuse(value, self.allowed)

    def schema(self) -> Schema:
        """See ``Kind``."""
        return {"type": "boolean"}

    @property
    def allowed(self) -> str:
        """See ``Kind``."""
        return "true or false"


@dataclass(frozen=True, slots=True)
class Text:
    """A string."""

    allowed: str = "text"
    pattern: str = ""
    """Regular expression that the whole text must match, in the syntax common to Python and ECMAScript; empty = any."""
    check: Callable[[str], str] | None = None
    """Returns the problem with a text that matches; empty = none."""
    empty: bool = False
    """Whether the text may be empty."""

    def read(self, value: Any, at: Location) -> Any:
        """See ``Kind``."""
        if not isinstance(value, str) or not (value or self.empty) or len(value) > _MAX_TEXT_LENGTH:
            return at.refuse(value, self.allowed)
        if value and self.pattern and not re.fullmatch(self.pattern, value, re.ASCII):
            return at.refuse(value, self.allowed)
        problem = self.check(value) if value and self.check else ""
        return at.note(f"is {quoted(value)}: {problem}") if problem else value

    def schema(self) -> Schema:
        """See ``Kind``."""
        result: Schema = {"type": "string", "minLength": 0 if self.empty else 1, "maxLength": _MAX_TEXT_LENGTH}
        if self.pattern:
            result["pattern"] = f"^(?:{self.pattern})?$" if self.empty else f"^(?:{self.pattern})$"
        return result


@dataclass(frozen=True, slots=True)
class Choice:
    """One of several texts."""

    texts: tuple[str, ...]

    def read(self, value: Any, at: Location) -> Any:
        """See ``Kind``."""
        value = ("off", "on")[value] if isinstance(value, bool) and self._is_switch else value
        if isinstance(value, str) and value in self.texts:
            return value
        hint = nearest(value, self.texts) if isinstance(value, str) else ""
        return at.refuse(value, f"{self.allowed}{f'; {hint}' if hint else ''}")

    def schema(self) -> Schema:
        """See ``Kind``."""
        return {"enum": [*self.texts, *([True, False] if self._is_switch else [])]}

    @property
    def _is_switch(self) -> bool:
        """Whether true and false stand for on and off, which YAML 1.1 parses as booleans."""
        return {"on", "off"} <= set(self.texts)

    @property
    def allowed(self) -> str:
        """See ``Kind``."""
        return f"one of {', '.join(self.texts)}"


@dataclass(frozen=True, slots=True)
class Span:
    """Smallest and largest value of a range, or one number for both."""

    low: float
    high: float

    def read(self, value: Any, at: Location) -> Any:
        """Returns (smallest, largest)."""
        pair = value if isinstance(value, list) else [value, value]
        is_valid = len(pair) == 2 and all(_is_number(v) and self.low <= v <= self.high for v in pair)
        if not is_valid or pair[0] > pair[1]:
            return at.refuse(value, self.allowed)
        return float(pair[0]), float(pair[1])

    def schema(self) -> Schema:
        """See ``Kind``."""
        item_schema = Number(self.low, self.high).schema()
        return {"anyOf": [item_schema, {"type": "array", "items": item_schema, "minItems": 2, "maxItems": 2}]}

    @property
    def allowed(self) -> str:
        """See ``Kind``."""
        return f"a number from {_number_text(self.low)} to {_number_text(self.high)}, or [smallest, largest] of them"


@dataclass(frozen=True, slots=True)
class Point:
    """Two coordinates."""

    far: float
    """Largest distance from the origin along an axis, metres."""

    def read(self, value: Any, at: Location) -> Any:
        """Returns (x, y)."""
        if not isinstance(value, list) or len(value) != 2 or not all(_is_number(v) and abs(v) <= self.far for v in value):
            return at.refuse(value, self.allowed)
        return float(value[0]), float(value[1])

    def schema(self) -> Schema:
        """See ``Kind``."""
        return {"type": "array", "items": Number(-self.far, self.far).schema(), "minItems": 2, "maxItems": 2}

    @property
    def allowed(self) -> str:
        """See ``Kind``."""
        return f"[x, y] in metres, each from {_number_text(-self.far)} to {_number_text(self.far)}"


@dataclass(frozen=True, slots=True)
class ListOf:
    """A list of values of one type."""

    kind: Kind
    maximum: int
    """Largest number of values."""
    minimum: int = 1
    allow_single: bool = True
    """Whether a single value may be given without a list."""

    def read(self, value: Any, at: Location) -> Any:
        """Returns a tuple."""
        if not isinstance(value, list):
            return (self.kind.read(value, at),) if self.allow_single else at.refuse(value, self.allowed)
        if not self.minimum <= len(value) <= self.maximum:
            return at.note(f"has {len(value)} values, must have {self.minimum} to {self.maximum}")
        return tuple(self.kind.read(item, at.item(i)) for i, item in enumerate(value))

    def schema(self) -> Schema:
        """See ``Kind``."""
        item_schema = self.kind.schema()
        array = {"type": "array", "items": item_schema, "minItems": self.minimum, "maxItems": self.maximum}
        return {"anyOf": [item_schema, array]} if self.allow_single else array

    @property
    def allowed(self) -> str:
        """See ``Kind``."""
        return f"a list, each {self.kind.allowed}"


@dataclass(frozen=True, slots=True)
class OrNone:
    """A value, or null."""

    kind: Kind
    none: Any = None
    """Value that null stands for."""

    def read(self, value: Any, at: Location) -> Any:
        """See ``Kind``."""
        return self.none if value is None else self.kind.read(value, at)

    def schema(self) -> Schema:
        """See ``Kind``."""
        inner = self.kind.schema()
        return {"anyOf": [*(inner["anyOf"] if set(inner) == {"anyOf"} else [inner]), {"type": "null"}]}

    @property
    def allowed(self) -> str:
        """See ``Kind``."""
        return f"{self.kind.allowed}, or null"


@dataclass(frozen=True, slots=True)
class CommandLine:
    """A command line: one text that is split as in a shell, or a list of texts."""

    maximum: int
    """Largest number of arguments, program included."""
    split: Callable[[str], list[str]]
    """Splits a text into arguments; raises ValueError if it cannot."""

    def read(self, value: Any, at: Location) -> Any:
        """Returns a tuple of texts."""
        if isinstance(value, str) and len(value) <= _MAX_TEXT_LENGTH:
            try:
                value = self.split(value)
            except ValueError as error:
                return at.note(f"is {quoted(value)}: {str(error).lower()}")
        is_valid = isinstance(value, list) and all(isinstance(word, str) and len(word) <= _MAX_TEXT_LENGTH for word in value)
        if not is_valid or not 1 <= len(value) <= self.maximum or not value[0]:
            return at.refuse(value, self.allowed)
        return tuple(value)

    def schema(self) -> Schema:
        """See ``Kind``."""
        text = {"type": "string", "maxLength": _MAX_TEXT_LENGTH}
        array = {
            "type": "array",
            "prefixItems": [{**text, "minLength": 1}],
            "items": text,
            "minItems": 1,
            "maxItems": self.maximum,
        }
        return {"anyOf": [{**text, "minLength": 1}, array]}

    @property
    def allowed(self) -> str:
        """See ``Kind``."""
        return f"a command line, as one text or a list of at most {self.maximum} texts; quote numbers"


@dataclass(frozen=True, slots=True)
class Variables:
    """A mapping of environment variables to texts."""

    reserved: tuple[str, ...]
    """Names that are not allowed."""
    maximum: int = 200
    pattern: str = r"[A-Za-z_][A-Za-z0-9_]*"

    def read(self, value: Any, at: Location) -> Any:
        """Returns a dictionary; numbers are converted to texts."""
        if not isinstance(value, Mapping) or len(value) > self.maximum:
            return at.refuse(value, self.allowed)
        result = {}
        for name, text in value.items():
            place = at.key(key_text(name))
            if not isinstance(name, str) or not re.fullmatch(self.pattern, name, re.ASCII):
                place.note("is not a variable name: letters, digits and _, no digit first")
            elif name in self.reserved:
                place.note("is set by the trial; leave it out")
            elif isinstance(text, bool) or not isinstance(text, (str, int, float)) or len(str(text)) > _MAX_TEXT_LENGTH:
                place.refuse(text, "text or a number; quote true and false")
            else:
                result[name] = str(text)
        return result

    def schema(self) -> Schema:
        """See ``Kind``."""
        return {
            "type": "object",
            "propertyNames": {"pattern": f"^{self.pattern}$", "not": {"enum": list(self.reserved)}},
            "additionalProperties": {"type": ["string", "number"], "maxLength": _MAX_TEXT_LENGTH},
            "maxProperties": self.maximum,
        }

    @property
    def allowed(self) -> str:
        """See ``Kind``."""
        return f"a mapping of at most {self.maximum} names to texts"


@dataclass(frozen=True, slots=True)
class Section:
    """A mapping whose keys are the fields of a dataclass."""

    cls: type
    kinds: Mapping[str, Kind]
    """Value type of each key; all fields of the class that a file may set."""
    short: str = ""
    """Key that a bare value stands for; empty = a mapping is required."""

    def read(self, value: Any, at: Location) -> Any:
        """Returns an instance of the class; None after a mistake."""
        if not isinstance(value, Mapping):
            if self.short and value is not None:
                return self.cls(**{self.short: self.kinds[self.short].read(value, at)})
            return at.refuse(value, self.allowed)
        previous_mistakes = len(at.mistakes)
        values = self.values(value, at)
        return None if len(at.mistakes) > previous_mistakes else self.cls(**values)

    def values(self, value: Mapping[Any, Any], at: Location) -> dict[str, Any]:
        """Returns the values of the keys that the mapping has."""
        result = {}
        for key, content in value.items():
            kind = self.kinds.get(key) if isinstance(key, str) else None
            if kind is None:
                hint = nearest(str(key), tuple(self.kinds)) if isinstance(key, str) else ""
                at.key(key_text(key)).note(f"is not a key; {f'{hint} ' if hint else ''}known: {', '.join(self.kinds)}")
            else:
                result[key] = kind.read(content, at.key(key))
        for name in self._required():
            if name not in value:
                at.key(name).note(f"is missing: {field_docs(self.cls).get(name, self.kinds[name].allowed)}")
        return result

    def correct_values(self, value: Mapping[Any, Any]) -> dict[str, Any]:
        """Returns the values without a mistake; those of a section with mistakes are in an instance with defaults for its other keys."""
        result = {}
        for key, content in value.items():
            kind, at = self.kinds.get(key) if isinstance(key, str) else None, Location("", [])
            if kind is None:
                continue
            content_read = kind.read(content, at)
            if not at.mistakes:
                result[key] = content_read
            elif isinstance(kind, Section) and isinstance(content, Mapping):
                inside = kind.correct_values(content)
                if inside.keys() >= set(kind._required()):
                    result[key] = kind.cls(**inside)
        return result

    def schema(self) -> Schema:
        """See ``Kind``."""
        docs = field_docs(self.cls)
        known = {f.name: f for f in fields(self.cls)}
        properties = {}
        for name, kind in self.kinds.items():
            description = docs.get(name) or _summary(kind)
            properties[name] = {
                **({"description": description.replace("``", "`")} if description else {}),
                **kind.schema(),
                **_default(known.get(name), kind),
            }
        mapping: Schema = {"type": "object", "properties": properties, "additionalProperties": False}
        if self._required():
            mapping["required"] = self._required()
        return {"anyOf": [self.kinds[self.short].schema(), mapping]} if self.short else mapping

    def _required(self) -> list[str]:
        missing = (f.name for f in fields(self.cls) if f.default is MISSING and f.default_factory is MISSING)
        return [name for name in missing if name in self.kinds]

    @property
    def allowed(self) -> str:
        """See ``Kind``."""
        other = f"{self.kinds[self.short].allowed}, or " if self.short else ""
        return f"{other}a mapping with {', '.join(self.kinds)}"


@dataclass(frozen=True, slots=True)
class SettingsOf:
    """Settings of a node: a mapping whose keys are fields of its dataclass, declared with ``settings.setting``."""

    cls: type
    without: tuple[str, ...] = ()
    """Settings that are not allowed."""
    _fields: dict[str, Field[Any]] = field(init=False)

    def __post_init__(self) -> None:
        object.__setattr__(self, "_fields", {f.name: f for f in setting_fields(self.cls) if f.name not in self.without})

    def read(self, value: Any, at: Location) -> Any:
        """Returns a dictionary."""
        if not isinstance(value, Mapping):
            return at.refuse(value, self.allowed)
        result = {}
        for key, content in value.items():
            if key in self.without:
                at.key(key).note("is set by the trial; leave it out")
            elif key not in self._fields:
                hint = nearest(str(key), tuple(self._fields))
                at.key(key_text(key)).note(
                    f"is not a setting that a trial accepts{f'; {hint}' if hint else ''} See docs/parameters.md"
                )
            else:
                result[key] = self._kind(self._fields[key]).read(content, at.key(key))
        return result

    def schema(self) -> Schema:
        """See ``Kind``."""
        properties = {}
        for name, f in self._fields.items():
            unit = f" ({f.metadata['unit']})" if f.metadata["unit"] else ""
            properties[name] = {
                "description": f"{f.metadata['doc']}{unit}".replace("``", "`"),
                **self._kind(f).schema(),
                "default": f.default,
            }
        return {"type": "object", "properties": properties, "additionalProperties": False}

    @staticmethod
    def _kind(f: Field[Any]) -> Kind:
        if isinstance(f.default, bool):
            return Flag()
        if isinstance(f.default, (int, float)):
            return Number(f.metadata["minimum"], f.metadata["maximum"], isinstance(f.default, int))
        return Choice(f.metadata["choices"]) if f.metadata["choices"] else Text(empty=True)

    @property
    def allowed(self) -> str:
        """See ``Kind``."""
        return "a mapping of settings, see docs/parameters.md"


def _is_number(value: Any) -> bool:
    return isinstance(value, (int, float)) and not isinstance(value, bool) and math.isfinite(value)


def key_text(key: object) -> str:
    """Returns a key of a file as part of a key path in a message."""
    return key if isinstance(key, str) and key.isprintable() and 0 < len(key) < _MAX_KEY_LENGTH else quoted(key)


def _number_text(value: float) -> str:
    return f"{value:g}" if abs(value) < 1e6 else f"{value:.0f}" if abs(value) < 1e15 else str(int(value))


def _summary(kind: Kind) -> str:
    """Returns the first sentence of the docstring of a section's class; empty = none."""
    while isinstance(kind, (ListOf, OrNone)):
        kind = kind.kind
    cls = getattr(kind, "cls", None)
    return " ".join((cls.__doc__ or "").split("\n\n")[0].split()) if cls is not None else ""


def _default(f: Field[Any] | None, kind: Kind) -> Schema:
    """Returns the default of a field as an entry of a schema; empty if it has none that YAML can express."""
    if f is None or f.default is MISSING:
        return {}
    if f.default == (SAMPLED,):
        return {"default": SAMPLED}
    if isinstance(f.default, tuple):
        return {} if isinstance(kind, ListOf) and len(f.default) < kind.minimum else {"default": list(f.default)}
    return {"default": f.default} if f.default is None or isinstance(f.default, (bool, int, float, str)) else {}
