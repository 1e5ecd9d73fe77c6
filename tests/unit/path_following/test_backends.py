"""Selection of a policy by name."""

from __future__ import annotations

import numpy as np
import pytest

from gibson_path_following.errors import ModelError, SettingError
from gibson_path_following.policies import backends
from gibson_path_following.policies.backends import BACKENDS, make_policy
from gibson_path_following.policies.learned import LearnedPolicy
from gibson_path_following.policies.teach_repeat import TeachRepeatPolicy
from gibson_path_following.types import STOP, PathNode, Place, RecordedPath
from support.path_views import straight_path


def test_teach_and_repeat_has_the_limits_and_shares_its_nodes_with_the_localiser() -> None:
    policy, localiser = make_policy("teach_repeat", straight_path(), 0.25, 0.5)
    assert isinstance(policy, TeachRepeatPolicy)
    assert (policy.settings.max_linear, policy.settings.max_angular) == (0.25, 0.5)
    assert policy.nodes is localiser.nodes


@pytest.mark.parametrize("name", ["learned:none.onnx", "onnx:none.onnx"])
def test_a_missing_network_is_named(name: str) -> None:
    with pytest.raises(ModelError, match=r"none\.onnx"):
        make_policy(name, straight_path())


@pytest.mark.parametrize("backend", ["teach_repeat", "learned", "onnx:none.onnx"])
def test_a_path_of_images_alone_is_refused(backend: str) -> None:
    nodes = tuple(PathNode(node.view, node.stamp_ns, 0.0, ((0, STOP),)) for node in straight_path().nodes)
    with pytest.raises(SettingError, match=r"12 nodes, but neither distances nor velocities.*localise on it with path_localiser"):
        make_policy(backend, RecordedPath("pinhole", straight_path().hfov, nodes))


@pytest.mark.parametrize("name", ["", "magic", "learned:", "onnx:", "teach_repeat:x"])
def test_unknown_names_are_refused_with_the_known_ones(name: str) -> None:
    with pytest.raises(SettingError, match="must be learned, learned:FILE, teach_repeat or onnx:FILE"):
        make_policy(name, straight_path())
    assert name not in BACKENDS


@pytest.mark.parametrize("backend", ["teach_repeat", "learned"])
def test_commands_are_bounded_and_finite_whatever_the_images_show(backend: str) -> None:
    rng = np.random.default_rng(0)
    for path in (straight_path(), straight_path(angular=0.5)):
        policy, localiser = make_policy(backend, path, 0.3, 0.6)
        shape, sent = path.nodes[0].view[0].shape, []
        for k in range(25):
            noise = rng.integers(0, 256, shape, np.uint8) if k % 5 else np.full(shape, 255 * (k % 2), np.uint8)
            place = localiser.update((noise,))
            # Also where a localiser is sure of a wrong place.
            sent.append(
                policy.act((noise,), k * 200_000_000, place if k % 2 else Place(float(rng.uniform(0.0, 11.0)), 1.0, False))
            )
        assert all(abs(v.linear) <= 0.3 and abs(v.angular) <= 0.6 for v in sent)


def test_the_learned_policy_knows_where_its_camera_is() -> None:
    policy, _ = make_policy("learned", straight_path(), camera_ahead=0.3)
    assert isinstance(policy, LearnedPolicy)
    assert policy.settings.camera_ahead == 0.3


def test_without_onnxruntime_the_message_names_the_backend_that_needs_none(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(backends, "find_spec", lambda name: None)
    with pytest.raises(
        SettingError, match=r"needs onnxruntime, which is not installed: pip install .* or set backend to teach_repeat"
    ):
        make_policy("learned", straight_path())
    assert isinstance(make_policy("teach_repeat", straight_path())[0], TeachRepeatPolicy)
