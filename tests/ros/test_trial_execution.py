"""Runs of trials with small stacks, good and bad: each ends with its kind of end, and leaves nothing behind."""

from __future__ import annotations

import math
import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from support.processes import is_running
from support.scenes import write_room
from support.simulation import require

require("rclpy", "gibson_msgs", "simulation_interfaces")

from rclpy.task import Future  # noqa: E402

from gibson_sim.bags.reader import BagReader  # noqa: E402
from gibson_sim.bags.replaying import read_run  # noqa: E402
from gibson_sim.processes.domain_lock import DomainLock  # noqa: E402
from gibson_sim.ros.trials.trial_node import _ActionGoal  # noqa: E402
from gibson_sim.trials.execution import execute, session  # noqa: E402
from gibson_sim.trials.execution.monitor import RunMonitor  # noqa: E402
from gibson_sim.trials.execution.trial_node import TrialInput  # noqa: E402
from gibson_sim.trials.records import Outcome, Person, PlacedObject, RunSpec  # noqa: E402
from gibson_sim.trials.scenario.spec import GoalInterface, Limits, Ready, Scenario, StackSpec, Status  # noqa: E402

pytestmark = pytest.mark.ros
STACKS = Path(__file__).parents[1] / "support" / "stacks"
DOMAINS = range(30, 50)
PATIENCE_S = 60.0
NS = 10**9


@pytest.fixture(scope="module")
def room(tmp_path_factory: pytest.TempPathFactory) -> str:
    """A scene that loads at once."""
    return str(write_room(tmp_path_factory.mktemp("room")))


def run_in(room: str, distance: float = 1.0) -> RunSpec:
    return RunSpec(1, room, "gibson_bot", 3, (0.0, 0.0, 0.0), (distance, 0.0, 0.0), distance, 0.18)


def scenario_of(*command: str, lockstep: bool = True, ready: Ready = Ready(), limits: Limits = Limits()) -> Scenario:  # noqa: B008
    rules = ("cmd_vel after ground_truth/odom",) if lockstep else ()
    stack = StackSpec(command, folder=STACKS, ready=ready, status=Status("status"), lockstep=rules)
    return Scenario("t", Path("t.yaml"), ("room",), stack, limits=limits)


def drive(*arguments: str) -> tuple[str, ...]:
    return (sys.executable, "drive.py", *arguments)


def marked_processes() -> list[str]:
    """Returns the command lines of all stacks' processes that these tests started and that are still there."""
    found = []
    for folder in Path("/proc").glob("[0-9]*"):
        try:
            variables = (folder / "environ").read_bytes().split(b"\0")
            if any(v.startswith(b"GIBSON_SIM_TRIAL=") for v in variables) and f"OF={os.getpid()}".encode() in variables:
                found.append((folder / "cmdline").read_text())
        except OSError:  # it has ended, or is someone else's
            continue
    return found


