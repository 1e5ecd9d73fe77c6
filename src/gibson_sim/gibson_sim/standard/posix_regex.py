"""POSIX extended regular expressions, matched in linear time.

Python's ``re`` has a different syntax and takes exponential time for malicious patterns; a client's filter must not block the simulator.
A pattern is compiled to a Glushkov automaton, which has one state per character of the pattern; a set of states is an integer with one
bit for each. https://pubs.opengroup.org/onlinepubs/9799919799/basedefs/V1_chap09.html, section 9.4, with the character classes of the
POSIX locale.
"""

from __future__ import annotations

import re
import string
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from functools import reduce
from operator import or_

from gibson_sim.errors import ConfigError
from gibson_sim.quoting import quoted

MAX_PATTERN_LENGTH = 1000
"""Maximum length of a pattern, characters."""
MAX_STATES = 256
"""Maximum number of states: characters of the pattern after intervals such as ``{2,5}`` are expanded."""
_MAX_REPEATS = 255
"""Maximum count in an interval."""
_MAX_DEPTH = 50
"""Maximum nesting depth of parentheses."""
_CACHE_SIZE = 20_000
"""Maximum number of transitions that a pattern caches."""
_START, _END = "\x02", "\x03"
"""Characters added before and after every text, which the anchors ``^`` and ``$`` match."""
_INTERVAL = re.compile(r"([0-9]{1,4})(,([0-9]{1,4})?)?}")
_SPECIAL = "^.[$()|*+?{\\"
_ASCII = [chr(i) for i in range(128)]
_CLASSES = {
    "alpha": frozenset(string.ascii_letters),
    "digit": frozenset(string.digits),
    "alnum": frozenset(string.ascii_letters + string.digits),
    "upper": frozenset(string.ascii_uppercase),
    "lower": frozenset(string.ascii_lowercase),
    "xdigit": frozenset(string.hexdigits),
    "space": frozenset(string.whitespace),
    "blank": frozenset(" \t"),
    "punct": frozenset(string.punctuation),
    "cntrl": frozenset(c for c in _ASCII if ord(c) < 32 or ord(c) == 127),
    "print": frozenset(c for c in _ASCII if 32 <= ord(c) < 127),
    "graph": frozenset(c for c in _ASCII if 33 <= ord(c) < 127),
}


class PatternError(ConfigError):
    """The pattern is not a POSIX extended regular expression, or is too large."""


@dataclass(frozen=True, slots=True)
class _Characters:
    """The characters that one position of the pattern matches."""

    chars: frozenset[str] = frozenset()
    ranges: tuple[tuple[str, str], ...] = ()
    negated: bool = False

    def matches(self, char: str) -> bool:
        contained = char in self.chars or any(low <= char <= high for low, high in self.ranges)
        return contained != self.negated and (not self.negated or char not in (_START, _END))


@dataclass(frozen=True, slots=True)
class _Fragment:
    """A fragment of the automaton; Glushkov's sets of positions are integers, one bit for each position."""

    nullable: bool
    """Whether it matches the empty string."""
    first: int
    """Positions at which a match may begin."""
    last: int
    """Positions at which a match may end."""


class PosixRegex:
    """A compiled pattern.

    Raises:
        PatternError: the pattern is invalid or too large.
    """

    def __init__(self, pattern: str) -> None:
        if len(pattern) > MAX_PATTERN_LENGTH:
            raise PatternError(f"the pattern has {len(pattern)} characters, must be at most {MAX_PATTERN_LENGTH}")
        if _START in pattern or _END in pattern:
            raise PatternError("the pattern holds a control character (2 or 3), which no name has")
        builder = _Builder()
        self._whole = builder.build(_Parser(pattern).parse())
        self._positions, self._follow = builder.positions, builder.follow
        self._transitions: dict[tuple[int, str], int] = {}

    def search(self, text: str) -> bool:
        """Returns whether the pattern matches a part of ``text``, as POSIX ``regexec`` does; ``^`` and ``$`` match its ends."""
        if self._whole.nullable:
            return True
        states = 0
        for char in (_START, *text, _END):
            states = self._step(states, char)
            if states & self._whole.last:
                return True
        return False

    def _step(self, states: int, char: str) -> int:
        """Returns the states after ``char``; a match may begin at every character."""
        key = (states, char)
        cached = self._transitions.get(key)
        if cached is not None:
            return cached
        reachable = self._whole.first | _union(self._follow[i] for i in _bits(states))
        next_states = _union(1 << i for i in _bits(reachable) if self._positions[i].matches(char))
        if len(self._transitions) >= _CACHE_SIZE:
            self._transitions.clear()
        self._transitions[key] = next_states
        return next_states


