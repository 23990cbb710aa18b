"""One diagnosis for the benchmarks, in a process of its own: the report as plain data, and its cost.

A fresh process per diagnosis is what a user has: compiled code is loaded, and the peak of memory is its own.
"""

from __future__ import annotations

import html
import json
import multiprocessing
import os
import re
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterable, Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from pathlib import Path
from typing import Any

import numpy as np

from fffo_drive.identification.dataset import Record
from fffo_drive.identification.facts import DriveFacts
from fffo_drive.model.parameters import ModelFile, Quantity

Call = tuple[Callable[..., object], tuple[object, ...]]


def mechanisms() -> tuple[str, ...]:
    """Names of the parts of the search that can be switched off."""
    from fffo_drive.diagnosis import diagnose as engine

    return tuple(getattr(engine, "MECHANISMS", ()))


def diagnosed(
    fit: Sequence[Record],
    held_out: Sequence[Record],
    facts: DriveFacts,
    without: Iterable[str] = (),
    ablate: Iterable[str] = (),
) -> dict[str, Any]:
    """The report of one diagnosis, with `first_p`, `process` (cost since the process began its work) and `ignored`:
    what was asked of the search that this version of it does not know."""
    begin = time.monotonic()
    from fffo_drive.diagnosis.diagnose import DiagnosisSettings, diagnose  # loads slowly: part of the cost
    from fffo_drive.diagnosis.results import report

    asked = {"without": frozenset(without), "ablate": frozenset(ablate)}
    known = {key: names for key, names in asked.items() if names and key in DiagnosisSettings._fields}
    found = diagnose(fit, held_out, facts, settings=DiagnosisSettings(**known))
    said = report(found)
    said["first_p"] = getattr(found, "first_p", None)
    said["ignored"] = sorted(name for key, names in asked.items() if key not in known for name in names)
    said["base"], said["fitted"] = _axis_numbers(found.model_before), _axis_numbers(found.model_after)
    said["process"] = {
        "wall_s": time.monotonic() - begin, "cpu_s": time.process_time(), "peak_mb": peak_mb(),
    }  # fmt: skip
    return said


def typed(folder: Path, fit: Sequence[str], held_out: Sequence[str], out: Path) -> dict[str, Any]:
    """The report of `fffo-drive diagnose` on the logs of a set, with `page`, the words of the opening of its page, and
    `process`. Raises ValueError with what the command says where it writes no report.
    """
    words = ["--drive", "drive.yaml", "--fit", *fit, "--held-out", *held_out, "--out", str(out)]
    begin = time.monotonic()
    command = [sys.executable, "-m", "fffo_drive", "diagnose", *words]
    with tempfile.TemporaryFile("w+") as said:
        process = subprocess.Popen(command, cwd=folder, stdout=subprocess.DEVNULL, stderr=said)
        _, _, usage = os.wait4(process.pid, 0)
        said.seek(0)
        last = said.read().strip().splitlines()[-1:]
    if not (out / "report.json").exists():
        raise ValueError(*last)
    found: dict[str, Any] = json.loads((out / "report.json").read_text())
    found["page"] = opening_of((out / "report.html").read_text())
    found["process"] = {
        "wall_s": time.monotonic() - begin,
        "cpu_s": usage.ru_utime + usage.ru_stime,
        "peak_mb": usage.ru_maxrss / 1024.0,
    }
    return found


def opening_of(page: str) -> str:
    """Headline and lines of a report's page, without its tags."""
    section = re.split('<section class="verdict[^>]*>', page, maxsplit=1)[1].split("</section>", 1)[0]
    return " ".join(html.unescape(re.sub("<[^>]*>", " ", section)).split())


def _axis_numbers(model: ModelFile | None) -> dict[str, list[float | None]]:
    """Value and standard deviation of inertia, delay and friction, by name; nothing where no model is offered."""
    if model is None:
        return {}
    kept = {"inertia_kg_m2": model.inertia_kg_m2, "delay_s": model.delay_s, "sensor_delay_s": model.sensor_delay_s}
    kept |= {name: value for name, value in model.friction if isinstance(value, Quantity)}
    return {name: [quantity.value, quantity.sd] for name, quantity in kept.items()}


def peak_mb() -> float:
    """Peak resident memory of this process. Not `ru_maxrss`, which a child takes over from its parent."""
    lines = Path("/proc/self/status").read_text().splitlines()
    return next(int(line.split()[1]) for line in lines if line.startswith("VmHWM")) / 1024.0


def write_answer(path: Path, content: dict[str, Any]) -> None:
    """A report as JSON, whole or not at all."""
    path.parent.mkdir(parents=True, exist_ok=True)
    part = path.with_suffix(".part")
    part.write_text(json.dumps(content, default=_plain, indent=1) + "\n")
    part.replace(path)


def _plain(value: Any) -> Any:
    if isinstance(value, np.ndarray):
        return value.tolist()
    if isinstance(value, np.generic):
        return value.item()
    return str(value)


def in_parallel(
    calls: Sequence[Call], jobs: int, progress: Callable[[float], None] | None, fresh: bool = False
) -> None:
    """Run calls in processes, with `fresh` each in one of its own; the first error is raised."""
    context = multiprocessing.get_context("spawn") if fresh else None
    with ProcessPoolExecutor(max(1, jobs), mp_context=context, max_tasks_per_child=1 if fresh else None) as pool:
        waiting = [pool.submit(function, *arguments) for function, arguments in calls]
        for number, done in enumerate(as_completed(waiting), 1):
            done.result()
            if progress is not None:
                progress(number / len(waiting))


def accepted_of(said: dict[str, Any]) -> list[dict[str, Any]]:
    """Accepted effects of a report, and after them the forms that it gives the friction itself."""
    return [*(one for one in said["effects"] if one["accepted"]), *said.get("friction_form", [])]


def claimed(said: Mapping[str, Any]) -> list[dict[str, Any]]:
    """Accepted effects of a report whose names it does not put in doubt."""
    return [one for one in said["effects"] if one["accepted"] and not one.get("doubt")]


def first_names(said: dict[str, Any], most: int = 4) -> str:
    """The first accepted findings of a report for a table, with an order where they have one; "?": in doubt."""
    named = []
    for finding in accepted_of(said)[:most]:
        order = finding["parameters"].get("order")
        doubt = "?" if finding.get("doubt") else ""
        named.append(f"`{finding['name']}`" + (f" {order:.4g}" if isinstance(order, float) else "") + doubt)
    return ", ".join(named) or said["verdict"].replace("_", " ")


def residual_is_reported(said: dict[str, Any]) -> bool:
    """True if the report states an unexplained residual, with findings or without."""
    return said["verdict"] == "unexplained" or said.get("unexplained_rest") is not None
