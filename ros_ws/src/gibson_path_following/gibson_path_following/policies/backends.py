"""Creates the policy of a backend name, with a localiser of the same path. It loads a network only for a backend that has one."""

from __future__ import annotations

from importlib.util import find_spec
from pathlib import Path

from gibson_path_following.errors import SettingError, quoted
from gibson_path_following.localisation.localiser import Localiser, NodeMatcher
from gibson_path_following.localisation.motions import has_motion
from gibson_path_following.policies.teach_repeat import TeachRepeatPolicy, TeachRepeatSettings
from gibson_path_following.types import Policy, RecordedPath

BACKENDS = ("learned", "learned:FILE", "teach_repeat", "onnx:FILE")
"""Backend names: our network, that of the package or of a file; visual teach and repeat; a network of the GNM family, a file or folder."""


def make_policy(
    backend: str, path: RecordedPath, max_linear: float = 0.5, max_angular: float = 1.0, camera_ahead: float = 0.12
) -> tuple[Policy, Localiser]:
    """Returns the policy of a backend for a path, and its localiser.

    Args:
        backend: one of ``BACKENDS``.
        path: the path.
        max_linear: largest speed, m/s.
        max_angular: largest yaw rate, rad/s.
        camera_ahead: distance of the camera ahead of the robot's centre, metres; for ``learned``.

    Raises:
        PathFollowingError: there is no such policy, its network cannot be used, or the path was recorded from images alone.
    """
    if not has_motion(path):
        raise SettingError(
            f"the path has {len(path.nodes)} nodes, but neither distances nor velocities: no robot can drive along it, since it was recorded "
            "from images alone; localise on it with path_localiser, or record it with odom or cmd_vel"
        )
    nodes = NodeMatcher(path)
    localiser = Localiser(path, nodes=nodes)
    name, _, file = backend.partition(":")
    if backend == "teach_repeat":
        return TeachRepeatPolicy(path, TeachRepeatSettings(max_linear=max_linear, max_angular=max_angular), nodes), localiser
    if name == "learned" and (file or backend == name):
        if find_spec("onnxruntime") is None:
            raise SettingError(
                f"backend {backend} needs onnxruntime, which is not installed: pip install 'gibson_path_following[onnx]', or set backend to "
                "teach_repeat, which needs no network and drives around no obstacle"
            )
        from gibson_path_following.obstacles.arcs import ArcSettings
        from gibson_path_following.policies.learned import LearnedPolicy, LearnedSettings
        from gibson_path_following.policies.path_model import DEFAULT_MODEL

        settings = LearnedSettings(camera_ahead=camera_ahead, arcs=ArcSettings(max_linear=max_linear, max_angular=max_angular))
        return LearnedPolicy(path, Path(file) if file else DEFAULT_MODEL, settings, nodes), localiser
    if name == "onnx" and file:
        from gibson_path_following.policies.gnm_policy import GnmPolicy, GnmSettings

        return GnmPolicy(path, Path(file), GnmSettings(max_linear=max_linear, max_angular=max_angular)), localiser
    raise SettingError(f"backend is {quoted(backend)}, must be {', '.join(BACKENDS[:-1])} or {BACKENDS[-1]}")
