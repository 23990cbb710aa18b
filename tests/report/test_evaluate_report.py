"""The report of runs that are not whole: what was skipped is said, and nothing is drawn of what is not there."""

from types import SimpleNamespace

import numpy as np
import pytest

from fffo_drive.cli.evaluate import print_summary
from fffo_drive.documents import DocumentError
from fffo_drive.evaluation.campaign import evaluation_of
from fffo_drive.evaluation.measures import Yardstick
from fffo_drive.evaluation.summary import summarise
from fffo_drive.evaluation.trace import trace_of
from fffo_drive.recording.run_records import RecordKind, RunRecord
from fffo_drive.recording.writer import RunWriter
from fffo_drive.report.document import provenance
from fffo_drive.report.evaluate import EvaluationSource, evaluation_report
from fffo_drive.report.page import render_page
from fffo_drive.signals import ROW
from fffo_drive.workflows import evaluate_live

PERIOD_S = 5e-4
SAMPLES = 4000
WINDOWS_S = ((0.5, 0.7), (1.8, 2.0))
YARDSTICK = Yardstick((0.0, 0.5, 1000.0), np.linspace(-0.4, 0.4, 81))


def rows_of(kept, error_rps):
    rows = np.zeros(len(kept), ROW)
    rows["profile_sample"] = kept
    rows["reference_rps"] = np.sin(4.0 * np.pi * PERIOD_S * np.asarray(kept))
    rows["velocity_rps"] = rows["reference_rps"] + error_rps
    rows["true_velocity_rps"] = np.nan
    return rows


def run(name, kept, error_rps, seed=1):
    return evaluation_of(
        name, seed, [trace_of(rows_of(kept, error_rps), PERIOD_S)], YARDSTICK, WINDOWS_S if seed == 1 else ()
    )


def report_of(*runs, published=frozenset()):
    source = EvaluationSource("title", "subtitle", YARDSTICK, [], provenance([], {}), published)
    return evaluation_report(source, summarise(runs), runs)


def test_a_loop_that_came_too_late_and_a_run_that_stopped_early_are_drawn_and_said():
    late = run("pi", [n for n in range(SAMPLES) if n % 10 != 5], 0.02)
    early = run("pi+fffo", list(range(3000)), 0.01)
    report = report_of(late, early)
    assert "pi, seed 1: the loop skipped 10 % of the ticks." in report.verdict.cautions
    assert not any("pi+fffo, seed 1" in text for text in report.verdict.cautions)
    drawn = {figure.title: figure for section in report.sections for figure in section.figures}
    assert [s.name for s in drawn["From 0.5 s"].series] == ["reference", "pi", "pi+fffo"]
    assert [s.name for s in drawn["From 1.8 s"].series] == ["reference", "pi"]
    assert drawn["From 1.8 s"].series[1].y.size == 400
    assert "the loop skipped 10 %" in render_page(report)


def test_runs_of_one_controller_with_two_models_are_two(monkeypatch):
    def recorded(names):
        effects = {"new": ["cogging"]}
        model_of = {name: SimpleNamespace(name=name, effects=effects.get(name, ())) for _, name in names}
        monkeypatch.setattr(evaluate_live, "recorded_files", lambda run: (None, model_of[run.model]))
        monkeypatch.setattr(evaluate_live, "controller_name", lambda run: run.controller)
        return evaluate_live.controller_names(
            [SimpleNamespace(controller=name, model=model, metadata={}) for name, model in names]
        )

    assert recorded([("pi", "old"), ("pi+", "old"), ("pi+", "new")]) == ["pi", "pi+, before", "pi+, after"]
    assert recorded([("pi", "new"), ("pi", "old"), ("pi", "old")]) == ["after", "before", "before"]
    assert recorded([("pi", "old"), ("pi", "other")]) == ["pi, old", "pi, other"]
    assert recorded([("pi", "old"), ("pi", "old")]) == ["pi", "pi"]


def cells_of(report, table):
    """Texts of the cells of a table by controller."""
    found = next(one for one in report.tables if one.name == table)
    return {row.label: [cell.text for cell in row.cells] for row in found.rows}


def test_a_run_without_a_reversal_says_so_in_the_cells_of_reversals():
    report = report_of(*(run(name, range(300), 0.01) for name in ("pi", "pi+fffo")))  # until 0.15 s: one direction
    lags, bands = cells_of(report, "lag"), cells_of(report, "bands")
    assert lags["pi"][:2] == ["no reversal", "no reversal"]
    assert bands["pi"][0] == "no reversal"
    assert "no reversal" in render_page(report)


def test_a_percentile_of_a_single_reversal_is_none():
    report = report_of(*(run(name, range(700), 1e-3) for name in ("pi", "pi+fffo")))  # until 0.35 s: one at 0.25 s
    mean, percentile, missed = cells_of(report, "lag")["pi"]
    assert float(mean) < 1.0
    assert percentile == "1 reversal"
    assert float(missed) == 0.0


def test_a_controller_that_missed_every_reversal_says_so_and_the_other_that_the_runs_cannot_be_compared():
    stuck = run("pi", range(SAMPLES), 5.0)  # its velocity never changes sign
    report = report_of(stuck, run("pi+fffo", range(SAMPLES), 0.0))
    lags = cells_of(report, "lag")
    assert lags["pi"][:2] == ["all missed"] * 2
    assert lags["pi+fffo"][:2] == ["not in every run"] * 2


