"""POSIX regular expressions that filter entities by name."""

from __future__ import annotations

import itertools
import random
import re

import pytest

from gibson_sim.standard.posix_regex import MAX_STATES, PatternError, PosixRegex


@pytest.mark.parametrize(
    ("pattern", "text", "found"),
    [
        ("", "chair", True),
        ("air", "chair", True),
        ("^air", "chair", False),
        ("^chair$", "chair", True),
        ("^chair$", "chair_2", False),
        ("^(chair|table)_[[:digit:]]+$", "table_12", True),
        ("^(chair|table)_[[:digit:]]+$", "table_x", False),
        ("[[:upper:]]", "robot", False),
        ("^[^[:digit:]]*$", "robot", True),
        ("^[^[:digit:]]*$", "robot2", False),
        ("^a{2,3}$", "a", False),
        ("^a{2,3}$", "aa", True),
        ("^a{2,3}$", "aaaa", False),
        ("^(ab){2}$", "abab", True),
        ("^a{2,}b$", "aaaab", True),
        ("^a{0}b$", "b", True),
        ("^a{0}b$", "ab", False),
        ("^x?y*z+$", "zz", True),
        ("^x?y*z+$", "xy", False),
        ("a.c", "abc", True),
        ("a.c", "ac", False),
        ("^a\\.b$", "axb", False),
        ("^a\\.b$", "a.b", True),
        ("[]x]", "]", True),
        ("[^]x]", "]", False),
        ("[a-c-]", "-", True),
        ("[[.-.]]", "-", True),
        ("[[=e=]]", "e", True),
        ("[a\\]", "\\", True),
        ("(^|_)left(_|$)", "wheel_left", True),
        ("(^|_)left(_|$)", "cleft", False),
        ("()", "anything", True),
        ("a|", "b", True),
    ],
)
def test_pattern_finds_what_posix_says(pattern: str, text: str, found: bool) -> None:
    assert PosixRegex(pattern).search(text) is found


@pytest.mark.parametrize(
    ("pattern", "hint"),
    [
        ("*a", "nothing precedes *"),
        ("a|+", "nothing precedes +"),
        ("(", "( is not closed"),
        (")", "closes nothing"),
        ("[a", "[ is not closed"),
        ("[[:foo:]]", "class 'foo' does not exist; known: alnum, alpha"),
        ("a{", "{m}"),
        ("a{3,2}", "0 to 255"),
        ("a{256}", "0 to 255"),
        ("\\d+", "[[:digit:]]"),
        ("a\\", "at the end"),
        ("[z-a]", "is reversed"),
        ("(" * 60 + ")" * 60, "more than 50"),
        ("a" * 1001, "must be at most 1000"),
        ("((a{99}){99}){99}", f"more than {MAX_STATES}"),
        ("(((){255}){255}){255}", f"more than {MAX_STATES}"),
    ],
)
def test_invalid_pattern_is_refused_with_a_hint(pattern: str, hint: str) -> None:
    with pytest.raises(PatternError) as error:
        PosixRegex(pattern)
    assert hint in str(error.value)
    assert "\n" not in str(error.value)


def test_pattern_that_makes_backtracking_explode_is_answered() -> None:
    # re.search of the first would take longer than the universe has lasted.
    assert not PosixRegex("^(a+)+$").search("a" * 254 + "b")
    assert not PosixRegex("^(a|a)*(a|aa)*b$").search("a" * 254)


def test_random_patterns_agree_with_another_engine() -> None:
    rng = random.Random(3)
    pieces = [
        "a",
        "b",
        ".",
        "(a|b)",
        "(ab|a)",
        "a*",
        "b+",
        "a?",
        "(ab)*",
        "[ab]",
        "[^a]",
        "a{2}",
        "(a|b){1,2}",
        "(a*b)+",
        "(a?b?){0,2}",
    ]
    texts = ["".join(t) for n in range(5) for t in itertools.product("ab", repeat=n)]
    for _ in range(300):
        pattern = "".join(rng.choices(pieces, k=rng.randint(1, 4)))
        pattern = rng.choice(["", "^"]) + pattern + rng.choice(["", "$", f"|{rng.choice(pieces)}$"])
        ours = PosixRegex(pattern)
        for text in texts:
            assert ours.search(text) is bool(re.search(pattern, text)), f"{pattern!r} in {text!r}"
