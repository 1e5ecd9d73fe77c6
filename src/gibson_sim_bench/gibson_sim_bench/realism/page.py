"""Reports of ``bench realism``: text for the terminal, and an HTML page with the worst pairs of pictures."""

from __future__ import annotations

import base64
import html
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from gibson_sim.quoting import duration_text
from gibson_sim.writing import write_file
from gibson_sim_bench.realism.causes import CAUSES
from gibson_sim_bench.realism.measure import Pair, RealismReport, SceneResult
from gibson_sim_bench.reports.render import table

_POLICY = "default-src 'none'; img-src data:; style-src 'unsafe-inline'"
_STYLE = (
    "body{font:15px/1.5 system-ui,sans-serif;margin:2em auto;max-width:1100px;padding:0 1em;color:#222}"
    "table{border-collapse:collapse;margin:1em 0}td,th{padding:.2em .7em;border-bottom:1px solid #ddd;text-align:right}"
    "td:first-child,th:first-child{text-align:left}img{max-width:100%}figure{margin:1.5em 0}.quiet{color:#666}"
)
_GAIN = 3
"""Factor of the errors in pictures of the difference, which are grey where it is 0."""
_COLUMNS = (
    ("psnr", "PSNR", "{:.1f}"), ("psnr_worst_tenth", "worst tenth", "{:.1f}"), ("psnr_worst", "worst", "{:.1f}"),
    ("psnr_inside", "inside", "{:.1f}"), ("psnr_moves", "moves", "{:.1f}"), ("psnr_still", "still", "{:.1f}"), ("ssim", "SSIM", "{:.3f}"),
    ("flip", "FLIP", "{:.3f}"), ("flip_worst", "worst", "{:.3f}"), ("noise_psnr", "noise", "{:.1f}"), ("same_depth", "same depth", "{:.1%}"),
)  # fmt: skip
"""Value of a summary, heading, format."""


def report_text(report: RealismReport, *, markdown: bool = False) -> str:
    """Returns the report as text: figures and shares of the causes of each scene."""
    plan = report.plan
    head = [
        f"{report.facts.text}.",
        f"{plan.poses} poses of each scene by seed {plan.seed}, {plan.width}x{plan.width * 3 // 4}; {plan.samples} paths per pixel; ours with "
        f"{plan.antialiasing} colour sample{'s' if plan.antialiasing > 1 else ''} per pixel; took {duration_text(report.wall_s)}.",
        "One exposure and white balance for all traced pictures of a scene, fitted to ours.",
    ]
    figures = table(("scene", *(title for _, title, _ in _COLUMNS)), _figures(report), markdown)
    shares = [(s.scene, *(f"{s.summary[f'share_{cause}']:.0%}" for cause in CAUSES)) for s in report.scenes]
    notes = [f"{scene.scene}: {warning}" for scene in report.scenes for warning in scene.warnings]
    parts = ["\n".join(f"- {line}" for line in head) if markdown else "\n".join(head), figures]
    parts += ["Share of the squared error:", table(("scene", *CAUSES), shares, markdown)]
    return "\n\n".join([*parts, *notes])


def _figures(report: RealismReport) -> list[tuple[str, ...]]:
    return [(scene.scene, *(style.format(scene.summary[key]) for key, _, style in _COLUMNS)) for scene in report.scenes]


def write_page(report: RealismReport, path: Path, worst: int) -> None:
    """Writes the page, a self-contained file.

    Args:
        report: the measurements, with pictures.
        path: the file.
        worst: number of pairs of each scene, those with the lowest PSNR.
    """
    parts = ["<h1>Our pictures beside path-traced ones</h1>", f"<p class=quiet>{html.escape(report.facts.text)}</p>"]
    head = "".join(f"<th>{title}</th>" for title in ("scene", *(title for _, title, _ in _COLUMNS), *CAUSES))
    rows = []
    for scene, figures in zip(report.scenes, _figures(report), strict=True):
        shares = (f"{scene.summary[f'share_{cause}']:.0%}" for cause in CAUSES)
        rows.append("".join(f"<td>{html.escape(cell)}</td>" for cell in (*figures, *shares)))
    parts.append(f"<table><tr>{head}</tr>{''.join(f'<tr>{row}</tr>' for row in rows)}</table>")
    parts.append(
        f"<p class=quiet>Each row of pictures: ours, path-traced, their difference times {_GAIN} about grey. "
        "PSNR in dB; the last columns are the shares of the causes in the squared error.</p>"
    )
    for scene in report.scenes:
        parts.append(f"<h2>{html.escape(scene.scene)}</h2>")
        parts += [_figure(scene, index) for index in worst_poses(scene, worst)]
    write_file(
        path,
        "<!doctype html><html lang=en><head><meta charset=utf-8><title>Realism</title>"
        f'<meta http-equiv="Content-Security-Policy" content="{_POLICY}"><style>{_STYLE}</style></head>'
        f"<body>{''.join(parts)}</body></html>\n",
    )


def worst_poses(scene: SceneResult, count: int) -> list[int]:
    """Returns the indices of the poses with the lowest PSNR, the worst first."""
    return sorted(range(len(scene.poses)), key=lambda index: scene.poses[index].psnr)[:count]


def _figure(scene: SceneResult, index: int) -> str:
    pose = scene.poses[index]
    largest = ", ".join(
        f"{cause} {pose.causes[cause].share:.0%}" for cause in sorted(CAUSES, key=lambda c: -pose.causes[c].share)[:3]
    )
    text = f"Pose {index}: {pose.where}. PSNR {pose.psnr:.1f} dB, SSIM {pose.ssim:.3f}, FLIP {pose.flip:.3f}; {largest}."
    if pose.moved:
        text += f" Moved: {', '.join(pose.moved)}."
    encoded, data = cv2.imencode(".png", cv2.cvtColor(side_by_side(scene.pairs[index]), cv2.COLOR_RGB2BGR))
    assert encoded
    picture = base64.b64encode(data.tobytes()).decode()
    return f'<figure><img alt="" src="data:image/png;base64,{picture}"><figcaption>{html.escape(text)}</figcaption></figure>'


def side_by_side(pair: Pair) -> NDArray[np.uint8]:
    """Returns ours, the traced picture, and their difference about grey, (H, 3 W, 3)."""
    difference = 128.0 + _GAIN * (pair.ours.astype(np.float64) - pair.truth)
    return np.hstack([pair.ours, pair.truth, np.clip(difference, 0.0, 255.0).astype(np.uint8)])
