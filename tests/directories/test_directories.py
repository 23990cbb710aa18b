"""Directories in places that everybody may write to: ours alone, or not used."""

from __future__ import annotations

import os
import stat
import subprocess
import sys
import tempfile
from pathlib import Path

import pytest

from fffo_drive.cli import main
from fffo_drive.daemon.places import socket_directory, user_directory
from fffo_drive.directories import ForeignDirectoryError, own_directory, require_own, shared_place
from fffo_drive.jit import cache_root

AXIS = Path(__file__).resolve().parents[2] / "configs" / "axis_simulated.yaml"
NOBODY = 65534
ROOT = os.getuid() == 0


@pytest.fixture
def shared(tmp_path, monkeypatch):
    """A place like /tmp, and nothing of the user's own."""
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    for name in ("XDG_RUNTIME_DIR", "RUNTIME_DIRECTORY", "NUMBA_CACHE_DIR", "CACHE_DIRECTORY", "STATE_DIRECTORY"):
        monkeypatch.delenv(name, raising=False)
    monkeypatch.setenv("XDG_CACHE_HOME", "/proc/no_cache")
    return tmp_path


def made_by_others(path: Path) -> str:
    """A directory that somebody else made in advance. Returns what is to be said of it."""
    path.mkdir(mode=0o777)
    if ROOT:
        os.chown(path, NOBODY, NOBODY)
        return f"not ours: it belongs to uid {NOBODY}"
    path.chmod(0o777)
    return "open to others: its mode is 0777"


def test_what_is_made_is_ours_alone_and_is_used_again(shared):
    before = os.umask(0)
    try:
        path = own_directory(shared_place("x"))
    finally:
        os.umask(before)
    assert path == shared / f"x-{os.getuid()}"
    assert stat.S_IMODE(path.stat().st_mode) == 0o700
    assert own_directory(path) == path


@pytest.mark.parametrize("mode", [0o770, 0o707, 0o722, 0o1777])
def test_one_that_others_may_write_to_is_refused(shared, mode):
    path = shared / "open"
    path.mkdir()
    path.chmod(mode)
    with pytest.raises(ForeignDirectoryError, match=f"its mode is {mode:04o}"):
        own_directory(path)


def test_a_link_and_a_file_are_refused(shared):
    (shared / "real").mkdir(mode=0o700)
    (shared / "link").symlink_to(shared / "real")
    (shared / "dangling").symlink_to(shared / "nothing")
    (shared / "file").write_text("")
    for name, problem in (("link", "a link"), ("dangling", "a link"), ("file", "no directory")):
        with pytest.raises(ForeignDirectoryError, match=problem):
            own_directory(shared / name)
    assert not (shared / "nothing").exists()


@pytest.mark.skipif(not ROOT, reason="only root gives files away")
def test_one_of_somebody_else_is_refused_whatever_its_mode(shared):
    path = shared / "theirs"
    path.mkdir(mode=0o700)
    os.chown(path, NOBODY, NOBODY)
    with pytest.raises(ForeignDirectoryError, match=f"uid {NOBODY}"):
        require_own(path)


def test_sockets_are_not_put_or_looked_for_in_a_directory_of_others(shared, capsys):
    problem = made_by_others(shared_place("fffo-drive"))
    for place in (lambda: socket_directory("axis"), user_directory):
        with pytest.raises(ForeignDirectoryError, match=problem):
            place()
    assert main(["ctl", "status"]) == 74
    said = capsys.readouterr().err
    assert f"{shared_place('fffo-drive')}: {problem}" in said
    assert "remove it and start again" in said


def test_sockets_have_a_directory_of_our_own(shared):
    assert user_directory() == shared_place("fffo-drive") / "fffo-drive"
    assert not shared_place("fffo-drive").exists()
    assert socket_directory("axis") == user_directory() / "axis"
    assert stat.S_IMODE(shared_place("fffo-drive").stat().st_mode) == 0o700
    assert socket_directory("axis", {"RUNTIME_DIRECTORY": "/run/fffo-drive/can0"}) == Path("/run/fffo-drive/can0")


def test_compiled_code_is_not_taken_from_a_directory_of_others(shared):
    root = cache_root()
    assert root == shared_place("fffo_drive") / "numba"
    assert [stat.S_IMODE(path.stat().st_mode) for path in (root, root.parent)] == [0o700, 0o700]
    root.rmdir()
    problem = made_by_others(root)
    with pytest.raises(ForeignDirectoryError, match=problem):
        cache_root()


@pytest.mark.skipif(not ROOT, reason="only root gives files away")
def test_the_cache_of_another_user_is_passed_over(shared, monkeypatch):
    """As under sudo, which may keep HOME."""
    theirs = shared / "home"
    made_by_others(theirs)
    monkeypatch.setenv("XDG_CACHE_HOME", str(theirs / ".cache"))
    assert cache_root() == shared_place("fffo_drive") / "numba"
    assert not (theirs / ".cache").exists()


def test_a_command_that_compiles_says_so_without_a_traceback(shared):
    problem = made_by_others(shared_place("fffo_drive"))
    done = subprocess.run(
        [sys.executable, "-m", "fffo_drive", "run", str(AXIS), "--out", str(shared / "run.mcap")],
        capture_output=True, text=True, env={**os.environ, "TMPDIR": str(shared), "NUMBA_DISABLE_JIT": "0"},
    )  # fmt: skip
    assert done.returncode == 74
    assert done.stderr.startswith(f"fffo-drive run: {shared_place('fffo_drive')}: {problem}")
    assert len(done.stderr.splitlines()) == 1
