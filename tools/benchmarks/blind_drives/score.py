"""What a diagnosis said against what was true: names, families, axes, false findings, and the error that was removed.

Only accepted effects that the report does not put in doubt count, and of these as many of the first as the drive has
effects: a diagnosis cannot gain by listing more. A form of the friction itself is counted apart: it is true of a plant
with several surfaces. A drive's
effect is *named* when one of these findings has its name, and *in the family* when its name stands among the finding's
alternatives too. An effect of no library is right as `unknown:` on one of its axes.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from fffo_drive.units import NORMAL_95

from .draw import FEWEST_PERIODS, MOST_PERIODS, STRONG_SHARE

LEAST_REMOVABLE = 0.1  # of the squared error that stays: below it the held-out run hardly shows the effect
RESAMPLES = 4000
CORES = 2.0  # that a diagnosis may have, by its target
NOTHING = "(nothing)"
ORDER_TOLERANCE = 0.01  # of a wave's order, for its name to count


class Share(NamedTuple):
    """So many of so many, with the Wilson interval of the share."""

    found: int
    total: int
    low: float
    high: float

    @property
    def value(self) -> float:
        """The share itself; 0 of nothing is 0."""
        return self.found / self.total if self.total else 0.0

    def __str__(self) -> str:
        percent = f"{100 * self.value:.0f} %" if self.total else "-"
        return f"{self.found}/{self.total} = {percent} ({100 * self.low:.0f} to {100 * self.high:.0f} %)"


def wilson(found: int, total: int) -> Share:
    """Wilson score interval at 95 % (Wilson, 1927)."""
    if total == 0:
        return Share(0, 0, 0.0, 1.0)
    z2 = NORMAL_95 * NORMAL_95
    share = found / total
    centre = (share + z2 / (2 * total)) / (1 + z2 / total)
    reach = NORMAL_95 * math.sqrt(share * (1 - share) / total + z2 / (4 * total * total)) / (1 + z2 / total)
    return Share(found, total, max(0.0, centre - reach), min(1.0, centre + reach))


class Guess(NamedTuple):
    """One true effect and what became of it."""

    name: str
    in_library: bool
    said: str  # name of the finding that was matched, or of the first finding that matches nothing
    named: bool
    in_family: bool
    is_target_wave: bool = False  # of FEWEST to MOST periods a turn, and STRONG enough that it must be found


@dataclass(frozen=True)
class Scored:
    """One drive."""

    seed: int
    guesses: tuple[Guess, ...]
    false_findings: tuple[str, ...]  # accepted findings that match no true effect
    forms: tuple[str, ...]  # that the friction itself is said to have
    verdict: str
    removed: float | None  # share of the squared held-out error that the oracle removes; None: hardly shown there
    seconds: float  # of two cores: half of the processor's time in a process of its own
    torque_percent: tuple[float, float]  # held-out, before and after
    silent: bool  # an effect is not among the findings, and nothing says that something is left
    peak_mb: float | None  # of the process; None in reports of earlier code
    doubted: tuple[str, ...] = ()  # findings that the report itself puts in doubt
    doubted_truths: int = 0  # of them, names that are right

    @property
    def has_effects(self) -> bool:
        """True where something was there to be found."""
        return bool(self.guesses)


def score_drive(truth: Mapping[str, Any], report: Mapping[str, Any], floor_rms_nm: float | None) -> Scored:
    """Score one report. `floor_rms_nm`: what the oracle leaves of the held-out torque error."""
    effects = truth["effects"]
    stands = [finding for finding in report["effects"] if finding["accepted"]]
    accepted = [finding for finding in stands if not finding.get("doubt")]
    doubted = [finding for finding in stands if finding.get("doubt")]
    counted = accepted[: len(effects)] if effects else accepted
    left = list(counted)
    guesses: list[Guess | None] = [None] * len(effects)
    for exact in (True, False):  # a right name first, so that a family does not take another effect's finding
        for k, effect in enumerate(effects):
            match = next((f for f in left if guesses[k] is None and _matches(effect, f, exact)), None)
            if match is not None:
                left.remove(match)
                guesses[k] = Guess(
                    effect["name"], effect["in_library"], match["name"], exact, True, _is_target_wave(effect)
                )
    spare = list(left)
    for k, effect in enumerate(effects):
        if guesses[k] is None:
            said = spare.pop(0)["name"] if spare else NOTHING
            guesses[k] = Guess(effect["name"], effect["in_library"], said, False, False, _is_target_wave(effect))
    before = report["before"]["held_out"]
    after = report["after"]["held_out"] or before  # nothing that carries over is no model: all is as before
    residual_reported = report["verdict"] == "unexplained" or report.get("unexplained_rest") is not None
    matched = len(effects) - sum(1 for guess in guesses if guess is not None and not guess.in_family)
    false = [f["name"] for f in (left + accepted[len(counted) :])] if effects else [f["name"] for f in accepted]
    assert matched + len(false) == len(accepted)
    return Scored(
        seed=int(truth["seed"]),
        guesses=tuple(guess for guess in guesses if guess is not None),
        false_findings=tuple(false),
        forms=tuple(form["name"] for form in report.get("friction_form", [])),
        verdict=report["verdict"],
        removed=_removed(before["torque_rms_nm"], after["torque_rms_nm"], floor_rms_nm) if effects else None,
        seconds=float(report["process"]["cpu_s"]) / CORES if "process" in report else float(report["seconds"]),
        torque_percent=(before["torque_relative_percent"], after["torque_relative_percent"]),
        silent=matched < len(effects) and not residual_reported,
        peak_mb=report.get("process", {}).get("peak_mb"),
        doubted=tuple(one["name"] for one in doubted),
        doubted_truths=sum(any(_matches(effect, one, True) for one in doubted) for effect in effects),
    )


def _is_target_wave(effect: Mapping[str, Any]) -> bool:
    order, share = effect.get("parameters", {}).get("order", 0.0), effect.get("share_of_coulomb") or 0.0
    return FEWEST_PERIODS <= order <= MOST_PERIODS and share >= STRONG_SHARE


def _matches(effect: Mapping[str, Any], finding: Mapping[str, Any], exact: bool) -> bool:
    names = [finding["name"]] if exact else [finding["name"], *finding["alternatives"]]
    if effect["in_library"]:
        return effect["name"] in names and _same_order(effect, finding)
    return any(name.startswith("unknown:") and name.partition(":")[2] in effect["axes"] for name in names)


def _same_order(effect: Mapping[str, Any], finding: Mapping[str, Any]) -> bool:
    """A wave of another order is another wave."""
    true, said = (one.get("parameters", {}).get("order") for one in (effect, finding))
    return true is None or said is None or abs(said - true) <= ORDER_TOLERANCE * true


def _removed(before: float, after: float, floor: float | None) -> float | None:
    if floor is None:
        return None
    removable = before * before - floor * floor
    if removable < LEAST_REMOVABLE * floor * floor:
        return None
    return (before * before - after * after) / removable


class Removed(NamedTuple):
    """Share of the removable squared error: mean over drives (each held to 0 to 1), its bootstrap interval, median."""

    mean: float
    low: float
    high: float
    median: float
    drives: int

    def __str__(self) -> str:
        mean = f"mean {100 * self.mean:.0f} % ({100 * self.low:.0f} to {100 * self.high:.0f} %)"
        return f"{mean}, median {100 * self.median:.0f} %, {self.drives} drives"


def removed_share(scored: Sequence[Scored]) -> Removed:
    """Over all drives whose held-out run shows the effect."""
    values = np.array([one.removed for one in scored if one.removed is not None])
    if not values.size:
        return Removed(0.0, 0.0, 1.0, 0.0, 0)
    clipped = np.clip(values, 0.0, 1.0)
    generator = np.random.default_rng(1)
    means = clipped[generator.integers(0, clipped.size, (RESAMPLES, clipped.size))].mean(axis=1)
    low, high = np.quantile(means, [0.025, 0.975])
    return Removed(float(clipped.mean()), float(low), float(high), float(np.median(values)), int(values.size))


@dataclass(frozen=True)
class Summary:
    """The figures of a set of drives."""

    named: Share  # of effects of the library
    in_family: Share
    unknown: Share  # of effects outside it: right axis
    removed: Removed
    false_drives: Share  # effect-free drives with a finding
    forms: Share  # of them, those whose friction is said to be not of the form of one surface
    extra_drives: Share  # drives with effects on which something stands beside the truth
    unexplained_free: Share  # effect-free drives of which something is said to be left
    worse_drives: Share  # drives with effects whose held-out torque error is larger after than before
    waves: Share  # of strong waves of many periods: first or in the family
    silent: Share  # drives with effects that are not named, and nothing is said of a rest
    doubted_truths: Share  # true effects whose name was found and put in doubt
    doubted_free: Share  # effect-free drives with something in doubt
    slowest_s: float
    median_s: float
    peak_mb: float


def summarise(scored: Sequence[Scored]) -> Summary:
    """Count over drives."""
    known = [guess for one in scored for guess in one.guesses if guess.in_library]
    odd = [guess for one in scored for guess in one.guesses if not guess.in_library]
    free = [one for one in scored if not one.has_effects]
    effected = [one for one in scored if one.has_effects]
    return Summary(
        named=wilson(sum(g.named for g in known), len(known)),
        in_family=wilson(sum(g.in_family for g in known), len(known)),
        unknown=wilson(sum(g.in_family for g in odd), len(odd)),
        removed=removed_share(scored),
        false_drives=wilson(sum(bool(one.false_findings) for one in free), len(free)),
        forms=wilson(sum(bool(one.forms) for one in free), len(free)),
        extra_drives=wilson(sum(_extra(one) for one in effected), len(effected)),
        unexplained_free=wilson(sum(one.verdict == "unexplained" for one in free), len(free)),
        worse_drives=wilson(sum(one.torque_percent[1] > one.torque_percent[0] for one in effected), len(effected)),
        waves=wilson(sum(g.in_family for g in known if g.is_target_wave), sum(g.is_target_wave for g in known)),
        silent=wilson(sum(one.silent for one in effected), len(effected)),
        doubted_truths=wilson(sum(one.doubted_truths for one in effected), len(known) + len(odd)),
        doubted_free=wilson(sum(bool(one.doubted) for one in free), len(free)),
        slowest_s=max((one.seconds for one in scored), default=0.0),
        median_s=float(np.median([one.seconds for one in scored])) if scored else 0.0,
        peak_mb=max((one.peak_mb or 0.0 for one in scored), default=0.0),
    )


def _extra(one: Scored) -> bool:
    missed = sum(not guess.in_family for guess in one.guesses)
    return len(one.false_findings) > missed


def confusion(scored: Sequence[Scored]) -> list[tuple[str, int, int, str]]:
    """Per true effect: how many, how many named, and what was said in place of the name."""
    rows = []
    guesses = [guess for one in scored for guess in one.guesses]
    for name in sorted({guess.name for guess in guesses}, key=lambda n: (n.startswith("odd_"), n)):
        own = [guess for guess in guesses if guess.name == name]
        right = [g for g in own if (g.named if g.in_library else g.in_family)]
        others = Counter(f"{g.said}{' (family)' if g.in_family else ''}" for g in own if g not in right)
        text = ", ".join(f"{said} x{count}" if count > 1 else said for said, count in others.most_common())
        rows.append((name, len(own), len(right), text or "-"))
    return rows
