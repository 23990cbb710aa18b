"""The benches of the diagnosis: measured machines as logs, yardsticks of known truth, and how answers are judged.

None runs a whole diagnosis but the samples at the end; each runs as from a terminal.
"""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import pytest

BENCHMARKS = Path(__file__).resolve().parents[2] / "tools" / "benchmarks"
DATA = BENCHMARKS.parents[2] / "shared" / "data"


def python(*arguments):
    done = subprocess.run(
        [sys.executable, *map(str, arguments)], capture_output=True, text=True, cwd=BENCHMARKS, timeout=560
    )
    assert done.returncode == 0, done.stderr
    return done.stdout


def said(code):
    return json.loads(python("-c", code).splitlines()[-1])


TEXTBOOK = """
import json, pathlib, sys, tempfile
import common
from measured import OWN_BAND_HZ, cases, records_of, textbook
from measured_sets import write_all
found = {}
with tempfile.TemporaryDirectory() as folder:
    sets = pathlib.Path(folder)
    write_all(pathlib.Path(%r), sets)
    for case in cases():
        fit, held_out = records_of(case, sets)
        figures = textbook(case, fit, held_out, OWN_BAND_HZ.get(case.machine, 45.0))
        found[case.name] = {
            "percent": 100.0 * figures["left_nm"] / figures["command_nm"],
            "gaps": sum(len(record.breaks) for record in (*fit, *held_out)), "runs": len(fit),
        }
print(json.dumps(found))
"""


@pytest.mark.slow
@pytest.mark.skipif(not DATA.is_dir(), reason="needs the measured data beside the project")
def test_the_textbook_does_on_the_converted_sets_what_is_published_of_it():
    found = said(TEXTBOOK % str(DATA))
    assert len(found) == 20
    assert all(one["gaps"] == 0 for one in found.values())
    assert found["emps: DATA_EMPS -> DATA_EMPS_PULSES"]["percent"] == pytest.approx(5.98, abs=0.15)
    bam = {name: one for name, one in found.items() if name.startswith("bam")}
    assert [one["runs"] for one in bam.values()] == [8, 8]  # two gains of four trajectories
    assert sorted(one["percent"] for one in bam.values()) == pytest.approx([30.0, 34.0], abs=2.0)


RECOVERED = """
import json, pathlib
import common
import numpy as np
from rows import Textbook, needed_nm, rows_of, rms
from fffo_drive.identification.dataset import Record

def record(velocity):
    time_s = np.arange(20_000) * 1e-3
    v = velocity(time_s)
    torque = 2e-3 * np.gradient(v, 1e-3) + 3e-3 * v + 0.02 * np.tanh(v / 0.025) + 0.01
    return Record(name="made", path=pathlib.Path("made"), period_s=1e-3, torque_constant_nm_per_a=0.1,
                  current_a=torque / 0.1, position_rev=np.cumsum(v) * 1e-3, velocity_rps=None, reference_rps=None,
                  lsb_rev=1e-5, breaks=(), digest="")

both = rows_of([record(lambda t: 5.0 * np.sin(2.0 * t) * np.cos(0.3 * t))])
one_way = rows_of([record(lambda t: 3.0 + np.sin(2.0 * t))])
book = Textbook.fit(both)
print(json.dumps({"strengths": list(book.strengths), "left": rms(book.left(both)) / rms(both.torque_nm),
                  "needed": rms(needed_nm(one_way, one_way, False)), "torque": rms(one_way.torque_nm)}))
"""


def test_the_textbook_recovers_what_was_planted_and_a_one_way_axis_needs_no_more_than_its_torque():
    found = said(RECOVERED)
    assert found["strengths"] == pytest.approx([2e-3, 3e-3, 0.02, 0.01], rel=0.03)
    assert found["left"] < 0.03
    # Coulomb friction and a constant are one column there: their large opposite values would be no need of the axis
    assert found["needed"] == pytest.approx(found["torque"], rel=0.01)


