"""What is known of a drive and where it came from, and the files that are made of it."""

from __future__ import annotations

import struct
from pathlib import Path

import numpy as np
import pytest
import yaml
from hypothesis import given, settings
from hypothesis import strategies as st
from paper_drive import Paper, plain_drive, u32
from shared_data import shared_files

from fffo_drive.drive.canopen.sdo_objects import SdoObjects
from fffo_drive.units import inertia_nm_s2_per_rev
from fffo_drive.workflows.axis_draft import ACCELERATION_RPS2, Place, make_draft, model_file_of
from fffo_drive.workflows.drive_facts import Answers, Fact, drive_facts
from fffo_drive.workflows.plan import make_plan

EPOS4 = {"vendor_id": 0xFB, "product_code": 0x61500000}


def facts_of(objects, node_id=1, identity=None, **answers):
    return drive_facts(objects, Answers(**answers), node_id, **(identity or {}))


def place(**changes):
    found = Place("axis", "axis.model.yaml", "loopback:29500", Fact(1_000_000, "assumed"), 1, "a drive")
    return found._replace(**changes)


def written(tmp_path, facts, objects, where=None):
    """The files as a user has them, through the same reading as every command."""
    draft = make_draft(where or place(), facts, objects)
    file = tmp_path / "axis.yaml"
    file.write_text(draft.axis_text)
    model_file_of(file).write_text(draft.model_text)
    return make_plan(file)


def test_each_scale_says_where_it_came_from():
    facts = facts_of(plain_drive())
    assert {name: fact.value for name, fact in facts.scales.items()} == {
        "counts_per_rev": 4096, "velocity_units_per_rps": 60.0, "rated_torque_nm": 1.0, "rated_current_a": 10.0,
        "torque_constant_nm_per_a": 0.1,
    }  # fmt: skip
    assert {name: fact.source for name, fact in facts.scales.items()} == {
        "counts_per_rev": "read: 0x608F",
        "velocity_units_per_rps": "read: 0x60A9 is 0x00B44700",
        "rated_torque_nm": "read: 0x6076 in mNm",
        "rated_current_a": "read: 0x6075",
        "torque_constant_nm_per_a": "assumed: rated torque over rated current; see the data sheet",
    }
    assert (facts.missing, facts.needs, facts.writes, facts.profile) == ([], (), {}, None)


def test_what_people_say_stands_before_what_is_read():
    facts = facts_of(plain_drive(), counts_per_rev=2000, torque_constant_nm_per_a=0.12, rated_torque_nm=1.1)
    assert facts.scales["counts_per_rev"] == Fact(2000, "given (--counts)")
    assert facts.scales["torque_constant_nm_per_a"] == Fact(0.12, "given (--torque-constant)")
    assert facts.section["rated_torque_nm"].value == 1.1


@pytest.mark.parametrize(
    ("without", "answers", "missing"),
    [
        ((), {}, []),
        (((0x608F, 1),), {}, ["counts_per_rev"]),
        (((0x60A9, 0),), {}, ["velocity_units_per_rps"]),
        (((0x6075, 0),), {}, ["torque_constant_nm_per_a"]),
        (((0x6075, 0),), {"torque_constant_nm_per_a": 0.1}, []),
        (((0x6075, 0),), {"rated_current_a": 9.0}, []),
        (((0x6076, 0), (0x6075, 0)), {}, ["rated_torque_nm", "torque_constant_nm_per_a"]),
        (((0x6076, 0),), {}, ["rated_torque_nm"]),
        (((0x6076, 0),), {"torque_constant_nm_per_a": 0.1}, []),
        (((0x6076, 0), (0x6075, 0)), {"torque_constant_nm_per_a": 0.1}, ["rated_torque_nm"]),
    ],
)
def test_what_nobody_has_said_is_missing(without, answers, missing):
    assert facts_of(plain_drive(without=without), **answers).missing == missing


@pytest.mark.parametrize(
    ("without", "answers", "derived", "value"),
    [
        ((), {}, "torque_constant_nm_per_a", 0.1),
        (((0x6075, 0),), {"torque_constant_nm_per_a": 0.08}, "rated_current_a", 12.5),
        (((0x6076, 0),), {"torque_constant_nm_per_a": 0.12}, "rated_torque_nm", 1.2),
        (((0x6076, 0),), {"rated_torque_nm": 1.3}, "torque_constant_nm_per_a", 0.13),
    ],
)
def test_of_rated_torque_current_and_torque_constant_one_follows_from_the_others(without, answers, derived, value):
    facts = facts_of(plain_drive(without=without), **answers)
    assert facts.scales[derived].value == pytest.approx(value)
    assert facts.scales[derived].assumed
    assert [name for name, fact in facts.scales.items() if fact.assumed] == [derived]
    assert facts.section["rated_torque_nm"] == facts.scales["rated_torque_nm"]


