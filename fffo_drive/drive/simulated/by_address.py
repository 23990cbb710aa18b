"""Calling a kernel by its address, where linking it in would cost too much.

numba copies the code of a kernel into every caller and optimises it again there, level by level. Called by
address, the plant is compiled once, whatever loop is built round it; and of the effects only those that are used
are compiled at all. Addresses live in arrays and records made at run time, never in compiled code, so callers
stay cacheable. Under NUMBA_DISABLE_JIT=1 an address is an index of the Python functions seen so far.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from numba import types

from ...jit import INTERPRETED

_interpreted: list[Callable[..., None]] = []


def address_of(kernel: Callable[..., None], arguments: tuple[Any, ...]) -> int:
    """Compile the kernel for the numba types `arguments` (or take it from the cache) and give its address."""
    if INTERPRETED:
        if kernel not in _interpreted:
            _interpreted.append(kernel)
        return _interpreted.index(kernel)
    dispatcher: Any = kernel
    dispatcher.compile(arguments)
    compiled = dispatcher.overloads[arguments]
    return int(compiled.library.get_pointer_to_function(compiled.fndesc.llvm_func_name))


def interpreted_kernel(address: int) -> Callable[..., None]:
    """The Python function at an address, under NUMBA_DISABLE_JIT=1."""
    return _interpreted[address]


def emit_call(context: Any, builder: Any, arguments: tuple[Any, ...], address: Any, values: Any) -> Any:
    """Code generation of an intrinsic: call the kernel without result at `address` with numba's own convention."""
    kernel_type = context.call_conv.get_function_type(types.none, arguments)
    pointer = builder.inttoptr(address, kernel_type.as_pointer())
    context.call_conv.call_function(builder, pointer, types.none, arguments, values)
    return context.get_dummy_value()
