"""Public scenes are downloaded from their origin: licence first, checked, resumed, and never outside their folders."""

from __future__ import annotations

import hashlib
import threading
from collections.abc import Iterator
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from typing import Any

import pytest
import yaml

from gibson_sim.cli.main import main
from gibson_sim.errors import GibsonSimError, SceneError
from gibson_sim.scenes.load import load_scene
from gibson_sim_tools.importing.fetching.fetch import download, download_folder
from gibson_sim_tools.importing.fetching.recipes import known_recipes, load_recipe
from support.interiors import write_gibson_folder


class Server:
    """Serves files over HTTP, with faults."""

    def __init__(self) -> None:
        self.files: dict[str, bytes] = {}
        self.cut_after: int | None = None
        """Bytes after which the next response ends; None = complete."""
        self.ranges: list[str] = []
        """Requested ranges, in order; "" = all."""
        outer = self

        class Handler(BaseHTTPRequestHandler):
            def do_GET(self) -> None:
                outer.answer(self)

            def log_message(self, *args: Any) -> None:
                pass

        self._server = ThreadingHTTPServer(("127.0.0.1", 0), Handler)
        self.url = f"http://127.0.0.1:{self._server.server_port}"
        self._thread = threading.Thread(target=self._server.serve_forever, kwargs={"poll_interval": 0.01})
        self._thread.start()

    def answer(self, request: BaseHTTPRequestHandler) -> None:
        data = self.files.get(request.path)
        asked = request.headers.get("Range", "")
        self.ranges.append(asked)
        if data is None:
            request.send_error(404)
            return
        begin = int(asked.removeprefix("bytes=").rstrip("-")) if asked else 0
        request.send_response(206 if asked else 200)
        request.send_header("Content-Length", str(len(data) - begin))
        request.end_headers()
        cut, self.cut_after = self.cut_after, None
        request.wfile.write(data[begin:] if cut is None else data[begin : begin + cut])

    def close(self) -> None:
        self._server.shutdown()
        self._thread.join()
        self._server.server_close()


@pytest.fixture
def server() -> Iterator[Server]:
    """A server on this machine."""
    running = Server()
    yield running
    running.close()


@pytest.fixture
def recipe(server: Server, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A recipe of a scene in Gibson's layout on the server; caches lie in the test's folder."""
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    folder = write_gibson_folder(tmp_path / "origin" / "Tiny")
    files = {}
    for path in folder.iterdir():
        data = path.read_bytes()
        server.files[f"/scenes/{path.name}"] = data
        files[path.name] = {"sha256": hashlib.sha256(data).hexdigest(), "bytes": len(data)}
    out = tmp_path / "tiny.yaml"
    out.write_text(yaml.safe_dump({
        "name": "tiny", "title": "a tiny room", "made_by": "Nobody", "homepage": server.url, "licence": "CC0-1.0",
        "licence_url": "https://creativecommons.org/publicdomain/zero/1.0/", "base_url": f"{server.url}/scenes", "files": files,
    }))  # fmt: skip
    return out


def _fetch(*words: object) -> int:
    with pytest.raises(SystemExit) as ended:
        main(["scene", "fetch", *map(str, words)])
    return int(ended.value.code or 0)


def test_licence_and_size_are_shown_and_then_the_scene_comes(
    recipe: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert _fetch(recipe, "--yes", "--output", tmp_path / "out") == 0
    text = capsys.readouterr().out
    assert text.index("CC0-1.0") < text.index("scene.yaml")
    assert "in 6 files" in text
    assert load_scene(tmp_path / "out").name == "tiny"
    assert "CC0-1.0" in (tmp_path / "out" / "ORIGIN.txt").read_text()
    assert not download_folder("tiny").exists()


def test_nothing_is_downloaded_before_the_licence_is_accepted(
    recipe: Path, server: Server, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert _fetch(recipe, "--output", tmp_path / "out") == 1
    assert "--yes" in capsys.readouterr().err
    assert server.ranges == []


def test_a_download_goes_on_where_it_was_cut_off(
    recipe: Path, server: Server, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    server.cut_after = 100
    assert _fetch(recipe, "--yes", "--output", tmp_path / "out") == 1
    assert "run the command again to resume" in capsys.readouterr().err
    assert _fetch(recipe, "--yes", "--output", tmp_path / "out") == 0
    assert "bytes=100-" in server.ranges
    # A complete file is not requested again.
    assert server.ranges.count("bytes=100-") == 1 and len(server.ranges) == 7


def test_a_file_with_another_checksum_than_the_recipe_is_not_kept(
    recipe: Path, server: Server, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    server.files["/scenes/floors.txt"] = b"9.9\n"
    assert _fetch(recipe, "--yes", "--output", tmp_path / "out") == 1
    assert "has the checksum" in capsys.readouterr().err
    assert not (tmp_path / "out").exists()
    assert not list(download_folder("tiny").rglob("floors.txt*"))


def test_a_download_larger_than_the_recipe_states_is_refused(server: Server, tmp_path: Path) -> None:
    server.files["/a"] = bytes(10_000_000)
    with pytest.raises(SceneError, match="sends more than the 10 bytes"):
        download(f"{server.url}/a", tmp_path / "a", "0" * 64, 10, lambda count: None)
    assert list(tmp_path.iterdir()) == []


def test_a_missing_download_is_one_line(server: Server, tmp_path: Path) -> None:
    with pytest.raises(SceneError, match="the server returned 404"):
        download(f"{server.url}/none", tmp_path / "a", "0" * 64, 10, lambda count: None)


@pytest.mark.parametrize(
    ("key", "value", "said"),
    [
        ("files", {"../evil": {"sha256": "0" * 64, "bytes": 1}}, "leaves the folder"),
        ("files", {"/etc/evil": {"sha256": "0" * 64, "bytes": 1}}, "leaves the folder"),
        ("files", {"a": {"sha256": "none", "bytes": 1}}, "without it nothing is downloaded"),
        ("files", {"a": {"sha256": "0" * 64, "bytes": 1, "url": "file:///etc/passwd"}}, "must begin with https"),
        ("files", {}, "must be a mapping"),
        ("scene", "../other", "leaves the folder"),
        ("licence", "", "licence is missing"),
        ("liscence", "x", "did you mean"),
    ],
)
def test_a_recipe_that_is_wrong_is_refused(recipe: Path, key: str, value: object, said: str) -> None:
    recipe.write_text(yaml.safe_dump({**yaml.safe_load(recipe.read_text()), key: value}))
    with pytest.raises(GibsonSimError, match=said):
        load_recipe(str(recipe))


def test_the_recipes_that_come_with_it_can_be_read() -> None:
    assert {"aws_small_house", "drake_living_room", "vr_gallery"} <= set(known_recipes())
    for name in known_recipes():
        recipe = load_recipe(name)
        assert recipe.name == name and recipe.bytes > 10**6
        # A commit, so that what is there cannot change.
        assert all(file.url.startswith("https://") for file in recipe.files)


@pytest.mark.parametrize(
    ("name", "folder"), [("vr_gallery", "playcanvas_vr_gallery"), ("drake_living_room", "drake_living_room")]
)
def test_checksums_of_the_recipes_are_those_of_the_files(data_dir: Path, name: str, folder: str) -> None:
    for file in load_recipe(name).files:
        data = (data_dir / folder / file.path).read_bytes()
        assert (hashlib.sha256(data).hexdigest(), len(data)) == (file.sha256, file.bytes)
