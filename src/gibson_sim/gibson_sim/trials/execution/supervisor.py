"""Supervisor of one run: starts, monitors and ends simulation, recorder, trial node and stack in a ROS domain of their own.

A stack that is kept over runs (``restart: never``) stays in its domain while the simulation is restarted for each run. To the stack this looks
like a reset: time starts at 0 again. Each run thus has a bag of its own for replay.
"""

from __future__ import annotations

import json
import os
import shutil
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

from gibson_sim.processes.job_folder import LOADED, VARIABLE, read_note
from gibson_sim.processes.shared_memory import remove_dead_segments
from gibson_sim.trials.execution.ending import Ending, node_died, reported_ending, server_died, stack_died
from gibson_sim.trials.execution.monitor import STILL_NS
from gibson_sim.trials.execution.node_settings import NodeSettings, check_stack, node_settings
from gibson_sim.trials.execution.session import DOMAINS, SESSIONS, STACK, Session
from gibson_sim.trials.execution.stack_log import StackLog
from gibson_sim.trials.execution.trial_node import CLOCK, IMAGES, INPUT, PROGRESS, REPORT, TrialInput, TrialReport
from gibson_sim.trials.json_values import json_text
from gibson_sim.trials.records import Outcome, RunSpec
from gibson_sim.trials.run_folder import BAG, SIMULATION_LOG, STACK_LOG, remove_results, write_outcome
from gibson_sim.trials.scenario.spec import Scenario
from gibson_sim.types import NS_PER_S
from gibson_sim.writing import write_file

PHYSICS, RENDER, RECORD, TRIAL = "physics", "render", "record", "trial"
_NODES = (PHYSICS, RENDER, RECORD, TRIAL)
_PERIOD_S = 0.02
"""Polling period of the supervisor, seconds of wall time."""
_PROGRESS_S = 0.5
"""Period of progress reports, seconds of wall time."""
_LAST_REPORT_S = 1.5
"""Timeout for the trial node to report a status that the stack sent before it exited, seconds of wall time."""
_REST_NS = STILL_NS + 2 * NS_PER_S
"""Simulation time for a robot to come to rest, and for this to be detected, after its stack exited with code 0, ns."""
_STALL_S = 3.0
"""Wall time without a tick after which simulation time counts as stalled, seconds: it waits for the exited stack."""
_GOOD_ENDS = ("reached", "gave up", "time limit")
"""Ends after which a stack can be kept; after others it is restarted."""
JOB = "job"
"""Subfolder of the run's folder for files exchanged between the nodes; removed after the run."""


def execute(
    scenario: Scenario,
    run: RunSpec,
    folder: Path,
    *,
    domains: Sequence[int] = DOMAINS,
    followed: bool = False,
    on_progress: Callable[[str], None] = lambda text: None,
    stop: Callable[[], bool] = lambda: False,
) -> Outcome:
    """Executes one run; leaves only its folder behind: outcome.json, bag, stack.log, simulation.log, and the files of the run.

    Args:
        scenario: scenario of the trial.
        run: one of its runs.
        folder: folder of the run; it is created, and files of an earlier run in it are removed.
        domains: candidate ROS domains.
        followed: whether this process executes another run next: a stack that is restarted for each run is then started at the end of this
            run, so that it loads while this run is judged.
        on_progress: called periodically with a short text.
        stop: called frequently; returns whether to interrupt the run.

    Raises:
        GibsonSimError: the stack or a setting cannot be used, or no domain is free; no process was started.
    """
    check_stack(scenario.stack)
    settings = node_settings(scenario, run, folder, folder / JOB)
    prepare_folder(run, folder)
    kept = scenario.stack.restart == "never"
    session = (SESSIONS.acquire if kept else SESSIONS.acquire_fresh)(scenario.stack, domains)
    try:
        outcome = _Run(scenario, run, folder, settings, session, on_progress, stop, kept=kept and session.has_stack).execute()
    finally:
        if kept:
            SESSIONS.release(session)
        else:
            session.close()
        shutil.rmtree(folder / JOB, ignore_errors=True)
    # Only after the old stack has ended: two at once could need the same port or file.
    if followed and not kept and not stop():
        SESSIONS.prepare(scenario.stack, domains)
    write_outcome(outcome, folder)
    return outcome


