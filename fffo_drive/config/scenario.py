"""Scenario files: the controllers to compare, the axis, the reference, noise, delay and model errors.

A scenario names an axis file (law, envelope, model, simulated drive) and says what is different: keys of the plant,
factors on the model's numbers, and one entry for each controller.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterator, Mapping
from dataclasses import asdict, replace
from pathlib import Path
from typing import Annotated, Any, Literal, NamedTuple

import numpy as np
from pydantic import Field, create_model, field_validator, model_validator

from .. import formats
from ..control.compensation import PortableEffects
from ..control.friction_observer import TOGGLE_OFF
from ..control.reference import MODE_VELOCITY, Profile
from ..documents import DocumentError, StrictRecord, check, did_you_mean, parse, read_text, refuse, require_named
from ..drive.simulated.parameters import DeviceConfig, PlantConfig, PlantConfigError
from ..evaluation.campaign import Candidate, Case
from ..evaluation.measures import Yardstick
from ..model.parameters import ModelFile, Quantity
from ..runtime.runs import simulated_ring_rows
from ..symbols import FRICTION
from .axis import TOGGLES, AxisFile, beside, build_profile, controller_config, model_of, read_axis
from .checks import law_problems, profile_problems
from .drive_section import SimulatedDriveSection
from .effects import compensation_table
from .mirror import dataclass_of, record_of
from .names import LONGEST_NAME, FileName
from .profile_sections import PaperProfile, ProfileSection
from .sections import (
    AdaptationSection,
    ControllerSection,
    FeedforwardSection,
    ObserverSection,
    RestSection,
    VelocitySection,
    length_problems,
    refuse_adaptation_beside,
)
from .session import session_config
from .simulated import read_simulated

FRICTION_KEYS = tuple(FRICTION)
AXIS_KEYS = ("inertia_kg_m2", "delay_s", "sensor_delay_s")
CUTOUT_PLACES = (0.3, 0.42, 0.62, 0.92)  # of the duration: two at low speeds, two at high ones, as in Fig. 8
CUTOUT_S = 1.5
HISTOGRAM_BINS = 160

Factor = Annotated[float, Field(gt=0, le=100)]
Gain = Annotated[float | None, Field(ge=0, le=1e6)]


def _inherited(section: type[StrictRecord], key: str) -> Any:
    """The description of a key that is the law's, where null leaves it as it is there."""
    return Field(description=f"{section.model_fields[key].description}; null: as in `law`")


class ControllerVariant(StrictRecord):
    """A controller: differences from that of the axis file, or from the paper's."""

    toggle: Annotated[Literal["off", "ff", "fb"], Field(description="friction from reference, feedback, or off")]
    law: Annotated[
        Literal["axis", "paper"],
        Field(
            description="what the keys below change: the law of the axis file, or the paper's, which is its gains and "
            "nothing beyond PI with friction observer"
        ),
    ] = "axis"
    feedforward: Annotated[FeedforwardSection | None, _inherited(ControllerSection, "feedforward")] = None
    proportional_a_per_rps: Annotated[Gain, _inherited(ControllerSection, "proportional_a_per_rps")] = None
    integral_a_per_rev: Annotated[Gain, _inherited(ControllerSection, "integral_a_per_rev")] = None
    gain_nm_per_rev: Annotated[Gain, _inherited(ObserverSection, "gain_nm_per_rev")] = None
    error_filter_s: Annotated[float | None, Field(ge=0, le=0.1), _inherited(ControllerSection, "error_filter_s")] = None
    learns_in: Annotated[Literal["friction", "integral"] | None, _inherited(ObserverSection, "learns_in")] = None
    at_rest: Annotated[RestSection | None, _inherited(ControllerSection, "at_rest")] = None
    clamp_ratio: Annotated[float | None, Field(ge=1, le=10), _inherited(ObserverSection, "clamp_ratio")] = None
    feedback_band_rps: Annotated[float | None, Field(ge=0, le=10), _inherited(ObserverSection, "feedback_band_rps")] = (
        None
    )
    velocity: Annotated[VelocitySection | None, _inherited(ControllerSection, "velocity")] = None
    adaptation: Annotated[
        AdaptationSection, Field(description="replaces this section of the axis file; absent: everything in it is off")
    ] = AdaptationSection()


