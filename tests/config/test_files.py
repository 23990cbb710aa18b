"""Configuration files: every shipped one is valid, and every mistake is named with file, line and key."""

from __future__ import annotations

import json
import re
from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from fffo_drive.cli import main
from fffo_drive.cli.config import SCHEMAS, schema_record
from fffo_drive.commissioning.record import CommissioningRecord
from fffo_drive.config.adoption import History
from fffo_drive.config.axis import (
    build_profile,
    controller_config,
    envelope_config,
    loop_axis,
    loop_config,
    model_of,
    read_axis,
)
from fffo_drive.config.checks import (
    bus_problems,
    law_margins,
    law_problems,
    profile_problems,
    rest_margins,
    shared_buses,
)
from fffo_drive.config.mirror import dataclass_of, record_of
from fffo_drive.config.simulated import read_simulated
from fffo_drive.control import envelope as env
from fffo_drive.control.notch import Notch, notch_config
from fffo_drive.documents import DocumentError, parse
from fffo_drive.drive.simulated.node.config import NodeConfig
from fffo_drive.model.parameters import read_model, write_model

CONFIGS = Path(__file__).resolve().parents[2] / "configs"
AXIS = (CONFIGS / "axis_simulated.yaml").read_text()
BUS = (CONFIGS / "axis_canopen.yaml").read_text()
MODEL = (CONFIGS / "models" / "table1.yaml").read_text()


def write(tmp_path: Path, text: str, name: str = "axis.yaml") -> Path:
    path = tmp_path / name
    path.write_text(text)
    (tmp_path / "models").mkdir(exist_ok=True)
    (tmp_path / "models" / "table1.yaml").write_text(MODEL)
    return path


def errors_of(path: Path, reader=read_axis) -> str:
    with pytest.raises(DocumentError) as caught:
        reader(path)
    return str(caught.value)


@pytest.mark.parametrize("path", sorted(CONFIGS.glob("axis_*.yaml")), ids=lambda p: p.name)
def test_every_shipped_axis_file_is_valid_stable_and_inside_its_limits(path):
    axis = read_axis(path)
    model = model_of(path, axis)
    profile = build_profile(axis.profile, axis.loop.period_s)
    assert axis.controller.accept_unproven == (path.name == "axis_nearest.yaml")  # which is said on everything it gives
    assert axis.controller.accept_unproven or law_problems(axis, model, True) == law_problems(axis, model, False) == []
    assert profile_problems(axis, profile) == bus_problems(axis, model) == []
    assert controller_config(axis, model).period_s == loop_config(axis).period_ns * 1e-9


def test_the_shipped_simulated_drive_is_valid():
    assert read_simulated(CONFIGS / "simulated_drive.yaml").node_id == 1


def test_an_unknown_key_names_its_line_and_the_nearest_one(tmp_path):
    path = write(tmp_path, AXIS.replace("integral_a_per_rev:", "integral_a_per_rv:"))
    line = next(k for k, text in enumerate(path.read_text().splitlines(), 1) if "integral_a_per_rv" in text)
    text = errors_of(path)
    assert f"{path}:{line}: controller.integral_a_per_rv: unknown key; did you mean 'integral_a_per_rev'?" in text
    assert "controller.integral_a_per_rev: missing" in text  # all errors at once


def test_a_value_out_of_range_names_the_range(tmp_path):
    text = errors_of(write(tmp_path, AXIS.replace("proportional_a_per_rps: 0.975", "proportional_a_per_rps: -1")))
    assert "controller.proportional_a_per_rps: a number above 0 and up to 10000 is needed (got -1)" in text


def test_a_wrong_type_is_reported(tmp_path):
    text = errors_of(write(tmp_path, AXIS.replace("current_limit_a: 12", "current_limit_a: twelve")))
    assert "controller.current_limit_a" in text
    assert "'twelve'" in text


def test_a_key_given_twice_is_an_error_with_both_lines(tmp_path):
    text = errors_of(write(tmp_path, AXIS + "name: again\n"))
    assert "name: given twice, first in line" in text


