"""Goggles: scores by hand, shards that are complete or absent, impossible settings."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from gibson_sim.errors import ConfigError
from gibson_sim_learn.goggles.pairs import Pairs, load_pairs, save_pairs
from gibson_sim_learn.goggles.scoring import Score, mean_of, score
from gibson_sim_learn.goggles.settings import GogglesSettings


def flat(level: int) -> np.ndarray:
    return np.full((8, 12, 3), level, np.uint8)


def test_a_score_is_the_mean_over_all_shots_of_the_views_that_are_looked_at() -> None:
    part = Pairs(np.stack([flat(100), flat(100)]), np.stack([[flat(100), flat(108)], [flat(0), flat(0)]]))
    found = score([part], lambda image: image, every=2)
    assert (found.images, found.psnr) == (2, pytest.approx((60.0 + 30.07) / 2, abs=0.01))
    assert mean_of([Score(10.0, 0.5, 3), Score(30.0, 0.9, 1)]) == Score(15.0, pytest.approx(0.6), 4)


def test_shards_are_read_as_saved_and_other_files_are_refused(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match="holds no pairs; run gibson-sim learn goggles"):
        load_pairs(tmp_path)
    save_pairs(tmp_path / "room-000", Pairs(flat(1)[None], flat(2)[None, None]))
    (found,) = load_pairs(tmp_path)
    assert (found.clean == 1).all() and (found.seen == 2).all()
    (tmp_path / "room-000" / "seen.npy").write_bytes(b"cut")
    with pytest.raises(
        ConfigError, match=r"room-000: not a shard of data: .*; delete it, and run `gibson-sim learn goggles` again"
    ):
        load_pairs(tmp_path)


def test_impossible_settings_are_refused() -> None:
    with pytest.raises(ConfigError, match="batch is 0, must be 1 to 4096"):
        GogglesSettings(batch=0)