@dataclass(frozen=True, slots=True)
class _Repeat:
    """``part`` repeated ``low`` to ``high`` times; None = no limit."""

    part: _Node
    low: int
    high: int | None


@dataclass(frozen=True, slots=True)
class _Sequence:
    parts: tuple[_Node, ...]


@dataclass(frozen=True, slots=True)
class _Alternation:
    parts: tuple[_Node, ...]


_Node = _Characters | _Repeat | _Sequence | _Alternation


class _Builder:
    """Builds the automaton: its positions, and the set of positions that may follow each of them."""

    def __init__(self) -> None:
        self.positions: list[_Characters] = []
        self.follow: list[int] = []
        self._work = 0

    def build(self, node: _Node) -> _Fragment:
        self._work += 1
        if self._work > 8 * MAX_STATES or len(self.positions) > MAX_STATES:
            raise PatternError(f"the pattern is too large: more than {MAX_STATES} characters when {{m,n}} is expanded")
        if isinstance(node, _Characters):
            bit = 1 << len(self.positions)
            self.positions.append(node)
            self.follow.append(0)
            return _Fragment(False, bit, bit)
        if isinstance(node, _Alternation):
            parts = [self.build(part) for part in node.parts]
            return _Fragment(any(p.nullable for p in parts), _union(p.first for p in parts), _union(p.last for p in parts))
        if isinstance(node, _Sequence):
            return self._join([self.build(part) for part in node.parts])
        return self._repeat(node)

    def _repeat(self, node: _Repeat) -> _Fragment:
        copies = []
        for i in range(max(node.low, 1) if node.high is None else node.high):
            copy = self.build(node.part)
            copies.append(copy if i < node.low else _Fragment(True, copy.first, copy.last))
        if node.high is None:
            self._connect(copies[-1].last, copies[-1].first)
        return self._join(copies)

    def _join(self, parts: list[_Fragment]) -> _Fragment:
        whole = _Fragment(True, 0, 0)
        for part in parts:
            self._connect(whole.last, part.first)
            whole = _Fragment(
                whole.nullable and part.nullable,
                whole.first | (part.first if whole.nullable else 0),
                part.last | (whole.last if part.nullable else 0),
            )
        return whole

    def _connect(self, last: int, first: int) -> None:
        for i in _bits(last):
            self.follow[i] |= first


