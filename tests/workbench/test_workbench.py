"""The workbench without a browser: lines that it types, roles, what it refuses, what it leaves in its log."""

from __future__ import annotations

import errno
import http.client
import io
import json
import shutil
import signal
import socket
import subprocess
import sys
from pathlib import Path

import pytest

from fffo_drive.can.link import free_loopback_port
from fffo_drive.cli import main
from fffo_drive.config.axis import read_axis
from fffo_drive.documents import DocumentError
from fffo_drive.live.keys import Asker
from fffo_drive.roles import ROLES, may
from fffo_drive.workbench import shelf
from fffo_drive.workbench.actions import ACTIONS, Bench
from fffo_drive.workbench.bench import AUDIT_NAME, ForbiddenError, Workbench
from fffo_drive.workbench.server import WorkbenchServer

CONFIGS = Path(__file__).resolve().parents[2] / "configs"
VERDICT = {"headline": "The model lacks cogging.", "finding": "cogging", "confidence": "certain",
           "next_step": "adopt it", "alarm": False}  # fmt: skip


@pytest.fixture
def axis(tmp_path):
    shutil.copytree(CONFIGS, tmp_path / "configs")
    return tmp_path / "configs" / "axis_undeclared.yaml"


@pytest.fixture
def workbench(tmp_path, axis):
    return Workbench(tmp_path / "out", axis, None, ())


def with_results(bench):
    """A recording, and the page of a diagnosis with its model."""
    (bench.directory / shelf.RUNS / "one.mcap").write_bytes(b"-")
    page = bench.directory / "diagnose_1"
    page.mkdir()
    (page / "report.json").write_text(json.dumps({"kind": "diagnose", "verdict": "effects_found", "opening": VERDICT}))
    (page / "report.html").write_text("<!DOCTYPE html>")
    shutil.copy(CONFIGS / "models" / "table1.yaml", page / "model.yaml")
    return Bench(bench.directory, bench._axis, None, ())


def on_a_free_bus(axis):
    """The example of an axis on a bus, on one where nobody answers."""
    file = axis.with_name("axis_canopen.yaml")
    file.write_text(file.read_text().replace("loopback:29500", f"loopback:{free_loopback_port()}"))
    return file


def test_every_action_is_a_line_that_its_command_understands(workbench):
    from fffo_drive.cli import parser_of

    bench = with_results(workbench)._replace(fleet="s3://bucket/store")
    run, model = str(bench.directory / "runs" / "one.mcap"), str(bench.directory / "diagnose_1" / "model.yaml")
    wishes = {
        "record": {"motion": "recipe", "toggle": "off"}, "circle": {"quick": True}, "identify": {"fit": [run]},
        "diagnose": {"fit": [run], "held_out": [run]}, "compare": {"fit": [run]}, "roll_back": {},
        "tune": {"model": model}, "adopt": {"model": model, "dry_run": True},
        "fleet_add": {"fit": [run]}, "fleet_work": {},
        "fleet_report": {"alarms_per_drive_year": 0.01, "serial": "-odd"},
        "fleet_diagnose": {"alarms_per_drive_year": 0.01, "serial": "-odd"},
    }  # fmt: skip
    assert set(wishes) == set(ACTIONS) - {"commission", "serve", "simulate", "accept"}
    for name, wish in wishes.items():
        order = ACTIONS[name].make(bench, wish)
        parser_of(order.words[0]).parse_args(order.words[1:])
    on_bus = bench._replace(axis=on_a_free_bus(bench.axis))
    served = on_bus._replace(served=bench.directory, who="anna (move)")
    for name, where in (("commission", on_bus), ("serve", on_bus), ("simulate", on_bus), ("accept", on_bus),
                        ("record", served)):  # fmt: skip
        words = ACTIONS[name].make(where, {}).words
        parser_of(words[0]).parse_args(words[1:])
    assert "--served" in words


@pytest.mark.parametrize(
    ("name", "wish", "text"),
    [
        ("record", {"motion": "dance"}, "no motion is called 'dance'"),
        ("identify", {"fit": []}, "tick at least one run"),
        ("identify", {"fit": ["/etc/passwd"]}, "no recording of this workbench"),
        ("tune", {"model": "/etc/passwd"}, "choose a model"),
        ("adopt", {}, "choose a model"),
        ("fleet_work", {}, "give one with --fleet"),
        ("commission", {}, "needs no commissioning record"),
        ("serve", {}, "a simulated drive in process is not served"),
        ("simulate", {}, "not on a loopback bus"),
    ],
)
def test_what_cannot_be_meant_is_refused_with_a_reason(workbench, name, wish, text):
    with pytest.raises(DocumentError, match=text):
        ACTIONS[name].make(with_results(workbench), wish)


