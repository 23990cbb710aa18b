"""EDS files as vendors write them: hand-made files with the habits of those in the wild, and mutations of them."""

from __future__ import annotations

import contextlib
import json
from pathlib import Path

import pytest
import yaml
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from fffo_drive.cli import main
from fffo_drive.config.drive_section import CanopenDriveSection
from fffo_drive.config.eds_fitness import fitness_of, mode_names
from fffo_drive.drive.canopen.eds import default_of, read_eds
from fffo_drive.drive.canopen.eds_tidy import number, tidy
from fffo_drive.drive.canopen.object_map import MappingError
from fffo_drive.drive.canopen.reported_units import velocity_units_per_rps

FILES = Path(__file__).resolve().parent / "eds"
NODE = 5

REMARKS = {
    "cp1252": [
        "line 7: byte 0xFC is not UTF-8; the file is read as cp1252",
        "line 8: VendorNumber=001 of [DeviceInfo] is read as 1",
        "line 18: [Comments] says Lines=nothing, there are 2",
        "line 19: [Comments] has Lines1=, where Line1= is meant",
        "line 81: PDOMapping of [1016sub0] is empty",
    ],
    "capitals": ["line 283: DefaultValue=NODEID+0x280 of [1801sub1] is read as $NODEID+640"],
    "twice": [
        "line 531: section [6071] begins again (first in line 523): joined",
        "line 532: ParameterName of [6071] is given twice; line 524 counts",
        "line 534: AccessType of [6071] is given twice; line 527 counts",
        "line 568: section '[6080' lacks its closing bracket",
        "line 574: HighLimit=0x1FFFFFFFF of [6080] does not fit 32 bits; left out",
        "line 575: 'this is no key' is neither a section nor a key; left out",
        "line 673: [2100sub1] has no section [2100] above it; taken for a record",
        "line 677: DefaultValue=-1 of [2100sub1] is negative in an unsigned type; read as 4294967295",
    ],
    "no_torque": [],
    "fixed": [],
}
REFUSALS = {
    "no_torque": [
        "there is no mode 10 (cyclic synchronous torque): 0x6502:00 says 0x00000065, bit 9 is needed",
    ],
    "fixed": [
        "RPDO1: its mapping is fixed to 0x60400010",
        "TPDO1: its mapping is fixed to 0x60410010",
        "TPDO2: object 0x6077:00/16 cannot be mapped to a PDO",
        "TPDO2: its mapping is fixed to 0x60410010",
    ],
}


def path_of(name: str) -> str:
    return str(FILES / f"{name}.eds")


@pytest.mark.parametrize("name", REMARKS)
def test_what_is_untidy_is_reported_with_its_line(name: str) -> None:
    assert [str(remark) for remark in read_eds(path_of(name), NODE).remarks] == REMARKS[name]


@pytest.mark.parametrize("name", REMARKS)
def test_what_can_be_done_with_the_drive(name: str) -> None:
    eds = read_eds(path_of(name), NODE)
    assert list(fitness_of(eds, NODE).refusals) == REFUSALS.get(name, [])


def test_each_way_of_writing_the_node_id() -> None:
    od = read_eds(path_of("capitals"), NODE).dictionary
    assert [default_of(od, index, 1) for index in (0x1400, 0x1800, 0x1801, 0x1802)] == [0x205, 0x185, 0x285, 0x385]
    assert default_of(od, 0x1014) == 0x85
    assert od[0x1000].access_type == "ro"
    assert default_of(od, 0x6076) is None  # an empty default is none, and legal


def test_the_first_of_two_descriptions_counts() -> None:
    od = read_eds(path_of("twice"), NODE).dictionary
    assert (od[0x6071].name, od[0x6071].access_type, od[0x6071].pdo_mappable) == ("Target torque", "rww", True)
    assert default_of(od, 0x2100, 1) == 0xFFFFFFFF


def test_text_in_the_vendors_code_page() -> None:
    eds = read_eds(path_of("cp1252"), NODE)
    assert eds.drive_name == "Prüfantriebe Süd Servo Größe 4"
    assert eds.dictionary.comments == "Prüfstand\nzweite Zeile"


@pytest.mark.parametrize(
    ("text", "value"),
    [("0x1F", 31), ("0X1f", 31), ("31", 31), ("-31", -31), ("0", 0), ("001", 1), ("010", 8), ("089", 89), ("1Fh", 31),
     ("0x1FUL", 31), ("3.0", 3), (" 7 ", 7), ("true", 1), ("No", 0), ("", None), ("x", None), ("0x", None),
     ("1.5", None), ("$NODEID", None), ("--1", None)],
)  # fmt: skip
def test_numbers(text: str, value: int | None) -> None:
    assert number(text) == value


