"""The tables of the blind drives: figures against what they must reach, confusions, and every drive by itself."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from common import Report

from .score import Scored, Summary, confusion, summarise

NAMED, IN_FAMILY, REMOVED = 0.75, 0.90, 0.80
MOST_FALSE = 1
SLOWEST_S = 60.0
KINDS = {"single_2sep": "the paper's single surface", "five_surfaces": "five surfaces"}


def blind_report(name: str, purpose: str, sets: Mapping[str, Sequence[Scored]]) -> Report:
    """One report over sets of drives by the kind of their base friction; targets hold for the single surface."""
    report = Report(name, purpose)
    for kind, scored in sets.items():
        _figures(report, KINDS[kind], summarise(scored), scored, kind == "single_2sep")
    for scored in sets.values():
        report.table(
            ["true effect", "drives", "right", "else"],
            [[f"`{n}`", str(total), str(right), other] for n, total, right, other in confusion(scored)],
        )
    for scored in sets.values():
        report.table(
            ["drive", "in it", "said", "beside it", "held-out torque error", "removed", "verdict"],
            [_drive(one) for one in sorted(scored, key=lambda one: (not one.has_effects, one.seed))],
        )
    return report


def _figures(report: Report, kind: str, summary: Summary, scored: Sequence[Scored], judged: bool) -> None:
    effected = sum(one.has_effects for one in scored)
    label = f"{kind} ({effected} drives with effects, {len(scored) - effected} without)"

    def share(what: str, value: float, text: str, least: float) -> None:
        met = value >= least if judged else None
        report.lines.append(_line(f"{label}: {what}", text, f">= {100 * least:.0f} %" if judged else "", met))
        report.facts[f"{kind}: {what}"] = value

    share("named first", summary.named.value, str(summary.named), NAMED)
    share("first or in the family", summary.in_family.value, str(summary.in_family), IN_FAMILY)
    share("outside the library: `unknown:` on the right axis", summary.unknown.value, str(summary.unknown), IN_FAMILY)
    share(
        "held-out squared error removed, of what an oracle removes", summary.removed.mean, str(summary.removed), REMOVED
    )
    few = summary.false_drives.found <= MOST_FALSE if judged else None
    target = f"<= {MOST_FALSE}" if judged else ""
    report.lines.append(_line(f"{label}: effect-free drives with a finding", str(summary.false_drives), target, few))
    report.lines.append(
        _line(f"{label}: effect-free drives called unexplained", str(summary.unexplained_free), "", None)
    )
    extra = "drives with effects where something stands beside the truth"
    report.lines.append(_line(f"{label}: {extra}", str(summary.extra_drives), "", None))
    worse = "drives with effects whose held-out error is larger after"
    report.lines.append(_line(f"{label}: {worse}", str(summary.worse_drives), "", None))
    report.figure(f"{label}: slowest diagnosis, two at a time", summary.slowest_s, "s")
    report.facts[f"{kind}: false findings"] = summary.false_drives.found


def _line(what: str, figure: str, target: str, met: bool | None) -> Any:
    from common import Line

    return Line(what, figure, target, met)


def _drive(one: Scored) -> list[str]:
    truth = ", ".join(f"`{guess.name}`" for guess in one.guesses) or "nothing"
    said = ", ".join(f"{guess.said}{_mark(guess)}" for guess in one.guesses)
    matched = {guess.said for guess in one.guesses}
    beside = ", ".join(name for name in one.false_findings if name not in matched or not one.has_effects) or "-"
    before, after = one.torque_percent
    removed = "-" if one.removed is None else f"{100 * one.removed:.0f} %"
    return [str(one.seed), truth, said or "-", beside, f"{before:.2f} to {after:.2f} %", removed, one.verdict]


def _mark(guess: Any) -> str:
    if guess.named or (guess.in_family and not guess.in_library):
        return " ✓"
    return " (family)" if guess.in_family else " ✗"


def drives_report(name: str, purpose: str, reports: Mapping[str, Mapping[str, Any]]) -> Report:
    """What was found in drives whose truth nobody has told."""
    report = Report(name, purpose)
    rows = []
    for drive, found in reports.items():
        accepted = [effect for effect in found["effects"] if effect["accepted"]]
        before, after = found["before"]["held_out"], found["after"]["held_out"]
        rows.append([
            drive,
            found["verdict"].replace("_", " "),
            "; ".join(_effect(effect) for effect in accepted) or "-",
            f"{before['torque_relative_percent']:.2f} to {after['torque_relative_percent']:.2f} %",
            _interval(after, "torque_relative_percent", "%"),
            f"{before['velocity_rms_rps']:.4f} to {after['velocity_rms_rps']:.4f} rps",
            f"{found['seconds']:.0f} s",
        ])  # fmt: skip
    header = [
        "drive",
        "verdict",
        "found",
        "held-out torque error",
        "95 % of it, after",
        "held-out velocity error",
        "time",
    ]
    report.table(header, rows)
    report.figure("slowest, as it ran", max(found["seconds"] for found in reports.values()), "s", SLOWEST_S)
    report.notes.append("Times are by the clock: the load at the end tells how much of the machine there was.")
    return report


def _effect(effect: Mapping[str, Any]) -> str:
    family = "".join(f" or `{name}`" for name in effect["alternatives"])
    if "curve" in effect:
        numbers = f"a curve of {len(effect['curve']['knots'])} knots"
    else:
        numbers = ", ".join(f"{key} {_number(value)}" for key, value in effect["parameters"].items())
    probability = effect["false_alarm_probability"]
    chance = "< 1e-4" if probability < 1e-4 else f"{probability:.2g}"
    share = f"{100 * effect['explained_fraction']:.0f} % of what was left, p {chance}"
    return f"`{effect['name']}`{family} ({share}; {numbers})"


def _number(value: Any) -> str:
    if isinstance(value, Mapping):
        return "by run " + "/".join(f"{one:.3g}" for one in value.values())
    return f"{value:.4g}"


def _interval(figures: Mapping[str, Any], key: str, unit: str) -> str:
    low, high = figures["interval_95"][key]
    return f"{low:.2f} to {high:.2f} {unit}"
