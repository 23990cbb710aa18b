"""Model files: parameters of an axis, with value, standard deviation, unit, provenance and a content hash.

A controller runs one model file. The torque constant is declared, never fitted: current, torque and inertia scale
together.
"""

from __future__ import annotations

import hashlib
import json
import math
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Annotated, Any, Literal

import yaml
from pydantic import Field, model_validator

from .. import formats, units
from ..documents import StrictRecord, check, parse, read_text, refuse
from .axis import AxisConfig
from .effects.law import SHAPE
from .effects.laws.lookup import UNKNOWN, CurveModel, curve_errors, curve_model, packed_curve, packed_sd
from .effects.registry import LAWS, law_of, name_error, parameter_errors
from .effects.table import Term
from .friction import OMEGA_CLIPPED, OMEGA_LITERAL, OMEGA_SIGNED, FrictionConfig

OMEGA_FORMS = {"clipped": OMEGA_CLIPPED, "signed": OMEGA_SIGNED, "literal": OMEGA_LITERAL}


class Quantity(StrictRecord):
    """One number of a model."""

    value: Annotated[float, Field(description="the number, in the unit of its key or of its law")]
    sd: Annotated[float | None, Field(ge=0, description="standard deviation, where it was fitted")] = None
    source: Annotated[str, Field(description="declared, fitted, assumed, or the origin of the value")] = "declared"

    @property
    def assumed(self) -> bool:
        """Neither declared nor measured, as in a first model by `fffo-drive bring-up`."""
        return self.source.startswith("assumed")


class FrictionModel(StrictRecord):
    """2SEP parameters as in Table I of the paper."""

    stribeck: Annotated[Literal["classical", "literal"], Field(description="falling curve, or the sign as printed")] = (
        "classical"
    )
    omega: Annotated[
        Literal["clipped", "signed", "literal"],
        Field(description="how Omega follows from F at a reversal, see model/friction.py"),
    ] = "clipped"
    viscous_nm_per_rps: Annotated[Quantity, Field(description="viscous slope sigma, Nm s/rev")]
    coulomb_nm: Annotated[Quantity, Field(description="Coulomb level Fc, Nm")]
    static_nm: Annotated[Quantity, Field(description="level Fs at break-away, Nm")]
    stribeck_velocity_rps: Annotated[Quantity, Field(description="Stribeck velocity Vs, rev/s")]
    stribeck_exponent: Annotated[Quantity, Field(description="Stribeck exponent delta")]
    stiffness_per_rev: Annotated[
        Quantity, Field(description="K: how fast presliding saturates after a reversal, 1/rev")
    ]
    attraction_nm_per_rev: Annotated[
        Quantity, Field(description="B: how fast friction approaches its steady value, Nm/rev")
    ]


class EffectModel(StrictRecord):
    """An effect in addition to J, Td and friction, by its name in model/effects; its torque opposes the motor's."""

    name: Annotated[str, Field(description="a law of model/effects, or unknown:AXIS")]
    parameters: Annotated[
        dict[str, Quantity],
        Field(description="parameters of a law; for an unknown:AXIS of version 0.1.0, the packed curve"),
    ] = Field(default_factory=dict)
    curve: Annotated[CurveModel | None, Field(description="curve of an unknown:AXIS")] = None
    datum: Annotated[
        Literal["absolute", "run"],
        Field(description="run: a periodic effect has a different phase in every run, and cannot be compensated"),
    ] = "absolute"
    alternatives: list[str] = Field(default_factory=list, description="effects that the data cannot separate from it")
    provenance: Annotated[str, Field(description="the command that fitted it, or the reason given by `diagnose`")] = ""
    brought_by: Annotated[
        str | None, Field(description="package or file with its law; null: a law of fffo-drive itself")
    ] = None

    @model_validator(mode="before")
    @classmethod
    def _whose_law(cls, data: Any) -> Any:
        """What is written names the package without which it cannot be read."""
        name = data.get("name") if isinstance(data, dict) else None
        brought_by = LAWS.brought_by(name) if isinstance(name, str) else None
        return data if brought_by is None or data.get("brought_by") else {**data, "brought_by": brought_by}

    def quantities(self) -> dict[str, Quantity]:
        """All numbers under the names of the law, including those of a curve."""
        if self.curve is None:
            return self.parameters
        sd = packed_sd(self.curve)
        return {key: Quantity(value=value, sd=sd.get(key)) for key, value in packed_curve(self.curve).items()}

    def term(self) -> Term:
        """The effect as input of the kernels."""
        return Term(self.name, {key: quantity.value for key, quantity in self.quantities().items()})


