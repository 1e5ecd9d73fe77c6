"""Checks a scene for problems: orientation, unit, meshes, textures, floors, start poses, views, splats, files.

Among them are pieces of free floor that are separated only by a gap in the scan.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from gibson_sim.description.omissions import Omission, OmissionKind, kind_of
from gibson_sim.errors import GibsonSimError, SceneError
from gibson_sim.formats.image_header import MAX_PIXELS
from gibson_sim.geometry.triangle_meshes import areas_of, unit_normals
from gibson_sim.maps.floor_map import FLOOR_TOLERANCE, FloorMap, scene_floor_map
from gibson_sim.quoting import quoted
from gibson_sim.scenes.load import load_scene
from gibson_sim.scenes.spec import SceneSpec
from gibson_sim_tools.importing.checks.facts import (
    DrawnGeometry,
    SceneFacts,
    declares_up,
    original_up,
    scene_facts,
    scene_geometry,
)
from gibson_sim_tools.importing.checks.faults import MeshFaults, find_faults
from gibson_sim_tools.importing.checks.gravity import ALIGNED_DEG, ON_ITS_SIDE_DEG, UpGuess, direction_text, guess_up, size_text
from gibson_sim_tools.importing.checks.splats import LARGE_SPLAT, MAX_SPLAT_DISTANCE, splat_distance
from gibson_sim_tools.importing.document import ASSETS, MIN_SCAN_SHARE, MIN_SCAN_TRIANGLES, read_left_out
from gibson_sim_tools.importing.scene_files import is_partly_finished, missing_items, outdated_items
from gibson_sim_tools.view_holes import ROBOT_HEIGHT, ROBOT_RADIUS, ViewHoles, view_holes

Level = Literal["error", "warning", "note"]
MAX_SIDE = 8192
"""Longest side of a texture supported by all GPUs and viewers, pixels."""
MAX_MEMORY_MB = 2048.0
"""Limit on the memory of all textures, MB."""
MIN_HOLE_LENGTH = 0.3
"""Minimum boundary length of a reported hole, m."""
MIN_VIEW_HOLES, VIEW_HOLES_WARNING = 0.001, 0.02
"""Fraction of holes in a robot's views from which they are reported, and above which they are a warning in a scan."""
NEED_UPRIGHT = {"no-floor", "floor-faces-down", "no-room", "start-blocked", "islands", "out-of-date", "view-holes"}
"""Findings that are meaningful only for an upright scene in metres."""
_MIN_FLOOR_AREA = 1.0
"""Minimum area of level surface at the height of a floor, m^2."""
_INVERTED_SHARE = 0.001
"""Fraction of inverted triangles above which they are a warning."""
_DEGENERATE_SHARE, _MIN_DEGENERATE = 0.01, 100
"""Fraction and number of degenerate triangles above which they are a warning."""
Bools = NDArray[np.bool_]
_NEAR_SCAN = 1.0
"""Distance to scanned floor within which unscanned cells may be floor, m."""
_MIN_AREA = 0.3
"""Minimum area of a reported piece, m^2."""


@dataclass(frozen=True, slots=True)
class SceneFinding:
    """One problem or note."""

    what: str
    """Identifier of its kind, such as ``not-level``."""
    level: Level
    """Severity: with an error the scene cannot be used as it is; a warning is a fault; a note is not a fault."""
    text: str
    remedy: str = ""
    fixable: bool = False
    """Whether ``--fix`` repairs it."""
    amount: float = 1.0
    """Amount, in the measure of its kind: faces, edges, metres, pieces, degrees, share of the views."""

    def line(self) -> str:
        """Returns the finding as one line of text, and its remedy as another."""
        return f"{self.level:>7}  {self.what}: {self.text}" + (f"\n         -> {self.remedy}" if self.remedy else "")


@dataclass(frozen=True, slots=True, eq=False)
class SceneReport:
    """Findings and facts of a scene."""

    findings: tuple[SceneFinding, ...]
    facts: SceneFacts | None = None
    """Facts; None if the scene cannot be read."""
    scene: SceneSpec | None = None
    geometry: DrawnGeometry | None = None
    free_floor: float | None = None
    """Free area for a robot of ``ROBOT_RADIUS`` on all floors together, m^2; None = the scene cannot be mapped."""

    @property
    def amounts(self) -> dict[str, float]:
        """Total amount of each kind of finding."""
        out: dict[str, float] = {}
        for finding in self.findings:
            out[finding.what] = out.get(finding.what, 0.0) + finding.amount
        return out

    @property
    def clean(self) -> bool:
        """Whether the scene has no errors and no warnings."""
        return all(finding.level == "note" for finding in self.findings)

    def json(self) -> dict[str, Any]:
        """Returns the report as plain values for JSON."""
        findings = [
            {"what": f.what, "level": f.level, "text": f.text, "remedy": f.remedy, "fixable": f.fixable, "amount": f.amount}
            for f in self.findings
        ]
        facts = None if self.facts is None else self.facts.json()
        return {"clean": self.clean, "findings": findings, "free_floor_m2": self.free_floor, "scene": facts}


