"""Advancing the plant by the address of `plant_advance`, for kernels that would otherwise carry its code along."""

from __future__ import annotations

from typing import Any

from numba import types
from numba.extending import intrinsic, overload

from .by_address import address_of, emit_call, interpreted_kernel
from .plant import plant_advance
from .state import PlantParameters, PlantState

_FLOATS = types.Array(types.float64, 1, "C")
_INTEGERS = types.Array(types.int64, 1, "C")
_TABLE = types.Array(types.float64, 2, "C")
_ARGUMENTS = (
    types.NamedTuple((_FLOATS, _INTEGERS, _TABLE, _INTEGERS, _TABLE), PlantParameters),
    types.NamedTuple((_FLOATS, _INTEGERS, _TABLE, _FLOATS, _FLOATS, _TABLE), PlantState),
    types.float64,
    types.int64,
)


def plant_address() -> int:
    """Address of `plant_advance` for `call_plant`; compiles it when needed."""
    return address_of(plant_advance, _ARGUMENTS)


@intrinsic
def _jump(typingctx: Any, address: Any, parameters: Any, state: Any, command_a: Any, substeps: Any) -> Any:
    def codegen(context: Any, builder: Any, signature: Any, values: Any) -> Any:
        return emit_call(context, builder, _ARGUMENTS, values[0], values[1:])

    return types.void(types.int64, *_ARGUMENTS), codegen


def call_plant(
    address: int, parameters: PlantParameters, state: PlantState, command_a: float, substeps: int
) -> None:
    """`plant_advance` at `address`."""
    interpreted_kernel(address)(parameters, state, command_a, substeps)


@overload(call_plant)
def _call_plant_overload(address: Any, parameters: Any, state: Any, command_a: Any, substeps: Any) -> Any:
    def implementation(address: Any, parameters: Any, state: Any, command_a: Any, substeps: Any) -> None:
        # numba supplies the typing context
        _jump(address, parameters, state, command_a, substeps)  # type: ignore[call-arg]

    return implementation
