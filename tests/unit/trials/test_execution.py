"""Parts of the execution of a run that need no ROS: settings, logs, endings, domains, leftover processes."""

from __future__ import annotations

import sys
from dataclasses import replace
from pathlib import Path

import pytest

from gibson_sim.errors import AlreadyRunningError, ConfigError, EnvironmentProblemError
from gibson_sim.processes.domain_lock import DomainLock
from gibson_sim.reach import PROFILE_VARIABLE
from gibson_sim.trials.execution import check_stack
from gibson_sim.trials.execution.ending import exit_text, last_error, node_died, reported_ending, stack_died
from gibson_sim.trials.execution.node_settings import node_settings, participants_of, stack_environment
from gibson_sim.trials.execution.session import acquire_free_domain
from gibson_sim.trials.execution.stack_log import StackLog
from gibson_sim.trials.execution.supervisor import prepare_folder
from gibson_sim.trials.execution.trial_node import TrialReport
from gibson_sim.trials.records import RunSpec
from gibson_sim.trials.scenario.spec import GoalInterface, Ready, Recording, Scenario, StackSpec

STACK = StackSpec((sys.executable, "-c", ""), lockstep=("cmd_vel every 0.05", "loc=pose after scan"))
RUN = RunSpec(1, "flat", "gibson_bot", 7, (1.0, 2.0, 0.5), (2.5, 1.0, 0.0), 1.5, 0.18)


def scenario_of(stack: StackSpec = STACK, **other: object) -> Scenario:
    return Scenario("t", Path("t.yaml"), ("flat",), stack, **other)  # type: ignore[arg-type]


def test_run_in_lockstep_waits_for_our_nodes_and_the_rules_of_the_stack(tmp_path: Path) -> None:
    physics = node_settings(scenario_of(), RUN, tmp_path, tmp_path / "job").physics
    assert physics.sync.participants == "trial; record; cmd_vel=cmd_vel every 0.05; loc=pose after scan"
    assert (physics.sync.lockstep, physics.time.rate, physics.topics.digests) == (True, 0.0, True)
    assert (physics.time.start_paused, physics.world.seed) == (True, 7)
    assert tuple(map(float, physics.world.start.split(","))) == pytest.approx((1.0, 2.0, 28.64788975654116))


def test_run_without_rules_is_in_real_time_at_the_rate_of_the_run(tmp_path: Path) -> None:
    scenario = scenario_of(replace(STACK, lockstep=()))
    physics = node_settings(scenario, replace(RUN, physics={"rate": 2.0}), tmp_path, tmp_path).physics
    assert (physics.sync.lockstep, physics.time.rate, physics.sync.participants) == (False, 2.0, "")


def test_files_of_a_run_are_named_by_their_place(tmp_path: Path) -> None:
    run = replace(RUN, robot="robot/robot.yaml", files={"robot/robot.yaml": "name: a\n", "looks.yaml": "{}\n"})
    run = replace(run, physics={"randomise": "looks.yaml"})
    prepare_folder(run, tmp_path)
    physics = node_settings(scenario_of(), run, tmp_path, tmp_path).physics
    assert Path(physics.world.robot).read_text() == "name: a\n"
    assert Path(physics.world.randomise).read_text() == "{}\n"


def test_recorder_keeps_the_images_that_the_scenario_requests(tmp_path: Path) -> None:
    settings = node_settings(scenario_of(record=Recording(images="compressed")), RUN, tmp_path, tmp_path)
    assert settings.record.record_images == "compressed"
    assert settings.physics.sync.participants.startswith("trial; record; render; ")


def test_unknown_setting_of_physics_is_refused(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match=r"physics has 'rat', which is not a setting"):
        node_settings(scenario_of(), replace(RUN, physics={"rat": 2.0}), tmp_path, tmp_path)


def test_files_of_an_earlier_execution_are_removed(tmp_path: Path) -> None:
    (tmp_path / "bag").mkdir()
    (tmp_path / "bag" / "old.mcap").write_text("")
    (tmp_path / "stack.log").write_text("old")
    prepare_folder(RUN, tmp_path)
    assert sorted(path.name for path in tmp_path.iterdir()) == ["job"]


