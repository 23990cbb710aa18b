"""`fffo-drive ctl` from the command line: its commands are the API's methods, its errors say what to do."""

from __future__ import annotations

import json
import re
import subprocess
import sys

import pytest
from daemon.rig import Rig

from fffo_drive.cli import main
from fffo_drive.daemon import serving
from fffo_drive.daemon.parameters import METHODS


def run(capsys, *words: str) -> tuple[int, str, str]:
    code = main(["ctl", *words])
    printed = capsys.readouterr()
    return code, printed.out, printed.err


def test_help_lists_every_method_with_its_words(capsys):
    with pytest.raises(SystemExit) as end:
        main(["ctl", "--help"])
    assert end.value.code == 0
    text = " ".join(capsys.readouterr().out.split())
    for name, method in METHODS.items():
        assert name.replace("_", "-") in text
        assert " ".join(method.summary.split()) in text
    for name in METHODS:
        with pytest.raises(SystemExit):
            main(["ctl", name.replace("_", "-"), "--help"])
        for field, info in METHODS[name].parameters.model_fields.items():
            text = " ".join(capsys.readouterr().out.split()) if field else text
            assert field == "name" or str(info.description).split()[0] in text
            break


def test_without_a_daemon_it_says_what_to_do(capsys, tmp_path, monkeypatch):
    code, _, error = run(capsys, "--sockets", str(tmp_path), "status")
    assert code == 69
    assert "fffo-drive serve" in error
    monkeypatch.setattr(serving, "SYSTEM_DIRECTORY", tmp_path)
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(tmp_path / "user"))
    assert run(capsys, "status")[0] == 69
    for name in ("can0", "can1"):
        (tmp_path / name).mkdir()
        (tmp_path / name / "watch.sock").touch()
    code, _, error = run(capsys, "status")
    assert code == 69
    assert "choose one with --axis: can0, can1" in error
    code, _, error = run(capsys, "--axis", "can7", "status")
    assert "no daemon of 'can7'" in error


def test_it_answers_quickly_because_it_imports_nothing_of_the_loop():
    heavy = ("numba", "numpy", "canopen", "asyncio")
    code = f"import sys, fffo_drive.cli.ctl; print([m for m in {heavy} if m in sys.modules])"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=120, check=True)
    assert done.stdout.strip() == "[]"


@pytest.mark.slow
@pytest.mark.realtime
@pytest.mark.timeout(300)
def test_a_session_at_the_terminal(capsys, tmp_path):
    with Rig(tmp_path) as rig:
        rig.until("ready")
        sockets = ("--sockets", str(rig.sockets))
        assert run(capsys, *sockets, "info", "--json")[0] == 0
        code, out, _ = run(capsys, *sockets, "status")
        assert code == 0
        assert out.startswith("ready, for")
        code, _, error = run(capsys, *sockets, "start")
        assert code == 70
        assert "start is not possible in state ready, only in enabled" in error
        assert run(capsys, *sockets, "enable")[1].startswith("state: enabled, reached: True, epoch: ")
        profile = tmp_path / "gentle.yaml"
        profile.write_text("kind: sine\nduration_s: 0.5\namplitude: 0.5\nfrequency_hz: 2\n")
        assert run(capsys, *sockets, "start", str(profile), "--wait-s", "60")[0] == 0
        code, _, error = run(capsys, *sockets, "start", "default", "--epoch", "7")
        assert code == 70
        assert "is the first one of this daemon" in error
        assert "not in 7" in error
        code, _, error = run(capsys, *sockets, "start", "no_such")
        assert code == 78
        assert "known: default" in error
        assert run(capsys, *sockets, "toggle", "off")[1] == "toggle: off\n"
        with pytest.raises(SystemExit) as end:
            run(capsys, *sockets, "toggle", "sideways")
        assert end.value.code == 2
        capsys.readouterr()
        key = "controller.proportional_a_per_rps"
        assert run(capsys, *sockets, "set", key, "0.9")[1] == f"key: {key}, value: 0.9\n"
        code, _, error = run(capsys, *sockets, "set", key, "nine")
        assert code == 78
        assert "no number" in error
        code, out, error = run(capsys, *sockets, "--json", "set", key, "-1")
        assert code == 78
        assert json.loads(out)["error"]["code"] == -32003
        code, _, error = run(capsys, *sockets, "model", str(rig.path.parent / "model.yaml"))
        assert code == 70
        assert "no change in state enabled" in error
        assert run(capsys, *sockets, "record", "on")[0] == 0
        code, out, _ = run(capsys, *sockets, "stop")
        assert code == 0
        assert re.fullmatch(r"at rest, \S+ rps measured; state: enabled, epoch: \d+\n", out)
        # what is typed now is a deliberate act, and names the epoch
        assert run(capsys, *sockets, "velocity", "2", "--run-on", "--wait-s", "60")[0] == 0
        out = run(capsys, *sockets, "stop", "--wait-s", "0")[1]
        assert re.match(r"taken, its end was not awaited: not at rest, [12][.\d]* rps measured; state: following", out)
        rig.until("enabled")
        assert run(capsys, *sockets, "start", str(profile), "--wait-s", "60")[0] == 0
        assert re.match("at rest, .*state: ready", run(capsys, *sockets, "quick-stop")[1])
        assert "\nstopped by pid " in run(capsys, *sockets, "status")[1]
        assert run(capsys, *sockets, "model", str(rig.path.parent / "model.yaml"))[0] == 0
        code, _, error = run(capsys, *sockets, "model", str(tmp_path / "none.yaml"))
        assert code == 78
        assert "none.yaml" in error
        code, out, _ = run(capsys, *sockets, "record", "off", "--json")
        assert json.loads(out)["files"]
        assert run(capsys, *sockets, "disable")[0] == 0
        assert run(capsys, *sockets, "reset-fault")[0] == 70
        code, out, _ = run(capsys, *sockets, "events", "--limit", "3")
        assert len(out.splitlines()) == 3
        assert run(capsys, *sockets, "reload")[0] == 0
