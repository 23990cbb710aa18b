"""The node with the dictionary of another drive: the objects of its file, as the file has them, and no others."""

from __future__ import annotations

import functools
import struct
from dataclasses import replace
from pathlib import Path

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from node.node_rig import ENABLE, OPERATION_ENABLED, Rig
from node.test_node_eds import upload
from shared_data import shared_files

from fffo_drive.canopen_node.dictionary import STRUCT_CODES, DataType, Entry
from fffo_drive.cli import main
from fffo_drive.documents import DocumentError
from fffo_drive.drive.simulated.node.config import NodeConfig
from fffo_drive.drive.simulated.node.eds import eds_text
from fffo_drive.drive.simulated.node.foreign_dictionary import ForeignDictionary
from fffo_drive.drive.simulated.node.objects import ENTRIES
from fffo_drive.drive.simulated.node.personality import Personality
from fffo_drive.drive.simulated.node.read_dictionary import read_dictionary
from fffo_drive.drive.simulated.parameters import PlantConfigError

DRIVES = ("e35", "elmo_gold", "epos2", "epos4", "foc_mc", "ipos", "nanotec_cl4e", "prbt", "roboteq", "schunk")
NO_OBJECT, NO_SUB, NO_DATA, READ_ONLY = 0x06020000, 0x06090011, 0x08000024, 0x06010002
TOO_HIGH, TOO_LOW, NOT_MAPPABLE = 0x06090031, 0x06090032, 0x06040041
# of these the device itself supplies what is read: the value of a file is not that of the moment
MEASURED = {0x1001, 0x603F, 0x6041, 0x6061, 0x6064, 0x606C, 0x6074, 0x6077, 0x6078, 0x6079, 0x60FD}
CYCLIC_TORQUE = 10
SUPPORTED_MODES = 0x6502


@functools.cache
def foreign(name: str) -> ForeignDictionary:
    return read_dictionary(shared_files(f"drives/{name}.yaml")[0])


def rig_of(name: str, node_id: int = 1, **personality: object) -> Rig:
    config = NodeConfig(node_id=node_id, dictionary=foreign(name), personality=Personality(**personality))  # type: ignore[arg-type]
    return Rig(config.validate())


def power_on_value(entry: Entry, node_id: int) -> int | bytes | None:
    """What the file says that is read at power-on; None where it does not say."""
    if entry.value is not None:
        return entry.value + node_id if entry.value_relative else entry.value  # type: ignore[operator]
    return entry.default + node_id if entry.relative else entry.default  # type: ignore[operator]


@pytest.mark.conformance(
    "CiA 402", "objects, types, access, limits and values are those of the file, and there are no others"
)
@pytest.mark.parametrize("name", DRIVES)
@pytest.mark.parametrize("node_id", [1, 5])
def test_every_object_is_as_its_file_has_it(name: str, node_id: int) -> None:
    rig = rig_of(name, node_id)
    assert rig.boot[0] == f"{0x700 + node_id:03X}#00"
    for entry in rig.config.dictionary.entries:  # type: ignore[union-attr]
        data, abort = upload(rig, entry.index, entry.sub)
        if abort:
            assert (entry.index, abort, entry.default) == (0x1003, NO_DATA, None), entry
            continue
        expected = power_on_value(entry, node_id)
        assert len(data) == entry.size, entry
        if expected is not None and entry.index not in MEASURED and entry.multiplexer != 0x1003 << 8:
            assert data == struct.pack("<" + STRUCT_CODES[entry.data_type], expected), entry


@pytest.mark.conformance(
    "CiA 402", "objects, types, access, limits and values are those of the file, and there are no others"
)
@pytest.mark.parametrize("name", DRIVES)
def test_every_other_object_is_absent(name: str) -> None:
    rig = rig_of(name)
    entries = rig.config.dictionary.entries  # type: ignore[union-attr]
    there = {(entry.index, entry.sub) for entry in entries}
    indices = {index for index, _ in there}
    for index in (*range(0x1000, 0x2200), *range(0x6000, 0x6800)):
        for sub in (0, 1, 5):
            if (index, sub) not in there:
                expected = NO_SUB if index in indices else NO_OBJECT
                assert rig.read_abort(index, sub) == expected, (hex(index), sub)
                assert rig.write(index, sub, 0, 4) == expected