@pytest.mark.parametrize(
    ("lines", "said"),
    [
        ("[2000]\nParameterName=x\nDataType=0x0003\nAccessType=rw\nDefaultValue=0xFFFF", None),  # -1, legal
        ("[2000]\nParameterName=x\nDataType=0x0003\nAccessType=rw\nDefaultValue=70000", "does not fit 16 bits"),
        ("[2000]\nParameterName=x\nDataType=0x0007\nAccessType=often", "AccessType of [2000] is 'often'; read as rw"),
        ("[2000]\nParameterName=x\nDataType=0x0007\nAccessType=", "AccessType of [2000] is empty; read as rw"),
        ("[2000]\nParameterName=x\nDataType=0x00A0\nAccessType=rw", "has the unknown DataType 0x00A0"),
        ("[2000]\nParameterName=x\nDataType=\nAccessType=rw", "line 5: [2000] has no DataType; left out"),
        ("[2000]\nParameterName=x\nDataType=7\nAccessType=rw\nDefaultValue=many", "line 7: DefaultValue=many"),
        ("[2000]\nParameterName=x\nDataType=7\nAccessType=ro\nPDOMapping=yes", "PDOMapping=yes of [2000] is read as 1"),
        ("[OptionalObjects]\nSupportedObjects=1\n1=0x2001", "[OptionalObjects] lists 0x2001, which is not described"),
        ("[2000]\nParameterName=x\nObjectType=0x8\nCompactSubObj=3\nDataType=7\nAccessType=rw\n"
         "[2000Name]\nNrOfEntries=9", None),
        ("[DummyUsage]\nDummy0002=1\nDummy0005=", "Dummy0005 is empty"),
        ("=", None),
    ],
)  # fmt: skip
def test_repairs(tmp_path: Path, lines: str, said: str | None) -> None:
    path = tmp_path / "x.eds"
    base = "[DeviceInfo]\nProductName=x\n{}\n[1000]\nParameterName=t\nDataType=7\nAccessType=ro\nDefaultValue=0x20192\n"
    path.write_text(base.format(lines))
    remarks = "\n".join(str(remark) for remark in read_eds(str(path), NODE).remarks)
    assert (said in remarks) if said else not remarks


def test_utf16_is_read_and_reported(tmp_path: Path) -> None:
    path = tmp_path / "x.eds"
    path.write_bytes(Path(path_of("no_torque")).read_text().encode("utf-16"))
    assert [str(remark) for remark in read_eds(str(path), NODE).remarks] == ["is UTF-16, not ASCII"]


def test_a_tidy_file_stays_as_it_is() -> None:
    once, _ = tidy(Path(path_of("capitals")).read_text())
    assert tidy(once) == (once, [])


BASE = Path(path_of("no_torque")).read_text().splitlines()


