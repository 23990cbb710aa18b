"""The rest is never silent: nothing is said of noise, and the right axis of what a residual still depends on."""

import re
from functools import cache

import numpy as np
import pytest
import sklearn.ensemble  # noqa: F401  # before the limit of its threads: what is loaded later has none
from diagnosis.planted import NOISE_NM, based, left, nothing, planted, runs
from diagnosis.small_axis import FACTS as SMALL_AXIS
from diagnosis.small_axis import there_and_back
from scipy import signal
from threadpoolctl import threadpool_limits

from fffo_drive.diagnosis import rest as rest_module
from fffo_drive.diagnosis.fitting import with_levels
from fffo_drive.diagnosis.rest import LARGE_SHARE, REPORTED_RATIO, refused_rest, rest_of
from fffo_drive.diagnosis.results import Ceiling
from fffo_drive.diagnosis.scenes import Effect

NO_CEILING = Ceiling(None, None, None, None, "no part of the reference was repeated")
CLOCK_S = 0.73
SIZE_NM = 1.5 * NOISE_NM


@pytest.fixture(autouse=True)
def _one_thread():
    """Threads of the trees spin for each other on a machine that is shared."""
    with threadpool_limits(1):
        yield


@cache
def axis(count=3):
    """(data, base) of runs without an effect."""
    return based(runs(*[nothing] * count, duration_s=10.0))


NEEDED_NM = 1.0  # so much that no rest is a large share of it


def rest(make, count=3, ceiling=NO_CEILING, needed_nm=NEEDED_NM):
    """What is said of a residual to which `make(rows)` was added."""
    data, base = axis(count)
    return rest_of(data, left(data, base, make(data.rows)), ceiling, needed_nm)


def velocity(rows):
    return SIZE_NM * np.sign(np.sin(rows.velocity_rps / 1.3))


def angle(rows):
    return SIZE_NM * np.sign(np.sin(2.0 * np.pi * rows.position_rev)) * (np.abs(rows.velocity_rps) < 15.0)


def clock(rows):
    return 4.0 * SIZE_NM * (np.mod(rows.time_s, CLOCK_S) < 0.06)


@pytest.mark.parametrize("count", [1, 3])
def test_nothing_is_said_of_noise(count):
    assert rest(lambda rows: 0.0 * rows.time_s, count) is None
    draw = np.random.default_rng(3)
    assert rest(lambda rows: NOISE_NM * draw.normal(size=rows.time_s.size), count) is None


@pytest.mark.parametrize(("make", "axis_word"), [(velocity, "velocity"), (angle, "motor_angle")])
def test_what_a_residual_depends_on_is_reported_with_its_axis(make, axis_word):
    found = rest(make)
    assert axis_word in found.axes
    assert axis_word.replace("_", " ") in found.sentence
    assert found.rms_nm > REPORTED_RATIO * found.floor_nm
    assert found.floor_nm == pytest.approx(np.sqrt(np.mean(axis()[1].residual_nm[axis()[0].used] ** 2)), rel=0.35)
    assert found.repeats_share is None


def test_what_drifts_within_each_run_is_reported_over_time():
    """Of one run: blocks of it are kept from the trees, not whole runs, or time would never come again."""
    found = rest(lambda rows: 1.5 * SIZE_NM * np.sin(2.0 * np.pi * rows.time_s / 9.0), count=1)
    assert "time" in found.axes


def test_a_friction_in_a_band_of_speeds_is_reported_that_one_run_alone_reaches():
    """Its class of speeds counts it as noise, and the other runs have no such speeds."""
    peaks_a = (0.5, 0.5, 1.2)
    records = [planted(seed=k, peak_a=peak, begin_s=20.0 * k) for k, peak in enumerate(peaks_a)]
    data, base = based(records)
    speed, run = np.abs(data.rows.velocity_rps), data.rows.run
    band = speed > speed[run < 2].max()
    assert 0.02 < band.mean() < 0.3
    spoiled = left(data, base, 8.0 * NOISE_NM * np.sign(data.rows.velocity_rps) * band)
    found = rest_of(with_levels(data, spoiled), spoiled, NO_CEILING, NEEDED_NM)
    assert "velocity" in found.axes
    assert found.rms_nm > 1.5 * found.floor_nm


def test_a_disturbance_with_a_clock_of_its_own_is_reported_with_its_period():
    found = rest(clock, count=1)
    assert found.axes == ("a clock of its own",)
    words = re.search(r"a period of ([\d.]+) s", found.sentence)
    assert float(words.group(1)) == pytest.approx(CLOCK_S, rel=0.01)


