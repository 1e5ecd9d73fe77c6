#!/usr/bin/env python3
"""The way of a new user without ROS: clone, `make run`, a page in a browser, keys, a spawned thing, a bag, its plot; every line with its time.

    tests/acceptance/new_user.py [FOLDER]

It types what the first screen of README.md says, into a fresh clone of this repository (FOLDER, or a temporary folder that is removed). The browser
is Chromium, driven by this environment's playwright. The exit code is 1 where a step does not show what it must.
"""

from __future__ import annotations

import re
import signal
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

from gibson_sim_bench.browser import chromium

ROOT = Path(__file__).resolve().parents[2]
PATIENCE_S = 1200.0
"""How long one step may take before it counts as hung."""
_BEGAN_S = time.monotonic()


def say(text: str) -> None:
    """Prints a line with the seconds since the clone began."""
    print(f"{time.monotonic() - _BEGAN_S:7.1f}  {text}", flush=True)


class Typed:
    """A command in a terminal of the clone, whose lines are printed as they come."""

    def __init__(self, command: str, folder: Path) -> None:
        say(f"$ {command}")
        self.lines: list[str] = []
        self._process = subprocess.Popen(
            ["bash", "-c", command],
            cwd=folder,
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            text=True,
            start_new_session=True,
        )
        self._reader = threading.Thread(target=self._read, daemon=True)
        self._reader.start()

    def _read(self) -> None:
        assert self._process.stdout is not None
        for line in self._process.stdout:
            self.lines.append(line.rstrip())
            say(f"  {self.lines[-1]}")

    def wait_for(self, beginning: str) -> str:
        """Returns the first line with this beginning."""
        wait_until(lambda: any(line.startswith(beginning) for line in self.lines) or self._process.poll() is not None, beginning)
        for line in self.lines:
            if line.startswith(beginning):
                return line
        raise SystemExit(f"it ended without a line that begins with {beginning!r}")

    def end(self, *, interrupt: bool = False) -> None:
        """Waits until it has ended, after Ctrl-C if ``interrupt``."""
        if interrupt:
            say("^C")
            for process in _children(self._process.pid):  # a terminal sends it to all of them
                _signal(process)
        code = self._process.wait(timeout=PATIENCE_S)
        self._reader.join()
        if code and not interrupt:
            raise SystemExit(f"exit code {code}")


def _children(group: int) -> list[int]:
    found = subprocess.run(["ps", "-o", "pid=", "-g", str(group)], capture_output=True, text=True, check=False).stdout
    return [int(number) for number in found.split()]


def _signal(process: int) -> None:
    subprocess.run(["kill", f"-{signal.SIGINT.value}", str(process)], check=False, stderr=subprocess.DEVNULL)


def wait_until(condition: Callable[[], bool], what: str) -> None:
    """Waits for a condition."""
    end = time.monotonic() + PATIENCE_S
    while not condition():
        if time.monotonic() > end:
            raise SystemExit(f"waited {PATIENCE_S:.0f} s for: {what}")
        time.sleep(0.02)


def _position(page: Any) -> tuple[float, float]:
    """Returns x and y that the page shows, metres."""
    x, y = re.findall(r"-?\d+\.\d+", page.inner_text("#pose"))[:2]
    return float(x), float(y)


def _moved(page: Any, start: tuple[float, float]) -> float:
    x, y = _position(page)
    return ((x - start[0]) ** 2 + (y - start[1]) ** 2) ** 0.5


def journey(folder: Path) -> None:
    """Does all of it in an empty folder."""
    Typed(f"git clone -q {ROOT} {folder}", ROOT).end()
    run = Typed("make run ARGS=--web", folder)
    address = run.wait_for("look: http://").split()[1]
    with chromium(webgl=True) as browser:
        page = browser.new_page(viewport={"width": 1280, "height": 800}, bypass_csp=True)
        page.goto(address)
        page.wait_for_selector("canvas[data-stamp]", timeout=PATIENCE_S * 1000)
        say("the browser shows the first picture")
        page.wait_for_function("document.querySelector('#pose').innerText.length > 0")
        start = _position(page)
        page.keyboard.down("w")
        wait_until(lambda: _moved(page, start) > 0.2, "a robot that drives")
        page.keyboard.up("w")
        say(f"W drove the robot {_moved(page, start):.2f} m")
        Typed("source env.sh && gibson-sim spawn bottle_water --at 4.2,5.7", folder).end()
        page.wait_for_selector("[data-key^='e:bottle_water']", timeout=PATIENCE_S * 1000)
        say("the page lists bottle_water")
    run.end(interrupt=True)
    arguments = "--drive tour --duration 30 --record out/tour --record-images compressed --video out/tour.mp4"
    Typed(f'make run ARGS="{arguments}"', folder).end()
    Typed("source env.sh && gibson-sim bag plot out/tour", folder).end()
    for name in ("tour.mp4", "tour_plot.png"):
        if not (folder / "out" / name).is_file():
            raise SystemExit(f"there is no out/{name}")
        say(f"out/{name}: {(folder / 'out' / name).stat().st_size / 1e6:.1f} MB")


def main() -> None:
    """Runs the journey."""
    if len(sys.argv) > 1:
        journey(Path(sys.argv[1]).resolve())
        return
    with tempfile.TemporaryDirectory(prefix="new-user-") as folder:
        journey(Path(folder) / "gibson-sim")


if __name__ == "__main__":
    main()