class MismatchSection(StrictRecord):
    """Errors of the model that the controllers use."""

    friction_share: Annotated[float, Field(ge=0, lt=1, description="relative error of each friction parameter")] = 0.0
    signs: Annotated[
        Literal["random", "high", "low"], Field(description="signs of these errors; random: drawn for each seed")
    ] = "random"
    factors: Annotated[
        dict[str, Factor], Field(description=f"factors on individual numbers: {', '.join(FRICTION_KEYS + AXIS_KEYS)}")
    ] = Field(default_factory=dict)

    @model_validator(mode="after")
    def _known(self) -> MismatchSection:
        unknown = sorted(set(self.factors) - set(FRICTION_KEYS) - set(AXIS_KEYS))
        if unknown:
            raise ValueError(f"unknown number '{unknown[0]}'; known: {', '.join(FRICTION_KEYS + AXIS_KEYS)}")
        return self


class ScenarioFile(StrictRecord):
    """A comparison."""

    format: Annotated[str, formats.SCENARIO.key] = formats.SCENARIO.word
    name: Annotated[
        str,
        Field(
            pattern=r"^[\w.-]+$",
            max_length=LONGEST_NAME,
            description="title of the report; letters, digits, _ . -",
        ),
    ]
    axis: Annotated[FileName, Field(description="axis file, relative to this file")]
    seeds: Annotated[int, Field(ge=1, le=100_000, description="runs of each controller")] = 10
    first_seed: Annotated[int, Field(ge=0, le=2**30, description="first seed of noise, phases and signs")] = 1
    reference: Annotated[ProfileSection | None, Field(description="null: as in the axis file")] = None
    vary_phases: Annotated[bool, Field(description="the phases of a multi-sine differ between seeds")] = True
    drive: Annotated[FileName | None, Field(description="file of the simulated drive; null: the axis file's")] = None
    plant: Annotated[
        dict[str, Any], Field(description="keys of the plant that differ: friction, effects, noise, delay")
    ] = Field(default_factory=dict)
    mismatch: MismatchSection = MismatchSection()
    band_edges_rps: Annotated[
        list[float], Field(min_length=2, description="speed bands, by the magnitude of the reference")
    ] = Field(default_factory=lambda: [0.0, 0.5, 2.0, 5.0, 1000.0])
    histogram_rps: Annotated[float, Field(gt=0, le=1000, description="half width of the error histograms")] = 0.4
    percent_of: Annotated[
        str | None, Field(description="controller that is 100 %; null: the one with the smallest value")
    ] = None
    controllers: Annotated[
        dict[str, ControllerVariant], Field(min_length=1, description="controllers to compare, by name")
    ]

    @field_validator("band_edges_rps")
    @classmethod
    def _rising(cls, edges: list[float]) -> list[float]:
        if any(high <= low for low, high in itertools.pairwise(edges)):
            raise ValueError("edges must rise")
        return edges


class Scenario(NamedTuple):
    """A checked scenario with all files that it names."""

    path: Path
    file: ScenarioFile
    axis_path: Path
    axis: AxisFile
    model: ModelFile
    plant: PlantConfig | None  # None: the axis is on a bus
    device: DeviceConfig | None

    @property
    def seeds(self) -> range:
        """Seeds of all runs."""
        return range(self.file.first_seed, self.file.first_seed + self.file.seeds)


def read_scenario(path: str | Path) -> Scenario:
    """Read a scenario and everything that it names. Raises DocumentError with every problem found."""
    path = Path(path)
    data, lines = parse(read_text(path), str(path))
    file = check(data, ScenarioFile, str(path), lines)
    if file.percent_of is not None and file.percent_of not in file.controllers:
        hint = did_you_mean(file.percent_of, file.controllers)
        refuse(path, [("percent_of", f"no controller is called '{file.percent_of}': {hint}")])
    axis_path = require_named(path, "axis", beside(path, file.axis))
    axis = read_axis(axis_path)
    model = model_of(axis_path, axis)
    plant, device = None, None
    drive_path = require_named(path, "drive", beside(path, file.drive)) if file.drive else None
    if drive_path is None and isinstance(axis.drive, SimulatedDriveSection):
        drive_path = require_named(axis_path, "drive.file", beside(axis_path, axis.drive.file))
    if drive_path is not None:
        drive = read_simulated(drive_path)
        plant, device = _changed_plant(drive.plant, file.plant, path, lines), drive.device
    elif file.plant:
        refuse(path, [("plant", "the axis is on a bus: its plant cannot be changed")])
    return _checked(Scenario(path, file, axis_path, axis, model, plant, device))


