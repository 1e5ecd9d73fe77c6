"""``named_goals`` against a localiser and a navigator that start late, as Nav2's do: no message is handled but what the test gives."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from types import SimpleNamespace
from typing import Any

import pytest

from support.simulation import require

require("rclpy", "lifecycle_msgs", "nav_msgs", "tf2_msgs")

from geometry_msgs.msg import PoseWithCovarianceStamped, TransformStamped  # noqa: E402
from lifecycle_msgs.msg import State  # noqa: E402
from lifecycle_msgs.srv import GetState  # noqa: E402
from nav_msgs.msg import Odometry  # noqa: E402
from rclpy.task import Future  # noqa: E402
from tf2_msgs.msg import TFMessage  # noqa: E402

from gibson_examples import named_goals  # noqa: E402
from gibson_examples.errors import NavigationError  # noqa: E402
from gibson_examples.named_goals import NamedGoals  # noqa: E402

pytestmark = pytest.mark.ros
INACTIVE = State(id=State.PRIMARY_STATE_INACTIVE, label="inactive")
ACTIVE = State(id=State.PRIMARY_STATE_ACTIVE, label="active")
TIMEOUT_S = 10.0


def done(result: Any) -> Future:
    future = Future()
    future.set_result(result)
    return future


class Node(NamedGoals):
    """The node with a clock of its own; ``each_spin`` stands for everything else."""

    def __init__(self, context: Any, monkeypatch: pytest.MonkeyPatch) -> None:
        super().__init__(TIMEOUT_S, context=context)
        self.now_s = 100.0
        self.each_spin: Callable[[], None] = lambda: None
        self.initial_poses: list[tuple[float, PoseWithCovarianceStamped]] = []
        """With the time, s."""
        self.states: list[State | None] = []
        """What the navigator answers in turn, the last one always; None = nothing. Empty: there is no such service."""
        self.amcl_publishers = 1
        monkeypatch.setattr(named_goals, "time", SimpleNamespace(monotonic=lambda: self.now_s))

    def _spin(self) -> None:
        self.now_s += 0.1
        self.each_spin()

    def _result(self, future: Any, timeout_s: float | None = None) -> Any:
        if not future.done():
            assert timeout_s is not None, "waits for ever"
            self.now_s += timeout_s
        return future.result()

    def create_publisher(self, kind: Any, topic: str, *args: Any, **options: Any) -> Any:
        if topic != "initialpose":
            return super().create_publisher(kind, topic, *args, **options)
        return SimpleNamespace(publish=lambda message: self.initial_poses.append((self.now_s, message)))

    def count_publishers(self, topic_name: str) -> int:
        assert topic_name == "amcl_pose"
        return self.amcl_publishers

    def create_client(self, kind: Any, name: str, **options: Any) -> Any:
        assert (kind, name) == (GetState, "bt_navigator/get_state")
        return SimpleNamespace(
            wait_for_service=lambda _timeout_s: bool(self.states),
            call_async=lambda _request: self._state(),
            remove_pending_request=lambda _future: None,
        )

    def _state(self) -> Future:
        state = self.states.pop(0) if len(self.states) > 1 else self.states[0]
        return Future() if state is None else done(GetState.Response(current_state=state))

    def odometry(self) -> None:
        message = Odometry()
        message.header.frame_id = "odom_of_any_name"
        message.pose.pose.position.x, message.pose.pose.position.y = 3.0, 4.0
        self._on_odometry(message)

    def amcl_pose(self, x: float) -> None:
        message = PoseWithCovarianceStamped()
        message.pose.pose.position.x, message.pose.pose.position.y = x, 4.0
        self._on_amcl_pose(message)

    def map_to_odom(self) -> None:
        transform = TransformStamped(child_frame_id="odom")
        transform.header.frame_id = "map"
        self._on_tf(TFMessage(transforms=[TransformStamped(child_frame_id="base_footprint"), transform]))


@pytest.fixture
def node(context: Any, monkeypatch: pytest.MonkeyPatch) -> Iterator[Node]:
    node = Node(context, monkeypatch)
    yield node
    node.destroy_node()


def test_initial_pose_is_sent_each_second_until_amcl_has_it(node: Node) -> None:
    node.odometry()
    node.each_spin = lambda: node.amcl_pose(3.2) if len(node.initial_poses) == 4 else None
    node.set_initial_pose()
    times = [at for at, _ in node.initial_poses]
    assert times == pytest.approx([100.0, 101.0, 102.0, 103.0], abs=0.11 * 4)
    _, message = node.initial_poses[-1]
    assert (message.header.frame_id, message.pose.pose.position.x, message.pose.pose.position.y) == ("map", 3.0, 4.0)
    assert message.pose.covariance[0] == message.pose.covariance[7] == 0.02


def test_initial_pose_waits_for_the_true_pose(node: Node) -> None:
    def spin() -> None:
        node.amcl_pose(3.0)
        if node.now_s > 105.0:
            node.odometry()

    node.each_spin = spin
    node.set_initial_pose()
    assert [at for at, _ in node.initial_poses] == pytest.approx([105.1], abs=0.2)


def test_pose_that_amcl_had_before_is_no_answer(node: Node) -> None:
    """After a reset AMCL still publishes the pose and the transform from before it."""

    def spin() -> None:
        node.map_to_odom()
        node.amcl_pose(3.0 if node.now_s > 105.0 else 8.0)

    node.odometry()
    node.each_spin = spin
    node.set_initial_pose()
    assert node.now_s == pytest.approx(105.1, abs=0.11)


def test_transform_answers_for_a_localiser_without_amcl_pose(node: Node) -> None:
    node.odometry()
    node.amcl_publishers = 0
    node.each_spin = lambda: node.map_to_odom() if node.now_s > 102.0 else None
    node.set_initial_pose()
    assert node.now_s == pytest.approx(102.1, abs=0.11)


def test_timeout_error_names_the_awaited_message(node: Node) -> None:
    with pytest.raises(NavigationError, match=r"^no ground_truth/odom within 10 s \(--timeout\): start gibson-sim run$"):
        node.set_initial_pose()
    node.odometry()
    with pytest.raises(
        NavigationError, match=r"^neither amcl_pose near .* nor map -> odom in /tf within 10 s .*--no-initial-pose.*$"
    ):
        node.set_initial_pose()
    assert len(node.initial_poses) == 10


def test_goals_wait_until_the_navigator_is_active(node: Node) -> None:
    node.states = [None, State(id=State.PRIMARY_STATE_UNCONFIGURED, label="unconfigured"), INACTIVE, ACTIVE]
    node.wait_until_active()
    assert node.states == [ACTIVE]
    assert node.now_s == pytest.approx(104.0, abs=0.4), (
        "a second for the answer that did not come, and three between the questions"
    )


def test_navigator_that_stays_inactive_is_an_error(node: Node) -> None:
    node.states = [INACTIVE]
    with pytest.raises(
        NavigationError, match=r"^bt_navigator was not active within 10 s \(--timeout\) but inactive: .*lifecycle_manager"
    ):
        node.wait_until_active()
    node.states = [None]
    with pytest.raises(NavigationError, match=r"but silent: "):
        node.wait_until_active()


class Navigator:
    """An action client whose server refuses goals until it is active, as bt_navigator does."""

    def __init__(self, node: Node, *statuses: int) -> None:
        self._node, self._statuses = node, list(statuses)

    def wait_for_server(self, timeout_s: float) -> bool:
        return timeout_s == TIMEOUT_S

    def send_goal_async(self, goal: Any) -> Future:
        accepted = self._node.states[:1] in ([], [ACTIVE])
        return done(
            SimpleNamespace(accepted=accepted, get_result_async=lambda: done(SimpleNamespace(status=self._statuses.pop(0))))
        )


@pytest.mark.parametrize("states", [[INACTIVE, INACTIVE, ACTIVE], []], ids=["nav2", "a navigator without states"])
def test_goals_are_sent_once_the_navigator_takes_them(node: Node, monkeypatch: pytest.MonkeyPatch, states: list[State]) -> None:
    node.states = list(states)
    monkeypatch.setattr(named_goals, "ActionClient", lambda _node, _kind, _name: Navigator(node, 4, 6, 4))
    monkeypatch.setattr(named_goals, "interface", lambda *_names: SimpleNamespace(Goal=SimpleNamespace))
    places = [SimpleNamespace(name=f"room_{i}", description="", pose=named_goals.PoseStamped().pose) for i in range(3)]
    assert node.drive_to(places) == 2
