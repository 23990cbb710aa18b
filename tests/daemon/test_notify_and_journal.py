"""What goes to the service manager and the journal: datagrams, byte by byte."""

from __future__ import annotations

import contextlib
import io
import json
import os
import re
import socket
import struct
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from fffo_drive.daemon import journal as journals
from fffo_drive.daemon.event_log import KEPT, EventLog
from fffo_drive.daemon.journal import LONGEST_VALUE, MESSAGE_IDS, Journal, encode_fields
from fffo_drive.daemon.notify import Notifier
from fffo_drive.recording.events import Level


def test_every_kind_of_event_has_its_message_id():
    said = "".join(path.read_text() for path in Path(journals.__file__).parent.glob("*.py"))
    kinds = set(re.findall(r'log\.add\(\s*"(\w+)"|self\.add\(\s*"(\w+)"', said))
    assert {kind or other for kind, other in kinds} <= set(MESSAGE_IDS)
    assert len(kinds) > 10
    assert len(set(MESSAGE_IDS.values())) == len(MESSAGE_IDS)
    assert all(re.fullmatch(r"[0-9a-f]{32}", number) for number in MESSAGE_IDS.values())


@pytest.fixture
def manager(tmp_path):
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as sock:
        sock.bind(str(tmp_path / "notify"))
        sock.settimeout(10)
        yield sock, {"NOTIFY_SOCKET": str(tmp_path / "notify")}


def test_what_the_service_manager_is_told(manager):
    sock, environment = manager
    notifier = Notifier(environment)
    notifier.ready()
    notifier.status("two\nlines")
    notifier.status("two lines")  # nothing new
    notifier.alive()
    notifier.reloading()
    notifier.stopping()
    messages = [sock.recv(4096).decode() for _ in range(5)]
    assert messages[:3] == ["READY=1", "STATUS=two lines", "WATCHDOG=1"]
    assert re.fullmatch(r"RELOADING=1\nMONOTONIC_USEC=\d+", messages[3])
    assert messages[4:] == ["STOPPING=1"]
    assert notifier.failures == 0


def test_an_abstract_socket_is_reached():
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as sock:
        name = f"fffo-test-{os.getpid()}"
        sock.bind("\0" + name)
        sock.settimeout(10)
        Notifier({"NOTIFY_SOCKET": f"@{name}"}).ready()
        assert sock.recv(100) == b"READY=1"


def test_without_a_manager_nothing_happens_and_one_that_is_gone_is_only_counted(tmp_path):
    Notifier({}).ready()
    notifier = Notifier({"NOTIFY_SOCKET": str(tmp_path / "gone")})
    notifier.ready()
    assert notifier.failures == 1


def test_a_busy_manager_is_told_the_status_again(manager):
    sock, environment = manager
    notifier = Notifier(environment)
    while not notifier.failures:  # its queue is full
        notifier.alive()
    notifier.status("running")
    assert notifier.failures == 2
    while sock.recv(4096) == b"WATCHDOG=1":
        notifier.status("running")
    notifier.status("running")  # once was enough
    sock.setblocking(False)
    left = set()
    with contextlib.suppress(BlockingIOError):
        while True:
            left.add(sock.recv(4096))
    assert left <= {b"WATCHDOG=1"}


@pytest.mark.parametrize(
    ("environment", "expected"),
    [
        ({}, None),
        ({"WATCHDOG_USEC": "3000000"}, 3.0),
        ({"WATCHDOG_USEC": "3000000", "WATCHDOG_PID": str(os.getpid())}, 3.0),
        ({"WATCHDOG_USEC": "3000000", "WATCHDOG_PID": "1"}, None),
        ({"WATCHDOG_USEC": "0"}, None),
        ({"WATCHDOG_USEC": "soon"}, None),
    ],
)
def test_whether_there_is_a_watchdog(environment, expected):
    assert Notifier(environment).watchdog_s == expected


def decode_fields(raw: bytes) -> dict[str, str]:
    """The inverse, by the journal's description of its protocol."""
    found = {}
    while raw:
        line, _, rest = raw.partition(b"\n")
        name, equals, value = line.partition(b"=")
        if equals:
            raw = rest
        else:
            (length,) = struct.unpack_from("<Q", rest)
            value, raw = rest[8 : 8 + length], rest[9 + length :]
        found[name.decode()] = value.decode()
    return found


@given(
    st.dictionaries(
        st.from_regex(r"[A-Z][A-Z0-9_]{0,20}", fullmatch=True),
        st.text(st.characters(exclude_categories=["Cs"]), max_size=200),
        max_size=6,
    )
)
def test_fields_survive_the_native_protocol(fields):
    assert decode_fields(encode_fields(fields)) == fields


def test_a_field_that_is_too_long_is_cut():
    assert len(encode_fields({"A": "x" * 10**6})) < LONGEST_VALUE + 10


