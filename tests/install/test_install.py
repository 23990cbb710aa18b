"""Install into an empty root directory and take it away again; from the source tree and from the wheel."""

from __future__ import annotations

import contextlib
import io
import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

from fffo_drive.cli import main
from fffo_drive.cli.install import hidden_from_services
from fffo_drive.system import placing, system_commands
from fffo_drive.system import service_files as sf
from fffo_drive.system.system_commands import after_install, after_removal
from fffo_drive.workflows.plan import make_plan

PROGRAM = "/opt/axis/bin/fffo-drive"
AXIS = "etc/fffo-drive/can0.yaml"
UNIT = f"{sf.UNITS}/{sf.UNIT}"


def install(root: Path, *words: str) -> dict[str, list[str]]:
    """`fffo-drive install` into root: what it says it did."""
    command = ["install", "--root", str(root), "--json", *words]
    if "--uninstall" not in words:
        command += ["--program", PROGRAM]
    printed = io.StringIO()
    with contextlib.redirect_stdout(printed):
        code = main(command)
    said = json.loads(printed.getvalue())
    assert code == (1 if any(command["problem"] for command in said["commands"]) else 0)
    return dict(said)


def files_in(root: Path) -> set[str]:
    """Files and links below root, without those of systemd-sysusers and groupdel."""
    found = {str(path.relative_to(root)) for path in root.rglob("*") if path.is_symlink() or path.is_file()}
    return {path for path in found if not path.startswith(("etc/group", "etc/gshadow", "etc/.pwd.lock"))}


def test_everything_comes_and_everything_goes(tmp_path):
    (tmp_path / "etc/systemd/system").mkdir(parents=True)
    said = install(tmp_path)
    assert set(said["installed"]) | {sf.MANIFEST} == files_in(tmp_path)
    assert {UNIT, "etc/udev/rules.d/90-fffo-drive.rules", AXIS} <= files_in(tmp_path)
    assert f"ExecStart={PROGRAM} serve %E/fffo-drive/%i.yaml" in (tmp_path / UNIT).read_text()
    said = install(tmp_path, "--uninstall")
    assert said["removed"]
    assert not said["kept"]
    assert files_in(tmp_path) == set()
    assert not (tmp_path / "etc/fffo-drive").exists()
    assert (tmp_path / "etc/systemd/system").is_dir()  # was there before


@pytest.mark.systemd
def test_the_group_comes_and_goes(tmp_path):
    install(tmp_path)
    assert any(line.startswith("fffo-drive:") for line in (tmp_path / "etc/group").read_text().splitlines())
    install(tmp_path, "--uninstall")
    assert "fffo-drive" not in (tmp_path / "etc/group").read_text()


def test_a_second_time_nothing_changes(tmp_path):
    install(tmp_path)
    before = {path: (tmp_path / path).read_bytes() for path in files_in(tmp_path)}
    said = install(tmp_path)
    assert not said["installed"] + said["updated"] + said["kept"]
    assert {path: (tmp_path / path).read_bytes() for path in files_in(tmp_path)} == before


def test_an_edited_file_is_never_overwritten_and_never_deleted(tmp_path):
    install(tmp_path)
    edited = (tmp_path / AXIS).read_text().replace("node_id: 1\n", "node_id: 5\n")
    (tmp_path / AXIS).write_text(edited)
    (tmp_path / "etc/fffo-drive/can1.yaml").write_text("mine")
    assert install(tmp_path)["kept"] == [AXIS]
    said = install(tmp_path, "--uninstall")
    assert said["kept"] == [AXIS]
    assert (tmp_path / AXIS).read_text() == edited
    assert files_in(tmp_path) == {AXIS, "etc/fffo-drive/can1.yaml"}


def test_a_file_that_was_there_before_is_kept(tmp_path):
    (tmp_path / "etc/fffo-drive").mkdir(parents=True)
    (tmp_path / AXIS).write_text("of somebody")
    assert install(tmp_path)["kept"] == [AXIS]
    install(tmp_path, "--uninstall")
    assert files_in(tmp_path) == {AXIS}


def test_an_update_replaces_what_nobody_edited(tmp_path):
    placing.place_files(tmp_path, [sf.ServiceFile("etc/a", b"one"), sf.ServiceFile("etc/b", b"one")])
    outcomes = placing.place_files(tmp_path, [sf.ServiceFile("etc/a", b"two")])
    assert {(one.path, one.action) for one in outcomes} == {("etc/a", placing.UPDATED), ("etc/b", placing.REMOVED)}
    assert (tmp_path / "etc/a").read_bytes() == b"two"
    assert not (tmp_path / "etc/b").exists()


