"""A gain tried on a running axis: a step of the velocity set point, the new value, the same step again.

The value goes through `set` of the daemon, and so through its gates; the steps are recorded by the daemon at the full
rate and read from its files.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any, Literal, NamedTuple

import numpy as np

from ..arrays import Floats
from ..daemon.client import CallError, ClientError, DaemonClient
from ..daemon.places import CONTROL
from ..daemon.served_run import own_recording
from ..documents import DocumentError
from ..recording.errors import RecordingError
from ..recording.reader import read_run
from ..units import NS_PER_S

LEAD_S, TAIL_S = 0.1, 0.5  # shown before the step and after its end
POLL_S = 0.05
PATIENCE_S = 20.0  # beyond the step's own time
POINTS = 1500  # of a curve on the page
BEGINS = ("enabled", "following")


class StepResponse(NamedTuple):
    """A step as it was recorded; time 0 is where the loop took it."""

    time_s: Floats  # shape (n,), as all
    reference_rps: Floats
    velocity_rps: Floats

    @property
    def figures(self) -> dict[str, float]:
        """Error over the whole picture, and by how much the velocity goes beyond the step."""
        error_rps = self.velocity_rps - self.reference_rps
        first_rps, top_rps = float(self.reference_rps[0]), _farthest(self.reference_rps, float(self.reference_rps[0]))
        height_rps = top_rps - first_rps
        beyond = float(np.max((self.velocity_rps - top_rps) * math.copysign(1.0, height_rps))) if height_rps else 0.0
        return {
            "rms_rps": float(np.sqrt(np.mean(error_rps**2))), "peak_rps": float(np.max(np.abs(error_rps))),
            "overshoot_percent": 100.0 * max(0.0, beyond) / abs(height_rps) if height_rps else 0.0,
        }  # fmt: skip


class Trial:
    """One trial, while it runs and afterwards."""

    def __init__(self, number: int, key: str, value: float | bool, by_rps: float, for_s: float) -> None:
        self.number, self.key, self.value = number, key, value
        self.by_rps, self.for_s = by_rps, for_s
        self.state: Literal["running", "done", "failed"] = "running"
        self.says = "a step with the gains in use"
        self.old_value: float | bool | None = None
        self.before: StepResponse | None = None
        self.after: StepResponse | None = None

    def as_object(self, curves: bool) -> dict[str, Any]:
        """For the page; with or without the recorded curves."""
        found: dict[str, Any] = {
            "number": self.number, "key": self.key, "value": self.value, "old_value": self.old_value,
            "by_rps": self.by_rps, "for_s": self.for_s, "state": self.state, "says": self.says,
        }  # fmt: skip
        if curves and self.before is not None:
            both = {"before": self.before} | ({"after": self.after} if self.after is not None else {})
            time_s = self.before.time_s[:: max(1, -(-self.before.time_s.size // POINTS))]
            found["time_s"] = _short(time_s)
            found["reference_rps"] = _short(np.interp(time_s, self.before.time_s, self.before.reference_rps))
            found["velocity_rps"] = {
                name: _short(np.interp(time_s, one.time_s, one.velocity_rps)) for name, one in both.items()
            }
            found["figures"] = {name: one.figures for name, one in both.items()}
        return found


def try_gain(trial: Trial, directory: Path, epoch: int, who: str, sleep: Callable[[float], None] = time.sleep) -> None:
    """Carry a trial out on the daemon whose sockets are in `directory`; what goes wrong is in `trial.says`."""
    asker = {"who": who}
    try:
        with DaemonClient(directory / CONTROL) as client:
            trial.old_value = client.call("info")["keys"].get(trial.key)
            trial.before = step_response(client, trial.by_rps, trial.for_s, epoch, asker, sleep)
            trial.says = f"{trial.key} = {trial.value:g}"
            client.call("set", key=trial.key, value=trial.value, **asker)
            trial.says = "the same step with the new value"
            trial.after = step_response(client, trial.by_rps, trial.for_s, epoch, asker, sleep)
    except (CallError, ClientError, DocumentError, RecordingError, OSError) as error:
        trial.state, trial.says = "failed", f"{trial.says}: {error}"
    else:
        trial.state, trial.says = "done", "done"


def step_response(
    client: DaemonClient, by_rps: float, for_s: float, epoch: int, asker: dict[str, str],
    sleep: Callable[[float], None] = time.sleep,
) -> StepResponse:  # fmt: skip
    """A step of the velocity set point and back, recorded. Raises CallError, ClientError, DocumentError."""
    status = client.call("status")
    if (state := status["state"]) not in BEGINS:
        raise DocumentError(f"a step begins from {' or '.join(BEGINS)}, the axis is in state {state}: enable it first")
    if status["set_point"] is not None and not status["set_point"]["run_on"]:
        raise DocumentError("a step begins from standstill or a velocity that may run on: this one ends by itself")
    with own_recording(client, asker) as files:
        sleep(LEAD_S)
        number = client.call("step", by_rps=by_rps, for_s=for_s, epoch=epoch, **asker)["set_point"]
        for _ in range(math.ceil((for_s + PATIENCE_S) / POLL_S)):
            status = client.call("status")
            asked = status["set_point"]
            if status["state"] not in BEGINS:
                raise DocumentError(f"the step was ended: the axis is in state {status['state']}")
            if asked is None or asked["number"] != number or asked["lapsed"]:
                break
            sleep(POLL_S)
        sleep(TAIL_S)
    return _response(files, number, for_s)


def _response(files: list[Path], number: int, for_s: float) -> StepResponse:
    columns = ("deadline_ns", "set_point_number", "reference_rps", "velocity_rps")
    runs = [read_run(file).columns for file in files]
    deadline_ns, numbers, reference_rps, velocity_rps = (
        np.concatenate([np.asarray(run[name]) for run in runs] or [np.zeros(0)]) for name in columns
    )
    taken = np.flatnonzero(numbers == number)
    if not taken.size:
        names = ", ".join(map(str, files)) or "no file"
        raise DocumentError(f"the recording has no row of set point {number}: {names}")
    own_s = (deadline_ns - deadline_ns[taken[0]]) / NS_PER_S
    shown = (own_s >= -LEAD_S) & (own_s <= for_s + TAIL_S)
    return StepResponse(own_s[shown], reference_rps[shown], velocity_rps[shown])


def _short(values: Floats) -> list[float]:
    """As a page shows them."""
    return [float(f"{value:.5g}") for value in values]


def _farthest(values: Floats, from_value: float) -> float:
    return float(values[np.argmax(np.abs(values - from_value))])