def test_the_unit_of_the_rated_torque_is_the_one_that_says_what_was_given():
    micro = plain_drive({(0x6076, 0): u32(1_228_400)})
    assert facts_of(micro).scales["rated_torque_nm"].value == pytest.approx(1228.4)
    given_too = facts_of(micro, rated_torque_nm=1.2284)
    assert given_too.section["rated_torque_unit"].value == "uNm"
    assert "rated_torque_unit" not in facts_of(plain_drive(), rated_torque_nm=1.0).section


def test_a_drive_that_was_not_told_its_motor_gets_it_from_the_axis_file(tmp_path):
    objects = plain_drive({(0x6076, 0): u32(0), (0x6075, 0): u32(0)})
    assert facts_of(objects).writes == {}
    facts = facts_of(objects, rated_torque_nm=1.25, rated_current_a=5.0)
    assert facts.writes == {"0x6076:00": 1250, "0x6075:00": 5000}
    section = written(tmp_path, facts, objects).axis.drive
    assert [(write.object, write.value, write.bytes, write.when) for write in section.sdo] == [
        (0x6076, 1250, 4, "before_mapping"), (0x6075, 5000, 4, "before_mapping"),
    ]  # fmt: skip


def test_a_known_family_brings_its_profile_and_what_the_drive_says_of_its_units_stands_before_it(tmp_path):
    factory = plain_drive({(0x6076, 0): u32(1_228_400)})
    facts = facts_of(factory, identity=EPOS4)
    assert facts.profile == "maxon_epos4"
    assert facts.scales["rated_torque_nm"].value == pytest.approx(1.2284)  # the family counts uNm
    assert "velocity_units_per_rps" not in facts.section  # the profile has it
    section = written(tmp_path, facts, factory, place(rate_hz=Fact(1000, ""))).axis.drive
    assert (section.profile, section.velocity_units_per_rps, section.highest_rate_hz) == ("maxon_epos4", 60.0, 1000)
    finer = plain_drive({(0x6076, 0): u32(1_228_400), (0x60A9, 0): u32(0xFDB44700)})
    finer_velocity = facts_of(finer, identity=EPOS4).section["velocity_units_per_rps"]
    assert finer_velocity.value == pytest.approx(60_000.0)
    assert "the profile has 60" in finer_velocity.source


def test_what_the_drive_lacks_is_named_or_replaced():
    lacking = plain_drive(without=((0x6071, 0),))
    assert any("0x6071" in need.text for need in facts_of(lacking).needs)
    replaced = facts_of(plain_drive({(0x1029, 1): b"\0"}, without=((0x6007, 0),)))
    assert replaced.needs == ()
    assert replaced.section["silence_reaction"].value == "error_behaviour"
    assert len(replaced.stand_ins) == 1


def test_a_node_with_a_second_axis_says_which_one_is_driven():
    assert facts_of(plain_drive()).remarks == ()
    (said,) = facts_of(plain_drive({(0x6841, 0): b"\x40\x02"})).remarks
    assert said.startswith("the node has another axis (0x6841). Only the first axis of a node (0x6000 to 0x67FF)")


def test_the_files_are_read_by_every_command_and_hold_what_is_known(tmp_path):
    objects = plain_drive()
    where = place(turnaround_us=Fact(80.0, "measured"), rate_hz=Fact(1000, "measured"))
    plan = written(tmp_path, facts_of(objects), objects, where)
    section, envelope = plan.axis.drive, plan.axis.envelope
    assert (section.counts, section.velocity_units_per_rps, section.node_id) == (4096, 60.0, 1)
    assert section.turnaround_us == 80.0
    # 0x6073 allows twice the rated current, 0x6072 the rated torque
    assert (envelope.continuous_current_a, envelope.current_limit_a) == (10.0, 10.0)
    objects = plain_drive({(0x6072, 0): struct.pack("<H", 1800)})
    (tmp_path / "more").mkdir()
    envelope = written(tmp_path / "more", facts_of(objects), objects, where).axis.envelope
    assert (envelope.continuous_current_a, envelope.current_limit_a) == (10.0, 15.0)  # no more than 1.5 is taken
    assert envelope.speed_limit_rps == 25.0
    assert plan.axis.commissioning == "axis.commissioning.yaml"
    # the assumed inertia: the rated torque accelerates it by so much
    by_rated_torque = 1.0 / inertia_nm_s2_per_rev(plan.model.inertia_kg_m2.value)
    assert by_rated_torque == pytest.approx(ACCELERATION_RPS2, rel=0.01)
    assert plan.model.inertia_kg_m2.source.startswith("assumed")
    text = (tmp_path / "axis.yaml").read_text()
    assert "feedback_missing_ticks" not in text  # a rehearsal's patience is for loopback buses alone
    assert max(len(line) for line in text.splitlines()) <= 120


def test_the_drives_own_limits_are_kept_and_a_free_master_id_is_found(tmp_path):
    limits = {(index, 0): number.to_bytes(2, "little") for index, number in ((0x6072, 2000), (0x6073, 1200))}
    objects = plain_drive({(0x6080, 0): u32(600)} | limits)
    where = place(node_id=127, other_nodes=(126,))
    plan = written(tmp_path, facts_of(objects, node_id=127), objects, where)
    assert plan.axis.envelope.speed_limit_rps == pytest.approx(8.0)  # 0.8 of 600 rpm
    assert plan.axis.envelope.current_limit_a == pytest.approx(12.0)
    assert (plan.axis.drive.node_id, plan.axis.drive.master_id) == (127, 125)


