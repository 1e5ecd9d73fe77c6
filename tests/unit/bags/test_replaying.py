"""The run that a replay reads from a bag, and the schedule of its inputs."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml

from gibson_sim.bags.replaying import InputSchedule, RecordedInput, in_order, read_facts, read_run, with_starts
from gibson_sim.bags.writer import BagWriter
from gibson_sim.cli.main import main
from gibson_sim.errors import RecordError

NS = 1_000_000_000
TWIST, STAMPED = "geometry_msgs/msg/Twist", "geometry_msgs/msg/TwistStamped"
SET_STATE = "simulation_interfaces/srv/SetSimulationState"
STOP, PLAY = b"\x00\x01\x00\x00\x00", b"\x00\x01\x00\x00\x01"


def _input(epoch: int, step: int, name: str = "/cmd_vel", data: bytes = b"") -> RecordedInput:
    return RecordedInput(epoch, step, name, SET_STATE if name.endswith("state") else TWIST, data)


class Bags:
    """Writes the topics of a run."""

    def __init__(self, messages: Any, folder: Path) -> None:
        self._messages, self._types, self.folder = messages, messages.types, folder
        folder.parent.mkdir(exist_ok=True)
        self._bag = BagWriter(folder, reserve_bytes=0)
        self._known: set[str] = set()

    def __enter__(self) -> Bags:
        return self

    def __exit__(self, *_: object) -> None:
        self._bag.close()

    def write(self, topic: str, type_name: str, data: bytes, ns: int) -> None:
        if topic not in self._known:
            self._known.add(topic)
            self._bag.add_topic(topic, type_name)
        self._bag.write(topic, data, ns, ns)

    def write_message(self, type_name: str, topic: str, ns: int, **fields: Any) -> None:
        message = self._types[type_name](header=self._messages.header(ns, ""), **fields)
        self.write(topic, type_name, self._messages.cdr(message), ns)

    def input(self, item: RecordedInput, ns: int) -> None:
        self.write_message(
            "gibson_msgs/msg/Input", "/inputs", ns,
            epoch=item.epoch, step=item.step, name=item.name, type=item.type_name, data=np.frombuffer(item.data, np.uint8),
        )  # fmt: skip

    def digest(self, epoch: int, step: int, ns: int, **digests: int) -> None:
        numbers = np.array(list(digests.values()), dtype=np.uint64)
        topics = [f"/{name}" for name in digests]
        self.write_message(
            "gibson_msgs/msg/TickDigest", "/tick_digest", ns, epoch=epoch, step=step, topics=topics, digests=numbers
        )

    def info(self, kind: str, settings: dict[str, Any]) -> None:
        self.write_message(
            "gibson_msgs/msg/RunInfo", "/run_info", 0,
            kind=kind, node=f"/{kind}", version="0.1.0", settings=yaml.safe_dump(settings), platform="{numpy: '2'}",
        )  # fmt: skip

    def twist(self, topic: str, ns: int, linear: float) -> None:
        self.write(topic, TWIST, self._messages.cdr(self._twist(linear)), ns)

    def stamped(self, topic: str, ns: int, linear: float) -> None:
        self.write_message(STAMPED, topic, ns, twist=self._twist(linear))

    def _twist(self, linear: float) -> Any:
        vector = self._types["geometry_msgs/msg/Vector3"]
        return self._types[TWIST](linear=vector(x=linear, y=0.0, z=0.0), angular=vector(x=0.0, y=0.0, z=0.0))


def test_settings_journal_and_digests_of_a_run_are_read(messages: Any, tmp_path: Path) -> None:
    with Bags(messages, tmp_path / "bag") as bag:
        bag.info("physics", {"scene": "flat", "seed": 3})
        bag.info("render", {"cameras": "left"})
        bag.info("render", {"cameras": "right"})
        for step in (4, 8):
            bag.digest(0, step, step, scene_state=step, odom=2**64 - 1)
        bag.input(_input(0, 5, data=b"\x01\x02"), 8)
    run = read_run(bag.folder)
    assert run.settings == {"physics": {"scene": "flat", "seed": 3}, "render": {"cameras": "left,right"}}
    assert run.surroundings["physics"] == {"numpy": "2", "gibson_sim": "0.1.0"}
    assert run.journal == (_input(0, 5, data=b"\x01\x02"),)
    assert run.digests[0, 8][0].values() == {"/scene_state": 8, "/odom": 2**64 - 1}
    assert run.end(240, 60) == (0, 8)
    facts = read_facts(bag.folder)
    assert (facts.has_journal, facts.has_digests, facts.has_commands) == (True, True, False)


def test_a_comparison_of_two_bags_compares_their_digests(
    messages: Any, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    for name, value in (("a", 1), ("b", 1), ("c", 2)):
        with Bags(messages, tmp_path / name) as bag:
            bag.digest(0, 4, NS, scene_state=5)
            bag.digest(0, 8, 2 * NS, scene_state=value)
    for other, line in (
        ("b", "2 ticks, equal to the bit"),
        ("c", "2 ticks, first difference: epoch 0, step 8, 2.0000 s, on /scene_state"),
    ):
        with pytest.raises(SystemExit) as end:
            main(["compare", str(tmp_path / "a"), str(tmp_path / other)])
        assert end.value.code == 0
        assert capsys.readouterr().out.endswith(f"note: digests: {line}\n")


def test_recording_continued_in_other_bags_after_resets_is_one_run(messages: Any, tmp_path: Path) -> None:
    reset = _input(0, 9, "/reset_simulation")
    with Bags(messages, tmp_path / "bag") as bag:
        bag.digest(0, 8, 8, scene_state=1)
        bag.input(reset, 9)
    with Bags(messages, tmp_path / "bag_epoch1") as later:
        later.input(reset, 0)  # latched, so it is received again
        later.digest(0, 8, 0, scene_state=1)
        later.digest(1, 4, 4, scene_state=1)
        later.input(_input(1, 4), 4)
    run = read_run(bag.folder)
    assert run.journal == (reset, _input(1, 4))
    assert run.end(240, 60) == (1, 4)


def test_bag_that_starts_after_a_reset_names_the_remedy(messages: Any, tmp_path: Path) -> None:
    with Bags(messages, tmp_path / "bag_epoch1") as bag:
        bag.digest(1, 4, 4, scene_state=1)
    with pytest.raises(RecordError, match="begins in epoch 1, after a reset: replay the bag that the recording began with"):
        read_run(bag.folder)


def test_commands_without_a_journal_become_inputs_at_the_steps_of_their_times(messages: Any, tmp_path: Path) -> None:
    begin = 1_700_000_000 * NS
    with Bags(messages, tmp_path / "bag") as bag:
        bag.twist("/left/cmd_vel", begin, 0.1)
        bag.twist("/cmd_vel_raw", begin + 1, 0.3)
        bag.twist("/left/cmd_vel", begin + NS // 100, 0.2)
        bag.twist("/left/cmd_vel", begin + NS, 0.0)
    run = read_run(bag.folder)
    assert run.journal is None
    assert [(item.step, item.name) for item in run.inputs(240)] == [
        (0, "/left/cmd_vel"),
        (3, "/left/cmd_vel"),
        (240, "/left/cmd_vel"),
    ]
    assert run.end(240, 60) == (0, 240)


def test_applied_commands_replace_commands_that_were_not_recorded(messages: Any, tmp_path: Path) -> None:
    with Bags(messages, tmp_path / "bag") as bag:
        bag.stamped("/left/cmd_vel_applied", 0, 0.1)
        bag.stamped("/left/cmd_vel_applied", NS, 0.2)
        bag.twist("/right/cmd_vel", NS, 0.3)
        bag.stamped("/right/cmd_vel_applied", NS, 0.3)
    assert read_facts(bag.folder).has_commands
    assert [(command.time_ns, command.name, command.type_name) for command in read_run(bag.folder).commands] == [
        (0, "/left/cmd_vel", STAMPED),
        (NS, "/left/cmd_vel", STAMPED),
        (NS, "/right/cmd_vel", TWIST),
    ]


def test_time_of_commands_starts_at_the_first_clock(messages: Any, tmp_path: Path) -> None:
    clock = messages.types["rosgraph_msgs/msg/Clock"]
    with Bags(messages, tmp_path / "bag") as bag:
        bag.twist("/cmd_vel", 1 * NS, 0.1)
        bag.write("/clock", "rosgraph_msgs/msg/Clock", messages.cdr(clock(clock=messages.time(NS))), 2 * NS)
        bag.twist("/cmd_vel", 3 * NS, 0.1)
    assert [command.time_ns for command in read_run(bag.folder).commands] == [0, NS]


def test_bag_without_digests_ends_at_its_last_state(messages: Any, tmp_path: Path) -> None:
    with Bags(messages, tmp_path / "bag") as bag:
        for step in (4, 8, 12):
            bag.write("/scene_state", "gibson_msgs/msg/SceneState", messages.scene_state(step, step), step)
        bag.input(_input(0, 4), 12)
    assert read_run(bag.folder).end(240, 60) == (0, 12)


def test_recording_that_started_in_the_middle_is_detected(messages: Any, tmp_path: Path) -> None:
    with Bags(messages, tmp_path / "bag") as bag:
        bag.digest(0, 400, 1, scene_state=1)
        bag.input(_input(0, 401), 2)
    assert read_run(bag.folder).begins_late


def test_bag_without_time_has_no_end(messages: Any, tmp_path: Path) -> None:
    with Bags(messages, tmp_path / "bag") as bag:
        bag.twist("/cmd_vel", NS, 0.1)
    with pytest.raises(RecordError, match="less than one tick"):
        read_run(bag.folder).end(240, 60)


def test_reset_is_the_last_of_its_step_whenever_it_was_written() -> None:
    reset, spawn, early = _input(0, 7, "/reset_simulation"), _input(0, 7, "/spawn_entity"), _input(0, 3)
    assert in_order([reset, spawn, _input(1, 0), early]) == [early, spawn, reset, _input(1, 0)]


def test_a_stopped_world_is_started_again_and_redundant_starts_are_dropped() -> None:
    stop, play = _input(0, 9, "/sim/set_simulation_state", STOP), _input(0, 4, "/sim/set_simulation_state", PLAY)
    found = with_starts([play, stop, _input(1, 3)])
    assert found == (stop, _input(1, 0, "/sim/set_simulation_state", PLAY), _input(1, 3))


def test_a_loaded_world_is_started() -> None:
    load = RecordedInput(0, 9, "/sim/load_world", "simulation_interfaces/srv/LoadWorld", b"")
    assert with_starts([load]) == (load, _input(1, 0, "/sim/set_simulation_state", PLAY))


def test_a_run_without_inputs_has_nothing_due() -> None:
    assert not InputSchedule([]).pop_due(3, 7, 8)


def test_inputs_are_due_once_and_some_steps_ahead() -> None:
    inputs = [_input(0, step) for step in (0, 7, 8, 20)]
    schedule = InputSchedule(inputs)
    assert schedule.pop_due(0, 0, 8) == inputs[:2]
    assert schedule.pop_due(0, 4, 8) == inputs[2:3]
    assert schedule.pop_due(0, 4, 8) == []
    assert schedule.left == 1


def test_inputs_after_a_reset_count_from_it() -> None:
    inputs = [_input(0, 10, "/reset_simulation"), _input(1, 0), _input(1, 3), _input(1, 12)]
    schedule = InputSchedule(inputs)
    assert schedule.pop_due(0, 4, 8) == inputs[:2], "the reset is 6 steps away, and step 0 behind it as well"
    assert schedule.pop_due(0, 8, 8) == inputs[2:3], "3 steps behind the reset are 5 steps away"
    assert schedule.pop_due(1, 4, 8) == []
    assert schedule.pop_due(1, 8, 8) == inputs[3:]
