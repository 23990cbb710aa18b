"""The same jobs on this processor and on a plain one, and what differs: `tools/numerics [WORD...]`.

The plain processor is this one without what newer ones have: NumPy's vector features are off, the linear algebra takes
its kernels for an old processor, compiled code and the C library do without AVX and fused multiply-add. Both use one
thread of the linear algebra.
"""

from __future__ import annotations

import json
import math
import os
import platform
import reprlib
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any, NamedTuple

from numerics.jobs import JOBS, chosen, vector_features

TINY = 1e-12  # in the unit of a number: below, a difference is none
SHOWN = 12  # differences of a job that are printed
SAME = {"OPENBLAS_NUM_THREADS": "1"}


class Difference(NamedTuple):
    """A number or a text that is not the same on both."""

    key: str
    here: Any
    plain: Any
    relative: float  # inf: no number, or missing on one of them


def plain_processor() -> dict[str, str]:
    """The environment in which a process sees a plain processor."""
    found = {
        "NPY_DISABLE_CPU_FEATURES": " ".join(vector_features()),
        "NUMBA_CPU_NAME": "generic",
        "NUMBA_CPU_FEATURES": "",
    }
    if platform.machine() == "x86_64":
        found["OPENBLAS_CORETYPE"] = "Nehalem"
        found["GLIBC_TUNABLES"] = "glibc.cpu.hwcaps=-AVX512F,-AVX2,-FMA,-FMA4"
    return found


def differences(here: Any, plain: Any, key: str = "") -> Iterator[Difference]:
    """Every number and text of two answers that differs, numbers by more than TINY."""
    if isinstance(here, dict) and isinstance(plain, dict):
        for name in dict.fromkeys([*here, *plain]):
            place = f"{key}.{name}" if key else name
            yield from differences(here.get(name), plain.get(name), place)
    elif isinstance(here, list) and isinstance(plain, list) and len(here) == len(plain):
        for number, pair in enumerate(zip(here, plain, strict=True)):
            yield from differences(*pair, f"{key}[{number}]")
    elif type(here) is type(plain) is float:
        if abs(here - plain) > TINY:
            yield Difference(key, here, plain, abs(here - plain) / max(abs(here), abs(plain)))
        elif math.isfinite(here) != math.isfinite(plain):
            yield Difference(key, here, plain, math.inf)
    elif here != plain:
        yield Difference(key, here, plain, math.inf)


def compared(here: dict[str, Any], plain: dict[str, Any]) -> tuple[list[str], list[str]]:
    """A line a job, and lines about what differs by more than it may."""
    lines, failures = [], []
    for name in here:
        job = JOBS[name]
        found = sorted(differences(here[name], plain[name]), key=lambda one: -one.relative)
        worst = f"{found[0].relative:.1e} in {found[0].key}" if found else "none"
        lines.append(f"{name:<36} allowed {job.tolerance:.0e}, largest {worst}")
        beyond = [one for one in found if not one.relative <= job.tolerance]
        if beyond:
            failures.append(f"{name}: {len(beyond)} differ by more than {job.tolerance:.0e}")
            failures += [
                f"  {one.key}: {reprlib.repr(one.here)} here, {reprlib.repr(one.plain)} on a plain processor"
                for one in beyond[:SHOWN]
            ]
    return lines, failures


def _jobs(changes: dict[str, str], *arguments: str) -> subprocess.Popen[bytes]:
    return subprocess.Popen([sys.executable, "-m", "numerics.jobs", *arguments], env={**os.environ, **SAME, **changes})


def _ended(*processes: subprocess.Popen[bytes]) -> None:
    codes = [process.wait() for process in processes]
    if any(codes):
        raise SystemExit("a process of the comparison failed; its words are above")


def main(words: list[str]) -> int:
    """Run the jobs whose names have one of the words in them (no words: all) on both; 1 when something differs."""
    if not chosen(words):
        raise SystemExit(f"no job has one of {' '.join(words)} in its name; there are: {'; '.join(JOBS)}")
    environment = plain_processor()
    with tempfile.TemporaryDirectory() as directory:
        records, here, plain = (Path(directory) / name for name in ("records", "here.json", "plain.json"))
        _ended(_jobs({}, "records", str(records)))
        _ended(
            _jobs({}, "answers", str(records), str(here), *words),
            _jobs(environment, "answers", str(records), str(plain), *words),
        )
        found, other = (json.loads(path.read_text()) for path in (here, plain))
    if other["features"]:
        raise SystemExit(f"NumPy's features {' '.join(other['features'])} could not be switched off")
    print(f"NumPy's features here: {' '.join(found['features']) or 'none, so that nothing is compared of them'}")
    print("the plain processor: " + ", ".join(f"{name}={value}" for name, value in environment.items()))
    lines, failures = compared(found["answers"], other["answers"])
    print("\n".join(lines))
    print(f"{found['seconds']:.0f} s here, {other['seconds']:.0f} s on a plain processor")
    if failures:
        print("the answers differ:", *failures, sep="\n")
    return 1 if failures else 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