def test_the_simulated_drive_has_the_file_beside_its_axis_else_the_example(workbench):
    bench = with_results(workbench)
    axis = on_a_free_bus(bench.axis)
    beside = axis.with_name("simulated_drive.yaml")
    drive = read_axis(axis).drive
    words = ACTIONS["simulate"].make(bench._replace(axis=axis), {}).words
    assert words == ("sim", str(beside), "--bus", drive.bus, "--node", str(drive.node_id))
    example = beside.read_bytes()
    beside.unlink()
    words = ACTIONS["simulate"].make(bench._replace(axis=axis), {}).words
    assert Path(words[1]).parent == bench.directory
    assert Path(words[1]).read_bytes() == example


def test_an_answer_needs_its_role_and_an_open_question(workbench):
    with pytest.raises(DocumentError, match="not open any more"):
        workbench.answer(Asker("tune"), {"question": 1, "answer": "yes"})


def test_without_an_axis_nothing_moves(tmp_path):
    bench = Bench(tmp_path, None, None, ())
    for name in ("record", "circle", "commission", "adopt"):
        with pytest.raises(DocumentError):
            ACTIONS[name].make(bench, {})


def test_roles_hold_each_other_and_everything_that_moves_needs_one_that_may():
    for k, role in enumerate(ROLES):
        assert [may(role, other) for other in ROLES] == [j <= k for j in range(len(ROLES))]
    assert all(may(action.role, "move") for action in ACTIONS.values() if action.moves)
    assert not any(may("stop", action.role) for action in ACTIONS.values())  # they look, and end what runs


def test_a_role_is_refused_what_it_may_not_and_the_log_says_who_did_what(workbench):
    for role, name in (
        ("look", "record"),
        ("look", "identify"),
        ("stop", "diagnose"),
        ("stop", "record"),
        ("move", "tune"),
        ("move", "circle"),
    ):
        with pytest.raises(ForbiddenError, match="your key does not allow it"):
            workbench.act(Asker(role), name, {})
    with pytest.raises(ForbiddenError):
        workbench.cancel(Asker("look"))
    with pytest.raises(ForbiddenError):
        workbench.take(Asker("stop"), "run.csv", b"")
    with pytest.raises(ForbiddenError):
        workbench.use_axis(Asker("move"), "x")
    assert not (workbench.directory / AUDIT_NAME).exists()
    workbench.take(Asker("move", "anna"), "run.csv", b"time_s\n")
    entry = json.loads((workbench.directory / AUDIT_NAME).read_text())
    assert (entry["role"], entry["name"], entry["action"], entry["file"]) == ("move", "anna", "take", "run.csv")


@pytest.mark.parametrize("name", ["../run.csv", "/tmp/run.csv", ".run.csv", "run.exe", "", "a\0.csv"])
def test_a_file_is_taken_in_under_a_plain_name_of_its_kind(workbench, name):
    with pytest.raises(DocumentError):
        workbench.take(Asker("tune"), name, b"")


def test_a_file_that_is_there_is_not_overwritten(workbench):
    workbench.take(Asker("tune"), "run.csv", b"first")
    with pytest.raises(DocumentError, match="already exists"):
        workbench.take(Asker("tune"), "run.csv", b"second")
    assert (workbench.directory / "runs" / "run.csv").read_bytes() == b"first"


def test_what_a_full_disk_cuts_off_is_not_left(workbench, monkeypatch):
    class FullDisk(io.BytesIO):
        def write(self, content):
            raise OSError(errno.ENOSPC, "No space left on device")

    opened = Path.open
    monkeypatch.setattr(
        Path, "open", lambda path, mode="r", **more: (opened(path, mode, **more).close(), FullDisk())[1]
    )
    with pytest.raises(OSError, match="No space"):
        workbench.take(Asker("tune"), "run.csv", b"first")
    assert not (workbench.directory / "runs" / "run.csv").exists()


