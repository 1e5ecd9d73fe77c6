"""Verdicts, measures and digest of made-up runs, with numbers computed by hand. The usual run drives 5 m in 10 s and stands for 2 s."""

from __future__ import annotations

import math
import shutil
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import pytest

from gibson_sim.bags.reader import BagReader
from gibson_sim.trials.judging import judge
from gibson_sim.trials.records import RunResult, Verdict
from gibson_sim.trials.scenario.spec import RateLimit, Reached, Region
from support.run_bags import DRIVES_THERE, Run, along, commands, messages, ns, planned, scenario, until

ROOM = Region("room", ((0.0, 0.0), (10.0, 0.0), (10.0, 4.0), (0.0, 4.0)))
LEFT = Region("left", ((0.0, 0.0), (3.0, 0.0), (3.0, 4.0), (0.0, 4.0)))
RIGHT = Region("right", ((3.0, 0.0), (10.0, 0.0), (10.0, 4.0), (3.0, 4.0)))


def judged(folder: Path, run: Run | None = None, end: Any = "reached", *, spec: Any = None, **verdicts: Any) -> RunResult:
    run = run or Run()
    return judge(scenario(folder, **verdicts), spec or planned(), run.outcome(end), run.write(folder))


def verdict(result: RunResult, name: str) -> Verdict:
    return next(verdict for verdict in result.verdicts if verdict.name == name)


def test_good_run_passes_with_its_measures(tmp_path: Path) -> None:
    """The nearest wall, at y = 0.05, is 1.95 m from the track; at the start the wall at x = 0.05 is 0.95 m away, less the radius.

    Of 119 changes in 11.9 s, one is from 0.5 m/s to 0: 2.5 m^2/s^3, which is sqrt(2.5 / 11.9) m/s^2.
    """
    result = judged(tmp_path)
    assert result.passed
    assert result.cause is None
    assert [v.name for v in result.verdicts] == ["run", "reached", "collisions", "alive"]
    expected = {
        "time": 12.0, "goal_distance": 0.0, "yaw_error": 0.0, "length": 5.0, "path_ratio": 1.0, "mean_speed": 5.0 / 12.0,
        "clearance": 0.75, "collisions": 0.0, "rms_acceleration": math.sqrt(2.5 / 11.9),
    }  # fmt: skip
    assert result.measures == pytest.approx(expected, abs=1e-6)


def test_time_ends_when_the_goal_was_reached_and_the_last_motion_counts_no_more(tmp_path: Path) -> None:
    """It is decided after 10 s; meanwhile /odom has 101 messages with both ends, which are 10.1 a second."""
    run = Run()
    limits = scenario(time=10.0, rates=(RateLimit("odom", 10.0),))
    result = judge(limits, planned(), run.outcome(decided_ns=ns(10.0)), run.write(tmp_path))
    assert verdict(result, "time") == Verdict("time", True, "the run took 10.00 s, at most 10 s", 10.0, 10.0)
    assert verdict(result, "rates.odom").value == pytest.approx(10.1)
    assert result.measures["mean_speed"] == pytest.approx(0.5)


def test_localisation_error_is_measured(tmp_path: Path) -> None:
    """0.1 m beside the truth from 3 s on: 91 of 121 poses."""
    result = judged(tmp_path, Run(corrections=[(-1.0, 1.0, 2.0, 0.0), (3.0, 1.0, 2.1, 0.0)]))
    assert result.measures["localisation_error"] == pytest.approx(0.1 * 91 / 121)
    assert result.measures["localisation_error_max"] == pytest.approx(0.1)
    assert result.measures["localisation_yaw_error"] == pytest.approx(0.0)


def test_goal_missed_by_position(tmp_path: Path) -> None:
    result = judged(tmp_path, Run(truth=until(9.0, 5.5)))
    text = "the robot ended 0.50 m from the goal, at most 0.3 m"
    assert verdict(result, "reached") == Verdict("reached", False, text, pytest.approx(0.5), 0.3)


