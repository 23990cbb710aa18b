"""Profiles of an axis file: the kinds of motion. Each key states its range and meaning."""

from __future__ import annotations

import itertools
from typing import Annotated, Literal

from pydantic import Field, Strict, field_validator, model_validator

from ..documents import StrictRecord

Rps = Annotated[float, Field(gt=0, le=1000)]
Hertz = Annotated[float, Field(gt=0, le=1000)]
Ordinate = Annotated[float, Field(ge=-1000, le=1000)]
Point = Annotated[tuple[Annotated[float, Field(ge=0, le=86_400)], Ordinate], Strict(False)]
PROFILE_KIND = Field(description="kind of profile; it determines the other keys")


class PaperProfile(StrictRecord):
    """Multi-sine under a biased sigmoid envelope (Fig. 7)."""

    kind: Annotated[Literal["paper"], PROFILE_KIND]
    duration_s: Annotated[float, Field(gt=0, le=86_400, description="length of the run, s")] = 60.0
    low_rps: Annotated[float, Field(ge=0, le=1000, description="amplitude at the start of the profile, rev/s")] = 0.2
    high_rps: Annotated[Rps, Field(description="amplitude at the end of the profile, rev/s")] = 15.0
    lowest_hz: Annotated[Hertz, Field(description="lowest frequency of the reference, Hz")] = 0.01
    highest_hz: Annotated[Hertz, Field(description="highest frequency of the reference, Hz")] = 10.0
    lines: Annotated[int, Field(ge=1, le=1000, description="number of sines in the reference")] = 31
    slope: Annotated[float, Field(ge=-4, le=4, description="amplitude of a line is f^slope")] = -0.5
    seed: Annotated[int, Field(ge=0, le=2**31, description="seed of the random phases")] = 1


class SineProfile(StrictRecord):
    """One sine."""

    kind: Annotated[Literal["sine"], PROFILE_KIND]
    mode: Annotated[Literal["velocity", "current"], Field(description="kind of reference: velocity or current")] = (
        "velocity"
    )
    duration_s: Annotated[float, Field(gt=0, le=86_400, description="length of the run, s")]
    amplitude: Annotated[float, Field(gt=0, le=1000, description="rps or A, by mode")]
    frequency_hz: Annotated[float, Field(gt=0, le=1000, description="frequency of the sine, Hz")]


class PointsProfile(StrictRecord):
    """Straight lines between points: steps, ramps, staircases, dwells."""

    kind: Annotated[Literal["points"], PROFILE_KIND]
    mode: Annotated[Literal["velocity", "current"], Field(description="kind of reference: velocity or current")] = (
        "velocity"
    )
    points: Annotated[list[Point], Field(min_length=2, description="[time_s, rps or A] each")]

    @model_validator(mode="after")
    def _rising(self) -> PointsProfile:
        times = [time for time, _ in self.points]
        if times[0] != 0 or any(b <= a for a, b in itertools.pairwise(times)):
            raise ValueError("times must start at 0 and rise from point to point")
        return self


class IdentifyProfile(StrictRecord):
    """The paper's identification current: a down-chirp, then an up-chirp, in a biased sigmoid envelope (Fig. 3)."""

    kind: Annotated[Literal["identify"], PROFILE_KIND]
    duration_s: Annotated[float, Field(gt=1, le=86_400, description="length of the run, s")] = 60.0
    low_a: Annotated[float, Field(gt=0, le=1000, description="amplitude at the start")] = 0.3
    high_a: Annotated[float, Field(gt=0, le=1000, description="amplitude at the end")] = 1.1
    lowest_hz: Annotated[Hertz, Field(description="lowest frequency, below highest_hz")] = 0.01
    highest_hz: Annotated[Hertz, Field(description="highest frequency of the excitation, Hz")] = 10.0

    @model_validator(mode="after")
    def _swept(self) -> IdentifyProfile:
        _require_sweep(self.lowest_hz, self.highest_hz)
        return self


class FrfProfile(StrictRecord):
    """Down-chirp of current at one amplitude, for the frequency response (section IV-C)."""

    kind: Annotated[Literal["frf"], PROFILE_KIND]
    duration_s: Annotated[float, Field(gt=1, le=86_400, description="length of the run, s")] = 120.0
    amplitude_a: Annotated[float, Field(gt=0, le=1000, description="amplitude of the excitation, A")] = 1.0
    lowest_hz: Annotated[Hertz, Field(description="lowest frequency, below highest_hz")] = 0.01
    highest_hz: Annotated[Hertz, Field(description="highest frequency of the excitation, Hz")] = 50.0

    @model_validator(mode="after")
    def _swept(self) -> FrfProfile:
        _require_sweep(self.lowest_hz, self.highest_hz)
        return self


def _require_sweep(lowest_hz: float, highest_hz: float) -> None:
    """Raise ValueError for a chirp that goes nowhere."""
    if lowest_hz >= highest_hz:
        raise ValueError(f"lowest_hz {lowest_hz:g} must be below highest_hz {highest_hz:g}")


class PartsProfile(StrictRecord):
    """A profile that consists of parts of the recipe."""

    high_rps: Annotated[Rps, Field(description="highest speed; some parts use a share of it")] = 14.0
    acceleration_rps2: Annotated[float, Field(gt=0, le=1e5, description="highest acceleration")] = 150.0


class RecipeProfile(PartsProfile):
    """Velocity profile that separates effects: staircase, dwells, triangles, accelerate/brake pairs, biased sines."""

    kind: Annotated[Literal["recipe"], PROFILE_KIND]
    repeats: Annotated[int, Field(ge=1, le=10, description="repeats of staircase and triangles")] = 2


class DecideProfile(PartsProfile):
    """The motion that separates one effect from similar ones: parts of the recipe, or a chirp of current."""

    kind: Annotated[Literal["decide"], PROFILE_KIND]
    effect: Annotated[str, Field(description="name of the effect, as reported by `fffo-drive diagnose`")]
    amplitude_a: Annotated[float, Field(gt=0, le=1000, description="amplitude of a chirp")] = 0.5

    @field_validator("effect")
    @classmethod
    def _known(cls, name: str) -> str:
        from ..model.effects.registry import name_error  # imports the loop's compiler: not for `ctl`

        error = name_error(name)
        if error:
            raise ValueError(error)
        return name


ProfileSection = Annotated[
    PaperProfile | SineProfile | PointsProfile | IdentifyProfile | FrfProfile | RecipeProfile | DecideProfile,
    Field(discriminator="kind"),
]


def duration_s(section: ProfileSection) -> float:
    """Duration of a profile, without computing its samples."""
    if isinstance(section, PointsProfile):
        return section.points[-1][0]
    if isinstance(section, RecipeProfile | DecideProfile):
        from ..identification.excitation import deciding_motion_s, motion_s, recipe_parts  # the loop's compiler

        shape = section.high_rps, section.acceleration_rps2
        if isinstance(section, RecipeProfile):
            return motion_s(recipe_parts(section.repeats), *shape)
        return deciding_motion_s(section.effect, *shape)
    return section.duration_s