@pytest.mark.parametrize("name", DRIVES)
def test_access_and_limits(name: str) -> None:
    rig = rig_of(name)
    for entry in foreign(name).entries:
        if entry.access in ("ro", "const"):
            assert rig.write(entry.index, entry.sub, 0, entry.size) == READ_ONLY, entry
            continue
        low, high = type_limits(entry)
        for limit, beyond, refusal in ((entry.low, -1, TOO_LOW), (entry.high, 1, TOO_HIGH)):
            if limit is not None and low <= limit + beyond <= high:
                assert rig.write(entry.index, entry.sub, limit + beyond, entry.size) == refusal, entry


def type_limits(entry: Entry) -> tuple[int, int]:
    bits = 8 * entry.size
    return (-(1 << bits - 1), (1 << bits - 1) - 1) if STRUCT_CODES[entry.data_type].islower() else (0, (1 << bits) - 1)


@pytest.mark.conformance("CiA 402", "the EDS of another drive reads back as the same")
@pytest.mark.parametrize("name", DRIVES)
def test_the_eds_reads_back_as_the_same(name: str, tmp_path: Path) -> None:
    path = tmp_path / "foreign.eds"
    path.write_text(eds_text(NodeConfig(dictionary=foreign(name))), encoding="ascii")
    assert read_dictionary(path).entries == foreign(name).entries


def test_a_file_that_calls_nothing_mappable_does_not_tell_it() -> None:
    silent = ForeignDictionary("silent", tuple(e for e in ENTRIES if e.index < 0x2000) + (
        Entry(0x6041, 0, "Statusword", DataType.UNSIGNED16, "ro"),
        Entry(0x6040, 0, "Controlword", DataType.UNSIGNED16, "rww"),
    ))  # fmt: skip
    plain = tuple(Entry(*(getattr(e, f) for f in ("index", "sub", "name", "data_type", "access", "default"))) for e in
                  silent.entries)  # fmt: skip
    rig = Rig(NodeConfig(dictionary=ForeignDictionary("silent", plain)))
    for communication, cob_id in ((0x1400, 0x80000201), (0x1800, 0x80000181)):
        assert rig.write(communication, 1, cob_id, 4) == 0
        assert rig.write(communication + 0x200, 0, 0, 1) == 0
    assert rig.write(0x1A00, 1, 0x60410010, 4) == 0
    assert rig.write(0x1600, 1, 0x60400010, 4) == 0
    assert rig.write(0x1600, 1, 0x60410010, 4) == NOT_MAPPABLE  # ro


# --- each drive as a drive


def mode_of(rig: Rig) -> int:
    return CYCLIC_TORQUE if rig.node.od.number(0x6502) >> CYCLIC_TORQUE - 1 & 1 else 4


TORQUE_DRIVES = {"e35": 310e-6 / 0.148, "elmo_gold": 8.3e-3, "epos4": 8.3e-3, "nanotec_cl4e": 8.3e-3, "foc_mc": 8.3e-3,
                 "roboteq": 8.3e-3}  # fmt: skip


@pytest.mark.conformance("CiA 402", "services work without the objects that a drive lacks")
@pytest.mark.parametrize("name", TORQUE_DRIVES)
def test_a_drive_with_a_torque_mode_turns_the_target_into_current(name: str) -> None:
    rig = rig_of(name)
    rig.operational()
    rig.enable(mode_of(rig))
    assert rig.write(0x6071, 0, 50, 2) == 0
    rig.wait(1000)
    rig.send("080#")
    assert rig.node.drive.current_command_a == pytest.approx(50 * TORQUE_DRIVES[name], rel=1e-3)
    assert rig.write(0x6040, 0, 0, 2) == 0
    assert rig.node.drive.current_command_a == 0.0


@pytest.mark.parametrize("name", sorted(set(DRIVES) - set(TORQUE_DRIVES)))
def test_a_drive_without_one_gives_none(name: str) -> None:
    rig = rig_of(name)
    rig.operational()
    for mode in (CYCLIC_TORQUE, 4):
        assert rig.write(0x6060, 0, mode, 1) == 0x06090030
    for word in ENABLE:
        assert rig.write(0x6040, 0, word, 2) == 0
    assert rig.state == OPERATION_ENABLED
    rig.write(0x6071, 0, 500, 2)
    rig.wait(100)
    assert set(rig.plant.torque_seen) == {0.0}


def test_ipos_has_its_vendors_torque_mode() -> None:
    rig = rig_of("ipos", vendor_mode=-5, vendor_target="0x201C:00", vendor_units_per_a=3000.0)
    rig.enable(mode=-5)
    assert rig.write(0x201C, 0, 1500, 4) == 0
    assert rig.node.drive.current_command_a == pytest.approx(0.5)


