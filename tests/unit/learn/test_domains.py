"""Differences between drives and recordings."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from gibson_sim.errors import ConfigError
from gibson_sim_learn.path_following.domains import (
    DOMAINS,
    FOR_CHOOSING,
    MEASURED,
    SEEN_IN_TRAINING,
    Conditions,
    Domain,
    domain_of,
    draw,
)

NOTHING = Domain("nothing", start=0.0, start_deg=0.0, slip=(1.0, 1.0), yaw_bias=0.0)


def test_a_domain_without_ranges_changes_nothing() -> None:
    drawn = draw(NOTHING, np.random.default_rng(0))
    light, plain = drawn.light, Conditions().light
    assert drawn.light.is_unchanged
    assert replace(drawn, light=replace(plain, sun_azimuth=light.sun_azimuth)) == replace(
        Conditions(), light=replace(plain, sun_azimuth=light.sun_azimuth)
    )


@pytest.mark.parametrize("name", sorted(DOMAINS))
def test_equal_seeds_draw_equal_conditions(name: str) -> None:
    one, same, other = (draw(DOMAINS[name], np.random.default_rng(seed)) for seed in (7, 7, 8))
    assert one == same != other


def test_a_wider_range_of_one_thing_leaves_the_others_as_they_were() -> None:
    narrow, wide = (
        draw(replace(NOTHING, moved=counts, slip=(0.5, 1.0)), np.random.default_rng(1)) for counts in ((0, 0), (6, 6))
    )
    assert wide.moved == 6
    assert replace(wide, moved=0) == narrow


def test_reality_contains_the_range_of_every_other_day() -> None:
    reality = DOMAINS["reality"]
    for name in ("trained", "light", "lens_exposure", "slip_latency", "moved", "obstacles"):
        domain = DOMAINS[name]
        for key in ("hfov_deg", "height", "pitch_deg", "start", "start_deg", "yaw_bias"):
            assert getattr(domain, key) <= getattr(reality, key)
        for key in (
            "ambient",
            "light_k",
            "sun",
            "exposure_ev",
            "camera_k",
            "noise",
            "slip",
            "latency_ticks",
            "moved",
            "obstacles",
        ):
            low, high = getattr(domain, key)
            assert getattr(reality, key)[0] <= low <= high <= getattr(reality, key)[1]
    assert "reality" not in SEEN_IN_TRAINING


def test_development_is_half_way_between_training_and_reality_and_no_result() -> None:
    trained, found, reality = (DOMAINS[name] for name in ("trained", "development", "reality"))
    for key in ("ambient", "light_k", "sun", "unevenness_ev", "exposure_ev", "camera_k", "noise", "vignette", "blur", "slip"):
        ends = zip(getattr(trained, key), getattr(reality, key), strict=True)
        assert getattr(found, key) == pytest.approx(tuple((a + b) / 2.0 for a, b in ends)), key
    for key in ("auto_exposure", "hfov_deg", "height", "pitch_deg", "start", "start_deg", "yaw_bias"):
        assert getattr(found, key) == pytest.approx((getattr(trained, key) + getattr(reality, key)) / 2.0), key
    assert (found.latency_ticks, found.moved, found.obstacles) == ((0, 2), (0, 4), (0, 1))  # 1.5 and 4.5 are no counts
    assert "development" not in MEASURED and frozenset({"trained", "development"}) == FOR_CHOOSING


def test_counts_reach_both_ends_of_their_range() -> None:
    drawn = {draw(DOMAINS["obstacles"], np.random.default_rng(seed)).obstacles for seed in range(40)}
    assert drawn == {0, 1, 2}


def test_an_unknown_domain_names_the_nearest() -> None:
    with pytest.raises(ConfigError, match=r"no domain 'realty'.*reality"):
        domain_of("realty")