def check_path(path: str | Path) -> SceneReport:
    """Loads and checks a scene; if it cannot be loaded, the report has one error."""
    try:
        return check_scene(load_scene(path))
    except GibsonSimError as e:
        return SceneReport((SceneFinding("unreadable", "error", str(e)),))


def check_scene(scene: SceneSpec) -> SceneReport:
    """Checks a loaded scene.

    Raises:
        MeshError: a mesh cannot be read.
    """
    geometry = scene_geometry(scene)
    guess = guess_up(geometry.vertices, geometry.triangles, original_up(scene), declares_up(scene))
    facts = scene_facts(scene, geometry, guess)
    faults, maps = _faults(geometry), _maps(scene, facts)
    findings = [
        *_orientation(facts, guess), *_unit(facts), *_mesh_findings(geometry, faults), *_textures(facts), *_floor(scene, geometry, facts),
        *_starts(scene, maps), *_views(scene, geometry, faults, maps), *_omissions(scene, geometry, guess), *_scene_files(scene),
        *_splats(scene, geometry),
    ]  # fmt: skip
    order = {"error": 0, "warning": 1, "note": 2}
    floor_maps = [m for m in maps.values() if isinstance(m, FloorMap)]
    free_area = sum(float(m.inflate(ROBOT_RADIUS).sum()) * m.resolution**2 for m in floor_maps)
    return SceneReport(tuple(sorted(findings, key=lambda f: order[f.level])), facts, scene, geometry, free_area if maps else None)


def _orientation(facts: SceneFacts, guess: UpGuess) -> Iterator[SceneFinding]:
    if not guess.sure:
        listed = "; ".join(direction_text(up) for up in guess.others)
        text = f"which way is up is not clear: it may be {listed}"
        remedy = f"view the scene, then: --fix --up={direction_text(guess.others[0])} rotates it to make this up; --up=z keeps it as it is"
        yield SceneFinding("up-unclear", "warning", text, remedy)
    elif facts.tilt_deg > ON_ITS_SIDE_DEG:
        text = f"up is {direction_text(guess.up)}, {facts.tilt_deg:.1f} degrees off z: the scene lies on its side or is rotated"
        yield SceneFinding(
            "not-level", "warning", text, "--fix rotates it; or give up_axis or pose in scene.yaml", True, facts.tilt_deg
        )
    elif facts.tilt_deg > ALIGNED_DEG:
        text = f"the floor is {facts.tilt_deg:.2f} degrees out of level: objects roll, and maps have false obstacles"
        yield SceneFinding("not-level", "warning", text, "--fix rotates it", True, facts.tilt_deg)


def _unit(facts: SceneFacts) -> Iterator[SceneFinding]:
    if facts.unit == "m":
        return
    yield SceneFinding(
        "not-metres", "warning", f"it is {size_text(facts.size)}",
        f"--fix --unit {facts.unit or 'UNIT'} scales it; or give unit_m in scene.yaml",
        bool(facts.unit),
    )  # fmt: skip


def _faults(geometry: DrawnGeometry) -> dict[int, MeshFaults]:
    """Returns the faults of each mesh, by its ``id()``; a mesh with several instances is checked once."""
    out: dict[int, MeshFaults] = {}
    for visual, mesh in geometry.meshes:
        if id(mesh) not in out and visual.shape.kind == "mesh":
            out[id(mesh)] = find_faults(*mesh.merged())
    return out


def _is_scan(faults: MeshFaults) -> bool:
    return len(faults.degenerate) >= MIN_SCAN_TRIANGLES and faults.largest_piece > MIN_SCAN_SHARE


def _mesh_findings(geometry: DrawnGeometry, faults: Mapping[int, MeshFaults]) -> Iterator[SceneFinding]:
    instances = Counter(id(mesh) for _, mesh in geometry.meshes)
    names = {id(mesh): visual.name for visual, mesh in reversed(geometry.meshes)}
    for key, mesh_faults in faults.items():
        for finding in _findings_of_mesh(names[key], mesh_faults, len(mesh_faults.degenerate)):
            # A repaired copy has a separate mesh for each instance.
            yield replace(finding, amount=finding.amount * instances[key])