def test_a_band_that_the_reference_never_reaches_says_so():
    wide = YARDSTICK._replace(band_edges_rps=(0.0, 0.5, 50.0, 1000.0))
    runs = [evaluation_of(name, 1, [trace_of(rows_of(range(SAMPLES), 0.01), PERIOD_S)], wide, ()) for name in "ab"]
    source = EvaluationSource("title", "subtitle", wide, [], provenance([], {}))
    report = evaluation_report(source, summarise(runs), runs)
    assert cells_of(report, "bands")["a"][-1] == "not reached"


def test_no_cell_is_empty_and_a_single_seed_is_said_where_intervals_would_stand():
    report = report_of(*(run(name, range(300), 0.01) for name in ("pi", "pi+fffo")))
    for table in report.tables:
        if table.name != "table-2":
            assert all(cell.text.strip("–") for row in table.rows for cell in row.cells), table.name
    for name in ("lag", "bands", "metrics-measured"):
        assert "one seed: no intervals" in next(one for one in report.tables if one.name == name).note


def test_runs_that_are_whole_have_no_such_caution():
    report = report_of(run("pi", list(range(SAMPLES)), 0.02), run("pi+fffo", list(range(SAMPLES)), 0.01))
    assert not any("too late" in text for text in report.verdict.cautions)


def recorded(path, runs, sizes=(SAMPLES,), **metadata):
    """A recording in which profiles ran one after the other: `runs` of the kept samples."""
    writer = RunWriter(path, {"period_s": str(PERIOD_S), **metadata}, [], 0)
    for number, size in enumerate(sizes, 1):
        writer.write_record(RunRecord(0, number, number, RecordKind.PROFILE, ("samples",), (float(size),)), 0)
    for number, kept in enumerate(runs, 1):
        rows = rows_of(kept, 0.01)
        rows["profile_number"] = number
        rows["deadline_ns"] = 500_000 * np.arange(rows.size)
        writer.write_rows(rows)
    return str(writer.close())


def test_a_recording_that_stops_before_its_profile_does_is_named(tmp_path):
    early = recorded(tmp_path / "early.mcap", [range(SAMPLES // 2)], candidate="early")
    whole = recorded(tmp_path / "whole.mcap", [range(SAMPLES)], candidate="whole")
    _, evaluations, cautions = evaluate_live.evaluate_recordings([early, whole], None)
    assert cautions == ["early.mcap: it ended after 50 % of its profile."]
    assert [e.candidate for e in evaluations] == ["early", "whole"]
    assert evaluations[1].measures.measured.error.mae == pytest.approx(0.01)


def test_a_recording_of_two_profiles_is_refused_and_one_of_which_only_one_ran_is_not(tmp_path):
    two = recorded(tmp_path / "two.mcap", [range(100), range(100)], (100, 100))
    with pytest.raises(DocumentError, match=r"two.mcap: contains more than one profile"):
        evaluate_live.evaluate_recordings([two], None)
    one = recorded(tmp_path / "one.mcap", [range(SAMPLES)], (SAMPLES, 77))
    assert evaluate_live.evaluate_recordings([one], None)[2] == []


def test_seeds_that_do_not_decide_between_the_best_two_ask_for_more_seeds():
    def verdict_of(best_rps):
        errors = {"pi": (0.010, 0.014, 0.012), "pi+fffo": best_rps}
        runs = [run(name, range(SAMPLES), rps, k) for name, own in errors.items() for k, rps in enumerate(own, 1)]
        return report_of(*runs).verdict

    open_ = verdict_of((0.012, 0.011, 0.0125))
    assert (open_.confidence, open_.next_step) == ("cannot tell", "run more seeds")
    assert "do not decide between" in open_.lines[-1].text
    assert verdict_of((0.002, 0.003, 0.002)).next_step == "use it"


def test_a_published_law_that_is_best_is_not_for_an_axis_file():
    errors = {"dob+": (0.002, 0.003, 0.002), "pi": (0.010, 0.014, 0.012)}
    runs = [run(name, range(SAMPLES), rps, k) for name, own in errors.items() for k, rps in enumerate(own, 1)]
    verdict = report_of(*runs, published=frozenset({"dob+"})).verdict
    assert (verdict.finding, verdict.next_step) == ("dob+ is best", "compare")
    assert verdict.lines[-1].text.endswith("The best of the scenario's own controllers is pi.")


def test_the_page_judges_by_the_measured_velocity_and_names_the_shafts():
    report = report_of(run("before", range(SAMPLES), 0.02), run("after", range(SAMPLES), 0.01))
    assert report.verdict.headline.startswith("after has the smallest squared error against measured velocity: 2")
    assert report.verdict.reasons[0] == "ISE against measured velocity: after < before."
    assert all("true velocity" not in table.title for table in report.tables)


def test_a_table_in_a_pipe_keeps_its_digits_however_long_a_name_is(capsys, monkeypatch):
    monkeypatch.delenv("COLUMNS", raising=False)
    name = "pi with a name of a hundred letters" * 3
    print_summary(summarise([run(name, range(SAMPLES), 0.0123), run("pi", range(SAMPLES), 0.02)]))
    printed = capsys.readouterr().out
    line = next(line.strip() for line in printed.splitlines() if line.strip().startswith(name))
    assert "…" not in printed
    assert float(line.removeprefix(name).split()[2]) == pytest.approx(0.0123, rel=0.01)
