"""A control law of a user's own: the loop's own law written again gives its currents, and its rows are replayed."""

from __future__ import annotations

import math
import os
import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pytest

import fffo_drive as fd
from fffo_drive.config.axis import loop_axis
from fffo_drive.control.stability import loop_margins
from fffo_drive.documents import DocumentError
from fffo_drive.jit import njit

CONFIGS = Path(__file__).resolve().parents[2] / "configs"
AXIS = CONFIGS / "axis_simulated.yaml"
SHORT = {"kind": "paper", "duration_s": 4, "seed": 3}
PLAIN = {  # the paper's PI with inertia forward
    "controller.error_filter_s": 0.0,
    "controller.at_rest": {"gain_share": 1.0, "release_friction": False},
    "controller.observer.toggle": "off",
}


class Gains(NamedTuple):
    proportional_a_per_rps: float
    integral_a_per_rev: float
    inertia_nm_s2_per_rev: float


class Memory(NamedTuple):
    integral_a: float


def pi_step(config: Gains, state: Memory, seen: fd.LawInput) -> tuple[float, Memory]:
    """PI with the inertia's torque of the reference."""
    integral_a = state.integral_a
    if not seen.limited:
        integral_a += config.integral_a_per_rev * seen.error_rps * seen.period_s
    forward_a = config.inertia_nm_s2_per_rev * seen.ahead_rps2 / seen.torque_constant_nm_per_a
    return config.proportional_a_per_rps * seen.error_rps + integral_a + forward_a, Memory(integral_a)


COMPILED = njit(pi_step)


def law(compiled: bool, **changes: Any) -> fd.ControlLaw:
    axis = fd.read_axis(AXIS)
    section = axis.file.controller
    inertia = axis.model.axis_config().inertia_nm_s2_per_rev
    gains = Gains(section.proportional_a_per_rps, section.integral_a_per_rev, inertia)
    return fd.ControlLaw("my pi", gains, Memory(0.0), COMPILED if compiled else pi_step).change(**changes)


@pytest.fixture(scope="module")
def plain():
    return fd.read_axis(AXIS).change(PLAIN)


def test_the_loops_own_pi_written_again_gives_its_velocities(plain):
    """To rounding: the loop's own law adds its terms in another order."""
    own = fd.simulate(plain, toggle="off", profile=SHORT, seed=1)
    again = fd.simulate(plain, toggle="off", profile=SHORT, seed=1, controller=law(compiled=True))
    active = own["profile_sample"] >= 0
    assert np.abs(own["requested_a"] - again["requested_a"])[active].max() < 0.05
    assert again.metrics.shaft.ise == pytest.approx(own.metrics.shaft.ise, rel=0.02)


def test_at_the_speed_of_python_and_compiled_the_rows_are_the_same(plain):
    runs = [fd.simulate(plain, profile=SHORT, seed=1, controller=law(compiled)) for compiled in (True, False)]
    for name in ("requested_a", "limited_a", "current_command_a", "velocity_rps"):
        assert np.array_equal(runs[0][name], runs[1][name])
    softer = fd.simulate(plain, profile=SHORT, seed=1, controller=law(True, proportional_a_per_rps=0.4))
    assert softer.metrics.measured.ise > runs[0].metrics.measured.ise


class Anything(NamedTuple):
    limit_a: float


def test_a_state_at_the_speed_of_python_is_any_object_and_begins_anew_in_each_run():
    seen = []

    def step(config, state, now):
        seen.append(state)
        return config.limit_a, [*state, now.reference_rps][-2:]

    counted = fd.ControlLaw("list", Anything(0.0), [], step)
    for _ in range(2):
        fd.simulate(AXIS, profile=SHORT, controller=counted)
    assert seen.count([]) == 2


def test_the_envelope_stands_behind_the_law():
    """A constant current above the limit: cut, and stopped by the envelope when the axis runs away."""
    constant = fd.ControlLaw("runaway", Anything(1e3), Memory(0.0), lambda config, state, now: (config.limit_a, state))
    run = fd.simulate(AXIS, profile=SHORT, controller=constant)
    limit_a = fd.read_axis(AXIS).file.controller.current_limit_a
    assert run["requested_a"].max() == 1e3
    assert run["limited_a"].max() <= limit_a
    assert run.fault is not None


def test_what_a_step_raises_stops_the_axis_and_is_raised_here():
    def step(config, state, now):
        return config.limit_a / now.reference_rps2 / 0.0, state

    with pytest.raises(DocumentError, match="controller 'broken': step raised ZeroDivisionError"):
        fd.simulate(AXIS, profile=SHORT, controller=fd.ControlLaw("broken", Anything(1.0), Memory(0.0), step))


@pytest.mark.parametrize(
    ("config", "state", "said"),
    [
        ((1.0,), Memory(0.0), "config: tuple where a NamedTuple"),
        (Anything(math.nan), Memory(0.0), "config: limit_a is not a finite number"),
        (Anything("fast"), Memory(0.0), "config: a NamedTuple of numbers is needed"),
        (Anything(1.0), 0.0, "at_rest: float where a NamedTuple"),
    ],
)
def test_a_law_that_cannot_be_packed_is_refused(config, state, said):
    with pytest.raises(DocumentError, match=f"controller 'x': {said}"):
        fd.ControlLaw("x", config, state, COMPILED)


def test_a_bare_function_is_no_law():
    with pytest.raises(DocumentError, match=r"controller: a function where a fd.ControlLaw"):
        fd.simulate(AXIS, profile=SHORT, controller=pi_step)
    with pytest.raises(DocumentError, match="controller: a function where"):
        fd.margins(AXIS, pi_step)


