"""The blind drives: how they are drawn, that their effects have the size they claim, and how an answer is scored."""

from __future__ import annotations

import importlib
import json
import subprocess
import sys
from pathlib import Path

import pytest
import yaml

from fffo_drive.identification.dataset import load_records
from fffo_drive.identification.facts import read_facts

BENCHMARKS = Path(__file__).resolve().parents[2] / "tools" / "benchmarks"
with pytest.MonkeyPatch.context() as patch:
    patch.syspath_prepend(BENCHMARKS)
    score = importlib.import_module("blind_drives.score")

READ_BACK = """
import json, sys
from blind_drives.run import drive_from_truth
print(json.dumps(drive_from_truth(json.load(open(sys.argv[1]))).truth()))
"""


def python(*arguments):
    done = subprocess.run(
        [sys.executable, *map(str, arguments)], capture_output=True, text=True, cwd=BENCHMARKS, timeout=560
    )
    assert done.returncode == 0, done.stderr
    return done.stdout


def effect(name="cogging", in_library=True, axes=()):
    return {"name": name, "in_library": in_library, "axes": list(axes)}


def finding(name, alternatives=(), accepted=True):
    return {"name": name, "alternatives": list(alternatives), "accepted": accepted}


def truth(effects=(), seed=7):
    return {"seed": seed, "effects": list(effects)}


def scored(effects, findings, before=2.0, after=1.1, floor=1.0, seed=7, forms=()):
    report = {
        "verdict": "effects_found" if findings else "no_effect_found", "effects": findings, "seconds": 20.0,
        "friction_form": list(forms),
        "before": {"held_out": {"torque_rms_nm": before, "torque_relative_percent": 10.0 * before}},
        "after": {"held_out": {"torque_rms_nm": after, "torque_relative_percent": 10.0 * after}},
    }  # fmt: skip
    return score.score_drive(truth(effects, seed), report, floor)


@pytest.mark.parametrize(
    ("found", "total", "low", "high"),
    [(8, 10, 0.4902, 0.9433), (0, 40, 0.0, 0.0876), (40, 40, 0.9124, 1.0), (0, 0, 0.0, 1.0)],
)
def test_wilson_intervals_are_those_of_the_formula(found, total, low, high):
    share = score.wilson(found, total)
    assert (share.low, share.high) == pytest.approx((low, high), abs=1e-4)


def test_a_name_counts_as_named_and_in_the_family_and_an_alternative_in_the_family_only():
    named = scored([effect()], [finding("cogging", ["unbalance"])]).guesses[0]
    family = scored([effect()], [finding("unbalance", ["cogging"])]).guesses[0]
    wrong = scored([effect()], [finding("quadratic_drag")])
    assert (named.named, named.in_family) == (True, True)
    assert (family.named, family.in_family) == (False, True)
    assert (wrong.guesses[0].named, wrong.guesses[0].in_family) == (False, False)
    assert wrong.false_findings == ("quadratic_drag",)


def test_nothing_is_gained_by_listing_more():
    many = scored([effect()], [finding("quadratic_drag"), finding("cogging")])
    assert not many.guesses[0].in_family
    assert many.false_findings == ("quadratic_drag", "cogging")
    rejected = scored([effect()], [finding("quadratic_drag", accepted=False), finding("cogging")])
    assert rejected.guesses[0].named
    assert rejected.false_findings == ()


def test_what_a_report_doubts_is_no_claim_and_is_counted_apart():
    doubtful = {**finding("cogging"), "doubt": "it does not stand out"}
    one, free = scored([effect()], [doubtful]), scored([], [doubtful])
    assert not one.guesses[0].named
    assert (one.false_findings, one.doubted, one.doubted_truths) == ((), ("cogging",), 1)
    assert (free.false_findings, free.doubted) == ((), ("cogging",))
    assert score.summarise([one, free]).doubted_truths.found == 1
    assert score.summarise([one, free]).doubted_free.found == 1


def test_a_wave_counts_with_its_order_alone_and_strong_waves_of_many_periods_are_counted_apart():
    wave = {**effect(), "parameters": {"order": 24.0}, "share_of_coulomb": 0.2}
    faint = {**wave, "share_of_coulomb": 0.1}
    right, wrong = ({**finding("cogging"), "parameters": {"order": order}} for order in (24.05, 12.0))
    drives = [scored([wave], [right]), scored([wave], [wrong]), scored([faint], [right])]
    assert [drive.guesses[0].in_family for drive in drives] == [True, False, True]
    assert score.summarise(drives).waves[:2] == (1, 2)


