"""Whatever a diagnosis can find, all that use a model read: every law with every shape of its search, every curve.

Found numbers -> model file -> disk -> the kernels' table, and what `adopt`, `run` and `tune` make of the file.
"""

from __future__ import annotations

import itertools
import math
from pathlib import Path

import numpy as np
import pytest
import yaml

from fffo_drive.config.axis import model_of, read_axis
from fffo_drive.config.effects import compensation_table, services, slope_margin
from fffo_drive.control.compensation import COUNT, MOST_EFFECTS
from fffo_drive.control.stability import linear_axis
from fffo_drive.model.effects.law import SearchContext
from fffo_drive.model.effects.laws.lookup import (
    AXIS_CODES,
    BRAKE,
    FRICTION,
    PLAIN,
    RESPONSE,
    VISCOUS,
    WOUND,
    code_of,
    values_of,
)
from fffo_drive.model.effects.registry import LAWS, vector_of
from fffo_drive.model.effects.table import effect_table
from fffo_drive.model.parameters import EffectModel, Quantity, effect_errors, effect_model, read_model, write_model
from fffo_drive.workflows.adoption_gates import gates
from fffo_drive.workflows.plan import make_plan

CONFIGS = Path(__file__).resolve().parents[2] / "configs"
AXIS_FILE = CONFIGS / "axis_simulated.yaml"
BASE = model_of(AXIS_FILE, read_axis(AXIS_FILE))
CONTEXT = SearchContext(
    100.0, 5e-4, 0.02, 15.0, -20.0, 20.0, 2.0, 0.3, 0.025, 0.067, 778.0, 2.33, slow_rps=0.3, driving_a=0.1,
    gear_ratio=160.0, pole_pairs=4, slots=12, orders=(0.37, 7.3, 72.0), slow_orders=(0.11,), slow_level_orders=(0.13,),
    frequencies_hz=(3.3, 49.9),
)  # fmt: skip
NAMES = [name for name in LAWS if name != "lookup"]


def numbered(letter, numbers):
    return {f"{letter}{k:02d}": float(number) for k, number in enumerate(numbers)}


def packed(kind, knots, scale=0.0, of_current=0.0, across=None, across_scale=0.0, levels=()):
    """Shapes of a curve as a search has them, with values that all differ."""
    shapes = {"kind": kind, "scale": scale, "of_current": of_current, "count": float(len(knots))}
    if across is not None:
        shapes |= {"across": code_of(across), "across_scale": across_scale, "levels": float(len(levels))}
    shapes |= numbered("x", knots) | numbered("z", levels)
    return shapes | numbered("y", 1e-4 * np.arange(1, values_of(shapes) + 1))


def curves():
    """(name, packed): a curve over every axis of every kind, memories, a table over each pair of axes and the speed."""
    places = (0.1, 0.35, 2.0, 7.5)
    for word, kind in itertools.product(AXIS_CODES, (PLAIN, FRICTION, VISCOUS, BRAKE)):
        yield f"unknown:{word}", packed(kind, places, scale=1.0 if "angle" in word else 0.0)
    yield "unknown:memory", packed(FRICTION, places, scale=12.0)
    yield "unknown:memory", packed(FRICTION, places, scale=4.0, of_current=1.0)
    yield "unknown:memory", packed(WOUND, np.geomspace(0.05, 3.0, 12))
    yield "unknown:frequency", packed(RESPONSE, np.geomspace(0.5, 40.0, 7))
    yield "unknown:motor_angle", packed(PLAIN, np.linspace(0.0, 1.0, 24), scale=1.0)
    for first, second in itertools.permutations(AXIS_CODES, 2):
        yield f"unknown:{first}", packed(PLAIN, places, across=second, across_scale=3.0, levels=(-1.0, 0.5, 2.0))
    speeds = (0.1, 1.0, 4.0, 12.0)
    yield "unknown:motor_angle", packed(BRAKE, np.linspace(0.0, 1.0, 24), scale=1.0, across="memory", levels=speeds)


