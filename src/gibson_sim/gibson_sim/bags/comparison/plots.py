"""Draws the plots of a comparison as SVG. Needs matplotlib, which is optional."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np

from gibson_sim.bags.comparison.compare import Comparison
from gibson_sim.bags.comparison.measure import Measurements
from gibson_sim.bags.comparison.recorded_drive import F64
from gibson_sim.bags.comparison.response import Step
from gibson_sim.bags.comparison.signals import held, speeds
from gibson_sim.bags.plots.style import drawn, require_matplotlib, svg_element

REAL, SIM, MODEL, COMMAND = "#c2410c", "#1d4ed8", "#111827", "#9ca3af"
"""Colours of all plots."""


@dataclass(frozen=True, slots=True)
class Plot:
    """One plot."""

    title: str
    caption: str
    svg: str
    """Plot as an ``<svg>`` element."""


def draw_plots(comparison: Comparison) -> list[Plot]:
    """Returns all plots for which there is data.

    Raises:
        EnvironmentProblemError: matplotlib is missing.
    """
    require_matplotlib("an HTML report", ", or leave out --html")
    makers: tuple[Callable[[Comparison], Iterator[Plot]], ...] = (_steps, _excerpts, _paths, _allan, _lidar, _luma)
    return [plot for make in makers for plot in make(comparison)]


def _plot(title: str, caption: str, columns: int, draw: Callable[[Any], None], height: float = 3.2) -> Plot:
    """Returns a plot drawn by ``draw``, which receives the axes, (columns,)."""
    file = drawn((11.0, height), lambda figure: draw(figure.subplots(1, columns, squeeze=False)[0]), form="svg")
    return Plot(title, caption, svg_element(file.decode(), re.sub(r"\W+", "", title.lower())))


def _sides(comparison: Comparison) -> tuple[tuple[str, str, Measurements], ...]:
    return ("real", REAL, comparison.real), ("simulated", SIM, comparison.sim)


def _steps(comparison: Comparison) -> Iterator[Plot]:
    kinds = [("linear", "forward"), ("angular", "turning")]
    steps_of_kind = {
        kind: [getattr(m, kind).steps if getattr(m, kind) else () for _, _, m in _sides(comparison)] for kind, _ in kinds
    }
    if not any(steps for both in steps_of_kind.values() for steps in both):
        return

    def draw(axes: Any) -> None:
        for axis, (kind, name) in zip(axes, kinds, strict=True):
            axis.plot([-0.2, 0, 0, 1.2], [0, 0, 1, 1], color=COMMAND, linestyle="--", linewidth=1.2, label="command")
            for (side, colour, measured), steps in zip(_sides(comparison), steps_of_kind[kind], strict=True):
                curves = [_normalised(measured, step, kind) for step in steps]
                for curve in curves:
                    axis.plot(_GRID, curve, color=colour, alpha=0.18, linewidth=0.8)
                if curves:
                    middle = np.nanmedian(np.array(curves), axis=0)
                    axis.plot(_GRID, middle, color=colour, linewidth=2.0, label=f"{side}, median of {len(steps)}")
            axis.set(
                title=name, xlabel="seconds after the command", ylabel="part of the step", xlim=(-0.1, 1.1), ylim=(-0.15, 1.35)
            )
            axis.legend(loc="lower right")

    yield _plot("Steps of the command", "Velocity by odometry after steps of cmd_vel, each divided by the step.", 2, draw)


_GRID: F64 = np.linspace(-0.2, 1.2, 281)


def _normalised(measured: Measurements, step: Step, kind: str) -> F64:
    odometry = measured.recording.odometry
    assert odometry is not None, "steps come from odometry"
    values = speeds(odometry)[kind == "angular"]
    curve = np.interp(step.time + _GRID, odometry.t, values)
    return np.asarray((curve - step.before) / (step.after - step.before), dtype=np.float64)


def _excerpts(comparison: Comparison) -> Iterator[Plot]:
    """Yields the 20 s of each recording with the most change, with the fitted model."""
    for side, colour, measured in _sides(comparison):
        fit, commands, odometry = measured.fit, measured.recording.commands, measured.recording.odometry
        if fit is None or commands is None or odometry is None:
            continue
        linear, angular = speeds(odometry)
        begin = _busiest(odometry.t, np.abs(np.gradient(fit.linear)) + 0.3 * np.abs(np.gradient(fit.angular)))
        rows = (odometry.t >= begin) & (odometry.t <= begin + 20.0)
        t = odometry.t[rows]
        series = (
            ("forward, m/s", held(commands.t, commands.linear, t, 0.5), linear[rows], fit.linear[rows]),
            ("turning, rad/s", held(commands.t, commands.angular, t, 0.5), angular[rows], fit.angular[rows]),
        )

        def draw(axes: Any, t: F64 = t, series: Any = series, colour: str = colour) -> None:
            for axis, (name, commanded, reported, model) in zip(axes, series, strict=True):
                axis.plot(t, commanded, color=COMMAND, linestyle="--", linewidth=1.2, label="command")
                axis.plot(t, reported, color=colour, linewidth=1.4, label="odometry")
                axis.plot(t, model, color=MODEL, linewidth=0.9, label="fitted drive")
                axis.set(title=name, xlabel="seconds")
            axes[0].legend(loc="best", ncols=3, fontsize=8)

        caption = f"Delay {1e3 * fit.delay.value:.0f} ms; the model leaves {1e3 * fit.linear_rms:.1f} mm/s and {fit.angular_rms:.3f} rad/s (rms)."
        yield _plot(f"Commands and odometry, {side}", caption, 2, draw)


def _busiest(t: F64, change: F64) -> float:
    """Returns the start of the 20 s with the most change, seconds."""
    total = np.concatenate([[0.0], np.cumsum(change)])
    ends = np.searchsorted(t, t + 20.0)
    return float(t[int(np.argmax(total[ends] - total[: len(t)]))])


def _paths(comparison: Comparison) -> Iterator[Plot]:
    shown = [(side, colour, m.recording) for side, colour, m in _sides(comparison) if m.recording.odometry is not None]
    if not shown:
        return

    def draw(axes: Any) -> None:
        for axis, (side, colour, recording) in zip(axes, shown, strict=True):
            odometry, truth = recording.odometry, recording.truth
            assert odometry is not None, "only such are shown"
            x, y = odometry.x, odometry.y
            if truth is not None:
                axis.plot(truth.x, truth.y, color=MODEL, linewidth=1.8, label=truth.source)
                at = truth.at(odometry.t[:1] if odometry.t[0] >= truth.t[0] else truth.t[:1])
                begin = np.array([float(at[0][0]), float(at[1][0]), float(at[2][0])])
                turn = begin[2] - float(odometry.yaw[0])
                dx, dy = x - x[0], y - y[0]
                x, y = begin[0] + dx * np.cos(turn) - dy * np.sin(turn), begin[1] + dx * np.sin(turn) + dy * np.cos(turn)
            axis.plot(x, y, color=colour, linewidth=1.4, label=odometry.source)
            axis.plot(x[:1], y[:1], "o", color=MODEL, markersize=5)
            axis.set(title=side, xlabel="x, m", ylabel="y, m")
            axis.set_aspect("equal", adjustable="datalim")
            axis.legend(loc="best", fontsize=8)

    yield _plot("Paths", "Odometry laid onto the true path at its start (dot).", len(shown), draw, 4.2)


def _allan(comparison: Comparison) -> Iterator[Plot]:
    shown = [(side, colour, m.imu) for side, colour, m in _sides(comparison) if m.imu is not None]
    if not shown:
        return

    def draw(axes: Any) -> None:
        for axis, (name, unit) in zip(axes, (("gyro", "rad/s"), ("accel", "m/s²")), strict=True):
            for side, colour, imu in shown:
                assert imu is not None, "only such are shown"
                curve, model = getattr(imu, f"{name}_curve"), getattr(imu, name)
                if not curve.deviation.any():
                    continue
                axis.loglog(curve.tau, curve.deviation, "o-", color=colour, markersize=3, linewidth=1.2, label=side)
                axis.loglog(curve.tau, model.density / np.sqrt(curve.tau), "--", color=colour, linewidth=0.9)
            axis.set(title={"gyro": "gyroscope", "accel": "accelerometer"}[name], xlabel="averaging time, s", ylabel=unit)
            if axis.get_legend_handles_labels()[0]:
                axis.legend(loc="best")

    rest = ", ".join(f"{side} {imu.rest_s:.0f} s" for side, _, imu in shown if imu is not None)
    caption = f"Overlapping Allan deviation at rest ({rest}), all axes together; dashed: white noise of the density found."
    yield _plot("IMU noise", caption, 2, draw)


def _lidar(comparison: Comparison) -> Iterator[Plot]:
    shown = [
        (f"{side} against the map", colour, m.map_residuals)
        for side, colour, m in _sides(comparison)
        if m.map_residuals is not None
    ]
    if comparison.scan_residuals is not None:
        shown.append(("real minus simulated, same poses", "#047857", comparison.scan_residuals))
    if not shown:
        return

    def draw(axes: Any) -> None:
        bins = np.linspace(-150.0, 150.0, 76)
        for name, colour, residuals in shown:
            assert residuals is not None, "only such are shown"
            values = 1e3 * residuals.values
            axes[0].hist(values, bins=bins, weights=np.full(len(values), 100.0 / len(values)), histtype="step", color=colour,
                         linewidth=1.6, label=f"{name}: {1e3 * residuals.bias:+.1f} ± {1e3 * residuals.spread:.1f} mm")  # fmt: skip
        axes[0].set(xlabel="measured minus expected range, mm", ylabel="% of beams")
        axes[0].legend(loc="upper right", fontsize=8)

    yield _plot("Lidar residuals", "Beams within 0.3 m of what was expected: median and spread.", 1, draw, 2.8)


def _luma(comparison: Comparison) -> Iterator[Plot]:
    matched, real, sim = comparison.pictures, comparison.real.recording.pictures, comparison.sim.recording.pictures
    if matched is None or real is None or sim is None:
        return

    def draw(axes: Any) -> None:
        for name, colour, pictures, column in (("real", REAL, real, 0), ("simulated", SIM, sim, 1)):
            histogram = 100.0 * pictures.histograms[matched.pairs[:, column]].mean(axis=0)
            axes[0].stairs(histogram, np.linspace(0.0, 1.0, len(histogram) + 1), color=colour, linewidth=1.6, label=name)
        axes[0].set(xlabel="luma, 0 black to 1 white", ylabel="% of pixels", xlim=(0.0, 1.0))
        axes[0].legend(loc="best")

    yield _plot("Brightness of images", f"Mean over {len(matched.pairs)} pairs at the same poses.", 1, draw, 2.6)
