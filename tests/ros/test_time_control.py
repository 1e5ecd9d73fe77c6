"""Time as clients see it: /clock, the real-time factor, another pace while it runs, a start that waits."""

from __future__ import annotations

from collections.abc import Iterator
from statistics import median
from typing import Any

import pytest

from support.simulation import Launched, Listener, require

require("rclpy", "gibson_msgs", "simulation_interfaces")

from nav_msgs.msg import Odometry  # noqa: E402
from rosgraph_msgs.msg import Clock  # noqa: E402
from simulation_interfaces.msg import SimulationState  # noqa: E402
from std_msgs.msg import Float64  # noqa: E402

from gibson_msgs.msg import Scene, SceneState  # noqa: E402
from gibson_sim.ros.client.simulation_client import SimulationClient  # noqa: E402
from support.clients import DEEP, LATCHED, client_of, stamp_ns, step_of, steps_of  # noqa: E402

pytestmark = pytest.mark.ros
NEVER_FASTER = 1.05
"""Greatest real-time factor relative to the requested rate. A busy machine may be slower, no machine may be faster."""


@pytest.fixture(scope="module", params=[()], ids=["usual"])
def sim(ros_domain: int, request: pytest.FixtureRequest) -> Iterator[Launched]:
    """A simulation; there can be one at a time, so the tests that need another one name its options."""
    launched = Launched("run", "--no-render", *request.param)
    launched.wait_for_line("collision shapes")
    yield launched
    assert launched.stop() == 0, "\n".join(launched.lines)


def _options(*options: str) -> pytest.MarkDecorator:
    return pytest.mark.parametrize("sim", [options], indirect=True, ids=["_".join(options)], scope="module")


@pytest.fixture
def control(sim: Launched, listener: Listener) -> Iterator[SimulationClient]:
    """The services of the simulation; afterwards it keeps the pace of wall time again."""
    services = client_of(listener)
    yield services
    services.set_parameter("physics", "rate", 1.0)


def test_clock_comes_at_its_rate_and_at_every_published_tick(sim: Launched, listener: Listener) -> None:
    clock = listener.collect(Clock, "/clock", DEEP)
    listener.spin_until(lambda: len(clock) > 240, "time")
    # Of every 12 steps at 240 Hz: 100 Hz is due at 3, 5, 8, 10 and 12, 60 Hz at 4, 8 and 12; sensors are due at some of these.
    assert {step % 12 for step in steps_of(clock)} == {0, 3, 4, 5, 8, 10}


def test_clock_has_all_ticks_of_the_state_and_comes_no_later(sim: Launched, listener: Listener) -> None:
    sent: dict[str, dict[int, int]] = {"clock": {}, "state": {}}

    def keep(name: str) -> Any:
        def on_message(message: Any, info: dict[str, int]) -> None:
            sent[name][stamp_ns(message)] = info["source_timestamp"]

        return on_message

    listener.node.create_subscription(Clock, "/clock", keep("clock"), DEEP)
    listener.node.create_subscription(SceneState, "scene_state", keep("state"), DEEP)
    listener.spin_until(lambda: len(sent["state"]) > 60 and max(sent["clock"], default=0) >= max(sent["state"]), "a second")
    states = [stamp for stamp in sent["state"] if stamp >= min(sent["clock"])]
    assert not [stamp for stamp in states if stamp not in sent["clock"]]
    assert not [stamp for stamp in states if sent["clock"][stamp] > sent["state"][stamp]]


