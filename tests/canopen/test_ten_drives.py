"""Ten real drives' dictionaries: what `drive-info` proposes brings each up, or the reason against it is true."""

from __future__ import annotations

import dataclasses
from pathlib import Path
from typing import Any

import pytest
from real_drives import DRIVES, RealDrive, described, eds_of, number_of
from shared_data import shared_files

from fffo_drive.can.link import free_loopback_port
from fffo_drive.cli import main
from fffo_drive.config.drive_profile import profile_for, read_profile, shipped_profiles
from fffo_drive.config.drive_proposal import config_of
from fffo_drive.config.eds_fitness import Fitness, fitness_of
from fffo_drive.drive.canopen.drive import CanopenDrive
from fffo_drive.drive.canopen.eds import default_of, read_eds
from fffo_drive.drive.port import DriveRefusedError

NODE = 32
PERIOD_NS = 1_000_000
NO_TORQUE = {  # why not
    "epos2": ["object 0x6071:00 is missing (the torque that is commanded)"],
    "prbt": ["there is no mode 10 (cyclic synchronous torque)", "object 0x6071:00 is missing"],
    "schunk": ["there is no mode 10 (cyclic synchronous torque)", "object 0x6071:00 is missing"],
}  # fmt: skip
RATINGS = {"e35": {"rated_torque_nm": 0.31}}  # of the motor: no part of a profile
LEFT_TO_THE_DRIVE = {(0x1000, 0): "0x20192", (0x6502, 0): "0x200"}  # where the file is silent
IPOS_OBJECTS = {  # of the vendor's own, which the public file leaves out
    (0x201C, 0): {"type": "0x4", "access": "rww", "pdo": "1"},
    (0x201D, 0): {"type": "0x6", "access": "rw", "pdo": "0"},
    (0x207E, 0): {"type": "0x3", "access": "ro", "pdo": "1"},
}


def fitness(name: str, folder: Path, base: dict[str, Any] | None = None) -> Fitness:
    """What is declared of a drive's file alone, or on top of a profile."""
    path = folder / f"{name}.eds"
    path.write_text(eds_of(shared_files(f"drives/{name}.yaml")[0]))
    return fitness_of(read_eds(str(path), NODE), NODE, base)


def brought_up(name: str, section: dict[str, Any]) -> str:
    """The refusal of the bring-up against the drive's own dictionary; empty when it comes up."""
    objects = described(shared_files(f"drives/{name}.yaml")[0])
    objects |= IPOS_OBJECTS if name == "ipos" else {}
    for place, default in LEFT_TO_THE_DRIVE.items():
        if not objects[place].get("default"):
            objects[place] = {**objects[place], "default": default}
    bus = f"loopback:{free_loopback_port()}"
    config = dataclasses.replace(
        config_of(section, NODE), bus=bus, listen_s=0.01, period_ns=PERIOD_NS, answer_timeout_s=1.0,
        start_timeout_s=0.1, rated_current_a=None,
    )  # fmt: skip
    with RealDrive(bus, NODE, objects) as node:
        try:
            with CanopenDrive(config):
                return ""
        except DriveRefusedError as refusal:
            return str(refusal)
        finally:
            assert not [value for index, _, value in node.written if index == 0x6040 and any(value)]


def test_the_ten_are_there() -> None:
    assert tuple(path.stem for path in shared_files("drives/*.yaml")) == DRIVES


@pytest.mark.parametrize("name", [name for name in DRIVES if name not in (*NO_TORQUE, "ipos")])
def test_a_drive_with_a_torque_mode_comes_up_with_what_its_file_proposes(name: str, tmp_path: Path) -> None:
    found = fitness(name, tmp_path)
    assert found.refusals == ()
    refusal = brought_up(name, found.section)
    unset = "0x6076:00 is 0: the drive does not know the rating of its motor"
    assert not refusal or unset in refusal  # of a drive that was never set up


