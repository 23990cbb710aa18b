"""Runs looked at one by one: what each determines, and what they say against each other."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from identification.balance import BOTH_WAYS, COULOMB, INERTIA, VISCOUS, balance_record

from fffo_drive.identification.runs import PARAMETERS, look_at_runs

OFFSET = 0.004
TRUTH = dict(zip(PARAMETERS, (INERTIA, VISCOUS, COULOMB, OFFSET), strict=True))
OTHER_WAYS = ((5.0, 0.23, 1.0), (2.0, 1.1, 0.0), (0.6, 3.9, 2.0))
SLOWER = ((3.0, 0.41, 0.5), (1.5, 1.7, 0.0), (0.5, 5.3, 1.0))
ONE_WAY = ((2.0, 0.31, 0.0), (0.8, 2.3, 1.0))


def constant(time_s, position_rev, velocity_rps):
    return OFFSET + 0.0 * time_s


def kinds(look):
    return [remark.kind for remark in look.remarks]


def test_a_run_that_moves_both_ways_determines_all_four():
    look = look_at_runs([balance_record("a", load=constant), balance_record("b", sines=OTHER_WAYS, load=constant)])
    assert look.remarks == ()
    assert look.delay_s == pytest.approx(0.0, abs=2e-4)
    for run in look.runs:
        assert not run.turns_one_way
        for name, estimate in run.estimates.items():
            assert estimate.determined, name
            assert abs(estimate.value - TRUTH[name]) < max(5.0 * estimate.sd, 0.01 * COULOMB), name
            assert estimate.sd < 0.02 * COULOMB


def test_a_run_that_turns_one_way_does_not_separate_friction_from_a_constant_torque():
    runs = [balance_record(name, mean, ONE_WAY, load=constant) for name, mean in (("a", 4.0), ("b", 6.0))]
    look = look_at_runs(runs)
    for run in look.runs:
        assert run.turns_one_way
        assert not run.estimates["coulomb_nm"].determined
        assert not run.estimates["offset_nm"].determined
        assert run.estimates["inertia_nm_s2_per_rev"].determined
        assert run.estimates["inertia_nm_s2_per_rev"].value == pytest.approx(INERTIA, rel=0.01)
    (remark,) = look.remarks
    assert remark.kind == "confounded"
    assert remark.parameters == ("coulomb_nm", "offset_nm")
    assert "the other way" in remark.text


def test_runs_that_each_turn_one_way_make_direction_and_run_one_thing():
    look = look_at_runs([balance_record("up", 4.0, ONE_WAY), balance_record("down", -4.0, ONE_WAY)])
    assert kinds(look) == ["confounded"]
    assert "every run goes one way only" in look.remarks[0].text
    both = look_at_runs([balance_record("up", 4.0, ONE_WAY), balance_record("both")])
    assert both.remarks == ()


def test_constant_speed_determines_neither_inertia_nor_viscous_friction():
    look = look_at_runs([balance_record("steady", 5.0, ((0.02, 1.0, 0.0),))])
    estimates = look.runs[0].estimates
    assert not any(estimates[name].determined for name in ("viscous_nm_per_rps", "coulomb_nm", "offset_nm"))
    assert {"viscous_nm_per_rps", "inertia_nm_s2_per_rev"} <= {p for r in look.remarks for p in r.parameters}
    still = look_at_runs([balance_record("steady", 5.0, ((0.02, 1.0, 0.0),)), balance_record("both")])
    assert "confounded" not in kinds(still)
    assert still.runs[1].estimates["viscous_nm_per_rps"].determined


def test_a_payload_that_changed_between_runs_is_a_contradiction():
    heavy = balance_record("heavy", sines=SLOWER, inertia=1.34 * INERTIA)
    look = look_at_runs([balance_record("light"), balance_record("also light", sines=OTHER_WAYS), heavy])
    (remark,) = look.remarks
    assert remark.kind == "contradiction"
    assert remark.parameters == ("inertia_nm_s2_per_rev",)
    assert "heavy" in remark.runs
    ratio = [run.estimates["inertia_nm_s2_per_rev"].value / INERTIA for run in look.runs]
    assert ratio == pytest.approx([1.0, 1.0, 1.34], rel=0.01)


def test_coulomb_friction_that_falls_from_run_to_run_is_a_drift():
    motions = (BOTH_WAYS, OTHER_WAYS, SLOWER, ((4.0, 0.37, 0.2), (1.0, 1.9, 0.0)))
    runs = [
        balance_record(f"r{k}", sines=sines, coulomb=COULOMB * (1.0 - 0.07 * k), begin_s=40.0 * k, seed=k)
        for k, sines in enumerate(motions)
    ]
    look = look_at_runs([runs[2], runs[0], runs[3], runs[1]])
    (remark,) = look.remarks
    assert (remark.kind, remark.parameters) == ("drift", ("coulomb_nm",))
    assert remark.runs == ("r0", "r1", "r2", "r3")  # over the clock of the log, not in the order given
    no_clock = look_at_runs([replace(run, begin_s=0.0) for run in runs])
    assert kinds(no_clock) == ["contradiction"]
    again = look_at_runs([*runs, balance_record("r4", coulomb=COULOMB, begin_s=160.0, sines=SLOWER, seed=9)])
    assert "drift" not in kinds(again)  # it came back


def test_one_reference_twice_is_a_repeat():
    reference = np.sin(np.arange(60_000) * 1e-3)
    runs = [replace(balance_record(name, seed=k), reference_rps=reference) for k, name in enumerate("ab")]
    (remark,) = look_at_runs(runs).remarks
    assert (remark.kind, remark.runs) == ("repeated_reference", ("a", "b"))
    steady = [replace(run, reference_rps=np.ones(60_000)) for run in runs]
    assert look_at_runs(steady).remarks == ()  # a steady reference is no evidence of a repeat


def test_no_remarks_without_a_reason():
    """Twenty sets of three runs of one axis: nothing is said of any."""
    said = [
        remark
        for seed in range(20)
        for remark in look_at_runs([
            balance_record(f"r{k}", sines=sines, begin_s=40.0 * k, seed=100 * seed + k, duration_s=12.0)
            for k, sines in enumerate((BOTH_WAYS, OTHER_WAYS, SLOWER))
        ]).remarks
    ]  # fmt: skip
    assert said == []
