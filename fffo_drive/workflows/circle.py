"""The circle on one axis: run, record, diagnose, adopt, run again; the tracking error before and after.

It records the axis' own profile, an identification current and the recipe that separates effects. The run of the
profile is held out. The circle works in a directory of its own, on a copy of the axis file.
"""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import yaml

from ..config.axis import AxisFile, build_profile, model_of, read_axis, with_keys
from ..config.checks import motion_problems
from ..config.drive_section import CanopenDriveSection
from ..config.effects import compensated_names, services, slope_margin
from ..config.simulated import read_simulated
from ..control.friction_observer import TOGGLE_OFF
from ..control.reference import MODE_VELOCITY
from ..documents import DocumentError
from ..identification.facts import read_facts
from ..model.effects.laws.second_surface import SECOND_SURFACE
from ..model.parameters import ModelFile, read_model
from ..report.circle import KIND, CircleRun, CircleSource, circle_report, tracking_of
from ..report.document import provenance, source_file, source_log
from ..report.page import refuse_other_report, write_report
from .adopt import put_in_service, read_report
from .adoption_gates import STABILITY, Gate, gates, held_out_gate, refused_effects
from .circle_runs import Circle, CircleWish, RecordedRun, SpoiledRunError, change, write_axis, write_simulated
from .diagnose import MODEL_NAME, diagnose_recordings
from .errors import DriveFaultError
from .plan import Plan, checked_plan, make_plan
from .progress import Bar, no_bar
from .recorded_facts import facts_of_axis
from .simulated_process import SimulatedProcess

IN_SERVICE = "effects in service"  # gate
GAIN_ROOM = 1.02  # times the L that condition (14) requires
RECIPE = {"kind": "recipe", "repeats": 1}
IDENTIFY = {"kind": "identify", "lowest_hz": 0.05}
IDENTIFY_S = 40.0
QUICK_S = 20.0
OTHER_SEED = 1000  # added to the profile's: another reference of its kind
BREAK_AWAY_RATIO = 2.4  # the identification current's peak over what breaks away; less where it goes too far
SHORTER = 0.85
LEAST_BREAK_AWAY_RATIO = 1.1

AS_THE_FILE_SAYS = CircleWish()
# facts, runs to fit, runs held out, directory, what the search leaves out
Diagnose = Callable[[Path, Sequence[Path], Sequence[Path], Path, Sequence[str]], None]


class Closed(NamedTuple):
    """Result of a circle."""

    source: CircleSource  # of the report: effects, gates, errors before and after
    gates: tuple[Gate, ...]  # none where nothing was found
    adopted: bool
    page: Path
    trouble: str  # why the error after the adoption is unknown; empty if it is known


def close_the_loop(
    axis_path: Path, out: Path, wish: CircleWish = AS_THE_FILE_SAYS, *, facts: Path | None = None, quick: bool = False,
    say: Callable[[str], None] = lambda _text: None, bar: Bar = no_bar, diagnose: Diagnose | None = None,
    show_gates: Callable[[Sequence[Gate]], None] = lambda _gates: None,
) -> Closed:  # fmt: skip
    """Go round once. **A drive on a bus moves.** `axis_path` stays as it is; everything is written to `out`.

    `facts`: what is declared about the drive (None: from the axis file). `quick`: runs of QUICK_S and no recipe. `say`
    gets messages, `bar` shows progress, `diagnose` is called in place of `diagnose_recordings`, `show_gates` gets the
    gates before the axis runs with the model. Raises DocumentError, DriveError, and DriveFaultError also if the
    machine keeps no rate.
    """
    plan = make_plan(axis_path)
    _require(plan, wish, facts)
    out.mkdir(parents=True, exist_ok=True)
    refuse_other_report(out, KIND)
    _require_empty(out)
    own_path = write_axis(axis_path, out, wish.sim, wish.rate_hz)
    facts_path = facts or _write_facts(plan, out, wish.sim is not None)
    circle = Circle(wish, own_path, say, bar)
    if quick:
        _shorten(own_path)
    plan = make_plan(own_path)
    try:
        with _drive_process(plan, wish, out):
            return _close(circle, plan, facts_path, quick, diagnose or _diagnose, show_gates)
    except SpoiledRunError as error:
        raise keeps_no_rate(str(error)) from error


def keeps_no_rate(trouble: str) -> DriveFaultError:
    """The error of a circle whose runs are unusable because the machine did not keep time."""
    return DriveFaultError(
        f"{trouble}: this machine does not keep the loop's rate; reduce its load (`fffo-drive doctor`), or lower the "
        "rate (--rate)"
    )