def _findings_of_mesh(name: str, faults: MeshFaults, count: int) -> Iterator[SceneFinding]:
    flat, inverted = int(faults.degenerate.sum()), int(faults.inverted.sum())
    if flat:
        level: Level = "warning" if flat > _DEGENERATE_SHARE * count and flat >= _MIN_DEGENERATE else "note"
        yield SceneFinding(
            "degenerate", level, f"{name}: {flat} of {count} triangles have no area", "--fix removes them", True, flat
        )
    if inverted:
        level = "warning" if inverted > _INVERTED_SHARE * count else "note"
        text = f"{name}: {inverted} of {count} triangles are wound opposite to their neighbours, or inside out"
        yield SceneFinding("inverted", level, text, "--fix flips them", True, inverted)
    # Holes in a scan are holes in walls.
    scan = _is_scan(faults)
    if faults.non_manifold_edges:
        level = "warning" if scan and faults.non_manifold_edges > 0.01 * count else "note"
        text = f"{name}: {faults.non_manifold_edges} edges belong to more than two triangles (non-manifold)"
        remedy = "harmless for driving; repair them before a convex decomposition"
        yield SceneFinding("non-manifold", level, text, remedy, amount=faults.non_manifold_edges)
    holes = [rim for rim in faults.holes if rim >= MIN_HOLE_LENGTH]
    if holes:
        text = (
            f"{name}: an open boundary of {holes[0]:.1f} m"
            if len(holes) == 1
            else f"{name}: {len(holes)} open boundaries of {MIN_HOLE_LENGTH} m and more, the longest {holes[0]:.1f} m, together {sum(holes):.1f} m"
        )
        remedy = "lidars and cameras see through holes in walls; close them in a mesh editor, or scan again" if scan else ""
        yield SceneFinding("holes", "warning" if scan else "note", text, remedy, amount=sum(holes))


def _textures(facts: SceneFacts) -> Iterator[SceneFinding]:
    for t in facts.textures:
        if max(t.width, t.height) > MAX_SIDE or t.width * t.height > MAX_PIXELS:
            text = f"{t.name}: has {t.width} x {t.height} pixels, {t.memory_mb:.0f} MB in memory; sides above {MAX_SIDE} are not supported everywhere"
            yield SceneFinding("huge-texture", "warning", text, f"--fix scales it down to {MAX_SIDE}", True)
    total = sum(t.memory_mb for t in facts.textures)
    if total > MAX_MEMORY_MB:
        text = f"all textures take {total:.0f} MB in memory, more than {MAX_MEMORY_MB:.0f}"
        yield SceneFinding("textures-memory", "warning", text, "--fix --max-texture 2048 scales them down", True, total)


def _floor(scene: SceneSpec, geometry: DrawnGeometry, facts: SceneFacts) -> Iterator[SceneFinding]:
    if not (facts.upright and (len(geometry.triangles) or scene.ground_z is not None)):
        return
    corners = geometry.vertices[geometry.triangles]
    normals, areas, heights = unit_normals(corners), areas_of(corners), corners[:, :, 2]
    for z in scene.floors:
        if scene.ground_z is not None and abs(scene.ground_z - z) <= FLOOR_TOLERANCE:
            continue
        is_level_near = (np.abs(heights - z) <= FLOOR_TOLERANCE).all(axis=1) & (np.abs(normals[:, 2]) > 0.95)
        up, down = (
            float(areas[is_level_near & (normals[:, 2] > 0)].sum()),
            float(areas[is_level_near & (normals[:, 2] < 0)].sum()),
        )
        if up + down < _MIN_FLOOR_AREA:
            text = f"no floor at z = {z:.2f} m: {up + down:.2f} m^2 of level surface at that height"
            yield SceneFinding(
                "no-floor",
                "warning",
                text,
                f"give floor_z in scene.yaml; the scene extends from {facts.low[2]:.2f} to {facts.high[2]:.2f} m",
            )
        elif up < 0.2 * down:
            text = f"the floor at z = {z:.2f} m faces down: {down:.1f} m^2 of it, against {up:.1f} m^2 that faces up"
            yield SceneFinding(
                "floor-faces-down", "warning", text, "the mesh may be inside out or upside down: give up_axis, or flip its faces"
            )


