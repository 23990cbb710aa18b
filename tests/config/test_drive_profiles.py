"""Profiles of drive families: what ships is valid, an axis file overrides it, and a refusal names key and choice."""

from __future__ import annotations

from pathlib import Path

import pytest
import yaml

from fffo_drive.cli import main
from fffo_drive.config.axis import read_axis
from fffo_drive.config.commissioning import declared_facts
from fffo_drive.config.drive_profile import (
    OF_ONE_AXIS,
    ProfileKeys,
    profile_for,
    profile_path,
    read_profile,
    shipped_profiles,
)
from fffo_drive.config.drive_proposal import config_of, open_units
from fffo_drive.config.drive_section import CanopenDriveSection, merged
from fffo_drive.documents import DocumentError
from fffo_drive.model.parameters import read_model

CONFIGS = Path(__file__).resolve().parents[2] / "configs"
MODEL = read_model(CONFIGS / "models" / "table1.yaml")
BUS = {"kind": "canopen", "bus": "loopback:0", "node_id": 1, "rated_torque_nm": 1.0}


def axis_file(folder: Path, **drive: object) -> Path:
    """The shipped axis file with another drive section."""
    data = yaml.safe_load((CONFIGS / "axis_canopen.yaml").read_text())
    data["drive"] = {**BUS, **drive}
    data["model"] = str(CONFIGS / "models" / "table1.yaml")
    path = folder / "axis.yaml"
    path.write_text(yaml.safe_dump(data))
    return path


@pytest.mark.parametrize("name", sorted(shipped_profiles()))
def test_every_profile_that_ships_makes_a_drive_section(tmp_path: Path, name: str) -> None:
    profile = read_profile(shipped_profiles()[name])
    keys = profile.keys
    open_keys = {key.partition(".")[0] for key in profile.to_fill_in if key.endswith(".units_per_a")}
    assert open_keys == set(open_units(keys))  # the profile says where each of its open values is found
    axis = read_axis(axis_file(tmp_path, profile=name, **{key: {"units_per_a": 1000} for key in open_keys}))
    for key, value in keys.items():
        if key not in ("sdo", *open_keys):
            found = getattr(axis.drive, key)
            assert (found.model_dump() if key == "pdo" else found) == value
    config = axis.drive.drive_config(0.1, 1_000_000)
    assert config.command.objects[1] == config.target


def test_seven_families_ship() -> None:
    assert set(shipped_profiles()) == {
        "amd_foc_mc", "e35", "elmo_gold", "maxon_epos4", "nanotec_cl4e", "roboteq", "technosoft_ipos",
    }  # fmt: skip


def test_a_profile_holds_what_a_family_has_in_common_and_nothing_of_one_axis() -> None:
    assert set(ProfileKeys.model_fields) == set(CanopenDriveSection.model_fields) - OF_ONE_AXIS


def test_the_axis_file_overrides_each_key(tmp_path: Path) -> None:
    axis = read_axis(
        axis_file(tmp_path, profile="nanotec_cl4e", velocity_units_per_rps=6000, silence_reaction="none",
                  resolver_bits=12)
    )  # fmt: skip
    drive = axis.drive
    assert (drive.velocity_units_per_rps, drive.silence_reaction, drive.counts) == (6000, "none", 4096)
    assert drive.max_torque_permille == 1000  # of the profile


def test_of_a_mapping_single_keys_are_overridden() -> None:
    found = merged({"target": {"object": 0x201C, "bits": 32}}, {"target": {"units_per_a": 5}})
    assert found == {"target": {"object": 0x201C, "bits": 32, "units_per_a": 5}}


def test_sdo_writes_are_joined_and_the_files_own_replaces_the_same_place() -> None:
    first = {"object": 0x60A9, "value": 1, "bytes": 4, "why": "rpm"}
    second = {"object": 0x3000, "value": 2, "bytes": 2, "why": "a setting"}
    changed = {**first, "sub": 0, "when": "before_mapping", "value": 7}
    assert merged({"sdo": [first, second]}, {"sdo": [changed]})["sdo"] == [changed, second]
    assert merged({"sdo": [first]}, {})["sdo"] == [first]
    later = {**first, "when": "after_disable"}
    assert merged({"sdo": [first]}, {"sdo": [later]})["sdo"] == [first, later]


