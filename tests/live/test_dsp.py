"""The page's own signal processing, in a browser, beside NumPy and SciPy on the same numbers."""

from __future__ import annotations

import json

import numpy as np
import pytest
from scipy import signal

from fffo_drive.live.page import ASSETS

pytestmark = [pytest.mark.slow, pytest.mark.browser]
RATE_HZ = 2000.0
RANDOM = np.random.default_rng(7)


@pytest.fixture(scope="module")
def dsp(chromium):
    """Calls of `Dsp`: its name, then arguments; arrays become Float64Array and come back as lists."""
    tab = chromium.new_page()
    tab.add_script_tag(content=(ASSETS / "dsp.js").read_text() + "\nwindow.Dsp = Dsp;")

    def call(name, *given):
        sent = json.dumps([{"array": list(map(float, one))} if isinstance(one, np.ndarray) else one for one in given])
        return tab.evaluate(
            """([name, sent]) => JSON.parse(JSON.stringify(
              Dsp[name](...JSON.parse(sent).map((v) => (v && v.array ? Float64Array.from(v.array) : v))),
              (key, v) => (v instanceof Float64Array ? Array.from(v) : v)))""",
            [name, sent],
        )

    yield call
    tab.close()


@pytest.mark.parametrize(("kind", "name"), [("hann", "hann"), ("flattop", "flattop"), ("none", "boxcar")])
@pytest.mark.parametrize("count", [1000, 4096])
def test_a_spectrum_is_that_of_numpy(dsp, kind, name, count):
    x = RANDOM.normal(size=count) + 3.0
    found = dsp("spectrum", x, RATE_HZ, kind, False)
    weights = signal.get_window(name, count)
    padded = len(found["at"]) * 2 - 2
    expected = 2.0 * np.abs(np.fft.rfft((x - x.mean()) * weights, padded)) / weights.sum()
    np.testing.assert_allclose(found["size"][1:-1], expected[1:-1], rtol=1e-7, atol=1e-12)
    np.testing.assert_allclose(found["at"], np.fft.rfftfreq(padded, 1.0 / RATE_HZ))
    assert found["mean"] == pytest.approx(x.mean())


@pytest.mark.parametrize(("rms", "share"), [(False, 1.0), (True, np.sqrt(0.5))])
def test_a_sine_has_its_amplitude_or_its_rms_where_it_stands(dsp, rms, share):
    time_s = np.arange(8000) / RATE_HZ
    x = 0.7 * np.sin(2 * np.pi * 37.3 * time_s) + 0.2 * np.sin(2 * np.pi * 120.0 * time_s) + 5.0
    found = dsp("spectrum", x, RATE_HZ, "flattop", rms)
    peaks = dsp("peaks", found["at"], found["size"], 2, 2.0 * found["resolution"])
    assert [at for _, at in peaks] == pytest.approx([37.3, 120.0], abs=0.1)
    assert [found["size"][k] for k, _ in peaks] == pytest.approx([0.7 * share, 0.2 * share], rel=2e-3)


def test_an_order_stands_where_it_is_while_the_speed_changes(dsp):
    time_s = np.arange(8000) / RATE_HZ
    position_rev = 1.0 * time_s + 0.8 * time_s**2  # from 1 to 7.4 rps: over frequency it smears
    x = 0.3 * np.cos(2 * np.pi * 6.0 * position_rev) + 0.1 * np.cos(2 * np.pi * 17.0 * position_rev)
    turned = dsp("overPosition", x, position_rev)
    assert turned["revolutions"] == pytest.approx(position_rev[-1])
    found = dsp("spectrum", np.array(turned["x"]), turned["perRev"], "flattop", False)
    peaks = dsp("peaks", found["at"], found["size"], 2, 2.0 * found["resolution"])
    assert [at for _, at in peaks] == pytest.approx([6.0, 17.0], abs=0.03)
    assert [found["size"][k] for k, _ in peaks] == pytest.approx([0.3, 0.1], rel=0.02)


def test_the_longest_way_in_one_direction_is_taken_and_the_sensors_noise_is_no_reversal(dsp):
    way_rev = np.concatenate((np.linspace(0, 1, 500), np.linspace(1, -4, 2500), np.linspace(-4, -3, 500)))
    noisy = way_rev + RANDOM.normal(scale=1e-3, size=way_rev.size)
    turned = dsp("overPosition", np.cos(2 * np.pi * 3 * way_rev), noisy)
    assert turned["revolutions"] == pytest.approx(5.0, abs=0.01)
    found = dsp("spectrum", np.array(turned["x"]), turned["perRev"], "hann", False)
    ((_, at),) = dsp("peaks", found["at"], found["size"], 1, 1.0)
    assert at == pytest.approx(3.0, abs=0.05)


