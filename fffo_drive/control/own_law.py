"""A control law of a user's own: Config, State and step, run in the loop's tick in place of PI with friction observer.

    current_a, state = step(config, state, seen)

The loop calls it by its address, so that nothing of the loop is compiled again. A step with @njit above it runs at the
speed of the loop, and on a drive; any other is called as the Python function that it is, and only in a simulation.
Reference, velocity and compensated effects are what the loop's own law gets; behind the law stand the same limit of its
current, envelope, row and replay. Its memory is at rest whenever the drive has no torque.
"""

from __future__ import annotations

import ctypes
import functools
import hashlib
import itertools
import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from ..arrays import Floats
from ..documents import DocumentError, did_you_mean
from ..jit import INTERPRETED, Kernel, njit
from ..jit.by_address import VectorKernel, call_on_vectors, vectors_address
from ..packing import flat_names, pack, reader, writer
from .controller import ControllerConfig, ControllerState, ControllerTerms
from .feedforward import Reference

MOST_NUMBERS = 64  # of a config, and of a state


class LawInput(NamedTuple):
    """What a law sees in a tick."""

    period_s: float
    reference_rps: float  # at this tick
    reference_rps2: float
    ahead_rps: float  # that the torque of this tick meets: as far ahead as the file's feedforward reads
    ahead_rps2: float
    expected_rps: float  # that the velocity below has if the axis follows exactly
    velocity_rps: float  # of the drive, or estimated, as the axis file says
    error_rps: float  # the last but one less the last
    position_rev: float
    effects_nm: float  # torque of the model's effects that is to be compensated
    torque_constant_nm_per_a: float
    current_limit_a: float
    limited: bool  # the last command was cut, by this limit or by the envelope


Step = Callable[[Any, Any, LawInput], tuple[float, Any]]

# places in the law's block
USED = 0
ADDRESS = 1
RUNNING = 2  # 1 after the first step
INPUT = 3
REQUESTED_A = len(LawInput._fields)  # behind the input
CONFIG = INPUT + REQUESTED_A + 1
AT_REST = CONFIG + MOST_NUMBERS
MEMORY = AT_REST + MOST_NUMBERS
BLOCK_SIZE = MEMORY + MOST_NUMBERS


def no_own_law() -> Floats:
    """The block of a loop that runs the law of its axis file. (BLOCK_SIZE,)"""
    return np.zeros(BLOCK_SIZE)


@dataclass(frozen=True)
class ControlLaw:
    """A control law.

    `config`: a NamedTuple of numbers. `at_rest`: the state before the first tick, a NamedTuple of numbers; of a step
    without @njit it may be anything. `step`: see above. Raises DocumentError for what is none of these.
    """

    name: str
    config: Any
    at_rest: Any
    step: Step

    def __post_init__(self) -> None:
        """Refuse what cannot be packed or called."""
        if not self.name:
            raise DocumentError("controller: a law needs a name")
        _require_numbers(f"controller {self.name!r}: config", self.config)
        if self.compiled:
            _require_numbers(f"controller {self.name!r}: at_rest", self.at_rest)
        if not callable(self.step):
            raise DocumentError(f"controller {self.name!r}: step: {type(self.step).__name__} is not a function")

    @property
    def compiled(self) -> bool:
        """Whether its step is compiled into the loop; without compilation at all, whether it could be."""
        return isinstance(self.step, Kernel) or (INTERPRETED and hasattr(self.at_rest, "_fields"))

    @property
    def file(self) -> str:
        """Name of the file with its step."""
        return Path(_function(self.step).__code__.co_filename).name

    def change(self, **values: float) -> ControlLaw:
        """The law with other numbers in its config. Raises DocumentError for one that it does not have."""
        unknown = next((name for name in values if name not in self.config._fields), None)
        if unknown is not None:
            text = did_you_mean(unknown, self.config._fields)
            raise DocumentError(f"controller {self.name!r}: config has no {unknown!r}: {text}")
        return replace(self, config=self.config._replace(**values))

    def block(self) -> Floats:
        """The law for a loop, memory at rest. (BLOCK_SIZE,). Raises DocumentError for a step that does not compile."""
        block = no_own_law()
        block[USED] = 1.0
        if not self.compiled:
            number = next(_numbers)
            _called[number] = self
            block[ADDRESS], block[CONFIG] = vectors_address(_python_kernel()), number
            return block
        config, memory = pack(self.config), pack(self.at_rest)
        block[CONFIG : CONFIG + config.size] = config
        block[AT_REST : AT_REST + memory.size] = memory
        try:
            kinds: tuple[Any, Any] = type(self.config), type(self.at_rest)
            block[ADDRESS] = vectors_address(_compiled_kernel(self.step, *kinds))
        except Exception as error:
            text = " ".join(str(error).split())
            raise DocumentError(
                f"controller {self.name!r}: step does not compile: it may use numbers, math, its records and other "
                f"functions with @njit, and returns (current in A, state): {text}"
            ) from error
        return block


def require_law(name: str, law: object) -> None:
    """Raise DocumentError for an argument of this name that is no law."""
    if not isinstance(law, ControlLaw):
        what = "function" if callable(law) else type(law).__name__
        raise DocumentError(f"{name}: a {what} where a fd.ControlLaw(name, config, at_rest, step) is needed")


