"""What is in no list, on plants that share no line with the search: which curve it is, what it says, and its tables."""

from functools import cache

import numpy as np
import pytest
from diagnosis.planted import based, begun, only
from diagnosis.test_recovery import FACTS as GEARED
from diagnosis.test_recovery import records_with

from fffo_drive.diagnosis.curves import coarse_tables, fine_table, pairs_of
from fffo_drive.diagnosis.diagnose import DiagnosisSettings
from fffo_drive.diagnosis.fitting import consistent_scenes, jacobian
from fffo_drive.diagnosis.pictures import picture
from fffo_drive.diagnosis.propose import LAW_RUNG, Search, evidence_of
from fffo_drive.diagnosis.scenes import Effect, load_rows
from fffo_drive.diagnosis.select import Selector, refitted
from fffo_drive.drive.simulated.parameters import EffectConfig
from fffo_drive.model.effects.laws.lookup import BRAKE, WOUND, across_word

AMPLITUDE_NM = 0.012
CABLE = {"torque_nm": 0.01, "reach_rev": 1.5}
PATCH = {"amplitude_nm": 0.012, "centre_rev": 0.4, "width_rev": 0.2, "fades_rps": 2.0}


@cache
def found_in(name):
    """(data, base, evidence, free curves, the best first) of an axis with one effect that is in no list."""
    values = {
        "odd_direction_angle": {"amplitude_nm": AMPLITUDE_NM, "phase_rev": 0.1}, "odd_cable": CABLE,
        "odd_stick_patch": PATCH,
    }[name]  # fmt: skip
    data, base = based(records_with(EffectConfig(name, values)), GEARED)
    evidence = evidence_of(data, base, jacobian(data, base))
    search = Search(GEARED, only(), frozenset())
    proposals = search.proposals(data, base, evidence, LAW_RUNG)
    return data, base, evidence, sorted(proposals, key=lambda one: -one.worth)


def curve(effect):
    """(places, values) of a curve."""
    count = int(effect.shapes["count"])
    return tuple(
        np.array([values(f"{axis}{k:02d}") for k in range(count)])
        for axis, values in (("x", effect.shapes.get), ("y", lambda name: float(effect.strengths[name][0])))
    )


@pytest.mark.slow
def test_a_drag_over_the_output_angle_is_found_as_one():
    data, base, evidence, proposals = found_in("odd_direction_angle")
    best = proposals[0]
    assert best.name == "unknown:output_angle"
    assert best.effect.shapes["kind"] == BRAKE
    assert best.score.explained > 0.8 * evidence.energy
    fitted = refitted(data, base, best, 1.0, True)
    places_rev, values_nm = curve(fitted.effects[0])
    low, high = np.quantile(data.rows.position_rev, (0.1, 0.9))
    inside = (places_rev > low) & (places_rev < high)
    wanted_nm = AMPLITUDE_NM * np.cos(2.0 * np.pi * (places_rev / GEARED.gear_ratio + 0.1))
    level = np.mean((values_nm - wanted_nm)[inside])  # the Coulomb level of the base takes up a constant
    assert values_nm[inside] - level == pytest.approx(wanted_nm[inside], abs=0.15 * AMPLITUDE_NM)


@pytest.mark.slow
def test_a_cable_that_winds_up_and_slips_is_found_as_a_memory_of_the_travel():
    _, _, evidence, proposals = found_in("odd_cable")
    best = proposals[0]
    assert best.name == "unknown:memory"
    assert best.effect.shapes["kind"] == WOUND
    assert best.score.explained > 0.6 * evidence.energy
    reaches_rev, pulls_nm = curve(best.effect)
    near = (reaches_rev > CABLE["reach_rev"] / 3.0) & (reaches_rev < 3.0 * CABLE["reach_rev"])
    assert pulls_nm[near].sum() == pytest.approx(CABLE["torque_nm"], rel=0.25)


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["wound(memory)", "drag(output_angle)", "viscous(time)", "friction(time)"])
def test_the_columns_of_a_curve_are_its_law(kind):
    """But for the filter: a curve changes slowly, and its columns are thinned."""
    data, base, _, proposals = found_in("odd_direction_angle")
    one = next(one for one in proposals if one.kind == kind)
    strengths = np.array([v[0] for v in one.effect.strengths.values()])
    along = load_rows(data.rows, consistent_scenes(data, base.physical, ()), one.effect)
    made = one.columns @ strengths
    kept = data.rows.kept
    scale = np.sqrt(np.mean(along[kept] ** 2))
    assert np.sqrt(np.mean((made - along)[kept] ** 2)) < (1e-6 if kind == "wound(memory)" else 0.2) * scale


@pytest.mark.slow
@pytest.mark.xfail(strict=True, reason="a drag over the angle is taken first, and no table beyond it")
def test_what_two_axes_do_together_is_found_as_a_table():
    """A patch on the motor's turn that is only felt when it is passed slowly."""
    records = records_with(EffectConfig("odd_stick_patch", PATCH))
    begin = begun(records, GEARED, only())
    selection = Selector(GEARED, DiagnosisSettings(without=only()), lambda share, text: None).run(*begin)
    tables = [e for e in selection.fitted.effects if across_word(e.shapes)]
    assert any(across_word(e.shapes) in ("speed", "velocity") and e.name == "unknown:motor_angle" for e in tables)
    assert selection.fitted.energy < 0.75 * selection.base.energy
    assert all(note.p <= 0.01 for note in selection.accepted)
    number = selection.fitted.effects.index(tables[0])
    shown = picture(selection.data, selection.fitted, number).curves  # at two levels, far apart
    assert [one.kind for one in shown] == ["points", "line"] * 2
    assert len({one.label for one in shown}) == 4
    assert all(" near " in one.label for one in shown)


@pytest.mark.slow
def test_the_columns_of_a_table_are_its_law():
    data, base, _, _ = found_in("odd_stick_patch")
    scenes = consistent_scenes(data, base.physical, ())
    table = fine_table(data.rows, scenes, next(p for p in pairs_of(100.0) if p.name == "motor_angle x speed"))
    values = np.random.default_rng(1).normal(size=table.columns.shape[1])
    strengths = {f"y{k:02d}": np.array([v]) for k, v in enumerate(values)}
    along = load_rows(data.rows, scenes, Effect(table.name, table.shapes, strengths))
    assert along == pytest.approx(table.columns @ values, abs=1e-7)


@pytest.mark.slow
def test_coarse_tables_hold_their_curves():
    """The knots of one axis add up to one: a table summed over one axis is a curve over the other."""
    data, base, _, _ = found_in("odd_stick_patch")
    for one in list(coarse_tables(data.rows, consistent_scenes(data, base.physical, ())))[:4]:
        side = int(np.sqrt(one.columns.shape[1]))
        if side * side == one.columns.shape[1]:
            summed = one.columns.reshape(-1, side, side).sum(axis=2)
            assert summed == pytest.approx(one.beside[:, :side], abs=1e-9)


def test_an_axis_that_hardly_turns_has_no_angle_of_the_motor():
    assert any(p.along.word == "motor_angle" for p in pairs_of(10.0))
    assert not any("motor_angle" in p.name for p in pairs_of(1.0))
    names = [p.name for p in pairs_of(10.0)]
    assert len(names) == len(set(names))
