"""One simulation at a time in a ROS domain."""

from __future__ import annotations

import fcntl
import os
import tempfile
from pathlib import Path

from gibson_sim.errors import AlreadyRunningError


class DomainLock:
    """Held by the one simulation of a ROS domain on this machine, its launcher or its physics node; the kernel frees it however that ends."""

    def __init__(self, domain_id: int, folder: Path | None = None) -> None:
        """Takes the lock.

        Raises:
            AlreadyRunningError: another process holds it.
        """
        self.path = (folder or Path(tempfile.gettempdir())) / f"gibson-sim-domain-{domain_id}.lock"
        self._file: int | None = os.open(self.path, os.O_RDWR | os.O_CREAT | os.O_CLOEXEC, 0o666)
        try:
            fcntl.flock(self._file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError:
            holder = os.read(self._file, 32).decode(errors="replace").strip()
            os.close(self._file)
            self._file = None
            raise AlreadyRunningError(
                f"a simulation runs in ROS domain {domain_id} already (process {holder or 'unknown'}): "
                "stop it, or choose another domain with --domain-id or ROS_DOMAIN_ID"
            ) from None
        os.ftruncate(self._file, 0)
        os.write(self._file, str(os.getpid()).encode())

    def close(self) -> None:
        """Frees the lock."""
        if self._file is not None:
            os.close(self._file)
            self._file = None