def test_no_write_of_a_sequence_is_lost_and_each_list_keeps_its_order() -> None:
    unlock = {"object": 0x2000, "value": 1, "bytes": 1, "why": "unlocks the settings"}
    setting = {"object": 0x2001, "value": 5, "bytes": 2, "why": "a setting"}
    lock = {**unlock, "value": 0, "why": "locks them again"}
    other = {"object": 0x3000, "value": 2, "bytes": 2, "why": "a setting"}
    changed = {**setting, "value": 7}
    sequence = [unlock, setting, lock]
    assert merged({"sdo": sequence}, {})["sdo"] == sequence
    assert merged({"sdo": [other]}, {"sdo": sequence})["sdo"] == [other, *sequence]
    assert merged({"sdo": sequence}, {"sdo": [changed]})["sdo"] == [unlock, changed, lock]
    assert merged({"sdo": sequence}, {"sdo": [unlock, changed, lock, other]})["sdo"] == [unlock, changed, lock, other]


@pytest.mark.parametrize("write", [5, {"object": [0x60A9], "value": 1, "bytes": 4, "why": "rpm"}])
def test_a_wrong_write_beside_those_of_a_profile_names_its_key(tmp_path: Path, write: object) -> None:
    profile = "family: x\ntried: nothing\ndrive:\n  sdo: [{object: 0x3000, value: 2, bytes: 2, why: a setting}]\n"
    (tmp_path / "mine.yaml").write_text(profile)
    with pytest.raises(DocumentError, match=r"axis.yaml:\d+: drive.sdo.0"):
        read_axis(axis_file(tmp_path, profile="mine", sdo=[write]))


@pytest.mark.parametrize("keys", [("resolver_bits: 12", {"counts_per_rev": 2000}), ("counts_per_rev: 2000", {})])
def test_counts_of_the_file_replace_bits_of_the_profile(tmp_path: Path, keys: tuple[str, dict[str, object]]) -> None:
    (tmp_path / "mine.yaml").write_text(f"family: x\ntried: nothing\ndrive:\n  {keys[0]}\n")
    assert read_axis(axis_file(tmp_path, profile="mine", **keys[1])).drive.counts == 2000


def test_requirements_are_checked_beside_a_profile_with_resolver_bits() -> None:
    """Bring-up asks the drive for nothing where the keys make no configuration."""
    assert config_of({"resolver_bits": 12}, 5).counts_per_rev == 4096
    assert config_of({"counts_per_rev": 2000}, 127).master_id == 126


def test_a_profile_beside_the_axis_file_stands_before_one_that_ships(tmp_path: Path) -> None:
    own = tmp_path / "maxon_epos4.yaml"
    text = (
        shipped_profiles()["maxon_epos4"]
        .read_text()
        .replace("velocity_units_per_rps: 60 ", "velocity_units_per_rps: 7 ")
    )
    own.write_text(text)
    assert read_axis(axis_file(tmp_path, profile="maxon_epos4")).drive.velocity_units_per_rps == 7
    assert profile_path(tmp_path / "axis.yaml", "../elsewhere/maxon_epos4.yaml") == own  # what a recording carries


def test_a_name_that_is_no_profile_is_told_those_that_are(tmp_path: Path) -> None:
    with pytest.raises(DocumentError, match=r"axis.yaml:\d+: drive.profile: 'epos' is neither a file.*maxon_epos4"):
        read_axis(axis_file(tmp_path, profile="epos"))


def test_a_mistake_in_a_profile_names_its_file_and_line(tmp_path: Path) -> None:
    (tmp_path / "mine.yaml").write_text("family: x\ntried: nothing\ndrive:\n  silence_detektion: heartbeat\n")
    with pytest.raises(DocumentError, match=r"mine.yaml:4: drive.silence_detektion: unknown key; did you mean"):
        read_axis(axis_file(tmp_path, profile="mine.yaml"))


