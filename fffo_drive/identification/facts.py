"""Declared facts about a drive: what no log contains, and how to read a log of another program.

A YAML file; only the torque constant is needed. For a linear axis (`units: linear`) revolutions, rps and Nm stand for
m, m/s and N throughout, and the torque constant is a force constant (N per unit of command).
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any, Literal

import yaml
from pydantic import Field

from .. import formats
from ..documents import StrictRecord, check, load
from ..importing.candidates import DeclaredColumn, Hints

Count = Annotated[int, Field(ge=1, le=10_000)]


class ColumnFact(StrictRecord):
    """One column of a foreign log."""

    column: Annotated[str, Field(description="its name in the file")]
    unit: Annotated[str | None, Field(description="its unit there; default: the signal's own")] = None
    scale: Annotated[float, Field(description="factor from the column to the signal in `unit`")] = 1.0
    offset: Annotated[float, Field(description="added after the scale")] = 0.0


class DriveFacts(StrictRecord):
    """Declared facts about a drive."""

    format: Annotated[str, formats.FACTS.key] = formats.FACTS.word

    name: Annotated[str, Field(description="name of the axis or drive, for the titles of pages")] = ""
    torque_constant_nm_per_a: Annotated[float, Field(gt=0, le=1e6, description="declared, never fitted")]
    rated_current_a: Annotated[
        float | None, Field(gt=0, le=1e4, description="an inertia that this current cannot accelerate is refused")
    ] = None
    gear_ratio: Annotated[float | None, Field(gt=0, le=1e5, description="motor speed over output speed")] = None
    resolver_bits: Annotated[
        int | None, Field(ge=8, le=32, description="2^bits counts per turn; default: from the data")
    ] = None
    position_lsb_rev: Annotated[float | None, Field(gt=0, description="one count, instead of resolver_bits")] = None
    sample_rate_hz: Annotated[float | None, Field(gt=0, le=1e5, description="required if a log has no time column")] = (
        None
    )
    pole_pairs: Annotated[Count | None, Field(description="electrical periods per revolution")] = None
    slots: Annotated[Count | None, Field(description="slots of the stator: cogging occurs at their multiples")] = None
    load_gravity_nm: Annotated[
        float | None,
        Field(
            gt=0, le=1e6, description="largest torque of the load's weight at the motor shaft; checked, never fitted"
        ),
    ] = None
    nominal_delay_s: Annotated[
        float | None,
        Field(ge=0, le=0.1, description="nominal delay from command to torque; a longer delay is reported"),
    ] = None
    absolute_angle: Annotated[bool, Field(description="the zero of the angle is the same in every run")] = False
    units: Annotated[
        Literal["rotary", "linear"], Field(description="linear: m, m/s, N and kg instead of rev, rps, Nm and kg m2")
    ] = "rotary"
    columns: Annotated[
        dict[str, str | ColumnFact] | None, Field(description="signal: column of the file; default: by name")
    ] = None

    @property
    def lsb_rev(self) -> float | None:
        """Resolution of the position; None if it is not declared."""
        if self.position_lsb_rev is not None:
            return self.position_lsb_rev
        return None if self.resolver_bits is None else 1.0 / (1 << self.resolver_bits)

    def hints(self) -> Hints:
        """What a reader of logs is told beforehand."""
        columns = tuple(
            DeclaredColumn(fact, signal)
            if isinstance(fact, str)
            else DeclaredColumn(fact.column, signal, fact.unit, fact.scale, fact.offset)
            for signal, fact in (self.columns or {}).items()
        )
        return Hints(self.sample_rate_hz, pole_pairs=self.pole_pairs, linear=self.units == "linear", columns=columns)


def read_facts(path: str | Path) -> DriveFacts:
    """Read and check a file of declared facts. Raises DocumentError with every error in it."""
    return load(path, DriveFacts)


def facts_of(declared: Mapping[str, Any], linear: bool) -> DriveFacts:
    """The facts of a log of another program: `declared` by the user, a torque constant of one where none is.

    Raises DocumentError with everything that cannot be declared so.
    """
    given = {"torque_constant_nm_per_a": 1.0} | {key: value for key, value in declared.items() if value is not None}
    return check(given | ({"units": "linear"} if linear else {}), DriveFacts, "what is declared")


def facts_text(facts: DriveFacts) -> str:
    """The facts as a file that `--drive` takes."""
    content = {"format": formats.FACTS.word, **facts.model_dump(exclude_defaults=True)}
    return yaml.safe_dump(content, sort_keys=False)
