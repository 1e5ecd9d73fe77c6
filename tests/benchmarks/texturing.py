"""Quality of textures from photographs, against known scenes and on real images: the tables and images of docs/texturing.md.

    python tests/benchmarks/texturing.py [--folder out/texturing] [--real FOLDER] [--json FILE] [--images DIR]

A scene is scanned in two resolutions (preset kinect, 200 images, with errors of exposure, white balance and pose), and fused to 100,000
triangles. A tenth of the photographs is held out. Compared are vertex colours, the best view of each triangle (no smoothness, no corrections,
no levelling) and ``scene texture``. In the smaller scan a figure is then inserted into a tenth of the photographs, and their depth images are
left out. ``--real`` is a folder of posed RGB-D, such as "livingroom1" of the augmented ICL-NUIM set: every second image textures the mesh of
all images, and that of these images alone. Scans and meshes stay in ``--folder``; a
second run uses them again. Needs Open3D.
"""

from __future__ import annotations

import argparse
import shutil
import subprocess
import sys
import time
from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from gibson_sim.cli.report_file import write_json
from gibson_sim.formats.load_mesh import load_mesh
from gibson_sim.geometry.transforms import pose_from_matrix
from gibson_sim.render.cache import default_folder
from gibson_sim.render.renderer import MeshFiles, Renderer
from gibson_sim.scenes.load import load_scene
from gibson_sim.types import CameraSpec, SceneState
from gibson_sim_bench import timing
from gibson_sim_tools.photographs.layouts import open_photographs
from gibson_sim_tools.scanning.clean_scene import static_scene
from gibson_sim_tools.scanning.posed_images import Photographs
from gibson_sim_tools.scanning.trajectories import read_stamped_poses
from gibson_sim_tools.scanning.triangle_mesh import TriangleMesh
from gibson_sim_tools.texturing.evaluation import RenderedImage, image_similarity, render_textured
from gibson_sim_tools.texturing.exposure import identity_exposures
from gibson_sim_tools.texturing.rasteriser import rasterise
from gibson_sim_tools.texturing.settings import TextureSettings
from gibson_sim_tools.texturing.surface import face_adjacency, project, surface_from_mesh
from gibson_sim_tools.texturing.texture import TexturedSurface, TextureReport, build_texture, collect_views, texture_surface

Bools = NDArray[np.bool_]
F32 = NDArray[np.float32]
F64 = NDArray[np.float64]
U8 = NDArray[np.uint8]

SCENE, FRAMES, TRIANGLES = "courtyard_flat", 200, 100_000
ERRORS = "--exposure-jitter-ev 0.3 --white-balance-jitter 0.06 --pose-noise-m 0.003 --pose-noise-deg 0.3 --drift-m 0 --drift-deg 0 --seed 1"
SIZES = {(640, 480): 0.015, (320, 240): 0.02}
"""Width and height of the photographs, pixels -> voxel size of the mesh, metres."""
REAL_STRIDES = (1, 2)
"""Meshes of real images are fused from every N-th."""
HOLD_OUT = 10
"""Every tenth photograph is held out, from the first."""
BEST_VIEW = TextureSettings(smoothness=0.0, poses=False, exposures=False, outliers=False, levelling="none")
"""The best view of each triangle, as it is."""
WITH_TRUE_GEOMETRY_M = 0.05
"""Largest distance between mesh and clean scene along the optical axis at which their colours are comparable, metres."""
PERSON_EVERY, PERSON_FROM = 10, 5
"""A figure stands in every tenth photograph, from the sixth."""


