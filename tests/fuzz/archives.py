"""Archives that are imported: ZIP and TAR, with entries that lie, leave the folder, or are more than they seem."""

from __future__ import annotations

import io
import json
import stat
import tarfile
import zipfile
from pathlib import Path
from typing import Any

from fuzz import seeds
from fuzz.grammar import Mutator
from fuzz.live import live, simulator
from fuzz.trial import Trial
from gibson_sim.standard.requests import LoadRequest
from gibson_sim_tools.importing.fetching.archives import ArchiveLimits, unpack
from gibson_sim_tools.importing.importers import import_scene

_NAMES = (
    "../out.txt",
    "/tmp/out.txt",
    "a/../../out.txt",
    "a\\b",
    "C:x",
    "a\0b",
    "",
    ".",
    "x" * 300,
    "a/" * 200 + "b",
    "é",
    "models/a.glb",
    "a.glb/b",
)
_LIMITS = ArchiveLimits(bytes=50 * 2**20, files=200, free=2**20)


def make(mutator: Mutator, folder: Path) -> None:
    """Writes an archive with a scene in it."""
    inside = folder / "inside"
    seeds.mesh_files(inside)
    world = mutator.chance(0.4)
    entries: list[dict[str, Any]] = []
    if world:
        entries.append({"name": "top/yard.world", "data": seeds.SDF_WORLD, "file": ""})
        entries.append({"name": "top/models/chair/model.sdf", "data": seeds.SDF_CHAIR, "file": ""})
        entries.append({"name": "top/a.dae", "data": "", "file": "a.dae"})
    else:
        entries += [{"name": f"top/{name}", "data": "", "file": name} for name in ("a.glb", "wood.png")]
    for entry in entries:
        entry.update(kind="file", mode=0o644, size=0)
    entries.append({"name": "top/README.txt", "data": "text", "file": "", "kind": "file", "mode": 0o644, "size": 0})
    for _ in range(mutator.times()):
        _change(mutator, entries)
    suffix = mutator.rng.choice((".zip", ".zip", ".tar", ".tar.gz", ".tar.bz2", ".tar.xz"))
    data = (
        _zip(mutator, inside, entries)
        if suffix == ".zip"
        else _tar(inside, entries, suffix.removeprefix(".tar").removeprefix("."))
    )
    if mutator.harsh and mutator.chance(0.3):
        data = mutator.data(data)
    (folder / f"scene{suffix}").write_bytes(data)
    (folder / "case.json").write_text(json.dumps({"file": f"scene{suffix}"}))


def _change(mutator: Mutator, entries: list[dict[str, Any]]) -> None:
    if not entries:
        return
    entry = mutator.rng.choice(entries)
    kind = mutator.rng.randrange(8 if mutator.harsh else 4)
    if kind == 0:
        mutator.rng.shuffle(entries)
    elif kind == 1:
        entry["mode"] = mutator.rng.choice((0, 0o777, 0o4755, 0o600))
    elif kind == 2:
        entries.append({**entry, "name": f"top/more/{mutator.rng.randrange(1000)}.txt", "file": "", "data": "x"})
    elif kind == 3:
        entries.insert(0, {**entry, "name": "top/", "kind": "folder", "data": "", "file": ""})
    elif kind == 4:
        entry["name"] = mutator.rng.choice(_NAMES)
    elif kind == 5:
        entry["kind"] = mutator.rng.choice(("link", "hard", "pipe", "device", "folder"))
    elif kind == 6:
        entry.update(file="", data="\0" * mutator.rng.choice((10**5, 10**6, 6 * 10**7)))
    else:
        entries.extend(dict(entry, name=f"{entry['name']}{k}") for k in range(mutator.rng.choice((1, 50, 300))))


def _content(inside: Path, entry: dict[str, Any]) -> bytes:
    return (inside / entry["file"]).read_bytes() if entry["file"] else entry["data"].encode()


def _zip(mutator: Mutator, inside: Path, entries: list[dict[str, Any]]) -> bytes:
    out = io.BytesIO()
    import warnings

    with warnings.catch_warnings(), zipfile.ZipFile(out, "w", zipfile.ZIP_DEFLATED) as archive:
        warnings.simplefilter("ignore")
        for entry in entries:
            info = zipfile.ZipInfo((entry["name"] or "x").replace("\0", "_"))
            kinds = {"link": stat.S_IFLNK, "pipe": stat.S_IFIFO, "device": stat.S_IFCHR, "folder": stat.S_IFDIR}
            info.external_attr = (kinds.get(entry["kind"], stat.S_IFREG) | entry["mode"]) << 16
            info.compress_type = mutator.rng.choice(
                (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED, zipfile.ZIP_BZIP2, zipfile.ZIP_LZMA)
            )
            archive.writestr(info, _content(inside, entry))
    return out.getvalue()


def _tar(inside: Path, entries: list[dict[str, Any]], mode: str) -> bytes:
    out = io.BytesIO()
    kinds = {
        "link": tarfile.SYMTYPE,
        "hard": tarfile.LNKTYPE,
        "pipe": tarfile.FIFOTYPE,
        "device": tarfile.CHRTYPE,
        "folder": tarfile.DIRTYPE,
    }
    with tarfile.open(fileobj=out, mode=f"w:{mode}") as archive:  # type: ignore[call-overload]
        for entry in entries:
            info = tarfile.TarInfo(entry["name"])
            info.type, info.mode, info.linkname = kinds.get(entry["kind"], tarfile.REGTYPE), entry["mode"], "../../etc/passwd"
            data = _content(inside, entry) if info.type == tarfile.REGTYPE else b""
            info.size = len(data)
            archive.addfile(info, io.BytesIO(data))
    return out.getvalue()


def run(folder: Path, trial: Trial) -> None:
    """Unpacks it, imports it and lives in what comes out; nothing may lie anywhere else."""
    archive = folder / json.loads((folder / "case.json").read_text())["file"]
    before = _names(folder)
    try:
        trial.call("unpack", unpack, archive, folder / "unpacked", _LIMITS)
        trial.reach("loaded")
        imported = trial.call("import_scene", import_scene, archive, folder / "imported")
    finally:
        strange = sorted(n for n in _names(folder) - before if not n.startswith(("files/unpacked", "files/imported")))
        if strange:
            trial.fault(f"outside of their folders lie now {strange[:5]}")
    with simulator(None) as made:
        trial.call("load_world", made.load_world, LoadRequest(str(imported.file)), secret=True)
        live(trial, made)


def _names(folder: Path) -> set[str]:
    top = folder.parent
    return {str(path.relative_to(top)) for path in top.rglob("*")}
