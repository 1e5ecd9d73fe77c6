"""Makes the policy that a name stands for, with a localiser of the same path. A network is loaded only when it is chosen."""

from __future__ import annotations

from gibson_path_following.errors import SettingError, quoted
from gibson_path_following.localisation import Localiser, NodeMatcher
from gibson_path_following.teach_repeat import TeachRepeatPolicy, TeachRepeatSettings
from gibson_path_following.types import Policy, RecordedPath

BACKENDS = ("teach_repeat",)
"""Names of the policies."""


def make_policy(backend: str, path: RecordedPath, max_linear: float = 0.5, max_angular: float = 1.0) -> tuple[Policy, Localiser]:
    """Returns a policy for a path, and its localiser.

    Args:
        backend: one of ``BACKENDS``.
        path: the path.
        max_linear: largest speed, m/s.
        max_angular: largest yaw rate, rad/s.

    Raises:
        PathFollowingError: there is no such policy, or its network cannot be used.
    """
    nodes = NodeMatcher(path)
    localiser = Localiser(path, nodes=nodes)
    if backend == "teach_repeat":
        return TeachRepeatPolicy(path, TeachRepeatSettings(max_linear=max_linear, max_angular=max_angular), nodes), localiser
    raise SettingError(f"backend is {quoted(backend)}, must be {' or '.join(BACKENDS)}")
