"""Calling an effect by its address: each is compiled only when it is used, and the plant never again."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from numba import types
from numba.extending import intrinsic, overload

from ..by_address import address_of, emit_call, interpreted_kernel
from .slots import Vector

EffectKernel = Callable[[Vector, Vector, Vector], None]

_VECTOR = types.Array(types.float64, 1, "C")
_ARGUMENTS = (_VECTOR, _VECTOR, _VECTOR)


def effect_address(kernel: EffectKernel) -> int:
    """Address of an effect's kernel for `call_effect`; compiles it when needed."""
    return address_of(kernel, _ARGUMENTS)


@intrinsic
def _jump(typingctx: Any, address: Any, signals: Any, parameters: Any, memory: Any) -> Any:
    def codegen(context: Any, builder: Any, signature: Any, values: Any) -> Any:
        return emit_call(context, builder, _ARGUMENTS, values[0], values[1:])

    return types.void(types.int64, *_ARGUMENTS), codegen


def call_effect(address: int, signals: Vector, parameters: Vector, memory: Vector) -> None:
    """Run the effect kernel at `address` on three float64 vectors."""
    interpreted_kernel(address)(signals, parameters, memory)


@overload(call_effect)
def _call_effect_overload(address: Any, signals: Any, parameters: Any, memory: Any) -> Any:
    def implementation(address: Any, signals: Any, parameters: Any, memory: Any) -> None:
        _jump(address, signals, parameters, memory)

    return implementation