@pytest.mark.parametrize(
    ("keys", "message"),
    [
        ({"target": {"object": 0x201C}}, "target.units_per_a: 0x201C has its own units"),
        ({"torque_feedback": {"object": 0x207E}}, "torque_feedback.units_per_a: 0x207E"),
        ({"torque_feedback": {"object": 0x606C}}, r":\d+: drive.torque_feedback.object: 0x606C is neither the drive's"),
        ({"torque_feedback": {"object": 0x6071}}, r"0x6071 is neither the drive's torque here \(0x6077 or 0x6078\)"),
        ({"torque_feedback": {"object": 0x6078}}, "torque_feedback.units_per_a: 0x6078"),
        ({"target": {"object": 0x60FF}}, r"drive.target.object: 0x60FF is neither the drive's torque here \(0x60"),
        ({"target": {"object": 0xA000}}, "0xA000 is neither"),
        (
            {"torque_feedback": {"object": 0x6877}},
            r"drive.torque_feedback.object: 0x6877 is 0x6077 of axis 2 of a node",
        ),
        ({"target": {"object": 0x7071}}, r"0x7071 is 0x6071 of axis 3 .* Only the first axis .* use 0x6071"),
        ({"target": {"object": 0x6877}}, "0x6877 is neither"),
        ({"silence_detection": "vendor"}, "the objects that set it belong in sdo"),
        ({"mode": 8}, "mode 8: 10, 4, or a negative one"),
        ({"pdo": {"motion": 2}}, "motion, status and event are three TPDOs"),
        ({"silence_detection": "hope"}, "silence_detection"),
    ],
)
def test_what_cannot_be_is_refused_by_key(tmp_path: Path, keys: dict[str, object], message: str) -> None:
    with pytest.raises(DocumentError, match=message):
        read_axis(axis_file(tmp_path, **keys))


def test_a_rate_beyond_the_drives_is_refused(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = axis_file(tmp_path, profile="nanotec_cl4e")
    assert main(["config", "check", str(path)]) == 78
    assert "loop.rate_hz: 2000 Hz; the drive accepts commands at no more than 1000 Hz" in capsys.readouterr().err


def test_a_drive_is_known_by_its_identity() -> None:
    known = profile_for(0x26C, 0x5B)
    assert known is not None
    assert known[0] == "nanotec_cl4e"
    assert profile_for(0x26C, 0x5C) is None  # another product of the vendor
    every = profile_for(0xFB, 0x1234)
    assert every is not None
    assert every[0] == "maxon_epos4"
    assert profile_for(None, None) is profile_for(0, 1) is None


def test_a_commissioning_stands_for_mode_and_target(tmp_path: Path) -> None:
    plain = declared_facts(read_axis(axis_file(tmp_path)), MODEL)
    other = declared_facts(read_axis(axis_file(tmp_path, mode=4)), MODEL)
    assert plain.command == ""
    assert "mode 4" in other.command
    assert plain.digest != other.digest


def test_the_list_of_profiles_says_what_was_tried(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["config", "drives"]) == 0
    text = capsys.readouterr().out
    assert text.count("tried:") == len(shipped_profiles())


def test_drive_info_writes_a_profile_that_is_read_back(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    eds = Path(__file__).resolve().parents[1] / "canopen" / "eds" / "capitals.eds"
    out = tmp_path / "cap.yaml"
    assert main(["drive-info", str(eds), "--profile", str(out)]) == 0
    profile = read_profile(out)
    assert (profile.vendor_id, profile.product_codes) == (0xFEED, [0x42])
    assert profile.keys == {"velocity_units_per_rps": 131072}  # counts are the encoder's, ratings the motor's
    axis = read_axis(axis_file(tmp_path, profile="cap"))
    assert axis.drive.velocity_units_per_rps == 131072
