"""Programs of tests that begin as copies of a process that has imported what takes seconds to import.

For tests of what a program does. One of how it starts starts it.
"""

from __future__ import annotations

import multiprocessing
import os
import subprocess
import sys
import tempfile
from collections.abc import Mapping, Sequence
from pathlib import Path
from types import ModuleType
from typing import Any

IMPORTED = (
    "scipy.signal", "scipy.stats", "scipy.optimize", "sklearn.ensemble", "fffo_drive.config.scenario",
    "fffo_drive.diagnosis.diagnose", "fffo_drive.evaluation.campaign", "fffo_drive.drive.simulated.in_process",
)  # fmt: skip


def run_python(arguments: Sequence[Any], cwd: Path, timeout_s: float) -> subprocess.CompletedProcess[str]:
    """`python ARGUMENTS`, a script or `-c` with code, in a directory; what it printed is captured."""
    words = [str(word) for word in arguments]
    if "NUMBA_DISABLE_JIT" in os.environ:  # the copies would be interpreted too
        environment = {name: value for name, value in os.environ.items() if name != "NUMBA_DISABLE_JIT"}
        return subprocess.run(
            [sys.executable, *words], capture_output=True, text=True, cwd=cwd, env=environment, timeout=timeout_s
        )
    context = multiprocessing.get_context("forkserver")
    context.set_forkserver_preload(list(IMPORTED))  # without effect after the first time
    with tempfile.TemporaryDirectory() as folder:
        printed = [Path(folder) / name for name in ("stdout", "stderr")]
        process = context.Process(target=_run, args=(words, str(cwd), dict(os.environ), list(map(str, printed))))
        process.start()
        process.join(timeout_s)
        if process.is_alive():
            process.kill()
            process.join()
            raise subprocess.TimeoutExpired(words, timeout_s)
        out, err = (path.read_text(encoding="utf-8") for path in printed)
        return subprocess.CompletedProcess(words, process.exitcode or 0, out, err)


def _run(words: Sequence[str], cwd: str, environment: Mapping[str, str], printed: Sequence[str]) -> None:
    """In the copy: what an interpreter does with these words."""
    for number, path in enumerate(printed, 1):
        os.dup2(os.open(path, os.O_WRONLY | os.O_CREAT), number)
    sys.stdout, sys.stderr = (os.fdopen(number, "w", encoding="utf-8", closefd=False) for number in (1, 2))
    os.chdir(cwd)
    os.environ.clear()
    os.environ.update(environment)
    main = ModuleType("__main__")
    main.__dict__["__builtins__"] = __builtins__
    sys.modules["__main__"] = main
    if words[0] == "-c":
        sys.argv, place, code, name = ["-c", *words[2:]], "", words[1], "<string>"
    else:
        name = words[0]
        sys.argv, place, code = list(words), str(Path(name).resolve().parent), Path(name).read_text(encoding="utf-8")
        main.__file__ = name
    sys.path.insert(0, place)
    exec(compile(code, name, "exec"), main.__dict__)
