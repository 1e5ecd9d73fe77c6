"""Units of work on worker processes of this machine."""

from __future__ import annotations

import json
import os
import select
import signal
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

from gibson_sim.errors import ConfigError, WriteError
from gibson_sim.jobs import units as units_module
from gibson_sim.jobs.local import LocalWorkers, core_shares
from gibson_sim.jobs.units import Unit, UnitResult, run_units
from support.processes import is_running, wait_for_end

TESTS = Path(__file__).resolve().parents[2]
DRIVER = """
import json, sys
from pathlib import Path
from gibson_sim.interrupts import Interruptible, die
from gibson_sim.jobs.local import LocalWorkers
from gibson_sim.jobs.units import Unit, run_units
pipe, output, deaf = sys.argv[1], Path(sys.argv[2]), sys.argv[3] == "deaf"
units = [Unit(f"u{k}", "support.work:wait", {"pipe": pipe, "deaf": deaf}) for k in range(3)]
try:
    with Interruptible():
        workers = LocalWorkers(2, on_interrupt=lambda running: print(json.dumps(["ending", running, ""]), flush=True))
        run_units(units, workers, output=output, on_result=lambda r: print(json.dumps([r.id, r.value, r.error]), flush=True))
except KeyboardInterrupt:
    die()
"""
"""A program with two workers and three units that wait."""


