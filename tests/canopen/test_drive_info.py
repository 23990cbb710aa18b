"""`drive-info FILE` as a user types it: every file as it comes, all unmet requirements, and the snippet."""

from __future__ import annotations

import json
import random
import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
import yaml
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from real_drives import BIT_RATES, DRIVES, Objects, eds_of, sections_of
from scripted_node import servo_dictionary
from shared_data import shared_files

from fffo_drive.cli import main
from fffo_drive.drive.canopen.eds import read_eds

FILES = Path(__file__).resolve().parent / "eds"
CONFIGS = Path(__file__).resolve().parents[2] / "configs"
GENTLE = {
    "proportional_a_per_rps": 0.02,
    "integral_a_per_rev": 0.02,
    "current_limit_a": 1.0,
    "observer": {"toggle": "off"},
}
CANNOT = {"epos2", "prbt", "schunk", "no_torque", "fixed"}  # no torque object or mode; mappings that are fixed
MAPPABLE = (0x6040, 0x6041, 0x6060, 0x6061, 0x6064, 0x606C, 0x6071, 0x6077, 0x6078)
SIGNED = {0x6060: 2, 0x6061: 2, 0x6064: 4, 0x606C: 4, 0x6071: 3, 0x6077: 3, 0x6078: 3}
# what a user finds in the manuals; none of them is a key of this program that he would have to know of
VALUES = {
    "units_per_a": 3276,
    "counts_per_rev": 4096,
    "velocity_units_per_rps": 4096,
    "rated_torque_nm": 1.0,
    "silence_detection": "none",
}


def servo(changes: Objects | None = None, without: tuple[int | tuple[int, int], ...] = ()) -> Objects:
    """The rows of a plain servo drive; `changes` of single keys of a row (None: the key is left out)."""
    rows: Objects = {}
    for (index, sub), value in servo_dictionary(1).items():
        if index in without or (index, sub) in without:
            continue
        kind = SIGNED.get(index) or {1: 5, 2: 6, 4: 7}.get(len(value), 9)
        rows[index, sub] = {
            "type": f"0x{kind:04X}",
            "access": "ro" if index in (0x1000, 0x6041, 0x6502) else "rw",
            "pdo": str(int(index in MAPPABLE)),
        }
        if kind != 9:
            rows[index, sub]["default"] = str(int.from_bytes(value, "little"))
    rows[0x60C2, 0] = {"type": "0x0005", "access": "const", "default": "2"}
    for place, row in (changes or {}).items():
        rows[place] = {**rows.get(place, {"type": "0x0006", "access": "rw", "pdo": "1"}), **row}
    return rows


def written(folder: Path, objects: Objects, bit_rates: tuple[int, ...] = BIT_RATES) -> Path:
    """An EDS with these objects."""
    path = folder / "drive.eds"
    head = ["[DeviceInfo]", "VendorName=Made up", "ProductName=MD"]
    head += [f"BaudRate_{rate}={int(rate in bit_rates)}" for rate in BIT_RATES]
    path.write_text("\n".join([*head, *sections_of(objects)]) + "\n")
    return path


def facts(path: Path, capsys: pytest.CaptureFixture[str], *more: str) -> tuple[int, dict[str, Any]]:
    """Exit code and JSON."""
    capsys.readouterr()
    code = main(["drive-info", str(path), "--json", *more])
    found: dict[str, Any] = json.loads(capsys.readouterr().out)
    return code, found


def filled(snippet: str) -> dict[str, Any]:
    """The printed sections, with what a user fills in; every open key says `fill in` and where its value is found."""
    for line in snippet.splitlines():
        if re.search(r":\s*#", line):
            assert re.search(r":   # fill in: .{15}", line), line

    def fill(section: dict[str, Any]) -> dict[str, Any]:
        given = {key: VALUES[key] if value is None and key in VALUES else value for key, value in section.items()}
        return {key: fill(value) if isinstance(value, dict) else value for key, value in given.items()}

    return fill(yaml.safe_load(snippet))


def checks(folder: Path, snippet: str) -> int:
    """Exit code of `config check` of the shipped axis file with the printed sections in it."""
    data = yaml.safe_load((CONFIGS / "axis_canopen.yaml").read_text())
    printed = filled(snippet)
    data["drive"] = printed["drive"]
    data["loop"] = {**data.get("loop", {}), **printed.get("loop", {})}
    data["controller"] = GENTLE  # stable at any rate
    data["envelope"] |= {"current_limit_a": 2, "continuous_current_a": 2}  # and safe in a long period
    data["model"] = str(CONFIGS / "models" / "table1.yaml")
    axis = folder / "axis.yaml"
    axis.write_text(yaml.safe_dump(data))
    return main(["config", "check", str(axis)])


