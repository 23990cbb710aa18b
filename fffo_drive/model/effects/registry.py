"""The registry of effects: every law by its name, and checks of requests for one.

To add an effect to this package, add its file in laws/ and a line in `NAMES`. One of a user's own comes from an
installed package, by an entry point of the group `fffo_drive.effects` that is a Law, or from `register_law`.
"""

from __future__ import annotations

import importlib
import math
import re
import threading
import warnings
from collections.abc import Iterator, Mapping
from importlib import metadata
from pathlib import Path

from ...documents import DocumentError, did_you_mean
from ...jit import INTERPRETED, Kernel
from ...jit.by_address import VectorKernel
from .law import SHAPE, Axis, Law
from .laws.lookup import AXIS_CODES, KNOWN_AHEAD, NO_AXIS, UNKNOWN
from .slots import MAX_PARAMETERS

NAMES = (
    "torque_offset",
    "asymmetric_coulomb",
    "asymmetric_viscous",
    "stribeck_shape",
    "presliding_shape",
    "frictional_lag",
    "second_surface",
    "dwell_stiction",
    "load_dependent_friction",
    "position_dependent_friction",
    "friction_ripple",
    "coulomb_drift",
    "viscous_drift",
    "torque_constant_drift",
    "quadratic_drag",
    "cogging",
    "torque_ripple",
    "unbalance",
    "torque_saturation",
    "dead_zone",
    "voltage_limit",
    "delay",
    "current_lag",
    "elasticity",
    "backlash",
    "resolver_error",
    "periodic_disturbance",
    "lookup",
)
GROUP = "fffo_drive.effects"  # of entry points


class Laws(Mapping[str, Law]):
    """Laws by name: this package's, then those of a user's own.

    The entry points are loaded when all laws are listed, or one is asked for that is not known: most commands need
    none, and a package with a law may import this one.
    """

    def __init__(self, own: Mapping[str, Law]) -> None:
        self._laws = dict(own)
        self._brought_by: dict[str, str] = {}  # law of a user's own -> "package NAME VERSION" or "file NAME"
        self._failed: dict[str, str] = {}  # entry point -> why it is no law
        self._loading = threading.RLock()
        self._loaded = False

    def __getitem__(self, name: str) -> Law:
        if name not in self._laws:
            self._load()
        return self._laws[name]

    def __iter__(self) -> Iterator[str]:
        self._load()
        return iter(tuple(self._laws))

    def __len__(self) -> int:
        self._load()
        return len(self._laws)

    def add(self, law: Law, brought_by: str) -> None:
        """Add a law, or put it in the place of its own former version. Raises DocumentError with what is wrong."""
        with self._loading:
            there = self._laws.get(law.name)
            if there is law:  # its module may also have registered it while the entry point was loaded
                if law.name in self._brought_by and brought_by.startswith("package "):
                    self._brought_by[law.name] = brought_by
                return
            if there is not None and _place_of(there) != _place_of(law):
                whose = self._brought_by.get(law.name, "fffo-drive")
                raise DocumentError(f"law {law.name!r}: {whose} has a law of this name: give it another name")
            problem = _problem_of(law)
            if problem is not None:
                raise DocumentError(f"law {law.name!r}: {problem}")
            self._laws[law.name] = law
            self._brought_by[law.name] = brought_by

    def brought_by(self, name: str) -> str | None:
        """ "package NAME VERSION" or "file NAME" of a law of a user's own; None for one of this package."""
        return self._brought_by.get(name)

    def failure(self, name: str) -> str | None:
        """Why the entry point of this name is no law; None if there is none."""
        self._load()
        return self._failed.get(name)

    def _load(self) -> None:
        with self._loading:
            if self._loaded:
                return
            self._loaded = True
            for entry in metadata.entry_points(group=GROUP):
                package = f"package {entry.dist.name} {entry.dist.version}" if entry.dist else f"module {entry.module}"
                try:
                    law = entry.load()
                    if not isinstance(law, Law):
                        raise DocumentError(f"{entry.value} is a {type(law).__name__}, not a Law")
                    if law.name != entry.name:
                        raise DocumentError(f"its entry point is called {entry.name!r}, its law {law.name!r}")
                    self.add(law, package)
                except Exception as error:  # whatever a module of somebody else raises, the other effects stay usable
                    text = f"the effect {entry.name!r} of the {package} cannot be used: {error}"
                    self._failed[entry.name] = text
                    warnings.warn(text, stacklevel=2)


LAWS = Laws({name: importlib.import_module(f"{__package__}.laws.{name}").LAW for name in NAMES})


def register_law(law: Law) -> None:
    """Make an effect of one's own known to this process: searched, fitted, compensated and reported as any other.

    `law`: see model/effects/law.py. A second call with the same name is for a new version of the same file; to let the
    commands know it as well, install it with an entry point of the group `fffo_drive.effects`.

    Raises DocumentError for what is no law, for a name that is taken, and for parameters that contradict each other.
    """
    if not isinstance(law, Law):
        raise DocumentError(f"law: {type(law).__name__} where a Law of fffo_drive.model.effects.law is needed")
    LAWS.add(law, f"file {_place_of(law)[0].name}")


