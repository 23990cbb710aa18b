"""C compiled on the spot, on the same memory as the kernels: records become structs, arrays become pointers.

The declarations are made from the Python records, dtypes and constants, so that no field is listed a second time and a
C source that no longer fits does not compile.
"""

from __future__ import annotations

import ctypes
import os
import re
import shutil
import struct
import subprocess
import tempfile
from collections.abc import Mapping, Sequence
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np

SOURCES = Path(__file__).resolve().parent / "c"
# what a distribution builds with; products and sums are not fused, so that C rounds as the kernels do
FLAGS = ("-O2", "-std=gnu11", "-ffp-contract=off", "-Wall", "-Wextra", "-Werror", "-fPIC", "-shared")
_SCALARS = {"<f8": "double", "<i8": "int64_t", "<u8": "uint64_t", "<i4": "int32_t", "<u4": "uint32_t"}
_SCALARS |= {"<i2": "int16_t", "<u2": "uint16_t", "|u1": "uint8_t", "|i1": "int8_t"}


class NoCompilerError(Exception):
    """There is no C compiler to compare with."""


class Declarations:
    """C declarations, in the order in which they were asked for."""

    def __init__(self) -> None:
        self._parts: dict[str, str] = {}
        self._dtypes: dict[np.dtype[Any], str] = {}

    @property
    def text(self) -> str:
        """All of it, as a header."""
        return "#pragma once\n#include <stdint.h>\n" + "".join(self._parts.values())

    def constants(self, module: ModuleType, *beginnings: str) -> None:
        """Upper-case numbers of a module (those whose names begin so) as #defines under their own names."""
        self.numbers({name: value for name, value in vars(module).items() if name.startswith(beginnings or "")})

    def numbers(self, values: Mapping[str, Any]) -> None:
        """Numbers with upper-case names as #defines; whatever else is in the mapping is passed over.

        Raises ValueError for a name that stands for another number already.
        """
        for name, value in values.items():
            if name.isupper() and not name.startswith("_") and isinstance(value, (int, float)):
                line = f"#define {name} {value!r}{'LL' if isinstance(value, int) else ''}\n"
                if self._parts.setdefault(name, line) != line:
                    raise ValueError(f"{name} has two values: {line.strip()} and {self._parts[name].strip()}")

    def dtype(self, name: str, dtype: np.dtype[Any]) -> None:
        """A structured dtype as `struct name`."""
        fields = [f"    {_SCALARS[dtype[i].str]} {field};\n" for i, field in enumerate(dtype.names or ())]
        check = f'_Static_assert(sizeof(struct {name}) == {dtype.itemsize}, "layout of {name}");\n'
        self._parts[name] = f"struct {name} {{\n{''.join(fields)}}};\n{check}"
        self._dtypes[dtype] = name

    def record(self, value: Any) -> None:
        """The type of a NamedTuple, and of the records in it, as structs named as they are, in snake case."""
        name = _struct_name(value)
        if name in self._parts:
            return
        fields = "".join(self._field(field, item) for field, item in zip(value._fields, value, strict=True))
        self._parts[name] = f"struct {name} {{\n{fields}}};\n"

    def unpacking(self, name: str, value: Any, names: Sequence[str]) -> None:
        """A function that fills a record from its packed numbers, `names` in their order (fffo_drive.packing)."""
        lines = [f"    c->{field} = block[{place}];\n" for place, field in enumerate(names)]
        head = f"static inline void {name}(const double *block, struct {_struct_name(value)} *c)\n"
        self._parts[name] = f"{head}{{\n{''.join(lines)}}}\n"

    def _field(self, name: str, value: Any) -> str:
        if isinstance(value, (bool, int, np.integer)):
            return f"    int64_t {name};\n"
        if isinstance(value, float):
            return f"    double {name};\n"
        if isinstance(value, np.ndarray):
            base = self._dtypes.get(value.dtype)
            kind = f"struct {base}" if base else _SCALARS[value.dtype.str]
            inner = "".join(f"[{size}]" for size in value.shape[1:])
            pointer = f"(*{name}){inner}" if inner else f"*{name}"
            return f"    {kind} {pointer};\n    int64_t {name}_n;\n"
        self.record(value)
        return f"    struct {_struct_name(value)} {name};\n"


def packed(value: Any) -> bytes:
    """A NamedTuple as the bytes of its struct. Its arrays are referred to, not copied: keep them alive."""
    parts = []
    for item in value:
        if isinstance(item, np.ndarray):
            assert item.flags.c_contiguous
            parts.append(struct.pack("@qq", item.ctypes.data, item.shape[0]))
        elif isinstance(item, float):
            parts.append(struct.pack("@d", item))
        elif isinstance(item, tuple):
            parts.append(packed(item))
        else:
            parts.append(struct.pack("@q", int(item)))
    return b"".join(parts)


def compiler() -> str:
    """The C compiler: CC, or gcc. Raises NoCompilerError."""
    name = os.environ.get("CC", "gcc")
    path = shutil.which(name)
    if path is None:
        raise NoCompilerError(
            f"this benchmark compares with C, and there is no '{name}': apt install gcc, or name a C compiler with CC="
        )
    return path


def compile_c(source: str, declarations: str = "") -> ctypes.CDLL:
    """Compile c/`source` with `declarations` as its "declarations.h" and load it. Raises NoCompilerError."""
    path = compiler()
    with tempfile.TemporaryDirectory(prefix="fffo_drive_benchmark_") as directory:
        header = Path(directory) / "declarations.h"
        header.write_text(declarations)
        library = Path(directory) / "library.so"
        command = [path, *FLAGS, "-I", directory, "-o", str(library), str(SOURCES / source), "-lm"]
        done = subprocess.run(command, capture_output=True, text=True)
        if done.returncode != 0:
            raise RuntimeError(f"{' '.join(command)}\n{done.stderr}")
        return ctypes.CDLL(str(library))


def compiler_version() -> str:
    """First line of `cc --version`."""
    done = subprocess.run([compiler(), "--version"], capture_output=True, text=True, check=True)
    return done.stdout.splitlines()[0]


def _struct_name(value: Any) -> str:
    return re.sub(r"(?<=[a-z0-9])(?=[A-Z])", "_", type(value).__name__).lower()
