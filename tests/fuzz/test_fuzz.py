"""A few mutants of every kind; ``make fuzz`` tries them for hours."""

from __future__ import annotations

import random
from collections.abc import Iterator
from pathlib import Path

import pytest

from fuzz.grammar import SECRET, Mutator
from fuzz.runner import Fuzzer
from fuzz.seeds import yaml_text
from fuzz.targets import TARGETS, write_mutant
from fuzz.trial import Outcome, Trial
from fuzz.worker import mutator_of, slow_fault

SEED = 1
MUTANTS = 4
"""Of each target; with the unchanged input they take some ten seconds."""


@pytest.fixture(scope="module")
def fuzzer(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Fuzzer]:
    """A fuzzer that has tried them."""
    with Fuzzer(SEED, tmp_path_factory.mktemp("findings")) as made:
        made.try_numbers(list(TARGETS), iter(range(-1, MUTANTS)))
        print("\n".join(made.tally.lines()))
        yield made


def test_no_mutant_produces_a_finding(fuzzer: Fuzzer) -> None:
    assert not fuzzer.tally.findings, "\n".join(fuzzer.tally.lines())


def test_most_mutants_reach_physics_or_the_renderer(fuzzer: Fuzzer) -> None:
    assert fuzzer.tally.deep_share >= 0.5, "\n".join(fuzzer.tally.lines())


def test_mutants_follow_from_seed_and_number(tmp_path: Path) -> None:
    made = []
    for name in ("a", "b"):
        for target in ("scene", "robot", "mesh"):
            (tmp_path / name / target).mkdir(parents=True)
            TARGETS[target].make(mutator_of(target, SEED, 3), tmp_path / name / target)
        made.append({p.relative_to(tmp_path / name): p.read_bytes() for p in (tmp_path / name).rglob("*") if p.is_file()})
    assert made[0] == made[1]


def test_unchanged_inputs_are_accepted_and_an_unexpected_exception_is_a_fault(fuzzer: Fuzzer, tmp_path: Path) -> None:
    write_mutant(TARGETS["mesh"], mutator_of("mesh", SEED, -1), tmp_path / "whole")
    assert fuzzer.try_folder("mesh", tmp_path / "whole")["reached"] in ("renderer", "physics")  # without EGL nothing is drawn
    (tmp_path / "empty" / "files").mkdir(parents=True)
    assert "foreign exception" in fuzzer.try_folder("mesh", tmp_path / "empty")["faults"][0]


@pytest.mark.parametrize(
    ("slowest_s", "unchanged_s", "faulty"),
    [(1.75, 0.01, False), (9.0, 0.01, False), (30.0, 2.0, False), (30.0, 1.0, True)],
    ids=["a busy machine", "not yet suspicious", "slow as the unchanged input", "much slower than the unchanged input"],
)
def test_call_is_slow_only_relative_to_the_unchanged_input(slowest_s: float, unchanged_s: float, faulty: bool) -> None:
    outcome = Outcome(slowest="load_run", slowest_s=slowest_s)
    assert bool(slow_fault(outcome, lambda: unchanged_s)) is faulty


def test_reply_that_reveals_file_content_is_a_fault() -> None:
    trial = Trial()
    trial.reply("spawn", f"link {SECRET!r} is unknown")
    assert "content of a file" in trial.outcome.faults[0]


def test_changes_stay_within_their_type_unless_they_are_harsh() -> None:
    mutator = Mutator(random.Random(1), harsh=False)
    document = {"a": 1.5, "b": ["x", 2], "c": {"d": True}}
    for _ in range(300):
        changed = mutator.tree(document)
        assert isinstance(changed.get("a", 0.0), float)
        assert SECRET not in str(changed)
    harsh = Mutator(random.Random(1), harsh=True)
    assert any(SECRET in yaml_text(harsh.tree(document)) for _ in range(300))
