"""Session: the ROS domain, node server, stack processes and output that later runs reuse if the stack is kept.

A stack that is restarted for each run can be started early, while the previous run is judged (``SessionPool.prepare``).
"""

from __future__ import annotations

import atexit
import os
import signal
import threading
import time
import uuid
from collections.abc import Callable, Sequence

from gibson_sim.errors import AlreadyRunningError, GibsonSimError
from gibson_sim.processes.descendants import end_marked
from gibson_sim.processes.domain_lock import DomainLock
from gibson_sim.processes.environment import node_environment
from gibson_sim.processes.shared_memory import remove_dead_segments
from gibson_sim.trials.execution.node_server import REST, SERVERS
from gibson_sim.trials.execution.node_settings import stack_environment
from gibson_sim.trials.execution.trial_node import MARKER
from gibson_sim.trials.scenario.spec import StackSpec

DOMAINS = range(1, 102)
"""ROS domains whose ports lie below the kernel's range of ephemeral ports."""
STACK = "stack"
"""Name of the stack's process in the node server."""
NODE_GRACE_S = ((signal.SIGINT, 10.0), (signal.SIGTERM, 3.0), (signal.SIGKILL, 5.0))
STACK_GRACE_S = ((signal.SIGINT, 5.0), (signal.SIGTERM, 2.0), (signal.SIGKILL, 5.0))
"""Signals that end our nodes and a stack, each with the wall time until the next signal, seconds."""
_PERIOD_S = 0.02
"""Period of polling for exited processes, seconds of wall time."""
_CHUNK = 1 << 20
"""Size of one read of output, bytes."""


def acquire_free_domain(domains: Sequence[int] = DOMAINS, start: int | None = None) -> tuple[int, DomainLock]:
    """Locks a domain in which no simulation runs; returns the domain and its lock.

    Args:
        domains: candidates.
        start: index of the first candidate tried; None = depends on the process id.

    Raises:
        AlreadyRunningError: a simulation runs in each candidate.
    """
    first = os.getpid() * 7 if start is None else start
    for number in range(len(domains)):
        domain = domains[(first + number) % len(domains)]
        try:
            return domain, DomainLock(domain)
        except AlreadyRunningError:
            continue
    raise AlreadyRunningError(
        f"a simulation runs in each of the ROS domains {domains[0]} to {domains[-1]}: wait until one ends, or stop one"
    )


class Session:
    """A ROS domain with a stack."""

    def __init__(self, stack: StackSpec, domains: Sequence[int]) -> None:
        """Acquires a free domain; ``start_stack`` starts the stack.

        Raises:
            GibsonSimError: no domain is free, or the nodes cannot work in this environment.
        """
        self.stack, self._domains = stack, tuple(domains)
        self.marker = uuid.uuid4().hex
        """Value of the variable ``MARKER`` of the stack's processes."""
        self.killed = False
        """Whether a process had to be killed, so that its shared memory remains."""
        self._has_processes = False
        """Whether the stack was started and its processes have not all been ended."""
        self._output = -1
        base = node_environment(reach="local")
        base.pop("ROS_DOMAIN_ID", None)
        self._base = base
        self.domain, self._lock = acquire_free_domain(domains)
        """ROS domain id."""
        try:
            self.server = SERVERS.acquire(base)
            """Server that starts the processes."""
        except BaseException:
            self._lock.close()
            raise

    @property
    def has_stack(self) -> bool:
        """Whether the stack is running."""
        return STACK in self.server.running

    def fits(self, stack: StackSpec, domains: Sequence[int]) -> bool:
        """Returns whether the session can serve runs of a stack in one of the domains."""
        return (self.stack, self._domains) == (stack, tuple(domains)) and self.server.is_alive

    def start_stack(self) -> None:
        """Starts the stack if it is not running."""
        if self.has_stack:
            return
        self._close_output()
        self._output, write_end = os.pipe2(os.O_CLOEXEC | os.O_NONBLOCK)
        os.set_blocking(write_end, True)
        environment = stack_environment(self.stack, self.domain, self.marker, os.environ)
        self._has_processes = True
        try:
            self.server.start_program(STACK, self.stack.command, self.stack.folder.absolute(), environment, MARKER, write_end)
        finally:
            os.close(write_end)

    def read(self) -> bytes:
        """Returns available output of the stack without waiting; empty = none."""
        try:
            return os.read(self._output, _CHUNK) if self._output >= 0 else b""
        except BlockingIOError:
            return b""

    def end_processes(self, names: Sequence[str], poll: Callable[[], None]) -> None:
        """Ends processes of the node server in parallel, each with a sequence of signals.

        Args:
            names: names of the processes.
            poll: called repeatedly while processes run; polls the server, reads the output and waits briefly.
        """
        began_s, sent, due_s = time.monotonic(), dict.fromkeys(names, 0), dict.fromkeys(names, 0.0)
        while running := [name for name in names if name in self.server.running]:
            waited_s = time.monotonic() - began_s
            for name in running:
                steps = STACK_GRACE_S if name == STACK else NODE_GRACE_S
                if waited_s >= due_s[name] and sent[name] < len(steps):
                    number, seconds = steps[sent[name]]
                    if name != STACK and sent[name]:
                        self.server.signal(name, signal.SIGUSR1)  # a node then logs the stack trace of where it hangs
                    self.server.signal(name, number)
                    self.killed |= number == signal.SIGKILL
                    sent[name], due_s[name] = sent[name] + 1, waited_s + seconds
            if all(sent[name] == len(NODE_GRACE_S) and waited_s >= due_s[name] for name in running):
                return  # SIGKILL does not end a process in uninterruptible sleep, such as on a broken disk
            poll()

    def end_leftovers(self) -> None:
        """Ends all remaining processes of the stack, detached ones included."""
        end_marked(self.marker, MARKER)
        self.server.end_rest()  # processes without the marker
        while REST in self.server.running:
            self._poll()
        self._has_processes = False

    def close(self) -> None:
        """Ends the stack and releases the domain."""
        try:
            if self._has_processes:
                self.end_processes([STACK], self._poll)
                self.end_leftovers()
                remove_dead_segments(wait=self.killed)
            SERVERS.release(self._base, self.server)
        finally:
            self._close_output()
            self._lock.close()

    def _poll(self) -> None:
        self.server.poll()
        if not self.read():
            time.sleep(_PERIOD_S)

    def _close_output(self) -> None:
        if self._output >= 0:
            os.close(self._output)
            self._output = -1