@pytest.mark.parametrize(
    ("stack", "text"),
    [
        (StackSpec(("no_such_program_here",)), "program 'no_such_program_here' not found"),
        (StackSpec(("./missing.sh",)), "program './missing.sh' not found"),
        (replace(STACK, folder=Path("/nonexistent")), "stack.folder is '/nonexistent'"),
        (replace(STACK, goal=GoalInterface("action", "go", "NavigateToPose")), "must be package/action/Name"),
        (replace(STACK, goal=GoalInterface("service", "go", "a_msgs/action/Go")), "must be package/srv/Name"),
        (replace(STACK, goal=GoalInterface("action", "go", "no_such_msgs/action/Go")), "package 'no_such_msgs'"),
        (
            replace(STACK, goal=GoalInterface("service", "go", "nav_msgs/srv/GetPlans", "goal")),
            "'nav_msgs/srv/GetPlans', which package nav_msgs does not have; did you mean 'GetPlan'? known: GetMap, GetPlan,",
        ),
        (
            replace(STACK, goal=GoalInterface("service", "go", "nav_msgs/srv/GetPlan", "pose")),
            "field is 'pose', must be a field of type geometry_msgs/PoseStamped of nav_msgs/srv/GetPlan, which has "
            "start (geometry_msgs/PoseStamped), goal (geometry_msgs/PoseStamped), tolerance (float)",
        ),
        (replace(STACK, lockstep=("cmd_vel sometimes",)), "cmd_vel sometimes"),
        (replace(STACK, lockstep=("",)), "participants"),
    ],
)
def test_stack_that_cannot_be_run_is_refused_in_one_line(stack: StackSpec, text: str) -> None:
    with pytest.raises((ConfigError, EnvironmentProblemError)) as caught:
        check_stack(stack)
    assert text in str(caught.value)
    assert "\n" not in str(caught.value)


def test_stack_that_can_be_run_is_accepted() -> None:
    check_stack(replace(STACK, ready=Ready(node="controller_server")))
    check_stack(replace(STACK, goal=GoalInterface("service", "go", "nav_msgs/srv/GetPlan", "goal")))


def test_two_rules_on_one_topic_need_names() -> None:
    with pytest.raises(ConfigError, match="twice"):
        participants_of(replace(STACK, lockstep=("cmd_vel every 0.05", "cmd_vel after scan")), ("trial",))


def test_environment_of_a_stack_is_inherited_with_domain_reach_and_marker() -> None:
    base = {"HOME": "/h", "ROS_LOCALHOST_ONLY": "1", "ROS_DOMAIN_ID": "9"}
    found = stack_environment(replace(STACK, environment={"SPEED": "2", "HOME": "/other"}), 42, "mark", base)
    assert found["ROS_DOMAIN_ID"] == "42"
    assert (found["HOME"], found["SPEED"], found["GIBSON_SIM_TRIAL"]) == ("/other", "2", "mark")
    assert found[PROFILE_VARIABLE].endswith("fastdds_local.xml")
    assert "ROS_LOCALHOST_ONLY" not in found


def test_flood_of_output_keeps_its_beginning_and_its_end(tmp_path: Path) -> None:
    log = StackLog(tmp_path / "stack.log", half=10)
    for number in range(10):
        log.write(f"line {number}\n".encode())
    assert log.last_line == "line 9"
    log.close()
    text = (tmp_path / "stack.log").read_bytes()
    assert text.startswith(b"line 0\nlin")
    assert text.endswith(b"line 8\nline 9\n")
    assert b"[... 46 bytes left out ...]" in text, "70 bytes, of which the first ten and the last two writes are kept"


def test_short_output_is_kept_whole(tmp_path: Path) -> None:
    log = StackLog(tmp_path / "stack.log", half=100)
    log.write(b"ready\n\n")
    log.close()
    log.write(b"late")
    assert (tmp_path / "stack.log").read_bytes() == b"ready\n\n"
    assert log.last_line == "ready"


def test_end_of_a_stack_has_its_cause_and_last_line() -> None:
    assert stack_died(-11, "loading").detail == "the stack was killed by SIGSEGV; its last line: loading"
    assert stack_died(3, "").detail == "the stack ended with code 3; it printed nothing"
    assert exit_text(-99) == "was killed by signal 99"


def test_end_of_a_node_has_its_last_error() -> None:
    output = "INFO scene flat\nERROR first\nerror: no such scene\nINFO bye\n"
    assert last_error(output) == "no such scene"
    assert node_died("physics", 1, output).detail == "the physics node ended with code 1: no such scene"
    clock = "error: another node publishes /clock in this ROS domain: stop that simulation\n"
    assert node_died("physics", 1, clock).detail.startswith("the stack publishes /clock, which only the simulation may do")


def test_stack_is_not_to_blame_if_time_waited_for_a_node_of_ours() -> None:
    report = TrialReport("stack silent", "no message on cmd_vel")
    late = "WARN lockstep: waiting for {} to finish the tick at 3.000 s (the node hangs or is slow); 4.0 s so far\n"
    assert reported_ending(report, late.format("'record'")).end == "simulation failed"
    ending = reported_ending(report, late.format("'record'") + late.format("'cmd_vel'"))
    assert ending.end == "stack silent"
    assert "'cmd_vel' to finish the tick at 3.000 s" in ending.detail
    assert reported_ending(report, "").detail == "no message on cmd_vel"
    assert reported_ending(TrialReport("reached", "there"), late).end == "reached"


def test_domain_with_a_simulation_is_passed_over() -> None:
    free, lock = acquire_free_domain(range(102, 110), start=0)
    try:
        other, second = acquire_free_domain(range(102, 110), start=free - 102)
        second.close()
        assert other != free
        with pytest.raises(AlreadyRunningError, match=f"each of the ROS domains {free} to {free}"):
            acquire_free_domain([free])
    finally:
        lock.close()
    DomainLock(free).close()
