"""Many runs on the simulated drive in process: cases, each a seed with all its controllers, over all cores."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Iterable
from typing import NamedTuple

import numpy as np

from ..arrays import Floats
from ..control.compensation import PortableEffects
from ..control.controller import ControllerConfig
from ..control.envelope import LIMIT_CURRENT, LIMIT_I2T, LIMIT_SLEW, TRIP_NONE, TRIP_TEXTS
from ..control.own_law import ControlLaw
from ..control.reference import Profile
from ..drive.simulated.in_process import SimulatedDrive
from ..drive.simulated.parameters import DeviceConfig, PlantConfig
from ..model.effects.registry import LAWS
from ..recording.ring_reader import RingReader
from ..runtime import blocks as b
from ..runtime.session import Session, SessionConfig, raise_failure
from .measures import Measures, Yardstick, measure
from .metrics import Rows
from .trace import Trace, trace_of
from .workers import over_cores

CHANGED_COMMAND = LIMIT_CURRENT | LIMIT_SLEW | LIMIT_I2T  # limits with which the envelope changed the command


class Candidate(NamedTuple):
    """A controller under test."""

    name: str
    toggle: int  # friction_observer.TOGGLE_*
    controller: ControllerConfig
    own_law: ControlLaw | None = None  # of a user, in place of the controller


class Case(NamedTuple):
    """One seed: the same axis, noise and reference for every candidate."""

    seed: int
    plant: PlantConfig  # its seed is the case's
    device: DeviceConfig
    session: SessionConfig  # the controller in it is replaced by the candidate's, the effects by those below
    effects: PortableEffects
    profile: Profile
    candidates: tuple[Candidate, ...]
    yardstick: Yardstick
    cutouts_s: tuple[tuple[float, float], ...]  # start and end of the pieces kept for plots


class Cutout(NamedTuple):
    """A piece of a run, arrays (n,)."""

    start_s: float
    period_s: float
    reference_rps: Floats
    velocity_rps: Floats  # of the shaft if known, else the measured velocity


class Evaluation(NamedTuple):
    """One evaluated run. `measures` is None if the envelope tripped too early."""

    candidate: str
    seed: int
    trip: int
    measures: Measures | None
    cutouts: tuple[Cutout, ...]
    skipped_share: float = 0.0  # samples of the profile whose ticks were skipped
    envelope_ticks: int | None = None  # in which the envelope changed the command; None: not counted, or no envelope

    @property
    def fault_text(self) -> str | None:
        """Why the run is invalid; None if it is valid."""
        if self.trip != TRIP_NONE:
            return TRIP_TEXTS[self.trip]
        return None if self.measures is not None else "the profile did not run"


def simulate(case: Case, candidate: Candidate) -> tuple[Rows, int]:
    """Rows of one run, and the trip that ended it (envelope.TRIP_*)."""
    drive = SimulatedDrive(case.plant, case.device)
    drive.connect()
    effects = case.effects.table()
    config = case.session._replace(controller=candidate.controller, effects=effects, own_law=candidate.own_law)
    session = Session(drive, config)
    session.run_profile(case.profile, candidate.toggle)
    raise_failure(session)
    return RingReader(session.ring).read().rows, session.status(b.TRIP)


def run_case(case: Case) -> list[Evaluation]:
    """All candidates of a case, one after the other."""
    return [_evaluate(case, candidate) for candidate in case.candidates]


def _evaluate(case: Case, candidate: Candidate) -> Evaluation:
    rows, trip = simulate(case, candidate)
    if trip != TRIP_NONE:
        return Evaluation(candidate.name, case.seed, trip, None, ())
    trace = trace_of(rows, case.profile.period_s, case.profile.values.size)
    found = evaluation_of(candidate.name, case.seed, [trace], case.yardstick, case.cutouts_s)
    changed = (rows["limits"] & CHANGED_COMMAND != 0) & (rows["profile_sample"] >= 0)
    return found._replace(envelope_ticks=int(changed.sum()))


def evaluation_of(
    candidate: str,
    seed: int,
    parts: Iterable[Trace],
    yardstick: Yardstick,
    windows_s: tuple[tuple[float, float], ...],
) -> Evaluation:
    """Evaluation of a run that reached its end, in parts that follow each other, which are iterated over again."""
    measures = measure(parts, yardstick)
    return Evaluation(
        candidate, seed, TRIP_NONE, measures, cut(parts, windows_s, measures.true is not None), measures.skipped_share
    )


def cut(parts: Iterable[Trace], windows_s: tuple[tuple[float, float], ...], of_shaft: bool) -> tuple[Cutout, ...]:
    """Pieces of a run; only those reached if it stopped early. `of_shaft`: with the true velocity, which is known."""
    found: dict[float, list[tuple[Floats, Floats]]] = {}
    begin, period_s = 0, 0.0
    for part in parts:
        velocity_rps = part.true_rps if of_shaft and part.true_rps is not None else part.measured_rps
        period_s = part.period_s
        for start_s, end_s in windows_s:
            first, last = (max(0, round(time_s / period_s) - begin) for time_s in (start_s, end_s))
            if first < min(last, velocity_rps.size):
                own = slice(first, last)
                found.setdefault(start_s, []).append((part.reference_rps[own].copy(), velocity_rps[own].copy()))
        begin += velocity_rps.size
        if all(end_s < begin * period_s for _, end_s in windows_s):
            break
    return tuple(
        Cutout(start_s, period_s, *(np.concatenate(column) for column in zip(*pieces, strict=True)))
        for start_s, pieces in found.items()
    )


def warm_up(case: Case) -> None:
    """Compile here what the workers need, so that they only load it: two concurrent compilations take twice as long
    each.
    """
    drive = SimulatedDrive(case.plant, case.device)
    Session(drive, case.session._replace(longest_profile=1, ring_rows=1)).compile()


def run_campaign(
    cases: Iterable[Case], workers: int | None = None, progress: Callable[[int], None] | None = None
) -> list[Evaluation]:
    """All cases, in their order, over the cores; `progress` gets the number of cases done."""
    remaining = iter(cases)
    first = next(remaining, None)
    if first is None:
        return []
    warm_up(first)
    if any((LAWS.brought_by(name) or "").startswith("file ") for name in first.effects.laws):
        workers = 1  # what register_law was told is known to this process alone
    found = over_cores(run_case, itertools.chain([first], remaining), workers, progress)
    return [evaluation for evaluations in found for evaluation in evaluations]
