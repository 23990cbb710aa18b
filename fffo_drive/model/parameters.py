"""Model files: what is believed about an axis, with value, standard deviation, unit, provenance and a content hash.

A controller runs one model file. The torque constant is declared, never fitted: current, torque and inertia scale
together.
"""

from __future__ import annotations

import hashlib
import json
from pathlib import Path
from typing import Annotated, Any, Literal

import yaml
from pydantic import Field

from .. import formats, units
from ..documents import Record, load, refuse
from .axis import AxisConfig
from .effects.registry import name_error, parameter_errors
from .effects.table import EffectTable, Term, effect_table
from .friction import OMEGA_CLIPPED, OMEGA_LITERAL, OMEGA_SIGNED, FrictionConfig

OMEGA_FORMS = {"clipped": OMEGA_CLIPPED, "signed": OMEGA_SIGNED, "literal": OMEGA_LITERAL}


class Quantity(Record):
    """One number of a model."""

    value: float
    sd: Annotated[float | None, Field(ge=0, description="standard deviation, where it was fitted")] = None
    source: Annotated[str, Field(description="declared, fitted, or where it was taken from")] = "declared"


class FrictionModel(Record):
    """2SEP parameters as in Table I of the paper."""

    stribeck: Annotated[Literal["classical", "literal"], Field(description="falling curve, or the sign as printed")] = (
        "classical"
    )
    omega: Annotated[
        Literal["clipped", "signed", "literal"], Field(description="reading of (4), see model/friction")
    ] = "clipped"
    viscous_nm_per_rps: Quantity
    coulomb_nm: Quantity
    static_nm: Quantity
    stribeck_velocity_rps: Quantity
    stribeck_exponent: Quantity
    stiffness_per_rev: Quantity
    attraction_nm_per_rev: Quantity


class EffectModel(Record):
    """An effect beside J, Td and friction, by its name in model/effects; its torque is taken from the motor's."""

    name: Annotated[str, Field(description="a law of model/effects, or unknown:AXIS")]
    parameters: dict[str, Quantity]
    datum: Annotated[
        Literal["absolute", "run"],
        Field(description="run: what is periodic has another phase in every run, and cannot be compensated"),
    ] = "absolute"
    alternatives: list[str] = Field(default_factory=list, description="effects that the data could not tell from it")
    provenance: str = ""

    def term(self) -> Term:
        """As the kernels take it."""
        return Term(self.name, {key: quantity.value for key, quantity in self.parameters.items()})


class Provenance(Record):
    """Where the model came from."""

    date: str = ""
    tool: str = ""
    runs: list[str] = Field(default_factory=list, description="SHA-256 of the runs that it was fitted on")
    note: str = ""


class ModelFile(Record):
    """A model of an axis."""

    format: Annotated[str, formats.MODEL.key] = formats.MODEL.word
    name: str
    torque_constant_nm_per_a: Annotated[float, Field(gt=0, le=1e6)]
    inertia_kg_m2: Quantity
    delay_s: Annotated[Quantity, Field(description="command to measured velocity, without the hold of the command")]
    sensor_delay_s: Annotated[
        Quantity, Field(description="the sensor's share of it; declared, it cannot be fitted")
    ] = Quantity(value=0.0)
    friction: FrictionModel
    effects: list[EffectModel] = Field(default_factory=list, description="what else takes torque away")
    provenance: Provenance = Provenance()
    content_hash: Annotated[str | None, Field(description="written by the tools; checked when it is there")] = None

    def friction_config(self) -> FrictionConfig:
        """The kernel's constants."""
        f = self.friction
        exponent = f.stribeck_exponent.value
        return FrictionConfig(
            f.coulomb_nm.value,
            f.static_nm.value,
            f.stribeck_velocity_rps.value,
            abs(exponent) if f.stribeck == "classical" else exponent,
            f.viscous_nm_per_rps.value,
            f.stiffness_per_rev.value,
            f.attraction_nm_per_rev.value,
            OMEGA_FORMS[f.omega],
        )

    def axis_config(self) -> AxisConfig:
        """The kernel's constants of the whole axis."""
        inertia = units.inertia_nm_s2_per_rev(self.inertia_kg_m2.value)
        return AxisConfig(inertia, self.torque_constant_nm_per_a, self.delay_s.value, self.friction_config())

    def effect_terms(self) -> list[Term]:
        """The effects as the kernels take them."""
        return [effect.term() for effect in self.effects]

    def effect_table(self, step_s: float) -> EffectTable:
        """The effects packed for a simulation with this step."""
        return effect_table(self.effect_terms(), self.axis_config(), step_s)


def content_hash(model: ModelFile) -> str:
    """SHA-256 over everything but the hash itself, and over the effects where there are any."""
    content = model.model_dump(mode="json", exclude={"content_hash"} | (set() if model.effects else {"effects"}))
    return hashlib.sha256(json.dumps(content, sort_keys=True).encode()).hexdigest()


# quantity -> (lowest, highest) that a model may have; beyond it a unit is wrong or the model is not one of friction
LIMITS: dict[str, tuple[float, float]] = {
    "inertia_kg_m2": (1e-9, 1e5),
    "delay_s": (0.0, 0.1),
    "sensor_delay_s": (0.0, 0.1),
    "friction.viscous_nm_per_rps": (0.0, 1e3),
    "friction.coulomb_nm": (1e-9, 1e5),
    "friction.static_nm": (1e-9, 1e5),
    "friction.stribeck_velocity_rps": (1e-6, 1e3),
    "friction.stribeck_exponent": (-3.0, 3.0),
    "friction.stiffness_per_rev": (1e-3, 1e8),
    "friction.attraction_nm_per_rev": (1e-9, 1e8),
}


def read_model(path: str | Path) -> ModelFile:
    """Read and check a model file. Raises DocumentError naming file and key."""
    model = load(path, ModelFile)
    errors = []
    for key, (low, high) in LIMITS.items():
        quantity: Any = model
        for part in key.split("."):
            quantity = getattr(quantity, part)
        if not low <= quantity.value <= high:
            errors.append((f"{key}.value", f"{quantity.value:g} is outside {low:g} .. {high:g}"))
    errors += effect_errors(model.effects)
    if model.content_hash is not None and model.content_hash != content_hash(model):
        text = "does not match the content: the file was edited by hand. Remove the line to accept the edit, or restore"
        errors.append(("content_hash", f"{text} the file"))
    refuse(path, errors)
    return model


def effect_errors(effects: list[EffectModel]) -> list[tuple[str, str]]:
    """(key, what is wrong with it) for the effects of a model."""
    errors = []
    for k, effect in enumerate(effects):
        wrong = name_error(effect.name)
        if wrong is not None:
            errors.append((f"effects[{k}].name", wrong))
            continue
        values = {key: quantity.value for key, quantity in effect.parameters.items()}
        errors += [(f"effects[{k}].parameters.{key}", text) for key, text in parameter_errors(effect.name, values)]
    return errors


def model_text(model: ModelFile) -> str:
    """The model as a file, with its content hash."""
    stamped = model.model_copy(update={"content_hash": content_hash(model)})
    content = stamped.model_dump(mode="json", exclude_none=True, exclude=set() if model.effects else {"effects"})
    return yaml.safe_dump(content, sort_keys=False, width=110)


def write_model(path: str | Path, model: ModelFile) -> None:
    """Write a model file with its content hash."""
    Path(path).write_text(model_text(model), encoding="utf-8")