def test_a_missing_file_and_broken_yaml_are_one_sentence(tmp_path):
    assert errors_of(tmp_path / "none.yaml").endswith("none.yaml: cannot be read: No such file or directory")
    assert "not valid YAML" in errors_of(write(tmp_path, "a: [1, 2"))
    assert "indent with blanks" in errors_of(write(tmp_path, "a:\n\tb: 1\n"))
    assert "a mapping of keys" in errors_of(write(tmp_path, "- 1\n- 2\n"))


def test_the_drive_is_checked_by_its_kind(tmp_path):
    text = errors_of(write(tmp_path, BUS.replace("node_id: 1", "node_id: 200")))
    assert "drive.node_id: a number from 1 to 127 is needed (got 200)" in text
    text = errors_of(write(tmp_path, BUS.replace("bus: loopback:29500", "bus: can0")))
    assert (
        "drive.bus: write socketcan:INTERFACE (socketcan:can0) or loopback:PORT (loopback:20000) (got 'can0')" in text
    )
    text = errors_of(write(tmp_path, BUS.replace("kind: canopen", "kind: canopn")))
    assert "drive.kind: 'canopn' is none of 'simulated', 'canopen'" in text
    assert "drive.kind: missing" in errors_of(write(tmp_path, BUS.replace("  kind: canopen\n", "")))


def test_limits_contradicting_each_other_are_reported(tmp_path):
    text = errors_of(write(tmp_path, AXIS.replace("continuous_current_a: 8.3", "continuous_current_a: 20")))
    assert "continuous_current_a must not exceed current_limit_a" in text


@pytest.mark.parametrize(
    ("notches", "line", "said"),
    [
        ("[{frequency_hz: 110}, {frequency_hz: 801}]", 6, "notches.1.frequency_hz: 801 Hz; at most 800 Hz is possible"),
        ("[{frequency_hz: 110, widht: 1}]", 6, "notches.0.widht: unknown key; did you mean 'width'?"),
        ("[{width: 1}]", 6, "notches.0.frequency_hz: missing"),
        ("[{frequency_hz: 40}, {frequency_hz: 50}, {frequency_hz: 60}]", 6, "notches: at most 2 entries are allowed"),
    ],
)
def test_errors_of_notches_have_their_line(tmp_path, notches, line, said):
    text = errors_of(write(tmp_path, AXIS.replace("controller:\n", f"controller:\n  notches: {notches}\n")))
    assert f":{line + AXIS[: AXIS.index('controller:')].count(chr(10)) - 4}: controller.{said}" in text


def test_a_notch_reaches_the_kernel_and_the_margins_and_not_the_papers_law(tmp_path):
    text = AXIS.replace("controller:\n", "controller:\n  notches: [{frequency_hz: 110, width: 0.8, depth: 0.2}]\n")
    axis = read_axis(write(tmp_path, text))
    model = model_of(tmp_path / "axis.yaml", axis)
    notch = Notch(110.0, 0.8, 0.2)
    assert controller_config(axis, model).notches == notch_config((notch,), axis.loop.period_s)
    assert loop_axis(axis, model).notches == (notch,)
    plain = read_axis(write(tmp_path, AXIS))
    assert law_margins(axis, model, True).phase_deg < law_margins(plain, model, True).phase_deg - 3.0
    assert rest_margins(axis, model) != rest_margins(plain, model)
    assert axis.controller.papers.notches == []


def test_an_unknown_trip_in_the_reactions_names_the_known_ones(tmp_path):
    text = errors_of(write(tmp_path, AXIS.replace("envelope:\n", "envelope:\n  reactions: {overspeeed: coast}\n")))
    assert re.search(r":\d+: envelope.reactions.overspeeed: no trip has this name: did you mean 'overspeed'", text)
    assert AXIS[: AXIS.index("envelope:\n")].count("\n") + 2 == int(re.search(r":(\d+): envelope", text)[1])