def test_a_name_that_a_drive_made_up_cannot_break_the_file(tmp_path):
    objects = plain_drive()
    nasty = place(drive="x: [}] # 'a\"")
    assert written(tmp_path, facts_of(objects), objects, nasty).axis.drive.node_id == 1


@settings(max_examples=25)
@given(
    st.integers(10, 5_000_000), st.integers(50, 500_000), st.integers(2, 1 << 31), st.sampled_from([500, 1000, 2000]),
    st.integers(1, 60_000), st.integers(1, 5000), st.floats(1.0, 1e5),
)  # fmt: skip
def test_any_motor_makes_files_that_pass_the_check(
    tmp_path_factory, torque, current, counts, rate, rpm, peak, rated_acceleration
):
    objects = plain_drive({
        (0x6076, 0): u32(torque), (0x6075, 0): u32(current), (0x608F, 1): u32(counts), (0x6080, 0): u32(rpm),
        (0x6073, 0): peak.to_bytes(2, "little"),
    })  # fmt: skip
    facts = facts_of(objects, inertia_kg_m2=torque * 1e-3 / (2 * np.pi * rated_acceleration))
    plan = written(tmp_path_factory.mktemp("any"), facts, objects, place(rate_hz=Fact(rate, "measured")))
    assert plan.axis.loop.rate_hz == rate


def dictionary_of(path):
    """The objects of a dictionary of ../shared/data/drives as a drive tells them: value, else default, else 0."""
    sizes = {0x0001: 1, 0x0002: 1, 0x0003: 2, 0x0004: 4, 0x0005: 1, 0x0006: 2, 0x0007: 4}
    found = {}
    for name, entry in yaml.safe_load(path.read_text())["objects"].items():
        size = sizes.get(int(entry["type"], 0))
        if size is None:
            continue
        number = str(entry.get("value", entry.get("default", "0"))).upper().replace("$NODEID", "1").replace(" ", "")
        try:
            value = sum(int(part, 0) for part in number.split("+"))
        except ValueError:
            value = 0
        found[int(name[:6], 16), int(name[7:], 16)] = (value & ((1 << 8 * size) - 1)).to_bytes(size, "little")
    return found


IDENTITIES = {"epos4": 0xFB, "epos2": 0xFB}  # their files leave it open


def test_every_known_dictionary_makes_an_axis_file_or_says_what_is_missing(tmp_path):
    usable = []
    for path in shared_files("drives/*.yaml"):
        dictionary = dictionary_of(path)
        if not any(dictionary[0x1000, 0]):  # what a file leaves to the drive
            dictionary[0x1000, 0] = u32(0x00020192)
        if not any(dictionary.get((0x6502, 0), b"")):
            dictionary[0x6502, 0] = u32(0x000003AD)
        if path.stem == "ipos":  # objects that its firmware has and its file has not
            dictionary |= {(0x201C, 0): u32(0), (0x207E, 0): b"\0\0"}
        objects = SdoObjects(Paper(dictionary).read)
        vendor = objects.value(0x1018, 1) or IDENTITIES.get(path.stem, 0)
        facts = facts_of(
            objects, identity={"vendor_id": vendor, "product_code": objects.value(0x1018, 2) or 0}, counts_per_rev=2000,
            velocity_units_per_rps=60.0, rated_torque_nm=0.5, rated_current_a=4.0, target_units_per_a=65536e3,
            feedback_units_per_a=1000.0,
        )  # fmt: skip
        assert facts.missing == []
        if facts.needs:
            assert all(len(need.text) > 20 and "pydantic" not in need.text for need in facts.needs)
            continue
        folder = Path(tmp_path) / path.stem
        folder.mkdir()
        highest = facts.profile_keys.get("highest_rate_hz") or 1000
        plan = written(folder, facts, objects, place(rate_hz=Fact(highest, "profile")))
        assert plan.axis.drive.counts == 2000
        usable.append(path.stem)
    assert {"e35", "elmo_gold", "epos4", "foc_mc", "ipos", "nanotec_cl4e", "roboteq"} <= set(usable)


def test_a_vendors_own_torque_objects_need_their_units():
    ipos = {"vendor_id": 0x1A3, "product_code": 1}
    assert facts_of(plain_drive(), identity=ipos).missing == ["target_units_per_a", "feedback_units_per_a"]
    answered = facts_of(plain_drive(), identity=ipos, target_units_per_a=182.0, feedback_units_per_a=3.0)
    assert answered.missing == []
    assert answered.section["target"].value == {"units_per_a": 182.0}
    assert answered.section["torque_feedback"].value == {"units_per_a": 3.0}
    assert facts_of(plain_drive(), target_units_per_a=182.0).missing == []
