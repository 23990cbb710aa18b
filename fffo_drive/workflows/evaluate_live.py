"""Evaluations that are not simulated in process: recordings, and runs on a bus in real time."""

from __future__ import annotations

import contextlib
import sys
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from types import MappingProxyType
from typing import NamedTuple

import numpy as np
import yaml

from ..config.axis import recorder_settings
from ..config.checks import require
from ..config.commissioning import Permission
from ..config.drive_section import CanopenDriveSection
from ..config.scenario import (
    Scenario,
    axis_of,
    candidates_of,
    cutouts_of,
    law_cautions,
    reference_of,
    wrong_model,
    yardstick_of,
)
from ..control.reference import Profile
from ..documents import DocumentError
from ..drive.port import DriveIdentity
from ..evaluation.campaign import Evaluation, evaluation_of
from ..evaluation.measures import Yardstick
from ..evaluation.metrics import profile_rows
from ..evaluation.trace import SAMPLE, Trace, traces
from ..recording.reader import Run, read_without_rows
from ..recording.settings import RunHeader
from ..runtime.runs import RunOutcome, record_live
from ..runtime.session import Session
from .errors import DriveFaultError, RecordingGapError
from .plan import YAML_TYPE, Plan, connect, open_drive, plan_session, run_header
from .progress import Bar, no_bar
from .recordings import recorded_blocks, recorder_hooks
from .replay import recorded_files
from .simulated_process import SimulatedProcess

NAMES = {"off": "pi", "fb": "pi+fbfo", "ff": "pi+fffo"}
PARTS = ("inertia", "preview", "delay_aware")
BANDS_RPS = (0.0, 0.5, 2.0, 5.0, 1000.0)
HISTOGRAM_BINS = 160
WHOLE_SHARE = 0.999  # of a profile
NOTHING_MORE: Mapping[str, str] = MappingProxyType({})
BEFORE, AFTER = "before", "after"  # the adoption of a model with more effects
CANDIDATE = "candidate"  # in the metadata of a recording: the scenario's name of the controller


def evaluate_recordings(
    files: Sequence[str], yardstick: Yardstick | None
) -> tuple[Yardstick, list[Evaluation], list[str]]:
    """Recorded runs by controller, the n-th run of each as its seed n; and cautions about comparing them."""
    runs = [_seen(Path(file)) for file in files]
    shapes = {(run.samples, run.rest.metadata.get("period_s")) for run in runs}
    cautions = [f"{run.rest.path.name}: {run.rest.reason}" for run in runs if not run.rest.complete]
    if len(shapes) > 1:
        cautions.append("The recordings have different profiles: their metrics are not comparable.")
    for run in runs:
        reached = (run.last + 1) / run.samples
        if reached < WHOLE_SHARE:
            cautions.append(f"{run.rest.path.name}: it ended after {100.0 * reached:.0f} % of its profile.")
    if yardstick is None:
        largest_rps = max(run.largest_rps for run in runs)
        yardstick = Yardstick(BANDS_RPS, np.linspace(-largest_rps, largest_rps, HISTOGRAM_BINS + 1))
    counted: dict[str, int] = {}
    evaluations = []
    for run, name in zip(runs, controller_names([run.rest for run in runs]), strict=True):
        counted[name] = counted.get(name, 0) + 1
        parts = ProfileParts([run.rest.path], float(run.rest.metadata["period_s"]), run.samples)
        windows = cutouts_of(parts.period_s * run.samples) if counted[name] == 1 else ()
        try:
            evaluations.append(evaluation_of(name, counted[name], parts, yardstick, windows))
        except ValueError as error:
            raise DocumentError(f"{run.rest.path}: {error}") from None
    return yardstick, evaluations, cautions


def controller_names(runs: Sequence[Run]) -> list[str]:
    """Name of each run's controller. Runs of one controller with two models, of which one has more effects: BEFORE and
    AFTER; with others, their models' names.
    """
    names = [controller_name(run) for run in runs]
    models = [_model_of(run) for run in runs]
    of_one = {name: sorted({m for n, m in zip(names, models, strict=True) if n == name}) for name in names}
    return [_with_model(name, model, of_one) for name, model in zip(names, models, strict=True)]


def _with_model(name: str, model: tuple[int, str], of_one: Mapping[str, Sequence[tuple[int, str]]]) -> str:
    """A controller's name, with what tells its models apart. `of_one`: the models of each, fewest effects first."""
    known = of_one[name]
    if len(known) < 2:
        return name
    if len(known) > 2 or known[0][0] == known[1][0]:
        return f"{name}, {model[1]}"
    when = BEFORE if model == known[0] else AFTER
    return when if len(of_one) == 1 else f"{name}, {when}"


def _model_of(run: Run) -> tuple[int, str]:
    """Effects and name of the model in a recording; none of one of `evaluate`, whose controllers have names, or without
    files.
    """
    if CANDIDATE not in run.metadata:
        with contextlib.suppress(DocumentError):
            model = recorded_files(run)[1]
            return len(model.effects), model.name
    return 0, ""


def controller_name(run: Run) -> str:
    """pi, pi+fbfo, pi+fffo, with the parts of the feed-forward that its axis file switches on; all three: +."""
    if CANDIDATE in run.metadata:
        return run.metadata[CANDIDATE]
    name = NAMES.get(run.metadata.get("controller", ""), run.path.stem)
    with contextlib.suppress(DocumentError):
        axis, _ = recorded_files(run)
        on = [part for part in PARTS if getattr(axis.controller.feedforward, part)]
        name += "+" if len(on) == len(PARTS) else "".join(f"+{part}" for part in on)
    return name