def _checked(scenario: Scenario) -> Scenario:
    """The scenario. Raises DocumentError for a law that adapts beside another, and a reference beyond the limits."""
    refuse(scenario.path, _adaptation_problems(scenario))
    problems = length_problems(scenario.file.reference or scenario.axis.profile, scenario.axis.loop)
    problems = problems or profile_problems(scenario.axis, reference_of(scenario, scenario.file.first_seed))
    refuse(scenario.path, [("reference", problem.removeprefix("profile: ")) for problem in problems])
    return scenario


def on_axis(scenario: Scenario, axis_path: str | Path) -> Scenario:
    """The controllers of a scenario once on another axis, on the profile of its file. Raises DocumentError."""
    path = Path(axis_path)
    axis = read_axis(path)
    one_run = {"reference": axis.profile, "seeds": 1, "vary_phases": False, "mismatch": MismatchSection()}
    file = scenario.file.model_copy(update=one_run)
    return _checked(Scenario(path, file, path, axis, model_of(path, axis), None, None))


def _adaptation_problems(scenario: Scenario) -> list[tuple[str, str]]:
    """(key, text) of each controller that adapts beside what it must not adapt beside."""
    found = []
    for name, variant in scenario.file.controllers.items():
        section = axis_of(scenario, name).controller
        try:
            if variant.adaptation.enabled:
                refuse_adaptation_beside(section.observer.learns_in, section.feedforward)
        except ValueError as error:
            found.append((f"controllers.{name}.adaptation.enabled", str(error).removeprefix("adaptation.enabled: ")))
    return found


def select_controllers(scenario: Scenario, names: list[str]) -> Scenario:
    """The same scenario with some of its controllers, in this order. Raises DocumentError for an unknown one."""
    known = scenario.file.controllers
    unknown = [name for name in names if name not in known]
    if unknown:
        raise DocumentError(f"{scenario.path}: controllers: no '{unknown[0]}'; there are {', '.join(known)}")
    chosen = {name: known[name] for name in names}
    return scenario._replace(file=scenario.file.model_copy(update={"controllers": chosen}))


def axis_of(scenario: Scenario, name: str) -> AxisFile:
    """The axis file as it would be with this controller."""
    variant = scenario.file.controllers[name]
    section = scenario.axis.controller
    section = section.papers if variant.law == "paper" else section
    observer = _given(variant, "toggle", "gain_nm_per_rev", "learns_in", "clamp_ratio", "feedback_band_rps")
    keys = ("proportional_a_per_rps", "integral_a_per_rev", "error_filter_s", "at_rest", "velocity", "feedforward")
    changed = {
        **_given(variant, *keys),
        "observer": section.observer.model_copy(update=observer),
        "adaptation": variant.adaptation,
    }
    return scenario.axis.model_copy(update={"controller": section.model_copy(update=changed)})


def _given(variant: ControllerVariant, *names: str) -> dict[str, Any]:
    return {name: getattr(variant, name) for name in names if getattr(variant, name) is not None}


def toggle_of(scenario: Scenario, name: str) -> int:
    """The toggle of a controller (friction_observer.TOGGLE_*)."""
    return TOGGLES[scenario.file.controllers[name].toggle]


def law_cautions(scenario: Scenario) -> list[str]:
    """Problems of a controller of the scenario: a violation of (14) or of a margin."""
    return [
        f"{name}: {problem.partition(': ')[2]}"
        for name in scenario.file.controllers
        for problem in law_problems(axis_of(scenario, name), scenario.model, toggle_of(scenario, name) != TOGGLE_OFF)
    ]


def reference_of(scenario: Scenario, seed: int) -> Profile:
    """The reference of a seed. Raises DocumentError for one that is not a velocity."""
    section = scenario.file.reference or scenario.axis.profile
    if isinstance(section, PaperProfile) and scenario.file.vary_phases:
        section = section.model_copy(update={"seed": seed})
    profile = build_profile(section, scenario.axis.loop.period_s)
    if profile.mode != MODE_VELOCITY:
        raise DocumentError(f"{scenario.path}: reference.mode: controllers are compared on a velocity, not a current")
    return profile


