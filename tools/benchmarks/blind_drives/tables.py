"""The tables of the blind drives: figures against what they must reach, confusions, and every drive by itself."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from common import Report
from engine import accepted_of

from .score import Scored, Share, Summary, confusion, summarise

IN_FAMILY = {"single_2sep": 0.90, "five_surfaces": 0.80}
WAVES = 0.95
MOST_FALSE = 1
USUAL_S, SLOWEST_S = 15.0, 30.0  # of two cores
MOST_MB = 1000.0
KINDS = {"single_2sep": "the paper's single surface", "five_surfaces": "five surfaces"}


def blind_report(name: str, purpose: str, sets: Mapping[str, Sequence[Scored]]) -> Report:
    """One report over sets of drives by the kind of their base friction."""
    report = Report(name, purpose)
    for kind, scored in sets.items():
        _figures(report, kind, summarise(scored), scored)
    for scored in sets.values():
        report.table(
            ["true effect", "drives", "right", "else"],
            [[f"`{n}`", str(total), str(right), other] for n, total, right, other in confusion(scored)],
        )
    for scored in sets.values():
        report.table(
            ["drive", "in it", "said", "besides", "held-out torque error", "removed", "verdict"],
            [_drive(one) for one in sorted(scored, key=lambda one: (not one.has_effects, one.seed))],
        )
    return report


def _figures(report: Report, kind: str, summary: Summary, scored: Sequence[Scored]) -> None:
    effected = sum(one.has_effects for one in scored)
    label = f"{KINDS[kind]} ({effected} drives with effects, {len(scored) - effected} without)"

    def share(what: str, value: Share, least: float | None = None) -> None:
        met = None if least is None or not value.total else value.value >= least
        report.bounded(f"{label}: {what}", str(value), met, "" if least is None else f">= {100 * least:.0f} %")
        report.facts[f"{KINDS[kind]}: {what}"] = value.value

    def count(what: str, value: Share, most: int | None = None) -> None:
        met = None if most is None else value.found <= most
        report.bounded(f"{label}: {what}", str(value), met, "" if most is None else f"<= {most}")
        report.facts[f"{KINDS[kind]}: {what}"] = value.found

    share("named first", summary.named)
    share("first or in the family", summary.in_family, IN_FAMILY[kind])
    share("waves of 12 to 72 periods a turn at 15 % of Fc and more: first or in the family", summary.waves, WAVES)
    share("outside the library: `unknown:` on the right axis", summary.unknown)
    report.bounded(f"{label}: held-out squared error removed, of what an oracle removes", str(summary.removed))
    report.facts[f"{KINDS[kind]}: removed"] = summary.removed.mean
    count("effect-free drives with a finding", summary.false_drives, MOST_FALSE)
    count("effect-free drives whose friction is reported to be of another form than one surface", summary.forms)
    count("effect-free drives called unexplained", summary.unexplained_free)
    count("drives with an effect that is not named, and no residual reported", summary.silent, 0)
    count("drives with a finding besides the true effects", summary.extra_drives)
    count("true effects that the report names but puts in doubt", summary.doubted_truths)
    count("effect-free drives with a finding in doubt", summary.doubted_free)
    count("drives with effects whose held-out error is larger after", summary.worse_drives)
    report.figure(f"{label}: median processor time, over two cores", summary.median_s, "s", USUAL_S)
    report.figure(f"{label}: longest processor time, over two cores", summary.slowest_s, "s", SLOWEST_S)
    report.figure(f"{label}: most memory, of a fresh process", summary.peak_mb, "MB", MOST_MB)


def _drive(one: Scored) -> list[str]:
    truth = ", ".join(f"`{guess.name}`" for guess in one.guesses) or "nothing"
    said = ", ".join(f"{guess.said}{_mark(guess)}" for guess in one.guesses)
    matched = {guess.said for guess in one.guesses}
    false = [name for name in one.false_findings if name not in matched or not one.has_effects]
    beside = ", ".join([*false, *(f"{name}?" for name in one.doubted)]) or "-"
    before, after = one.torque_percent
    removed = "-" if one.removed is None else f"{100 * one.removed:.0f} %"
    return [str(one.seed), truth, said or "-", beside, f"{before:.2f} to {after:.2f} %", removed, one.verdict]


def _mark(guess: Any) -> str:
    if guess.named or (guess.in_family and not guess.in_library):
        return " ✓"
    return " (family)" if guess.in_family else " ✗"


def drives_report(name: str, purpose: str, reports: Mapping[str, Mapping[str, Any]]) -> Report:
    """Findings on drives whose truth is unknown."""
    report = Report(name, purpose)
    rows = []
    for drive, found in reports.items():
        accepted = accepted_of(found)
        before, after = found["before"]["held_out"], found["after"]["held_out"]
        rows.append([
            drive,
            found["verdict"].replace("_", " "),
            "; ".join(_effect(effect) for effect in accepted) or "-",
            f"{before['torque_relative_percent']:.2f} to {after['torque_relative_percent']:.2f} %",
            _interval(after, "torque_relative_percent", "%"),
            f"{before['velocity_rms_rps']:.4f} to {after['velocity_rms_rps']:.4f} rps",
            f"{found['seconds']:.0f} s",
            _cost(found),
        ])  # fmt: skip
    header = [
        "drive",
        "verdict",
        "found",
        "held-out torque error",
        "95 % of it, after",
        "held-out velocity error",
        "time",
        "fresh process: wall, CPU, memory",
    ]
    report.table(header, rows)
    report.figure("slowest", max(found["seconds"] for found in reports.values()), "s", SLOWEST_S)
    report.notes.append("Times are by the wall clock; the load at the end shows how busy the machine was.")
    return report


def _effect(effect: Mapping[str, Any]) -> str:
    family = "".join(f" or `{name}`" for name in effect["alternatives"])
    if "curve" in effect:
        numbers = f"a curve of {len(effect['curve']['knots'])} knots"
    else:
        numbers = ", ".join(f"{key} {_number(value)}" for key, value in effect["parameters"].items())
    probability = effect["false_alarm_probability"]
    chance = "< 1e-4" if probability < 1e-4 else f"{probability:.2g}"
    share = f"{100 * effect['explained_fraction']:.0f} % of the residual of all others, p {chance}"
    return f"`{effect['name']}`{family} ({share}; {numbers})"


def _cost(found: Mapping[str, Any]) -> str:
    cost = found.get("process")
    return "-" if cost is None else f"{cost['wall_s']:.0f} s, {cost['cpu_s']:.0f} s, {cost['peak_mb']:.0f} MB"


def _number(value: Any) -> str:
    if isinstance(value, Mapping):
        return "by run " + "/".join(f"{one:.3g}" for one in value.values())
    return f"{value:.4g}"


def _interval(figures: Mapping[str, Any], key: str, unit: str) -> str:
    low, high = figures["interval_95"][key]
    return f"{low:.2f} to {high:.2f} {unit}"