def _place_of(law: Law) -> tuple[Path, str]:
    """File and name of a law's kernel."""
    function = getattr(law.kernel, "py_func", law.kernel)
    return Path(function.__code__.co_filename), function.__qualname__


def _problem_of(law: Law) -> str | None:
    """What is wrong with a law of a user's own; None if nothing is."""
    if not re.fullmatch(r"[a-z][a-z0-9_]*", law.name) or law.name.startswith(UNKNOWN.rstrip(":")):
        return "its name: small letters, digits and _, and not beginning with 'unknown'"
    kernels = [kernel for kernel in (law.kernel, law.feedforward) if kernel is not None]
    if not INTERPRETED and not all(isinstance(kernel, Kernel) for kernel in kernels):
        return "its kernel is not compiled: put @njit above it (from fffo_drive.jit import njit)"
    names = [p.name for p in law.parameters]
    if not law.strengths or len(names) > MAX_PARAMETERS or len(set(names)) < len(names):
        return f"parameters: at least one strength, at most {MAX_PARAMETERS} in all, and no name twice"
    shapes = {p.name for p in law.shapes}
    for p in law.parameters:
        if p.kind == SHAPE and not p.low <= p.typical <= p.high:
            return f"parameter {p.name!r}: typical {p.typical:g} is outside {p.low:g} to {p.high:g} {p.unit}"
        if not p.low < p.high:
            return f"parameter {p.name!r}: no value is between low {p.low:g} and high {p.high:g}"
        if p.needs and p.needs not in shapes:
            return f"parameter {p.name!r} needs {p.needs!r}, which is none of its shapes: {', '.join(shapes) or 'none'}"
    return None


def law_of(name: str) -> Law:
    """The law of a name; `unknown:AXIS` is the lookup over that axis. Raises KeyError for any other."""
    return LAWS["lookup" if name.startswith(UNKNOWN) else name]


def law_of_kernel(kernel: VectorKernel) -> str:
    """The law whose torque a controller computes by this kernel. Raises KeyError if there is none."""
    for law in LAWS.values():
        if kernel is (law.feedforward or law.kernel):
            return law.name
    raise KeyError(kernel)


def axis_of_effect(name: str) -> Axis:
    """The variable over which an effect acts."""
    if name.startswith(UNKNOWN):
        return next(word for word in AXIS_CODES if word == name.removeprefix(UNKNOWN))
    return LAWS[name].axis


def vector_of(name: str, values: Mapping[str, float]) -> list[float]:
    """Parameters in the kernel's order; of an `unknown:AXIS` the axis comes from the name."""
    given = dict(values)
    if name.startswith(UNKNOWN):
        given["axis"] = float(AXIS_CODES[axis_of_effect(name)])
    return list(law_of(name).filled(given).values())


def is_compensable(name: str, values: Mapping[str, float]) -> bool:
    """Whether feed-forward can supply the torque; for a lookup, only over variables that are known ahead."""
    law = law_of(name)
    if law.name != "lookup":
        return law.compensable
    axes = {vector_of(name, values)[0], values.get("across", NO_AXIS)} - {NO_AXIS}
    return axes <= KNOWN_AHEAD


def name_error(name: str, brought_by: str | None = None) -> str | None:
    """Problem with the name of an effect; None if it is valid. `brought_by`: whose law a model file says it is."""
    if name.startswith(UNKNOWN):
        word = name.removeprefix(UNKNOWN)
        return None if word in AXIS_CODES else f"no axis is called {word!r}: {did_you_mean(word, AXIS_CODES)}"
    if name in LAWS:
        return None
    failure = LAWS.failure(name)
    if failure is not None:
        return failure
    if brought_by is None:
        return f"no effect is called {name!r}: {did_you_mean(name, LAWS)}"
    if brought_by.startswith("file "):
        mend = f"call fd.register_law(LAW) with it first, or install it with an entry point of the group {GROUP}"
    else:
        mend = "install that"
    return f"the effect {name!r} is not known here, its law is in the {brought_by}: {mend}"


def parameter_errors(name: str, values: Mapping[str, float]) -> list[tuple[str, str]]:
    """(parameter, problem) for an effect with a valid name."""
    known = {p.name: p for p in law_of(name).parameters}
    errors = []
    for key, value in values.items():
        if key not in known:
            text = f"effect {name!r} has no parameter {key!r}: {did_you_mean(key, known)}"
            errors.append((key, text))
        elif not (math.isfinite(value) and known[key].low <= value <= known[key].high):
            p = known[key]
            errors.append((key, f"{value:g} is outside {p.low:g} to {p.high:g} {p.unit}"))
    missing = [p.name for p in law_of(name).parameters if p.name not in values and not p.may_be_left_out]
    if missing and law_of(name).name != "lookup":
        errors.append((missing[0], f"missing: effect {name!r} needs its shape ({', '.join(missing)})"))
    return errors
