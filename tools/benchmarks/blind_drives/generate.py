"""A whole drive from a seed: its plant, its effects at a strength that can be seen, its four runs, and the truth."""

from __future__ import annotations

import gzip
import io
import json
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from fffo_drive.drive.simulated.parameters import PlantConfig

from .draw import (
    MIXED,
    ODD_AXES,
    WAVES,
    base_plant,
    chirp_current_a,
    effect_draws,
    effect_names,
    gains_of,
    kind_of,
    plant_draws,
    variant,
    with_limits,
)
from .profiles import RATE_HZ, Profile, profiles
from .simulate import Gains, Run, simulate
from .strength import Calibrated, calibrate, is_sound, quiet_runs

DRAWS_OF_A_NAME = 3
MOST_PLANTS = 8  # for one name: each comes as often as it was drawn, and not as often as it is easy
MOST_PARTNERS = 6
# two of one group are never put into one drive: together they are one effect of another size
GROUPS = (
    {"torque_offset", "asymmetric_coulomb", "asymmetric_viscous"},
    {"coulomb_drift", "viscous_drift"},
    {"cogging", "torque_ripple", "friction_ripple", "resolver_error"},
    {"unbalance", "position_dependent_friction"},
    {"elasticity", "backlash", "current_lag"},
    {"quadratic_drag", "torque_saturation", "voltage_limit", "load_dependent_friction"},
)
DECIMALS = {
    "time_s": 4, "current_command_a": 5, "current_a": 4, "velocity_rps": 5, "position_rev": 6, "reference_rps": 5,
}  # fmt: skip
ORDER = tuple(DECIMALS)


@dataclass(frozen=True)
class BlindDrive:
    """A drive with its runs, and the truth, which the diagnosis does not get."""

    seed: int
    plant: PlantConfig
    gains: Gains
    asked: tuple[Profile, ...]
    effects: tuple[Calibrated, ...]
    plants: int = 1  # how many were drawn until one could have the effects of this seed

    def runs(self, with_effects: bool = True) -> list[Run]:
        """The four runs with all their noise; without effects: the twin of the drive, under the same noise."""
        plant = self.plant if with_effects else replace(self.plant, effects=())
        return [simulate(plant, self.gains, p, 4 * self.seed + k + 1) for k, p in enumerate(self.asked)]

    def facts(self) -> dict[str, float | int]:
        """What is declared about the drive."""
        return {
            "torque_constant_nm_per_a": self.plant.torque_constant_nm_per_a,
            "rated_current_a": self.plant.rated_current_a,
            "gear_ratio": int(self.plant.gear_ratio),
            "resolver_bits": self.plant.resolver.bits,
            "sample_rate_hz": RATE_HZ,
        }

    def truth(self) -> dict[str, Any]:
        """What the diagnosis is never shown."""
        effects = [
            {
                "name": found.variant.name,
                "in_library": found.variant.name not in ODD_AXES,
                "axes": list(ODD_AXES.get(found.variant.name, ())),
                "parameters": dict(found.variant.at(found.size).parameters),
                "share_of_friction_after_refit": found.share,
                "share_of_coulomb": self._of_coulomb(found),
            }
            for found in self.effects
        ]
        plant = asdict(replace(self.plant, effects=()))
        return {"seed": self.seed, "plants": self.plants, "effects": effects, "plant": plant}

    def _of_coulomb(self, found: Calibrated) -> float | None:
        """Amplitude of a wave over Coulomb friction; that of a ripple is a share of the torque, which is at least that
        while the axis moves. None for what is no wave."""
        if found.variant.name not in WAVES:
            return None
        return found.size / self.plant.friction.coulomb_nm if found.variant.name == "cogging" else found.size