def test_the_state_names_runs_pages_and_what_the_key_allows(workbench):
    with_results(workbench)
    state = workbench.state(Asker("look"))
    assert (state["role"], state["may_cancel"]) == ("look", False)
    assert state["may"] == []
    assert [run["name"] for run in state["runs"]] == ["one.mcap"]
    (page,) = state["pages"]
    assert (page["name"], page["finding"], page["confidence"]) == ("diagnose_1", "cogging", "certain")
    assert page["model"].endswith("diagnose_1/model.yaml")
    assert state["axis"]["drive"] == "simulated, in process"
    json.dumps(state)


def test_what_is_gone_again_and_reports_of_others_do_not_end_the_state(workbench):
    bench = with_results(workbench)
    (bench.directory / shelf.RUNS / "gone.mcap").symlink_to(bench.directory / "nowhere")
    for name, content in (("list", "[1]"), ("text", '{"verdict": "fine"}'), ("old", '{"verdict": {"finding": "x"}}')):
        (bench.directory / name).mkdir()
        (bench.directory / name / "report.json").write_text(content)
        (bench.directory / name / "report.html").write_text("<!DOCTYPE html>")
    state = workbench.state(Asker("look"))
    assert [run["name"] for run in state["runs"]] == ["one.mcap"]
    assert [page["name"] for page in state["pages"]] == ["diagnose_1"]


def test_an_axis_file_with_a_mistake_is_reported_and_the_bench_lives(workbench, axis):
    axis.write_text(axis.read_text().replace("speed_limit_rps", "speed_limt_rps"))
    error = workbench.state(Asker("tune"))["axis"]["error"]
    assert "speed_limt_rps" in error


def test_only_axis_files_of_this_bench_can_be_chosen(workbench, tmp_path):
    with pytest.raises(DocumentError, match="no axis file of this workbench"):
        workbench.use_axis(Asker("tune"), str(tmp_path / "configs" / "axis_bench.yaml"))
    tuned = workbench.directory / "tune_1"
    tuned.mkdir()
    text = (tmp_path / "configs" / "axis_undeclared.yaml").read_text()
    (tuned / "axis_undeclared.yaml").write_text(text)
    (tuned / "controller.yaml").write_text("controller: {}")
    workbench.use_axis(Asker("tune"), str(tuned / "axis_undeclared.yaml"))
    state = workbench.state(Asker("tune"))
    assert state["axis"]["path"] == str(tuned / "axis_undeclared.yaml")
    assert len(state["axis_files"]) == 2


def test_results_never_overwrite_each_other(tmp_path):
    for number in (1, 2, 3):
        path = shelf.next_free(tmp_path, "tune")
        assert path.name == f"tune_{number}"
        path.mkdir()


@pytest.fixture
def served(workbench):
    with_results(workbench)
    server = WorkbenchServer(workbench)
    server.start()
    yield server
    server.close()


def asked(served, method, path, body=None, **more):
    port = served._server.server_address[1]
    connection = http.client.HTTPConnection("127.0.0.1", port, timeout=30)
    given = {"Host": f"127.0.0.1:{port}", "Origin": f"http://127.0.0.1:{port}"} | more
    connection.putrequest(method, path, skip_host=True)
    for name, value in given.items():
        if value:
            connection.putheader(name, value)
    content = json.dumps(body).encode() if body is not None else b""
    if "Content-Length" not in more:
        connection.putheader("Content-Length", str(len(content)))
    connection.endheaders(content)
    answer = connection.getresponse()
    text = answer.read()
    connection.close()
    return answer.status, dict(answer.getheaders()), text


def test_nobody_without_the_key_or_from_another_page_gets_anything(served):
    key = served.bench.keys.of("tune")
    assert asked(served, "GET", "/")[0] == 404
    assert asked(served, "GET", "/guess/state")[0] == 404
    assert asked(served, "GET", f"/{key}/state")[0] == 200
    assert asked(served, "GET", f"/{key}/state", Host="evil.example")[0] == 421
    for origin in ("http://evil.example", "null", ""):
        assert asked(served, "POST", f"/{key}/record", {}, Origin=origin)[0] == 403
    assert served.bench.jobs.all() == []


def test_the_page_runs_nothing_but_its_own_and_keys_have_their_role(served):
    for role in ROLES:
        status, headers, text = asked(served, "GET", f"/{served.bench.keys.of(role)}/")
        assert status == 200
        assert b"http://" not in text.replace(b"http://www.w3.org", b"")
        assert "frame-ancestors 'none'" in headers["Content-Security-Policy"]
        assert headers["Referrer-Policy"] == "no-referrer"
        assert json.loads(asked(served, "GET", f"/{served.bench.keys.of(role)}/state")[2])["role"] == role
    status, _, text = asked(served, "POST", f"/{served.bench.keys.of('look')}/record", {})
    assert (status, "move is needed" in json.loads(text)["error"]) == (403, True)


