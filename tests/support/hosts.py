"""Two machines on one network: network namespaces joined by a cable, each with shared memory of its own."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
import warnings
from collections.abc import Mapping, Sequence

import pytest

_OF_ROS = ("ROS_", "RMW_", "FASTRTPS_", "FASTDDS_", "SKIP_DEFAULT_XML")
"""Variables whose names begin like this say how ROS talks."""


class Hosts:
    """The machines ``here`` and ``there``; the network's names and addresses are those of documentation (RFC 5737)."""

    def __init__(self) -> None:
        """Makes them; skips the test, loudly, where that is not allowed."""
        own = f"gs{os.getpid()}"
        self._names = {"here": f"{own}h", "there": f"{own}t"}
        self.addresses = {"here": "192.0.2.1", "there": "192.0.2.2"}
        try:
            self._make()
        except (OSError, subprocess.CalledProcessError) as error:
            self.close()
            message = (
                f"SKIPPED: no network namespaces here, so nobody knows who reaches a simulation from another machine: {error}"
            )
            warnings.warn(message, stacklevel=2)
            pytest.skip(message)

    def _make(self) -> None:
        here, there = self._names.values()
        for name in self._names.values():
            _ip("netns", "add", name)
            _ip("-n", name, "link", "set", "lo", "up")
        _ip("-n", here, "link", "add", "cable", "type", "veth", "peer", "name", "cable", "netns", there)
        for host, name in self._names.items():
            _ip("-n", name, "addr", "add", f"{self.addresses[host]}/24", "dev", "cable")
            _ip("-n", name, "link", "set", "cable", "up")
            _ip("-n", name, "route", "add", "default", "dev", "cable")
        # What works at all is tried once, so that a test does not fail for what the machine lacks.
        for host in self._names:
            subprocess.run(self.on(host, ["true"]), check=True, capture_output=True)

    def on(self, host: str, command: Sequence[str]) -> list[str]:
        """Returns the command line that runs a command on a host; the process is the command's own."""
        mount = 'mount -t tmpfs tmpfs /dev/shm && exec "$@"' if host == "there" else 'exec "$@"'
        return ["ip", "netns", "exec", self._names[host], "unshare", "--mount", "sh", "-c", mount, "sh", *command]

    def python(self, host: str, *arguments: str, **variables: str) -> subprocess.CompletedProcess[str]:
        """Runs a Python program on a host, with no other variables of ROS than those given; returns what it said."""
        command = self.on(host, [sys.executable, *arguments])
        return subprocess.run(command, env=plain_environment(variables), capture_output=True, text=True, check=True)

    def read(self, host: str, path: str) -> str:
        """Returns the text of a file as a host sees it."""
        return subprocess.run(self.on(host, ["cat", path]), capture_output=True, text=True, check=True).stdout

    def close(self) -> None:
        """Removes them."""
        for name in self._names.values():
            subprocess.run(["ip", "netns", "del", name], capture_output=True, check=False)


def plain_environment(variables: Mapping[str, str]) -> dict[str, str]:
    """Returns the environment of this process without what says how ROS talks, and with these variables."""
    return {**{name: value for name, value in os.environ.items() if not name.startswith(_OF_ROS)}, **variables}


def _ip(*arguments: str) -> None:
    program = shutil.which("ip") or "/usr/sbin/ip"
    subprocess.run([program, *arguments], check=True, capture_output=True, text=True)
