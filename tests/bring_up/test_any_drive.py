"""Whatever a drive tells: no crash, one verdict, and a file that every command reads or none."""

from __future__ import annotations

from pathlib import Path

import pytest
from hypothesis import event, given, settings
from hypothesis import strategies as st
from paper_drive import Paper, u32
from scripted_node import servo_dictionary

from fffo_drive.cli.bring_up import exit_code, report_lines
from fffo_drive.config.axis import model_of, read_axis
from fffo_drive.drive.canopen.scan import NodeName
from fffo_drive.drive.canopen.sdo_objects import WANTED, SdoObjects
from fffo_drive.system.findings import Severity
from fffo_drive.workflows import bring_up as workflow
from fffo_drive.workflows.bring_up import BringUpReport, Wishes
from fffo_drive.workflows.drive_facts import Answers

VENDORS = [0, 0x11, 0xFB, 0x9A, 0x26C, 0x1A3, 0x469, 0x586]
ABORTS = [0x06020000, 0x06090011, 0x08000020, 0x06010001]
POSITIVE, INERTIAS = st.floats(1e-4, 1e4), st.floats(1e-7, 1.0)


class Silent:
    """Nobody to ask."""

    def tell(self, text):
        pass

    def progress(self, share):
        pass

    def ask(self, question, proposal):
        return None


@st.composite
def dictionaries(draw):
    """A plain servo drive of which some objects are missing, refused, or of any value."""
    objects = servo_dictionary(1) | {
        (0x6041, 0): b"\x50\x02", (0x608F, 1): u32(4096), (0x608F, 2): u32(1), (0x60A9, 0): u32(0xFDB44700),
    }  # fmt: skip
    for where in draw(st.lists(st.sampled_from(sorted({*WANTED, *objects})), max_size=8, unique=True)):
        size = len(objects.get(where, b"1234")) if where in objects else draw(st.sampled_from([1, 2, 4]))
        likely = st.one_of(st.just(bytes(size)), st.binary(min_size=size, max_size=size), st.sampled_from(ABORTS))
        objects[where] = draw(likely)
    return objects


@settings(max_examples=80)
@given(
    dictionaries(), st.sampled_from(VENDORS),
    st.builds(
        Answers, st.none() | POSITIVE, st.none() | st.integers(2, 1 << 31), st.none() | POSITIVE, st.none() | POSITIVE,
        st.none() | POSITIVE, st.none() | POSITIVE, st.none() | POSITIVE, st.none() | INERTIAS,
        st.none() | st.tuples(INERTIAS, INERTIAS).map(lambda ends: (min(ends), max(ends))),
    ),
)  # fmt: skip
def test_any_drive_ends_in_a_verdict_and_a_whole_file_or_none(tmp_path_factory, objects, vendor, answers):
    out = tmp_path_factory.mktemp("any") / "axis.yaml"
    wishes = Wishes("loopback:29500", out, answers=answers, measure=False)
    node = NodeName(1, 0x00020192, "", "a drive", vendor_id=vendor)
    reported = SdoObjects(Paper(objects).read)
    reported.read_all()
    facts = workflow._facts(reported, wishes, node, Silent())
    reported.stop_reading()
    found = BringUpReport("loopback:29500", "", False, (node,), node_id=1)
    report = workflow._propose(wishes, found, node, reported, facts, [], Silent())
    event(report.verdict.partition(":")[0] + (", with a file" if report.axis_file else ", without"))
    failures = [one for one in report.findings if one.level is Severity.FAILURE]
    assert report.ready is (report.axis_file is not None and not failures)
    assert report.verdict.startswith("READY" if report.ready else ("NOT READY", "CANNOT BE USED"))
    assert exit_code(report) == (0 if report.ready else 78 if report.missing else 70)
    assert max(len(line) for line in report_lines(report) if str(out.parent) not in line) <= 80
    assert all(one.remedy for one in failures)
    if report.axis_file is None:
        assert not out.exists()
        return
    axis = read_axis(out)
    assert axis.drive.node_id == 1
    assert model_of(out, axis).torque_constant_nm_per_a == pytest.approx(
        report.facts["torque_constant_nm_per_a"].value, rel=1e-5
    )
    assert Path(report.model_file).exists()