@pytest.mark.parametrize("name", ["../configs/axis_bench.yaml", "%2e%2e/configs/axis_bench.yaml", "runs/one.mcap", "x"])
def test_files_are_those_pages_of_the_directory_and_no_others(served, name):
    key = served.bench.keys.of("tune")
    assert asked(served, "GET", f"/{key}/files/diagnose_1/report.html")[0] == 200
    assert asked(served, "GET", f"/{key}/files/{name}")[0] == 404


def test_a_page_is_found_whatever_its_directory_is_called(served):
    folder = served.bench.directory / "Versuch #2, 50 % Öl?"
    (served.bench.directory / "diagnose_1").rename(folder)
    key = served.bench.keys.of("look")
    (page,) = json.loads(asked(served, "GET", f"/{key}/state")[2])["pages"]
    assert page["name"] == folder.name
    assert asked(served, "GET", f"/{key}/files/{page['page']}")[0] == 200


def test_a_file_that_is_cut_off_on_its_way_is_not_taken_in(served):
    port, key = served._server.server_address[1], served.bench.keys.of("tune")
    head = f"POST /{key}/take?name=run.csv HTTP/1.1\r\nHost: 127.0.0.1:{port}\r\nOrigin: http://127.0.0.1:{port}\r\n"
    with socket.create_connection(("127.0.0.1", port), timeout=30) as connection:
        connection.sendall(f"{head}Content-Length: 100\r\n\r\ntime_s\n".encode())
        connection.shutdown(socket.SHUT_WR)
        with connection.makefile("rb") as answer:
            assert b" 400 " in answer.readline()
    assert not (served.bench.directory / "runs" / "run.csv").exists()


def test_what_is_too_large_is_refused_before_it_is_read(served):
    for role, what in (("tune", "record"), ("look", "take?name=run.csv")):
        path = f"/{served.bench.keys.of(role)}/{what}"
        assert asked(served, "POST", path, **{"Content-Length": str(1 << 20)})[0] == 413
    assert not (served.bench.directory / "runs" / "run.csv").exists()


@pytest.mark.parametrize("body", [[], "x", {"fit": 3}, {"fit": [["a"]]}, {"fit": ["a"]}])
def test_what_is_not_understood_is_refused_and_the_server_lives(served, body):
    key = served.bench.keys.of("tune")
    assert asked(served, "POST", f"/{key}/identify", body)[0] == 400
    assert asked(served, "POST", f"/{key}/nothing", {})[0] == 400
    assert asked(served, "POST", f"/{key}/record", {"motion": ["a"]})[0] == 400
    assert asked(served, "GET", f"/{key}/state")[0] == 200


@pytest.mark.parametrize(
    ("words", "text"),
    [
        (("--port", "99999"), "--port 99999"),
        (("theirs.exe",), "neither an axis file"),
        (("theirs.csv",), "no such file"),
        (("nowhere.yaml",), "nowhere.yaml"),
        (("--drive", "nowhere.yaml"), "nowhere.yaml"),
    ],
)
def test_a_mistake_on_the_command_line_is_named(words, text, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    assert main(["workbench", "--no-browser", *words]) == 78
    assert text in capsys.readouterr().err


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM, signal.SIGHUP])
def test_what_was_started_ends_with_the_workbench(number, tmp_path, monkeypatch):
    before = {one: signal.getsignal(one) for one in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)}
    closed = []
    monkeypatch.setattr(Workbench, "close", lambda self: closed.append(self))
    monkeypatch.setattr(WorkbenchServer, "wait", lambda _: signal.raise_signal(number))
    signal.signal(signal.SIGINT, signal.default_int_handler)  # a shell in the background has it ignored
    signal.signal(signal.SIGHUP, signal.SIG_DFL)  # nohup has it ignored
    try:
        assert main(["workbench", "--no-browser", "--out", str(tmp_path)]) == 0
    finally:
        for one, handler in before.items():
            signal.signal(one, handler)
    assert len(closed) == 1


def test_it_needs_nothing_but_what_every_installation_has():
    """`live` is an extra: its library is not in the environment of who only runs."""
    program = "import sys; sys.modules['websockets'] = None; import fffo_drive.cli.workbench"
    subprocess.run([sys.executable, "-c", program], check=True)