@pytest.mark.parametrize("name", NO_TORQUE)
def test_a_drive_without_one_is_refused_with_the_reason(name: str, tmp_path: Path) -> None:
    refusals = fitness(name, tmp_path).refusals
    for reason in NO_TORQUE[name]:
        assert any(reason in refusal for refusal in refusals), refusals
    assert "0x6071" in brought_up(name, {}) or "no mode 10" in brought_up(name, {})


@pytest.mark.parametrize(
    ("name", "profile"),
    [("e35", "e35"), ("elmo_gold", "elmo_gold"), ("epos4", "maxon_epos4"), ("foc_mc", "amd_foc_mc"),
     ("ipos", "technosoft_ipos"), ("nanotec_cl4e", "nanotec_cl4e"), ("roboteq", "roboteq")],
)  # fmt: skip
def test_the_profile_that_ships_brings_its_drive_up(name: str, profile: str, tmp_path: Path) -> None:
    keys = read_profile(shipped_profiles()[profile]).keys
    assert fitness(name, tmp_path, keys).refusals == ()
    refusal = brought_up(name, {**keys, **RATINGS.get(name, {})})
    assert not refusal or "0x6076:00 is 0: the drive does not know the rating" in refusal


@pytest.mark.parametrize("name", ["elmo_gold", "foc_mc", "ipos", "nanotec_cl4e", "roboteq"])
def test_a_drive_that_tells_its_vendor_is_offered_its_profile(name: str) -> None:
    objects = described(shared_files(f"drives/{name}.yaml")[0])
    vendor, product = (objects.get((0x1018, sub), {}).get("default") for sub in (1, 2))
    known = profile_for(int(vendor, 0), int(product, 0) if product else None)
    assert known is not None
    assert name.partition("_")[0] in known[0]


@pytest.mark.parametrize(
    ("name", "facts"),
    [
        ("nanotec_cl4e", {"counts_per_rev": 3600, "velocity_units_per_rps": 60.0,
                          "silence_reaction": "error_behaviour"}),
        ("e35", {"rated_torque_nm": 0.31, "rated_current_a": 3.0, "counts_per_rev": 2000,
                 "velocity_units_per_rps": 2000.0, "silence_detection": "life_guarding", "silence_reaction": "none"}),
        ("epos4", {"velocity_units_per_rps": 60.0}),
        ("elmo_gold", {}),
        ("foc_mc", {"mode": 4, "silence_reaction": "none", "bitrate_hz": 800_000,
                    "pdo": {"command": 2, "motion": 2, "status": 3, "event": 1}}),
        ("roboteq", {"mode": 4, "torque_slope": 1_000_000, "silence_reaction": "none"}),
    ],
)  # fmt: skip
def test_what_a_file_tells(name: str, facts: dict[str, Any], tmp_path: Path) -> None:
    section = dict(fitness(name, tmp_path).section)
    for always in ("command_timeout_ms", "rated_torque_nm", "rated_current_a"):
        if always not in facts:
            section.pop(always, None)
    assert section == facts


def test_every_way_of_writing_the_node_id_is_read(tmp_path: Path) -> None:
    for name in DRIVES:
        path = tmp_path / f"{name}.eds"
        path.write_text(eds_of(shared_files(f"drives/{name}.yaml")[0]))
        dictionary = read_eds(str(path), NODE).dictionary
        objects = described(shared_files(f"drives/{name}.yaml")[0])
        for place, row in objects.items():
            if "NODE" in row.get("default", "").upper() and "value" not in row:
                assert default_of(dictionary, *place) == number_of(row["default"], NODE), (name, place)


@pytest.mark.parametrize("name", [name for name in DRIVES if name not in (*NO_TORQUE, "ipos")])
def test_a_profile_is_written_from_the_file_alone(name: str, tmp_path: Path) -> None:
    path, out = tmp_path / f"{name}.eds", tmp_path / f"{name}_new.yaml"
    path.write_text(eds_of(shared_files(f"drives/{name}.yaml")[0]))
    assert main(["drive-info", str(path), "--without-profile", "--profile", str(out)]) == 0
    keys = read_profile(out).keys
    refusal = brought_up(name, {**keys, **RATINGS.get(name, {})})
    assert not refusal or "0x6076:00 is 0" in refusal
