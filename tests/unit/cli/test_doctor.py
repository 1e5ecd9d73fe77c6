"""Graphics in ``gibson-sim doctor``: one line per device, with a remedy if it cannot render."""

from __future__ import annotations

import argparse
import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from gibson_sim.cli.commands import doctor
from gibson_sim.processes.domain_lock import DomainLock

UUID = "01234567-89ab-cdef-0123-456789abcdef"
OTHER = "fedcba98-7654-3210-fedc-ba9876543210"
Answers = Callable[[dict[str, tuple[bool, str]]], None]


@pytest.fixture
def answers(monkeypatch: pytest.MonkeyPatch) -> Answers:
    """Sets the answers of the programs that doctor runs, by a word in their text."""

    def set_answers(by_word: dict[str, tuple[bool, str]]) -> None:
        def answer(code: str) -> tuple[bool, str]:
            return next(text for word, text in by_word.items() if word in code)

        monkeypatch.setattr(doctor, "_try", answer)

    return set_answers


def device(index: int, **changes: Any) -> dict[str, Any]:
    usual = {
        "index": index, "vendor": "NVIDIA Corporation", "renderer": "NVIDIA GPU", "version": "4.6", "drm_node": "/dev/dri/renderD128",
        "software": False, "usable": True, "problem": "", "uuid": UUID, "cuda_ordinal": -1,
    }  # fmt: skip
    return {**usual, **changes}


def devices(*found: dict[str, Any]) -> tuple[bool, str]:
    return True, json.dumps(found)


def cuda(uuid: str) -> tuple[bool, str]:
    return True, json.dumps([{"ordinal": 3, "name": "NVIDIA GPU", "uuid": uuid}])


def test_every_device_is_tested_on_its_own(answers: Answers) -> None:
    answers(
        {
            "list_devices": devices(device(0, vendor="Mesa"), device(1, vendor="Mesa")),
            "self_test(0)": (True, "pixel-exact"),
            "self_test(1)": (False, "draws wrongly: 12 of 4096 colours"),
        }
    )
    found = list(doctor._graphics())
    assert [(f.what, f.status) for f in found] == [("EGL device 0", "ok"), ("EGL device 1", "FAIL")]
    assert found[0].detail == f"pixel-exact, UUID {UUID}"
    assert "12 of 4096" in found[1].detail
    assert "--egl-device" in found[1].remedy


def test_a_device_that_cannot_be_opened_is_a_warning_and_not_used(answers: Answers) -> None:
    answers({"list_devices": devices(device(0, usable=False, problem="no right to open it")), "self_test": (True, "drawn")})
    found = list(doctor._graphics())
    assert [(f.what, f.status) for f in found] == [("EGL", "FAIL"), ("EGL device 0", "warn")]
    assert "no right to open it" in found[1].detail


def test_cuda_on_the_rendering_gpu_is_reported(answers: Answers) -> None:
    answers({"list_devices": devices(device(1)), "self_test": (True, "drawn"), "CudaPython": cuda(UUID)})
    finding = list(doctor._graphics())[-1]
    assert (finding.what, finding.status, finding.detail) == ("CUDA", "ok", "cuda:3 NVIDIA GPU is EGL device 1")


def test_cuda_on_another_gpu_is_a_warning_with_a_remedy(answers: Answers) -> None:
    answers({"list_devices": devices(device(1)), "self_test": (True, "drawn"), "CudaPython": cuda(OTHER)})
    finding = list(doctor._graphics())[-1]
    assert (finding.what, finding.status) == ("CUDA", "warn")
    assert OTHER in finding.detail
    assert "CUDA_VISIBLE_DEVICES" in finding.remedy


def test_without_cuda_the_remedy_is_the_extra(answers: Answers) -> None:
    answers({"list_devices": devices(device(0)), "self_test": (True, "drawn"), "CudaPython": (False, "no CUDA here")})
    finding = list(doctor._graphics())[-1]
    assert (finding.what, finding.status) == ("CUDA", "warn")
    assert "gibson_sim[cuda]" in finding.remedy


def test_cuda_is_not_mentioned_without_a_rendering_nvidia_gpu(answers: Answers) -> None:
    answers({"list_devices": devices(device(0, vendor="Mesa/X.org", software=True)), "self_test": (True, "drawn")})
    assert [f.what for f in doctor._graphics()] == ["EGL device 0"]


def test_a_message_package_that_is_missing_is_named(answers: Answers) -> None:
    missing = "ModuleNotFoundError: No module named"
    answers(
        {
            "import rclpy": (True, "rmw"),
            "import control_msgs": (False, missing),
            "import tf2_msgs": (False, missing),
            "": (True, ""),
        }
    )
    found = {f.what: f for f in doctor._ros()}
    assert {what: f.status for what, f in found.items() if f.status != "ok"} == {"control_msgs": "warn", "tf2_msgs": "FAIL"}
    assert found["control_msgs"].remedy.startswith("run `make setup`, or build the workspace")


def test_interfaces_whose_packets_reach_the_loopback_are_named(tmp_path: Path) -> None:
    for name, value in (("all", "0"), ("default", "1"), ("eth0", "0"), ("cni0", "1"), ("lo", "1")):
        (tmp_path / name).mkdir()
        (tmp_path / name / "route_localnet").write_text(f"{value}\n")
    assert doctor._routed_localnet(tmp_path) == "cni0"
    assert doctor._routed_localnet(tmp_path / "nothing") == ""


def test_an_occupied_domain_can_be_changed_as_the_message_says(monkeypatch: pytest.MonkeyPatch) -> None:
    parser = argparse.ArgumentParser()
    doctor.add_parser(parser.add_subparsers())
    assert parser.parse_args(["doctor"]).domain_id is None
    monkeypatch.setenv("ROS_DOMAIN_ID", "229")
    lock = DomainLock(229)
    try:
        (occupied,) = doctor._domain(None)
    finally:
        lock.close()
    (free,) = doctor._domain(parser.parse_args(["doctor", "--domain-id", "228"]).domain_id)
    (wrong,) = doctor._domain(999)
    assert [finding.status for finding in (occupied, free, wrong)] == ["warn", "ok", "FAIL"]
    assert "--domain-id" in occupied.detail and free.detail.startswith("ROS_DOMAIN_ID 228, ")