def test_a_clock_that_goes_on_from_run_to_run_is_reported_as_well():
    assert "a clock of its own" in rest(clock).axes


@pytest.mark.parametrize(("period_s", "axis_word"), [(2.0, "the cycle of the motion"), (CLOCK_S, "a clock of its own")])
def test_what_comes_with_the_cycle_of_a_repeated_motion_has_no_clock_of_its_own(period_s, axis_word):
    """There and back every 2 s, and a push with that period, at the end of the way back, or another."""
    data, base = based(there_and_back(2.0), SMALL_AXIS)
    push_nm = 0.006 * (np.mod(data.rows.time_s - 1.9, period_s) < 0.06)
    found = rest_of(data, left(data, base, push_nm), NO_CEILING, NEEDED_NM)
    assert found.axes[0] == axis_word


def test_what_repeats_is_reported_where_no_feature_says_it():
    """Eighty per cent come again with the command, and trees know nothing of that."""
    draw = np.random.default_rng(4)
    data, _ = axis()
    noise = NOISE_NM * draw.normal(size=data.rows.time_s.size)
    found = rest(lambda rows: noise, ceiling=Ceiling(0.8, 0.8, 1e-3, None, "10 s"))
    assert found.floor_nm == pytest.approx(found.rms_nm * np.sqrt(0.2), rel=1e-6)
    assert found.repeats_share == 0.8
    assert rest(lambda rows: noise, ceiling=Ceiling(0.1, 0.1, 1e-3, None, "10 s")) is None


def test_the_sentence_says_how_much_and_how_large():
    found = rest(velocity)
    share = 100.0 * (1.0 - (found.floor_nm / found.rms_nm) ** 2)
    assert found.sentence.startswith(f"{share:.0f} %")
    assert f"{found.rms_nm:.3g}" in found.sentence


def wandering(rows):
    """A torque of 0.5 Hz and less that goes with nothing."""
    draw = np.random.default_rng(8).normal(size=rows.time_s.size)
    slow = signal.sosfilt(signal.butter(2, 0.5, fs=1.0 / rows.filter.row_period_s, output="sos"), draw)
    return 4.0 * NOISE_NM * slow / slow.std()


def at_times(rows):
    """A drag that acts seven seconds in every 31."""
    return 3e-4 * rows.velocity_rps * (np.mod(rows.time_s, 31.0) < 7.0)


@pytest.mark.parametrize("make", [wandering, at_times])
def test_what_is_large_and_smooth_is_unexplained_whether_or_not_something_predicts_it(make, monkeypatch):
    monkeypatch.setattr(rest_module, "_trees", lambda features, target, group, names: (0.0 * target, ()))
    data, base = axis()
    rms = float(np.sqrt(np.mean(left(data, base, make(data.rows)).residual_nm[data.used] ** 2)))
    found = rest(make, needed_nm=rms / (1.01 * LARGE_SHARE))
    assert found.sentence.startswith("5 % of the torque is smooth and unexplained")
    assert found.axes == ()
    assert found.floor_nm < 0.8 * found.rms_nm
    assert rest(make, needed_nm=rms / (0.99 * LARGE_SHARE)) is None


def test_what_is_large_and_knows_nothing_of_its_own_past_is_noise():
    draw = np.random.default_rng(5)
    noise = 5.0 * NOISE_NM * draw.normal(size=axis()[0].rows.time_s.size)
    assert rest(lambda rows: noise, needed_nm=10.0 * NOISE_NM) is None


def test_what_effects_explain_that_do_not_carry_over_is_left():
    data, base = axis()
    spoiled = left(data, base, 3.0 * NOISE_NM * np.ones(data.rows.time_s.size))
    wave = Effect("cogging", {"order": 5.0}, {"cos_nm": np.array([1e-3]), "sin_nm": np.zeros(1)})
    found = refused_rest(data, spoiled, base._replace(effects=(wave,)))
    rms = [float(np.sqrt(np.mean(one.residual_nm[data.used] ** 2))) for one in (spoiled, base)]
    assert (found.rms_nm, found.floor_nm) == pytest.approx(tuple(rms))
    assert found.share == pytest.approx(1.0 - (rms[1] / rms[0]) ** 2)
    assert "the fitted runs alone" in found.sentence
    assert found.sentence.endswith("it depends on motor angle")
    assert refused_rest(data, base, base) is None