def law_values(name):
    """The law at every shape of its search, all strengths that act there at a tenth of what is typical."""
    law = LAWS[name]
    for shape in law.search(CONTEXT):
        yield {**shape, **{p.name: 0.1 * p.typical for p in law.strengths if not p.is_off(shape)}}


def of_today(name, values):
    sd = {key: 1e-5 for key in values if key in {p.name for p in LAWS.get(name, LAWS["lookup"]).strengths}}
    return effect_model(name, values, sd)


def of_0_1_0(name, values):
    """As fffo-drive 0.1.0 wrote them: only what was searched, and curves with one key a number."""
    return EffectModel(name=name, parameters={key: Quantity(value=v, source="fitted") for key, v in values.items()})


FOUND = [(name, list(law_values(name))) for name in NAMES]
CURVES = [(name, [values for other, values in curves() if other == name]) for name in dict(curves())]


@pytest.fixture
def axis_with(tmp_path):
    """An axis file of its own that names a model, its loop not judged: only what a file can be read for matters."""

    def written(model_path):
        data = yaml.safe_load(AXIS_FILE.read_text())
        data["drive"]["file"] = str(CONFIGS / data["drive"]["file"])
        data["model"] = str(model_path)
        data["controller"]["accept_unproven"] = True
        data["profile"] = {"kind": "sine", "mode": "velocity", "duration_s": 0.3, "amplitude": 2.0, "frequency_hz": 5.0}
        path = tmp_path / "axis.yaml"
        path.write_text(yaml.safe_dump(data))
        return path

    return written


@pytest.mark.parametrize("form", [of_today, of_0_1_0])
@pytest.mark.parametrize(("name", "found"), FOUND + CURVES, ids=[name for name, _ in FOUND + CURVES])
def test_a_found_effect_is_read_by_all_that_use_a_model(name, found, form, tmp_path, axis_with):
    assert found, "the search of the law tries no shape on this context"
    for number, begin in enumerate(range(0, len(found), MOST_EFFECTS)):
        some = found[begin : begin + MOST_EFFECTS]
        model = BASE.model_copy(update={"effects": [form(name, values) for values in some]})
        path = tmp_path / f"model_{number}.yaml"
        write_model(path, model)
        again = read_model(path)
        assert effect_errors(again.effects) == []
        parameters = effect_table([effect.term() for effect in again.effects], again.axis_config(), 5e-4).parameters
        for row, values, effect in zip(parameters, some, again.effects, strict=True):
            vector = vector_of(name, values)
            assert row[: len(vector)] == pytest.approx(vector, rel=1e-14, abs=0.0)
            assert (effect.curve is not None) == (name.startswith("unknown:") and form is of_today)

        axis_path = axis_with(path)
        plan = make_plan(axis_path)  # run
        compensated = [service for service in services(plan.axis, plan.model) if service.reason is None]
        assert compensation_table(plan.axis, plan.model)[COUNT] == len(compensated)
        ranges = {g.name: g for g in gates(plan.axis, BASE, again, None, None) if g.name.endswith("range")}  # adopt
        assert all(gate.passed for gate in ranges.values()), ranges
        assert math.isfinite(slope_margin(plan.axis, again, plan.profile, True).slope_nm_per_rev)
        assert linear_axis(again, plan.axis.loop.period_s).inertia_nm_s2_per_rev > 0.0  # tune


def test_a_search_tries_what_the_context_offers():
    """So that the round trip above is over something: waves of many periods, windows with and without a pitch."""
    shapes = {name: [*LAWS[name].search(CONTEXT)] for name in NAMES}
    assert {72.0, 24.0, 48.0, 0.37, 0.11} <= {shape["order"] for shape in shapes["cogging"]}
    keys = {frozenset(shape) for shape in shapes["position_dependent_friction"]}
    assert keys == {frozenset({"period_rev"}), frozenset({"centre_rev", "width_rev"}),
                    frozenset({"centre_rev", "width_rev", "pitch_rev"})}  # fmt: skip
