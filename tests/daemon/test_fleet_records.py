"""Records of the fleet by a unit of its own: a request on its socket, and what comes back."""

from __future__ import annotations

import json
import socket
import subprocess
import sys
import threading
from pathlib import Path

import pytest
from fleet.fleet_rig import write_run

from fffo_drive.daemon import fleet_records, places
from fffo_drive.fleet.store import FleetStore

LONGEST_S = 120.0


@pytest.fixture
def listener(tmp_path, monkeypatch):
    """The socket, as the service manager has it for the axis can0."""
    monkeypatch.setattr(places, "SYSTEM_RECORDS", tmp_path)
    monkeypatch.setenv("RUNTIME_DIRECTORY", "/run/fffo-drive/can0")
    with socket.socket(socket.AF_UNIX, socket.SOCK_STREAM) as sock:
        sock.bind(str(tmp_path / "can0.sock"))
        sock.listen()
        yield sock


def unit(listener: socket.socket) -> subprocess.Popen:
    """What the service manager starts: the socket is descriptor 3, and LISTEN_PID the process itself."""
    code = (
        f"import os, sys; os.dup2({listener.fileno()}, 3); os.environ.update(LISTEN_PID=str(os.getpid()), "
        "LISTEN_FDS='1'); os.execv(sys.executable, [sys.executable, '-m', 'fffo_drive', 'fleet', 'answer'])"
    )
    return subprocess.Popen([sys.executable, "-c", code], pass_fds=[listener.fileno()], stderr=subprocess.PIPE)


def test_the_unit_makes_what_it_is_asked_for_and_says_what_went_wrong(listener, tmp_path):
    store, run = tmp_path / "store", write_run(tmp_path / "run.csv", 1)
    with unit(listener) as process:  # a table has no facts with it: there is a complaint
        said = fleet_records._make(str(store), [str(run)])
        assert process.wait(LONGEST_S) == 0
    assert "--drive FILE" in said
    assert FleetStore(str(store)).index().num_rows == 0


def test_a_unit_that_is_killed_in_the_midst_is_told(listener):
    def die() -> None:
        connection, _ = listener.accept()
        with connection, connection.makefile("rb") as lines:
            assert json.loads(lines.readline()) == {"store": "s", "files": ["a.mcap"]}

    thread = threading.Thread(target=die)
    thread.start()
    said = fleet_records._make("s", ["a.mcap"])
    thread.join()
    assert "fffo-drive-records@can0 ended without an answer" in said
    assert "out of memory" in said


def test_by_hand_it_says_who_starts_it():
    done = subprocess.run(
        [sys.executable, "-m", "fffo_drive", "fleet", "answer"], capture_output=True, text=True, timeout=LONGEST_S
    )
    assert done.returncode == 78
    assert "fffo-drive-records@NAME.socket" in done.stderr


def test_without_the_unit_a_child_does_it_which_is_the_first_to_be_killed_from_its_first_byte_on(monkeypatch):
    """A child of the service would have the service's own score, until it said otherwise: too late."""
    monkeypatch.delenv("RUNTIME_DIRECTORY", raising=False)
    assert places.records_socket() is None
    before = Path("/proc/self/oom_score_adj").read_text()
    monkeypatch.setattr(sys, "executable", "/bin/cat")
    words = fleet_records.command("store", ["a.mcap"])
    shell = words[: words.index("/bin/cat") + 1]
    done = subprocess.run([*shell, "/proc/self/oom_score_adj"], capture_output=True, text=True, timeout=LONGEST_S)
    assert done.stdout == "1000\n"
    assert Path("/proc/self/oom_score_adj").read_text() == before