@pytest.fixture(autouse=True)
def functions_can_be_imported(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("PYTHONPATH", os.pathsep.join([str(TESTS), os.environ.get("PYTHONPATH", "")]).rstrip(os.pathsep))


def work(name: str, output: Path, *, function: str = "", workers: int = 1, **arguments: Any) -> UnitResult:
    """Runs one unit, whose function has its name."""
    (result,) = run_units([Unit(name, f"support.work:{function or name}", arguments)], LocalWorkers(workers), output=output)
    return result


class Waiting:
    """``DRIVER``, once two of its units wait."""

    def __init__(self, tmp_path: Path, how: str = "") -> None:
        pipe = tmp_path / "pipe"
        os.mkfifo(pipe)
        command = [sys.executable, "-c", DRIVER, str(pipe), str(tmp_path / "out"), how]
        self.process = subprocess.Popen(command, stdout=subprocess.PIPE, text=True, env={**os.environ, "TMPDIR": str(tmp_path)})
        reader = os.open(pipe, os.O_RDWR)  # a writer of our own: no end of the file between two units
        text = ""
        while text.count("\n") < 2:
            text += os.read(reader, 1000).decode()
        os.close(reader)
        lines = text.splitlines()
        self.started = [int(pid) for line in lines for pid in line.split()[:2]]
        """The workers and their children."""
        assert all(int(line.split()[2]) == self.process.pid for line in lines)
        assert all(is_running(pid) for pid in self.started)

    def results(self) -> dict[str, tuple[Any, str]]:
        output, _ = self.process.communicate()
        return {name: (value, error) for name, value, error in map(json.loads, output.splitlines())}


@pytest.mark.parametrize("workers", [1, 3])
def test_every_unit_leaves_its_value_and_its_files(tmp_path: Path, workers: int) -> None:
    seen: list[str] = []
    told: list[tuple[str, str]] = []
    units = [Unit(f"u{k}", "support.work:square", {"x": k}) for k in range(5)]
    results = run_units(
        units,
        LocalWorkers(workers),
        output=tmp_path,
        on_result=lambda r: seen.append(r.id),
        on_progress=lambda *t: told.append(t),
    )
    assert [(r.id, r.value, r.error, r.attempts, r.log) for r in results] == [
        (f"u{k}", {"square": k * k}, "", 1, None) for k in range(5)
    ]
    assert [(tmp_path / f"u{k}" / "square.txt").read_text() for k in range(5)] == ["0", "1", "4", "9", "16"]
    assert sorted(seen) == [f"u{k}" for k in range(5)]
    assert sorted(told) == [(f"u{k}", f"{k} is done") for k in range(5)]


def test_results_come_as_they_are_ready_and_are_returned_in_the_order_of_the_units(tmp_path: Path) -> None:
    pipe = tmp_path / "pipe"
    os.mkfifo(pipe)
    seen: list[str] = []

    def on_result(result: UnitResult) -> None:
        seen.append(result.id)
        if result.id == "quick":
            pipe.write_text("the quick one has come")

    units = [Unit("slow", "support.work:after", {"pipe": str(pipe)}), Unit("quick", "support.work:square", {"x": 2})]
    results = run_units(units, LocalWorkers(2), output=tmp_path / "out", on_result=on_result)
    assert seen == ["quick", "slow"]
    assert [(r.id, r.value) for r in results] == [("slow", "the quick one has come"), ("quick", {"square": 4})]


def test_a_worker_keeps_its_modules_from_unit_to_unit(tmp_path: Path) -> None:
    units = [Unit(f"u{k}", "support.work:count") for k in range(3)]
    assert [r.value for r in run_units(units, LocalWorkers(1), output=tmp_path)] == [1, 2, 3]


def test_a_killed_unit_is_repeated_with_an_empty_folder_and_without_its_children(tmp_path: Path) -> None:
    told: list[str] = []
    unit = Unit("u", "support.work:die_once", {"note": str(tmp_path / "note")})
    (result,) = run_units([unit], LocalWorkers(1), output=tmp_path / "out", on_progress=lambda _, text: told.append(text))
    assert (result.value, result.error, result.attempts) == ([], "", 2)
    assert [path.name for path in (tmp_path / "out" / "u").iterdir()] == ["whole"]
    assert not is_running(int((tmp_path / "note").read_text()))
    assert told == ["its worker was killed by SIGKILL (out of memory?): repeated"]


def test_a_unit_that_always_kills_its_worker_fails_at_the_third_attempt_and_the_others_go_on(tmp_path: Path) -> None:
    units = [
        Unit("crash", "support.work:die", {"signal": signal.SIGSEGV}),
        *(Unit(f"u{k}", "support.work:square", {"x": k}) for k in range(3)),
    ]
    crash, *others = run_units(units, LocalWorkers(1), output=tmp_path)
    assert (crash.error, crash.attempts, crash.died, crash.value) == ("its worker was killed by SIGSEGV", 3, True, None)
    assert crash.log is not None
    assert crash.log.read_text().count("Segmentation fault") == 3
    assert [r.value for r in others] == [{"square": 0}, {"square": 1}, {"square": 4}]


def test_an_exception_fails_its_unit_with_the_last_line_of_the_traceback(tmp_path: Path) -> None:
    result = work("divide", tmp_path, x=0)
    assert (result.error, result.attempts) == ("ZeroDivisionError: division by zero", 1)
    assert result.log == tmp_path / "divide.log"
    assert result.log.read_text().startswith("a child speaks\nTraceback")
    assert "return 1 / arguments" in result.log.read_text()


def test_an_error_for_users_fails_its_unit_with_its_line_alone(tmp_path: Path) -> None:
    result = work("refuse", tmp_path)
    assert (result.error, result.log) == ("the value is 7, must be 8", None)


@pytest.mark.parametrize(
    ("name", "error"),
    [
        ("no_json", "support.work:no_json returned a value that is not JSON: Object of type set is not JSON serializable"),
        ("leave", "SystemExit: 3"),
        ("absent", "AttributeError: module 'support.work' has no attribute 'absent'"),
    ],
)
def test_a_function_that_gives_nothing_usable_fails_its_unit(tmp_path: Path, name: str, error: str) -> None:
    assert work(name, tmp_path).error == error


def test_large_arguments_values_outputs_and_much_progress_pass(tmp_path: Path) -> None:
    told: list[str] = []
    arguments = {"text": "ü" * 3_000_000, "lines": 5000, "files": {"a/b.bin": 20_000_000}}
    unit = Unit("u", "support.work:echo", arguments)
    (result,) = run_units([unit], LocalWorkers(1), output=tmp_path, on_progress=lambda _, text: told.append(text))
    assert result.value == arguments
    assert told == [str(k) for k in range(5000)]
    assert (tmp_path / "u" / "a" / "b.bin").stat().st_size == 20_000_000


def test_files_are_where_they_are(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "scene").mkdir()
    (tmp_path / "scene" / "scene.yaml").write_text("name: hall")
    file = str(tmp_path / "scene" / "scene.yaml")
    unit = Unit("u", "support.work:read", {"path": file}, (tmp_path / "scene",))
    other = Unit("other", "support.work:read", {"path": "/elsewhere"}, (tmp_path / "scene",))
    relative = Unit("relative", "support.work:read", {"path": "scene/../scene/scene.yaml"}, (Path("scene"),))
    found, refused, also = run_units([unit, other, relative], LocalWorkers(1), output=tmp_path / "out")
    assert found.value == also.value == ["scene.yaml", "name: hall", False]
    assert refused.error == f"'/elsewhere' is not among the unit's files: {tmp_path}/scene"


def test_stop_ends_the_running_unit_and_begins_no_other(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "pipe")
    reader = os.open(tmp_path / "pipe", os.O_RDONLY | os.O_NONBLOCK)
    units = [Unit(name, "support.work:wait", {"pipe": str(tmp_path / "pipe")}) for name in ("first", "second")]

    def begun() -> bool:
        return bool(select.select([reader], [], [], 0)[0]) and bool(os.read(reader, 100))

    first, second = run_units(units, LocalWorkers(1), output=tmp_path / "out", stop=begun)
    os.close(reader)
    assert (first.value, first.error) == ("stopped", "")
    assert (second.error, second.attempts, second.stopped) == ("stopped before it began", 0, True)


def test_ctrl_c_lets_units_end_and_leaves_nothing(tmp_path: Path) -> None:
    waiting = Waiting(tmp_path)
    waiting.process.send_signal(signal.SIGINT)
    assert waiting.results() == {
        "ending": (2, ""),
        "u2": (None, "stopped before it began"),
        "u0": ("stopped", ""),
        "u1": ("stopped", ""),
    }
    assert waiting.process.returncode == -signal.SIGINT
    assert not [pid for pid in waiting.started if is_running(pid)]
    assert sorted(path.name for path in tmp_path.iterdir()) == ["out", "pipe"]


def test_a_second_ctrl_c_ends_units_that_go_on(tmp_path: Path) -> None:
    waiting = Waiting(tmp_path, "deaf")
    waiting.process.send_signal(signal.SIGINT)
    assert waiting.process.stdout is not None
    assert json.loads(waiting.process.stdout.readline()) == ["ending", 2, ""]
    assert json.loads(waiting.process.stdout.readline()) == ["u2", None, "stopped before it began"]
    waiting.process.send_signal(signal.SIGINT)
    assert set(waiting.results().values()) == {(None, "stopped, and killed since it did not end")}
    assert not [pid for pid in waiting.started if is_running(pid)]


def test_nothing_is_left_when_the_caller_is_killed(tmp_path: Path) -> None:
    waiting = Waiting(tmp_path, "deaf")
    janitors = [int(path.parent.name) for path in Path("/proc").glob("*/cmdline") if str(tmp_path).encode() in _read(path)]
    waiting.process.kill()
    waiting.process.communicate()
    wait_for_end([*waiting.started, *(pid for pid in janitors if pid != waiting.process.pid)])
    assert not [pid for pid in waiting.started if is_running(pid)]
    assert sorted(path.name for path in tmp_path.iterdir()) == ["out", "pipe"]


def _read(path: Path) -> bytes:
    try:
        return path.read_bytes()
    except OSError:
        return b""


def test_each_worker_has_its_share_of_the_cores(tmp_path: Path) -> None:
    assert core_shares([0, 2, 4, 5, 6], 2) == [[0, 2], [4, 5, 6]]
    assert core_shares([0, 1], 3) == [[0], [1], [0]]
    (result,) = run_units([Unit("u", "support.work:cores")], LocalWorkers(1, bind=True), output=tmp_path)
    assert result.value == sorted(os.sched_getaffinity(0))


@pytest.mark.parametrize("name", ["", ".", "..", "a/b", "a b", "-a", "ä", "a\n", "a" * 101, "a.log", "a\0"])
def test_an_id_that_is_no_plain_name_of_a_folder_is_refused(name: str) -> None:
    with pytest.raises(ConfigError, match=r"the id of a unit is .*, must be at most 100 letters"):
        Unit(name, "support.work:square")


@pytest.mark.parametrize("function", ["square", "support/work:square", "support.work:", "a:b:c", ":x"])
def test_a_function_without_module_is_refused(function: str) -> None:
    with pytest.raises(ConfigError, match=r"unit u: function is .*, must be module:function"):
        Unit("u", function)


def test_arguments_that_json_lacks_are_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    with pytest.raises(ConfigError, match="unit u: its arguments are not JSON: Object of type set"):
        Unit("u", "m:f", {"x": {1}})
    monkeypatch.setattr(units_module, "MAX_ARGUMENTS_BYTES", 2_000_000)
    with pytest.raises(ConfigError, match="unit u: its arguments have 3 MB as JSON, at most 2 MB; pass files"):
        Unit("u", "m:f", {"x": "x" * 3_000_000})


def test_a_missing_file_is_refused(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match=r"unit u: file '.*/absent' does not exist"):
        Unit("u", "m:f", files=(tmp_path / "absent",))


def test_equal_ids_and_used_folders_are_refused_before_anything_starts(tmp_path: Path) -> None:
    unit = Unit("u", "support.work:square", {"x": 1})
    with pytest.raises(ConfigError, match="two units have the id 'u'"):
        run_units([unit, unit], LocalWorkers(1), output=tmp_path)
    (tmp_path / "u").mkdir()
    (tmp_path / "u" / "mine").write_text("mine")
    with pytest.raises(WriteError, match="/u exists already"):
        run_units([unit], LocalWorkers(1), output=tmp_path)
    assert (tmp_path / "u" / "mine").read_text() == "mine"


def test_no_units_give_no_results(tmp_path: Path) -> None:
    assert run_units([], LocalWorkers(2), output=tmp_path) == []


@pytest.mark.parametrize("count", [0, -1, 257])
def test_an_impossible_number_of_workers_is_refused(count: int) -> None:
    with pytest.raises(ConfigError, match=f"the number of workers is {count}, must be from 1 to 256"):
        LocalWorkers(count)