def _close(
    circle: Circle, plan: Plan, facts_path: Path, quick: bool, diagnose: Diagnose,
    show_gates: Callable[[Sequence[Gate]], None],
) -> Closed:  # fmt: skip
    """Runs, diagnosis, adoption, the run with it, the report."""
    out, say = circle.out, circle.say
    say("run and record: the file's profile, identification current, " + ("another one" if quick else "recipe"))
    third = ("other", _other_reference(plan)) if quick else ("recipe", recipe_profile(plan))
    identify = identification_profile(plan, quick)
    before, *fit = circle.at_a_rate_it_keeps(
        lambda: (circle.run("before"), circle.run("identify", identify), circle.run(*third))
    )
    say(f"diagnose ({before.rate_hz} Hz; {before.health.text})")
    model_path = out / "diagnosis" / MODEL_NAME

    def adopt_without(*names: str) -> tuple[ModelFile | None, dict[str, Any] | None, bool, list[Gate]]:
        diagnose(facts_path, [run.path for run in fit], [before.path], model_path.parent, names)
        report = read_report(model_path, None)
        model = read_model(model_path) if model_path.exists() else None
        return model, report, *_adopt(circle.path, model_path, model, report)

    as_given = circle.path.read_text(encoding="utf-8")
    model, report, adopted, found = adopt_without()
    if model is not None and _second_surface_is_unstable(model, found):
        say("the loop is not stable with the friction of two surfaces: diagnose again with one")
        circle.path.write_text(as_given, encoding="utf-8")
        model, report, adopted, found = adopt_without(SECOND_SURFACE)
    show_gates(found)
    after, trouble = None, ""
    if adopted:
        say("adopted; run again")
        try:
            after = circle.run("after")
        except SpoiledRunError as error:
            trouble = f"{error}; the model is in service in {circle.path}, but its tracking error was not measured"
    source = _source(circle, plan, model, report, found, (before, *fit), after)
    return Closed(source, tuple(found), adopted, write_report(circle_report(source), out).page, trouble)


# -- before anything moves --------------------------------------------------------------------------------------------


def _require(plan: Plan, wish: CircleWish, facts: Path | None) -> None:
    """Read every file once, and refuse an axis that cannot finish a circle."""
    if facts:
        read_facts(facts)
    if wish.sim:
        read_simulated(wish.sim)
    if plan.profile.mode != MODE_VELOCITY:
        raise DocumentError(
            f"{plan.path}: profile: {plan.axis.profile.kind} has no tracking error: a velocity profile is needed"
        )
    on_bus = isinstance(plan.axis.drive, CanopenDriveSection)
    if wish.bus and not on_bus:
        raise DocumentError(f"{plan.path}: drive.kind: simulated runs in process and has no bus: leave --bus out")


def _require_empty(out: Path) -> None:
    """Nothing of an earlier circle is overwritten."""
    old = [out / name for name in ("axis.yaml", "before.mcap", "report.html") if (out / name).exists()]
    if old:
        raise DocumentError(f"{old[0]}: exists already: give another --out")


def _shorten(path: Path) -> None:
    """The file's profile in QUICK_S, where it has a duration."""
    profile = read_axis(path).profile
    if getattr(profile, "duration_s", 0.0) > QUICK_S:
        change(path, ("profile", "duration_s"), QUICK_S)


@contextlib.contextmanager
def _drive_process(plan: Plan, wish: CircleWish, out: Path) -> Iterator[None]:
    """The simulated drive on the bus for the duration of the circle, if requested."""
    section = plan.axis.drive
    if wish.sim is None or not isinstance(section, CanopenDriveSection):
        yield
        return
    with SimulatedProcess(write_simulated(wish.sim, out), wish.bus or section.bus):
        yield


def identification_profile(plan: Plan, quick: bool) -> dict[str, Any]:
    """An identification current that keeps the axis inside its envelope, by the model in service."""
    break_away_a = plan.model.friction.static_nm.value / plan.model.torque_constant_nm_per_a
    ratio = BREAK_AWAY_RATIO
    quick_s = min(QUICK_S, plan.profile.duration_s)
    while ratio > LEAST_BREAK_AWAY_RATIO:
        currents = {"high_a": ratio * break_away_a, "low_a": 0.3 * ratio * break_away_a}
        profile = IDENTIFY | currents | {"duration_s": quick_s if quick else IDENTIFY_S}
        axis = with_keys(plan.axis, {"profile": profile}, "profile")
        if not motion_problems(axis, build_profile(axis.profile, axis.loop.period_s), plan.model):
            return profile
        ratio *= SHORTER
    raise DocumentError(
        f"{plan.path}: envelope: according to the model, a current that breaks the axis away exceeds it: record "
        "the runs "
        "yourself and use `fffo-drive diagnose` and `fffo-drive adopt`"
    )


def recipe_profile(plan: Plan) -> dict[str, Any]:
    """The motions that separate effects, inside the axis' limits: the `profile` section of an axis file."""
    return RECIPE | {"high_rps": min(14.0, 0.6 * plan.axis.envelope.speed_limit_rps)}


def _other_reference(plan: Plan) -> dict[str, Any]:
    """Another reference of the same kind where the profile has a seed, else the same."""
    profile = plan.axis.profile.model_dump()
    return profile | ({"seed": profile["seed"] + OTHER_SEED} if "seed" in profile else {})