def prepare_folder(run: RunSpec, folder: Path) -> None:
    """Creates the folder of a run with its files and removes the files of an earlier execution."""
    for name in (BAG, JOB):
        shutil.rmtree(folder / name, ignore_errors=True)
    remove_results(folder)
    (folder / JOB).mkdir(parents=True)
    for name, text in run.files.items():
        write_file(folder / name, text, durable=False)


class _Run:
    """The processes of one run."""

    def __init__(
        self, scenario: Scenario, run: RunSpec, folder: Path, settings: NodeSettings, session: Session,
        on_progress: Callable[[str], None], stop: Callable[[], bool], *, kept: bool,
    ) -> None:  # fmt: skip
        """``kept``: whether the stack has served an earlier run."""
        self._scenario, self._folder, self._job, self._settings = scenario, folder, folder / JOB, settings
        self._session, self._server, self._on_progress, self._stop = session, session.server, on_progress, stop
        self._input = TrialInput.of(scenario, run, session.marker, kept=kept)
        self._began_s = self._progress_s = time.monotonic()
        self._log = StackLog(folder / STACK_LOG)
        self._keeps_stack = False
        self._stack_code: int | None = None

    def execute(self) -> Outcome:
        """Executes the run; returns its outcome."""
        try:
            self._start()
            ending = self._monitor()
            decided_s = time.monotonic()
            self._keeps_stack = self._scenario.stack.restart == "never" and ending.end in _GOOD_ENDS
        finally:
            self._end()
        return self._outcome(ending, decided_s)

    # Start

    def _start(self) -> None:
        self._server.ended.clear()
        write_file(self._job / INPUT, json_text(self._input), durable=False)
        self._start_node(PHYSICS, self._settings.physics)
        self._start_node(TRIAL, self._settings.trial)
        self._start_node(RECORD, self._settings.record)
        if self._scenario.record.images != "none":
            self._start_node(RENDER, self._settings.render)
        self._session.start_stack()

    def _start_node(self, name: str, config: Any) -> None:
        environment = {"ROS_DOMAIN_ID": str(self._session.domain), VARIABLE: f"-1:{self._job}"}
        output = os.open(self._log_of(name), os.O_WRONLY | os.O_CREAT | os.O_APPEND | os.O_CLOEXEC)
        try:
            self._server.start_node(name, f"{name}_node", config, environment, output)
        finally:
            os.close(output)

    def _log_of(self, name: str) -> Path:
        return self._job / f"{name}.log"

    def _output_of(self, name: str) -> str:
        try:
            return self._log_of(name).read_text(errors="replace")
        except OSError:  # it was not started
            return ""

    # Monitoring

    def _monitor(self) -> Ending:
        limit_s = self._scenario.limits.wall_time
        while True:
            self._poll()
            if ending := self._ending():
                return ending
            now_s = time.monotonic()
            if self._stop():
                return Ending("interrupted", f"after {now_s - self._began_s:.1f} s")
            if now_s - self._began_s > limit_s:
                return Ending("wall time limit", f"the run took longer than {limit_s:g} s; {self._progress()}")
            if now_s - self._progress_s > _PROGRESS_S:
                self._progress_s = now_s
                self._on_progress(self._progress())

    def _ending(self) -> Ending | None:
        """Returns the end of the run; None = the run continues."""
        ended = self._server.ended
        if (report := self._report()).end:
            return reported_ending(report, self._output_of(PHYSICS))
        if ended and not self._server.is_alive:
            return server_died()
        if TRIAL in ended:
            # The trial node also exits without a report after a failure of the physics node.
            self._wait(lambda: PHYSICS in ended, 0.5)
        for name in (PHYSICS, TRIAL, RECORD, RENDER):
            if name in ended:
                return node_died(name, ended[name], self._output_of(name))
        if STACK in ended:
            self._stack_code = ended[STACK]
            self._wait_for_last_report(self._stack_code)
            if (report := self._report()).end:
                return reported_ending(report, self._output_of(PHYSICS))
            return stack_died(self._stack_code, self._log.last_line)
        if RENDER not in self._server.running and read_note(self._job, IMAGES) is not None:
            self._start_node(RENDER, self._settings.render)
        return None

    def _progress(self) -> str:
        if read_note(self._job, LOADED) is None:
            return "loading the scene"
        return read_note(self._job, PROGRESS) or "starting the stack"

    def _poll(self, wait_s: float = _PERIOD_S) -> None:
        """Reads the stack's output and polls for exited processes; waits if there is no output."""
        self._server.poll()
        data = self._session.read()
        self._log.write(data)
        if not data:
            time.sleep(wait_s)

    def _wait(self, condition: Callable[[], bool], seconds: float) -> bool:
        """Waits for a condition; returns whether it became true in time."""
        deadline_s = time.monotonic() + seconds
        while not condition() and time.monotonic() < deadline_s:
            self._poll()
        return condition()

    def _wait_for_last_report(self, code: int) -> None:
        """Waits for the report after the stack exited. After code 0 the stack may have finished its task: its robot gets time to come to rest."""
        self._wait(lambda: bool(self._report().end), _LAST_REPORT_S)
        if code != 0:
            return
        ended_ns = now_ns = self._clock_ns()
        ticked_s = time.monotonic()
        while not self._report().end and now_ns - ended_ns < _REST_NS and not self._stop():
            self._poll()
            before_ns, now_ns = now_ns, self._clock_ns()
            if now_ns != before_ns:
                ticked_s = time.monotonic()
            elif time.monotonic() - ticked_s > _STALL_S:
                return

    def _clock_ns(self) -> int:
        return int(read_note(self._job, CLOCK) or 0)

    def _report(self) -> TrialReport:
        text = read_note(self._job, REPORT)
        return TrialReport(**json.loads(text)) if text else TrialReport()

    # End

    def _end(self) -> None:
        """Ends all processes and writes their output."""
        if STACK in self._server.ended and self._stack_code is None:
            self._stack_code = self._server.ended[STACK]
        try:
            # First the trial node, whose report has the last tick; then all others at once, since time no longer advances.
            if not self._report().end:
                self._session.end_processes([TRIAL], self._poll)
            self._session.end_processes([PHYSICS, RENDER, RECORD, *([] if self._keeps_stack else [STACK])], self._poll)
            self._wait(lambda: TRIAL not in self._server.running, _LAST_REPORT_S)
            self._session.end_processes([TRIAL], self._poll)
            if not self._keeps_stack:
                self._session.end_leftovers()
            while data := self._session.read():
                self._log.write(data)
        finally:
            self._log.close()
            remove_dead_segments(wait=self._session.killed)
            self._write_simulation_log()

    def _write_simulation_log(self) -> None:
        parts = [f"{name:8} | {line}\n" for name in _NODES for line in self._output_of(name).splitlines()]
        write_file(self._folder / SIMULATION_LOG, "".join(parts), durable=False)

    def _outcome(self, ending: Ending, decided_s: float) -> Outcome:
        report, now_s = self._report(), time.monotonic()
        summary = json.loads(read_note(self._job, "physics.json") or "{}")
        began_s = report.began_s or decided_s
        ended_s = report.ended_s or decided_s
        return Outcome(
            end=ending.end,
            detail=ending.detail,
            lockstep=bool(self._scenario.stack.lockstep),
            goal_ns=report.goal_ns,
            decided_ns=report.decided_ns,
            end_ns=report.end_ns,
            exit_code=self._stack_code,
            status=report.status,
            callers=report.callers,
            time_calls=report.time_calls,
            refused_commands=summary.get("refused_commands", 0),
            start_up_s=round(began_s - self._began_s, 3),
            running_s=round(ended_s - began_s, 3),
            ending_s=round(now_s - ended_s, 3),
        )
