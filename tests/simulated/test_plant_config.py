"""The configuration of the simulated drive: all errors at once, each with key and range; and what it is packed into."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from fffo_drive.drive.simulated import friction
from fffo_drive.drive.simulated.pack import new_state, plant_parameters
from fffo_drive.drive.simulated.parameters import (
    DeviceConfig,
    EffectConfig,
    PlantConfig,
    PlantConfigError,
    ResolverConfig,
    paper_plant,
)
from fffo_drive.drive.simulated.surfaces import FIVE_SURFACES, PlantFriction


def complaints(config) -> list[str]:
    with pytest.raises(PlantConfigError) as raised:
        config.validate()
    return str(raised.value).splitlines()


def test_the_defaults_are_valid():
    assert PlantConfig().validate() == PlantConfig()
    assert paper_plant().validate().friction.kind == "single_2sep"
    assert DeviceConfig().validate() == DeviceConfig()


def test_all_errors_are_named_at_once_with_key_value_and_range():
    wrong = PlantConfig(
        inertia_kg_m2=0.0,
        seed=1.5,
        dc_link_v=float("nan"),
        resolver=ResolverConfig(bits=40, tracking_hz=True),
        friction=PlantFriction(
            kind="sticky", surfaces=(replace(FIVE_SURFACES[0], coulomb_nm=0.1), replace(FIVE_SURFACES[1], ratio=0.0))
        ),
        effects=(
            EffectConfig("coging"),
            EffectConfig("cogging", {"amplitud_nm": 0.1}),
            EffectConfig("unbalance", {"amplitude_nm": 9.0}),
        ),
    )
    lines = complaints(wrong)
    assert [line.split(":")[0] for line in lines] == [
        "plant.inertia_kg_m2",
        "plant.dc_link_v",
        "plant.seed",
        "plant.resolver.bits",
        "plant.resolver.tracking_hz",
        "plant.friction.surfaces[1].ratio",
        "plant.friction.kind",
        "plant.friction.surfaces[0].stiction_nm",
        "plant.effects[0].name",
        "plant.effects[1].parameters.amplitud_nm",
        "plant.effects[2].parameters.amplitude_nm",
    ]
    assert "0 is outside 1e-07 to 100 kg m^2" in lines[0]
    assert "not a whole number" in lines[2]
    assert "did you mean 'cogging'" in lines[8]
    assert "did you mean 'amplitude_nm'" in lines[9]
    assert "9 is outside 0 to 0.5 Nm" in lines[10]


def test_a_delay_shorter_than_its_fixed_parts_is_refused_with_the_least_possible_one():
    (line,) = complaints(PlantConfig(delay_s=0.001))
    assert line.startswith("plant.delay_s: 0.001 is shorter than the fixed parts together, 0.0016")
    least_s = float(line.split(", ")[1].split(" ")[0])
    PlantConfig(delay_s=least_s + 1e-6).validate()


def test_effects_that_take_more_inertia_than_there_is_are_refused():
    shares = (EffectConfig("elasticity", {"load_share": 0.6}), EffectConfig("backlash", {"load_share": 0.6}))
    (line,) = complaints(PlantConfig(effects=shares))
    assert line.startswith("plant.motor_inertia_share")


def test_the_voltage_limit_option_of_quick_stop_is_refused():
    (line,) = complaints(DeviceConfig(quick_stop_option=4))
    assert line.startswith("device.quick_stop_option")


def test_surfaces_behind_the_gear_are_seen_through_its_ratio():
    table = plant_parameters(PlantConfig()).friction
    output = FIVE_SURFACES[4]
    row = table[4]
    assert output.ratio == 160.0
    assert row[friction.COULOMB_NM] == output.coulomb_nm / 160.0
    assert row[friction.STIFFNESS] == output.stiffness_nm_per_rev / 160.0**2
    assert row[friction.VISCOUS_NM_PER_RPS] == output.viscous_nm_per_rps / 160.0**2
    assert 1.0 / row[friction.PER_STRIBECK_RPS] == pytest.approx(output.stribeck_rps * 160.0)


def test_kernels_read_the_parameters_in_the_order_of_the_registry():
    values = {"phase_rev": 0.3, "amplitude_nm": 0.02}
    parameters = plant_parameters(PlantConfig(effects=(EffectConfig("cogging", values),)))
    assert parameters.effect_parameters[0, :3] == pytest.approx([0.02, 12.0, 0.3])


def test_effects_are_packed_in_the_order_of_their_stages():
    names = ("resolver_error", "cogging", "asymmetric_coulomb", "torque_ripple", "dead_zone")
    config = PlantConfig(effects=tuple(EffectConfig(name) for name in names))
    parameters = plant_parameters(config)
    assert list(parameters.integers[2:]) == [0, 1, 2, 3, 4, 5]
    backwards = plant_parameters(replace(config, effects=config.effects[::-1]))
    assert np.array_equal(parameters.effects, backwards.effects)


def test_a_state_begins_where_the_configuration_says():
    state = new_state(PlantConfig(initial_angle_rev=2.5), seed=9)
    other = new_state(PlantConfig(initial_angle_rev=2.5), seed=10)
    assert state.values[0] == 2.5
    assert not np.array_equal(state.words[:4], other.words[:4])