@pytest.mark.parametrize(
    ("name", "position", "velocity"),
    [("e35", 2000, 2000), ("nanotec_cl4e", 3600, 60), ("epos4", 32768, 60), ("elmo_gold", 32768, 32768)],
)
def test_units_are_those_of_the_drive(name: str, position: int, velocity: int) -> None:
    rig = rig_of(name)
    rig.plant.angle_rev, rig.plant.velocity_rps = 2.25, 3.5
    rig.send("080#")
    assert (rig.read(0x6064), rig.read(0x606C)) == (2.25 * position, 3.5 * velocity)


def test_a_drive_without_a_communication_parameter_has_that_of_the_predefined_set() -> None:
    rig = rig_of("elmo_gold")  # its file has no 0x1005
    assert rig.read_abort(0x1005) == NO_OBJECT
    assert rig.write(0x1800, 2, 1, 1) == 0
    rig.operational()
    assert any(frame.startswith("181#") for frame in rig.send("080#"))


def test_without_0x1014_there_are_no_emergency_messages() -> None:
    rig = rig_of("roboteq")
    rig.node.drive.trip(0x4310)
    assert rig.wait(50) == []
    assert rig.wait(60) == ["701#7F"]  # its heartbeat, 100 ms after boot-up


@pytest.mark.parametrize(("option", "state"), [(0, OPERATION_ENABLED), (1, 0x0F), (2, 0x40), (3, 0x07)])
def test_a_lost_connection_without_0x6007(option: int, state: int) -> None:
    rig = rig_of("nanotec_cl4e", connection_loss_option=option)
    assert rig.write(0x1016, 1, 127 << 16 | 100, 4) == 0
    rig.enable()
    rig.plant.velocity_rps = 50.0
    rig.send("77F#05")
    rig.wait(110)
    assert rig.state == state


def test_a_default_mapping_of_objects_that_the_file_does_not_tell_is_a_gap() -> None:
    rig = rig_of("roboteq")  # 0x1A00: 0x21060120, 0x21060220, of which its file tells nothing here
    assert rig.write(0x1800, 2, 1, 1) == 0
    rig.operational()
    assert "181#" + "00" * 8 in rig.send("080#")
    assert rig.send("201#" + "FF" * 8) == []


def test_0x1010_stores_what_its_sub_index_says() -> None:
    rig = rig_of("nanotec_cl4e")
    save = int.from_bytes(b"save", "little")
    assert rig.write(0x1017, 0, 250, 2) == 0
    assert rig.write(0x1010, 1, save, 4) == 0
    assert rig.write(0x1010, 13, save, 4) == 0
    rig.send("000#8101")
    assert rig.read(0x1017) == 250


def test_self_starting_as_the_file_has_it() -> None:
    assert rig_of("nanotec_cl4e").node.nmt.state == 5
    assert rig_of("epos4").node.nmt.state == 127


