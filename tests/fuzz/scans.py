"""Posed RGB-D in every layout: images, intrinsics, trajectories."""

from __future__ import annotations

import json
from pathlib import Path

import cv2
import numpy as np

from fuzz.grammar import Mutator
from fuzz.trial import Trial
from gibson_sim_tools.scanning.layouts import open_posed_rgbd
from gibson_sim_tools.scanning.trajectories import write_stamped_poses, write_trajectory_log

_WIDTH, _HEIGHT, _FRAMES = 12, 8, 3
_INTRINSICS = {"width": _WIDTH, "height": _HEIGHT, "intrinsic_matrix": [10.0, 0, 0, 0, 11.0, 0, 5.5, 3.5, 1]}
_FOCAL = (10.0, 11.0, 5.5, 3.5)
_POSES = np.stack([np.eye(4) + np.array([[0, 0, 0, k], [0] * 4, [0, 0, 0, 0.5], [0] * 4]) for k in range(_FRAMES)])


def make(mutator: Mutator, folder: Path) -> None:
    """Writes a set in one of the layouts."""
    top = folder / "set"
    layout = mutator.rng.choice((_open3d, _seven_scenes, _tum, _ours))
    layout(top)
    for _ in range(mutator.times()):
        files = sorted(p for p in top.rglob("*") if p.is_file())
        if not files:
            return
        texts = [p for p in files if p.suffix in (".txt", ".json", ".log")]
        path = mutator.rng.choice(texts) if texts and mutator.chance(0.7) else mutator.rng.choice(files)
        if path.suffix == ".json":
            path.write_bytes(
                mutator.file_text(json.dumps(mutator.tree(json.loads(path.read_text())))) if _is_json(path) else b"{"
            )
        elif path in texts and not mutator.harsh:
            path.write_text(_moved(mutator, path.read_text()))
        elif path in texts:
            path.write_bytes(mutator.lines(path.read_text(errors="replace")).encode(errors="surrogatepass"))
        elif mutator.harsh and mutator.chance(0.3):
            path.unlink()
        elif mutator.harsh and mutator.chance(0.5):
            path.write_bytes(mutator.data(path.read_bytes()))
        else:
            _repaint(mutator, path)
    (folder / "case.json").write_text(json.dumps({"focal": mutator.chance(0.9)}))


def _moved(mutator: Mutator, text: str) -> str:
    """Returns poses and times of which one place or time is other; rotations stay what they are."""
    rows = text.split("\n")
    k = mutator.rng.randrange(len(rows))
    words = rows[k].split()
    place = [
        i
        for i, word in enumerate(words)
        if "." in word and (i in (0, 1, 2, 3) if len(words) in (2, 8) else i == 3 and len(words) == 4)
    ]
    if place:
        i = mutator.rng.choice(place)
        words[i] = mutator.numbers_in(words[i])
        rows[k] = " ".join(words)
    return "\n".join(rows)


def _is_json(path: Path) -> bool:
    try:
        json.loads(path.read_text())
    except ValueError:
        return False
    return True


def _repaint(mutator: Mutator, path: Path) -> None:
    """Gives an image other values, another depth, or another size."""
    old = cv2.imdecode(np.fromfile(path, dtype=np.uint8), cv2.IMREAD_UNCHANGED)
    if old is None:
        return
    if mutator.harsh and mutator.chance(0.4):
        width, height = mutator.rng.choice(((1, 1), (_WIDTH, _HEIGHT + 1), (4000, 3000)))
        old = np.zeros((height, width, *old.shape[2:]), dtype=mutator.rng.choice((np.uint8, np.uint16)))
    else:
        old = np.random.default_rng(mutator.rng.randrange(2**32)).integers(0, np.iinfo(old.dtype).max, old.shape, dtype=old.dtype)
    ok, data = cv2.imencode(path.suffix if path.suffix == ".png" or old.dtype == np.uint8 else ".png", old)
    assert ok
    path.write_bytes(data.tobytes())


def _images(color: Path, depth: Path, k: int) -> None:
    for path in (color, depth):
        path.parent.mkdir(parents=True, exist_ok=True)
    cv2.imwrite(str(color), np.full((_HEIGHT, _WIDTH, 3), (10, 20, 100 + 10 * k), dtype=np.uint8))
    cv2.imwrite(str(depth), np.full((_HEIGHT, _WIDTH), 1500, dtype=np.uint16))


def _open3d(top: Path) -> None:
    for k in range(_FRAMES):
        _images(top / "image" / f"{k:05d}.png", top / "depth" / f"{k:05d}.png", k)
    write_trajectory_log(top / "trajectory.log", _POSES)
    (top / "camera_intrinsic.json").write_text(json.dumps(_INTRINSICS))


def _seven_scenes(top: Path) -> None:
    for k in range(_FRAMES):
        _images(top / f"frame-{k:06d}.color.png", top / f"frame-{k:06d}.depth.png", k)
        rows = "\t\n".join("\t ".join(f"{value:.7e}" for value in row) for row in _POSES[k])
        (top / f"frame-{k:06d}.pose.txt").write_text(rows + "\t\n")


def _tum(top: Path) -> None:
    for k in range(_FRAMES):
        _images(top / "rgb" / f"{k}.png", top / "depth" / f"{k}.png", k)
    (top / "rgb.txt").write_text("# timestamp filename\n" + "".join(f"{100 + k / 10:.6f} rgb/{k}.png\n" for k in range(_FRAMES)))
    (top / "depth.txt").write_text("".join(f"{100.005 + k / 10:.6f} depth/{k}.png\n" for k in range(_FRAMES)))
    poses = np.repeat(np.eye(4)[None], 40, axis=0)
    poses[:, 0, 3] = np.arange(40) / 10
    write_stamped_poses(top / "groundtruth.txt", 100 + np.arange(40) / 100, poses)


def _ours(top: Path) -> None:
    for k in range(_FRAMES):
        _images(top / "color" / f"{k:06d}.jpg", top / "depth" / f"{k:06d}.png", k)
    write_stamped_poses(top / "poses.txt", range(_FRAMES), _POSES)
    (top / "intrinsic.json").write_text(json.dumps(_INTRINSICS))
    (top / "scan.json").write_text(json.dumps({"format": "gibson_sim scan", "frames": _FRAMES}))


def run(folder: Path, trial: Trial) -> None:
    """Opens the set and reads all its frames."""
    path = folder / "case.json"
    focal = _FOCAL if not path.exists() or json.loads(path.read_text())["focal"] else None
    rgbd = trial.call("open_posed_rgbd", open_posed_rgbd, folder / "set", focal=focal)
    trial.reach("loaded")
    if not np.isfinite(rgbd.poses).all():
        trial.fault("a pose holds a NaN")
    for number in range(min(len(rgbd), 50)):
        frame = trial.call("frame", rgbd.__getitem__, number)
        if frame.rgb.shape[:2] != frame.depth.shape:
            trial.fault(f"frame {number}: colours have shape {frame.rgb.shape}, depths {frame.depth.shape}")
        trial.reach("frames")
