"""The comparison of two processors notices what it is for: another name, another number, something missing."""

import pytest
from numerics.compare import compared, differences
from numerics.jobs import DETERMINED, JOBS, NOISE, ROUNDED

JOB = "recover current_lag"
ANSWER = {"found": {"share": 0.9, "tau_s": 0.007}, "names": ["current_lag"], "zero": 0.0, "none": None}


def failures(plain):
    return compared({JOB: ANSWER}, {JOB: plain})[1]


@pytest.mark.parametrize(
    "change",
    [
        {"found": {"share": 0.9 * (1.0 + 2.0 * DETERMINED), "tau_s": 0.007}},
        {"found": {"share": 0.9}},
        {"found": {"share": float("nan"), "tau_s": 0.007}},
        {"names": ["delay"]},
        {"names": []},
        {"zero": 1e-9},
        {"none": 1.0},
        {"more": 1.0},
    ],
)
def test_what_differs_is_reported_by_its_key_and_both_values(change):
    found = failures(ANSWER | change)
    assert found[0] == f"{JOB}: 1 differ by more than {DETERMINED:.0e}"
    assert next(iter(change)) in found[1]
    assert "here" in found[1]
    assert "plain" in found[1]


def test_last_digits_are_no_difference():
    share, tau_s = ANSWER["found"].values()
    assert failures(ANSWER | {"zero": 1e-17, "found": {"share": share * (1.0 + 1e-12), "tau_s": tau_s}}) == []
    assert list(differences(ANSWER, ANSWER)) == []


def test_only_what_a_processor_simulates_itself_may_differ_by_noise():
    assert {job.tolerance for name, job in JOBS.items() if "own run" in name} == {NOISE}
    assert max(job.tolerance for name, job in JOBS.items() if "own run" not in name) < 1e-4 < NOISE
    assert min(job.tolerance for job in JOBS.values()) == ROUNDED
