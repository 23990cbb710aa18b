"""One picture of what logs can show: velocity over time, input against acceleration, speeds, places."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ..identification.coverage import Coverage
from ..identification.dataset import Record
from ..identification.kinematics import motion_of
from .figures import Axis, Figure, Series, Uniform

MOST_RUNS = 4  # that are drawn over time
CLASSES = 60
POINTS = 3000


def coverage_figures(records: Sequence[Record], coverage: Coverage, linear: bool) -> list[list[Figure]]:
    """Rows of figures for one sheet."""
    turn, speed, acceleration = ("m", "m/s", "m/s2") if linear else ("rev", "rps", "rps2")
    colours = ("blue", "orange", "green", "purple")
    motions = [[motion_of(r, part, coverage.cutoff_hz) for part in r.segments()] for r in records]
    over_time, against = [], []
    for record, parts, colour in zip(records[:MOST_RUNS], motions, colours, strict=False):
        velocity = np.full(record.samples, np.nan)
        own: list[np.ndarray] = []
        for part, motion in zip(record.segments(), parts, strict=True):
            velocity[part] = motion.velocity_rps
            own.append(np.stack([motion.acceleration_rps2, record.current_a[part]], axis=1))
        over_time.append(Series(record.name, Uniform(0.0, record.period_s), velocity, colour))
        points = np.concatenate(own)
        points = points[:: max(1, points.shape[0] // POINTS)]
        points = points[np.argsort(points[:, 0])]
        against.append(Series(record.name, points[:, 0], points[:, 1], colour, draw="points"))
    velocity = np.concatenate([m.velocity_rps for parts in motions for m in parts])
    position = np.concatenate([m.position_rev for parts in motions for m in parts])
    return [
        [
            Figure(
                "velocity", "time", "Velocity", "The derivative of the position, filtered.", Axis("Time", "s"),
                Axis("Velocity", speed), tuple(over_time),
            ),
        ],
        [
            Figure(
                "input", "xy", "Input against acceleration",
                "Inertia is the slope; friction and all else is what lies above and below.",
                Axis("Acceleration", acceleration), Axis("Input", "-"), tuple(against),
            ),
            _shares("speeds", "Speeds", Axis("Velocity", speed), velocity),
            _shares("places", "Places", Axis("Position", turn), position),
        ],
    ]  # fmt: skip


def _shares(name: str, title: str, axis: Axis, values: np.ndarray) -> Figure:
    counts, edges = np.histogram(values, bins=CLASSES)
    share = 100.0 * counts / max(1, values.size)
    return Figure(
        name, "histogram", title, "How much of the time is spent where.", axis, Axis("Share of the time", "%"),
        (Series(title, edges, share, "blue", draw="filled"),),
    )  # fmt: skip
