"""Untrusted files, YAML and XML are refused before any value is built."""

from __future__ import annotations

import math
import os
import re
from pathlib import Path

import pytest
import yaml

from gibson_sim.errors import MeshError, SceneError, TextError
from gibson_sim.quoting import clipped, quoted
from gibson_sim.reading import (
    MAX_DEPTH,
    MAX_XML_ATTRIBUTES,
    MAX_XML_DEPTH,
    MAX_XML_TAGS,
    MAX_YAML_BYTES,
    MAX_YAML_VALUES,
    exists,
    is_file,
    is_folder,
    parse_xml,
    parse_yaml,
    read_file,
    yaml_texts,
)
from support.effort import effort

BOMB = "name: b\ngravity:\n- &z0 [x,x,x,x,x,x,x,x,x]\n" + "".join(
    f"- &z{k} [{','.join([f'*z{k - 1}'] * 9)}]\n" for k in range(1, 12)
)
"""500 bytes that expand to 9^12 values."""
MERGE_BOMB = "a0: &a0 {x: 1}\n" + "".join(f"a{k}: &a{k} {{<<: [{','.join([f'*a{k - 1}'] * 9)}]}}\n" for k in range(1, 12))


def test_plain_yaml_is_read_as_pyyaml_reads_it(root: Path) -> None:
    for path in (*sorted(root.glob("scenes/*/scene.yaml")), *sorted(root.glob("config/**/*.yaml"))):
        assert parse_yaml(path.read_bytes()) == yaml.safe_load(path.read_text()), path
    text = "{a: &a {x: 1, y: [1.5, yes, null, 2026-01-02]}, b: {<<: *a, x: 2}, c: *a, ? d, 'e': !!str 1}"
    assert parse_yaml(text) == yaml.safe_load(text)
    assert parse_yaml("") is None


@pytest.mark.parametrize(
    ("text", "reason"),
    [
        (BOMB, f"more than {MAX_YAML_VALUES} values"),
        (MERGE_BOMB, f"more than {MAX_YAML_VALUES} values"),
        ("[" * 200_000, f"nested deeper than {MAX_DEPTH} levels"),
        ("- " * 200_000, f"nested deeper than {MAX_DEPTH} levels"),
        ("? " * 200_000, f"nested deeper than {MAX_DEPTH} levels"),
        ("- &a0 [x]\n" + "".join(f"- &a{k} [*a{k - 1}]\n" for k in range(1, 300)), f"nested deeper than {MAX_DEPTH} levels"),
        ("a: &a [*a]", "alias 'a' holds itself"),
        ("a: *b", "alias 'b' is not defined before"),
        ("a: 1\nb: 2\na: 3", "line 3, column 1: key 'a' is given twice"),
        ("x: 1\n---\ny: 2", "second document"),
        ("day: 2026-99-99", "month must be in 1..12"),
        ("x: " + "9" * 5000, "a number has 5000 characters, must have at most 200"),
        ("x: 0x" + "f" * 300, "a number has 302 characters"),
        ("0b" + "1" * 300 + ": x", "a number has 302 characters"),
        ("x: 1" + ":59" * 400_000, "a number has 1200001 characters"),
        ("x: 1" + ":59" * 400_000 + ".5", "a number has 1200003 characters"),
        ("x: 1" + "_" * 300 + "1", "a number has 302 characters"),
        ('x: "a\\0b"', "a text holds a NUL"),
        ('x: !!int ""', "is not YAML"),
        ("x: !!python/object/apply:os.system [ls]", "is not YAML"),
        ("? [a]\n: b", "unhashable"),
        ("a: [", "line 2, column 1"),
        (b"\xff\xfe\x00", "is not YAML"),
        ("\ud800", "is not YAML"),
        ("x" * (MAX_YAML_BYTES + 1), "must have at most 8 MB"),
    ],
)
def test_malicious_yaml_is_refused_in_one_short_line(text: str | bytes, reason: str) -> None:
    with pytest.raises(TextError, match=re.escape(reason)) as error:
        parse_yaml(text)
    assert len(str(error.value)) < 400
    assert "\n" not in str(error.value)
    assert error.value.public, "a client is told something"


