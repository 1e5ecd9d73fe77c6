"""Malicious archives, meshes and images: one clear line, bounded memory, and nothing outside the folder."""

from __future__ import annotations

import gzip
import io
import json
import resource
import struct
import tarfile
import zipfile
import zlib
from pathlib import Path

import pytest

from gibson_sim.cli.main import main
from gibson_sim.errors import GibsonSimError, MeshError, SceneError
from gibson_sim.formats.load_mesh import load_mesh
from gibson_sim.scenes.load import load_scene
from gibson_sim.scenes.spawning import SpawnError, load_spawnable
from gibson_sim.types import Pose
from gibson_sim_tools.importing.fetching.archives import ArchiveLimits, unpack
from gibson_sim_tools.importing.importers import import_scene
from support.gltf import Gltf
from support.interiors import room, write_gibson_folder, write_obj
from support.plys import ply

MEMORY_KB = 150_000
"""Memory that reading bad input may add to that of the process."""


def _zip(path: Path, files: dict[str, bytes], kind: int = zipfile.ZIP_DEFLATED) -> Path:
    with zipfile.ZipFile(path, "w", kind) as archive:
        for name, data in files.items():
            archive.writestr(name, data)
    return path


def _tar(path: Path, *members: tarfile.TarInfo) -> Path:
    with tarfile.open(path, "w:gz") as archive:
        for member in members:
            archive.addfile(member, io.BytesIO(b"x" * member.size))
    return path


def _member(name: str, **changes: object) -> tarfile.TarInfo:
    member = tarfile.TarInfo(name)
    for key, value in changes.items():
        setattr(member, key, value)
    return member


def _everything(folder: Path) -> set[str]:
    return {str(p.relative_to(folder)) for p in folder.rglob("*")}


# Archives


def test_an_archive_of_a_scene_imports(tmp_path: Path) -> None:
    folder = write_gibson_folder(tmp_path / "Tiny")
    archive = _zip(tmp_path / "tiny.zip", {f"Tiny/{p.name}": p.read_bytes() for p in folder.iterdir()})
    imported = import_scene(archive, tmp_path / "out")
    assert (imported.scene.name, imported.kind) == ("tiny", "Gibson folder")
    assert {p.name for p in tmp_path.iterdir()} == {"Tiny", "tiny.zip", "out"}


def test_a_zip_bomb_is_refused(tmp_path: Path) -> None:
    bomb = _zip(tmp_path / "bomb.zip", {f"{k}.obj": bytes(2**20) for k in range(20)})
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    with pytest.raises(SceneError, match="zip bomb"):
        unpack(bomb, tmp_path / "out", ArchiveLimits(free=2**20))
    assert resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before < MEMORY_KB
    assert not (tmp_path / "out").exists()


def test_a_zip_with_false_sizes_is_stopped_during_extraction(tmp_path: Path) -> None:
    bomb = _zip(tmp_path / "bomb.zip", {"a.obj": bytes(8 * 2**20)})
    data = bomb.read_bytes().replace(struct.pack("<I", 8 * 2**20), struct.pack("<I", 1000))
    bomb.write_bytes(data)
    with pytest.raises(SceneError):
        unpack(bomb, tmp_path / "out", ArchiveLimits(free=2**20))
    assert sum(p.stat().st_size for p in (tmp_path / "out").rglob("*")) <= 2**21


def test_a_tar_whose_headers_stand_for_gigabytes_is_refused_unread(tmp_path: Path) -> None:
    head = tarfile.TarInfo("x")
    head.size, head.type = 2**28, tarfile.XHDTYPE
    with gzip.open(tmp_path / "a.tar.gz", "wb") as file:
        file.write(head.tobuf(tarfile.USTAR_FORMAT))
        for _ in range(256):
            file.write(bytes(2**20))
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    with pytest.raises(SceneError, match="a header has 256 MB, must be at most 1 MB"):
        unpack(tmp_path / "a.tar.gz", tmp_path / "out")
    assert resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before < 100 * 1024


@pytest.mark.parametrize("packing", ["", ":gz", ":bz2", ":xz"])
def test_tars_of_every_packing_are_unpacked(tmp_path: Path, packing: str) -> None:
    content = bytes(range(256)) * 10_000
    with tarfile.open(tmp_path / "a.tar", f"w{packing}") as tar:  # type: ignore[call-overload]
        member = tarfile.TarInfo("folder/" + "n" * 200)
        member.size = len(content)
        tar.addfile(member, io.BytesIO(content))
    unpack(tmp_path / "a.tar", tmp_path / "out")
    assert (tmp_path / "out/folder" / ("n" * 200)).read_bytes() == content


