"""The one place where numba is configured: `njit` for kernels, `generic` for dispatch on a port's type.

Kernels hold no GIL, allocate nothing (one that makes an array or a list does not compile), keep IEEE arithmetic (no
fastmath: compiled and interpreted code agree bit for bit, so a replay is exact) and are cached in a directory that is
named after the content of every file with a kernel in it. numba's own cache key knows only the file of the caller: an
edited callee in another file would go unnoticed. A port of a user's own is keyed by the content of its file, and a
kernel from outside this package by that of all kernels in its folder.

With NUMBA_DISABLE_JIT=1 the same functions run as plain Python.
"""

from __future__ import annotations

import functools
import hashlib
import os
import shutil
import sys
from collections.abc import Callable, Iterable, Iterator
from pathlib import Path
from typing import Any, TypeVar, overload

import numba
from numba import types
from numba.core.caching import FunctionCache
from numba.extending import overload as numba_overload

from ..directories import ForeignDirectoryError, own_directory, shared_place

F = TypeVar("F", bound=Callable[..., Any])

PACKAGE_DIRECTORY = Path(__file__).resolve().parent.parent
# without numba's runtime there is nothing to allocate with, and no reference count of an array is touched: their atomic
# increments were two fifths of the loop's cycle
_OPTIONS: dict[str, Any] = {"nogil": True, "error_model": "numpy", "cache": True, "_nrt": False}
KEPT_CACHES = 4  # older cache directories are deleted: each edit of a kernel makes a new one


def kernel_digest() -> str:
    """Hash over every source file of the package that holds a kernel (16 hex digits)."""
    return _digest(PACKAGE_DIRECTORY, PACKAGE_DIRECTORY.rglob("*.py"))


def _digest(directory: Path, paths: Iterable[Path]) -> str:
    """Hash over those of the files in a directory that hold a kernel (16 hex digits)."""
    digest = hashlib.sha256(numba.__version__.encode())
    for path in sorted(paths):
        content = path.read_bytes()
        if b"njit" in content:
            digest.update(path.relative_to(directory).as_posix().encode())
            digest.update(content)
    return digest.hexdigest()[:16]


@functools.cache
def _digest_beside(path: Path) -> str:
    """Hash over the kernels in the folder of one from outside this package, which may call them; "" for one inside."""
    return "" if PACKAGE_DIRECTORY in path.parents else _digest(path.parent, path.parent.glob("*.py"))


def cache_root() -> Path:
    """Directory that holds all kernel caches: NUMBA_CACHE_DIR, the user's cache, or a temporary directory.

    What lies there is run. Raises ForeignDirectoryError for a temporary one that somebody else has a hand in.
    """
    home_cache = Path(os.environ.get("XDG_CACHE_HOME") or os.path.expanduser("~/.cache"))
    given = [os.environ.get("NUMBA_CACHE_DIR"), os.environ.get("CACHE_DIRECTORY")]
    candidates = [Path(directory) for directory in given if directory]
    if _is_ours(home_cache):  # under sudo it may be another user's
        candidates.append(home_cache / "fffo_drive" / "numba")
    for candidate in candidates:
        try:
            candidate.mkdir(parents=True, exist_ok=True, mode=0o700)
        except OSError:
            continue
        if os.access(candidate, os.W_OK):
            return candidate
    try:
        return own_directory(own_directory(shared_place("fffo_drive")) / "numba")
    except ForeignDirectoryError:
        raise
    except OSError as error:
        raise OSError("no writable directory for compiled code: set NUMBA_CACHE_DIR to one") from error


def _is_ours(path: Path) -> bool:
    """The path, or what there is of it, belongs to the user of this process."""
    there = next((place for place in (path, *path.parents) if place.exists()), path)
    return there.exists() and there.stat().st_uid == os.getuid()


def _use_cache_directory() -> Path:
    root = cache_root()
    directory = root / kernel_digest()
    if not directory.is_dir():
        directory.mkdir(mode=0o700, exist_ok=True)
        caches = [p for p in root.iterdir() if p.is_dir() and len(p.name) == len(directory.name)]
        for old in sorted(caches, key=lambda p: p.stat().st_mtime, reverse=True)[KEPT_CACHES:]:
            shutil.rmtree(old, ignore_errors=True)
    numba.config.CACHE_DIR = str(directory)
    return directory