def test_goal_missed_by_yaw(tmp_path: Path) -> None:
    """30 degrees too far, seen from the goal's yaw of 170 degrees: -160."""
    run = Run(truth=lambda t: (*along(t)[:2], math.radians(-160.0)))
    spec = planned(goal=(6.0, 2.0, math.radians(170.0)))
    result = judged(tmp_path, run, spec=spec, reached=Reached(0.3, 20.0))
    assert (
        verdict(result, "reached").text
        == "the robot ended 0.00 m from the goal, at most 0.3 m, with a heading error of 30 deg, at most 20 deg"
    )
    assert not verdict(result, "reached").passed
    assert result.measures["yaw_error"] == pytest.approx(math.radians(30.0))


@pytest.mark.parametrize("end", ["time limit", "gave up"])
def test_goal_that_the_stack_did_not_report_is_not_reached(tmp_path: Path, end: str) -> None:
    result = judged(tmp_path, end=end)
    assert not verdict(result, "reached").passed
    assert verdict(result, "reached").text.endswith(f"; the run ended differently: {end}")
    assert verdict(result, "run").passed


def test_collisions_are_named(tmp_path: Path) -> None:
    touches = [(-0.5, -0.4, "early"), (1.0, 1.1, "wall_1"), (2.0, 3.0, "chair"), (4.0, 4.1, "wall_1"), (5.0, 5.1, "desk")]
    result = judged(tmp_path, Run(touches=touches), collisions=3)
    text = "4 collisions, at most 3: wall_1 at 1.0 s, chair at 2.0 s, wall_1 at 4.0 s and 1 more"
    assert verdict(result, "collisions") == Verdict("collisions", False, text, 4.0, 3.0)


def test_as_many_collisions_as_are_allowed_pass(tmp_path: Path) -> None:
    assert judged(tmp_path, Run(touches=[(1.0, 1.1, "wall")]), collisions=1).passed


def test_clearance(tmp_path: Path) -> None:
    """Down to y = 0.3 at 5 s: 0.25 m from the wall's edge at 0.05, less the radius of 0.2."""
    dips = Run(truth=lambda t: (along(t)[0], 0.3 if 4.9 < t < 5.1 else 2.0, 0.0))
    result = judged(tmp_path, dips, clearance=0.06)
    found = verdict(result, "clearance")
    assert (found.passed, found.limit) == (False, 0.06)
    assert found.value == pytest.approx(0.05, abs=1e-6)
    assert found.text == "the robot came within 0.05 m of an obstacle of the map, at (3.50, 0.30) after 5.0 s, at least 0.06 m"


def test_clearance_is_to_the_nearest_wall(tmp_path: Path) -> None:
    """Beside the lower left corner of the room: 0.30 m from the left wall, 0.40 m from the lower one."""
    run = Run(truth=lambda t: (0.35, 0.45, 0.0))
    assert judged(tmp_path, run).measures["clearance"] == pytest.approx(0.30 - 0.2, abs=1e-6)


def test_regions_to_stay_in_count_together(tmp_path: Path) -> None:
    assert verdict(judged(tmp_path, stay_within=(LEFT, RIGHT)), "stay_within").passed


def test_leaving_a_region(tmp_path: Path) -> None:
    """After 4 s it is at x = 3, where the right half begins."""
    found = verdict(judged(tmp_path, stay_within=(LEFT,)), "stay_within")
    assert found == Verdict("stay_within", False, "the robot left left at (3.00, 2.00) after 4.0 s", pytest.approx(4.0))


def test_entering_a_region(tmp_path: Path) -> None:
    result = judged(tmp_path, stay_out_of=(RIGHT, Region("far", ((9.0, 0.0), (9.5, 0.0), (9.5, 4.0)))))
    assert verdict(result, "stay_out_of.right").text == "the robot entered right at (3.00, 2.00) after 4.0 s"
    assert verdict(result, "stay_out_of.far").passed


def test_path_ratio(tmp_path: Path) -> None:
    found = verdict(judged(tmp_path, spec=planned(shortest=4.0), path_ratio=1.2), "path_ratio")
    assert (found.passed, found.value) == (False, pytest.approx(1.25))
    assert found.text == "5.00 m driven, shortest path 4.00 m: ratio 1.25, more than 1.2"