def effect_model(
    name: str, values: Mapping[str, float], sd: Mapping[str, float | None], *,
    datum: Literal["absolute", "run"] = "absolute", alternatives: Sequence[str] = (), provenance: str = "",
) -> EffectModel:  # fmt: skip
    """A found effect for a model file: a free curve as lists, and shapes left out by the search as typical.

    `values`, `sd`: by the names of the law's parameters; no sd, None or one that is not finite: not fitted.
    """
    known = {key: float(one) for key, one in sd.items() if one is not None and math.isfinite(one)}
    common: dict[str, Any] = {"datum": datum, "alternatives": list(alternatives), "provenance": provenance}
    if name.startswith(UNKNOWN):
        return EffectModel(name=name, curve=curve_model(values, known), **common)
    quantities = {}
    for p in law_of(name).parameters:
        if p.name in values:
            spread = known.get(p.name)
            source = "found by search" if spread is None else "fitted"
            quantities[p.name] = Quantity(value=float(values[p.name]), sd=spread, source=source)
        elif p.kind == SHAPE:
            quantities[p.name] = Quantity(value=p.typical, source="typical")
    return EffectModel(name=name, parameters=quantities, **common)


class Provenance(StrictRecord):
    """Origin of the model."""

    date: Annotated[str, Field(description="local date on which it was made, YYYY-MM-DD")] = ""
    tool: Annotated[str, Field(description="program, version and command that wrote it; empty: written by hand")] = ""
    runs: list[str] = Field(default_factory=list, description="SHA-256 of the runs to which it was fitted")
    note: Annotated[str, Field(description="a remark for readers of the file; it has no effect")] = ""


class ModelFile(StrictRecord):
    """A model of an axis."""

    format: Annotated[str, formats.MODEL.key] = formats.MODEL.word
    name: Annotated[str, Field(description="names the model in recordings, reports and the status of `serve`")]
    units: Annotated[
        Literal["rotary", "linear"],
        Field(description="linear: m, m/s and N replace rev, rps and Nm, and `mass_kg` replaces `inertia_kg_m2`"),
    ] = "rotary"
    torque_constant_nm_per_a: Annotated[
        float, Field(gt=0, le=1e6, description="declared, never fitted; for a linear axis, the force constant")
    ]
    inertia_kg_m2: Annotated[Quantity, Field(description="at the motor shaft; `mass_kg` for a linear axis")]
    delay_s: Annotated[Quantity, Field(description="command to measured velocity, without the hold of the command")]
    sensor_delay_s: Annotated[
        Quantity, Field(description="the sensor's share of this delay; declared, as it cannot be fitted")
    ] = Quantity(value=0.0)
    friction: FrictionModel
    effects: list[EffectModel] = Field(default_factory=list, description="effects in addition to friction")
    provenance: Provenance = Provenance()
    content_hash: Annotated[str | None, Field(description="written by the tools; checked if present")] = None

    @model_validator(mode="before")
    @classmethod
    def _mass(cls, data: Any) -> Any:
        """`mass_kg` of a linear axis: force is mass times m/s2, as torque is 2 pi inertia times rev/s2."""
        if not isinstance(data, Mapping) or data.get("units") != "linear" or "mass_kg" not in data:
            return data
        rest = {key: value for key, value in data.items() if key != "mass_kg"}
        return {**rest, "inertia_kg_m2": _scaled(data["mass_kg"], lambda mass: mass / units.TWO_PI)}

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

    def inertia_text(self, *inertias_nm_s2_per_rev: float) -> str:
        """An inertia, or both ends of a range, in the unit of the file."""
        linear = self.units == "linear"
        numbers = [one if linear else units.inertia_kg_m2(one) for one in inertias_nm_s2_per_rev]
        return f"{' to '.join(f'{number:.4g}' for number in numbers)} {'kg' if linear else 'kg m2'}"

    def axis_config(self) -> AxisConfig:
        """The kernel's constants of the whole axis."""
        inertia = units.inertia_nm_s2_per_rev(self.inertia_kg_m2.value)
        return AxisConfig(inertia, self.torque_constant_nm_per_a, self.delay_s.value, self.friction_config())


def _content(model: ModelFile, exclude_none: bool) -> dict[str, Any]:
    """The model as it is written and hashed: `effects` only if there are any, each with its curve or its parameters."""
    content = model.model_dump(mode="json", exclude_none=exclude_none, exclude=set() if model.effects else {"effects"})
    for effect in content.get("effects", []):
        effect.pop("parameters" if effect.get("curve") is not None else "curve", None)
    if model.units == "rotary":  # as files had it before there were others
        del content["units"]
        return content
    return {
        "mass_kg" if key == "inertia_kg_m2" else key: _scaled(value, _mass_kg) if key == "inertia_kg_m2" else value
        for key, value in content.items()
    }


def _mass_kg(inertia_kg_m2: float) -> float:
    """With as many digits as are needed to read it back unchanged."""
    return float(f"{units.TWO_PI * inertia_kg_m2:.15g}")


def _scaled(quantity: Any, convert: Callable[[float], float]) -> Any:
    """A parsed quantity in another unit; anything else as it is."""
    if not isinstance(quantity, Mapping):
        return quantity

    def converted(key: str, value: Any) -> Any:
        number = key in ("value", "sd") and isinstance(value, int | float) and not isinstance(value, bool)
        return convert(value) if number else value

    return {key: converted(key, value) for key, value in quantity.items()}