class _Parser:
    """A recursive-descent parser of patterns."""

    def __init__(self, pattern: str) -> None:
        self._pattern, self._at, self._depth = pattern, 0, 0

    def parse(self) -> _Node:
        node = self._alternation()
        if self._peek():
            raise self._error("a ) that closes nothing; write \\) for the character")
        return node

    def _error(self, reason: str) -> PatternError:
        shown = self._pattern if len(self._pattern) <= 80 else f"{self._pattern[:80]}..."
        return PatternError(f"{quoted(shown)} is not a POSIX extended regular expression: at character {self._at + 1}: {reason}")

    def _peek(self) -> str:
        return self._pattern[self._at : self._at + 1]

    def _alternation(self) -> _Node:
        self._depth += 1
        if self._depth > _MAX_DEPTH:
            raise self._error(f"more than {_MAX_DEPTH} nested parentheses")
        parts = [self._sequence()]
        while self._peek() == "|":
            self._at += 1
            parts.append(self._sequence())
        self._depth -= 1
        return _Alternation(tuple(parts))

    def _sequence(self) -> _Node:
        parts: list[_Node] = []
        while self._peek() not in ("", "|", ")"):
            node = self._atom()
            while self._peek() in ("*", "+", "?", "{"):
                node = _Repeat(node, *self._counts())
            parts.append(node)
        return _Sequence(tuple(parts))

    def _counts(self) -> tuple[int, int | None]:
        """Parses one of ``* + ? {m} {m,} {m,n}``; returns the minimum and maximum count, None = no limit."""
        operator = self._peek()
        self._at += 1
        if operator != "{":
            return {"*": (0, None), "+": (1, None), "?": (0, 1)}[operator]
        match = _INTERVAL.match(self._pattern, self._at)
        if not match:
            raise self._error("a { must begin {m}, {m,} or {m,n}; write \\{ for the character")
        low = int(match[1])
        high = int(match[3]) if match[3] else None if match[2] else low
        if max(low, high or 0) > _MAX_REPEATS or (high is not None and high < low):
            raise self._error(f"the numbers in {{m,n}} must be 0 to {_MAX_REPEATS}, the second not below the first")
        self._at = match.end()
        return low, high

    def _atom(self) -> _Node:
        char = self._peek()
        if char in ("*", "+", "?", "{"):
            raise self._error(f"nothing precedes {char}; write \\{char} for the character")
        self._at += 1
        if char == "(":
            node = self._alternation()
            if self._peek() != ")":
                raise self._error("a ( is not closed")
            self._at += 1
            return node
        if char == "[":
            return self._bracket()
        if char == "\\":
            return self._escaped()
        if char == ".":
            return _Characters(negated=True)
        return _Characters(frozenset({"^": _START, "$": _END}.get(char, char)))

    def _escaped(self) -> _Characters:
        char = self._peek()
        if not char:
            raise self._error("a \\ at the end of the pattern")
        if char not in _SPECIAL and char.isalnum():
            raise self._error(f"\\{char} has no meaning; write [[:digit:]], [[:alpha:]], [[:space:]] and so on for classes")
        self._at += 1
        return _Characters(frozenset(char))

    def _bracket(self) -> _Characters:
        """Parses a bracket expression ``[...]`` after its opening bracket."""
        negated = self._peek() == "^"
        self._at += negated
        chars: set[str] = set()
        ranges: list[tuple[str, str]] = []
        start = self._at
        while self._peek() != "]" or self._at == start:
            if not self._peek():
                raise self._error("a [ is not closed")
            if self._pattern.startswith("[:", self._at):
                chars |= self._class()
                continue
            low = self._bracket_character()
            if self._peek() == "-" and self._pattern[self._at + 1 : self._at + 2] not in ("]", ""):
                self._at += 1
                high = self._bracket_character()
                if high < low:
                    raise self._error(f"the range {low}-{high} is reversed")
                ranges.append((low, high))
            else:
                chars.add(low)
        self._at += 1
        return _Characters(frozenset(chars), tuple(ranges), negated)

    def _bracket_character(self) -> str:
        for opening in ("[.", "[="):
            if self._pattern.startswith(opening, self._at):
                char = self._pattern[self._at + 2 : self._at + 3]
                if self._pattern[self._at + 3 : self._at + 5] != f"{opening[1]}]":
                    raise self._error(f"{opening} must hold one character and end with {opening[1]}]")
                self._at += 5
                return char
        char = self._peek()
        if not char:
            raise self._error("a [ is not closed")
        self._at += 1
        return char

    def _class(self) -> frozenset[str]:
        end = self._pattern.find(":]", self._at + 2)
        name = self._pattern[self._at + 2 : end] if end >= 0 else ""
        if name not in _CLASSES:
            raise self._error(f"class {quoted(name)} does not exist; known: {', '.join(sorted(_CLASSES))}")
        self._at = end + 2
        return _CLASSES[name]


def _bits(states: int) -> Iterator[int]:
    """Yields the indices of the bits that are set."""
    while states:
        lowest = states & -states
        yield lowest.bit_length() - 1
        states ^= lowest


def _union(sets: Iterable[int]) -> int:
    """Returns the union of sets of states."""
    return reduce(or_, sets, 0)
