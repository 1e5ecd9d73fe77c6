"""The container of binary glTF files."""

from __future__ import annotations

from gibson_sim.formats.glb import glb_bytes


def test_chunks_are_padded_to_four_bytes() -> None:
    # Magic, version 2, 12 + (8 + 8) + (8 + 8) bytes.
    head = b"glTF\x02\x00\x00\x00\x2c\x00\x00\x00"
    text = b'\x08\x00\x00\x00JSON{"a":1} '
    data = b"\x08\x00\x00\x00BIN\x00\x01\x02\x03\x04\x05\x00\x00\x00"
    assert glb_bytes({"a": 1}, b"\x01\x02\x03\x04\x05") == head + text + data


def test_without_data_there_is_no_chunk_for_it() -> None:
    assert glb_bytes({}, b"") == b"glTF\x02\x00\x00\x00\x18\x00\x00\x00\x04\x00\x00\x00JSON{}  "
