"""Processes that a program started are found wherever they went, and ended."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import threading
from pathlib import Path

from gibson_sim.processes.descendants import VARIABLE, any_runs, descendants, end_all, end_marked, marked, siblings, with_mark
from support.processes import wait_for_end

WAITS = "import time; time.sleep(600)"


def test_a_process_that_left_its_session_is_found_by_its_mark_and_ended() -> None:
    code = f"import subprocess, sys; subprocess.Popen([sys.executable, '-c', {WAITS!r}], start_new_session=True)"
    mark = f"unit-{os.getpid()}"
    subprocess.run([sys.executable, "-c", code], env={**os.environ, "A_VARIABLE": mark}, check=True)
    assert marked(mark) == []
    assert len(marked(mark, "A_VARIABLE")) == 1
    assert end_marked(mark, "A_VARIABLE") == 1
    assert marked(mark, "A_VARIABLE") == []
    assert end_marked(mark, "A_VARIABLE") == 0


def test_a_process_that_ignores_sigterm_is_killed() -> None:
    code = "import signal; signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGTERM}); print('deaf', flush=True); signal.pause()"
    command = [sys.executable, "-c", code]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True, env=with_mark(os.environ, "of this test")) as process:
        assert process.stdout is not None
        assert process.stdout.readline() == "deaf\n"
        assert marked("of this test") == [process.pid]
        threading.Thread(target=process.wait).start()
        end_marked("of this test", term_s=0.0)
    assert process.returncode == -signal.SIGKILL


def test_all_descendants_are_found_except_excluded_ones_and_their_descendants() -> None:
    code = (
        f"import subprocess, sys; child = subprocess.Popen([sys.executable, '-c', {WAITS!r}], start_new_session=True); "
        "print(child.pid, flush=True); child.wait()"
    )
    with subprocess.Popen([sys.executable, "-c", code], stdout=subprocess.PIPE, text=True) as parent:
        assert parent.stdout is not None
        child = int(parent.stdout.readline())
        assert descendants(parent.pid) == [child]
        assert {parent.pid, child} <= set(descendants(os.getpid()))
        assert not {parent.pid, child} & set(descendants(os.getpid(), [parent.pid]))
        end_all(lambda: descendants(parent.pid))
    assert parent.returncode == 0
    wait_for_end([child])


def test_marks_within_marks_add_up() -> None:
    assert with_mark({}, "a") == {VARIABLE: "a"}
    assert with_mark({VARIABLE: "a", "HOME": "/"}, "b") == {VARIABLE: "a:b", "HOME": "/"}


def test_a_process_that_waits_does_not_run(tmp_path: Path) -> None:
    for process_id, state in ((10, "S"), (11, "R"), (12, "D")):
        task = tmp_path / str(process_id) / "task" / str(process_id)
        task.mkdir(parents=True)
        (task / "stat").write_text(f"{process_id} (a (b) c) {state} 1 1")
        (tmp_path / str(process_id) / "stat").write_text(f"{process_id} (a (b) c) {state} {os.getppid()} 1")
    assert not any_runs([10, 99], tmp_path)
    assert any_runs([10, 11], tmp_path)
    assert any_runs([12], tmp_path)
    assert sorted(siblings(tmp_path)) == [10, 11, 12]
