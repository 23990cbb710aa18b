"""The sequential test that takes effects out of service: harm is seen, help is kept, chance is not taken for harm."""

from __future__ import annotations

import math

import numpy as np

from fffo_drive.runtime.effect_monitor import (
    EffectMonitor,
    MonitorConfig,
    Phase,
    Window,
    monitor_start,
    monitor_step,
    sentence,
)
from fffo_drive.signals import ROW

CONFIG = MonitorConfig()
PERIOD_S = 0.0005


def run(generator, changes, windows=400, spread=0.5):
    """A monitor over windows; effect k makes the squared error `changes[k]` times as large. (state, windows, verdicts)

    Ends when the trials are over.
    """
    state = monitor_start((1 << len(changes)) - 1)
    verdicts = []
    for number in range(windows):
        squared = 1e-3 * math.exp(spread * generator.standard_normal())
        for k, change in enumerate(changes):
            squared *= change if state.wanted >> k & 1 else 1.0
        state, decision = monitor_step(CONFIG, state, Window(squared, state.wanted, True))
        if decision.verdict is not None:
            verdicts.append(decision.verdict)
        assert decision.effects == state.wanted
        if state.phase is not Phase.TRIAL:
            return state, number + 1, verdicts
    return state, windows, verdicts


def test_harm_is_seen_and_help_is_kept():
    for seed in range(40):
        generator = np.random.default_rng(seed)
        worse, used, verdicts = run(generator, [4.0])
        assert (worse.phase, worse.wanted) == (Phase.OUT, 0)
        assert used < 2 * CONFIG.most_pairs
        assert verdicts[-1].worse
        assert "cogging taken out of service: squared tracking error +" in sentence(verdicts[-1], ["cogging"])
        better, _, verdicts = run(generator, [0.25])
        assert (better.phase, better.wanted) == (Phase.SERVICE, 1)
        assert "cogging in service: squared tracking error -" in sentence(verdicts[-1], ["cogging"])


def test_chance_alone_hardly_ever_takes_an_effect_out():
    generator = np.random.default_rng(7)
    outcomes = [run(generator, [1.0])[0].phase for _ in range(400)]
    assert outcomes.count(Phase.OUT) <= 8  # one in a hundred is meant
    assert Phase.TRIAL not in outcomes


def test_of_several_effects_the_wrong_one_is_taken_out():
    """Whether together they do harm or not."""
    for seed in range(20):
        generator = np.random.default_rng(seed)
        state, _, verdicts = run(generator, [0.1, 3.0, 0.5])  # together better
        assert state.wanted == 0b101
        assert [v.effects for v in verdicts if v.worse] == [0b010]
        state, _, verdicts = run(generator, [0.4, 30.0])  # together worse: all out first
        assert verdicts[0].worse
        assert verdicts[0].effects == 0b11
        assert state.wanted == 0b01
        assert run(generator, [5.0, 6.0])[0].phase is Phase.OUT


def test_a_grown_error_in_service_begins_another_trial():
    generator = np.random.default_rng(3)
    state, _, _ = run(generator, [0.5, 0.5])
    assert state.wanted == 0b11

    def served(state, factor, windows):
        for k in range(windows):
            squared = factor * 0.25e-3 * math.exp(0.5 * generator.standard_normal())
            state, decision = monitor_step(CONFIG, state, Window(squared, 0b11, True))
            if state.phase is not Phase.SERVICE:
                return state, k, decision
        return state, windows, decision

    state, lasted, _ = served(state, 1.0, 200)
    assert lasted == 200
    state, lasted, decision = served(state, 8.0, 200)
    assert lasted < 20
    assert state.phase is Phase.TRIAL
    assert sentence(decision.verdict, ["a", "b"]) == "tracking error has grown: a, b tried again"


def test_what_was_taken_out_is_not_tried_again():
    state, _, _ = run(np.random.default_rng(2), [0.1, 5.0])
    assert state.wanted == 0b01
    for _ in range(100):
        state, decision = monitor_step(CONFIG, state, Window(10.0, state.wanted, True))
        assert not decision.effects & 0b10


def test_standstill_and_windows_of_the_other_kind_do_not_count():
    state = monitor_start()
    for window in (Window(1.0, 1, False), Window(1.0, 0, True), Window(0.0, 1, True)):
        assert monitor_step(CONFIG, state, window)[0] is state


def rows_of(monitor, samples, error_rps, first_tick=0):
    rows = np.zeros(samples, ROW)
    rows["tick"] = first_tick + np.arange(samples)
    rows["mode"] = 1
    rows["reference_rps"] = 1.0
    rows["error_rps"] = error_rps
    rows["effects"] = monitor.effects
    return rows


def test_rows_of_a_loop_are_cut_into_windows():
    """Batches of 50 ms as a recorder sees them; the request comes through in the next one."""
    monitor = EffectMonitor(PERIOD_S, ["cogging"])
    generator = np.random.default_rng(5)
    asked: list[int] = []
    verdicts: list[str] = []
    for k in range(4000):
        size = 0.3 if monitor.effects else 0.1
        errors = size * generator.standard_normal(100)
        for decision in monitor.observe(rows_of(monitor, 100, errors, 100 * k)):
            asked.append(decision.effects)
            verdicts += [monitor.sentence(decision.verdict)] if decision.verdict is not None else []
        if monitor.state.phase is Phase.OUT:
            break
    assert asked[:4] == [0, 1, 0, 1]  # with, without, without, with, with, ...
    assert monitor.state.phase is Phase.OUT
    assert monitor.effects == 0
    assert len(verdicts) == 1


def test_a_loop_at_rest_gives_no_windows():
    monitor = EffectMonitor(PERIOD_S)
    before = monitor.state
    for _ in range(200):
        rows = rows_of(monitor, 100, 0.1)
        rows["mode"] = 0
        assert monitor.observe(rows) == []
    assert monitor.state is before