def wrong_model(model: ModelFile, mismatch: MismatchSection, seed: int) -> ModelFile:
    """The wrong model that the controllers of a seed use."""
    factors = dict(mismatch.factors)
    if mismatch.friction_share > 0.0:
        signs = {"high": 1.0, "low": -1.0}.get(mismatch.signs)
        drawn = np.random.default_rng([seed, 0xF]).choice((-1.0, 1.0), len(FRICTION_KEYS))
        for key, sign in zip(FRICTION_KEYS, drawn, strict=True):
            wrong = 1.0 + mismatch.friction_share * (float(sign) if signs is None else signs)
            factors[key] = factors.get(key, 1.0) * wrong
    friction = {key: _scaled(getattr(model.friction, key), factors.get(key, 1.0)) for key in FRICTION_KEYS}
    axis = {key: _scaled(getattr(model, key), factors.get(key, 1.0)) for key in AXIS_KEYS}
    return model.model_copy(
        update={**axis, "friction": model.friction.model_copy(update=friction), "content_hash": None}
    )


def _scaled(quantity: Quantity, factor: float) -> Quantity:
    return quantity if factor == 1.0 else quantity.model_copy(update={"value": quantity.value * factor})


def candidates_of(scenario: Scenario, seed: int) -> tuple[Candidate, ...]:
    """The controllers of a seed, with the wrong model that they use."""
    model = wrong_model(scenario.model, scenario.file.mismatch, seed)
    return tuple(
        Candidate(name, toggle_of(scenario, name), controller_config(axis_of(scenario, name), model))
        for name in scenario.file.controllers
    )


def yardstick_of(file: ScenarioFile) -> Yardstick:
    """How all runs of the scenario are measured."""
    edges_rps = np.linspace(-file.histogram_rps, file.histogram_rps, HISTOGRAM_BINS + 1)
    return Yardstick(tuple(file.band_edges_rps), edges_rps)


def cutouts_of(duration_s: float) -> tuple[tuple[float, float], ...]:
    """Cut-outs of a run that are kept for plots: begin and end of each, s."""
    length_s = min(CUTOUT_S, 0.1 * duration_s)
    return tuple((place * duration_s, place * duration_s + length_s) for place in CUTOUT_PLACES)


def case_of(scenario: Scenario, seed: int) -> Case:
    """One seed. Raises DocumentError for a scenario without a simulated drive."""
    if scenario.plant is None or scenario.device is None:
        raise DocumentError(f"{scenario.path}: drive: no simulated drive: give one, or run on the bus")
    profile = reference_of(scenario, seed)
    candidates = candidates_of(scenario, seed)
    ring_rows = simulated_ring_rows(profile, scenario.axis.loop.tail_s)
    session = session_config(scenario.axis, scenario.model, profile.values.size, ring_rows)
    return Case(
        seed,
        replace(scenario.plant, seed=seed),
        scenario.device,
        session._replace(effects=None),
        PortableEffects.of(compensation_table(scenario.axis, scenario.model)),
        profile,
        candidates,
        yardstick_of(scenario.file),
        cutouts_of(profile.duration_s) if seed == scenario.file.first_seed else (),
    )


def cases_of(scenario: Scenario) -> Iterator[Case]:
    """All seeds, made one by one."""
    return (case_of(scenario, seed) for seed in scenario.seeds)


def _changed_plant(plant: PlantConfig, changes: Mapping[str, Any], path: Path, lines: Any) -> PlantConfig:
    """The plant with the scenario's keys. Raises DocumentError with their lines."""
    merged = _merged(asdict(plant), changes)
    record: Any = check({"plant": merged}, _PlantRecord, str(path), lines)
    changed = dataclass_of(PlantConfig, record.plant)
    try:
        changed.validate()
    except PlantConfigError as error:
        found = [line.partition(": ") for line in str(error).splitlines()]
        refuse(path, [(key, text) for key, _, text in found])
    return changed


def _merged(base: Mapping[str, Any], changes: Mapping[str, Any]) -> dict[str, Any]:
    """`base` with `changes`: mappings key by key, everything else as a whole."""
    merged = dict(base)
    for key, value in changes.items():
        inner = merged.get(key)
        both = isinstance(inner, Mapping) and isinstance(value, Mapping)
        merged[key] = _merged(inner, value) if both else value  # type: ignore[arg-type]
    return merged


_PlantRecord: type[StrictRecord] = create_model(
    "ScenarioPlant", __base__=StrictRecord, plant=(record_of(PlantConfig), ...)
)