def test_a_reaction_reaches_the_kernel(tmp_path):
    axis = read_axis(write(tmp_path, AXIS.replace("envelope:\n", "envelope:\n  reactions: {overspeed: coast}\n")))
    assert envelope_config(axis).reactions[env.TRIP_OVERSPEED] == env.REACTION_COAST
    assert envelope_config(axis).reactions[env.TRIP_BUS_OFF] == env.REACTION_QUICK_STOP


def test_a_reaction_under_the_former_name_of_its_trip_counts_in_a_file_of_that_time(tmp_path):
    older = AXIS.replace("fffo_drive/axis/2", "fffo_drive/axis/1")
    axis = read_axis(write(tmp_path, older.replace("envelope:\n", "envelope:\n  reactions: {foreign_sync: coast}\n")))
    assert envelope_config(axis).reactions[env.TRIP_FOREIGN_COMMAND] == env.REACTION_COAST


def test_an_observer_gain_that_breaks_condition_14_is_refused_with_the_needed_one(tmp_path):
    axis = read_axis(
        write(tmp_path, AXIS.replace("gain_nm_per_rev: 5 ", "gain_nm_per_rev: 3\n    learns_in: friction "))
    )
    model = model_of(tmp_path / "axis.yaml", axis)
    assert any("condition (14)" in text and "at least 3.22" in text for text in law_problems(axis, model, True))
    assert law_problems(axis, model, False) == []


def test_an_observer_gain_without_margin_is_refused(tmp_path):
    axis = read_axis(write(tmp_path, AXIS.replace("gain_nm_per_rev: 5", "gain_nm_per_rev: 20")))
    assert any("phase margin" in text for text in law_problems(axis, model_of(tmp_path / "a", axis), True))


def test_a_profile_beyond_the_envelope_is_refused(tmp_path):
    axis = read_axis(write(tmp_path, AXIS.replace("speed_limit_rps: 25", "speed_limit_rps: 10")))
    profile = build_profile(axis.profile, axis.loop.period_s)
    assert any("speed_limit_rps" in text for text in profile_problems(axis, profile))


def test_a_rate_that_does_not_fit_the_bus_is_refused(tmp_path):
    axis = read_axis(write(tmp_path, BUS.replace("node_id: 1", "node_id: 1\n  bitrate_hz: 500000")))
    assert any("loop.rate_hz" in text for text in bus_problems(axis, model_of(tmp_path / "a", axis)))


def test_axes_of_two_nodes_on_one_bus_are_reported(tmp_path, capsys):
    first = write(tmp_path, BUS, "first.yaml")
    variant = write(tmp_path, BUS.replace("name: bench", "name: other"), "variant.yaml")  # of the same drive
    second = write(tmp_path, BUS.replace("node_id: 1", "node_id: 2"), "second.yaml")
    elsewhere = write(tmp_path, BUS.replace("node_id: 1", "node_id: 3").replace("29500", "29501"), "elsewhere.yaml")
    in_process = write(tmp_path, (CONFIGS / "axis_simulated.yaml").read_text(), "in_process.yaml")
    axes = [(path.name, read_axis(path)) for path in (first, variant, elsewhere, in_process)]
    assert shared_buses(axes) == []
    (said,) = shared_buses([*axes[1:3], ("second.yaml", read_axis(second))])
    assert said.startswith(
        "loopback:29500 is the bus of variant.yaml and second.yaml: one bus has one master, and several"
    )
    assert main(["config", "check", str(first), str(second)]) == 0
    assert "warning: loopback:29500 is the bus of" in capsys.readouterr().out


def test_errors_of_the_simulated_drive_have_lines(tmp_path):
    path = tmp_path / "drive.yaml"
    path.write_text(
        "node_id: 1\nplant:\n  effects:\n    - {name: coging}\n    - {name: cogging, parameters: {order: -1}}\n"
    )
    text = errors_of(path, read_simulated)
    assert f"{path}:4: plant.effects[0]" in text
    assert "cogging" in text
    assert f"{path}:5: plant.effects[1]" in text