def test_stamp_is_the_step_in_whole_nanoseconds(sim: Launched, listener: Listener) -> None:
    states = listener.collect(SceneState, "scene_state", DEEP)
    listener.spin_until(lambda: len(states) > 30, "states")
    assert [stamp_ns(state) for state in states] == [state.step * 1_000_000_000 // 240 for state in states]


@_options("--step-hz", "900", "--publish-hz", "90")
def test_stamps_of_another_step_rate_are_whole_nanoseconds_too(sim: Launched, listener: Listener) -> None:
    states = listener.collect(SceneState, "scene_state", DEEP)
    listener.spin_until(lambda: len(states) > 30, "states")
    assert [stamp_ns(state) for state in states] == [state.step * 1_000_000_000 // 900 for state in states]
    assert {state.step % 10 for state in states} == {0}, "900 steps and 90 states a second"


@pytest.mark.parametrize("rate", [0.3, 1.0])
def test_real_time_factor_is_never_above_the_requested_rate(
    sim: Launched, listener: Listener, control: SimulationClient, rate: float
) -> None:
    assert control.set_parameter("physics", "rate", rate) == (True, "")
    factors = listener.collect(Float64, "real_time_factor", DEEP)
    # The report in which the pace changed is a mixture.
    listener.spin_until(lambda: len(factors) > 3, "real-time factors")
    later = [factor.data for factor in factors[1:]]
    print(f"requested {rate:g}: {[round(factor, 3) for factor in later]}")
    assert 0.0 < median(later) <= NEVER_FASTER * rate


def test_pace_changes_while_it_runs(sim: Launched, listener: Listener, control: SimulationClient) -> None:
    factors = listener.collect(Float64, "real_time_factor", DEEP)
    assert control.set_parameter("physics", "rate", 0.05) == (True, "")
    listener.spin_until(lambda: bool(factors) and factors[-1].data < 0.06, "a twentieth of the pace")
    assert control.set_parameter("physics", "rate", 1.0) == (True, "")
    listener.spin_until(lambda: factors[-1].data > 0.08, "a higher pace")


def test_pace_without_end_is_as_fast_as_the_machine(sim: Launched, listener: Listener, control: SimulationClient) -> None:
    factors = listener.collect(Float64, "real_time_factor", DEEP)
    assert control.set_parameter("physics", "rate", 0.05) == (True, "")
    listener.spin_until(lambda: bool(factors) and factors[-1].data < 0.06, "a slow pace")
    assert control.set_parameter("physics", "rate", 0.0) == (True, "")
    listener.spin_until(lambda: factors[-1].data > 0.08, "a higher pace")


def test_time_goes_on_where_it_was_when_the_pace_changes(sim: Launched, listener: Listener, control: SimulationClient) -> None:
    states = listener.collect(SceneState, "scene_state", DEEP)
    listener.spin_until(lambda: len(states) > 10, "states")
    for rate in (0.5, 2.0, 1.0):
        assert control.set_parameter("physics", "rate", rate) == (True, "")
        count = len(states)
        listener.spin_until(lambda count=count: len(states) > count + 10, "states at another pace")  # type: ignore[misc]
    steps = [state.step for state in states]
    assert steps == list(range(steps[0], steps[-1] + 1, 4))


def test_impossible_pace_is_refused_and_nothing_changes(sim: Launched, listener: Listener, control: SimulationClient) -> None:
    taken, why = control.set_parameter("physics", "rate", -1.0)
    assert not taken
    assert all(word in why for word in ("rate", "0.0", "1000.0", "-1.0")), why
    clock = listener.collect(Clock, "/clock", DEEP)
    listener.spin_until(lambda: len(clock) > 10, "time that goes on")


def test_other_settings_cannot_be_changed_while_it_runs(sim: Launched, control: SimulationClient) -> None:
    taken, why = control.set_parameter("physics", "cmd_vel_timeout", 1.0)
    assert not taken
    assert "read-only" in why


@_options("--start-paused")
def test_start_that_waits_shows_the_scene_and_begins_with_the_first_step(
    sim: Launched, listener: Listener, control: SimulationClient
) -> None:
    scenes = listener.collect(Scene, "scene", LATCHED)
    clock, odometry = listener.collect(Clock, "/clock", DEEP), listener.collect(Odometry, "odom", DEEP)
    listener.spin_until(lambda: bool(scenes) and bool(listener.node.count_publishers("odom")), "the scene")
    # Factors come once a second of wall time, so time had a chance to pass.
    factors = listener.collect(Float64, "real_time_factor", DEEP)
    listener.spin_until(lambda: len(factors) > 1, "reports")
    assert control.state in (SimulationState.STATE_STOPPED, SimulationState.STATE_PAUSED)
    assert [factor.data for factor in factors] == [0.0] * len(factors)
    assert (clock, odometry) == ([], [])
    control.play()
    listener.spin_until(lambda: len(odometry) > 3 and len(clock) > 3, "time")
    assert step_of(stamp_ns(clock[0])) == 3, "100 Hz is due first at step 3 of 240"
    assert steps_of(odometry[:3]) == [4, 8, 12]
