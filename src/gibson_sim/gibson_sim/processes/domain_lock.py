"""A lock that allows one simulation at a time in a ROS domain.

The lock is the name of a Unix socket in Linux's abstract namespace. It needs no file: it is independent of ``TMPDIR`` and of files of other
users in ``/tmp``, and the kernel frees the name when the process ends for any reason. Such names belong to a network namespace, like the
loopback interface of a ROS domain: a container with its own network has its own domains.
"""

from __future__ import annotations

import errno
import os
import pwd
import socket
import struct
from pathlib import Path

from gibson_sim.errors import AlreadyRunningError, EnvironmentProblemError

_CREDENTIALS = struct.Struct("3i")
"""Format of SO_PEERCRED (unix(7)): process id, user id, group id."""
_FIRST_PORT, _PORTS_PER_DOMAIN = 7400, 250
"""UDP ports of a DDS domain: PB and DG of the RTPS specification, section 9.6.1.1."""
_BACKLOG = 4096
"""Length of the socket's queue. Refused processes stay in it, since the holder never accepts; when it is full, errors do not name the holder."""


class DomainLock:
    """The lock of a ROS domain on this machine, held by the launcher or the physics node of its simulation."""

    def __init__(self, domain_id: int) -> None:
        """Acquires the lock.

        Raises:
            AlreadyRunningError: another process holds it; the message names the process and its user.
            EnvironmentProblemError: this machine does not allow such a socket.
        """
        name = f"\0{_name(domain_id)}"
        self._socket: socket.socket | None = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
        try:
            self._socket.bind(name)
            self._socket.listen(_BACKLOG)
        except OSError as error:
            self.close()
            if error.errno != errno.EADDRINUSE:
                raise EnvironmentProblemError(
                    f"the lock of ROS domain {domain_id}, the abstract Unix socket @{name[1:]}, cannot be created: {error.strerror}"
                ) from error
            raise AlreadyRunningError(_refusal(domain_id, _holder(name))) from None

    def close(self) -> None:
        """Releases the lock."""
        if self._socket is not None:
            self._socket.close()
            self._socket = None


def is_held(domain_id: int) -> bool:
    """Returns whether a simulation of this machine holds the lock of a ROS domain: it runs or starts."""
    try:
        sockets = Path("/proc/net/unix").read_text(errors="replace").splitlines()
    except OSError:
        return False
    return any(line.endswith(f" @{_name(domain_id)}") for line in sockets)


def domains_in_use() -> set[int]:
    """Returns the ROS domains in which a participant of this machine's network namespace has a UDP port, of any vendor of DDS.

    A participant with shared memory alone is not seen. In domains above 101, another program's ephemeral port looks like a participant.
    """
    found = set()
    for table in ("udp", "udp6"):
        try:
            lines = Path("/proc/net", table).read_text().splitlines()[1:]
        except OSError:
            continue
        ports = [int(line.split()[1].rpartition(":")[2], 16) for line in lines]
        found |= {(port - _FIRST_PORT) // _PORTS_PER_DOMAIN for port in ports if port >= _FIRST_PORT}
    return found


def _name(domain_id: int) -> str:
    return f"gibson-sim-domain-{domain_id}"


def _refusal(domain_id: int, holder: tuple[int, int] | None) -> str:
    other_domain = "choose another domain with --domain-id or ROS_DOMAIN_ID"
    if holder is None:
        return f"a simulation runs in ROS domain {domain_id} already (its process cannot be identified): {other_domain}"
    process_id, user_id = holder
    process = f"process {process_id}" if process_id else "a process of another container"
    if user_id == os.getuid():
        return f"a simulation runs in ROS domain {domain_id} already ({process}): stop it, or {other_domain}"
    return f"a simulation runs in ROS domain {domain_id} already ({process} of user {_user(user_id)}): {other_domain}"


def _holder(name: str) -> tuple[int, int] | None:
    """Returns the ids of the process that listens on an abstract name and of its user; None if they cannot be read."""
    with socket.socket(socket.AF_UNIX, socket.SOCK_STREAM) as probe:
        probe.setblocking(False)
        try:
            probe.connect(name)
            packed = probe.getsockopt(socket.SOL_SOCKET, socket.SO_PEERCRED, _CREDENTIALS.size)
        except OSError:
            return None
    process_id, user_id, _ = _CREDENTIALS.unpack(packed)
    return process_id, user_id


def _user(user_id: int) -> str:
    try:
        return pwd.getpwuid(user_id).pw_name
    except KeyError:
        return str(user_id)