def test_the_command_wears_a_drive_and_writes_its_eds(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    drive, eds = tmp_path / "drive.yaml", tmp_path / "foreign.eds"
    drive.write_text("format: fffo_drive/simulated/1\n")
    other = shared_files("drives/epos4.yaml")[0]
    assert main(["sim", str(drive), "--dictionary", str(other), "--eds", str(eds)]) == 0
    assert read_dictionary(eds).entries == read_dictionary(other).entries
    assert main(["sim", str(drive), "--dictionary", str(eds), "--eds", str(tmp_path / "again.eds")]) == 0
    assert read_dictionary(tmp_path / "again.eds").entries == read_dictionary(other).entries


def test_the_command_refuses_a_file_that_is_none(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    drive, other = tmp_path / "drive.yaml", tmp_path / "other.yaml"
    drive.write_text("format: fffo_drive/simulated/1\npersonality: {values: {'0x6076:00': 0}}\n")
    other.write_text("drive: x\nobjects:\n  '0x1000:00': {type: 7}\n")
    assert main(["sim", str(drive), "--dictionary", str(other)]) == 78
    assert f"{other}:3: objects.0x1000:00.access: missing" in capsys.readouterr().err
    assert main(["sim", str(drive), "--dictionary", str(tmp_path / "away.dcf")]) == 78
    assert "away.dcf: No such file" in capsys.readouterr().err
    other.write_text("drive: x\nobjects:\n  '0x1000:00': {type: 7, access: ro}\n")
    assert main(["sim", str(drive), "--dictionary", str(other)]) == 78  # the personality names what it does not have
    assert "personality.values.0x6076:00: the drive has no such number" in capsys.readouterr().err


def test_a_configuration_with_entries_that_no_node_can_serve_is_refused() -> None:
    entries = (Entry(0x1000, 0, "", DataType.UNSIGNED32, "ro"), Entry(0x6041, 0, "", DataType.UNSIGNED32, "ro"))
    with pytest.raises(PlantConfigError, match=r"node\.dictionary: 0x6041:00 is UNSIGNED32"):
        NodeConfig(dictionary=ForeignDictionary("wide", entries)).validate()


# --- files that are no dictionary

OBJECT = 'drive: x\nobjects:\n  "0x1000:00": {type: 7, access: ro}\n'


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("drive: x\nobjects: {}\n", "d.yaml:2: objects: is empty"),
        ("drive: x\n", "d.yaml:1: objects: missing"),
        ('drive: x\nobjects:\n  "0x6041:00": {type: 6, access: ro}\n', "0x1000:00 .device type. is missing"),
        (OBJECT + '  "0x6041": {type: 6, access: ro}\n', "d.yaml:4: objects.0x6041: an object is named 0xINDEX:SUB"),
        (OBJECT + '  "0x6041:00": {type: 0x99, access: ro}\n', "objects.0x6041:00.type: '153' is no data type"),
        (OBJECT + '  "0x6041:00": {type: 6}\n', "objects.0x6041:00.access: missing"),
        (OBJECT + '  "0x6041:00": {type: 6, access: none}\n', "access: 'none' is none of ro, wo"),
        (OBJECT + '  "0x6041:00": {type: 6, access: ro, default: x}\n', "0x6041:00.default: 'x' is no number"),
        (OBJECT + '  "0x6041:00": {type: 6, access: ro, default: 70000}\n', "70000 does not fit UNSIGNED16"),
        (OBJECT + '  "0x6041:00": {type: 6, access: ro, low: 3, high: 1}\n', "low: 3 is above high, 1"),
        (OBJECT + '  "0x6041:00": {type: 6, access: ro, pdo: 7}\n', "pdo: '7' is neither 0 nor 1"),
        (OBJECT + '  "0x6041:00": {type: 6, access: ro, deflt: 1}\n', "did you mean 'default'"),
        (OBJECT + '  "0x6041:00": {type: [6], access: ro}\n', "0x6041:00.type: text or a number is needed"),
        (OBJECT + '  "0x6041:00": {type: 7, access: ro}\n', "0x6041:00 is UNSIGNED32; CiA 301 and 402 have UNSIGNED16"),
        (OBJECT + '  "0x6040:00": {type: 9, access: rw}\n', "0x6040:00 is VISIBLE_STRING; CiA 301 and"),
        (OBJECT + '  "0x1000:0": {type: 7, access: ro}\n', "objects.0x1000:0: stands here twice"),
        ("drive: [\n", "not valid YAML"),
    ],
)  # fmt: skip
def test_a_file_that_is_none_is_refused_in_one_sentence(text: str, said: str, tmp_path: Path) -> None:
    path = tmp_path / "d.yaml"
    path.write_text(text)
    with pytest.raises(DocumentError, match=said) as caught:
        read_dictionary(path)
    assert "d.yaml" in str(caught.value)
    assert len(str(caught.value).splitlines()) == 1


def test_an_eds_that_is_none_is_refused_in_one_sentence(tmp_path: Path) -> None:
    eds = eds_text(NodeConfig())
    for name, text, said in (
        ("none.eds", "hello", "has no section"),
        ("empty.dcf", "", "has no section"),
        ("no_section.txt", "[FileInfo]\n", "has no section"),
        ("wide.eds", eds.replace("[6041]", "[6041]\nDataType=0x0007"), "0x6041:00 is UNSIGNED32"),
    ):
        path = tmp_path / name
        path.write_text(text)
        with pytest.raises(DocumentError, match=said) as caught:
            read_dictionary(path)
        assert name in str(caught.value)
        assert len(str(caught.value).splitlines()) == 1
    with pytest.raises(DocumentError, match=r"away\.eds: No such file"):
        read_dictionary(tmp_path / "away.eds")