def make_drive(seed: int, friction: str = "single_2sep", kinds: str = MIXED) -> BlindDrive:
    """The drive of a seed. `friction`: "single_2sep" or "five_surfaces"; `kinds`: MIXED, ODD or STRONG_WAVES.

    Raises RuntimeError where none of `MOST_PLANTS` plants can have the effect whose turn it is.
    """
    count, _ = kind_of(seed, kinds)
    names = effect_names(seed, kinds) if count else []
    draw = effect_draws(seed)
    for attempt in range(MOST_PLANTS):
        plant = with_limits(base_plant(plant_draws(seed, attempt), seed, friction), names[:1])
        gains = gains_of(plant)
        asked = profiles(seed, chirp_current_a(plant))
        if not names:
            return _with(seed, plant, gains, asked, ())
        first = _calibrated(plant, gains, asked, names[0], draw, kinds)
        if first is None:
            continue
        drive = _with(seed, plant, gains, asked, (first,))
        if count == 2:
            drive = _with_partner(seed, plant, gains, asked, first, names)
        if drive is not None:
            return replace(drive, plants=attempt + 1)
    raise RuntimeError(
        f"seed {seed}: {names[0]} reaches its share of the friction torque on none of {MOST_PLANTS} plants"
    )


def _with(
    seed: int, plant: PlantConfig, gains: Gains, asked: tuple[Profile, ...], effects: tuple[Calibrated, ...]
) -> BlindDrive:
    configured = replace(plant, effects=tuple(found.variant.at(found.size) for found in effects)).validate()
    return BlindDrive(seed, configured, gains, asked, effects)


def _calibrated(
    plant: PlantConfig, gains: Gains, asked: tuple[Profile, ...], name: str, draw: np.random.Generator, kinds: str
) -> Calibrated | None:
    for _ in range(DRAWS_OF_A_NAME):
        found = calibrate(plant, gains, asked, variant(draw, name, kinds), draw)
        if found is not None:
            return found
    return None


def _with_partner(
    seed: int,
    plant: PlantConfig,
    gains: Gains,
    asked: tuple[Profile, ...],
    first: Calibrated,
    names: list[str],
) -> BlindDrive | None:
    """The drive with a second effect, of another group, under which the loop is still sound."""
    draw = np.random.default_rng((seed, 3))
    others = [n for n in names if n not in (first.variant.name, "torque_saturation") and not _alike(n, first)]
    for name in draw.permutation(others)[:MOST_PARTNERS]:
        second = _calibrated(plant, gains, asked, str(name), draw, MIXED)
        if second is None:
            continue
        ordered = tuple(sorted((first, second), key=lambda found: -found.share))
        drive = _with(seed, plant, gains, asked, ordered)
        if is_sound(quiet_runs(drive.plant, gains, asked)):
            return drive
    return None


def _alike(name: str, first: Calibrated) -> bool:
    return any(name in group and first.variant.name in group for group in GROUPS)


def write_drive(drive: BlindDrive, folder: Path) -> None:
    """`drive.yaml` and the four runs as csv.gz, columns as in the data's README."""
    folder.mkdir(parents=True, exist_ok=True)
    lines = ["# declared facts about this drive", *(f"{key}: {value}" for key, value in drive.facts().items())]
    (folder / "drive.yaml").write_text("\n".join(lines) + "\n")
    for run in drive.runs():
        columns = {"time_s": run.time_s, **run.columns}
        names = [name for name in ORDER if name in columns]
        text = io.StringIO()
        text.write(",".join(names) + "\n")
        formats = [f"%.{DECIMALS[name]}f" for name in names]
        np.savetxt(text, np.stack([columns[name] for name in names], axis=1), fmt=formats, delimiter=",")
        with gzip.GzipFile(folder / f"{run.profile.name}.csv.gz", "wb", compresslevel=4, mtime=0) as file:
            file.write(text.getvalue().encode())


def write_truth(drive: BlindDrive, path: Path) -> None:
    """The truth, in a file apart from the logs."""
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(json.dumps(drive.truth(), indent=1) + "\n")
