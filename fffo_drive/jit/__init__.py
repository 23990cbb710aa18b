"""The one place where numba is configured: `njit` for kernels, `generic` for dispatch on a port's type.

Kernels hold no GIL, allocate nothing (one that makes an array or a list does not compile), keep IEEE arithmetic (no
fastmath: compiled and interpreted code agree bit for bit, so a replay is exact) and are cached in a directory that is
named after the content of every file with a kernel in it. numba's own cache key knows only the file of the caller: an
edited callee in another file would go unnoticed. A port of a user's own is keyed by the content of its file, and a
kernel from outside this package by that of all kernels in its folder.

numba itself takes longer to import than most commands take to run, so it is loaded with the first kernel that is called
from Python (`compiler`); until then a kernel is a name and a Python function. With NUMBA_DISABLE_JIT=1 the same
functions run as plain Python, and it is never loaded.
"""

from __future__ import annotations

import functools
import hashlib
import os
import shutil
import time
from collections.abc import Callable, Iterable
from importlib import metadata
from pathlib import Path
from typing import Any, TypeVar, overload

from ..directories import ForeignDirectoryError, own_directory, shared_place

F = TypeVar("F", bound=Callable[..., Any])

PACKAGE_DIRECTORY = Path(__file__).resolve().parent.parent
KEPT_CACHES = 4  # older cache directories are deleted: each edit of a kernel makes a new one


def kernel_digest() -> str:
    """Hash over every source file of the package that holds a kernel (16 hex digits)."""
    return digest_of(PACKAGE_DIRECTORY, PACKAGE_DIRECTORY.rglob("*.py"))


def digest_of(directory: Path, paths: Iterable[Path]) -> str:
    """Hash over those of the files in a directory that hold a kernel, or declare something to it (16 hex digits)."""
    digest = hashlib.sha256(metadata.version("numba").encode())
    for path in sorted(paths):
        content = path.read_bytes()
        if b"njit" in content or b"when_compiling" in content:
            digest.update(path.relative_to(directory).as_posix().encode())
            digest.update(content)
    return digest.hexdigest()[:16]


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


@functools.cache
def cache_directory() -> Path:
    """Directory of the compiled code of these kernels; makes it, and deletes the oldest of its kind."""
    root = cache_root()
    directory = root / kernel_digest()
    if not directory.is_dir():
        directory.mkdir(mode=0o700, exist_ok=True)
        caches = [p for p in root.iterdir() if p.is_dir() and len(p.name) == len(directory.name)]
        for old in sorted(caches, key=lambda p: p.stat().st_mtime, reverse=True)[KEPT_CACHES:]:
            shutil.rmtree(old, ignore_errors=True)
    return directory


def _is_switched_off(text: str) -> bool:
    """NUMBA_DISABLE_JIT as numba reads it."""
    try:
        return bool(int(text))
    except ValueError:
        return False


INTERPRETED = _is_switched_off(os.environ.get("NUMBA_DISABLE_JIT", ""))


class Kernel:
    """A function that numba compiles when it is called, or when a kernel that calls it is compiled.

    It has all attributes of numba's dispatcher, which is made when the first of them is asked for.
    """

    def __init__(self, py_func: Callable[..., Any], inline: bool) -> None:
        functools.update_wrapper(self, py_func)
        self.py_func = py_func
        self.inline = inline

    def __call__(self, *arguments: Any, **named: Any) -> Any:
        return self.dispatcher(*arguments, **named)

    def __getattr__(self, name: str) -> Any:  # of what is not here yet; numba types a kernel by its `_numba_type_`
        if name.startswith("__"):
            raise AttributeError(name)
        if name == "dispatcher":
            from .compiler import dispatcher_of

            return dispatcher_of(self)
        return getattr(self.dispatcher, name)

    def __reduce__(self) -> str:  # by name, which is that of the function
        return self.py_func.__qualname__


LONG_S = 2.0  # of compiling, after which it is said: one small kernel takes less
_told: list[Callable[[], None]] = []
_first_s: list[float] = []


def say_when_compiling(tell: Callable[[], None]) -> None:
    """Have it told, once, that this process compiles for longer than LONG_S: the first start of a version does."""
    _told[:] = [tell]
    _first_s.clear()


def compiling(now_s: float | None = None) -> None:
    """A kernel is about to be compiled. `now_s`: None for the clock's time."""
    now_s = time.monotonic() if now_s is None else now_s
    _first_s[:] = _first_s or [now_s]
    if _told and now_s - _first_s[0] > LONG_S:
        _told.pop()()


declarations: list[Callable[[], None]] = []


def when_compiling(declare: Callable[[], None]) -> Callable[[], None]:
    """Declare to numba what is not a kernel (overloads, intrinsics) once it is loaded; never if nothing is compiled."""
    if not INTERPRETED:
        declarations.append(declare)
    return declare


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
        return f if INTERPRETED else Kernel(f, inline == "always")

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

    when_compiling(lambda: _declare_choice(call, registry))
    return call  # type: ignore[return-value]


def _declare_choice(call: Callable[..., Any], registry: dict[type, Callable[..., Any]]) -> None:
    from .compiler import declare_choice

    declare_choice(call, registry)