DRAWN = """
import json
import common
from blind_drives import generate
from blind_drives.draw import MANY_PERIODS, ODD, ODD_AXES, _order, effect_names, kind_of
import numpy as np
draw = np.random.default_rng(1)
orders = np.array([_order(draw) for _ in range(4000)])
whole = [k for k in range(6, 73) if k not in (8, 12)]
many = np.isin(orders, whole)
real, tried = generate._calibrated, []

def reluctant(plant, gains, asked, name, draw, kinds):
    tried.append(name)
    return None if len(tried) < 3 else real(plant, gains, asked, "torque_offset", draw, kinds)

generate._calibrated = reluctant
seed = next(k for k in range(100) if kind_of(k) == (1, False))
drive = generate.make_drive(seed)
print(json.dumps({
    "octaves": [float(np.mean(many & (orders >= a) & (orders < 2 * a))) for a in (9, 18, 36)],
    "many": float(np.mean(np.isin(orders, list(MANY_PERIODS)))), "odd": [effect_names(k, ODD)[0] for k in range(10)],
    "all": sorted(ODD_AXES), "plants": drive.plants, "tried": tried, "first": effect_names(seed)[0],
}))
"""


def test_waves_of_many_periods_are_drawn_and_a_hard_name_gets_another_drive():
    found = said(DRAWN)
    assert found["many"] > 0.5
    share = 0.5 * 0.6931 / 2.98  # of an octave among whole numbers 4 to 72 with weights 1/n
    assert found["octaves"] == pytest.approx([share] * 3, rel=0.25)
    assert sorted(found["odd"]) == found["all"]
    assert found["plants"] == 3
    assert found["tried"] == [found["first"]] * 3


STRONG = """
import json
import common
from blind_drives.draw import STRONG_WAVES
from blind_drives.generate import make_drive
from blind_drives.score import _is_target_wave
drives = [make_drive(seed, kinds=STRONG_WAVES).truth() for seed in (3, 4, 5)]
print(json.dumps([[e["name"], _is_target_wave(e)] for drive in drives for e in drive["effects"]]))
"""


def test_a_set_of_strong_waves_has_one_in_every_drive_and_each_kind_in_turn():
    assert said(STRONG) == [["cogging", True], ["torque_ripple", True], ["friction_ripple", True]]


JUDGED = """
import json
import common
from blind_drives.draw import ODD_AXES
from blind_drives.left_out import SERVED_BY, judge, left_out_report

def one(names, verdict="effects_found", rest=None):
    effect = {"name": "odd_fatigue", "axes": ["memory", "time"], "parameters": {}}
    axis = {"coulomb_drift": "time"}
    effects = [{"name": name, "accepted": True, "parameters": {}, "axis": axis.get(name, name.split(":")[-1])}
               for name in names]
    return judge({"seed": 3, "effects": [effect]}, {"effects": effects, "verdict": verdict, "unexplained_rest": rest})

judged = [one(["unknown:time"]), one(["coulomb_drift"]), one(["unknown:velocity"]), one([], "unexplained"),
          one([], "no_effect_found", {"rms_nm": 1.0}), one([], "no_effect_found")]
report = left_out_report(judged, [])
print(json.dumps({"outcomes": [j.outcome for j in judged], "kinds": sorted(SERVED_BY) == sorted(ODD_AXES),
                  "on_axis": [j.on_axis for j in judged[:3]], "described": [j.described for j in judged[:3]],
                  "missed": report.missed}))
"""


def test_without_the_curve_of_its_kind_another_axis_or_a_reported_rest_is_right_and_a_law_is_wrong():
    found = said(JUDGED)
    assert found["outcomes"] == ["right axis", "wrong", "wrong", "residual reported", "residual reported", "silent"]
    assert found["kinds"]
    assert found["on_axis"] == [True, True, False]  # a drift names the time, which the effect depends on
    assert found["described"] == [True, False, False]
    assert found["missed"] == ["wrong name or axis"]