def test_trembling_is_no_path(tmp_path: Path) -> None:
    """Four millimetres to and fro, ten times a second, on top of the 5 m."""
    run = Run(truth=lambda t: (along(t)[0] + 0.004 * (round(t * 10) % 2), 2.0, 0.0))
    assert judged(tmp_path, run).measures["length"] == pytest.approx(5.0, abs=0.01)


def test_acceleration_of_commands(tmp_path: Path) -> None:
    """0 to 0.5 and back each 0.1 s: 5 m/s^2, of which not-a-number does not count."""
    wild = [(t, 0.5 * (k % 2), 0.0) for k, (t, _, _) in enumerate(DRIVES_THERE)]
    found = verdict(judged(tmp_path, Run(commands=wild), max_acceleration=1.0), "max_acceleration")
    assert (found.passed, found.value) == (False, pytest.approx(5.0))


def test_rates(tmp_path: Path) -> None:
    """121 messages in 12 s."""
    result = judged(tmp_path, rates=(RateLimit("odom", 10.0), RateLimit("/ground_truth/odom", 20.0)))
    assert verdict(result, "rates.odom").passed
    found = verdict(result, "rates.ground_truth/odom")
    assert (found.passed, found.value) == (False, pytest.approx(121 / 12))


@pytest.mark.parametrize(
    ("end", "code", "passed"),
    [
        ("reached", None, True),
        ("reached", 0, True),
        ("gave up", 0, True),
        ("time limit", 0, False),
        ("reached", 1, False),
        ("stack died", -9, False),
    ],
)
def test_alive(tmp_path: Path, end: Any, code: int | None, passed: bool) -> None:
    run = Run(duration=1.0)
    result = judge(scenario(), planned(), run.outcome(end, exit_code=code), run.write(tmp_path))
    assert verdict(result, "alive").passed == passed


@pytest.mark.parametrize(
    ("topic", "name", "limit"),
    [
        ("/ground_truth/odom", "reached", {}), ("/ground_truth/odom", "clearance", {"clearance": 0.1}),
        ("/ground_truth/odom", "path_ratio", {"path_ratio": 2.0}), ("/ground_truth/odom", "stay_within", {"stay_within": (ROOM,)}),
        ("/ground_truth/odom", "stay_out_of.room", {"stay_out_of": (ROOM,)}), ("/collisions", "collisions", {}),
        ("/map", "clearance", {"clearance": 0.1}), ("/cmd_vel", "max_acceleration", {"max_acceleration": 9.0}),
        ("/plan", "rates.plan", {"rates": (RateLimit("plan", 0.1),)}),
    ],
)  # fmt: skip
def test_missing_topic_fails_its_verdict(tmp_path: Path, topic: str, name: str, limit: dict[str, Any]) -> None:
    found = verdict(judged(tmp_path, Run(without=[topic]), **limit), name)
    assert not found.passed
    assert found.text.startswith("cannot be judged: ")
    assert found.text.endswith("missing from the bag")


def test_recording_that_ends_early_is_a_failure(tmp_path: Path) -> None:
    run = Run(duration=8.0, commands=commands((0.0, 8.0, 0.5)))
    result = judge(scenario(), planned(), run.outcome(end_ns=ns(12.0)), run.write(tmp_path))
    assert verdict(result, "run").text == "the bag ends 4.0 s before the run does: the rest of the run is unknown"
    assert result.cause is not None
    assert result.cause.kind == "unknown"


def test_messages_after_the_end_do_not_count(tmp_path: Path) -> None:
    """The same bag to its end, and to 6 s: there it has driven 3 m and had one of two collisions."""
    run = Run(touches=[(2.0, 2.1, "a"), (8.0, 8.1, "b")])
    folder = run.write(tmp_path)
    result = judge(scenario(), planned(), run.outcome("time limit", end_ns=ns(6.0)), folder)
    assert result.measures["length"] == pytest.approx(3.0)
    assert result.measures["collisions"] == 1.0
    assert result.measures["goal_distance"] == pytest.approx(2.0)