def test_a_model_edited_by_hand_is_noticed_and_units_mistaken_are_absurd(tmp_path):
    path = tmp_path / "model.yaml"
    write_model(path, read_model(CONFIGS / "models" / "table1.yaml"))
    assert read_model(path).content_hash is not None
    path.write_text(path.read_text().replace("0.025", "0.026"))
    assert "content_hash: does not match" in errors_of(path, read_model)
    path.write_text(MODEL.replace("delay_s: {value: 0.00275", "delay_s: {value: 2.75"))
    assert "delay_s.value: 2.75 is outside 0 .. 0.1" in errors_of(path, read_model)


def test_the_record_of_the_simulated_drive_is_its_dataclass():
    assert dataclass_of(NodeConfig, record_of(NodeConfig)()) == NodeConfig()


RECORDS = {kind: schema_record(kind) for kind in SCHEMAS} | {"commissioning": CommissioningRecord, "adoptions": History}


@pytest.mark.parametrize("kind", RECORDS)
def test_schemas_are_json_and_take_no_unknown_key(kind):
    schema = json.loads(json.dumps(RECORDS[kind].model_json_schema()))
    assert schema["type"] == "object"
    assert schema["additionalProperties"] is False


@pytest.mark.parametrize("kind", RECORDS)
def test_every_key_of_a_schema_has_a_description(kind):
    """Its own, or that of the one section which it holds: what editors show, and the reference of the manual."""
    schema = RECORDS[kind].model_json_schema()
    sections = schema.get("$defs", {})

    def described(entry):
        return entry.get("description") or sections.get(entry.get("$ref", "").rpartition("/")[2], {}).get("description")

    assert [
        f"{name}.{key}"
        for name, section in {kind: schema, **sections}.items()
        for key, entry in section.get("properties", {}).items()
        if not described(entry)
    ] == []


@pytest.mark.parametrize(
    ("listen", "needed"),
    [
        ("8700", []),
        ("127.0.0.1:8700", []),
        ("127.0.0.5:8700", []),
        ("'[::1]:8700'", ["AF_INET6"]),
        ("192.0.2.7:8700", ["IPAddressAllow="]),
        ("bench.lab:8700", ["IPAddressAllow="]),
        ("'[2001:db8::1]:8700'", ["IPAddressAllow=", "AF_INET6"]),
    ],
)
def test_an_address_that_the_units_sandbox_closes_is_reported(tmp_path, capsys, listen, needed):
    unit = (CONFIGS.parent / "systemd" / "fffo-drive@.service").read_text()
    assert "\nIPAddressDeny=any\nIPAddressAllow=localhost\n" in unit
    assert "\nRestrictAddressFamilies=AF_CAN AF_UNIX AF_INET\n" in unit
    axis = AXIS.replace("file: simulated_drive.yaml", f"file: {CONFIGS / 'simulated_drive.yaml'}")
    for key in ("scope", "foxglove"):
        path = write(tmp_path, f"{axis}daemon: {{{key}: {listen}}}\n")
        assert main(["config", "check", str(path)]) == 0
        warnings = [line for line in capsys.readouterr().out.splitlines() if "closed by the sandbox" in line]
        assert len(warnings) == bool(needed)
        for line in warnings:
            assert f"warning: daemon.{key}: " in line
            assert [word for word in ("IPAddressAllow=", "AF_INET6") if word in line] == needed


def test_numbers_are_yaml_1_2():
    data, _ = parse("a: 1e3\nb: 1.5e-4\nc: 10\nd: on\ne: true\nf: -.5\n", "x")
    assert data == {"a": 1000.0, "b": 1.5e-4, "c": 10, "d": "on", "e": True, "f": -0.5}
    assert isinstance(data["c"], int)


@settings(max_examples=150)
@given(st.text(max_size=200))
def test_any_text_is_a_file_or_a_clean_error(tmp_path_factory, text):
    path = tmp_path_factory.mktemp("any") / "axis.yaml"
    path.write_text(text, encoding="utf-8", errors="replace", newline="")
    with pytest.raises(DocumentError):
        read_axis(path)
