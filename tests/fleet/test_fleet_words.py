"""The opening of a fleet's page in each state that a fleet can be in: what it says is what was found."""

from __future__ import annotations

import numpy as np
import pytest

from fffo_drive.fleet.detector import BURN_IN
from fffo_drive.fleet.regress import PARAMETERS
from fffo_drive.fleet.report import FleetSource, fleet_report
from fffo_drive.fleet.spread import LEAST_DRIVES, ModelSpread, Outsider
from fffo_drive.fleet.store import StoreStatus
from fffo_drive.fleet.watch import Alarm, Undecided, Watched
from fffo_drive.report.document import MOST_LINES

RATE = 0.01


def spread(drives, runs, outsiders=()):
    names = tuple(f"SN{k}" for k in range(drives))
    shape = drives, len(PARAMETERS)
    return ModelSpread(
        "M1",
        "rotary",
        names,
        np.full(drives, runs),
        np.zeros(drives),
        np.zeros(drives),
        tuple(PARAMETERS),
        np.ones(shape),
        np.full(shape, 0.01),
        (),
        tuple(outsiders),
    )


def far(drive):
    return Outsider(drive, "coulomb_nm", 0.03, 0.001, 0.02, 7.0)


def alarm(drive):
    return Alarm(
        drive,
        "Coulomb friction",
        (),
        0.1,
        (0.08, 0.12),
        "its size before",
        0.002,
        "coulomb_nm",
        0,
        "a" * 64,
        1.77e9,
        ("a" * 64, "b" * 64),
        "c" * 64,
        1.78e9,
        ("a" * 64, "b" * 64),
    )


def page(own, alarms=(), doubts=(), status=None, laws=("viscous friction", "Coulomb friction")):
    logged = len(own.drives) if "viscous friction" in laws else 0
    watched = Watched(tuple(alarms), tuple(doubts), len(own.drives), int(own.runs.sum()), 1.0, RATE, laws, logged)
    done = status or StoreStatus(*([0] * len(StoreStatus._fields)))
    return fleet_report(FleetSource("store", done, [own], {}, {"M1": watched}))


def said(report):
    verdict = report.verdict
    return verdict.finding, verdict.confidence, verdict.next_step


def status(**given):
    return StoreStatus(**{name: given.get(name, 0) for name in StoreStatus._fields})


ENOUGH = LEAST_DRIVES, BURN_IN + 1


def test_nothing_was_found_and_that_is_not_certain():
    report = page(spread(*ENOUGH))
    assert said(report) == ("none outside, none changed", "probable", "nothing to do")
    assert f"changed: at most {RATE:g} false alarms per drive and year" in report.verdict.reasons


def test_an_outlier():
    report = page(spread(*ENOUGH, [far("SN1")]))
    assert said(report) == ("1 outside", "probable", "diagnose the runs of those outside")
    assert [line.label for line in report.verdict.lines] == ["SN1"]
    assert not report.verdict.alarm


def test_eleven_changes_are_all_on_the_page():
    report = page(spread(12, BURN_IN + 1), [alarm(f"SN{k}") for k in range(11)])
    assert said(report) == ("11 changed", "probable", "diagnose the runs of those changed")
    assert report.verdict.alarm
    assert "none outside of the population, 11 changed in its own history" in report.verdict.headline
    assert len(report.verdict.lines) == MOST_LINES
    assert report.verdict.lines[-1].text == f"{11 - MOST_LINES + 1} more, in the tables below"
    table = next(table for table in report.tables if table.name == "moved")
    assert {row.label for row in table.rows} == {f"SN{k}" for k in range(11)}


def test_both_and_a_drive_that_changed_twice_is_one_drive():
    report = page(spread(*ENOUGH, [far("SN1"), far("SN2")]), [alarm("SN3"), alarm("SN3")])
    assert said(report) == ("2 outside and 1 changed", "probable", "diagnose the runs of those outside and changed")


@pytest.mark.parametrize(
    ("drives", "runs", "caution"),
    [
        (LEAST_DRIVES - 1, BURN_IN + 1, f"fewer than {LEAST_DRIVES} drives make no population: M1"),
        (LEAST_DRIVES, BURN_IN, f"no drive has more than {BURN_IN} runs, so no change can be found: M1"),
    ],
)
def test_what_could_not_be_judged_is_told(drives, runs, caution):
    report = page(spread(drives, runs))
    assert said(report) == ("none outside, none changed", "cannot tell", "nothing to do")
    assert report.verdict.cautions == [caution]


def test_too_little_to_judge_anything():
    report = page(spread(1, 1))
    assert said(report) == ("too little data", "cannot tell", "add drives and runs")
    assert "too few drives and runs to judge any" in report.verdict.headline


@pytest.mark.parametrize(
    ("counts", "step"),
    [
        ({"runs": 10, "recorded": 7, "failed": 3}, "see why runs make no record (`fleet status`)"),
        ({"runs": 10, "recorded": 7}, "make the missing records (`fleet work`)"),
    ],
)
def test_runs_without_a_record_are_no_proof_that_nothing_is_there(counts, step):
    report = page(spread(*ENOUGH), status=status(**counts))
    assert said(report) == ("none outside, none changed", "cannot tell", step)
    (caution,) = report.verdict.cautions
    assert "runs have no record yet" in caution


def test_records_that_cannot_decide_are_counted():
    report = page(spread(*ENOUGH), doubts=[Undecided("SN2", "warmer than ever")])
    assert said(report)[1] == "cannot tell"
    assert "the records of 1 drive cannot decide" in report.verdict.cautions[0]


def test_without_a_temperature_no_change_is_no_proof_that_there_is_none():
    report = page(spread(*ENOUGH), laws=("Coulomb friction",))
    assert said(report) == ("none outside, none changed", "cannot tell", "nothing to do")
    (caution,) = report.verdict.cautions
    assert caution.startswith("no temperature is logged: viscous friction is not watched, a change of Coulomb friction")
