"""Free ROS domains."""

from __future__ import annotations

import os
from collections.abc import Sequence

from gibson_sim.errors import AlreadyRunningError
from gibson_sim.processes.domain_lock import DomainLock

DOMAINS = range(1, 102)
"""ROS domains whose ports lie below the range from which the kernel takes those of other connections."""


def lock_free_domain(domains: Sequence[int] = DOMAINS, start: int | None = None) -> tuple[int, DomainLock]:
    """Returns a domain in which no simulation runs, and its lock.

    Args:
        domains: that may be taken.
        start: index of the one that is tried first; None = another one in each process.

    Raises:
        AlreadyRunningError: a simulation runs in each of them.
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