class ProfileParts:
    """A profile as its files recorded it, in parts that follow each other; each iteration reads the files anew."""

    def __init__(self, files: Sequence[Path], period_s: float, samples: int) -> None:
        self._files, self.period_s, self.samples = files, period_s, samples

    def __iter__(self) -> Iterator[Trace]:
        return traces(recorded_blocks(self._files), self.period_s, self.samples)


class _Seen(NamedTuple):
    """A recording of one profile, read once."""

    rest: Run  # without its rows
    samples: int
    last: int  # sample that ran
    largest_rps: float  # error against the measured velocity


def _seen(file: Path) -> _Seen:
    """Raises DocumentError where it is no run of one profile."""
    rest = read_without_rows(file)
    sizes, samples, last, largest_rps = rest.profile_sizes, rest.profile_samples, -1, 0.0
    numbers: set[int] = set()
    for rows in recorded_blocks([file]):
        inside = profile_rows(rows)
        if sizes and inside.size:
            numbers |= set(np.unique(inside["profile_number"]).tolist())
            samples = sizes.get(min(numbers)) if len(numbers) == 1 else None
        if samples is None and inside.size:
            raise DocumentError(f"{file}: contains more than one profile: give recordings of one profile each")
        inside = profile_rows(inside, samples)
        if inside.size:
            last = int(inside[SAMPLE][-1])
            error_rps = np.abs(inside["reference_rps"] - inside["velocity_rps"])
            largest_rps = max(largest_rps, float(error_rps.max()))
    if last < 0 or samples is None or "period_s" not in rest.metadata:
        raise DocumentError(rest.lacks("contains no profile with the velocity loop closed"))
    return _Seen(rest, samples, last, largest_rps)


class BusRun(NamedTuple):
    """One controller on one seed's reference, as it ran on the bus."""

    controller: str
    seed: int
    profile: Profile
    outcome: RunOutcome


def runs_on_bus(
    scenario: Scenario, bus: str | None, node: str | None, out: Path, given: Permission, bar: Bar = no_bar
) -> list[BusRun]:
    """Every controller on every seed's reference, one run after the other on one loop; recordings go to `out`.

    SYNC goes on between the runs, without torque. `node`: file of a simulated drive to start on the bus; `given`: to
    enable the drive. Raises DocumentError when a controller breaks (14) or a margin: what simulation may try, a machine
    may not.
    """
    section = scenario.axis.drive
    if not isinstance(section, CanopenDriveSection):
        raise DocumentError(f"{scenario.axis_path}: drive.kind: --bus needs an axis file with a canopen drive")
    if not scenario.axis.controller.accept_unproven:
        require(scenario.path, [f"controllers: {caution}" for caution in law_cautions(scenario)])
    plan = Plan(scenario.axis_path, scenario.axis, scenario.model, reference_of(scenario, scenario.seeds[0]))
    address = bus or section.bus
    runs = []
    with contextlib.ExitStack() as stack:
        process = stack.enter_context(SimulatedProcess(Path(node), address)) if node is not None else None
        drive = open_drive(plan, address)
        identity = connect(drive, given)
        session = stack.enter_context(Session(drive, plan_session(plan)))
        for refusal in session.start().refusals:
            print(f"without real-time properties: {refusal}", file=sys.stderr)
        for seed in scenario.seeds:
            profile = reference_of(scenario, seed)
            for candidate in candidates_of(scenario, seed):
                if process is not None:
                    process.check()
                session.set_controller(candidate.controller)
                own = plan._replace(
                    profile=profile,
                    axis=axis_of(scenario, candidate.name),
                    model=wrong_model(scenario.model, scenario.file.mismatch, seed),
                )
                header = candidate_header(own, candidate.name, candidate.toggle, identity, {"seed": str(seed)})
                path = out / f"{candidate.name.replace('+', '_')}_{seed}.mcap"
                with bar(f"{candidate.name}, seed {seed}") as progress:
                    outcome = record_live(
                        session, profile, candidate.toggle, path, header, recorder_settings(plan.axis),
                        recorder_hooks(), progress,
                    )  # fmt: skip
                if outcome.fault_text is not None:
                    raise DriveFaultError(f"{candidate.name}: {outcome.fault_text}; the recording is in {path}")
                if outcome.gap_text is not None:
                    raise RecordingGapError(f"{candidate.name}: {outcome.gap_text}")
                runs.append(BusRun(candidate.name, seed, profile, outcome))
    return runs


def evaluate_on_bus(
    scenario: Scenario, bus: str | None, node: str | None, out: Path, given: Permission, bar: Bar = no_bar
) -> list[Evaluation]:
    """What `runs_on_bus` ran, measured."""
    evaluations = []
    for run in runs_on_bus(scenario, bus, node, out, given, bar):
        parts = ProfileParts(run.outcome.files, run.profile.period_s, run.profile.values.size)
        windows = cutouts_of(run.profile.duration_s) if run.seed == scenario.seeds[0] else ()
        evaluations.append(evaluation_of(run.controller, run.seed, parts, yardstick_of(scenario.file), windows))
    return evaluations


def candidate_header(
    plan: Plan, name: str, toggle: int, identity: DriveIdentity, extra: Mapping[str, str] = NOTHING_MORE
) -> RunHeader:
    """Metadata as of any run, with a name and with this plan's axis and model, which differ from those of its files."""
    header = run_header(plan, identity, toggle)
    documents = ((plan.path.name, plan.axis), (Path(plan.axis.model).name, plan.model))
    attachments = tuple(
        (file, YAML_TYPE, yaml.safe_dump(record.model_dump(mode="json", exclude_none=True), sort_keys=False).encode())
        for file, record in documents
    )
    return RunHeader({**header.metadata, CANDIDATE: name, **extra}, attachments)