def test_laws_at_the_speed_of_python_keep_their_states_apart_in_threads(plain):
    laws = [law(compiled=False, proportional_a_per_rps=gain) for gain in (0.4, 0.6, 0.8)]

    def ise(one):
        return fd.simulate(plain, profile=SHORT, seed=1, controller=one).metrics.shaft.ise

    with ThreadPoolExecutor(3) as pool:
        assert list(pool.map(ise, laws)) == [ise(one) for one in laws]


def test_a_step_that_does_not_compile_is_an_error_of_the_argument():
    @njit
    def step(config, state, seen):
        return [seen.error_rps], state

    with pytest.raises(DocumentError, match="controller 'x': step does not compile"):
        fd.simulate(AXIS, profile=SHORT, controller=fd.ControlLaw("x", Anything(1.0), Memory(0.0), step))
    with pytest.raises(DocumentError, match="config has no 'limit': did you mean 'limit_a'"):
        fd.ControlLaw("x", Anything(1.0), Memory(0.0), step).change(limit=2.0)


def test_a_recorded_run_of_an_own_law_is_replayed_bit_for_bit_with_its_recorded_config(plain, tmp_path):
    run = fd.run(AXIS, tmp_path / "own.mcap", profile=SHORT, controller=law(True, proportional_a_per_rps=0.5))
    report = fd.replay(run, controller=law(compiled=True))
    assert report.rows > 7000
    assert report.exact
    with pytest.raises(DocumentError, match=r"recorded with the control law 'my pi' of .*give it, as fd.replay\(run"):
        fd.replay(run)
    assert not fd.replay(run, instead=AXIS).exact


def test_margins_of_a_pi_are_those_of_the_formula():
    axis = fd.read_axis(AXIS)
    section = axis.file.controller
    gains = section.proportional_a_per_rps, section.integral_a_per_rev
    linear = loop_axis(axis.file, axis.model)._replace(error_filter_s=0.0, notches=(), estimator=None)
    expected = loop_margins(linear, *gains, 0.0)
    for compiled in (True, False):
        found = fd.margins(axis, law(compiled))
        assert found.phase_deg == pytest.approx(expected.phase_deg, abs=0.5)
        assert found.gain == pytest.approx(expected.gain, rel=0.03)
        assert found.crossover_hz == pytest.approx(expected.crossover_hz, rel=0.01)
    assert fd.margins(axis).phase_deg > 0.0


def test_an_own_law_is_a_row_of_an_evaluation(tmp_path):
    path = tmp_path / "scenario.yaml"
    path.write_text(
        f"format: fffo_drive/scenario/1\nname: own\naxis: {AXIS}\nseeds: 2\nreference: {{kind: paper, duration_s: 2}}\n"
        'controllers: {pi: {toggle: "off"}}\n'
    )
    found = fd.evaluate(path, workers=1, laws=[law(True), replace(law(True, proportional_a_per_rps=0.3), name="soft")])
    assert found.controllers == ("pi", "my pi", "soft")
    assert found.figure("measured.ise", "soft") > found.figure("measured.ise", "my pi")
    with pytest.raises(DocumentError, match="two controllers are called 'my pi'"):
        fd.evaluate(path, laws=[law(True), law(False)])


def test_a_drive_on_a_bus_is_not_run_with_a_law_that_is_slow_or_without_margins(tmp_path):
    axis, out = CONFIGS / "axis_canopen.yaml", tmp_path / "own.mcap"
    with pytest.raises(DocumentError, match="controller 'my pi': a drive needs it compiled: put @njit"):
        fd.run(axis, out, controller=law(compiled=False), uncommissioned=True)
    with pytest.raises(DocumentError, match=r"controller 'my pi': its margins are -?\d.* below phase_margin_deg"):
        fd.run(axis, out, controller=law(True, proportional_a_per_rps=9.0), uncommissioned=True)
    assert not out.exists()


LAW_SCRIPT = """
import hashlib
from typing import NamedTuple
import numpy as np
import fffo_drive as fd
from fffo_drive.jit import njit

class Gain(NamedTuple):
    gain: KIND

class Nothing(NamedTuple):
    memory: float

@njit
def step(config, state, seen):
    return config.gain * seen.error_rps, state

LAW = fd.ControlLaw("p", Gain(0.75), Nothing(0.0), step)

def asked_a():
    run = fd.simulate(AXIS, profile=np.full(200, 0.5), seed=1, controller=LAW)
    return float(np.abs(run["requested_a"]).max())

if __name__ == "__main__":
    print(asked_a())
"""


def test_a_law_is_the_same_as_a_script_and_as_a_module_and_an_edit_is_not_taken_from_the_cache(tmp_path):
    def said(kind, *words):
        (tmp_path / "p_law.py").write_text(LAW_SCRIPT.replace("KIND", kind).replace("AXIS", repr(str(AXIS))))
        root = str(CONFIGS.parent)
        environment = dict(os.environ, PYTHONPATH=os.pathsep.join([str(tmp_path), root]))
        done = subprocess.run([sys.executable, *words], cwd=tmp_path, env=environment, capture_output=True, text=True)
        assert done.returncode == 0, done.stderr
        return float(done.stdout)

    script, module = ("p_law.py",), ("-c", "import p_law; print(p_law.asked_a())")
    first = said("float", *script)
    assert first > 0.1
    assert said("float", *module) == first
    assert said("int", *script) == 0.0  # a gain of whole numbers