@dataclass(frozen=True, slots=True, eq=False)
class CleanScene:
    """Images of the scene itself at the poses of photographs: without noise, blur and other errors. In the place of ``Photographs``."""

    colours: tuple[U8, ...]
    """(H, W, 3) each, sRGB."""
    depths: tuple[F32, ...]
    """(H, W) each, metres along the optical axis."""

    def __len__(self) -> int:
        return len(self.colours)

    def image(self, number: int) -> U8:
        """Returns an image, (H, W, 3) uint8, sRGB."""
        return self.colours[number]

    @classmethod
    def of(cls, scene: str, photographs: Photographs) -> CleanScene:
        """Renders a scene at the poses of photographs."""
        drawn = static_scene(load_scene(scene))
        colours, depths = [], []
        with Renderer(drawn, meshes=MeshFiles(cache=default_folder())) as renderer:
            for number, item in enumerate(photographs.items):
                intrinsics = photographs.intrinsics(number)
                camera = CameraSpec(
                    "clean", "", pose_from_matrix(item.T_world_camera), intrinsics.width, intrinsics.height, near=0.03,
                    matrix=tuple(intrinsics.matrix.ravel().tolist()), outputs=("rgb", "depth"), samples=4,
                )  # fmt: skip
                frame = renderer.render(SceneState.still(drawn.revision), [camera])[0]
                assert frame.rgb is not None and frame.depth is not None
                colours.append(frame.rgb)
                depths.append(frame.depth)
        return cls(tuple(colours), tuple(depths))