def _maps(scene: SceneSpec, facts: SceneFacts) -> dict[float, FloorMap | SceneError]:
    """Returns the map of each floor by its height, or the error that prevents it; empty if maps would be meaningless."""
    out: dict[float, FloorMap | SceneError] = {}
    for floor_z in scene.floors if facts.upright and facts.unit == "m" else ():
        try:
            out[floor_z] = scene_floor_map(replace(scene, floor_z=floor_z), robot_height=ROBOT_HEIGHT)
        except SceneError as e:
            out[floor_z] = e
    return out


def _starts(scene: SceneSpec, maps: Mapping[float, FloorMap | SceneError]) -> Iterator[SceneFinding]:
    for floor_z, floor in maps.items():
        starts = [s for s in scene.starts if abs(s.pose.position[2] - floor_z) < 0.5]
        if isinstance(floor, SceneError):
            yield SceneFinding("no-floor", "warning", str(floor), "give floor_z in scene.yaml")
            continue
        if not floor.inflate(ROBOT_RADIUS).any():
            yield SceneFinding("no-room", "warning", f"no free position on the floor at z = {floor_z:.2f} m for a robot of radius {ROBOT_RADIUS} m",
                          "is floor_z right, and the unit?")  # fmt: skip
        pieces = islands(floor, ROBOT_RADIUS)
        if pieces:
            text = (
                f"the free floor at z = {round(floor_z, 2) + 0.0:.2f} m is in {len(pieces)} pieces with unscanned floor between them: "
                f"{', '.join(f'{area:.1f}' for area in pieces[:6])}{', ...' if len(pieces) > 6 else ''} m^2"
            )
            yield SceneFinding(
                "islands",
                "warning",
                text,
                "robots stay on the piece they start on; scan the gaps, or close them with ground_z",
                amount=len(pieces),
            )
        for start in starts:
            x, y, _ = start.pose.position
            if float(floor.clearance(np.array([x, y]))) < ROBOT_RADIUS:
                free = floor.nearest_free((x, y), ROBOT_RADIUS)
                nearest = f"; the nearest free position is {free[0]:.2f}, {free[1]:.2f}" if free else ""
                yield SceneFinding("start-blocked", "warning", f"start {quoted(start.name)} at {x:.2f}, {y:.2f} is not free for a robot of radius "
                              f"{ROBOT_RADIUS} m{nearest}", "move it in scene.yaml")  # fmt: skip


def _views(
    scene: SceneSpec, geometry: DrawnGeometry, faults: Mapping[int, MeshFaults], maps: Mapping[float, FloorMap | SceneError]
) -> Iterator[SceneFinding]:
    # The surface of a scan is one-sided; modelled sheets, such as curtains, are two-sided.
    scans = [id(mesh) in faults and _is_scan(faults[id(mesh)]) for _, mesh in geometry.meshes]
    holes = robot_view_holes(scene, geometry, np.repeat(scans, [mesh.triangle_count for _, mesh in geometry.meshes]), maps)
    if holes is None or holes.share < MIN_VIEW_HOLES:
        return
    remedy = (
        "scan the missing parts, close the holes in a mesh editor, or fill them in images (--camera-fill)" if any(scans) else ""
    )
    level: Level = "warning" if any(scans) and holes.share > VIEW_HOLES_WARNING else "note"
    yield SceneFinding("view-holes", level, holes.text(), remedy, amount=holes.share)


def robot_view_holes(
    scene: SceneSpec, geometry: DrawnGeometry, one_sided: NDArray[np.bool_], maps: Mapping[float, FloorMap | SceneError]
) -> ViewHoles | None:
    """Measures the holes in a robot's views of a scene; None if the robot fits nowhere.

    Args:
        scene: the scene.
        geometry: geometry of the scene.
        one_sided: whether the back of each triangle is a hole, (F,).
        maps: maps of the floors, by height.
    """
    floors = [m for m in maps.values() if isinstance(m, FloorMap)]
    return view_holes(geometry.vertices[geometry.triangles], one_sided, floors, ROBOT_RADIUS, ground_z=scene.ground_z)