def test_types_and_forms_of_an_eds(tmp_path: Path) -> None:
    path = tmp_path / "odd.eds"
    path.write_text(
        "[DeviceInfo]\nVendorName=v\nProductName=odd\n[1000]\nParameterName=t\nDataType=7\nAccessType=ro\n"
        "DefaultValue=0x20192\nPDOMapping=0\n"
        "[2001]\nParameterName=text\nDataType=9\nAccessType=rw\nDefaultValue=abc\nPDOMapping=0\n"
        "[2002]\nParameterName=real\nDataType=8\nAccessType=rw\nDefaultValue=1.5\nPDOMapping=0\n"
        "[2003]\nParameterName=long\nDataType=0x15\nAccessType=rw\nDefaultValue=-2\nPDOMapping=0\n"
        "[2004]\nParameterName=three\nDataType=0x16\nAccessType=rw\nDefaultValue=0x123456\nPDOMapping=0\n"
        "[2005]\nParameterName=bytes\nDataType=0xA\nAccessType=ro\nDefaultValue=0102ff\nPDOMapping=0\n"
        "[2006]\nParameterName=many\nObjectType=8\nDataType=6\nAccessType=rw\nDefaultValue=9\nPDOMapping=0\n"
        "CompactSubObj=3\n"
    )
    rig = Rig(NodeConfig(dictionary=read_dictionary(path)))
    wanted = {
        0x2001: b"abc", 0x2002: struct.pack("<f", 1.5), 0x2003: struct.pack("<q", -2), 0x2004: b"\x56\x34\x12",
        0x2005: b"\x01\x02\xff",
    }  # fmt: skip
    for index, data in wanted.items():
        assert upload(rig, index, 0)[0] == data
    assert [rig.read(0x2006, sub) for sub in range(4)] == [3, 9, 9, 9]
    again = tmp_path / "again.eds"
    again.write_text(eds_text(rig.config))
    assert read_dictionary(again).entries == rig.config.dictionary.entries  # type: ignore[union-attr]


OWN_EDS = eds_text(NodeConfig()).splitlines()
SPOILT = st.sampled_from(
    ("", "=", "DataType=", "DataType=0x99", "DataType=0x1B", "DataType=4", "LowLimit=5", "HighLimit=-1", "\0")
    + ("DefaultValue=$NODEID", "DefaultValue=99999999999", "ParameterValue=7", "AccessType=wow", "PDOMapping=9")
    + ("[6041]", "[6041sub1]", "[1800sub1]", "ObjectType=0x8", "CompactSubObj=300")
)