def content_hash(model: ModelFile) -> str:
    """SHA-256 over everything but the hash itself and the names of packages; over the effects only if there are any."""
    content = _content(model.model_copy(update={"content_hash": None}), exclude_none=False)
    del content["content_hash"]
    for effect in content.get("effects", []):
        del effect["brought_by"]
    return hashlib.sha256(json.dumps(content, sort_keys=True).encode()).hexdigest()


# quantity -> (lowest, highest) allowed; beyond it a unit is wrong or the model is not plausible
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
    return model_of_text(read_text(Path(path)), str(path))


def model_of_text(content: str, name: str) -> ModelFile:
    """The text of a model file, checked. Raises DocumentError with `name` for the file."""
    data, lines = parse(content, name)
    model = check(data, ModelFile, name, lines)
    errors = []
    for key, (low, high) in LIMITS.items():
        quantity: Any = model
        for part in key.split("."):
            quantity = getattr(quantity, part)
        if not low <= quantity.value <= high:
            errors.append((f"{key}.value", f"{quantity.value:g} is outside {low:g} .. {high:g}"))
    errors += [(key, units.text_on(text, model.units == "linear")) for key, text in effect_errors(model.effects)]
    if model.content_hash is not None and model.content_hash != content_hash(model):
        text = "does not match the content: the file was edited by hand. Remove the line to accept the edit, or restore"
        errors.append(("content_hash", f"{text} the file"))
    refuse(name, errors, lines)
    return model


def effect_errors(effects: list[EffectModel]) -> list[tuple[str, str]]:
    """(key, problem) for the effects of a model."""
    errors = []
    for k, effect in enumerate(effects):
        wrong = name_error(effect.name, effect.brought_by)
        if wrong is not None:
            errors.append((f"effects[{k}].name", wrong))
            continue
        if effect.curve is not None:
            errors += [(f"effects[{k}].{key}", text) for key, text in _curve_errors(effect, effect.curve)]
            continue
        if effect.name.startswith(UNKNOWN) and not effect.parameters:
            errors.append((f"effects[{k}].curve", f"missing: {effect.name} is a curve: kind, unit, knots, values"))
        values = {key: quantity.value for key, quantity in effect.parameters.items()}
        errors += [(f"effects[{k}].parameters.{key}", text) for key, text in parameter_errors(effect.name, values)]
    return errors


def _curve_errors(effect: EffectModel, curve: CurveModel) -> list[tuple[str, str]]:
    if not effect.name.startswith(UNKNOWN):
        return [("curve", f"only an effect unknown:AXIS has a curve: {effect.name} has parameters")]
    both = [("parameters", "a curve has all numbers of the effect: leave them out")] if effect.parameters else []
    return both + [(f"curve.{key}", text) for key, text in curve_errors(curve)]


class _Dumper(yaml.SafeDumper):
    """Lists of numbers in flow style, all else in block style."""


def _list_node(dumper: yaml.SafeDumper, items: list[Any]) -> yaml.Node:
    in_lines = all(isinstance(one, int | float | None) for one in items)
    return dumper.represent_sequence("tag:yaml.org,2002:seq", items, flow_style=in_lines)


_Dumper.add_representer(list, _list_node)


def model_text(model: ModelFile) -> str:
    """The model as a file, with its content hash and, for a linear axis, the meaning of its keys."""
    stamped = model.model_copy(update={"content_hash": content_hash(model)})
    text = yaml.dump(_content(stamped, exclude_none=True), Dumper=_Dumper, sort_keys=False, width=110)
    return _names_of_linear(model) + text


def _names_of_linear(model: ModelFile) -> str:
    """A comment with the meaning of each key on a linear axis; the keys are always those of a rotary axis."""
    if model.units == "rotary":
        return ""
    keys = {name: (name, units.unit_in(name)) for name in FrictionModel.model_fields}
    for effect in model.effects:
        for p in law_of(effect.name).parameters:
            if p.name in effect.parameters:
                keys[f"{effect.name}: {p.name}"] = (p.name, p.unit)
        if effect.curve is not None:
            keys[f"{effect.name}: values"] = ("values", effect.curve.unit)
    lines = ["# A linear axis. Keys have the names of a rotary one; what they are here:\n"]
    lines.append("#   torque_constant_nm_per_a: the force constant, in N for a unit of the command (A or V)\n")
    for key, (name, unit) in keys.items():
        if unit in units.LINEAR:
            own = units.name_on(name, unit, linear=True)
            renamed = f" {own}," if own != name else ""
            lines.append(f"#   {key}:{renamed} in {units.unit_on(unit, linear=True)}\n")
    return "".join(lines)


def write_model(path: str | Path, model: ModelFile) -> None:
    """Write a model file with its content hash."""
    Path(path).write_text(model_text(model), encoding="utf-8")
