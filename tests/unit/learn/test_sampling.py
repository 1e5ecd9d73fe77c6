"""Batches from shards: what belongs together stays together, also when it is mirrored."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from gibson_sim.errors import ConfigError
from gibson_sim_learn.path_following.data import DIRECTIONS, PAIR, Shard, load_shard, save_shard
from gibson_sim_learn.path_following.sampling import Sampler, augment_lens


def shard() -> Shard:
    """Returns four images, bright on their right half; the first two are recorded, the third was seen later, the last has no pairs."""
    images = np.zeros((4, 64, 96, 3), np.uint8)
    images[:, :, 48:] = (np.arange(4) * 40 + 80)[:, None, None, None]
    free = np.tile(np.linspace(1.0, 2.0, DIRECTIONS, dtype=np.float32), (4, 1))
    pairs = np.array([(2, 0, 1.0, 0.5, 0.25, True), (2, 1, 2.0, -0.5, -0.25, False)], dtype=PAIR)
    return Shard(images, free, pairs)


def test_pairs_belong_to_their_later_image() -> None:
    batch = Sampler([shard()]).batch(np.random.default_rng(0), 40, 2, augment=False)
    later = batch.later[:, 0, 95, 0]
    assert batch.has_pairs.tolist() == (later == 160).tolist()
    assert batch.has_pairs.any()
    of_pairs = batch.recorded[batch.has_pairs][:, :, 0, 95, 0]
    np.testing.assert_array_equal(batch.pose[batch.has_pairs][..., 0], np.where(of_pairs == 80, 1.0, 2.0))
    np.testing.assert_array_equal(batch.match[batch.has_pairs], of_pairs == 80)


def test_mirrored_images_have_mirrored_truth() -> None:
    batch = Sampler([shard()]).batch(np.random.default_rng(1), 60, 1)
    mirrored = batch.later[:, :, :40].mean(axis=(1, 2, 3)) > batch.later[:, :, 56:].mean(axis=(1, 2, 3))
    assert 0 < mirrored.sum() < 60
    np.testing.assert_array_equal(batch.free[:, 0] > batch.free[:, -1], mirrored)
    match = batch.match[:, 0]
    np.testing.assert_allclose(batch.pose[match, 0, 1], np.where(mirrored[match], -0.5, 0.5))
    np.testing.assert_allclose(batch.pose[match, 0, 2], np.where(mirrored[match], -0.25, 0.25))


def test_an_image_and_its_recorded_ones_change_colours_alike() -> None:
    red = shard()
    red.images[..., 1:] = 0
    batch = Sampler([red]).batch(np.random.default_rng(2), 60, 1)
    later = batch.later.astype(int).sum(axis=(1, 2)).argmax(axis=1)
    recorded = batch.recorded[:, 0].astype(int).sum(axis=(1, 2)).argmax(axis=1)
    assert set(later.tolist()) == {0, 1, 2}
    assert (later == 0).mean() > 0.5, "most keep their colours: half of them, and a third of the others"
    np.testing.assert_array_equal(later[batch.has_pairs], recorded[batch.has_pairs])


def test_grey_stays_grey_in_other_colours() -> None:
    batch = Sampler([shard()]).batch(np.random.default_rng(4), 40, 1)
    bright = np.maximum(batch.later[:, :, :40].mean(axis=(1, 2)), batch.later[:, :, 56:].mean(axis=(1, 2)))
    assert np.ptp(bright, axis=1).max() < 1.5, "but for the noise"


def test_equal_generators_give_equal_batches() -> None:
    first, second = (Sampler([shard()]).batch(np.random.default_rng(3), 8, 2) for _ in range(2))
    np.testing.assert_array_equal(first.later, second.later)
    np.testing.assert_array_equal(first.recorded, second.recorded)


def test_images_can_be_drawn_for_their_free_distances_alone() -> None:
    batch = Sampler([shard()]).batch(np.random.default_rng(5), 8, 0)
    assert batch.later.shape == (8, 64, 96, 3) and batch.recorded.shape == (8, 0, 64, 96, 3)
    assert (batch.free.min(axis=1) == 1.0).all()


def test_another_lens_changes_each_image_by_itself_and_leaves_it_where_it_is() -> None:
    images = shard().images.repeat(10, axis=0)
    seen, _ = augment_lens(images, np.random.default_rng(0))
    np.testing.assert_array_equal(seen, augment_lens(images, np.random.default_rng(0))[0])
    assert len({image.tobytes() for image in seen}) == len(seen)
    bright, dark = seen[:, 16:48, 60:84].mean(axis=(1, 2, 3)), seen[:, 16:48, 12:36].mean(axis=(1, 2, 3))
    expected = images[:, 0, 95, 0]
    assert (dark < 5.0).all(), "the left half is black but for grain"
    assert (bright > 0.55 * expected).all() and (bright <= np.minimum(1.45 * expected, 255.0)).all()


def _with_earlier() -> Shard:
    """Returns the shard with earlier images that are the same, from 0.3 m behind and a little to the left."""
    one = shard()
    pose = np.tile(np.array([-0.3, 0.02, 0.1], np.float32), (4, 1))
    return replace(one, earlier=one.images.copy(), earlier_pose=pose)


def test_an_earlier_image_changes_as_its_later_one_but_for_noise() -> None:
    batch = Sampler([_with_earlier()]).batch(np.random.default_rng(1), 60, 0)
    seen, before = augment_lens(batch.later, np.random.default_rng(0), batch.earlier)
    for later, earlier in ((batch.later, batch.earlier), (seen, before)):
        difference = later.astype(float) - earlier
        assert np.abs(difference).mean() < 8.0 and np.abs(difference.mean(axis=(1, 2, 3))).max() < 2.0
        assert difference.any(axis=(1, 2, 3)).all(), "noise is drawn for each"
    mirrored = batch.later[:, :, :40].mean(axis=(1, 2, 3)) > batch.later[:, :, 56:].mean(axis=(1, 2, 3))
    np.testing.assert_allclose(batch.earlier_pose, np.where(mirrored[:, None], [-0.3, -0.02, -0.1], [-0.3, 0.02, 0.1]), rtol=1e-6)


def test_an_earlier_image_that_is_unknown_stays_black() -> None:
    batch = Sampler([shard()]).batch(np.random.default_rng(1), 20, 0)
    seen, before = augment_lens(batch.later, np.random.default_rng(0), batch.earlier)
    assert not batch.earlier.any() and not before.any() and seen.any()


def test_a_black_image_gets_grain_alone() -> None:
    black = np.zeros((6, 64, 96, 3), np.uint8)
    seen, _ = augment_lens(black, np.random.default_rng(0))
    np.testing.assert_array_equal(seen, augment_lens(black, np.random.default_rng(0))[0])
    assert seen.any() and seen.max() < 25


def test_shards_with_earlier_images_are_stored(tmp_path: Path) -> None:
    for name, one in (("with", _with_earlier()), ("without", shard())):
        save_shard(tmp_path / name, one)
        found = load_shard(tmp_path / name)
        assert (found.earlier is None) == (one.earlier is None) and (found.earlier_pose is None) == (one.earlier_pose is None)
        if one.earlier is not None and one.earlier_pose is not None:
            np.testing.assert_array_equal(found.earlier, one.earlier)
            np.testing.assert_array_equal(found.earlier_pose, one.earlier_pose)


def test_no_data_is_one_line() -> None:
    with pytest.raises(ConfigError, match="no data to train on"):
        Sampler([])
