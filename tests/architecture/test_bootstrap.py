"""The set-up, as far as it can be tested without installing anything."""

from __future__ import annotations

import importlib.util
import os
import re
import sys
from pathlib import Path
from types import ModuleType

import pytest


@pytest.fixture
def bootstrap(root: Path) -> ModuleType:
    spec = importlib.util.spec_from_file_location("bootstrap", root / "bootstrap.py")
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def test_unsupported_python_is_refused_in_one_line(
    bootstrap: ModuleType, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(bootstrap, "SUPPORTED", ((3, 0),))
    monkeypatch.setattr(sys, "argv", ["bootstrap.py", "--venv", str(tmp_path / "venv")])
    assert bootstrap.main() == 1
    error = capsys.readouterr().err
    assert error.startswith("error: Python is CPython 3.")
    assert error.count("\n") == 1
    assert "must be CPython 3.0; choose one with PYTHON=" in error


def test_folder_not_created_by_the_set_up_is_left_alone(bootstrap: ModuleType, tmp_path: Path) -> None:
    (tmp_path / "mine").write_text("precious")
    with pytest.raises(bootstrap.SetupError, match="was not made by this set-up"):
        bootstrap.make_venv(tmp_path)
    assert [path.name for path in tmp_path.iterdir()] == ["mine"]


def test_folder_that_cannot_be_made_is_an_error_of_one_line(
    bootstrap: ModuleType, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    file = tmp_path / "file"
    file.touch()
    monkeypatch.setattr(sys, "argv", ["bootstrap.py", "--venv", str(file)])
    assert bootstrap.main() == 1
    text = capsys.readouterr().err
    assert text.startswith(f"error: {file}: ") and "VENV=DIR chooses another folder" in text and text.count("\n") == 1


def test_missing_parts_are_named_with_their_packages(bootstrap: ModuleType, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(bootstrap, "missing_system_parts", lambda: ["a C++ compiler", "a driver for EGL"])
    monkeypatch.setattr(bootstrap.os, "geteuid", lambda: 1000)
    with pytest.raises(bootstrap.SetupError) as error:
        bootstrap.check_system()
    assert str(error.value) == (
        "this machine lacks a C++ compiler, a driver for EGL; "
        "remedy: sudo apt-get install g++ libegl-mesa0 libgl1-mesa-dri (Debian, Ubuntu)"
    )


def test_headers_come_with_the_version_of_the_python(bootstrap: ModuleType, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(bootstrap, "distribution_python", lambda: True)
    version = f"{sys.version_info.major}.{sys.version_info.minor}"
    assert bootstrap.debian_packages(["the headers of Python"]) == [f"python{version}-dev"]


def test_step_is_redone_when_a_message_changes(bootstrap: ModuleType, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(bootstrap, "ROOT", tmp_path)
    (tmp_path / "A.msg").write_text("int32 a\n")
    before = bootstrap.digest([tmp_path])
    assert bootstrap.digest([tmp_path]) == before
    (tmp_path / "A.msg").write_text("int64 a\n")
    assert bootstrap.digest([tmp_path]) != before


def test_every_pin_is_a_package_and_each_is_there_once(bootstrap: ModuleType) -> None:
    names = [line.partition("==")[0] for line in bootstrap.pins() if ";" not in line]
    assert all(re.fullmatch("[a-z0-9-]+", name) for name in names)
    assert len(names) == len(set(names))


def test_messages_for_python_alone_are_built_where_cmake_is_told_to_look(bootstrap: ModuleType) -> None:
    assert (bootstrap.PYTHON_ONLY / "rosidl_default_generatorsConfig.cmake").is_file()
    assert bootstrap.PYTHON_ONLY.is_relative_to(bootstrap.INTERFACES[1]), "a change of it builds the messages again"
    assert not list(bootstrap.PYTHON_ONLY.glob("package.xml")), "colcon finds no package in it"


def test_another_ros_installation_stays_outside(bootstrap: ModuleType, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("PYTHONPATH", "/opt/ros/jazzy/lib/python3.12/site-packages")
    monkeypatch.setenv("_ROS_WHEELS_BOOTSTRAP_COMPLETE", "1")
    env = bootstrap.clean_environment(Path("/venv"))
    assert {"PYTHONPATH", "_ROS_WHEELS_BOOTSTRAP_COMPLETE"} & set(env) == set()
    assert env["PATH"].split(":")[0] == "/venv/bin"


def test_the_set_up_compiles_modules_also_where_python_must_not(bootstrap: ModuleType, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("PYTHONDONTWRITEBYTECODE", "1")
    assert "PYTHONDONTWRITEBYTECODE" not in bootstrap.clean_environment(Path("/venv"))


def test_packages_installed_in_place_are_put_into_the_ament_index(bootstrap: ModuleType, tmp_path: Path) -> None:
    project, venv = tmp_path / "robot_shop", tmp_path / "venv"
    metadata = venv / "lib/python3.11/site-packages/robot_shop-0.1.0.dist-info/entry_points.txt"
    for file in (
        project / "resource/robot_shop",
        project / "launch/shop.launch.py",
        project / "config/shop.yaml",
        project / "package.xml",
        metadata,
    ):
        file.parent.mkdir(parents=True, exist_ok=True)
        file.touch()
    metadata.write_text("[console_scripts]\nsell_node = robot_shop.sell:main\n")
    bootstrap.put_into_ament_index(venv, project)
    (project / "launch/shop.launch.py").rename(project / "launch/store.launch.py")
    bootstrap.put_into_ament_index(venv, project)
    links = {str(link.relative_to(venv)): link.readlink() for link in venv.rglob("*") if link.is_symlink()}
    assert links == {
        "lib/robot_shop/sell_node": venv / "bin/sell_node",
        "share/ament_index/resource_index/packages/robot_shop": project / "resource/robot_shop",
        "share/robot_shop/config": project / "config",
        "share/robot_shop/launch/store.launch.py": project / "launch/store.launch.py",
        "share/robot_shop/package.xml": project / "package.xml",
    }


def test_set_up_compiles_the_loops_of_every_module_with_compiled_loops(bootstrap: ModuleType, root: Path) -> None:
    # Of what simulates; the loops of the tools are compiled when a tool first needs them.
    found = {
        path for path in (root / "src" / "gibson_sim").rglob("*.py") if re.search(r"^@compiled$", path.read_text(), re.MULTILINE)
    }
    assert set(bootstrap.COMPILED) == found
    compile(bootstrap.FIRST_IMAGE, "first_image", "exec")


def test_steps_say_what_they_do_and_how_long_it_took(bootstrap: ModuleType, capsys: pytest.CaptureFixture[str]) -> None:
    with bootstrap.counted_steps(), bootstrap.step("building"), bootstrap.step("fetching"):
        pass
    with pytest.raises(bootstrap.SetupError), bootstrap.step("failing"):
        raise bootstrap.SetupError("no")
    assert capsys.readouterr().out.splitlines() == [
        "gibson-sim setup: building ...",
        "gibson-sim setup: fetching ...",
        "gibson-sim setup: fetching: 0 s",
        "gibson-sim setup: building: 0 s",
        "gibson-sim setup: failing ...",
    ]


def test_every_package_belongs_to_a_section(bootstrap: ModuleType) -> None:
    found = bootstrap.sections()
    assert set(bootstrap.MESSAGE_SECTIONS) <= set(found)
    assert sum(len(packages) for packages in found.values()) == len(bootstrap.pins())
    assert all(len(bootstrap.pinned(name)) >= 1 for name in (*bootstrap.BUILD_TOOLS, *bootstrap.MESSAGE_TOOLS, "uv", "pip"))


def test_uv_gets_the_settings_of_pip_files_and_variables(
    bootstrap: ModuleType, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    for name in [name for name in os.environ if name.startswith(("PIP_", "XDG_", "SSL_", "HTTP"))]:
        monkeypatch.delenv(name)
    monkeypatch.setenv("XDG_CONFIG_HOME", str(tmp_path))
    monkeypatch.setenv("XDG_CONFIG_DIRS", str(tmp_path / "all"))
    monkeypatch.setattr(bootstrap.Path, "home", lambda: tmp_path / "home")
    (tmp_path / "pip").mkdir()
    (tmp_path / "pip" / "pip.conf").write_text(
        "[global]\nindex-url = https://mirror/simple\ncert = /mirror.pem\n[install]\nfind-links =\n    /wheels\n    /more\n"
    )
    monkeypatch.setenv("PIP_EXTRA_INDEX_URL", "https://other/simple")
    arguments = bootstrap.uv_arguments()
    assert arguments[:2] == ["--default-index", "https://mirror/simple"]
    assert arguments[-4:] == ["--find-links", "/wheels", "--find-links", "/more"]
    assert arguments[arguments.index("--index") + 1] == "https://other/simple"
    assert bootstrap.uv_environment() == {"SSL_CERT_FILE": "/mirror.pem"}
    monkeypatch.setenv("PIP_INDEX_URL", "https://mine/simple")
    assert bootstrap.uv_arguments()[:2] == ["--default-index", "https://mine/simple"], "a variable overrules a file"


def test_pip_installs_what_uv_cannot(bootstrap: ModuleType, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    commands = []

    def run(command: list[str], *_: object) -> None:
        commands.append(command)
        if command[0] == "uv":
            raise bootstrap.SetupError("no network")

    monkeypatch.setattr(bootstrap, "run", run)
    monkeypatch.setattr(bootstrap, "uv", lambda venv: Path("uv"))
    bootstrap.install(tmp_path, "log", "numpy==2.4.6")
    assert [command[:4] for command in commands[1:]] == [
        [str(tmp_path / "bin" / "python"), "-m", "ensurepip", "--default-pip"],
        [str(tmp_path / "bin" / "python"), "-m", "pip", "install"],
    ]
    assert all(command[-1] == "numpy==2.4.6" for command in (commands[0], commands[2]))


def _build(bootstrap: ModuleType, folder: Path, text: str) -> Path:
    """Returns a folder that stands for built message packages."""
    for file, content in {
        bootstrap.BUILT: "key\n",
        f"{bootstrap.MANIFESTS}/shop_msgs.txt": "lib/libshop.so\nshare/shop_msgs/cmake/shop.cmake\n",
        "lib/libshop.so": text,
        "share/shop_msgs/cmake/shop.cmake": f"set(here {bootstrap.PREFIX})",
    }.items():
        (folder / file).parent.mkdir(parents=True, exist_ok=True)
        (folder / file).write_text(content)
    return folder


def test_messages_are_built_once_for_all_environments(
    bootstrap: ModuleType, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    built = []

    def build(venv: Path, key: str) -> Path:
        built.append(key)
        return _build(bootstrap, venv / "built", f"library of {len(built)}")

    monkeypatch.setattr(bootstrap, "build_messages", build)
    for name in ("one", "two"):
        venv = tmp_path / name
        (venv / "gibson_setup").mkdir(parents=True)
        assert bootstrap.install_messages(venv)
        assert not bootstrap.install_messages(venv), "nothing to do"
        assert (venv / "lib" / "libshop.so").read_text() == "library of 1"
        assert (venv / "share" / "shop_msgs" / "cmake" / "shop.cmake").read_text() == f"set(here {venv})"
    assert len(built) == 1
    # Other messages: what the old ones had and the new ones have not goes.
    monkeypatch.setattr(bootstrap, "messages_key", lambda *texts: "other" + "".join(texts))
    (venv / bootstrap.MANIFESTS / "shop_msgs.txt").write_text("lib/libold.so\n")
    (venv / "lib" / "libold.so").touch()
    assert bootstrap.install_messages(venv)
    assert [path.name for path in (venv / "lib").iterdir()] == ["libshop.so"]
    assert (venv / "lib" / "libshop.so").read_text() == "library of 2"


def test_the_last_builds_of_messages_are_kept(bootstrap: ModuleType, tmp_path: Path) -> None:
    for number in range(bootstrap.KEPT_BUILDS + 2):
        kept = bootstrap.keep_messages(_build(bootstrap, tmp_path / "built", str(number)), tmp_path / "kept" / str(number))
        os.utime(kept, (number, number))
    assert sorted(path.name for path in (tmp_path / "kept").iterdir()) == ["2", "3", "4", "5"]


def test_messages_are_installed_where_the_cache_cannot_be_written(
    bootstrap: ModuleType, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "file").touch()
    built = _build(bootstrap, tmp_path / "built", "1")
    assert bootstrap.keep_messages(built, tmp_path / "file" / "kept") == built
    assert "not kept for other environments" in capsys.readouterr().out


def test_compiled_loops_move_between_clones(bootstrap: ModuleType, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    module = tmp_path / "src" / "gibson_sim" / "gibson_sim" / "physics" / "frames.py"
    monkeypatch.setattr(bootstrap, "ROOT", tmp_path)
    monkeypatch.setattr(bootstrap, "COMPILED", (module,))
    package, kept = module.parents[1], tmp_path / "kept"
    assert not bootstrap.copy_loops(package, kept)
    compiled = module.parent / "__pycache__" / "frames.turn-10.py311.nbi"
    compiled.parent.mkdir(parents=True)
    compiled.write_text("loops")
    assert bootstrap.copy_loops(package, kept)
    compiled.unlink()
    assert bootstrap.copy_loops(kept, package)
    assert compiled.read_text() == "loops"