CACHE_DIRECTORY = _use_cache_directory()
INTERPRETED = bool(numba.config.DISABLE_JIT)


def _named_tuples(kind: Any) -> Iterator[type]:
    """Classes of the named tuples in a numba type, or in a tuple of types."""
    if isinstance(kind, types.BaseNamedTuple):
        yield kind.instance_class
    if isinstance(kind, tuple | types.BaseTuple):
        for part in kind:
            yield from _named_tuples(part)


def _origin(named_tuple: type) -> str:
    """Where a class is from; one from outside this package also by the content of its file, which holds its kernels."""
    name = f"{named_tuple.__module__}.{named_tuple.__qualname__}"
    if named_tuple.__module__.startswith(f"{PACKAGE_DIRECTORY.name}."):
        return name
    path = getattr(sys.modules.get(named_tuple.__module__), "__file__", None)
    return f"{name} {hashlib.sha256(Path(path).read_bytes()).hexdigest() if path else os.getpid()}"


class _KernelCache(FunctionCache):  # type: ignore[misc]
    """numba's cache with text for a signature, since a pickled class can be read only where it can be imported.

    Without it, one script with a port of its own made every other program fail at the loop's cache.
    """

    def _index_key(self, sig: Any, codegen: Any) -> tuple[Any, ...]:
        arguments = tuple(sig) if isinstance(sig, tuple) else sig.args
        origins = sorted({_origin(named_tuple) for named_tuple in _named_tuples(arguments)})
        beside = _digest_beside(Path(self._py_func.__code__.co_filename).resolve())
        return (repr((arguments, origins, beside)), *super()._index_key(sig, codegen)[1:])


@overload
def njit(function: F) -> F: ...
@overload
def njit(*, inline: str = "never") -> Callable[[F], F]: ...
def njit(function: Any = None, *, inline: str = "never") -> Any:
    """Compile a kernel: no GIL, no allocation, no fastmath, division by zero gives inf or nan, cached on disk.

    inline="always": compiled into its callers. A record is handed to a kernel as its fields, each array as seven words,
    so that a call with a port or the blocks copies a hundred words and more.
    """

    def wrap(f: Any) -> Any:
        kernel = numba.njit(f, fastmath=False, forceinline=inline == "always", **_OPTIONS)
        if not INTERPRETED:
            kernel._cache = _KernelCache(f)
        return kernel

    return wrap if function is None else wrap(function)


def generic(declaration: F) -> F:
    """A function whose implementation is chosen by the type of its first argument, a NamedTuple.

    It works alike from Python and inside a kernel, where the choice is made at compile time:
    `@name.register(SomePort)` above a kernel gives the implementation for that type. This is how one loop function
    drives a simulated and a CANopen drive. The body of `declaration` is never run.
    """
    registry: dict[type, Callable[..., Any]] = {}

    def call(first: Any, *rest: Any) -> Any:
        return registry[type(first)](first, *rest)

    call.__name__ = declaration.__name__
    call.__qualname__ = declaration.__qualname__
    call.__module__ = declaration.__module__
    call.__doc__ = declaration.__doc__

    def register(port_type: type) -> Callable[[F], F]:
        def add(implementation: F) -> F:
            registry[port_type] = implementation
            return implementation

        return add

    call.register = register  # type: ignore[attr-defined]

    if not INTERPRETED:

        def choose(first: Any, *rest: Any) -> Any:
            if not isinstance(first, types.BaseNamedTuple):
                return None
            kernel = registry.get(first.instance_class)
            if kernel is None:
                return None

            # a call, not the kernel's own Python function: that would be compiled twice under one symbol and crash
            def implementation(first: Any, *rest: Any) -> Any:
                return kernel(first, *rest)

            return implementation

        options = {name: value for name, value in _OPTIONS.items() if name != "cache"}  # its callers are cached whole
        numba_overload(call, strict=False, jit_options=options | {"forceinline": True})(choose)
    return call  # type: ignore[return-value]
