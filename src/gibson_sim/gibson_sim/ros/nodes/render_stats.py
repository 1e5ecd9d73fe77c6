"""Statistics of a render node: rendered images, published messages and their wall times; progress of loading."""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Callable, Iterable
from statistics import median
from typing import Any

from gibson_sim.sensors.schedule import images_due
from gibson_sim.types import NS_PER_S, CameraSpec, Frame

_MAX_SAMPLES = 10_000
"""Maximum number of samples for medians, the newest ones: it bounds the memory of long runs."""

_LATE_NS = 3 * NS_PER_S // 2
"""Time after the last report after which the next one is late, ns of wall time; reports are due once a second."""


class RenderStats:
    """Statistics since the start of a render node.

    Simulation time may jump back at the start of a new epoch; the interval of the jump counts neither as skipped nor as simulated.
    """

    def __init__(self) -> None:
        self._skipped: dict[str, int] = {}
        self.last_stamp_ns = 0
        self._images: dict[str, int] = {}
        self._failed: dict[str, int] = {}
        self._outputs: dict[str, int] = {}
        self._messages: dict[str, int] = {}
        self._stamps: dict[str, int] = {}
        self._draw_ms: deque[float] = deque(maxlen=_MAX_SAMPLES)
        self._publish_ms: deque[float] = deque(maxlen=_MAX_SAMPLES)
        self._first_ns = self._last_ns = 0
        self._simulated_ns = 0
        self._reported = (time.monotonic_ns(), 0, 0, 0)

    def count_due(self, camera: CameraSpec, stamp_ns: int, *, subscribed: bool) -> None:
        """Counts a due image of a camera; images that were due since the last one count as skipped, unless they had no subscriber."""
        last = self._stamps.pop(camera.name, None)
        if not subscribed:
            return
        if last is not None and stamp_ns > last:
            self._skipped[camera.name] = self._skipped.get(camera.name, 0) + images_due(last, stamp_ns, camera.rate_hz) - 1
        self._stamps[camera.name] = stamp_ns

    def add(self, started_ns: int, drawn_ns: int, published_ns: int, frames: list[Frame], messages: Iterable[str]) -> None:
        """Adds the images rendered at one stamp, the kinds of published messages, and the times of both (monotonic clock, ns)."""
        stamp_ns = frames[0].stamp_ns
        if not self._images:
            self._first_ns = published_ns
        else:
            self._simulated_ns += max(0, stamp_ns - self.last_stamp_ns)
        for frame in frames:
            name = frame.camera.name
            self._images[name] = self._images.get(name, 0) + 1
            for output in frame.camera.outputs:
                key = f"{name}/{output}"
                self._outputs[key] = self._outputs.get(key, 0) + 1
        for kind in messages:
            self._messages[kind] = self._messages.get(kind, 0) + 1
        self._draw_ms.append((drawn_ns - started_ns) / 1e6)
        self._publish_ms.append((published_ns - drawn_ns) / 1e6)
        self._last_ns, self.last_stamp_ns = published_ns, stamp_ns

    def count_failed(self, camera: CameraSpec) -> None:
        """Counts an image that could not be rendered."""
        self._failed[camera.name] = self._failed.get(camera.name, 0) + 1

    @property
    def skipped(self) -> int:
        """Number of images of all cameras that were due and not rendered."""
        return sum(self._skipped.values())

    @property
    def report_is_late(self) -> bool:
        """Whether the timer of the reports does not get to run, since a state to render is always queued."""
        return time.monotonic_ns() - self._reported[0] > _LATE_NS

    def since_last_report(self) -> dict[str, float]:
        """Returns rates and counts since the last call."""
        now, total, all_failed = time.monotonic_ns(), sum(self._images.values()), sum(self._failed.values())
        last_ns, images, skipped, failed = self._reported
        self._reported = (now, total, self.skipped, all_failed)
        seconds = (now - last_ns) / NS_PER_S
        return {
            "images_per_s": (total - images) / seconds,
            "due_per_s": (total - images + self.skipped - skipped) / seconds,
            "skipped": self.skipped - skipped,
            "failed": all_failed - failed,
            "draw_ms": self._draw_ms[-1] if self._draw_ms else 0.0,
        }

    def summary(self) -> dict[str, Any]:
        """Returns rates and counts since the first image."""
        wall_s, sim_s = (self._last_ns - self._first_ns) / NS_PER_S, self._simulated_ns / NS_PER_S
        return {
            "images": dict(self._images),
            "failed_images": dict(self._failed),
            "outputs": dict(self._outputs),
            "messages": dict(self._messages),
            "images_per_wall_s": {k: (n - 1) / wall_s if wall_s else 0.0 for k, n in self._images.items()},
            "images_per_simulated_s": {k: (n - 1) / sim_s if sim_s else 0.0 for k, n in self._images.items()},
            "skipped_images": self.skipped,
            "skipped_by_camera": {k: self._skipped.get(k, 0) for k in {**self._images, **self._failed}},
            "draw_ms_median": median(self._draw_ms) if self._draw_ms else 0.0,
            "publish_ms_median": median(self._publish_ms) if self._publish_ms else 0.0,
        }


class LoadingProgress:
    """Reports the progress of loading a scene: logs it every two seconds, and reports it to the launcher four times a second.

    The end of a stage is logged if its progress was, so that no log ends at 11 %.

    Args:
        report: receives the stage and its progress as text, for the launcher.
        log: receives the same text, for the log.
        now_s: monotonic clock, s.
    """

    def __init__(
        self, report: Callable[[str], Any], log: Callable[[str], Any], now_s: Callable[[], float] = time.monotonic
    ) -> None:
        self._report, self._log, self._now_s = report, log, now_s
        self._logged_s, self._reported_s, self._logged_stage = now_s(), -1.0, ""

    def __call__(self, stage: str, fraction: float) -> None:
        """Reports a stage and its progress, 0 to 1."""
        now, text = self._now_s(), f"{stage}: {100.0 * fraction:.0f} %"
        if now - self._reported_s >= 0.25 or fraction >= 1.0:
            self._reported_s = now
            self._report(text)
        if now - self._logged_s >= 2.0 or (fraction >= 1.0 and self._logged_stage == stage):
            self._logged_s, self._logged_stage = now, stage
            self._log(text)
