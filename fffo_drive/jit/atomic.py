"""Atomic loads and stores on int64 arrays, for words that two threads share (ring head, sequence numbers, stop).

Compiled code uses acquire and release; the interpreter holds the GIL and needs nothing.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from . import when_compiling

Words = np.ndarray[Any, np.dtype[np.int64]]


def load_acquire(words: Words, index: int) -> int:
    """words[index], and everything written before its release is seen."""
    return int(words[index])


def store_release(words: Words, index: int, value: int) -> None:
    """words[index] = value, after everything written before."""
    words[index] = value


@when_compiling
def _for_kernels() -> None:
    """The same in compiled code."""
    from numba import types
    from numba.extending import intrinsic, overload
    from numba.np.arrayobj import make_array

    def word_pointer(context: Any, builder: Any, array_type: Any, array: Any, index: Any) -> Any:
        struct = make_array(array_type)(context, builder, array)
        return builder.gep(struct.data, [index])

    @intrinsic
    def load(typingctx: Any, words: Any, index: Any) -> Any:
        def codegen(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
            pointer = word_pointer(context, builder, signature.args[0], arguments[0], arguments[1])
            return builder.load_atomic(pointer, "acquire", 8)

        return types.int64(words, types.int64), codegen

    @intrinsic
    def store(typingctx: Any, words: Any, index: Any, value: Any) -> Any:
        def codegen(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
            pointer = word_pointer(context, builder, signature.args[0], arguments[0], arguments[1])
            builder.store_atomic(arguments[2], pointer, "release", 8)
            return context.get_dummy_value()

        return types.void(words, types.int64, types.int64), codegen

    @overload(load_acquire)
    def load_compiled(words: Any, index: Any) -> Any:
        def implementation(words: Any, index: Any) -> Any:
            return load(words, index)

        return implementation

    @overload(store_release)
    def store_compiled(words: Any, index: Any, value: Any) -> Any:
        def implementation(words: Any, index: Any, value: Any) -> Any:
            store(words, index, value)

        return implementation