@pytest.fixture
def leaves_nothing(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    monkeypatch.setenv("OF", str(os.getpid()))
    domains: list[int] = []
    locked = session.acquire_free_domain

    def lock(allowed: Sequence[int]) -> tuple[int, DomainLock]:
        domain, held = locked(allowed)
        domains.append(domain)
        return domain, held

    monkeypatch.setattr(session, "acquire_free_domain", lock)
    yield
    session.SESSIONS.close()
    assert marked_processes() == []
    for domain in domains:
        DomainLock(domain).close()


@pytest.mark.usefixtures("leaves_nothing")
def test_equal_runs_with_things_and_people_are_equal_to_the_bit(room: str, tmp_path: Path) -> None:
    box, anna = (
        PlacedObject("box", "box_cardboard", (1.0, 1.0, 0.3)),
        Person("anna", ((-1.0, -1.0), (1.0, -1.0)), 0.8, 0.25, 1.75),
    )
    run = replace(run_in(room), things=(box,), people=(anna,))
    outcomes: list[Outcome] = []
    for number in range(2):
        outcomes.append(execute(scenario_of(*drive("daemon")), run, tmp_path / str(number), domains=DOMAINS))
        assert sorted(p.name for p in (tmp_path / str(number)).iterdir()) == [
            "bag", "outcome.json", "simulation.log", "stack.log",
        ]  # fmt: skip
    first, second = outcomes
    assert (first.end, first.goal_ns, first.lockstep, first.refused_commands) == ("reached", 0, True, 0)
    assert (first.end_ns, first.decided_ns) == (second.end_ns, second.decided_ns)
    assert first.end_ns % (NS // 2) == 0
    assert first.start_up_s > 0.0 and first.running_s > 0.0 and first.ending_s > 0.0
    digests = [read_run(tmp_path / str(number) / "bag", digests=True).digests for number in range(2)]
    assert len(digests[0]) == first.end_ns * 60 // NS, "a digest for each tick, of 60 in a second"
    assert digests[0] == digests[1]
    said = (tmp_path / "0" / "stack.log").read_text()
    assert "the stack starts" in said
    assert not is_running(int(said.partition("without environment: ")[2].split()[0]))
    assert "physics  | INFO lockstep: 'trial' joined" in (tmp_path / "0" / "simulation.log").read_text()


@pytest.mark.usefixtures("leaves_nothing")
def test_failing_stacks_end_with_their_kind_of_failure(room: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(session, "STACK_GRACE_S", ((signal.SIGINT, 1.0), (signal.SIGTERM, 0.5), (signal.SIGKILL, PATIENCE_S)))
    run, limits = run_in(room), Limits(time=4.0, wall_time=PATIENCE_S, silence=3.0)

    crash = execute(scenario_of(*drive("crash"), limits=limits), run_in(room, 3.0), tmp_path / "crash", domains=DOMAINS)
    assert (crash.end, crash.exit_code, crash.end_ns) == ("stack died", 1, 3 * NS)
    assert crash.detail == "the stack ended with code 1; its last line: RuntimeError: no more memory for the costmap"

    nan = execute(scenario_of(*drive("nan"), limits=limits), run, tmp_path / "nan", domains=DOMAINS)
    assert (nan.end, nan.end_ns, nan.refused_commands) == ("time limit", 4 * NS, 239), "one for each tick but the last"

    hang = execute(scenario_of(*drive("hang"), limits=limits), run_in(room, 3.0), tmp_path / "hang", domains=DOMAINS)
    assert (hang.end, hang.end_ns) == ("stack silent", 3 * NS)
    assert hang.detail.startswith("no message on cmd_vel within 3 s of wall time, at 3.000 s")

    dead = execute(scenario_of("false", limits=limits), run, tmp_path / "dead", domains=DOMAINS)
    assert (dead.end, dead.detail, dead.goal_ns) == ("stack died", "the stack ended with code 1; it printed nothing", -1)

    never = scenario_of(sys.executable, "never_ready.py", ready=Ready(within=0.5, service="plan"), limits=limits)
    outcome = execute(never, run, tmp_path / "never", domains=DOMAINS)
    assert outcome.end == "never ready"
    assert outcome.detail.endswith(
        "no subscriber of /goal_pose, on which the goal is given (key stack.goal) and no service 'plan'"
    )


@pytest.mark.usefixtures("leaves_nothing")
def test_run_without_rules_is_in_real_time_and_ends_when_it_is_told_to(room: str, tmp_path: Path) -> None:
    told: list[str] = []
    scenario = scenario_of(*drive("service"), lockstep=False, limits=Limits(wall_time=PATIENCE_S))
    scenario = replace(
        scenario, stack=replace(scenario.stack, goal=GoalInterface("service", "plan", "nav_msgs/srv/GetPlan", "goal"))
    )
    outcome = execute(
        scenario,
        run_in(room, 3.0),
        tmp_path,
        domains=DOMAINS,
        on_progress=told.append,
        stop=lambda: any(" m from" in t for t in told),
    )
    assert (outcome.end, outcome.lockstep, outcome.goal_ns) == ("interrupted", False, 0)
    assert outcome.end_ns > 0


@pytest.mark.usefixtures("leaves_nothing")
def test_shell_script_is_a_stack_and_the_true_pose_decides(room: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("PATH", f"{Path(sys.executable).parent}:{os.environ['PATH']}")  # it calls gibson-sim
    scenario = scenario_of("./script.sh", lockstep=False, limits=Limits(wall_time=PATIENCE_S))
    scenario = replace(scenario, stack=replace(scenario.stack, status=Status()))
    outcome = execute(scenario, run_in(room, 0.8), tmp_path, domains=DOMAINS)
    assert outcome.end == "reached", (
        outcome.detail,
        (tmp_path / "stack.log").read_text(),
        (tmp_path / "simulation.log").read_text(),
    )
    assert outcome.detail.endswith("m from the goal")
    assert outcome.end_ns - outcome.decided_ns >= NS, "it has stood there for a second"


@pytest.mark.usefixtures("leaves_nothing")
def test_lifecycle_node_gets_its_goal_once_it_is_active_and_doors_close(tmp_path: Path) -> None:
    house = write_room(tmp_path / "house")
    with (house / "scene.yaml").open("a") as file:
        file.write("bodies: [{name: way, model: door_90_left, pose: {xyz: [-1.0, 0.9, 0.0]}, joints: {hinge: 85.0}}]\n")
    scenario = scenario_of(*drive("lifecycle"), ready=Ready(node="drive"), limits=Limits(time=30.0))
    outcome = execute(scenario, replace(run_in(str(house)), closed_doors=("way",)), tmp_path / "run", domains=DOMAINS)
    assert (outcome.end, outcome.goal_ns) == ("reached", 0)
    with BagReader(tmp_path / "run" / "bag") as reader:
        hinges = [
            dict(zip(values.interface_names, values.values, strict=True))["position"]
            for _, _, message in reader.messages(["/object_joint_states"])
            for name, values in zip(message.joint_names, message.interface_values, strict=True)
            if name == "way/hinge"
        ]
    assert hinges[0] == pytest.approx(math.radians(85.0))
    assert hinges[-1] == pytest.approx(0.0, abs=0.01)


@pytest.mark.usefixtures("leaves_nothing")
def test_kept_stack_serves_run_after_run(room: str, tmp_path: Path) -> None:
    scenario = scenario_of(*drive(), limits=Limits(time=30.0, silence=30.0))
    scenario = replace(scenario, stack=replace(scenario.stack, restart="never"))
    starts = []
    for number, distance in enumerate((0.6, 0.3)):
        outcome = execute(scenario, run_in(room, distance), tmp_path / str(number), domains=DOMAINS)
        assert (outcome.end, outcome.goal_ns) == ("reached", number * NS // 2), "it first sees that time begins again"
        starts.append("the stack starts" in (tmp_path / str(number) / "stack.log").read_text())
    assert starts == [True, False]
    assert len(marked_processes()) == 1
    assert read_run(tmp_path / "1" / "bag", digests=True).digests


@pytest.mark.usefixtures("leaves_nothing")
def test_stack_that_was_started_before_its_run_makes_the_same_run(room: str, tmp_path: Path) -> None:
    scenario, waiting = scenario_of(*drive(), limits=Limits(time=30.0, silence=30.0)), []
    for number in range(2):
        outcome = execute(scenario, run_in(room, 0.4), tmp_path / str(number), domains=DOMAINS, followed=number == 0)
        assert (outcome.end, outcome.goal_ns) == ("reached", 0)
        assert (tmp_path / str(number) / "stack.log").read_text().count("the stack starts") == 1
        waiting.append([prepared.has_stack for prepared in session.SESSIONS.prepared])
    assert waiting == [[True], []]
    digests = [read_run(tmp_path / str(number) / "bag", digests=True).digests for number in range(2)]
    assert digests[0] and digests[0] == digests[1]


@pytest.mark.parametrize(
    ("accepted", "status", "end"), [(False, 0, "gave up"), (True, 4, "reached"), (True, 6, "gave up"), (True, 5, "gave up")]
)
def test_result_of_an_action_is_the_end(accepted: bool, status: int, end: str) -> None:
    """Answers as those of rclpy's client; no action with a pose is installed everywhere."""

    def answer(**values: object) -> Any:
        future = Future()
        future.set_result(SimpleNamespace(**values))
        return future

    scenario = scenario_of("true")
    scenario = replace(scenario, stack=replace(scenario.stack, goal=GoalInterface("action", "go", "a_msgs/action/Go")))
    monitor = RunMonitor(TrialInput.of(scenario, run_in("room")))
    goal = _ActionGoal.__new__(_ActionGoal)
    goal._monitor = monitor
    monitor.give_goal(0)
    goal._on_response(answer(accepted=accepted, get_result_async=lambda: answer(status=status)))
    assert goal.is_accepted()
    decision = monitor.silence(0.0)
    assert decision is not None and decision.end == end


def test_worker_that_is_killed_leaves_no_process(room: str, tmp_path: Path) -> None:
    code = (
        "import sys; sys.path.insert(0, sys.argv[1])\n"
        "from pathlib import Path\n"
        "from test_trial_execution import *\n"
        "execute(scenario_of(*drive('daemon')), run_in(sys.argv[2], 4.0), Path(sys.argv[3]), domains=DOMAINS)"
    )
    paths = os.pathsep.join(str(p) for p in (Path(__file__).parent, Path(__file__).parents[1]))
    worker = subprocess.Popen(
        [sys.executable, "-c", code, str(Path(__file__).parent), room, str(tmp_path)],
        env={**os.environ, "PYTHONPATH": paths, "OF": str(os.getpid())},
    )
    try:
        wait_for(lambda: len(marked_processes()) == 2, "stack and its daemon")
    finally:
        worker.send_signal(signal.SIGKILL)
        worker.wait()
    wait_for(lambda: marked_processes() == [], "end of all")


def wait_for(condition: Callable[[], bool], what: str) -> None:
    deadline = time.monotonic() + PATIENCE_S
    while not condition():
        assert time.monotonic() < deadline, what
        time.sleep(0.05)
