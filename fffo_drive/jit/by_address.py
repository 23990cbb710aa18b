"""Calling a kernel by its address, where linking it in would cost too much.

numba copies the code of a kernel into every caller and optimises it again there, level by level. Called by address, a
plant is compiled once, whatever loop is built round it; and of a library of effects only those that are used are
compiled at all. Addresses live in arrays and records made at run time, never in compiled code, so callers stay
cacheable. Under NUMBA_DISABLE_JIT=1 an address is an index of the Python functions seen so far.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import cache
from typing import Any

import numpy as np

from . import INTERPRETED, when_compiling

Vector = np.ndarray[Any, np.dtype[np.float64]]
VectorKernel = Callable[[Vector, Vector, Vector], None]

_interpreted: list[Callable[..., None]] = []


def address_of(kernel: Callable[..., None], arguments_of: Callable[[], tuple[Any, ...]]) -> int:
    """Compile the kernel for the numba types of its arguments (or take it from the cache) and give its address."""
    if INTERPRETED:
        if kernel not in _interpreted:
            _interpreted.append(kernel)
        return _interpreted.index(kernel)
    dispatcher: Any = kernel
    arguments = arguments_of()
    dispatcher.compile(arguments)
    compiled = dispatcher.overloads[arguments]
    return int(compiled.library.get_pointer_to_function(compiled.fndesc.llvm_func_name))


def interpreted_kernel(address: int) -> Callable[..., None]:
    """The Python function at an address, under NUMBA_DISABLE_JIT=1."""
    return _interpreted[address]


def emit_call(context: Any, builder: Any, arguments: tuple[Any, ...], address: Any, values: Any) -> Any:
    """Code generation of an intrinsic: call the kernel without result at `address` with numba's own convention."""
    from numba import types

    kernel_type = context.call_conv.get_function_type(types.none, arguments)
    pointer = builder.inttoptr(address, kernel_type.as_pointer())
    context.call_conv.call_function(builder, pointer, types.none, arguments, values)
    return context.get_dummy_value()


_vector_kernels: dict[int, VectorKernel] = {}


@cache
def _vectors() -> tuple[Any, ...]:
    from numba import types

    return (types.Array(types.float64, 1, "C"),) * 3


@cache
def vectors_address(kernel: VectorKernel) -> int:
    """Address of a kernel on three float64 vectors for `call_on_vectors`; compiles it when needed."""
    address = address_of(kernel, _vectors)
    _vector_kernels[address] = kernel
    return address


def vector_kernel_at(address: int) -> VectorKernel:
    """The kernel that `vectors_address` gave this address. Raises KeyError for any other number."""
    return _vector_kernels[address]


def call_on_vectors(address: int, first: Vector, second: Vector, third: Vector) -> None:
    """Run the kernel at `address` on three float64 vectors."""
    interpreted_kernel(address)(first, second, third)


@when_compiling
def _for_kernels() -> None:
    """The same in compiled code."""
    from numba import types
    from numba.extending import intrinsic, overload

    @intrinsic
    def jump(typingctx: Any, address: Any, first: Any, second: Any, third: Any) -> Any:
        def codegen(context: Any, builder: Any, signature: Any, values: Any) -> Any:
            return emit_call(context, builder, _vectors(), values[0], values[1:])

        return types.void(types.int64, *_vectors()), codegen

    @overload(call_on_vectors)
    def call_compiled(address: Any, first: Any, second: Any, third: Any) -> Any:
        def implementation(address: Any, first: Any, second: Any, third: Any) -> None:
            jump(address, first, second, third)

        return implementation
