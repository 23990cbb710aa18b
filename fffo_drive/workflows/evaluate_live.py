"""Evaluations that are not simulated in process: recordings, and runs on a bus in real time."""

from __future__ import annotations

import contextlib
import sys
from collections.abc import Mapping, Sequence
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
from ..evaluation.trace import SAMPLE, TRACED, trace_of
from ..recording.reader import Run, read_run
from ..recording.settings import Rows, RunHeader
from ..runtime.runs import RunOutcome, record_live
from ..runtime.session import Session
from .errors import DriveFaultError, RecordingGapError
from .plan import YAML_TYPE, Plan, connect, open_drive, plan_session, run_header
from .progress import Bar, no_bar
from .recordings import recorded_rows, recorder_hooks
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
    runs = [read_run(file, columns=(*TRACED, "profile_number")) for file in files]
    shapes = {(run.profile_samples, run.metadata.get("period_s")) for run in runs}
    cautions = [f"{run.path.name}: {run.reason}" for run in runs if not run.complete]
    if len(shapes) > 1:
        cautions.append("The recordings have different profiles: their metrics are not comparable.")
    rows = [_profile_of(run) for run in runs]
    for run, (own, samples) in zip(runs, rows, strict=True):
        reached = (int(own[SAMPLE][-1]) + 1) / samples
        if reached < WHOLE_SHARE:
            cautions.append(f"{run.path.name}: it ended after {100.0 * reached:.0f} % of its profile.")
    if yardstick is None:
        largest_rps = max(float(np.abs(own["reference_rps"] - own["velocity_rps"]).max()) for own, _ in rows)
        yardstick = Yardstick(BANDS_RPS, np.linspace(-largest_rps, largest_rps, HISTOGRAM_BINS + 1))
    counted: dict[str, int] = {}
    evaluations = []
    for run, name, (own, samples) in zip(runs, controller_names(runs), rows, strict=True):
        counted[name] = counted.get(name, 0) + 1
        period_s = float(run.metadata["period_s"])
        windows = cutouts_of(period_s * samples) if counted[name] == 1 else ()
        evaluations.append(evaluation_of(name, counted[name], trace_of(own, period_s), yardstick, windows))
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


def _profile_of(run: Run) -> tuple[Rows, int]:
    """The rows inside the profile of a run, and its samples. Raises DocumentError."""
    samples, sample = run.profile_samples or 0, run.rows[SAMPLE]
    if samples == 0 and (sample >= 0).any():
        raise DocumentError(f"{run.path}: contains more than one profile: give recordings of one profile each")
    inside = run.rows[(sample >= 0) & (sample < samples)]
    if inside.size == 0 or "period_s" not in run.metadata:
        raise DocumentError(run.lacks("contains no profile with the velocity loop closed"))
    return inside, samples


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
        trace = trace_of(recorded_rows(run.outcome.files), run.profile.period_s, run.profile.values.size)
        windows = cutouts_of(run.profile.duration_s) if run.seed == scenario.seeds[0] else ()
        evaluations.append(evaluation_of(run.controller, run.seed, trace, yardstick_of(scenario.file), windows))
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