def test_an_archive_larger_than_allowed_is_refused(tmp_path: Path) -> None:
    archive = _zip(tmp_path / "a.zip", {"a": bytes(1000)}, zipfile.ZIP_STORED)
    with pytest.raises(SceneError, match="unpacks to more than"):
        unpack(archive, tmp_path / "out", ArchiveLimits(bytes=999))


def test_too_many_files_are_refused(tmp_path: Path) -> None:
    archive = _zip(tmp_path / "a.zip", {str(k): b"" for k in range(11)})
    with pytest.raises(SceneError, match="more than 10 files"):
        unpack(archive, tmp_path / "out", ArchiveLimits(files=10))


@pytest.mark.parametrize("name", ["../evil.obj", "/tmp/evil.obj", "a/../../evil.obj", "a\\..\\evil.obj", "C:/evil.obj"])
@pytest.mark.parametrize("kind", ["zip", "tar.gz"])
def test_names_that_leave_the_folder_are_refused_and_nothing_is_written(tmp_path: Path, name: str, kind: str) -> None:
    path = tmp_path / f"evil.{kind}"
    if kind == "zip":
        _zip(path, {"good.obj": b"x", name: b"x"})
    else:
        _tar(path, _member("good.obj", size=1), _member(name, size=1))
    with pytest.raises(SceneError, match="outside the folder"):
        unpack(path, tmp_path / "in" / "out")
    assert _everything(tmp_path) == {path.name}


@pytest.mark.parametrize(
    ("member", "said"),
    [
        (_member("a", type=tarfile.SYMTYPE, linkname="/etc/passwd"), "a link"),
        (_member("a", type=tarfile.LNKTYPE, linkname="../b"), "a link"),
        (_member("a", type=tarfile.CHRTYPE), "a device"),
        (_member("a", type=tarfile.FIFOTYPE), "a device"),
    ],
)
def test_links_and_devices_are_refused(tmp_path: Path, member: tarfile.TarInfo, said: str) -> None:
    with pytest.raises(SceneError, match=said):
        unpack(_tar(tmp_path / "a.tar.gz", member), tmp_path / "out")


def test_a_link_in_a_zip_is_refused(tmp_path: Path) -> None:
    info = zipfile.ZipInfo("link")
    info.external_attr = 0o120777 << 16
    with zipfile.ZipFile(tmp_path / "a.zip", "w") as archive:
        archive.writestr(info, "/etc/passwd")
    with pytest.raises(SceneError, match="a link"):
        unpack(tmp_path / "a.zip", tmp_path / "out")


@pytest.mark.parametrize("kept", [0.2, 0.7])
def test_an_archive_that_is_cut_is_refused(tmp_path: Path, kept: float) -> None:
    data = _tar(tmp_path / "a.tar.gz", _member("a", size=100_000), _member("b", size=100_000)).read_bytes()
    (tmp_path / "b.tar.gz").write_bytes(data[: int(kept * len(data))])
    with pytest.raises(SceneError, match="cannot be unpacked"):
        unpack(tmp_path / "b.tar.gz", tmp_path / "out")


# Meshes


def _import_error(path: Path, output: Path, capsys: pytest.CaptureFixture[str]) -> str:
    """Returns the one line of a failing import, which leaves nothing behind."""
    before = _everything(output.parent)
    with pytest.raises(SystemExit) as ended:
        main(["scene", "import", str(path), "--output", str(output)])
    assert ended.value.code == 1
    assert _everything(output.parent) == before
    (line,) = capsys.readouterr().err.splitlines()
    assert line.startswith("gibson-sim: error: ")
    return line