def all_files(folder: Path) -> Iterator[Path]:
    """Every dictionary that there is, as a file."""
    for source in shared_files("drives/*.yaml"):
        path = folder / f"{source.stem}.eds"
        path.write_text(eds_of(source))
        yield path
    yield from sorted(FILES.glob("*.eds"))


@pytest.mark.parametrize("profile", [(), ("--without-profile",)])
def test_every_file_as_it_comes_is_answered_and_its_snippet_is_an_axis_file(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], profile: tuple[str, ...]
) -> None:
    cannot = CANNOT | ({"ipos"} if profile else set())  # its mode is the vendor's: only the profile knows it
    seen = set()
    for path in all_files(tmp_path):
        assert main(["drive-info", str(path), *profile]) == (78 if path.stem in cannot else 0), path
        text = capsys.readouterr().out
        assert ("cannot be used" in text) == (path.stem in cannot)
        if path.stem not in cannot:
            assert checks(tmp_path, text[text.index("drive:\n") :]) == 0, (path, capsys.readouterr().err)
        seen.add(path.stem)
    assert seen >= set(DRIVES)


def test_every_key_that_a_profile_leaves_open_says_where_its_value_is_found(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "ipos.eds"
    path.write_text(eds_of(shared_files("drives/ipos.yaml")[0]))
    code, found = facts(path, capsys)
    assert (code, found["usable"], found["profile"]) == (0, True, "technosoft_ipos")
    assert found["left_to_the_drive"] == ["0x201C:00", "0x207E:00"]  # the file describes no object of the vendor's
    assert "Ipeak" in found["to_fill_in"]["target.units_per_a"]
    assert "Ipeak" in found["to_fill_in"]["torque_feedback.units_per_a"]


def test_a_vendors_object_that_a_file_of_vendors_objects_lacks_is_missing(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "ipos.eds"
    other = "[2000]\nParameterName=other\nObjectType=7\nDataType=6\nAccessType=rw\n"
    path.write_text(eds_of(shared_files("drives/ipos.yaml")[0]) + other)
    code, found = facts(path, capsys)
    assert code == 78
    assert found["refusals"] == [
        "object 0x201C:00 is missing (the torque that is commanded)",
        "object 0x207E:00 is missing (the torque that comes back)",
    ]


@pytest.mark.parametrize(
    ("changes", "without", "keys"),
    [
        ({(0x1000, 0): {"default": "0"}}, (), {"device_profile": None}),
        ({(0x1000, 0): {"default": "0x00030191"}}, (), {"device_profile": None}),
        ({}, (0x6502,), {"modes_told": False}),
        ({}, (0x6061,), {"mode_display": "not_checked"}),
        ({(0x6502, 0): {"default": "0x08"}}, (), {"mode": 4}),
        ({(0x6502, 0): {"default": "0x208"}, (0x6060, 0): {"low": "-128", "high": "0x08"}}, (), {"mode": 4}),
        ({}, (0x6007,), {"silence_reaction": "none"}),
        ({(0x100C, 0): {}, (0x100D, 0): {"type": "0x5"}}, (0x1017,), {"silence_detection": "life_guarding"}),
        ({}, ((0x1802, 3),), {"status_event": 0}),
        ({(0x6071, 0): {"type": "0x4"}}, (), {"target": {"bits": 32}}),
        ({(0x6078, 0): {"type": "0x3"}}, (0x6077,), {"torque_feedback": {"object": 0x6078, "units_per_a": 100.0}}),
        (
            {(0x1400, 2): {"access": "const", "default": "255"}},
            (),
            {"pdo": {"command": 2, "motion": 1, "status": 2, "event": 3}},
        ),
        ({(0x60C2, 2): {"low": "0xFD", "high": "0xFD"}}, (), {"highest_rate_hz": 1000}),
        ({(0x60C2, 1): {"low": "4"}, (0x60C2, 2): {"type": "0x2", "low": "-3"}}, (), {"highest_rate_hz": 250}),
        (
            {(0x60C2, 1): {"access": "const", "default": "2"}, (0x60C2, 2): {"access": "const", "default": "-3"}},
            (),
            {"highest_rate_hz": 500},
        ),
    ],
)
def test_a_key_does_without_what_stands_against_a_drive(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], changes: Objects, without: Any, keys: dict[str, Any]
) -> None:
    path = written(tmp_path, servo(changes, without))
    code, found = facts(path, capsys)
    assert (code, found["refusals"]) == (0, [])
    (need,) = found["needs"]
    assert need["keys"] == keys
    assert checks(tmp_path, found["snippet"]) == 0, capsys.readouterr().err
    assert main(["drive-info", str(path)]) == 0
    assert f"can be used with {next(iter(keys))}: " in capsys.readouterr().out


def test_all_that_stands_against_a_drive_is_told_at_once(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    changes: Objects = {(0x1000, 0): {"default": "0"}, (0x6502, 0): {"default": "0x08"}, (0x60C2, 2): {"low": "-3"}}
    path = written(tmp_path, servo(changes, (0x6061, 0x6007, 0x1802, 0x1803)), bit_rates=(125, 250))
    code, found = facts(path, capsys)
    assert code == 0
    assert [next(iter(need["keys"])) for need in found["needs"]] == [
        "device_profile",
        "mode",
        "mode_display",
        "silence_reaction",
        "pdo",
        "bitrate_hz",
        "highest_rate_hz",
    ]
    assert found["bit_rates_hz"] == [125_000, 250_000]
    assert checks(tmp_path, found["snippet"]) == 0
    beyond = written(tmp_path, servo(changes, (0x6071, 0x6061, 0x606C)))
    code, found = facts(beyond, capsys)
    assert code == 78
    assert found["refusals"] == [
        "object 0x606C:00 is missing (the velocity that is controlled)",
        "object 0x6071:00 is missing (the torque that is commanded)",
    ]
    assert {"device_profile", "mode_display"} < {key for need in found["needs"] for key in need["keys"]}


def test_the_deadline_that_a_profile_switches_off_is_on_where_it_is_the_only_watch(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    changes: Objects = {(0x6502, 0): {"default": "0x208"}}
    path = written(tmp_path, servo(changes, (0x1016,)))
    path.write_text(path.read_text().replace("[DeviceInfo]", "[DeviceInfo]\nVendorNumber=0x469"))  # Roboteq: 0
    code, found = facts(path, capsys)
    assert (code, found["profile"]) == (0, "roboteq")
    assert {"silence_detection": "rpdo_timer", "command_timeout_ms": 20} in [need["keys"] for need in found["needs"]]
    assert checks(tmp_path, found["snippet"]) == 0


def test_none_is_never_filled_in_for_a_person(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    code, found = facts(written(tmp_path, servo({}, (0x1016, (0x1400, 5)))), capsys)
    assert code == 0
    assert "silence_detection" not in found["drive_section"]
    assert "keeps its last command when the PC is silent" in found["to_fill_in"]["silence_detection"]
    assert checks(tmp_path, found["snippet"]) == 0  # with `none` typed in


@pytest.mark.parametrize(
    ("rates", "bitrate_hz", "rate_hz"),
    [
        ((125, 250), 250_000, 500),
        ((500,), 500_000, 1000),
        ((), None, 2000),
        ((10,), 10_000, None),
        ((20, 1000), None, 2000),
    ],
)
def test_bit_rates_of_the_file_decide_bit_rate_and_loop(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], rates: tuple[int, ...], bitrate_hz: int, rate_hz: int | None
) -> None:
    code, found = facts(written(tmp_path, servo(), rates), capsys)
    assert found["drive_section"].get("bitrate_hz") == bitrate_hz
    if rate_hz is None:
        assert code == 78
        assert "at 10 kbit/s the bus has no time for 100 Hz" in found["refusals"][0]
        return
    assert (code, found["rate_hz"]) == (0, rate_hz)
    assert checks(tmp_path, found["snippet"]) == 0
    faster = {"drive": {**filled(found["snippet"])["drive"]}, "loop": {"rate_hz": 2 * rate_hz}}
    if bitrate_hz:  # twice that rate does not fit: `config check` says so
        assert checks(tmp_path, yaml.safe_dump(faster)) == 78


def test_a_bit_rate_that_the_drive_lacks_is_refused_by_the_check_of_an_axis_file(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    _, found = facts(written(tmp_path, servo(), (500,)), capsys)
    sections = filled(found["snippet"])
    assert checks(tmp_path, yaml.safe_dump(sections)) == 0
    capsys.readouterr()
    sections["drive"]["bitrate_hz"] = 250_000
    sections["loop"]["rate_hz"] = 500
    assert checks(tmp_path, yaml.safe_dump(sections)) == 78
    assert "the drive takes 500 kbit/s, the bus has 250; set drive.bitrate_hz: 500000" in capsys.readouterr().err
    sections["drive"]["bus"] = "loopback:29500"  # has no bit rate
    assert checks(tmp_path, yaml.safe_dump(sections)) == 0


def test_the_range_of_the_mode_is_read(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    code, found = facts(written(tmp_path, servo({(0x6060, 0): {"low": "-2", "high": "9"}})), capsys)
    assert code == 78
    said = ["0x6060:00 takes -2 to 9, which leaves out mode 10 (cyclic synchronous torque)"]
    assert found["refusals"] == said
    for limits in (
        {"low": "0xFE", "high": "0x0A"},
        {"low": "0", "high": "0"},
        {"low": "10", "high": "-10"},
        {"high": "10"},
    ):
        code, found = facts(written(tmp_path, servo({(0x6060, 0): limits})), capsys)
        assert (code, found["refusals"]) == (0, []), limits


# --- any file


BASES = [path.read_bytes().decode("latin-1") for path in sorted(FILES.glob("*.eds"))]
NUMBERS = [
    "0x0A",
    "10",
    "-3",
    "0xFD",
    "0",
    "255",
    "0XFF",
    "1Fh",
    "$NODEID+0x200",
    "0x40000180+$NODEID",
    "",
    "many",
    "0xFFFFFFFF",
    "-129",
    "007",
    "1.0",
    "0x7",
    "99999999999999999999",
    "\xfc",
    "3.5",
    "True",
]
KEYS = [
    "LowLimit",
    "HighLimit",
    "DefaultValue",
    "AccessType",
    "PDOMapping",
    "DataType",
    "ObjectType",
    "SubNumber",
    "ParameterValue",
    "BaudRate_1000",
    "BaudRate_250",
    "VendorNumber",
    "CompactSubObj",
    "; a remark",
]
ACCESS = ["ro", "rw", "const", "wo", "rww", "RWR", "often", ""]


def mangled(text: str, seed: int, changes: int) -> str:
    """A file with so many lines changed as vendors, editors and disks change them."""
    draw, lines = random.Random(seed), text.splitlines()
    for _ in range(changes):
        place = draw.randrange(len(lines))
        kind = draw.randrange(7)
        if kind == 0 and len(lines) > 5:  # a section is lost
            end = next((k for k in range(place + 1, len(lines)) if lines[k].startswith("[")), len(lines))
            del lines[place:end]
        elif kind <= 3:  # a value of another kind
            key = lines[place].partition("=")[0] if kind == 1 else draw.choice(KEYS)
            lines.insert(place, f"{key}{draw.choice([' = ', '='])}{draw.choice(NUMBERS + ACCESS)}")
            if kind == 1:
                del lines[place + 1]
        elif kind == 4:
            lines[place] = lines[place].swapcase()
        elif kind == 5:
            lines.insert(
                place, f"[{draw.choice(['6060', '60C2sub1', '60C2', '1802', '1A01sub1', 'DeviceInfo', '6071'])}]"
            )
        else:
            lines[place] = "".join(chr(draw.randrange(1, 256)) for _ in range(draw.randrange(20)))
        if not lines:
            break
    return "\n".join(lines)


@settings(max_examples=80, deadline=None, suppress_health_check=list(HealthCheck))
@given(base=st.sampled_from(BASES), seed=st.integers(0, 1 << 30), changes=st.integers(0, 120))
def test_no_file_ends_in_a_traceback_and_every_snippet_is_a_drive_section(
    tmp_path_factory: pytest.TempPathFactory, capsys: pytest.CaptureFixture[str], base: str, seed: int, changes: int
) -> None:
    folder = tmp_path_factory.getbasetemp()
    path = folder / "any.eds"
    path.write_bytes(mangled(base, seed, changes).encode("latin-1"))
    code = main(["drive-info", str(path)])
    out, err = capsys.readouterr()
    assert code in (0, 78)
    if not out:
        assert err.startswith(f"fffo-drive drive-info: EDS file {path}: ")
        assert err.count("\n") == 1
        return
    assert ("cannot be used" in out) == (code == 78)
    assert main(["drive-info", str(path), "--json"]) == code
    snippet = json.loads(capsys.readouterr().out)["snippet"]
    if code == 0:
        assert checks(folder, snippet) == 0, (snippet, capsys.readouterr().err)
        capsys.readouterr()


def test_the_file_is_read_once_and_its_bit_rates_kept(tmp_path: Path) -> None:
    rates = read_eds(str(written(tmp_path, servo(), (125, 800))), 1).dictionary.device_information.allowed_baudrates
    assert rates == {125_000, 800_000}