def test_a_missed_effect_is_silent_where_no_rest_is_reported():
    missed = scored([effect()], [finding("quadratic_drag")])
    with_rest = score.score_drive(
        truth([effect()]),
        {
            "verdict": "nothing_carries_over", "effects": [], "seconds": 20.0, "process": {"cpu_s": 30.0},
            "unexplained_rest": {"rms_nm": 1.0},
            "before": {"held_out": {"torque_rms_nm": 2.0, "torque_relative_percent": 20.0}},
            "after": {"held_out": None},
        },
        1.0,
    )  # fmt: skip
    found = scored([effect()], [finding("cogging")])
    assert [drive.silent for drive in (missed, with_rest, found)] == [True, False, False]
    assert (missed.seconds, with_rest.seconds) == (20.0, 15.0)  # half of the processor's time, where it was taken
    assert with_rest.torque_percent == (20.0, 20.0)  # no model is offered: all is as it was
    assert score.summarise([missed, with_rest]).silent[:2] == (1, 2)


def test_a_form_of_the_friction_is_no_finding_and_is_counted_apart():
    formed = scored([], [], forms=[finding("second_surface")])
    assert (formed.false_findings, formed.forms) == ((), ("second_surface",))
    missed = scored([effect("dwell_stiction")], [], forms=[finding("dwell_stiction")])
    assert not missed.guesses[0].in_family  # nor does it say what is there
    summary = score.summarise([formed, scored([], [finding("cogging")])])
    assert (summary.false_drives[:2], summary.forms[:2]) == ((1, 2), (1, 2))


def test_two_effects_are_matched_in_any_order_and_exact_names_first():
    both = scored([effect("cogging"), effect("unbalance")], [finding("unbalance", ["cogging"]), finding("cogging")])
    assert [guess.named for guess in both.guesses] == [True, True]


def test_an_effect_of_no_library_is_right_as_unknown_on_its_axis_alone():
    odd = effect("odd_fatigue", False, ["memory", "time"])
    assert scored([odd], [finding("unknown:memory")]).guesses[0].in_family
    assert scored([odd], [finding("unknown:time")]).guesses[0].in_family
    assert not scored([odd], [finding("unknown:velocity")]).guesses[0].in_family
    assert not scored([odd], [finding("coulomb_drift")]).guesses[0].in_family


def test_removed_is_the_share_of_what_the_oracle_removes_and_only_where_something_is_to_be_removed():
    assert scored([effect()], [finding("cogging")], 2.0, 1.1, 1.0).removed == pytest.approx((4.0 - 1.21) / 3.0)
    assert scored([effect()], [finding("cogging")], 1.02, 1.0, 1.0).removed is None
    assert scored([], []).removed is None
    shares = score.removed_share(
        [scored([effect()], [finding("cogging")], 2.0, after, 1.0) for after in (1.0, 1.0, 2.0)]
    )
    assert shares.mean == pytest.approx(2 / 3)
    assert shares.low <= shares.mean <= shares.high


def test_a_set_is_counted_by_effects_and_by_drives():
    drives = [
        scored([effect()], [finding("cogging")]),
        scored([effect("unbalance")], [finding("cogging", ["unbalance"])]),
        scored([effect("odd_cable", False, ["memory"])], [finding("unknown:memory"), finding("cogging")]),
        scored([], []),
        scored([], [finding("delay")]),
    ]
    summary = score.summarise(drives)
    assert summary.named[:2] == (1, 2)
    assert summary.in_family[:2] == (2, 2)
    assert summary.unknown[:2] == (1, 1)
    assert summary.false_drives[:2] == (1, 2)
    assert summary.extra_drives[:2] == (1, 3)
    rows = {row[0]: row[1:] for row in score.confusion(drives)}
    assert rows["unbalance"] == (1, 0, "cogging (family)")
    assert rows["odd_cable"] == (1, 1, "-")