def _splats(scene: SceneSpec, geometry: DrawnGeometry) -> Iterator[SceneFinding]:
    if scene.splats is None:
        return
    distance = splat_distance(scene.splats, geometry.vertices[geometry.triangles], np.random.default_rng(0))
    if distance.median > MAX_SPLAT_DISTANCE:
        remedy = "--align-splats finds pose and scale (--fix does so for a copy); or give them under visual in scene.yaml"
        yield SceneFinding(
            "splats-apart",
            "error",
            f"{distance.text()}; at most {100.0 * MAX_SPLAT_DISTANCE:g} cm are allowed",
            remedy,
            True,
            distance.median,
        )
    else:
        yield SceneFinding("splats", "note", distance.text(), amount=distance.median)
    if distance.large:
        text = (
            f"{distance.large:,} of {distance.splats:,} splats have a standard deviation above {LARGE_SPLAT:g} m, the largest "
            f"{distance.largest:.0f} m: they may cover whole images"
        )
        yield SceneFinding("splats-large", "note", text, "delete them in SuperSplat, or correct the scale", amount=distance.large)
    if distance.without_rotation:
        text = f"{distance.without_rotation:,} of {distance.splats:,} splats have a quaternion of length 0 and are drawn without rotation"
        yield SceneFinding("splats-unrotated", "note", text, "export the splats again", amount=distance.without_rotation)


def _omissions(scene: SceneSpec, geometry: DrawnGeometry, guess: UpGuess) -> Iterator[SceneFinding]:
    for line in left_out(scene, geometry):
        if kind_of(line) is OmissionKind.UP_UNCLEAR:
            if guess.sure and guess.tilt_deg <= ON_ITS_SIDE_DEG:
                yield SceneFinding(
                    "up-unclear",
                    "warning",
                    line,
                    "view the scene, then: --fix --up=z keeps it as it is; any other direction rotates it",
                )
            continue
        missing = kind_of(line) in (OmissionKind.MISSING_ASSET, OmissionKind.UNSUPPORTED_ASSET)
        texture = "texture" in line and missing
        yield SceneFinding(
            "missing-texture" if texture else "missing" if missing else "left-out", "warning" if missing else "note", line
        )


def left_out(scene: SceneSpec, geometry: DrawnGeometry) -> list[str]:
    """Returns the items of the scene, and of the source that it was imported from, that could not be used.

    Raises:
        SceneError: the list written by the import cannot be read.
    """
    lines: dict[str, Omission] = {}
    for line in (*scene.warnings, *(w for _, mesh in geometry.meshes for w in mesh.warnings), *read_left_out(scene.root)):
        short = line.replace(f"{scene.root}/", "")
        # A copied file is reported once, by its name in the source.
        lines.setdefault(short.replace(f"{ASSETS}/", ""), Omission(short, kind_of(line)))
    return list(lines.values())


def _scene_files(scene: SceneSpec) -> Iterator[SceneFinding]:
    for text in outdated_items(scene, ROBOT_RADIUS, ROBOT_HEIGHT):
        yield SceneFinding("out-of-date", "warning", text, "gibson-sim scene map SCENE --write updates it")
    lacking = missing_items(scene)
    if lacking and is_partly_finished(scene):
        remedy = "`gibson-sim scene map SCENE --write` writes maps and free poses; docs/scenes.md describes rooms"
        yield SceneFinding("unfinished", "note", f"a finished scene also has {', '.join(lacking)}", remedy)


def islands(floor: FloorMap, radius: float) -> tuple[float, ...]:
    """Returns the areas, m^2, of the pieces of free floor that would be connected if the unscanned cells between them were floor.

    Args:
        floor: map of the floor.
        radius: radius of the robot, metres.

    Returns:
        The largest piece first, then the pieces that gaps separate from it; empty without such pieces.
    """
    free_cells = floor.inflate(radius)
    labels, count = ndimage.label(free_cells)
    if count < 2:
        return ()
    areas = np.bincount(labels.ravel(), minlength=count + 1) * floor.resolution**2
    areas[0] = 0.0
    largest = int(areas.argmax())
    unknown = ~(floor.floor | floor.occupied)
    is_near_scan = ndimage.distance_transform_edt(~floor.free) * floor.resolution <= _NEAR_SCAN
    passable = np.pad(floor.free | (unknown & is_near_scan), 1, constant_values=False)
    clearance = ndimage.distance_transform_edt(passable)[1:-1, 1:-1] * floor.resolution
    joined_labels, _ = ndimage.label(free_cells | (clearance >= radius + floor.resolution * math.sqrt(0.5)))
    main_label = joined_labels[labels == largest][0]
    cut_off = [
        k
        for k in range(1, count + 1)
        if k != largest and areas[k] >= _MIN_AREA and (joined_labels[labels == k] == main_label).any()
    ]
    return tuple(float(areas[k]) for k in [largest, *sorted(cut_off, key=lambda k: -areas[k])]) if cut_off else ()