def _write_facts(plan: Plan, out: Path, simulated: bool) -> Path:
    """What the axis file declares about the drive. The simulated drive's angle is the same in every run."""
    facts = facts_of_axis(plan.axis, plan.model, True if simulated else None)
    path = out / "facts.yaml"
    path.write_text(yaml.safe_dump(facts, sort_keys=False), encoding="utf-8")
    return path


# -- diagnosis and adoption -------------------------------------------------------------------------------------------


def _diagnose(
    facts: Path, fit: Sequence[Path], held_out: Sequence[Path], out: Path, without: Sequence[str]
) -> None:  # fmt: skip
    diagnose_recordings(fit, held_out, out, facts_file=facts, without=without)


def _adopt(
    axis_path: Path, model_path: Path, model: ModelFile | None, report: dict[str, Any] | None
) -> tuple[bool, list[Gate]]:
    """Adopt what was found on the circle's own axis file. The observer's gain follows the refitted friction.

    Without a model nothing lowers the error of the held-out run, and that gate refuses.
    """
    if model is None:
        return False, [held_out_gate(report)]
    if not model.effects:
        return False, []
    axis = read_axis(axis_path)
    gain = _needed_gain(axis_path, axis, model)
    if gain is not None:
        change(axis_path, ("controller", "observer", "gain_nm_per_rev"), gain)
        axis = read_axis(axis_path)
    if not compensated_names(axis, model):
        reasons = "; ".join(f"{service.effect.name}: {service.reason}" for service in services(axis, model))
        return False, [Gate(IN_SERVICE, False, f"no effect can go into service: {reasons}")]
    found = gates(axis, model_of(axis_path, axis), model, report, None)
    weak = refused_effects(model, found)
    if weak and set(compensated_names(axis, model)) - set(weak):
        change(axis_path, ("controller", "effects", "out_of_service"), weak)
        axis = read_axis(axis_path)
        found = [gate for gate in found if gate.name.rpartition(": ")[0] in weak and not gate.passed]
        found = [Gate(gate.name, True, f"left out of service: {gate.text}") for gate in found]
        found += gates(axis, model_of(axis_path, axis), model, report, None)
    if not all(gate.passed for gate in found):
        return False, found
    put_in_service(axis_path, model_path, found)
    return True, found


def _second_surface_is_unstable(model: ModelFile, found: Sequence[Gate]) -> bool:
    """Whether the stability gate refuses a model of two surfaces: its first has a large B, which requires a large L."""
    refused = any(gate.name == STABILITY and not gate.passed for gate in found)
    return refused and any(effect.name == SECOND_SURFACE for effect in model.effects)


def _needed_gain(axis_path: Path, axis: AxisFile, model: ModelFile) -> float | None:
    """The larger L that (14) requires with the refitted B; None if that of the file is enough."""
    observer_on = axis.controller.observer.toggle != "off"
    plan = checked_plan(axis_path, axis, model_of(axis_path, axis), (TOGGLE_OFF,))
    left = slope_margin(axis, model, plan.profile, observer_on).condition_14_nm_per_rev
    if not observer_on or left >= 0.0:
        return None
    return round(GAIN_ROOM * (axis.controller.observer.gain_nm_per_rev - left), 3)


# -- what came of it --------------------------------------------------------------------------------------------------


def _source(
    circle: Circle, plan: Plan, model: ModelFile | None, report: dict[str, Any] | None, found: Sequence[Gate],
    fit: Sequence[RecordedRun], after: RecordedRun | None,
) -> CircleSource:  # fmt: skip
    """Everything that the report is made of."""
    before = fit[0]
    runs = {run.path.stem: run for run in (*fit, *([after] if after else []))}
    files = [source_log(run.path) for run in runs.values()]
    served = services(circle.axis, model) if model else []
    shown = [circle.path, *([circle.out / "simulated.yaml"] if (circle.out / "simulated.yaml").exists() else [])]
    files += [source_file(path.name, path.read_bytes(), text=True) for path in shown]
    return CircleSource(
        axis=plan.axis.name,
        verdict=str((report or {}).get("verdict", "none")),
        effects=tuple(effect.name for effect in model.effects) if model else (),
        unexplained_rest=str(((report or {}).get("unexplained_rest") or {}).get("sentence", "")),
        not_compensated={s.effect.name: s.reason for s in served if s.reason is not None},
        gates=tuple(gate._asdict() for gate in found),
        model_error={key: (report or {}).get(key) for key in ("before", "after")},
        tracking=tracking_of(before.rows, after.rows if after else None, 1.0 / before.rate_hz, before.samples),
        runs=tuple(
            CircleRun(name, run.rate_hz, run.health.ticks, run.health.lost_share, run.health.longest_s)
            for name, run in runs.items()
        ),
        provenance=provenance(files, {"axis": plan.axis.name, "rate": f"{before.rate_hz} Hz"}),
    )
