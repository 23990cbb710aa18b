"""Units, names of parameters and sentences of a linear axis: one rule for all laws, and no word of a shaft left."""

from __future__ import annotations

import re

import pytest

from fffo_drive.model.effects.registry import LAWS
from fffo_drive.model.parameters import FrictionModel
from fffo_drive.units import LINEAR, axis_word_on, name_on, text_on, unit_in, unit_on

PARAMETERS = [(law.name, p) for law in LAWS.values() if not law.rotary for p in law.parameters]
OF_A_SHAFT = {"nm", "rps", "rps2", "rev", "torque", "inertia"}
WORDS = re.compile(r"\b(torques?|inertia|angle|Nm|rps|rev|motor turn)\b")


@pytest.mark.parametrize(("law", "parameter"), PARAMETERS, ids=[f"{law}-{p.name}" for law, p in PARAMETERS])
def test_every_parameter_of_a_law_has_a_name_and_a_unit_of_a_linear_axis(law, parameter):
    name, unit = (convert(parameter.name, parameter.unit, True) for convert in (name_on, lambda _, u, k: unit_on(u, k)))
    assert not OF_A_SHAFT & set(name.split("_"))
    assert not WORDS.search(unit.replace("/", " "))
    if parameter.unit in LINEAR and name != parameter.name:
        assert name.endswith(LINEAR[parameter.unit].linear_suffix)
    assert name_on(parameter.name, parameter.unit, False) == parameter.name
    assert unit_on(parameter.unit, False) == parameter.unit


@pytest.mark.parametrize(("law", "parameter"), PARAMETERS, ids=[f"{law}-{p.name}" for law, p in PARAMETERS])
def test_a_name_ends_in_the_unit_that_its_law_declares(law, parameter):
    """Else a name would stay as it is beside another unit."""
    assert unit_in(parameter.name) in ("", parameter.unit)
    if parameter.unit in LINEAR and law != "lookup" and parameter.name != "order":
        assert unit_in(parameter.name) == parameter.unit


@pytest.mark.parametrize("name", sorted(FrictionModel.model_fields))
def test_the_friction_has_names_of_a_linear_axis(name):
    assert not OF_A_SHAFT & set(name_on(name, unit_in(name), True).split("_"))


def test_names_by_hand():
    assert name_on("excess_nm_per_rps", "Nm/rps", True) == "excess_n_s_per_m"
    assert name_on("torque_nm", "Nm", True) == "force_n"
    assert name_on("speed_rps", "rps", True) == "speed_mps"
    assert name_on("drag_nm_per_rps2", "Nm/rps2", True) == "drag_n_s2_per_m2"
    assert name_on("inertia_nm_s2_per_rev", "Nm s^2/rev", True) == "mass_kg"
    assert name_on("tau_s", "s", True) == "tau_s"


@pytest.mark.parametrize("law", [law for law in LAWS.values() if not law.rotary], ids=lambda law: law.name)
def test_no_sentence_of_a_law_speaks_of_a_shaft(law):
    for sentence in (law.meaning, law.regime, law.experiment, *(p.meaning for p in law.parameters)):
        assert not WORDS.search(text_on(sentence, True)), sentence
        assert text_on(sentence, False) == sentence


def test_keys_names_of_effects_and_of_files_stay():
    for kept in ("torque_offset", "unknown:torque", "friction(torque)", "torque.mcap", "/logs/torque", "5 mNm",
                 "--torque-constant", "load_gravity_nm", "controller.observer.gain_nm_per_rev"):  # fmt: skip
        assert text_on(kept, True) == kept


def test_sentences_by_hand():
    said = text_on("Torque of 3 Nm, an inertia of 2 Nm s^2/rev: less than one period (0.5 rev) at 2 rps.", True)
    assert said == "Force of 3 N, a mass of 2 kg: less than one period (0.5 m) at 2 m/s."
    assert axis_word_on("motor_angle", True) != axis_word_on("output_angle", True)
    assert axis_word_on("motor_angle", False) == "motor angle"
