"""Calling an effect by its address, so that the plant's kernel is compiled once and each effect only when it
is used.

An address is that of the compiled kernel; under NUMBA_DISABLE_JIT=1 it is an index of the Python functions
seen so far. Addresses live in arrays made at run time, never in compiled code, so the plant's kernel stays
cacheable.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from numba import types
from numba.extending import intrinsic, overload

from ....jit import INTERPRETED
from .slots import Vector

EffectKernel = Callable[[Vector, Vector, Vector], None]

_VECTOR = types.Array(types.float64, 1, "C")
_ARGUMENTS = (_VECTOR, _VECTOR, _VECTOR)
_interpreted: list[EffectKernel] = []


def address_of(kernel: EffectKernel) -> int:
    """Compile the kernel (or take it from the cache) and give its address for `call_effect`."""
    if INTERPRETED:
        if kernel not in _interpreted:
            _interpreted.append(kernel)
        return _interpreted.index(kernel)
    dispatcher: Any = kernel
    dispatcher.compile(_ARGUMENTS)
    compiled = dispatcher.overloads[_ARGUMENTS]
    return int(compiled.library.get_pointer_to_function(compiled.fndesc.llvm_func_name))


@intrinsic
def _jump(typingctx: Any, address: Any, signals: Any, parameters: Any, memory: Any) -> Any:
    def codegen(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        kernel_type = context.call_conv.get_function_type(types.none, _ARGUMENTS)
        pointer = builder.inttoptr(arguments[0], kernel_type.as_pointer())
        context.call_conv.call_function(builder, pointer, types.none, _ARGUMENTS, arguments[1:])
        return context.get_dummy_value()

    return types.void(types.int64, _VECTOR, _VECTOR, _VECTOR), codegen


def call_effect(address: int, signals: Vector, parameters: Vector, memory: Vector) -> None:
    """Run the effect kernel at `address` (of `address_of`) on three float64 vectors."""
    _interpreted[address](signals, parameters, memory)


@overload(call_effect)
def _call_effect_overload(address: Any, signals: Any, parameters: Any, memory: Any) -> Any:
    def implementation(address: Any, signals: Any, parameters: Any, memory: Any) -> None:
        # numba supplies the typing context
        _jump(address, signals, parameters, memory)  # type: ignore[call-arg]

    return implementation
