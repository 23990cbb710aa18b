"""Tables over two axes: found where two axes act together, refused where they do not, and kept apart from curves."""

from dataclasses import replace

import numpy as np
import pytest
from fffo_drive.diagnosis.candidates import Effect, effect_rows
from fffo_drive.diagnosis.pairs import coarse_tables, pairs_of, table_trial
from fffo_drive.diagnosis.selection import Contest, Selection, evidence_of
from fffo_drive.diagnosis.tables import with_table
from identification.rig import random_plant, record
from identification.synthetic import PERIOD_S

from fffo_drive.diagnosis.diagnose import prepared
from fffo_drive.diagnosis.fitting import consistent_scenes, refit
from fffo_drive.diagnosis.pictures import picture
from fffo_drive.diagnosis.startup import fit_base
from fffo_drive.drive.simulated.parameters import EffectConfig
from fffo_drive.identification.excitation import identification_sequence, separating_recipe
from fffo_drive.identification.facts import DriveFacts
from fffo_drive.model.effects.laws.lookup import across_word

FACTS = DriveFacts(torque_constant_nm_per_a=0.148, rated_current_a=8.3, gear_ratio=160.0, resolver_bits=15)
RATE = 0.01


def records_with(*effects):
    """Two runs of an axis."""
    plant = replace(random_plant(5), roughness_nm=2e-4, effects=effects)
    return [
        record(plant, identification_sequence(16.0, PERIOD_S, 0.5, 1.1, 0.1, 10.0), "identify"),
        record(plant, separating_recipe(PERIOD_S, 12.0, 80.0, 1), "recipe"),
    ]


def base_on(records):
    """The base fitted to runs: (data, base, sensitivities)."""
    return fit_base(*prepared(records, FACTS, None), len(records))


def axis_with(*effects):
    """Two runs of an axis, and the base fitted to them: (data, base, sensitivities)."""
    return base_on(records_with(*effects))


@pytest.fixture(scope="module")
def patched():
    """An axis with a patch on the motor's turn that is only felt when it is passed slowly."""
    patch = {"amplitude_nm": 0.012, "centre_rev": 0.4, "width_rev": 0.2, "fades_rps": 2.0}
    return axis_with(EffectConfig("odd_stick_patch", patch))


def selection(data, base, matrix, *wrong):
    """What a search would hand over that has found these effects."""
    fitted = refit(data, matrix, base.physical, list(wrong)) if wrong else base
    contests = tuple(Contest(e.name, {e.name: 1.0}, {}) for e in wrong)
    return Selection(data, base, fitted, matrix, contests, (1e-9,) * len(wrong), (), (), None)


def untold(share):
    assert 0.0 <= share <= 1.0


@pytest.mark.slow
def test_what_two_axes_do_together_is_found_as_a_table_and_takes_the_place_of_a_law_that_fits_half_of_it(patched):
    data, base, matrix = patched
    offset = Effect("torque_offset", {}, {"torque_nm": np.array([1e-4])})
    found = with_table(selection(data, base, matrix, offset), RATE, untold)
    assert [e.name for e in found.fitted.effects] == ["unknown:motor_angle"]
    assert across_word(found.fitted.effects[0].shapes) in ("speed", "velocity")
    assert found.fitted.loss < 0.75 * found.base.loss
    assert found.probabilities[-1] <= RATE
    assert len(found.contests) == len(found.probabilities) == 1
    shown = picture(found.data, found.base, found.fitted, 0).curves  # at the two levels that differ most
    assert [curve.kind for curve in shown] == ["points", "line"] * 2
    assert len({curve.label for curve in shown}) == 4
    assert all(" near " in curve.label for curve in shown)


@pytest.mark.slow
def test_the_columns_of_a_table_are_its_law(patched):
    data, base, matrix = patched
    evidence, scenes = evidence_of(data, matrix, base)
    pair = next(p for p in pairs_of(100.0) if p.name == "motor_angle x speed")
    trial = table_trial(evidence, scenes, pair)
    strengths = np.array([trial.effect.strengths[name][0] for name in trial.columns.names])
    along = effect_rows(consistent_scenes(data, base.physical, ()), trial.effect, data.rows.laws)
    assert along == pytest.approx(trial.columns.values @ strengths, abs=1e-9)


def test_an_axis_that_hardly_turns_has_no_angle_of_the_motor():
    assert any(p.along.word == "motor_angle" for p in pairs_of(10.0))
    assert not any("motor_angle" in p.name for p in pairs_of(1.0))
    names = [p.name for p in pairs_of(10.0)]
    assert len(names) == len(set(names))


@pytest.mark.slow
def test_coarse_tables_hold_their_curves(patched):
    """The knots of one axis add up to one: a table summed over one axis is a curve over the other."""
    data, base, matrix = patched
    scenes = evidence_of(data, matrix, base)[1]
    for one in coarse_tables(data.rows, scenes)[:4]:
        side = int(np.sqrt(one.columns.shape[1]))
        if side * side != one.columns.shape[1]:
            continue
        summed = one.columns.reshape(-1, side, side).sum(axis=2)
        assert summed == pytest.approx(one.beside[:, :side], abs=1e-9)