def test_network_files_are_examples_until_an_interface_is_named(tmp_path):
    install(tmp_path)
    network = tmp_path / sf.NETWORK
    assert all(path.suffix == ".example" for path in network.iterdir())
    install(tmp_path, "--network", "vcan0")
    live = {path.name for path in network.iterdir() if path.suffix != ".example"}
    assert live == {"80-fffo-vcan0.netdev", "80-fffo-vcan0.network"}
    assert not (network / "80-fffo-vcan0.netdev.example").exists()


def test_links_of_enabled_units_go_with_the_unit(tmp_path):
    install(tmp_path)
    wants = tmp_path / sf.UNITS / "sys-subsystem-net-devices-can0.device.wants"
    wants.mkdir()
    (wants / "fffo-drive@can0.service").symlink_to(f"/{UNIT}")
    (wants / "other.service").symlink_to("/etc/systemd/system/other.service")
    install(tmp_path, "--uninstall")
    assert [path.name for path in wants.iterdir()] == ["other.service"]


@pytest.mark.parametrize("interface", ["can0", "vcan0"])
def test_the_installed_axis_is_a_correct_one_for_its_interface(tmp_path, interface):
    install(tmp_path)
    plan = make_plan(tmp_path / f"etc/fffo-drive/{interface}.yaml")
    assert plan.axis.drive.bus == f"socketcan:{interface}"
    assert plan.axis.name == interface
    assert plan.axis.commissioning is None  # an axis that nobody checked does not move


def test_a_program_that_the_sandbox_hides_is_refused(tmp_path, capsys):
    assert hidden_from_services([Path("/opt/fffo-drive/bin/fffo-drive")]) is None
    for path in ("/home/me/.venv/bin/fffo-drive", "/root/venv/bin/fffo-drive", "/tmp/venv/bin/fffo-drive"):
        assert hidden_from_services([Path("/usr/bin/python3"), Path(path)]) == Path(path)
    assert main(["install", "--root", str(tmp_path), "--program", "bin/fffo-drive"]) == 78
    assert "absolute path" in capsys.readouterr().err
    assert main(["install", "--root", str(tmp_path / "none"), "--program", PROGRAM]) == 78
    assert "no such directory" in capsys.readouterr().err
    assert main(["install", "--root", str(tmp_path), "--program", PROGRAM, "--network", "can7"]) == 78
    assert "can0, vcan0" in capsys.readouterr().err
    assert files_in(tmp_path) == set()


def test_a_broken_manifest_is_named(tmp_path, capsys):
    (tmp_path / "etc/fffo-drive").mkdir(parents=True)
    (tmp_path / sf.MANIFEST).write_text("{}")
    assert main(["install", "--root", str(tmp_path), "--program", PROGRAM]) == 78
    assert str(tmp_path / sf.MANIFEST) in capsys.readouterr().err


def test_another_root_is_no_reason_to_talk_to_this_systemd(tmp_path, monkeypatch):
    monkeypatch.setattr(system_commands, "RUNNING_SYSTEMD", tmp_path)
    monkeypatch.setattr(system_commands, "RUNNING_UDEV", tmp_path / "not there")
    for command in after_install(tmp_path) + after_removal(tmp_path):
        assert str(tmp_path) in " ".join(command.words)
    assert [command.words[0] for command in after_install(Path("/"))] == ["systemd-sysusers", "systemctl"]


def test_a_relative_root_is_made_absolute_for_the_system_programs(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    Path("image").mkdir()
    printed = install(Path("image"))["commands"]
    assert printed
    assert all(str(tmp_path / "image") in command["command"] for command in printed)


@pytest.mark.long  # it builds the wheel, and with it the manual
def test_the_wheel_brings_all_files(site, tmp_path):
    """The wheel installs the same files as the source tree."""
    root = tmp_path / "root"
    root.mkdir()
    words = ["-m", "fffo_drive", "install", "--root", str(root), "--program", PROGRAM, "--json"]
    environment = dict(os.environ, PYTHONPATH=str(site))
    done = subprocess.run([sys.executable, *words], capture_output=True, text=True, cwd=tmp_path, env=environment)
    assert done.stderr == ""
    expected = {file.path: file.content for file in sf.service_files(Path(PROGRAM))}
    assert {path: (root / path).read_bytes() for path in expected} == expected
