"""Decimation keeps what the eye would see; the encoding keeps numbers."""

import base64

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from fffo_drive.report.decimation import decimate, decimated_abscissa, thinned
from fffo_drive.report.encoding import MISSING, SHORT, encode
from fffo_drive.report.figures import Series, Uniform

samples = arrays(
    np.float64,
    st.integers(1, 400),
    elements=st.one_of(st.floats(-1e6, 1e6), st.just(float("nan"))),
)


@given(samples, st.integers(4, 60))
def test_extremes_of_every_bucket_are_kept_and_nothing_is_made_up(y, most):
    points, bucket = decimate(y, most)
    assert points.size <= max(most, 4)
    if bucket == 1:
        np.testing.assert_array_equal(points, y)
        return
    for number, begin in enumerate(range(0, y.size, bucket)):
        part = y[begin : begin + bucket]
        pair = points[2 * number : 2 * number + 2]
        if np.isnan(part).all():
            assert np.isnan(pair).all()
        else:
            assert pair.min() == np.nanmin(part)
            assert pair.max() == np.nanmax(part)


@given(samples, st.integers(4, 60))
def test_points_stand_in_the_order_and_near_the_place_of_their_samples(y, most):
    points, bucket = decimate(y, most)
    x = decimated_abscissa(Uniform(10.0, 0.5), bucket).values(points.size)
    assert (np.diff(x) > 0).all()
    for place, value in zip(x, points, strict=True):
        if not np.isnan(value):
            found = 10.0 + 0.5 * np.flatnonzero(y == value)
            assert np.abs(found - place).min() <= 0.5 * bucket
    if bucket > 1:
        for number in range(points.size // 2):
            part = y[number * bucket : (number + 1) * bucket]
            first, second = points[2 * number], points[2 * number + 1]
            if not np.isnan(first):
                assert np.flatnonzero(part == first)[0] <= np.flatnonzero(part == second)[-1]


def test_a_curve_in_the_plane_is_thinned_and_bars_are_not():
    angle = np.linspace(0.0, 6.0, 1000)
    curve = Series("loop", np.cos(angle), np.sin(angle), "blue")
    x, y, stride = thinned(curve, 100)
    assert stride == 10
    np.testing.assert_allclose(np.asarray(x) ** 2 + y**2, 1.0)
    bars = Series("bars", np.arange(50.0), np.arange(50.0), "blue", "bars")
    assert thinned(bars, 10)[1].size == 50


def decode(encoded):
    """Inverse of `encode`, as the page's script computes it."""
    if "f4" in encoded:
        return np.frombuffer(base64.b64decode(encoded["f4"]), "<f4").astype(np.float64)
    steps = np.frombuffer(base64.b64decode(encoded["i2"]), "<i2").astype(np.float64)
    return np.where(steps == MISSING, np.nan, steps * encoded["scale"] + encoded["offset"])


@given(samples)
def test_short_records_are_float32(y):
    encoded = encode(y)
    assert set(encoded) == {"f4"}
    np.testing.assert_array_equal(decode(encoded), y.astype(np.float32).astype(np.float64))


@pytest.mark.parametrize(("low", "high"), [(-1.0, 1.0), (1e-9, 3e-9), (1e6, 1e6 + 1), (-5e4, 0.0)])
def test_long_records_keep_every_sample_to_a_step_of_their_range(low, high):
    y = np.random.default_rng(0).uniform(low, high, SHORT + 1000)
    y[[7, 70]] = np.nan
    y[100], y[200] = low, high
    encoded = encode(y)
    assert set(encoded) == {"i2", "scale", "offset"}
    back = decode(encoded)
    np.testing.assert_array_equal(np.isnan(back), np.isnan(y))
    step = (high - low) / 65534
    assert np.nanmax(np.abs(back - y)) <= 0.5 * step * (1 + 1e-6)
    assert back[100] == pytest.approx(low, abs=1e-9 * abs(low) + 1e-12 * step)
    assert back[200] == pytest.approx(high, abs=1e-9 * abs(high) + 1e-12 * step)


def test_a_long_constant_record_is_encoded_too():
    np.testing.assert_array_equal(decode(encode(np.full(SHORT + 1, 2.5))), 2.5)
    assert np.isnan(decode(encode(np.full(SHORT + 1, np.nan)))).all()
