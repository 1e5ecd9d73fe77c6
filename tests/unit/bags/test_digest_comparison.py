"""Comparison of two runs by their digests: equal, or the first difference."""

from __future__ import annotations

import json
from array import array

from gibson_sim.bags.digest_comparison import (
    Difference,
    DigestComparison,
    Tick,
    TickDigests,
    comparison_line,
    verification_from_json,
)


def _physics(number: int, scan: int | None = None) -> TickDigests:
    topics = ("/odom", "/scene_state") if scan is None else ("/odom", "/scan", "/scene_state")
    return TickDigests(0, topics, array("Q", [number, 7] if scan is None else [number, scan, 7]))


def _image(topic: str, number: int) -> TickDigests:
    return TickDigests(0, (topic,), array("Q", [number]))


def _run(*steps: int) -> dict[Tick, list[TickDigests]]:
    return {(0, step): [_physics(step)] for step in steps}


def test_equal_runs_are_equal() -> None:
    comparison = DigestComparison(_run(4, 8))
    for step in (4, 8, 12):
        comparison.add((0, step), _physics(step))
    result = comparison.result()
    assert result.is_equal and (result.ticks, result.unknown_ticks) == (2, 0), "what comes behind the end does not count"
    assert result.compared == {"/odom": 2, "/scene_state": 2}


def test_first_difference_names_tick_and_topics_in_any_order_of_arrival() -> None:
    comparison = DigestComparison(_run(4, 8, 12))
    comparison.add((0, 12), _physics(99))
    comparison.add((0, 8), TickDigests(33, ("/odom", "/scene_state"), array("Q", [99, 99])))
    comparison.add((0, 4), _physics(4))
    result = comparison.result()
    assert not result.is_equal
    assert result.first == Difference(0, 8, 33, ("/odom", "/scene_state"))
    assert result.differing == {"/odom": 2, "/scene_state": 1}
    assert any("/odom: 2 of 3 ticks differ" in line for line in result.lines())


def test_a_topic_of_only_one_run_is_a_difference() -> None:
    comparison = DigestComparison({(0, 4): [_physics(1, scan=2)]})
    comparison.add((0, 4), _physics(1))
    assert comparison.result().differing == {"/scan": 1}


def test_a_run_that_ends_early_is_not_equal() -> None:
    comparison = DigestComparison(_run(4, 8))
    comparison.add((0, 4), _physics(4))
    result = comparison.result()
    assert not result.is_equal and result.missing_ticks == 1


def test_nothing_compared_is_not_equal() -> None:
    assert not DigestComparison({}).result().is_equal


def test_ticks_after_a_reset_are_different_ticks() -> None:
    comparison = DigestComparison({(0, 4): [_physics(1)], (1, 4): [_physics(2)]})
    comparison.add((0, 4), _physics(1))
    comparison.add((1, 4), _physics(2))
    assert comparison.result().is_equal


def test_images_are_compared_if_both_runs_have_them() -> None:
    expected = {(0, step): [_physics(step), _image("/camera/image_raw", step)] for step in (4, 8, 12)}
    comparison = DigestComparison(expected)
    for step in (4, 8, 12):
        comparison.add((0, step), _physics(step))
    comparison.add((0, 4), _image("/camera/image_raw", 4))
    comparison.add((0, 8), _image("/camera/depth/image_raw", 8))
    result = comparison.result()
    assert result.is_equal and (result.images, result.missing_images, result.unknown_images) == (1, 2, 1)
    comparison.add((0, 12), _image("/camera/image_raw", 99))
    assert comparison.result().differing == {"/camera/image_raw": 1}


def test_images_that_are_never_drawn_prove_nothing() -> None:
    comparison = DigestComparison({(0, 4): [_physics(4), _image("/camera/image_raw", 1)]})
    comparison.add((0, 4), _physics(4))
    assert not comparison.result().is_equal


def test_without_images_physics_alone_counts() -> None:
    comparison = DigestComparison({(0, 4): [_physics(4), _image("/camera/image_raw", 1)]}, images=False)
    comparison.add((0, 4), _physics(4))
    assert comparison.result().is_equal
    assert comparison.image_topics == ()


def test_flow_is_compared_if_the_previous_image_is_of_the_same_tick() -> None:
    flow = "/camera/flow/image_raw"
    expected = {(0, step): [_physics(step), _image(flow, step)] for step in (4, 12, 16)}
    comparison = DigestComparison(expected)
    for step in (4, 8, 12, 16):
        comparison.add((0, step), _image(flow, step if step != 12 else 99))
    result = comparison.result()
    assert result.compared == {flow: 2}, "12 follows 8 here and 4 there"
    assert not result.differing


def test_a_tick_is_complete_when_all_expected_digests_have_arrived() -> None:
    comparison = DigestComparison({(0, 4): [_physics(4), _image("/camera/image_raw", 1)]})
    comparison.add((0, 4), _physics(4))
    assert not comparison.is_complete((0, 4))
    comparison.add((0, 4), _image("/camera/image_raw", 1))
    assert comparison.is_complete((0, 4)) and comparison.is_complete((0, 8))


def test_a_result_survives_json() -> None:
    comparison = DigestComparison(_run(4))
    comparison.add((0, 4), _physics(5))
    result = comparison.result()
    assert verification_from_json(json.loads(json.dumps(result.to_json()))) == result


def test_two_bags_are_compared_in_one_line() -> None:
    assert comparison_line(_run(4, 8), {}) == comparison_line({}, _run(4)) == ""
    assert comparison_line(_run(4, 8), _run(4, 8)) == "digests: 2 ticks, equal to the bit"
    images = {(0, 8): [_physics(8), _image("/camera/image_raw", 3)]}
    assert comparison_line({**_run(4), **images}, {**_run(4), **images}) == "digests: 2 ticks (1 with images), equal to the bit"
    other = {**_run(4), (0, 8): [TickDigests(33_333_333, ("/odom", "/scene_state"), array("Q", [99, 7]))], **_run(12)}
    first = "first difference: epoch 0, step 8, 0.0333 s, on /odom"
    assert comparison_line(_run(4, 8, 12), other) == f"digests: 3 ticks, {first}"


def test_ticks_of_one_bag_alone_are_counted() -> None:
    assert comparison_line(_run(4, 8, 12), _run(4)) == "digests: 1 tick, equal to the bit; 2 only in the first bag"
    assert comparison_line(_run(8), _run(4, 8, 12)) == "digests: 1 tick, equal to the bit; 2 only in the second bag"
    assert comparison_line(_run(4), _run(8)) == "digests: no tick is in both bags"