@settings(max_examples=60, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(data=st.data())
def test_a_broken_file_is_read_or_refused_in_one_sentence(tmp_path: Path, data: st.DataObject) -> None:
    lines = list(BASE)
    for _ in range(data.draw(st.integers(1, 30))):
        place = data.draw(st.integers(0, len(lines) - 1))
        change = data.draw(st.sampled_from(["drop", "double", "cut", "garbage", "empty", "swap", "bracket"]))
        if change == "drop" and len(lines) > 1:
            del lines[place]
        elif change == "double":
            lines.insert(place, data.draw(st.sampled_from(BASE)))
        elif change == "cut":
            lines[place] = lines[place][: data.draw(st.integers(0, 12))]
        elif change == "garbage":
            lines[place] = data.draw(st.text(max_size=30))
        elif change == "empty":
            lines[place] = lines[place].partition("=")[0] + "="
        elif change == "swap":
            other = data.draw(st.integers(0, len(lines) - 1))
            lines[place], lines[other] = lines[other], lines[place]
        else:
            lines[place] = "[" + data.draw(st.sampled_from(["1000sub", "1A00SUB1", "6040", "DeviceInfo", "x=y"])) + "]"
    path = tmp_path / "broken.eds"
    path.write_text("\n".join(lines), encoding="utf-8", errors="replace")
    refusal = ""
    try:
        fitness_of(read_eds(str(path), NODE), NODE)
    except MappingError as error:
        refusal = str(error)
    assert not refusal or refusal.startswith(f"EDS file {path}: ")
    assert "\n" not in refusal


@settings(max_examples=100, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(raw=st.binary(max_size=300))
def test_any_bytes(tmp_path: Path, raw: bytes) -> None:
    path = tmp_path / "noise.eds"
    path.write_bytes(b"[DeviceInfo]\n" + raw)
    with contextlib.suppress(MappingError):
        read_eds(str(path), NODE)


# --- the command


def test_drive_info_of_a_drive_that_can_be_used(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["drive-info", path_of("capitals"), "--node", "7"]) == 0
    text = capsys.readouterr().out
    assert "Cap Motion CM-12" in text
    assert "can be used, as far as the file says" in text
    assert "cyclic synchronous torque" in text
    assert text.count("possible") == 4
    section = yaml.safe_load(text[text.index("drive:\n") :])["drive"]
    assert section["rated_torque_nm"] is None  # the file has no rated torque: to fill in
    section["rated_torque_nm"] = 1.5
    read = CanopenDriveSection.model_validate(section)
    assert (read.node_id, read.counts, read.velocity_units_per_rps, read.rated_current_a) == (7, 131072, 131072, 7.5)


def test_drive_info_refuses_a_drive_without_cyclic_torque_by_name(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["drive-info", path_of("no_torque")]) == 78
    text = capsys.readouterr().out
    assert "cannot be used: Altwerk Positionierer 3\n  there is no mode 10 (cyclic synchronous torque)" in text
    assert "drive:\n" not in text


def test_drive_info_as_json(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["drive-info", path_of("fixed"), "--json"]) == 78
    facts = json.loads(capsys.readouterr().out)
    assert facts["usable"] is False
    assert facts["modes"] is None  # the file leaves it to the drive
    assert facts["pdos"]["RPDO1"] == ["its mapping is fixed to 0x60400010"]
    assert "0x1006:00: the drive knows the SYNC period" in facts["missing"]


def test_drive_info_says_that_of_two_axes_the_first_is_used(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["drive-info", path_of("capitals")]) == 0
    assert "another axis" not in capsys.readouterr().out
    second = "\n[6841]\nParameterName=Statusword 2\nObjectType=7\nDataType=6\nAccessType=ro\n"
    path = tmp_path / "two_axes.eds"
    path.write_text(Path(path_of("capitals")).read_text(encoding="latin-1") + second, encoding="latin-1")
    assert main(["drive-info", str(path)]) == 0
    said = " ".join(capsys.readouterr().out.split())
    assert "the node has another axis (0x6841). Only the first axis of a node (0x6000 to 0x67FF) can be driven" in said


def test_drive_info_of_what_is_no_eds(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["drive-info", str(tmp_path / "none.eds")]) == 78
    assert "No such file" in capsys.readouterr().err


def test_names_of_modes() -> None:
    assert mode_names(1 << 9 | 1 << 3) == ["profile torque", "cyclic synchronous torque"]
    assert mode_names(1 << 20 | 1 << 10) == ["mode 11", "manufacturer's modes"]


# --- what a dictionary says of units

RPM = 0x00B44700


def test_the_value_of_a_dcf_stands_before_its_default_and_one_to_one_is_no_encoder(tmp_path: Path) -> None:
    entry = "\n[{0}]\nParameterName=x\nObjectType=7\nDataType=7\nAccessType=rw\nDefaultValue={1}\nParameterValue={2}\n"
    text = Path(path_of("capitals")).read_text(encoding="latin-1")
    section = next(line for line in text.splitlines() if line.lower() == "[608fsub1]")
    for value, wanted in (("2000", 2000.0), ("1", None)):
        begin = text.index(section) + len(section)
        end = text.index("\n[", begin)
        body = [line for line in text[begin:end].splitlines() if "value" not in line.lower()]
        path = tmp_path / f"counts{value}.dcf"
        changed = [*body, "DefaultValue=4096", f"ParameterValue={value}"]
        path.write_text(text[:begin] + "\n".join(changed) + text[end:] + entry.format("60A9", 0, RPM))
        facts = fitness_of(read_eds(str(path), NODE), NODE).section
        assert facts.get("counts_per_rev") == wanted
        assert facts["velocity_units_per_rps"] == 60


@pytest.mark.parametrize(
    ("index", "value", "key"),
    [
        ("6076", "0xFFFFFFFF", "rated_torque_nm"),
        ("6075", "0xFFFFFFFF", "rated_current_a"),
        ("60A8", "0x80410000", "counts_per_rev"),  # degrees times 10^-128
    ],
)
def test_a_default_that_no_key_takes_is_left_to_fill_in(tmp_path: Path, index: str, value: str, key: str) -> None:
    text = Path(path_of("capitals")).read_text(encoding="latin-1")
    before, _, after = text.partition(f"\n[{index}]\n")
    entry = f"\n[{index}]\nParameterName=x\nObjectType=7\nDataType=7\nAccessType=rw\nDefaultValue={value}\n"
    path = tmp_path / "unset.eds"
    path.write_text(before + entry + after[after.find("\n[") :] if after else text + entry, encoding="latin-1")
    fitness = fitness_of(read_eds(str(path), NODE), NODE)
    assert key not in fitness.section
    assert fitness.refusals == ()
    assert main(["drive-info", str(path)]) == 0


@pytest.mark.parametrize(
    ("unit", "counts", "wanted"),
    [
        (RPM, None, 60.0),  # rpm: EPOS4, Nanotec
        (0xFDB44700, None, 60_000.0),  # thousandths of rpm
        (0x00B40300, None, 1.0),  # rev/s
        (0x00B50300, 2000, 2000.0),  # increments a second: e35
        (0x00B50300, None, None),
        (0xFF410300, 2000, 3600.0),  # tenths of a degree a second: Nanotec
        (0x00010300, 2000, None),  # metres a second
        (0, 2000, None),
    ],
)
def test_a_unit_of_velocity_is_read_as_cia_303_has_it(unit: int, counts: int | None, wanted: float | None) -> None:
    assert velocity_units_per_rps(unit, counts) == wanted