@pytest.fixture
def journal(tmp_path):
    """A journal's socket, and a stderr that is said to lead to it."""
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as sock, (tmp_path / "stderr").open("w+") as stream:
        sock.bind(str(tmp_path / "socket"))
        sock.settimeout(10)
        status = os.fstat(stream.fileno())
        log = Journal({"JOURNAL_STREAM": f"{status.st_dev}:{status.st_ino}"}, stream, str(tmp_path / "socket"))
        yield sock, log, stream
        log.close()


def test_the_journal_gets_fields(journal):
    sock, log, stream = journal
    assert log.structured
    log.write("fault", Level.ERROR, "fault: two\nlines", {"state": "fault", "fault": "overspeed"})
    fields = decode_fields(sock.recv(65536))
    assert fields == {
        "MESSAGE": "fault: two\nlines",
        "MESSAGE_ID": MESSAGE_IDS["fault"],
        "PRIORITY": "3",
        "SYSLOG_IDENTIFIER": "fffo-drive",
        "FFFO_KIND": "fault",
        "FFFO_STATE": "fault",
        "FFFO_FAULT": "overspeed",
    }
    assert stream.tell() == 0


def test_a_journal_that_is_gone_leaves_stderr(journal):
    sock, log, stream = journal
    sock.close()
    log.write("state", Level.INFO, "still there", {})
    assert log.failures == 1
    stream.seek(0)
    assert "still there" in stream.read()


def test_elsewhere_it_is_lines_on_stderr():
    stream = io.StringIO()
    log = Journal({"JOURNAL_STREAM": "1:2"}, stream)
    assert not log.structured
    log.write("state", Level.WARNING, "a\nb", {"state": "ready"})
    assert stream.getvalue().endswith("a b [FFFO_STATE=ready]\n")
    stream.close()
    log.write("state", Level.WARNING, "c", {})  # and a stderr that is gone is only counted
    assert log.failures == 1


FIELD = re.compile(r'(?P<name>[A-Z0-9_]+)=(?P<value>"(?:[^"\\]|\\.)*"|[^\s"\[\]]+)(?: |$)')


def parsed(line: str) -> tuple[str, dict[str, str]]:
    """The text and the fields of a line on stderr."""
    assert line.count("\n") == 1
    assert line.endswith("]\n")
    begin = line.index(" [FFFO_")
    fields, rest = {}, line[begin + 2 : -2]
    while rest:
        match = FIELD.match(rest)
        assert match is not None, rest
        value = match["value"]
        fields[match["name"]] = json.loads(value) if value.startswith('"') else value
        rest = rest[match.end() :]
    return line[:begin], fields


@given(st.dictionaries(st.from_regex(r"[a-z][a-z0-9_]{0,10}", fullmatch=True), st.text(max_size=50), min_size=1))
def test_a_line_on_stderr_is_parsed_back(fields):
    stream = io.StringIO()
    Journal({}, stream).write("state", Level.INFO, "what happened", fields)
    line = stream.getvalue()
    kept = {f"FFFO_{k.upper()}": v for k, v in fields.items() if " " not in v or v not in "what happened"}
    assert (parsed(line) if kept else (line.rstrip("\n"), {})) == ("what happened", kept)


def test_a_text_with_blanks_is_in_quotes_and_not_there_twice():
    stream = io.StringIO()
    log = Journal({}, stream)
    data = {"axis": "can0", "name": "overspeed", "text": "26 rps at tick 9067", "tick": 9067, "device": 'the "new" one'}
    log.write("fault", Level.ERROR, "fault: 26 rps at tick 9067", data)
    assert stream.getvalue() == (
        "fault: 26 rps at tick 9067 "
        '[FFFO_AXIS=can0 FFFO_NAME=overspeed FFFO_TICK=9067 FFFO_DEVICE="the \\"new\\" one"]\n'
    )


def test_message_ids_are_distinct_and_well_formed():
    assert len(set(MESSAGE_IDS.values())) == len(MESSAGE_IDS)
    assert all(re.fullmatch(r"[0-9a-f]{32}", value) for value in MESSAGE_IDS.values())


def test_events_are_numbered_kept_and_reported():
    heard = []
    log = EventLog(Journal({}, io.StringIO()), lambda: {"state": "ready"})
    log.listeners.append(heard.append)
    for number in range(KEPT + 10):
        log.add("state", f"event {number}")
    assert log.last_number == KEPT + 10
    assert [event["number"] for event in log.since(0, 2000)] == list(range(11, KEPT + 11))
    assert [event["number"] for event in log.since(KEPT + 5, 3)] == [KEPT + 8, KEPT + 9, KEPT + 10]
    assert log.since(log.last_number, 10) == []
    assert len(heard) == KEPT + 10