def _require_numbers(what: str, record: Any) -> None:
    """Raise DocumentError for what is no NamedTuple of numbers."""
    if not hasattr(record, "_fields"):
        raise DocumentError(f"{what}: {type(record).__name__} where a NamedTuple of numbers is needed")
    try:
        numbers = pack(record)
        names = flat_names(type(record))
    except (TypeError, ValueError, NameError, KeyError) as error:
        raise DocumentError(f"{what}: a NamedTuple of numbers is needed, each with its type: {error}") from None
    if len(names) != numbers.size or numbers.size > MOST_NUMBERS:
        raise DocumentError(f"{what}: {numbers.size} numbers: at most {MOST_NUMBERS}, each with its type")
    bad = next((name for name, value in zip(names, numbers, strict=True) if not math.isfinite(value)), None)
    if bad is not None:
        raise DocumentError(f"{what}: {bad} is not a finite number")


def _function(step: Step) -> Any:
    return getattr(step, "py_func", step)


@functools.cache
def _compiled_kernel(step: Step, config: Any, state: Any) -> VectorKernel:
    """The step as a kernel on three vectors: input, config, memory."""
    code = _function(step).__code__
    file = Path(code.co_filename)
    # compiled readers are kept on disk by their names: those of another law, or of another version, have others
    origin = file.read_bytes() if file.is_file() else repr((id(step), np.random.default_rng().bytes(16))).encode()
    records = [(one.__module__, one.__qualname__, one.__annotations__) for one in (config, state)]
    digest = hashlib.sha256(origin + repr(records).encode()).hexdigest()[:16]
    space = {
        "step": step,
        "read_config": njit(reader(config, f"read_config_{digest}")),
        "read_state": njit(reader(state, f"read_state_{digest}")),
        "read_input": _read_input,
        "write_state": njit(writer(state, f"write_state_{digest}")),
    }
    text = f"""\
def own_law(signals, parameters, memory):
    current_a, state = step(read_config(parameters), read_state(memory), read_input(signals))
    write_state(state, memory)
    signals[{REQUESTED_A}] = current_a
"""
    return _made(text, space)


def _made(text: str, space: dict[str, Any]) -> VectorKernel:
    exec(compile(text, "<control law>", "exec"), space)  # no file: such a kernel is not kept on disk
    made: VectorKernel = njit(space["own_law"])
    return made


_input_of = reader(LawInput, "read_law_input")
_read_input = njit(_input_of)
_write_input = njit(writer(LawInput, "write_law_input"))

_numbers = itertools.count()
_called: dict[int, ControlLaw] = {}  # laws at the speed of Python, by the number in their blocks
_states: dict[int, Any] = {}  # their states, by the address of the loop's memory for them
_failures: dict[int, BaseException] = {}  # ... and what their steps raised


def _call(signals_at: int, parameters_at: int, memory_at: int) -> None:
    """One step of a law at the speed of Python. What it raises is kept, and the envelope trips on its command."""
    signals = (ctypes.c_double * (REQUESTED_A + 1)).from_address(signals_at)
    begun = ctypes.c_double.from_address(memory_at)
    law = _called[int(ctypes.c_double.from_address(parameters_at).value)]
    try:
        before = law.at_rest if begun.value == 0.0 else _states[memory_at]
        begun.value = 1.0
        current_a, _states[memory_at] = law.step(law.config, before, _input_of(signals))
        signals[REQUESTED_A] = float(current_a)
    except BaseException as error:
        _failures.setdefault(memory_at, error)
        signals[REQUESTED_A] = math.nan


@functools.cache
def _python_kernel() -> VectorKernel:
    """The kernel that calls `_call`, with the lock of the interpreter."""
    c_call = ctypes.CFUNCTYPE(None, ctypes.c_size_t, ctypes.c_size_t, ctypes.c_size_t)(_call)
    text = """\
def own_law(signals, parameters, memory):
    c_call(signals.ctypes.data, parameters.ctypes.data, memory.ctypes.data)
"""
    return _made(text, {"c_call": c_call})


def forget_failure(block: Floats) -> None:
    """Before a loop begins: an earlier one may have had its memory at the same address."""
    _failures.pop(block[MEMORY:].ctypes.data, None)


def failure_of(block: Floats) -> BaseException | None:
    """What the step of a law at the speed of Python raised in the loop with this block; None if nothing."""
    return _failures.get(block[MEMORY:].ctypes.data)


@njit
def own_law_rest(block: Floats) -> None:
    """The law does not act: its next step begins at rest."""
    block[RUNNING] = 0.0


@njit
def own_law_step(
    block: Floats,
    config: ControllerConfig,
    state: ControllerState,
    reference: Reference,
    added_nm: float,
    followed_rps: float,
    position_rev: float,
) -> tuple[ControllerTerms, ControllerState]:
    """One period of the law, in place of `controller_step`; of its terms only error and command are known."""
    if block[RUNNING] == 0.0:
        block[RUNNING] = 1.0
        for k in range(MOST_NUMBERS):
            block[MEMORY + k] = block[AT_REST + k]
    signals = block[INPUT:CONFIG]
    error_rps = reference.expected - followed_rps
    seen = LawInput(
        config.period_s,
        reference.value,
        reference.derivative,
        reference.ahead,
        reference.ahead_derivative,
        reference.expected,
        followed_rps,
        error_rps,
        position_rev,
        added_nm,
        config.torque_constant_nm_per_a,
        config.current_limit_a,
        state.limited,
    )
    _write_input(seen, signals)
    call_on_vectors(int(block[ADDRESS]), signals, block[CONFIG:AT_REST], block[MEMORY:])
    requested_a = signals[REQUESTED_A]
    limit_a = config.current_limit_a
    command_a = requested_a
    if math.isfinite(requested_a):
        command_a = min(max(requested_a, -limit_a), limit_a)
    limited = command_a != requested_a
    terms = ControllerTerms(error_rps, error_rps, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, requested_a, command_a, limited)
    after = ControllerState(
        0.0, error_rps, state.friction, state.toggle, limited, state.rest, state.hold, state.notches
    )
    return terms, after
