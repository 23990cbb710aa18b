"""A law fitted to a plant that shares no line with it: the numbers of the effect come out as they were put in."""

from functools import cache

import numpy as np
import pytest
from diagnosis.test_tables import FACTS, axis_with
from identification.synthetic import PERIOD_S
from scipy import signal

from fffo_drive.diagnosis.current_side import LEAST_SHARE, shortage, shown_share
from fffo_drive.diagnosis.fitting import polished
from fffo_drive.diagnosis.screening import screen, search_context
from fffo_drive.diagnosis.selection import beside, evidence_of
from fffo_drive.drive.simulated.parameters import EffectConfig

# what the plant is given, and what the law has to find of it: (value, relative error)
PLANTED = {
    "coulomb_drift": ({"share": 0.6, "time_constant_s": 30.0}, {"share": (0.6, 0.06), "tau_s": (30.0, 0.06)}),
    "elasticity": (
        {"load_share": 0.4, "frequency_hz": 25.0, "damping": 0.06},
        {"share": (0.4, 0.04), "frequency_hz": (25.0, 0.02), "damping": (0.06, 0.1)},
    ),
    "dead_zone": ({"width_a": 0.2}, {"width_a": (0.2, 0.03), "lost_nm": (0.2 * 0.148, 0.03)}),
    "torque_ripple": ({"share": 0.15, "order": 6.0}, {"size": (0.15, 0.03), "order": (6.0, 0.001)}),
    "current_lag": ({"time_constant_s": 0.007}, {"share": (1.0, 0.15), "tau_s": (0.007, 0.05)}),
    "position_dependent_friction": (
        {"period_rev": 22.0, "wave_share": 0.4, "window_share": 0.0},
        {"size": (0.4, 0.05), "period_rev": (22.0, 0.01)},
    ),
    "friction_ripple": ({"share": 0.5, "order": 8.0}, {"size": (0.5, 0.06), "order": (8.0, 0.001)}),
}


@cache
def fitted(planted, name):
    """(data, fit with this law) on a plant with an effect in it, at the best place of the law's own search."""
    data, base, matrix = axis_with(EffectConfig(planted, PLANTED[planted][0]))
    evidence, scenes = evidence_of(data, matrix, base)
    context = search_context(data.rows, scenes, base.physical, base.residual_nm, FACTS)
    trials = screen(evidence, scenes, context, False, 0.01, names={name}).trials
    return data, polished(data, beside(data, matrix, base, trials[0])), base


@pytest.mark.slow
@pytest.mark.parametrize("name", PLANTED)
def test_the_numbers_of_an_effect_are_found_as_they_were_put_in(name):
    _, found, base = fitted(name, name)
    effect = found.effects[0]
    values = effect.values(0) | ({"size": effect.sizes()[0]} if effect.waves else {})
    for parameter, (truth, tolerance) in PLANTED[name][1].items():
        assert values[parameter] == pytest.approx(truth, rel=tolerance), parameter
    assert found.loss < 0.4 * base.loss


def measured(data, tau_s):
    """The same data with a current that was measured a sample late, behind a lag."""
    draw = np.random.default_rng(8)
    keep = np.exp(-PERIOD_S / tau_s) if tau_s > 0.0 else 0.0
    found = []
    for stretch in data.stretches:
        lagged = signal.lfilter([1.0 - keep], [1.0, -keep], np.concatenate([[0.0], stretch.current_a[:-1]]))
        found.append(stretch._replace(measured_a=lagged + 0.01 * draw.normal(size=lagged.size)))
    return data._replace(stretches=found)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("planted", "tau_s", "low", "high"), [("current_lag", 0.007, 0.9, 1.0), ("elasticity", 0.0, -np.inf, 0.1)]
)
def test_a_lag_is_believed_where_the_measured_current_shows_it_however_much_a_delay_looks_like_it(
    planted, tau_s, low, high
):
    data, found, _ = fitted(planted, "current_lag")
    data = measured(data, tau_s)
    short = shortage(data)
    assert short is not None
    assert short.rows_nm.shape == (short.delays_s.size, data.rows.time_s.size)
    assert low < shown_share(data, short, found, found.effects[0]) < high
    assert not low < LEAST_SHARE < high


@pytest.mark.slow
def test_without_a_measured_current_nothing_is_said_of_it():
    assert shortage(fitted("current_lag", "current_lag")[0]) is None