DESCRIBED = """
import json
import common
from blind_drives.left_out import describes

patch = {"name": "odd_stick_patch", "parameters": {"centre_rev": 0.98, "width_rev": 0.2, "fades_rps": 2.0}}
tooth = {"name": "odd_alternate_turns", "parameters": {"turns": 4.0, "share": 0.5}}
window = {"window_share": 0.4, "centre_rev": 0.03, "width_rev": 0.2, "pitch_rev": 1.0}
law = "position_dependent_friction"
print(json.dumps([
    describes(law, window, patch), describes(law, {**window, "centre_rev": 0.2}, patch),
    describes(law, {**window, "pitch_rev": 0.5}, patch), describes(law, {**window, "window_share": -0.4}, patch),
    describes(law, {**window, "period_rev": 1.0}, patch), describes("dwell_stiction", window, patch),
    describes(law, {"period_rev": 4.0}, tooth), describes("friction_ripple", {"order": 0.75}, tooth),
    describes("friction_ripple", {"order": 0.9}, tooth), describes(law, {"period_rev": 9.0}, tooth),
    describes(law, window, tooth), describes("cogging", {"order": 0.75}, tooth),
]))
"""


def test_a_law_describes_an_effect_outside_the_library_by_its_numbers_and_not_by_its_name():
    found = said(DESCRIBED)
    assert found == [True, False, False, False, False, False, True, True, False, False, False, False]


CALIBRATED = """
import json, pathlib, sys
import common
import numpy as np
from calibration import calibration_report, draw, planted_effect, size_z
draws = np.random.default_rng(4)
quiet = [{"first_p": p, "accepted": 0, "z": {"coulomb_nm": z}} for p, z in zip(draws.uniform(size=400),
                                                                              draws.normal(size=400))]
one = [{"effect": "cogging", "size_z": z, "z": {}} for z in draws.normal(0.0, 2.0, 400)]
report = calibration_report(quiet, one)
draw(quiet, one, pathlib.Path(sys.argv[1]))
wave = {"parameters": {"cos_nm": 0.003, "sin_nm": 0.004}, "sd": {"cos_nm": 1e-4, "sin_nm": 1e-4}}
print(json.dumps({**report.facts, "missed": report.missed, "wave": size_z(wave, "wave", 0.0048),
                  "names": sorted({planted_effect(k).name for k in range(4)})}))
"""


def test_calibration_passes_what_is_calibrated_and_catches_an_interval_that_is_half_as_long(tmp_path):
    found = json.loads(python("-c", CALIBRATED, tmp_path / "drawn.svg").splitlines()[-1])
    assert found["p <= 0.1"] == pytest.approx(0.1, abs=0.05)
    assert found["coverage: Coulomb, no effect"] == pytest.approx(0.95, abs=0.03)
    assert found["coverage: cogging"] == pytest.approx(0.673, abs=0.06)  # of a normal within 1.96/2 deviations
    assert found["missed"] == ["95 % interval contains the true value: cogging"]
    assert found["wave"] == pytest.approx(2.0)
    assert len(found["names"]) == 4
    assert (tmp_path / "drawn.svg").stat().st_size < 60_000


ABLATED = """
import json, pathlib
import common
from ablation_diagnosis import ablation_report
from drive_folders import DriveFolder

def drive(name, effects):
    truth = {"seed": 1, "effects": effects, "plant": {"friction": {"kind": "single_2sep"}}}
    return DriveFolder(name, pathlib.Path(name), truth)

def answer(names, ignored=()):
    figures = {"held_out": {"torque_rms_nm": 1.0, "torque_relative_percent": 5.0}}
    effects = [{"name": n, "alternatives": [], "accepted": True, "parameters": {}} for n in names]
    return {"verdict": "effects_found" if names else "no_effect_found", "effects": effects, "seconds": 3.0,
            "before": figures, "after": figures, "ignored": list(ignored)}

cogging = {"name": "cogging", "in_library": True, "axes": [], "parameters": {}}
drives = [drive("a", [cogging]), drive("b", [])]
report = ablation_report(drives, {"all on": [answer(["cogging"]), answer([])],
                                  "drop": [answer(["cogging"]), answer(["delay"])],
                                  "swap": [answer(["cogging"], ["swap"]), answer([])]})
print(json.dumps({**report.facts, "notes": report.notes}))
"""


def test_an_ablation_counts_the_drives_whose_answer_changes():
    found = said(ABLATED)
    assert [found[name]["changed"] for name in ("all on", "drop", "swap")] == [0, 1, 0]
    assert [found[name]["false"] for name in ("all on", "drop", "swap")] == [0, 1, 0]
    assert "swap" in found["notes"][0]  # what could not be switched off is reported