def test_coherence_and_phase_are_those_of_scipy(dsp):
    x = RANDOM.normal(size=20_000)
    y = signal.lfilter(*signal.butter(2, 0.2), x) + 0.3 * RANDOM.normal(size=x.size)
    found = dsp("crossSpectrum", x, y, RATE_HZ, 1024)
    at, coherence = signal.coherence(x, y, RATE_HZ, nperseg=1024)
    _, cross = signal.csd(x, y, RATE_HZ, nperseg=1024)
    np.testing.assert_allclose(found["at"], at)
    np.testing.assert_allclose(found["coherence"][1:-1], coherence[1:-1], rtol=1e-6)
    np.testing.assert_allclose(found["phase"][1:-1], np.degrees(np.angle(cross))[1:-1], atol=1e-6)


def test_two_unrelated_signals_have_no_phase(dsp):
    alike = []
    for _ in range(5):
        found = dsp("crossSpectrum", RANDOM.normal(size=9216), RANDOM.normal(size=9216), RATE_HZ, 2048)
        alike += [value >= found["needed"] for value in found["coherence"][1:-1]]
    assert np.mean(alike) < 0.004  # 0.001 is asked for
    assert not dsp("lag", RANDOM.normal(size=4000), RANDOM.normal(size=4000), 500)["clear"]


@pytest.mark.parametrize("delay_ticks", [0.0, 3.0, 7.5, -4.25, 40.0])
def test_a_lag_is_found_between_the_samples(dsp, delay_ticks):
    ticks = np.arange(4000.0)

    def wave(at):
        return sum(np.sin(2 * np.pi * f * at / RATE_HZ + f) for f in (1.3, 3.1, 7.7, 19.0))

    found = dsp("lag", wave(ticks), wave(ticks - delay_ticks), 500)
    assert found["samples"] == pytest.approx(delay_ticks, abs=0.1)
    assert found["clear"]


@pytest.mark.parametrize("damping", [0.3, 0.5, 0.9])
def test_figures_of_a_step_are_those_of_a_second_order_system(dsp, damping):
    natural, height = 40.0, 2.0
    time_s = np.arange(-0.25, 1.0, 1.0 / RATE_HZ)
    after = np.maximum(time_s, 0.0)
    system = signal.lti([natural**2], [1.0, 2 * damping * natural, natural**2])
    fine_s = np.arange(0.0, 1.0, 1e-5)
    _, fine = signal.step(system, T=fine_s)
    response = 1.0 + height * np.interp(after, fine_s, fine)
    reference = np.where(time_s >= 0.0, 1.0 + height, 1.0)
    found = dsp("step", list(time_s), list(reference), list(response), 0.0, 0.02)
    assert found["overshoot"] == pytest.approx(100 * np.exp(-np.pi * damping / np.sqrt(1 - damping**2)), abs=0.1)
    rise_s = fine_s[np.argmax(fine >= 0.9)] - fine_s[np.argmax(fine >= 0.1)]
    assert found["rise"] == pytest.approx(rise_s, abs=1.0 / RATE_HZ)
    settled_s = fine_s[np.flatnonzero(np.abs(fine - 1.0) > 0.02)[-1]]
    assert found["settling"] == pytest.approx(settled_s, abs=2.0 / RATE_HZ)


def test_what_is_no_step_is_said_in_words(dsp):
    time_s = np.arange(-0.5, 0.5, 1.0 / RATE_HZ)
    step, still = np.where(time_s >= 0.0, 2.0, 0.0), np.zeros(time_s.size)

    def problem(reference, response):
        return dsp("step", list(time_s), list(reference), list(response), 0.0, 0.02).get("problem", "")

    assert "no step" in problem(still + 3.0, step)
    assert "does not follow" in problem(step, still)
    assert "before the step" in problem(np.sin(9 * time_s) + step, step)
    assert "at the end" in problem(np.where(time_s > 0.45, 0.0, step), step)
    assert problem(step, step) == ""
    assert dsp("step", list(time_s), list(step), list(step + 0.3 * (time_s > 0.499)), 0.0, 0.02)["settling"] is None


def test_missing_ticks_are_filled_in_and_counted(dsp):
    ticks, values = [10, 11, 14, 15], [0.0, 1.0, 4.0, 5.0]
    even, filled = dsp("evenly", ticks, values)
    assert even == [0.0, 1.0, 2.0, 3.0, 4.0, 5.0]
    assert filled == 2