class TestBadBags:
    """Runs whose bag tells nothing."""

    def assert_failed(self, result: RunResult, words: str) -> None:
        assert not result.passed
        assert words in verdict(result, "run").text
        assert verdict(result, "reached").text == "not judged: the bag cannot be read"
        assert (result.digest, result.measures) == ("", {})
        assert result.cause is not None
        assert result.cause.kind == "unknown"
        assert words in result.cause.text

    def test_missing(self, tmp_path: Path) -> None:
        self.assert_failed(judge(scenario(), planned(), Run().outcome(), tmp_path), str(tmp_path / "bag"))

    def test_without_messages(self, tmp_path: Path) -> None:
        with messages().writer(tmp_path / "bag") as bag:
            bag.add_topic("/odom", "nav_msgs/msg/Odometry")
        self.assert_failed(judge(scenario(), planned(), Run().outcome(), tmp_path), "no messages")

    def test_cut_off(self, tmp_path: Path) -> None:
        folder = Run(duration=2.0).write(tmp_path)
        (file,) = (folder / "bag").glob("*.mcap")
        file.write_bytes(file.read_bytes()[: file.stat().st_size // 2])
        self.assert_failed(judge(scenario(), planned(), Run().outcome(), folder), "gibson-sim bag repair")

    def test_without_metadata(self, tmp_path: Path) -> None:
        folder = Run(duration=2.0).write(tmp_path)
        (folder / "bag" / "metadata.yaml").unlink()
        self.assert_failed(judge(scenario(), planned(), Run().outcome(), folder), "bag")

    def test_message_of_another_type(self, tmp_path: Path) -> None:
        """Bytes of a text where odometry is announced."""
        run = Run(duration=2.0, extra=[(1.0, "/odom", messages()("std_msgs/String", data="?"))])
        self.assert_failed(judge(scenario(), planned(), run.outcome(), run.write(tmp_path)), "cannot be decoded")

    def test_invalid_values_are_left_out(self, tmp_path: Path) -> None:
        """A true position that is not a number, and a map without cells: what is left is judged."""
        run = Run(truth=lambda t: (math.nan if t > 11.95 else along(t)[0], 2.0, 0.0))
        result = judged(tmp_path, run)
        assert result.measures["goal_distance"] == pytest.approx(0.0)

    def test_run_without_a_goal_is_judged_by_its_outcome(self, tmp_path: Path) -> None:
        outcome = Run().outcome("never ready", detail="no message on /pose within 60 s", goal_ns=-1, end_ns=-1)
        result = judge(scenario(clearance=0.1), planned(), outcome, tmp_path)
        assert verdict(result, "run").text == "never ready: no message on /pose within 60 s"
        assert verdict(result, "clearance").text == "not judged: the goal was not sent"
        assert verdict(result, "alive").passed
        assert result.cause is not None
        assert (result.cause.kind, result.cause.text) == ("never ready", "never ready: no message on /pose within 60 s")
        assert result.cause.time is None


class TestDigest:
    """The digest of a run's ticks."""

    def digest(self, folder: Path, rows: list[tuple[float, Any]], **outcome: Any) -> str:
        """Returns the digest of a bag with these messages of tick_digest; the folder is used again."""
        run = Run(duration=2.0, without=["/tick_digest"])
        folder = run.write(folder)
        shutil.rmtree(folder / "bag")
        with messages().writer(folder / "bag") as bag:
            bag.add_topic("/tick_digest", "gibson_msgs/msg/TickDigest")
            for t, message in rows:
                bag.write("/tick_digest", messages().cdr(message), ns(t), ns(t))
        result = judge(scenario(), planned(), run.outcome(**outcome), folder)
        shutil.rmtree(folder / "bag")
        return result.digest

    def rows(self, epoch: int = 0, **changes: int) -> list[tuple[float, Any]]:
        return [(0.1 * k, messages().digest(0.1 * k, k, {"/scene_state": 5 + k, "/odom": 7, **changes}, epoch)) for k in range(4)]

    def test_equal_runs_have_equal_digests(self, tmp_path: Path) -> None:
        first = self.digest(tmp_path, self.rows())
        assert len(first) == 32
        assert self.digest(tmp_path, self.rows()) == first

    def test_order_of_topics_and_images_do_not_count(self, tmp_path: Path) -> None:
        """Images, and ticks of one stamp that were logged in another order."""
        mixed = [(0.1 * k, messages().digest(0.1 * k, k, {"/odom": 7, "/scene_state": 5 + k})) for k in range(4)]
        image = (0.2, messages().digest(0.2, 2, {"/camera/image_raw": 99}))
        swapped = [(0.3, mixed[k][1]) for k in (3, 0, 2, 1)]
        assert self.digest(tmp_path, [image, *swapped]) == self.digest(tmp_path, self.rows())

    def test_every_tick_and_topic_counts(self, tmp_path: Path) -> None:
        others = [self.rows(), self.rows()[:-1], self.rows()[1:], self.rows(**{"/odom": 8}), self.rows(**{"/scan": 7})]
        assert len({self.digest(tmp_path, rows) for rows in others}) == len(others)

    def test_run_after_a_reset_is_the_same_run(self, tmp_path: Path) -> None:
        assert self.digest(tmp_path, self.rows(epoch=3)) == self.digest(tmp_path, self.rows())

    def test_ticks_after_the_end_do_not_count(self, tmp_path: Path) -> None:
        assert self.digest(tmp_path, self.rows(), end_ns=ns(0.1)) == self.digest(tmp_path, self.rows()[:2])

    def test_bag_without_digests_has_none(self, tmp_path: Path) -> None:
        assert judged(tmp_path, Run(duration=1.0, without=["/tick_digest"])).digest == ""


class TestPredicates:
    """Functions of the user."""

    def call(self, folder: Path, source: str, predicate: str = "checks:ok") -> Verdict:
        (folder / "checks.py").write_text(source)
        result = judged(folder, Run(duration=0.5), predicates=(predicate,))
        return verdict(result, f"predicates.{predicate}")

    def test_predicate_gets_the_bag_and_the_run(self, tmp_path: Path) -> None:
        source = "def ok(bag, run):\n    return (bag / 'metadata.yaml').is_file() and run.shortest == 5.0\n"
        assert self.call(tmp_path, source) == Verdict("predicates.checks:ok", True, "checks:ok returned True")

    def test_returned_text_is_the_reason_of_the_failure(self, tmp_path: Path) -> None:
        assert self.call(tmp_path, "def ok(bag, run):\n    return 'the cup\\nfell'\n") == Verdict(
            "predicates.checks:ok", False, "the cup fell"
        )

    @pytest.mark.parametrize("answer", ["False", "None", "3"])
    def test_other_return_values_fail(self, tmp_path: Path, answer: str) -> None:
        found = self.call(tmp_path, f"def ok(bag, run):\n    return {answer}\n")
        assert (found.passed, answer in found.text) == (False, True)

    def test_exception_is_named_with_its_line(self, tmp_path: Path) -> None:
        found = self.call(tmp_path, "import math\ndef ok(bag, run):\n    return math.sqrt(-1.0)\n")
        assert found.text.startswith("checks:ok raised ValueError: ")
        assert found.text.endswith(f"({tmp_path / 'checks.py'}, line 3)")

    def test_syntax_error_is_named_with_its_line(self, tmp_path: Path) -> None:
        assert self.call(tmp_path, "\ndef ok(:\n").text.endswith(f"({tmp_path / 'checks.py'}, line 2)")

    def test_exit_is_a_failure(self, tmp_path: Path) -> None:
        assert "raised SystemExit: 3" in self.call(tmp_path, "import sys\ndef ok(bag, run):\n    sys.exit(3)\n").text

    def test_interrupt_passes_through(self, tmp_path: Path) -> None:
        with pytest.raises(KeyboardInterrupt):
            self.call(tmp_path, "def ok(bag, run):\n    raise KeyboardInterrupt\n")

    @pytest.mark.parametrize(
        ("predicate", "words"),
        [("checks:other", "no function other"), ("absent:ok", "no module absent"), ("checks", "must be module:function")],
    )
    def test_missing_predicate_is_named(self, tmp_path: Path, predicate: str, words: str) -> None:
        assert words in self.call(tmp_path, "def ok(bag, run):\n    return True\n", predicate).text

    def test_missing_import_inside_is_an_exception(self, tmp_path: Path) -> None:
        found = self.call(tmp_path, "import absent_library\n")
        assert "raised ModuleNotFoundError: No module named 'absent_library'" in found.text

    def test_modules_of_one_folder_import_each_other(self, tmp_path: Path) -> None:
        (tmp_path / "judging_helper_of_this_test.py").write_text("ANSWER = True\n")
        source = "from judging_helper_of_this_test import ANSWER\ndef ok(bag, run):\n    return ANSWER\n"
        assert self.call(tmp_path, source).passed

    def test_modules_of_one_name_in_two_folders_are_two(self, tmp_path: Path) -> None:
        for name, answer in (("a", True), ("b", False)):
            (tmp_path / name).mkdir()
            assert self.call(tmp_path / name, f"def ok(bag, run):\n    return {answer}\n").passed == answer


def without_ticks(run: Run, folder: Path, *gaps: tuple[float, float]) -> Path:
    """Writes the bag of a run whose recorder was paused in these intervals, s since the goal, ends excluded."""
    full, bag = run.write(folder / "full"), folder / "bag"
    make = messages()
    with BagReader(full / "bag") as read, make.writer(bag) as written:
        for name, info in read.topics().items():
            written.add_topic(name, info.type_name)
        for topic, at, data in read.raw_messages(list(read.topics())):
            if not any(ns(begin) < at < ns(end) for begin, end in gaps):
                written.write(topic, data, at, at)
    return folder


def test_recording_that_was_paused_in_mid_run_is_a_failure_and_its_cause(tmp_path: Path) -> None:
    """Ticks are 0.1 s apart: between those at 2 s and at 9.1 s there are 7.0 s without any."""
    run = Run(touches=((4.0, 5.0, "box"),))
    folder = without_ticks(run, tmp_path, (2.0, 9.1))
    result = judge(scenario(), planned(), run.outcome(callers={"pause": ["/cheat"]}), folder)
    found = verdict(result, "run")
    assert not found.passed
    assert found.text == (
        "the bag lacks 7.0 s from 2.0 s after the goal: recording was paused, by node '/cheat', or messages were lost; "
        "what happened then is unknown"
    )
    assert result.cause is not None
    assert result.cause.time == 2.0
    assert not verdict(result, "collisions").passed, "the count has risen meanwhile"


@pytest.mark.parametrize(
    ("gaps", "text"),
    [
        (((-0.95, 3.1),), "the bag lacks 3.0 s from 0.0 s after the goal: "),
        (((9.0, 11.55),), "the bag lacks 2.5 s from 9.0 s after the goal: "),
        ([(k, k + 0.35) for k in range(1, 6)], "the bag lacks 0.3 s from 1.0 s after the goal, and 1.2 s in other gaps: "),
        ([(1.0, 1.35), (2.0, 4.1), (5.0, 6.1)], "the bag lacks 2.0 s from 2.0 s after the goal, and 1.3 s in other gaps: "),
    ],
)
def test_gaps_in_the_recording_are_found_wherever_they_are(
    tmp_path: Path, gaps: Sequence[tuple[float, float]], text: str
) -> None:  # fmt: skip
    run = Run()
    found = verdict(judge(scenario(), planned(), run.outcome(), without_ticks(run, tmp_path, *gaps)), "run")
    assert not found.passed
    assert found.text.startswith(text)


def test_a_few_lost_ticks_are_no_gap(tmp_path: Path) -> None:
    run = Run()
    folder = without_ticks(run, tmp_path, (1.0, 1.15), (3.0, 3.25), (6.0, 6.15))
    assert verdict(judge(scenario(), planned(), run.outcome(), folder), "run").passed