def main() -> None:
    """Prints the tables as they are made."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--folder", type=Path, default=Path("out/texturing"), help="scans and meshes")
    parser.add_argument("--real", type=Path, help="folder of posed RGB-D, every second image textures")
    parser.add_argument("--json", type=Path)
    parser.add_argument("--images", type=Path, help="write texturing_seams.jpg and texturing_person.jpg here")
    args = parser.parse_args()
    args.folder.mkdir(parents=True, exist_ok=True)
    found: dict[str, Any] = {
        "date": timing.now(), "version": timing.version(), "machine": timing.machine(), "cores": timing.cores(), "scene": SCENE
    }  # fmt: skip
    for (width, height), voxel in SIZES.items():
        scan, surface = scanned(args.folder, width, height, voxel)
        found[f"{width}x{height}"] = compared(scan, surface, args.images if width == 320 else None)
        show(f"{width}x{height}", found[f"{width}x{height}"])
    found["person"] = with_a_person(args.folder, args.images)
    show("person", found["person"])
    if args.real is not None:
        for stride in REAL_STRIDES:
            name = f"real, stride {stride}"
            found[name] = on_real_images(args.folder, args.real, stride)
            show(name, found[name])
    if args.json is not None:
        write_json(args.json, found)


def show(title: str, values: dict[str, Any]) -> None:
    """Prints results, one line each."""
    print(f"{title}:")
    for name, value in values.items():
        print(f"  {name}: {value}", flush=True)


# Data


def scanned(folder: Path, width: int, height: int, voxel: float) -> tuple[Path, TriangleMesh]:
    """Returns the folder of a scan and its mesh, both from earlier runs if they are there."""
    scan, mesh = folder / f"scan_{width}x{height}", folder / f"mesh_{width}x{height}.ply"
    command(
        "scan", SCENE, "--preset", "kinect", "--frames", str(FRAMES), "--width", str(width), "--height", str(height), *ERRORS.split(),
        "--output", str(scan),
    )  # fmt: skip
    if not mesh.exists():
        command("fuse", str(scan), "--triangles", str(TRIANGLES), "--voxel", str(voxel), "--output", str(mesh))
    return scan, surface_from_mesh(load_mesh(mesh, [mesh.parent]))


def command(*words: str) -> None:
    """Runs a command of ``gibson-sim scene``."""
    subprocess.run([sys.executable, "-m", "gibson_sim.cli.main", "scene", *words], check=True, stdout=subprocess.DEVNULL)


# Textures compared


def compared(scan: Path, surface: TriangleMesh, images: Path | None) -> dict[str, Any]:
    """Returns the results of the three ways to colour a mesh, on held-out photographs and against the clean scene."""
    photographs = open_photographs(scan)
    held_out = range(0, len(photographs), HOLD_OUT)
    true = photographs.with_poses(read_stamped_poses(scan / "true_poses.txt")[1])
    started = time.process_time()
    textured = texture_surface(surface, photographs, TextureSettings(), held_out=held_out)
    seconds = time.process_time() - started
    best = texture_surface(surface, photographs, BEST_VIEW, held_out=held_out)
    true_held_out = true.subset(held_out)
    clean = CleanScene.of(SCENE, true_held_out)
    corrected = textured.photographs.subset(held_out)
    clean_corrected = CleanScene.of(SCENE, corrected)
    ways = {"vertex colours": (textured, surface_colours(textured)), "best view": (best, None), "scene texture": (textured, None)}
    similarity: dict[str, Any] = {}
    for name, (way, colours) in ways.items():
        similarity[name] = {
            "held-out photographs at true poses": similar(true_held_out, true_held_out, way, colours, clean.depths),
            "clean scene at true poses": similar(clean, true_held_out, way, colours, clean.depths),
        }
        if name != "best view":
            similarity[name]["held-out photographs at corrected poses"] = similar(
                corrected, corrected, way, colours, clean_corrected.depths
            )
    seams = levelled_seams(textured, photographs)
    if images is not None:
        write_seams(images / "texturing_seams.jpg", photographs, textured, seams)
    return {
        **similarity,
        "patches": {"best view": best.report.patches, "scene texture": textured.report.patches},
        "loss of quality": round(textured.report.quality_loss, 4),
        "step over seams, of 255": {
            "best view": steps(best.report),
            "exposures uncorrected": steps(seams["original photographs"].report),
            "scene texture": steps(textured.report),
        },
        "error of the poses, pixels": {
            "given": round(pose_error_px(surface, photographs, true), 2),
            "corrected": round(pose_error_px(surface, textured.photographs, true), 2),
        },
        "processor time, s": round(seconds, 1),
    }


def surface_colours(textured: TexturedSurface) -> U8:
    """Returns the vertex colours of the fused mesh, (V, 3) uint8."""
    assert textured.surface.colors is not None, "scene fuse colours its mesh"
    return textured.surface.colors


def similar(
    reference: Photographs | CleanScene, poses: Photographs, textured: TexturedSurface, colours: U8 | None, depths: Sequence[F32]
) -> dict[str, Any]:
    """Returns PSNR and SSIM over all pixels that show a textured triangle, and over those whose geometry is that of the scene.

    Args:
        reference: images to compare with.
        poses: photographs with the poses and intrinsics of ``reference``.
        textured: the textured surface.
        colours: (V, 3) uint8, vertex colours in place of the texture; None = the texture.
        depths: (H, W) each, metres: depth of the clean scene at these poses.
    """

    def rendered(number: int, *, true_geometry: bool) -> RenderedImage:
        intrinsics, pose = poses.intrinsics(number), poses.items[number].T_world_camera
        image = render_textured(textured, intrinsics, pose, vertex_colors=colours)
        if not true_geometry:
            return image
        depth = rasterise(textured.surface, intrinsics, pose).depth
        return replace(image, compared=image.visible & np.isclose(depth, depths[number], rtol=0.0, atol=WITH_TRUE_GEOMETRY_M))

    results = {}
    for name, true_geometry in (("all", False), ("true geometry", True)):
        found = image_similarity(reference, lambda number: rendered(number, true_geometry=true_geometry))  # type: ignore[arg-type]  # noqa: B023
        results[name] = {"psnr": round(found.psnr, 2), "ssim": round(found.ssim, 3), "pixels": found.pixels}
    results["share of true geometry"] = round(results["true geometry"]["pixels"] / max(results["all"]["pixels"], 1), 3)
    return results


def steps(report: TextureReport) -> dict[str, Any]:
    """Returns the mean steps over seams by stage of levelling: point by point, and of the means of edges."""
    return {
        "points": {name: round(value, 2) for name, value in report.seam_steps.items()},
        "edge means": {name: round(value, 2) for name, value in report.edge_steps.items()},
    }


def pose_error_px(surface: TriangleMesh, photographs: Photographs, true: Photographs) -> float:
    """Returns the mean distance in the images between the centres of visible triangles at the given and at the true poses, pixels."""
    centres, sums, count = surface.corners.mean(axis=1), 0.0, 0
    for number, item in enumerate(photographs.items):
        intrinsics, truth = photographs.intrinsics(number), true.items[number].T_world_camera
        faces = np.unique(rasterise(surface, intrinsics, truth).face)
        points = centres[faces[faces >= 0]]
        uv, z = project(points, intrinsics, item.T_world_camera)
        true_uv, true_z = project(points, intrinsics, truth)
        distances = np.linalg.norm(uv - true_uv, axis=1)[(z > 0.1) & (true_z > 0.1)]
        sums, count = sums + float(distances.sum()), count + len(distances)
    return sums / max(count, 1)


def levelled_seams(textured: TexturedSurface, given: Photographs) -> dict[str, TexturedSurface]:
    """Returns the texture of the same views at each stage: original photographs, exposures corrected, global and local levelling."""
    surface, adjacency = textured.surface, face_adjacency(textured.surface.triangles)
    stages = {
        "original photographs": (identity_exposures(len(given)), "none"),
        "exposures corrected": (textured.exposures, "none"),
        "global levelling": (textured.exposures, "global"),
        "local levelling": (textured.exposures, "both"),
    }
    return {
        name: build_texture(
            surface,
            textured.photographs,
            textured.labels,
            exposures,
            adjacency,
            TextureSettings(levelling=levelling),
            TextureReport(),
        )
        for name, (exposures, levelling) in stages.items()
    }


def write_seams(file: Path, photographs: Photographs, textured: TexturedSurface, seams: dict[str, TexturedSurface]) -> None:
    """Writes an image of the stages of levelling, from left to right, at the poses of three held-out photographs."""
    numbers = range(0, len(photographs), HOLD_OUT)[2:17:5]
    rows = [
        np.concatenate([
            render_textured(stage, photographs.intrinsics(k), textured.photographs.items[k].T_world_camera).rgb for stage in seams.values()
        ], axis=1)
        for k in numbers
    ]  # fmt: skip
    write(file, np.concatenate(rows))


def write(file: Path, rgb: F32) -> None:
    """Writes an image, (H, W, 3), 0 to 1."""
    cv2.imwrite(str(file), np.rint(255.0 * np.clip(rgb, 0.0, 1.0)).astype(np.uint8)[:, :, ::-1], [cv2.IMWRITE_JPEG_QUALITY, 88])


# A person in some photographs


def figure(width: int, height: int, rng: np.random.Generator) -> tuple[U8, Bools]:
    """Returns a standing figure somewhere in an image, (H, W, 3) uint8, sRGB, and its mask, (H, W)."""
    rgb, mask = np.zeros((height, width, 3), dtype=np.uint8), np.zeros((height, width), dtype=np.uint8)
    x, unit = round(width * rng.uniform(0.25, 0.75)), height / 240.0

    def box(half_width: float, top: float, bottom: float, colour: tuple[int, int, int]) -> None:
        corners = (round(x - half_width * unit), round(top * unit)), (round(x + half_width * unit), round(bottom * unit))
        cv2.rectangle(rgb, *corners, colour, cv2.FILLED)
        cv2.rectangle(mask, *corners, 1, cv2.FILLED)

    box(32, 68, 148, (200, 35, 40))
    box(26, 149, 232, (15, 45, 140))
    cv2.circle(rgb, (x, round(48 * unit)), round(20 * unit), (240, 185, 155), cv2.FILLED)
    cv2.circle(mask, (x, round(48 * unit)), round(20 * unit), 1, cv2.FILLED)
    noise = rng.normal(0.0, 4.0, rgb.shape)
    return np.rint(np.clip(rgb + noise, 0, 255)).astype(np.uint8), mask != 0


def with_a_person(folder: Path, images: Path | None) -> dict[str, Any]:
    """Returns on how many triangles behind a figure the figure appears, with outliers kept and by default."""
    (width, height), voxel = (320, 240), SIZES[320, 240]
    scan, surface = scanned(folder, width, height, voxel)
    crowded, rng = folder / "scan_with_person", np.random.default_rng(0)
    if crowded.exists():
        shutil.rmtree(crowded)
    crowded.mkdir()
    photographs = open_photographs(scan)
    numbers = list(range(PERSON_FROM, len(photographs), PERSON_EVERY))
    masks, items = {}, list(photographs.items)
    for number in numbers:
        rgb, masks[number] = figure(width, height, rng)
        image = photographs.image(number)
        image[masks[number]] = rgb[masks[number]]
        file = crowded / f"{number:06d}.png"
        cv2.imwrite(str(file), image[:, :, ::-1])
        items[number] = replace(items[number], file=file, depth=None)
    crowd = replace(photographs, items=tuple(items))
    textures = {
        "outliers kept": texture_surface(surface, crowd, TextureSettings(outliers=False)),
        "default": texture_surface(surface, crowd, TextureSettings()),
    }
    split = textures["default"].surface
    corrected = textures["default"].photographs
    behind, others = np.zeros(len(split.triangles), dtype=bool), np.zeros(len(split.triangles), dtype=np.int64)
    views = collect_views(split, corrected)
    shows_figure = np.zeros(len(views), dtype=bool)
    for number in numbers:
        of_number = np.flatnonzero(views.photograph == number)
        shows_figure[of_number] = in_mask(split, views.face[of_number], corrected, number, masks[number])
    behind[views.face[shows_figure]] = True
    np.add.at(others, views.face[~shows_figure], 1)
    results: dict[str, Any] = {"triangles behind figures": int(behind.sum())}
    for least, name in ((0, "all"), (2, "shown by two or more other photographs")):
        some = behind & (others >= least)
        shown = {way: int((shows(texture, masks) & some).sum()) for way, texture in textures.items()}
        results[name] = {
            "triangles": int(some.sum()),
            **shown,
            "removed": round(1.0 - shown["default"] / shown["outliers kept"], 3),
        }
    if images is not None:  # of the two photographs whose figures appear most
        kept = textures["outliers kept"]
        appears = {k: int(shows(kept, {k: masks[k]}).sum()) for k in numbers}
        rows = [
            np.concatenate([
                crowd.image(k) / np.float32(255.0),
                *(render_textured(t, crowd.intrinsics(k), t.photographs.items[k].T_world_camera).rgb for t in textures.values()),
            ], axis=1)
            for k in sorted(numbers, key=lambda number: -appears[number])[:2]
        ]  # fmt: skip
        write(images / "texturing_person.jpg", np.concatenate(rows).astype(np.float32))
    return results


def shows(textured: TexturedSurface, masks: dict[int, Bools]) -> Bools:
    """Returns (F,), which triangles have the figure in their texture."""
    out = np.zeros(len(textured.labels), dtype=bool)
    for number, mask in masks.items():
        faces = np.flatnonzero(textured.labels == number)
        out[faces] = in_mask(textured.surface, faces, textured.photographs, number, mask)
    return out


def in_mask(surface: TriangleMesh, faces: NDArray[np.integer], photographs: Photographs, number: int, mask: Bools) -> Bools:
    """Returns (N,), which of the triangles have their centre at a pixel of a mask of a photograph."""
    uv = project(surface.corners[faces].mean(axis=1), photographs.intrinsics(number), photographs.items[number].T_world_camera)[0]
    column, row = np.rint(uv).astype(int).T
    inside = (row >= 0) & (row < mask.shape[0]) & (column >= 0) & (column < mask.shape[1])
    return np.asarray(inside & mask[row.clip(0, mask.shape[0] - 1), column.clip(0, mask.shape[1] - 1)])


# Real images


def on_real_images(folder: Path, real: Path, stride: int) -> dict[str, Any]:
    """Returns the results of textures on real images: every second one textures a mesh of every ``stride``-th, a tenth of these is held out."""
    mesh = folder / f"mesh_real_{stride}.ply"
    if not mesh.exists():
        command("fuse", str(real), "--triangles", str(TRIANGLES), "--stride", str(stride), "--output", str(mesh))
    surface = surface_from_mesh(load_mesh(mesh, [mesh.parent]))
    photographs = open_photographs(real)
    photographs = photographs.subset(range(0, len(photographs), 2))
    held_out = range(0, len(photographs), HOLD_OUT)
    started = time.process_time()
    textured = texture_surface(surface, photographs, TextureSettings(), held_out=held_out)
    seconds = time.process_time() - started
    corrected = textured.photographs.subset(held_out)

    def measured(colours: U8 | None) -> dict[str, Any]:
        def rendered(number: int) -> RenderedImage:
            pose = corrected.items[number].T_world_camera
            return render_textured(textured, corrected.intrinsics(number), pose, vertex_colors=colours)

        return {name: round(value, 3) for name, value in asdict(image_similarity(corrected, rendered)).items()}

    return {
        "photographs": len(photographs),
        "held out": len(held_out),
        "scene texture": measured(None),
        "vertex colours": measured(surface_colours(textured)),
        "patches": {"best view": textured.report.best_patches, "scene texture": textured.report.patches},
        "loss of quality": round(textured.report.quality_loss, 4),
        "step over seams, of 255": steps(textured.report),
        "processor time, s": round(seconds, 1),
    }


if __name__ == "__main__":
    main()
