"""Two trials compared, run by run."""

from __future__ import annotations

from dataclasses import replace

import pytest

from gibson_sim.trials.comparison import compare, find_shift, least_significant_count, percent, two_sided_binomial
from gibson_sim.trials.records import RunResult, Verdict
from support.trial_results import failed, passed


@pytest.mark.parametrize(
    ("fewer", "more", "p"),
    [
        (0, 10, 2 / 2**10),
        (10, 0, 2 / 2**10),
        (1, 12, 2 * (1 + 13) / 2**13),
        (2, 3, 1.0),  # 2 (1 + 5 + 10) / 32
        (1, 4, 2 * (1 + 5) / 2**5),
        (5, 5, 1.0),  # the two tails overlap
        (0, 0, 1.0),
    ],
)
def test_exact_test_has_the_probability_counted_by_hand(fewer: int, more: int, p: float) -> None:
    assert two_sided_binomial(fewer, more) == pytest.approx(p, rel=1e-12)


def test_six_runs_that_differ_in_one_direction_are_the_fewest_for_significance() -> None:
    assert least_significant_count() == 6  # 2 / 2^6 = 3.1 %, 2 / 2^5 = 6.3 %


def test_ten_runs_that_got_worse_are_a_decline() -> None:
    found = compare([passed(n) for n in range(40)], [failed(n) if n < 10 else passed(n) for n in range(40)])
    assert found.p == pytest.approx(2 / 2**10)
    assert found.is_decline
    assert [pair.after.run.number for pair in found.worse] == list(range(10))
    assert found.lines()[0] == (
        "10 runs got worse, 0 got better; by chance alone such a difference or a greater one would occur in 0.2 % of cases: "
        "the stacks differ, and the first is better"
    )


def test_ten_runs_that_got_better_are_no_decline() -> None:
    found = compare([failed(n) for n in range(10)], [passed(n) for n in range(10)])
    assert not found.is_decline
    assert found.lines()[0].endswith("the stacks differ, and the second is better")


def test_a_few_runs_that_differ_are_no_evidence() -> None:
    found = compare([passed(n) for n in range(20)], [failed(n) if n < 3 else passed(n) for n in range(20)])
    assert not found.is_decline
    assert "in 25 % of cases: this is no evidence that the stacks differ (fewer than 6 differing runs" in found.lines()[0]


def test_a_trial_does_not_differ_from_itself() -> None:
    results = [passed(n, digest=f"d{n}") if n % 3 else failed(n) for n in range(30)]
    lines = compare(results, results).lines()
    assert lines[0] == "no run got better or worse: the verdicts show no difference between the stacks"
    assert lines[1] == "of 30 pairs 20 passed in both, 10 failed in both"
    assert "20 of 30 pairs are equal bit for bit" in lines


def test_runs_are_paired_by_number_scene_robot_start_goal_and_seed() -> None:
    others = [
        passed(0, scene="orchard_house"), passed(1, robot="other_bot"), passed(2, start=(1.0, 1.0, 0.0)), passed(3, goal=(2.0, 2.0, 0.0)),
        passed(4, seed=7), passed(9),
    ]  # fmt: skip
    found = compare([passed(n) for n in range(7)], [*others, passed(6)])
    assert [pair.after.run.number for pair in found.pairs] == [6]
    assert (found.unpaired_before, found.unpaired_after) == (6, 6)
    assert found.lines()[-1] == "left out, without a partner: 6 runs only in the first trial, 6 runs only in the second trial"


def test_trials_of_other_runs_are_not_compared() -> None:
    assert compare([passed(0)], [passed(1)]).lines()[0].startswith("the trials have no run in common")


def judged(number: int, **verdicts: bool) -> RunResult:
    return replace(passed(number), verdicts=tuple(Verdict(name, good, "") for name, good in verdicts.items()))


def test_a_stack_with_more_goals_and_more_collisions_is_compared_by_verdict() -> None:
    before = [judged(n, reached=n >= 8, collisions=True) for n in range(16)]
    after = [judged(n, reached=True, collisions=n < 8) for n in range(16)]
    found = compare(before, after)
    assert (len(found.worse), len(found.better), found.p) == (8, 8, 1.0)
    reached, collisions = found.verdicts
    assert (reached.name, reached.worse, reached.better) == ("reached", 0, 8)
    assert (collisions.name, collisions.worse, collisions.better) == ("collisions", 8, 0)
    assert collisions.p == pytest.approx(2 * 2 / 2**8)  # for two verdicts
    assert found.is_decline
    assert found.lines()[0].endswith("in 100 % of cases; but the stacks differ by more than chance in: reached, collisions")
    assert "collisions: 8 runs got worse, 0 got better: that is more than chance (1.6 %)" in found.lines()


def test_verdicts_that_cannot_reach_significance_are_no_tests() -> None:
    before = [judged(n, collisions=True, time=n < 15) for n in range(16)]
    after = [judged(n, collisions=n >= 6, time=True) for n in range(16)]
    collisions, time = compare(before, after).verdicts
    assert collisions.p == pytest.approx(2 / 2**6)
    assert (time.p, time.is_chance) == (1.0, True)


def test_times_are_compared_where_both_passed() -> None:
    before = [passed(n, time=10.0) for n in range(10)] + [passed(10), failed(11)]
    after = [passed(n, time=11.0 if n < 9 else 9.0) for n in range(10)] + [failed(10), passed(11)]
    time, length = compare(before, after).shifts
    assert (time.pairs, time.larger, time.smaller) == (10, 9, 1)
    assert time.median == pytest.approx(1.0)
    assert time.share == pytest.approx(0.1)
    assert time.p == pytest.approx(2 * (1 + 10) / 2**10)
    assert (length.larger, length.smaller, length.p) == (0, 0, 1.0)
    line = compare(before, after).lines()[3]
    assert (
        line
        == "of 10 runs that passed in both, 9 got slower and 1 faster (median +1.00 s, +10.0 %): that is more than chance (2.1 %)"
    )


def test_a_tick_more_or_less_is_no_difference() -> None:
    time, _ = compare([passed(n, time=10.0) for n in range(9)], [passed(n, time=10.033) for n in range(9)]).shifts
    assert (time.larger, time.smaller, time.is_chance) == (0, 0, True)


def test_a_measure_without_pairs_has_no_shift() -> None:
    assert find_shift("time", "s", []) is None


@pytest.mark.parametrize(("p", "text"), [(0.0034, "0.3 %"), (0.00001, "less than 0.1 %"), (0.39, "39 %"), (1.0, "100 %")])
def test_probabilities_are_formatted_in_percent(p: float, text: str) -> None:
    assert percent(p) == text
