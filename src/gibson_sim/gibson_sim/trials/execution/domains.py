"""Free ROS domains."""

from __future__ import annotations

import os
from collections.abc import Sequence

from gibson_sim.errors import AlreadyRunningError
from gibson_sim.processes.domain_lock import DomainLock

DOMAINS = range(1, 102)
"""ROS domains whose ports lie below the kernel's range of ephemeral ports."""


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