DRAWN = """
import json
from blind_drives.draw import IN_THE_BASE, effect_names, kind_of
from fffo_drive.drive.simulated.effects.registry import EFFECTS
kinds = [kind_of(seed) for seed in range(100)]
firsts = [effect_names(seed)[0] for seed in range(100) if kind_of(seed)[0]]
library = [n for n in EFFECTS if not n.startswith("odd_") and n not in IN_THE_BASE and n != "thermal_drift"]
print(json.dumps({"kinds": kinds, "firsts": firsts, "library": library}))
"""


def test_of_a_hundred_seeds_sixty_have_effects_and_all_names_come():
    drawn = json.loads(python("-c", DRAWN))
    counts = [count for count, _ in drawn["kinds"]]
    assert [counts.count(k) for k in (0, 1, 2)] == [40, 50, 10]
    assert sum(odd for _, odd in drawn["kinds"]) == 10
    known = [name for name in drawn["firsts"] if not name.startswith("odd_")]
    odd = [name for name in drawn["firsts"] if name.startswith("odd_")]
    assert len(set(odd)) == 10
    assert set(known) == set(drawn["library"])
    assert max(known.count(name) for name in drawn["library"]) <= 3


SIZES = """
import json
from dataclasses import replace
from blind_drives.draw import base_plant, chirp_current_a, gains_of, plant_draws, with_limits
from blind_drives.profiles import profiles
from blind_drives.strength import is_sound, quiet_runs, share_after_refit
from fffo_drive.drive.simulated.parameters import EffectConfig
plant = with_limits(base_plant(plant_draws(3), 3), [])
gains, asked = gains_of(plant), profiles(3, chirp_current_a(plant))
found = {}
trials = {"none": (), "small": (EffectConfig("unbalance", {"amplitude_nm": 0.005}),),
          "large": (EffectConfig("unbalance", {"amplitude_nm": 0.010}),),
          "in the base": (EffectConfig("delay", {"delay_s": 0.001}),
                          EffectConfig("presliding_shape", {"stiffness_share": 0.3}))}
for name, effects in trials.items():
    made = replace(plant, effects=effects)
    runs = quiet_runs(made, gains, asked)
    assert is_sound(runs)
    found[name] = share_after_refit(made, runs)
print(json.dumps(found))
"""


@pytest.mark.slow
@pytest.mark.timeout(600)
def test_an_effect_has_its_size_after_the_refit_and_a_change_of_the_base_has_none():
    found = json.loads(python("-c", SIZES))
    assert found["none"] < 0.01
    assert found["large"] == pytest.approx(2.0 * found["small"], rel=0.15)
    assert 0.03 < found["small"] < 0.3
    assert found["in the base"] < 0.015  # what a refit takes in is nothing that could be found


@pytest.mark.slow
@pytest.mark.timeout(600)
def test_a_generated_drive_is_logs_and_facts_with_its_truth_elsewhere(tmp_path):
    text = python(BENCHMARKS / "blind.py", "generate", "--seeds", "3", "--out", tmp_path)
    assert "1 drives" in text
    folder = tmp_path / "logs" / "0003"
    assert sorted(path.name for path in folder.iterdir()) == [
        "check.csv.gz", "drive.yaml", "identify.csv.gz", "recipe.csv.gz", "track.csv.gz",
    ]  # fmt: skip
    assert set(yaml.safe_load((folder / "drive.yaml").read_text())) == {
        "torque_constant_nm_per_a", "rated_current_a", "gear_ratio", "resolver_bits", "sample_rate_hz",
    }  # fmt: skip
    facts = read_facts(folder / "drive.yaml")
    records = load_records([folder / f"{name}.csv.gz" for name in ("identify", "track", "recipe", "check")], facts)
    assert [record.closed_loop for record in records] == [False, True, True, True]
    assert [record.begin_s for record in records] == [0.0, 75.0, 150.0, 280.0]
    assert all(not record.breaks for record in records)
    truth = json.loads((tmp_path / "truth" / "0003.json").read_text())
    assert truth["effects"] == []
    read_back = python("-c", READ_BACK, tmp_path / "truth" / "0003.json")
    assert json.loads(read_back) == truth
    # once more is the same, bit for bit, and costs nothing where it is there already
    before = {path: path.read_bytes() for path in folder.iterdir()}
    (tmp_path / "truth" / "0003.json").unlink()
    python(BENCHMARKS / "blind.py", "generate", "--seeds", "3", "--out", tmp_path)
    assert {path: path.read_bytes() for path in folder.iterdir()} == before