def test_a_glb_with_nan_vertices_is_refused(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    nan = Gltf().triangle([[0.0, 0.0, 0.0], [1.0, float("nan"), 0.0], [0.0, 1.0, 0.0]])
    (tmp_path / "a.glb").write_bytes(nan.glb())
    assert "coordinates must be finite" in _import_error(tmp_path / "a.glb", tmp_path / "out", capsys)


@pytest.mark.parametrize("name", ["a.glb", "a.ply", "a.obj"])
@pytest.mark.parametrize("kept", [0.3, 0.8])
def test_a_mesh_that_is_cut_is_one_line(tmp_path: Path, name: str, kept: float, capsys: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / name
    corners, quads = room()
    if name == "a.obj":
        write_obj(path, corners, quads)
    else:
        path.write_bytes(ply(corners, quads.tolist(), None) if name == "a.ply" else Gltf().triangle().glb())
    data = path.read_bytes()
    # An OBJ may be cut between two lines, and is whole then: cut it before its last vertices.
    path.write_bytes(data[: int((0.2 if name == "a.obj" else kept) * len(data))])
    assert str(path) in _import_error(path, tmp_path / "out", capsys)


def test_a_buffer_outside_the_folder_is_refused(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    gltf = Gltf().triangle()
    (tmp_path / "secret.bin").write_bytes(gltf.chunk)
    (tmp_path / "in").mkdir()
    gltf.document["buffers"] = [{"byteLength": len(gltf.chunk), "uri": "../secret.bin"}]
    (tmp_path / "in" / "a.gltf").write_text(json.dumps(gltf.document))
    assert "lies outside the folder of the mesh" in _import_error(tmp_path / "in" / "a.gltf", tmp_path / "out", capsys)


def test_a_link_that_leaves_the_folder_is_refused(tmp_path: Path) -> None:
    write_obj(tmp_path / "secret.obj", *room())
    (tmp_path / "in").mkdir()
    (tmp_path / "in" / "a.obj").symlink_to(tmp_path / "secret.obj")
    with pytest.raises(GibsonSimError, match="lies outside"):
        import_scene(tmp_path / "in" / "a.obj", tmp_path / "out")


def test_a_texture_outside_the_folder_is_not_read(tmp_path: Path) -> None:
    write_gibson_folder(tmp_path / "Tiny")
    (tmp_path / "secret.png").write_bytes((tmp_path / "Tiny" / "atlas.png").read_bytes())
    (tmp_path / "Tiny" / "mesh_z_up.mtl").write_text("newmtl scan\nmap_Kd ../secret.png\n")
    imported = import_scene(tmp_path / "Tiny", tmp_path / "out")
    assert any("lies outside the folder of the mesh" in warning for warning in imported.warnings)
    assert not any("secret" in name for name in _everything(tmp_path / "out"))


# Images


def _png(width: int, height: int) -> bytes:
    """Returns a truncated PNG whose header names this size."""

    def chunk(kind: bytes, data: bytes) -> bytes:
        return struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))

    head = struct.pack(">IIBBBBB", width, height, 8, 2, 0, 0, 0)
    return b"\x89PNG\r\n\x1a\n" + chunk(b"IHDR", head) + chunk(b"IDAT", zlib.compress(bytes(1000))) + chunk(b"IEND", b"")


def test_a_texture_of_300_mb_is_refused_before_it_is_decoded(tmp_path: Path) -> None:
    write_obj(tmp_path / "a.obj", *room(), "atlas.png")
    (tmp_path / "atlas.png").write_bytes(_png(10_000, 10_000))
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    with pytest.raises(MeshError, match=r"10000 x 10000 pixels, 286 MB.*--fix"):
        load_mesh(tmp_path / "a.obj", [tmp_path])
    assert resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before < MEMORY_KB


@pytest.mark.parametrize("data", [b"", b"no image", _png(16, 16)[:40], b"\xff\xd8\xff\xe0\0"])
def test_an_invalid_image_leaves_the_colour(tmp_path: Path, data: bytes) -> None:
    write_obj(tmp_path / "a.obj", *room(), "atlas.png")
    (tmp_path / "atlas.png").write_bytes(data)
    mesh = load_mesh(tmp_path / "a.obj", [tmp_path])
    assert mesh.parts[0].material.texture is None
    assert any("cannot be decoded" in warning for warning in mesh.warnings)


# Descriptions


@pytest.mark.parametrize(
    "inside",
    [
        "<link name='b'><visual><geometry><mesh filename='self.urdf'/></geometry></visual></link>",
        "<link name='b'/><joint name='j' type='fixed'><parent link='b'/><child link='b'/></joint>",
    ],
)
def test_a_urdf_that_refers_to_itself_is_refused(tmp_path: Path, inside: str) -> None:
    (tmp_path / "self.urdf").write_text(f"<robot name='a' xmlns:xacro='x'>{inside}</robot>")
    with pytest.raises(SpawnError) as caught:
        load_spawnable(str(tmp_path / "self.urdf"), "", name="a", pose=Pose(), roots=())
    assert "\n" not in str(caught.value)


def test_a_scene_that_names_a_mesh_outside_is_refused(tmp_path: Path) -> None:
    write_obj(tmp_path / "secret.obj", *room())
    (tmp_path / "in").mkdir()
    (tmp_path / "in" / "scene.yaml").write_text("objects: [{mesh: ../secret.obj}]\n")
    with pytest.raises(SceneError, match="lies outside"):
        load_scene(tmp_path / "in")