COMPARED = """
import json, pathlib
import common
from drive_folders import DriveFolder
from peers import peers_report

def ours(nm, low, rest=None):
    figures = {"torque_rms_nm": nm, "interval_95": {"torque_rms_nm": [low, 2 * nm - low]}}
    return {"verdict": "no_effect_found", "effects": [], "unexplained_rest": rest,
            "before": {"held_out": figures}, "after": {"held_out": figures}}

def theirs(*errors_nm):
    peers = {f"peer {k}": {"held_nm": nm, "terms": 5, "more": 3, "seconds": 1.0} for k, nm in enumerate(errors_nm)}
    return {"peers": {**peers, "broken": {"failure": "no", "seconds": 0.1}}, "command_nm": 10.0, "base_nm": 1.0}

drives = [DriveFolder(name, pathlib.Path(name), {"effects": []}) for name in "abc"]
said = [(ours(1.0, 0.9), theirs(0.97, 2.0)), (ours(1.0, 0.9), theirs(2.0, 0.5)),
        (ours(1.0, 0.9, {"rms_nm": 1.0}), theirs(0.5, 2.0))]
report = peers_report(drives, said)
print(json.dumps({"near": report.facts["near"], "silent": report.facts["silent"], "text": report.markdown()}))
"""


def test_a_peer_that_is_better_by_more_than_our_interval_must_be_reported():
    found = said(COMPARED)
    assert found["near"] == 1  # 1.0 is within 1.05 times 0.97
    assert found["silent"] == 1  # of the two drives with a better peer one says that something is left
    assert "peer 0 | 3.0" in found["text"]


PEERS = """
import json
import common
import numpy as np
from calibration import drive_of
from fffo_drive.drive.simulated.parameters import EffectConfig
from fffo_drive.diagnosis.diagnose import DiagnosisSettings, filter_for
from peers import OWN, peer_rows
from rows import rms

effect = EffectConfig("asymmetric_viscous", {"share": 0.4})
records, facts, plant = drive_of(5, (effect,))
s = plant.friction.single
base = {"inertia_kg_m2": plant.inertia_kg_m2, "delay_s": plant.delay_s, "sensor_delay_s": 0.0,
        "viscous_nm_per_rps": s.viscous_nm_per_rps, "coulomb_nm": s.coulomb_nm, "static_nm": s.stiction_nm,
        "stribeck_velocity_rps": s.stribeck_rps, "stribeck_exponent": s.stribeck_exponent,
        "stiffness_per_rev": s.stiffness_per_rev, "attraction_nm_per_rev": s.attraction_nm_per_rev}
filter_ = filter_for(records, facts, DiagnosisSettings())
rows = peer_rows(records, filter_, {name: [value, None] for name, value in base.items()})
speed = np.abs(rows.regressors[:, 1])
slope = float(speed @ rows.left_nm / (speed @ speed)) / s.viscous_nm_per_rps
left = rows.left_nm - slope * s.viscous_nm_per_rps * speed
print(json.dumps({"left": rms(left) / rms(rows.left_nm), "slope": slope, "columns": rows.regressors.shape[1],
                  "finite": bool(np.isfinite(rows.regressors).all())}))
"""


@pytest.mark.slow
@pytest.mark.timeout(300)
def test_the_peers_are_given_rows_that_hold_the_effect_and_hardly_anything_else():
    found = said(PEERS)
    assert found["columns"] == 66
    assert found["finite"]
    assert abs(found["slope"]) == pytest.approx(0.4, rel=0.15)
    assert found["left"] < 0.3


@pytest.mark.long
@pytest.mark.timeout(600)
@pytest.mark.skipif(not DATA.is_dir(), reason="needs the measured data beside the project")
def test_a_measured_machine_is_diagnosed_in_a_process_of_its_own():
    found = json.loads(python(BENCHMARKS / "measured.py", "--sample", "--json", "--only", "emps").splitlines()[-1])
    case = found["emps: DATA_EMPS -> DATA_EMPS_PULSES"]
    assert case["left_nm"] < 0.1 * case["command_nm"]
    assert 50.0 < case["peak_mb"] < 10_000.0
    assert case["cpu_s"] > 0.0