def test_yaml_bombs_cost_no_time() -> None:
    def refused() -> None:
        with pytest.raises(TextError):
            parse_yaml(BOMB)

    assert effort(refused) < 10.0


def test_message_for_clients_reveals_nothing_of_the_file() -> None:
    for text in ("a: [\n secret", "secret: 1\nsecret: 2", "x: !secret 1", "x: *secret"):
        with pytest.raises(TextError) as error:
            parse_yaml(text)
        assert error.value.public == "is not YAML that can be read"


@pytest.mark.parametrize(
    ("text", "found"),
    [
        (b"name: a\nx: [1, {name: no}]\ndescription: two words\n]] no YAML", {"name": "a", "description": "two words"}),
        (b"x: {name: no, description: no}\n? [name, description]\n: no\n&n name: 5\n", {"name": "5"}),
        (b"name: ~\ndescription: null", {}),
        (b"name: ''\ndescription: 'null'", {"description": "null"}),
        (b"name: [a]\ndescription: &d {name: b}\nother: *d", {}),
        (b"[name, a]", {}),
        (b"name", {}),
        (b"", {}),
    ],
)
def test_texts_of_the_outermost_mapping_are_read_without_the_rest(text: bytes, found: dict[str, str]) -> None:
    assert yaml_texts(text, ("name", "description")) == found


def test_white_space_before_the_xml_declaration_is_allowed_as_in_gazebo_and_ros() -> None:
    assert parse_xml(b'\n\n  <?xml version="1.0"?>\n<sdf/>').tag == "sdf"


@pytest.mark.parametrize(
    ("text", "reason"),
    [
        (b"<robot>" + b"<link/>" * MAX_XML_TAGS + b"</robot>", f"must have at most {MAX_XML_TAGS}"),
        (b"<a>" * 1000 + b"</a>" * 1000, f"nested deeper than {MAX_XML_DEPTH} levels"),
        (b'<!DOCTYPE a [<!ENTITY b "c">]><a>&b;</a>', "XML entities"),
        ('<?xml version="1.0" encoding="UTF-16"?><!DOCTYPE a [<!ENTITY b "c">]><a/>'.encode("utf-16"), "XML entities"),
        (b'<!DOCTYPE a [<!ATTLIST b c CDATA "d">]><a><b/></a>', "defaults of attributes"),
        (b"<a " + b"b='' " * (MAX_XML_ATTRIBUTES + 1) + b"/>", f"must have at most {MAX_XML_ATTRIBUTES}"),
        (b"<a><b></a>", "is not well-formed XML"),
        (b'<?xml version="1.0" encoding="x"?><a/>', "is not well-formed XML"),
    ],
)
def test_malicious_xml_is_refused(text: bytes, reason: str) -> None:
    with pytest.raises(TextError, match=re.escape(reason)) as error:
        parse_xml(text)
    assert error.value.public


def test_longest_numbers_of_yaml_fit_into_a_float() -> None:
    for text in ("9" * 200, "0x" + "f" * 198, "1" + ":59" * 66):
        assert math.isfinite(float(parse_yaml(text)))


def test_folders_are_listed_beside_a_deep_description() -> None:
    def refused() -> None:
        with pytest.raises(TextError, match=f"nested deeper than {MAX_DEPTH} levels"):
            yaml_texts(b"a: " + b"[" * 250_000, ("name",))

    assert effort(refused) < 10.0, "libyaml takes minutes"


def test_millions_of_elements_are_refused_unread() -> None:
    text = b"<robot>" + b"<link/>" * 4_000_000 + b"</robot>"

    def refused() -> None:
        with pytest.raises(TextError):
            parse_xml(text)

    assert effort(refused) < 10.0, "to parse them takes 5 s"