class SessionPool:
    """The sessions of this process whose stacks are kept or were started early; each serves one run at a time."""

    def __init__(self) -> None:
        self._idle: list[Session] = []
        self._prepared: list[Session] = []
        """Sessions whose stacks have served no run."""
        self._mutex, self._owner = threading.Lock(), os.getpid()

    def acquire(self, stack: StackSpec, domains: Sequence[int]) -> Session:
        """Returns an idle or new session for a stack."""
        with self._mutex:
            self._drop_if_forked()
            for number, session in enumerate(self._idle):
                session.server.poll()
                if session.fits(stack, domains):
                    return self._idle.pop(number)
        return Session(stack, domains)

    def prepare(self, stack: StackSpec, domains: Sequence[int]) -> None:
        """Starts a stack for the next call of ``acquire_fresh``, in the background."""
        try:
            session = Session(stack, domains)
        except GibsonSimError:  # such as no free domain: the next run reports it if it persists
            return
        try:
            session.start_stack()
        except GibsonSimError:
            session.close()
            return
        with self._mutex:
            self._drop_if_forked()
            self._prepared.append(session)

    def acquire_fresh(self, stack: StackSpec, domains: Sequence[int]) -> Session:
        """Returns a session whose stack has served no run: a prepared one with a running stack, or a new one without a stack."""
        with self._mutex:
            self._drop_if_forked()
            prepared, self._prepared = self._prepared, []
        fitting = None
        for session in prepared:
            session.server.poll()
            if fitting is None and session.has_stack and session.fits(stack, domains):
                fitting = session
            else:
                session.close()
        return fitting or Session(stack, domains)

    @property
    def prepared(self) -> tuple[Session, ...]:
        """Sessions whose stacks wait for their run."""
        with self._mutex:
            self._drop_if_forked()
            return tuple(self._prepared)

    def _drop_if_forked(self) -> None:
        """Drops the sessions of the parent process after a fork."""
        if self._owner != os.getpid():
            self._owner = os.getpid()
            self._idle.clear()
            self._prepared.clear()

    def release(self, session: Session) -> None:
        """Keeps a session for the next run; closes idle sessions of other stacks."""
        with self._mutex:
            others, self._idle = self._idle, [session]
        for other in others:
            if other.stack == session.stack:
                self._idle.append(other)
            else:
                other.close()

    def close(self) -> None:
        """Ends all sessions that serve no run."""
        with self._mutex:
            self._drop_if_forked()
            sessions = [*self._idle, *self._prepared]
            self._idle, self._prepared = [], []
        for session in sessions:
            session.close()


SESSIONS = SessionPool()
"""Sessions of this process; they end with the process."""
atexit.register(SESSIONS.close)