@settings(max_examples=100, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(changes=st.lists(st.tuples(st.integers(0, len(OWN_EDS) - 1), SPOILT), min_size=1, max_size=30))
def test_a_spoilt_eds_is_refused_or_used(changes: list[tuple[int, str]], tmp_path: Path) -> None:
    lines = list(OWN_EDS)
    for place, text in changes:
        lines[place] = text
    path = tmp_path / "spoilt.eds"
    path.write_text("\n".join(lines))
    try:
        dictionary = read_dictionary(path)
    except DocumentError:
        return
    rig = Rig(NodeConfig(dictionary=dictionary))
    rig.operational()
    for entry in dictionary.entries:
        rig.send(f"601#40{entry.index & 0xFF:02X}{entry.index >> 8:02X}{entry.sub:02X}00000000")
    rig.send("080#")
    rig.wait(20)


# --- whatever the dictionary


_PAIRS = (
    (DataType.INTEGER8, DataType.UNSIGNED8),
    (DataType.INTEGER16, DataType.UNSIGNED16),
    (DataType.INTEGER32, DataType.UNSIGNED32),
)
OTHER_SIGN = dict(_PAIRS) | {unsigned: signed for signed, unsigned in _PAIRS}


def entries_strategy() -> st.SearchStrategy[tuple[Entry, ...]]:
    """Some of the objects of our own drive, in which any may be missing, with other defaults and access."""

    def changed(draw: st.DrawFn, entry: Entry) -> Entry:
        low, high = type_limits(entry) if entry.size else (0, 0)
        default = draw(st.none() | st.integers(low, high)) if entry.size else entry.default
        access = draw(st.sampled_from((entry.access, "rw", "const", "ro", "rww")))
        data_type = entry.data_type
        if entry.index >= 0x2000 and data_type in OTHER_SIGN:
            data_type = draw(st.sampled_from((data_type, OTHER_SIGN[data_type])))
            low, high = type_limits(replace(entry, data_type=data_type))
            default = draw(st.none() | st.integers(low, high))
        return Entry(entry.index, entry.sub, entry.name, data_type, access, default, None, None, True)

    @st.composite
    def some(draw: st.DrawFn) -> tuple[Entry, ...]:
        missing = draw(st.sets(st.sampled_from(sorted({e.index for e in ENTRIES} - {0x1000})), max_size=60))
        odd = draw(st.sets(st.sampled_from([e.multiplexer for e in ENTRIES]), max_size=25))
        kept = [e for e in ENTRIES if e.index not in missing]
        modes = draw(st.sampled_from((None, 0, 1 << 3, 1 << 9, 0x65)))
        return tuple(
            replace(e, default=modes) if e.index == SUPPORTED_MODES else changed(draw, e) if e.multiplexer in odd else e
            for e in kept
        )

    return some()


PERSONALITIES = st.builds(
    Personality,
    rtr_bit=st.sampled_from(("free", "required")),
    mode_display=st.sampled_from(("at_once", "with_sync", "when_enabled")),
    command_following=st.sampled_from(("shown", "not_shown", "refused")),
    remote=st.sampled_from((True, True, True, False)),
    warning_code=st.sampled_from((0, 0xFF00)),
    warning_at_s=st.sampled_from((-1.0, 0.01)),
    sto_active=st.sampled_from((False, False, False, True)),
    dc_link_share=st.sampled_from((1.0, 1.0, 0.3)),
    encoder_counts_per_rev=st.sampled_from((0, 1, 2000, 1 << 23)),
    rated_torque_unit_nm=st.sampled_from((1e-3, 1e-6)),
    connection_loss_option=st.integers(0, 3),
    vendor_mode=st.sampled_from((0, -5)),
    vendor_target=st.just("0x201C:00"),
)
WRITES = st.lists(
    st.tuples(
        st.sampled_from([(e.index, e.sub) for e in ENTRIES if e.size and e.index != SUPPORTED_MODES]),
        st.integers(0, 0xFFFFFFFF),
    ),
    max_size=12,
)


@settings(max_examples=120, deadline=None)
@given(entries=entries_strategy(), personality=PERSONALITIES, writes=WRITES, mode=st.sampled_from((10, 4, -5, 3, 0)))
def test_no_dictionary_crashes_it_or_gives_torque_that_was_not_enabled(
    entries: tuple[Entry, ...], personality: Personality, writes: list[tuple[tuple[int, int], int]], mode: int
) -> None:
    config = NodeConfig(dictionary=ForeignDictionary("some", entries), personality=personality).validate()
    sizes = {(e.index, e.sub): e.size for e in entries}
    rig = Rig(config)
    drive = rig.node.drive

    def never_without_leave() -> None:
        if drive.current_command_a and not drive.braking:
            assert drive.state == 4
            in_force = drive.od.number(0x6061)
            assert in_force in (4, 10, personality.vendor_mode)
            assert in_force == personality.vendor_mode or drive.od.number(0x6502) >> in_force - 1 & 1
            assert not personality.sto_active
            assert personality.remote
            assert personality.command_following != "refused"
            assert personality.dc_link_share == 1.0
        assert abs(drive.current_command_a) <= config.plant.peak_current_a + 1e-6

    def try_to_write(index: int, sub: int, value: int) -> None:
        if (index, sub) in sizes:
            rig.send(_download(index, sub, value, sizes[index, sub]))
        never_without_leave()

    rig.send("000#0100")
    for (index, sub), value in writes:
        try_to_write(index, sub, value)
    try_to_write(0x6060, 0, mode)
    for word in (0x80, *ENABLE):
        try_to_write(0x6040, 0, word)
        rig.send("080#")
    for index in (0x6071, 0x201C):
        rig.send(_download(index, 0, 150, 2 if index == 0x6071 else 4))
        never_without_leave()
    for frame in ("080#", "201#0F00C800", "301#0F00C800", "080#", "701#", "77F#05"):
        rig.send(frame)
        never_without_leave()
    rig.node.poll(rig.now_ns + 20_000_000)
    never_without_leave()
    rig.now_ns += 20_000_000
    for entry in entries:
        rig.send(f"601#40{entry.index & 0xFF:02X}{entry.index >> 8:02X}{entry.sub:02X}00000000")
    rig.send("000#8101")
    eds_text(config)


def _download(index: int, sub: int, value: int, size: int) -> str:
    data = struct.pack("<BHBI", {1: 0x2F, 2: 0x2B, 4: 0x23}[size], index, sub, value & (1 << 8 * size) - 1)
    return "601#" + data.hex()
