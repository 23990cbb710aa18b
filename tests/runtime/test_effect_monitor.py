"""The sequential test that takes effects out of service: harm is seen, help is kept, chance is not taken for harm."""

from __future__ import annotations

import math

import numpy as np

from fffo_drive.runtime.effect_monitor import (
    EffectMonitor,
    MonitorConfig,
    MonitorState,
    Phase,
    Window,
    monitor_start,
    monitor_step,
    wants_effects,
)
from fffo_drive.signals import ROW

CONFIG = MonitorConfig()
PERIOD_S = 0.0005


def run(generator, change, windows=200, spread=0.5):
    """A monitor over windows whose squared error is `change` times as large with effects. (state, windows, verdicts)"""
    state: MonitorState = monitor_start()
    verdicts: list[str] = []
    for k in range(windows):
        with_effects = wants_effects(state)
        squared = 1e-3 * math.exp(spread * generator.standard_normal()) * (change if with_effects else 1.0)
        state, decision = monitor_step(CONFIG, state, Window(squared, with_effects, True))
        if decision.verdict:
            verdicts.append(decision.verdict)
        if state.phase is not Phase.TRIAL:
            return state, k + 1, verdicts
    return state, windows, verdicts


def test_harm_is_seen_and_help_is_kept():
    for seed in range(40):
        generator = np.random.default_rng(seed)
        worse, used, verdicts = run(generator, 4.0)
        assert worse.phase is Phase.OUT
        assert used < 2 * CONFIG.most_pairs
        assert "out of service" in verdicts[-1]
        better, _, verdicts = run(generator, 0.25)
        assert better.phase is Phase.SERVICE
        assert "stay in service" in verdicts[-1]


def test_chance_alone_hardly_ever_takes_an_effect_out():
    generator = np.random.default_rng(7)
    outcomes = [run(generator, 1.0)[0].phase for _ in range(400)]
    assert outcomes.count(Phase.OUT) <= 8  # one in a hundred is meant
    assert Phase.TRIAL not in outcomes


def test_a_grown_error_in_service_begins_another_trial():
    generator = np.random.default_rng(3)
    state, _, _ = run(generator, 0.5)
    assert state.phase is Phase.SERVICE

    def served(state, factor, windows):
        for k in range(windows):
            squared = factor * 0.5e-3 * math.exp(0.5 * generator.standard_normal())
            state, decision = monitor_step(CONFIG, state, Window(squared, True, True))
            if state.phase is not Phase.SERVICE:
                return state, k, decision
        return state, windows, decision

    state, lasted, _ = served(state, 1.0, 200)
    assert lasted == 200
    state, lasted, decision = served(state, 8.0, 200)
    assert lasted < 20
    assert state.phase is Phase.TRIAL
    assert "tried again" in decision.verdict


def test_standstill_and_windows_of_the_other_kind_do_not_count():
    state = monitor_start()
    for window in (Window(1.0, True, False), Window(1.0, False, True), Window(0.0, True, True)):
        assert monitor_step(CONFIG, state, window)[0] is state


def rows_of(monitor, samples, error_rps, first_tick=0):
    rows = np.zeros(samples, ROW)
    rows["tick"] = first_tick + np.arange(samples)
    rows["mode"] = 1
    rows["reference_rps"] = 1.0
    rows["error_rps"] = error_rps
    rows["effects"] = 1 if monitor.with_effects else 0
    return rows


def test_rows_of_a_loop_are_cut_into_windows():
    """Batches of 50 ms as a recorder sees them; the request comes through in the next one."""
    monitor = EffectMonitor(PERIOD_S)
    generator = np.random.default_rng(5)
    asked: list[bool] = []
    verdicts: list[str] = []
    for k in range(4000):
        size = 0.3 if monitor.with_effects else 0.1
        errors = size * generator.standard_normal(100)
        for decision in monitor.observe(rows_of(monitor, 100, errors, 100 * k)):
            asked.append(decision.with_effects)
            verdicts += [decision.verdict] if decision.verdict else []
        if monitor.state.phase is Phase.OUT:
            break
    assert asked[:4] == [False, True, False, True]  # with, without, without, with, with, ...
    assert monitor.state.phase is Phase.OUT
    assert not monitor.with_effects
    assert len(verdicts) == 1


def test_a_loop_at_rest_gives_no_windows():
    monitor = EffectMonitor(PERIOD_S)
    for _ in range(200):
        rows = rows_of(monitor, 100, 0.1)
        rows["mode"] = 0
        assert monitor.observe(rows) == []
    assert monitor.state == monitor_start() or math.isnan(monitor.state.pending)
    assert monitor.state.number == 0