def test_only_regular_files_of_bounded_size_are_opened(tmp_path: Path) -> None:
    (tmp_path / "file").write_bytes(b"x" * 100)
    assert read_file(tmp_path / "file") == b"x" * 100
    assert read_file(tmp_path / "file", 100) == b"x" * 100
    os.mkfifo(tmp_path / "pipe")
    for path, reason in (
        (tmp_path / "pipe", "not a regular file"),
        (tmp_path, "not a regular file"),
        (Path("/dev/zero"), "not a regular file"),
        (tmp_path / "a\0b", "no file can have this name"),
        (tmp_path / "\udc80\ud800", "no file can have this name"),
    ):
        with pytest.raises(OSError, match=re.escape(reason)):
            read_file(path)
    with pytest.raises(OSError, match="too large"):
        read_file(tmp_path / "file", 99)
    with pytest.raises(FileNotFoundError):
        read_file(tmp_path / "none")


def test_file_that_has_no_size_beforehand_is_bounded() -> None:
    assert read_file(Path("/proc/self/status")).startswith(b"Name:")
    with pytest.raises(OSError, match="too large"):
        read_file(Path("/proc/self/status"), 10)


@pytest.mark.parametrize("name", ["a\0b", "x" * 300, "x" * 5000, "\ud800", "none"])
def test_invalid_paths_do_not_exist(tmp_path: Path, name: str) -> None:
    assert (exists(tmp_path / name), is_file(tmp_path / name), is_folder(tmp_path / name)) == (False, False, False)


def test_folders_and_files_are_distinguished(tmp_path: Path) -> None:
    (tmp_path / "file").touch()
    os.mkfifo(tmp_path / "pipe")
    assert (is_file(tmp_path / "file"), is_folder(tmp_path / "file"), exists(tmp_path / "file")) == (True, False, True)
    assert (is_file(tmp_path), is_folder(tmp_path)) == (False, True)
    assert (is_file(tmp_path / "pipe"), exists(tmp_path / "pipe")) == (False, True)


def test_every_quotation_is_short_and_takes_no_time() -> None:
    nested: object = ["x"] * 9
    for _ in range(40):
        nested = [nested] * 9
    odd: dict[str, object] = {"a": nested, "b": 10**5000, "c": b"bytes", "d": "t" * 10**6, "e": {k: k for k in range(10**5)}}
    assert effort(lambda: [quoted(value) for value in (*odd.values(), odd)]) < 10.0
    assert all(len(quoted(value)) < 130 for value in (*odd.values(), odd))
    assert all("\n" not in quoted(value) for value in ("a\nb", ["a\nb"], {"a\nb": 1}))


def test_short_values_are_quoted_as_python_writes_them() -> None:
    for value in ("chair", [1, 2.5, "x"], {"a": None}, True, -3, 1e30, (1, 2), "\x00"):
        assert quoted(value) == repr(value)
    assert quoted("x" * 100) == f"'{'x' * 80}'... (100 characters)"
    assert quoted(b"secret") == "6 bytes"
    assert quoted(10**5000) == "a whole number of 5001 digits"


def test_long_messages_lose_their_middle() -> None:
    assert clipped("a\n b", 10) == "a b"
    assert clipped("a" * 100 + "b" * 100, 10) == "aaaaa ... bbbbb"
    assert clipped("é \x1b[31m\0\ud800", 80) == "é \\x1b[31m\\x00\\ud800"


def test_messages_are_one_line_within_bounds_whatever_a_file_names() -> None:
    assert str(SceneError("/a  b/c: is missing")) == "/a  b/c: is missing"
    assert str(SceneError("a\n\x1b[31mb")) == "a \\x1b[31mb"
    assert len(str(SceneError("x" * 10**6))) < 4100
    assert str(MeshError("a\nb").with_public("c")) == "a b"
