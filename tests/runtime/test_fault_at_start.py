"""A drive that is in fault at the start: refused with the command that clears it, and cleared when told."""

from __future__ import annotations

import json

import pytest
from daemon.rig import CommandedNode, axis_file, edit

from fffo_drive.can.link import free_loopback_port
from fffo_drive.cli import main
from fffo_drive.commissioning.procedure import NotAgreedError
from fffo_drive.drive.canopen import scan
from fffo_drive.drive.simulated.cia402_device import FAULT, SWITCH_ON_DISABLED
from fffo_drive.drive.simulated.node.config import NodeConfig
from fffo_drive.drive.simulated.node.faults import Fault, FaultKind
from fffo_drive.recording.reader import read_run
from fffo_drive.workflows import rate_trial
from fffo_drive.workflows.commission import bounds_of, commission_axis, commissioning_plan

pytestmark = [pytest.mark.slow, pytest.mark.realtime, pytest.mark.timeout(300)]

OVER = Fault(FaultKind.OVERCURRENT, duration_s=0.001)  # gone, and latched in the drive
STAYS = Fault(FaultKind.OVERCURRENT)


@pytest.fixture
def bus():
    return f"loopback:{free_loopback_port()}"


def node_in_fault(bus, *faults):
    return CommandedNode(bus, NodeConfig(sync_loss_tolerance_ms=10_000, faults=faults))


def short_axis(folder):
    axis = axis_file(folder)
    edit(axis, lambda content: content["profile"].update(duration_s=1, frequency_hz=2))
    return axis


def test_a_run_names_the_command_and_with_it_clears_the_fault_and_says_which(tmp_path, capsys, bus):
    axis, out = short_axis(tmp_path), tmp_path / "run.mcap"
    words = ["run", str(axis), "--bus", bus, "--uncommissioned", "--json", "--out", str(out)]
    with node_in_fault(bus, OVER) as node:
        assert main(words) == 70
        said = capsys.readouterr().err
        assert (
            "the drive is in fault (0x603F 0x2310 (continuous over-current at the output); statusword 0x0218: fault"
            in said
        )
        assert f"`fffo-drive run {axis} --reset-fault`" in said
        assert node.node.drive.state == FAULT  # nothing was reset by itself
        assert main([*words, "--reset-fault"]) == 0
        output = capsys.readouterr()
    assert "fault cleared: " in output.err
    assert json.loads(output.out)["fault"] is None
    assert "fault cleared: " in read_run(out).metadata["at_start"]


def test_a_fault_whose_cause_is_still_there_is_not_cleared(tmp_path, capsys, bus):
    axis, out = short_axis(tmp_path), tmp_path / "run.mcap"
    with node_in_fault(bus, STAYS) as node:
        assert main(["run", str(axis), "--bus", bus, "--uncommissioned", "--out", str(out), "--reset-fault"]) == 70
        assert node.node.drive.state == FAULT
    assert "the drive stays in fault after a reset" in capsys.readouterr().err


def test_commission_the_same(tmp_path, capsys, bus):
    axis = axis_file(tmp_path)
    words = ["commission", str(axis), "--bus", bus, "--out", str(tmp_path / "record.yaml")]
    with node_in_fault(bus, OVER) as node:
        assert main([*words, "--yes"]) == 70
        assert f"`fffo-drive commission {axis} --reset-fault`" in capsys.readouterr().err
        assert node.node.drive.state == FAULT
        plan, told = commissioning_plan(axis), list[str]()
        with pytest.raises(NotAgreedError):  # to the first motion
            commission_axis(
                plan,
                bounds_of(plan),
                tmp_path / "record.yaml",
                bus,
                told.append,
                may_move=lambda motion: False,
                reset_fault=True,
            )
        assert any(text.startswith("fault cleared: ") for text in told)
        assert node.node.drive.state == SWITCH_ON_DISABLED


def test_bring_up_the_same(tmp_path, capsys, bus, monkeypatch):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(rate_trial, "SETTLE_S", 0.05)
    monkeypatch.setattr(scan, "NAME_TIMEOUT_S", 2.0)  # a busy machine is no silent drive
    words = ["bring-up", bus, "--yes", "--json", "--seconds", "0.1", "--torque-constant", "0.148"]

    def finding(arguments):
        code = main(arguments)
        report = json.loads(capsys.readouterr().out)
        return code, next(one for one in report["findings"] if one["subject"] == "fault")

    with node_in_fault(bus, OVER) as node:
        code, found = finding(words)
        assert (code, found["level"]) == (70, "failure"), found
        command = f"fffo-drive bring-up {bus} --node 1 --out axis.yaml --force --reset-fault"
        assert f"`{command}`" in found["remedy"]
        assert node.node.drive.state == FAULT
        _, found = finding([*words, "--force", "--reset-fault"])
        assert found["text"].startswith("fault cleared: ")
        assert "in the way" not in found["text"]
        assert node.node.drive.state == SWITCH_ON_DISABLED


def test_a_drive_in_no_fault_is_run_as_before(tmp_path, capsys, bus):
    axis, out = short_axis(tmp_path), tmp_path / "run.mcap"
    with node_in_fault(bus):
        code = main(["run", str(axis), "--bus", bus, "--uncommissioned", "--out", str(out), "--reset-fault"])
    said = capsys.readouterr().err
    assert code == 0, said
    assert "cleared" not in said
    assert "at_start" not in read_run(out).metadata


def test_of_a_served_drive_the_daemon_resets(tmp_path):
    with pytest.raises(SystemExit, match="fffo-drive ctl reset-fault"):
        main(["run", str(axis_file(tmp_path)), "--served", "--reset-fault"])
    with pytest.raises(SystemExit, match="not with --no-measure"):
        main(["bring-up", "loopback:29500", "--no-measure", "--reset-fault"])
