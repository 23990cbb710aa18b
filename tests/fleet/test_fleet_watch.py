"""Watching drives: the rate of false alarms, planted changes, temperature that is no wear, and what stays undecided."""

from __future__ import annotations

import json
import math
from typing import NamedTuple

import numpy as np
import numpy.typing as npt
import pytest
from scipy import stats

from fffo_drive.fleet import watch as watch_module
from fffo_drive.fleet.channels import FleetPrior, _references, marginal
from fffo_drive.fleet.detector import (
    CLIP,
    SCALE_CLIP_SQUARED,
    SCALE_MEAN,
    SECOND_MOMENT,
    SLOPES,
    ChannelPrior,
    Detections,
    detect,
    log_norms,
)
from fffo_drive.fleet.history import RunHistory
from fffo_drive.fleet.matrices import inverse_total
from fffo_drive.fleet.regress import COULOMB, OFFSET, PARAMETERS, STRIBECK, VISCOUS
from fffo_drive.fleet.thermometers import seen_share
from fffo_drive.fleet.watch import FleetWatch, watch, watch_lines, watch_model

Floats = npt.NDArray[np.float64]

WEEK_S = 7.0 * 86400.0
LEVEL = np.array([1e-3, 5e-3, 0.02, 0.02, 0.001, 0.0, 0.0, 0.0])
SCATTER = np.array([0.04, 0.06, 0.02, 0.06, 0.03, 0.05, 0.05, 0.05])  # between runs, over the scales
SCALE = np.array([1e-3, 5e-3, 0.02, 0.02, 0.02, 5e-3, 0.02, 0.02])
VISCOUS_PER_K, COULOMB_PER_K = -0.02, -0.004


def drawn(
    number: int, change: dict[int, float] | None = None, at: int = 25, runs: int = 50, season_k: float = 10.0,
    logged: bool = True, ripple: float = 1.0, gap: float = 1.0,
) -> RunHistory:  # fmt: skip
    """A drive's records: seasonal temperature, scatter with heavy tails, and a step of some columns, over LEVEL."""
    rng = np.random.default_rng([11, number])
    warmer_k = season_k * np.sin(2.0 * np.pi * (np.arange(runs) / 52.0 + rng.random())) + 2.0 * rng.standard_normal(
        runs
    )
    theta = (
        LEVEL * np.exp(0.05 * rng.standard_normal(LEVEL.size)) + SCALE * SCATTER * rng.standard_t(4, (runs, 8)) / 1.4
    )
    theta[:, VISCOUS] += LEVEL[VISCOUS] * VISCOUS_PER_K * warmer_k
    theta[:, [COULOMB, STRIBECK]] += LEVEL[COULOMB] * COULOMB_PER_K * warmer_k[:, None]
    for column, share in (change or {}).items():
        theta[at:, column] += share * SCALE[column]
    information = np.tile(np.diag((0.01 * SCALE) ** -2.0), (runs, 1, 1))
    amplitude = np.full((runs, 20), np.nan)
    amplitude[:, 11] = 1e-3 * np.exp(0.1 * rng.standard_normal(runs))
    amplitude[at:, 11] *= ripple
    gap_rev = 0.02 * np.exp(0.05 * rng.standard_normal(runs))
    gap_rev[at:] *= gap
    return RunHistory(
        np.arange(runs) * WEEK_S, theta, information, PARAMETERS, 2e-3 * np.exp(0.1 * rng.standard_normal(runs)),
        amplitude, np.arange(1.0, 21.0), np.full(runs, 3.0),
        25.0 + warmer_k if logged else np.full(runs, math.nan), np.array([f"{number}_{k}" for k in range(runs)]),
        gap_rev, np.full(runs, 0.02),
    )  # fmt: skip


def fleet(count: int = 24, **one: object) -> dict[str, RunHistory]:
    """Drives without a change; `one`: of drive 0."""
    drives = {str(number): drawn(number, logged=bool(one.get("logged", True))) for number in range(1, count)}
    return {"0": drawn(0, **one), **drives}  # type: ignore[arg-type]


@pytest.fixture(scope="module")
def worn() -> FleetWatch:
    return watch(fleet(change={COULOMB: 0.10, STRIBECK: 0.10}), 1e-3)


# -- the bound


def mean_growth(slope: float, reach: Floats) -> Floats:
    """E exp(slope z) of clipped scores that are uniform within +-reach, by the integral."""
    places = (np.arange(20_000) + 0.5) / 20_000
    return np.array([float(np.mean(np.cosh(slope * np.minimum(one * places, CLIP)))) for one in reach])


@pytest.mark.parametrize("slope", range(SLOPES.size))
def test_no_symmetric_score_with_one_peak_and_these_moments_grows_faster(slope: int) -> None:
    """Random mixtures of three uniform scores that meet both moments: none beyond the bound, some close to it."""
    rng = np.random.default_rng(1)
    reach = np.column_stack([rng.uniform(0.0, 1.5, 4000), rng.uniform(1.5, 2.5, 4000), rng.uniform(2.5, 200.0, 4000)])
    places = (np.arange(400) + 0.5) / 400
    middle, second = (
        np.mean(np.minimum(reach[..., None] * places, clip) ** 2, axis=2) for clip in (SCALE_CLIP_SQUARED**0.5, CLIP)
    )
    most = rng.uniform(0.9, 1.0, 4000) * SECOND_MOMENT
    matrix = np.stack([np.ones_like(reach), middle, second], axis=1)
    shares = np.linalg.solve(matrix, np.stack([np.ones(4000), np.full(4000, SCALE_MEAN), most], axis=1)[..., None])
    kept = np.flatnonzero((shares[..., 0] >= 0.0).all(axis=1))
    growth = np.array([shares[k, :, 0] @ mean_growth(float(SLOPES[slope]), reach[k]) for k in kept[:150]])
    assert kept.size > 50
    assert np.log(growth.max()) <= log_norms()[slope] + 1e-6
    assert np.log(growth.max()) > 0.9 * log_norms()[slope]


@pytest.mark.parametrize("slope", range(SLOPES.size))
@pytest.mark.parametrize(
    ("tail", "scale"), [(stats.norm(), 1.0), (stats.t(4), 1.1527), (stats.t(2), 1.3430), (stats.uniform(-1, 2), 0.6540)]
)
def test_from_uniform_to_infinite_variance_the_moments_and_the_bound_hold(
    slope: int, tail: stats.rv_continuous, scale: float
) -> None:
    """`scale`: what makes the middle that of a normal score (Huber's proposal 2)."""
    score = tail.ppf((np.arange(400_000) + 0.5) / 400_000) / scale
    assert np.mean(np.minimum(score**2, SCALE_CLIP_SQUARED)) == pytest.approx(SCALE_MEAN, rel=1e-3)
    clipped = np.clip(score, -CLIP, CLIP)
    assert np.mean(clipped**2) < SECOND_MOMENT
    assert np.log(np.mean(np.exp(SLOPES[slope] * clipped))) < log_norms()[slope]


def watched(noise: Floats, rate: float, change: float = 0.0, at: int = 25) -> Detections:
    """Drives (d, n, c) of scale 0.03 about levels of their own, with a logged temperature, and a step in channel 0."""
    drives, runs, channels = noise.shape
    rng = np.random.default_rng(2)
    ambient = rng.standard_normal((drives, runs, 1))
    slopes = 0.05 * rng.standard_normal((drives, 1, channels))
    y = 0.03 * noise + 0.3 * rng.standard_normal((drives, 1, channels)) + slopes * ambient
    y[:, at:, 0] += change
    prior = ChannelPrior(
        np.zeros((channels, 3)), np.tile(np.diag([100.0, 3.0, 3.0]), (channels, 1, 1)), np.full(channels, 9e-4),
        np.full(channels, 4.0), np.zeros(channels),
    )  # fmt: skip
    count = drives * runs
    covariates = np.column_stack([ambient.ravel(), np.zeros(count)])
    return detect(
        np.arange(0, count + 1, runs), np.tile(np.arange(runs) * WEEK_S, drives), y.reshape(count, channels),
        np.ones((count, channels)), covariates, prior, rate,
    )  # fmt: skip


@pytest.mark.parametrize("tails", ["normal", "t3", "t2", "one-sided"])
def test_the_rate_of_false_alarms_is_kept(tails: str) -> None:
    rng = np.random.default_rng(3)
    shape = (600, 50, 4)
    scale = {"t3": 1.212, "t2": 1.343}.get(tails, 1.0)  # what Huber's proposal 2 makes of them
    noise = {
        "normal": lambda: rng.standard_normal(shape), "t3": lambda: rng.standard_t(3, shape),
        "t2": lambda: rng.standard_t(2, shape), "one-sided": lambda: rng.exponential(1.0, shape) - 1.0,
    }[tails]() / scale  # fmt: skip
    rate, years = 0.1, 600 * 49 * WEEK_S / (365.25 * 86400.0)
    assert watched(noise, rate).drive.size <= rate * years


def test_a_step_of_five_standard_deviations_is_found_within_ten_runs_and_its_first_run_too() -> None:
    found = watched(np.random.default_rng(4).standard_normal((200, 50, 4)), 1e-3, change=0.15)
    own = (found.channel == 0) & (found.run % 50 >= 25) & (found.run % 50 < 35)
    assert np.unique(found.drive[own]).size >= 195
    assert np.mean(np.abs(found.first[own] % 50 - 25) <= 1) > 0.9
    assert np.all(found.sign[own] == 1)


def test_one_outlier_raises_no_alarm() -> None:
    noise = np.random.default_rng(5).standard_normal((50, 50, 2))
    noise[:, 30] = 60.0
    assert watched(noise, 1e-3).drive.size == 0


def test_a_schedule_of_many_runs_a_day_has_no_more_alarms_a_year() -> None:
    noise = np.random.default_rng(6).standard_normal((100, 200, 2))
    dense = watched(noise, 5.0)
    assert dense.evidence.max() < watched(noise, 50.0).evidence.max()


def short_runs(number: int, logged: bool, worn: float = 0.0) -> RunHistory:
    """A drive as `drawn`, at one temperature all year: what each run says of friction is correlated, as in real fits.

    Every parameter scatters by 2 % from run to run. `worn`: rise of Coulomb friction and stiction from run 25 on.
    """
    rng = np.random.default_rng([14, number])
    speed = np.concatenate([sign * np.linspace(0.05, 3.0, 60) for sign in (1.0, -1.0)]) * rng.uniform(0.8, 1.25)
    direction = np.sign(speed)
    columns = np.column_stack([
        20.0 * np.sin(17.0 * np.arange(speed.size)), speed, direction, direction * np.exp(-np.abs(speed)),
        np.ones(speed.size), np.abs(speed),
    ])  # fmt: skip
    information = np.zeros((50, 8, 8))
    information[:, :6, :6] = columns.T @ columns / 1e-2**2 * np.exp(0.2 * rng.standard_normal((50, 1, 1)))
    theta = LEVEL * np.exp(0.05 * rng.standard_normal(8)) * np.exp(0.02 * rng.standard_normal((50, 8)))
    theta[25:, [COULOMB, STRIBECK]] *= 1.0 + worn
    degc = 25.0 + 2.0 * rng.standard_normal(50) if logged else np.full(50, math.nan)
    return drawn(number)._replace(theta=theta, information=information, temperature_degc=degc)


@pytest.mark.parametrize("logged", [True, False])
def test_a_fleet_that_shows_no_temperature_keeps_the_rate(logged: bool) -> None:
    rate = 0.1
    found = watch({str(number): short_runs(number, logged) for number in range(100)}, rate).found
    assert len(found.alarms) <= stats.poisson.ppf(0.99, rate * found.drive_years)


def test_in_such_a_fleet_wear_of_some_drives_is_not_taken_for_temperature() -> None:
    rate = 0.05
    fleet = {str(number): short_runs(number, False, 0.1 if number % 4 == 0 else 0.0) for number in range(100)}
    found = watch(fleet, rate).found
    worn = {alarm.drive for alarm in found.alarms if int(alarm.drive) % 4 == 0}
    false = [alarm for alarm in found.alarms if int(alarm.drive) % 4]
    assert len(worn) >= 20
    assert len(false) <= stats.poisson.ppf(0.99, rate * found.drive_years)


def test_a_rate_of_nothing_is_refused() -> None:
    with pytest.raises(ValueError, match="above 0"):
        watch({"0": drawn(0)}, 0.0)


# -- projections in closed form


def test_the_inverse_of_the_total_is_that_of_the_sum_and_of_a_part_where_nothing_is_known() -> None:
    rng = np.random.default_rng(7)
    a, b = rng.standard_normal((2, 3, 3))
    information, covariance = a @ a.T, b @ b.T + np.eye(3)
    wanted = np.linalg.inv(np.linalg.inv(information) + covariance)
    assert inverse_total(information[None], covariance)[0] == pytest.approx(wanted, rel=1e-8)
    information[2], information[:, 2] = 0.0, 0.0
    part = inverse_total(information[None], covariance)[0]
    assert part[:2, :2] == pytest.approx(np.linalg.inv(np.linalg.inv(information[:2, :2]) + covariance[:2, :2]))
    assert np.abs(part[2]).max() < 1e-12


def test_the_information_of_some_columns_is_that_of_their_covariance() -> None:
    a = np.random.default_rng(8).standard_normal((4, 4))
    whole = a @ a.T
    wanted = np.linalg.inv(np.linalg.inv(whole)[:2, :2])
    assert marginal(whole[None], [0, 1])[0] == pytest.approx(wanted)


# -- drives


def test_ten_per_cent_of_coulomb_friction_are_found_named_and_sized(worn: FleetWatch) -> None:
    (alarm,) = worn.found.alarms
    assert (alarm.drive, alarm.law) == ("0", "Coulomb friction")
    assert alarm.interval[0] < 0.10 < alarm.interval[1]
    assert abs(int(alarm.first_run.split("_")[1]) - 25) <= 2
    assert 25 < int(alarm.raised_run.split("_")[1]) <= 36
    assert alarm.size == pytest.approx(alarm.change * LEVEL[COULOMB], rel=0.3)
    before, after = alarm.look_at[:2], alarm.look_at[2:]
    assert all(int(run.split("_")[1]) < 25 for run in before)
    assert all(int(run.split("_")[1]) >= 25 for run in after)


def test_what_is_printed_and_what_is_json_say_the_same(worn: FleetWatch) -> None:
    plain = json.loads(json.dumps(worn.found.as_plain()))
    assert plain["alarms"][0]["text"] == watch_lines(worn.found)[0]
    assert "Coulomb friction +" in watch_lines(worn.found)[0]
    assert worn.trace("0").evidence.max() >= 1.0
    with pytest.raises(KeyError, match="nobody"):
        worn.trace("nobody")


class Stored(NamedTuple):
    """Histories as `history.ModelRecords` gives them."""

    by_drive: dict[str, RunHistory]

    @property
    def bounds(self) -> npt.NDArray[np.int64]:
        return np.cumsum([0, *(one.time_s.size for one in self.by_drive.values())])

    def histories(self, drives: npt.NDArray[np.int64]) -> dict[str, RunHistory]:
        names = list(self.by_drive)
        return {names[k]: self.by_drive[names[k]] for k in drives}


@pytest.mark.parametrize("drives_a_piece", [100, 10])
def test_a_fleet_watched_piece_by_piece_says_what_it_says_as_a_whole(
    worn: FleetWatch, drives_a_piece: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    stored = fleet(change={COULOMB: 0.10, STRIBECK: 0.10})
    monkeypatch.setattr(watch_module, "DRIVES_A_PIECE", drives_a_piece)
    monkeypatch.setattr(watch_module, "model_records", lambda store, model: Stored(stored))
    found = watch_model(None, "M", 1e-3)  # type: ignore[arg-type]  # no store is asked
    key = [(alarm.drive, alarm.law, alarm.first_run, alarm.raised_run) for alarm in found.alarms]
    assert key == [(alarm.drive, alarm.law, alarm.first_run, alarm.raised_run) for alarm in worn.found.alarms]
    assert found.drive_years == pytest.approx(worn.found.drive_years)
    assert found._replace(alarms=(), drive_years=0.0) == worn.found._replace(alarms=(), drive_years=0.0)


def test_a_doubled_ripple_is_named_by_its_order() -> None:
    found = watch(fleet(ripple=2.0), 1e-3).found
    assert [(alarm.drive, alarm.law) for alarm in found.alarms] == [("0", "ripple of order 12")]
    assert found.alarms[0].change == pytest.approx(1.0, abs=0.25)


@pytest.mark.parametrize("logged", [True, False])
def test_a_gap_grown_by_a_fifth_is_named_backlash(logged: bool) -> None:
    found = watch(fleet(gap=1.2, logged=logged), 1e-3).found
    assert [(alarm.drive, alarm.law) for alarm in found.alarms] == [("0", "backlash")]
    low, high = found.alarms[0].interval
    assert low < 0.2 < high


def test_a_constant_torque_is_named() -> None:
    found = watch(fleet(change={OFFSET: 0.25}), 1e-3).found
    assert [(alarm.drive, alarm.law) for alarm in found.alarms] == [("0", "constant torque")]


@pytest.mark.parametrize("logged", [True, False])
def test_a_change_of_temperature_is_no_wear(logged: bool) -> None:
    """A season of 40 % of viscous and 8 % of Coulomb friction."""
    assert watch(fleet(logged=logged), 0.01).found.alarms == ()


def test_without_a_temperature_a_change_along_the_line_of_temperature_is_a_doubt_and_no_alarm() -> None:
    change = {VISCOUS: 0.9, COULOMB: 0.18, STRIBECK: 0.18}  # 45 K colder
    found = watch(fleet(change=change, at=40, logged=False), 1e-3).found
    assert [alarm.law for alarm in found.alarms if alarm.drive == "0"] == []
    (doubt,) = (one for one in found.doubts if one.drive == "0")
    assert "wear cannot be distinguished from temperature" in doubt.text


def test_a_temperature_that_was_not_seen_before_is_a_doubt() -> None:
    history = drawn(0)
    history.temperature_degc[-8:] = 70.0
    found = watch({**fleet(), "0": history}, 1e-3).found
    assert any(doubt.drive == "0" and "70 degC" in doubt.text for doubt in found.doubts)


def test_a_drive_with_few_runs_says_so_and_drives_with_other_columns_are_refused() -> None:
    found = watch({**fleet(6), "new": drawn(40, runs=5, at=5)}, 0.01).found
    assert any(doubt.drive == "new" and "5 runs" in doubt.text for doubt in found.doubts)
    with pytest.raises(ValueError, match="drive b"):
        watch({"a": drawn(1), "b": drawn(2)._replace(names=PARAMETERS[::-1])}, 0.01)


@pytest.mark.parametrize("warm", [0.0, 1.0])
def test_the_level_of_a_drive_is_the_least_squares_of_its_runs_so_far(warm: float) -> None:
    """Drives beside each other, and of different lengths, as each alone by plain matrices."""
    rng = np.random.default_rng(3)
    lengths, p = (20, 5, 16), 3
    own = np.repeat(np.arange(3), lengths)
    place = np.concatenate([np.arange(n) for n in lengths])
    theta, steps = 1.0 + 0.1 * rng.standard_normal((own.size, p)), warm * rng.standard_normal(own.size)
    half = rng.standard_normal((own.size, p, 5))
    inverse = half @ half.transpose(0, 2, 1)
    slope, slope_sd = np.full(p, 0.1), np.full(p, 0.5)
    prior = FleetPrior((), np.eye(p), np.eye(p), slope, slope_sd, slope, np.eye(p), ())
    levels, slopes = _references(theta, steps, inverse, own, place, 3, prior)
    for drive, count in enumerate(lengths):
        weights = np.ones(count)
        mine = np.flatnonzero(own == drive)
        for block in range(levels.shape[0]):
            part = slice(8 * block, 8 * block + 8)
            runs = mine[part]
            if block:
                away = theta[runs] - levels[block - 1, drive] - steps[runs, None] * slopes[block - 1, drive]
                weights[part] = np.minimum(1.0, 2.0 * p / np.einsum("ni,nij,nj->n", away, inverse[runs], away))
            normal = np.diag(np.concatenate([np.full(p, 1e-6), slope_sd**-2]))
            right = np.concatenate([np.zeros(p), slope / slope_sd**2])
            for n, weight in zip(mine[: 8 * block + 8], weights, strict=False):
                design = np.kron([[1.0, steps[n]]], np.eye(p)).T
                normal += weight * design @ inverse[n] @ design.T
                right += weight * design @ inverse[n] @ theta[n]
            expected = np.linalg.solve(normal, right)
            assert levels[block, drive] == pytest.approx(expected[:p], rel=1e-9)
            if warm:
                assert slopes[block, drive] == pytest.approx(expected[p:], rel=1e-9)


# -- thermometers

SEASONS = 2.0 * np.pi / 52.0


def with_thermometer(kind: str, number: int) -> RunHistory:
    """A drive as `drawn`, with a thermometer at the drive, in the cabinet (25.0 +- 0.3 degC), or one that shows one of
    two sources of heat that are alike in size. Drives 0 to 5 wear from run 25 on.
    """
    history = drawn(number, {COULOMB: 0.10, STRIBECK: 0.10} if number < 6 else None)
    rng = np.random.default_rng([15, number])
    if kind == "half":
        warmer_k = 10.0 * np.sin(3.1 * SEASONS * np.arange(50) + 2.0 * np.pi * rng.random())
        history.theta[:, VISCOUS] += LEVEL[VISCOUS] * VISCOUS_PER_K * warmer_k
        history.theta[:, [COULOMB, STRIBECK]] += LEVEL[COULOMB] * COULOMB_PER_K * warmer_k[:, None]
    elif kind == "cabinet":
        return history._replace(temperature_degc=25.0 + 0.3 * rng.standard_normal(50))
    return history


@pytest.fixture(scope="module")
def thermometers() -> FleetWatch:
    """24 drives: every fourth thermometer is in the cabinet, and every fourth shows half."""
    kinds = ("drive", "drive", "cabinet", "half")
    return watch({str(number): with_thermometer(kinds[number % 4], number) for number in range(24)}, 1e-3)


def test_a_thermometer_that_explains_nothing_is_not_used_and_one_that_sees_half_is_used_half(
    thermometers: FleetWatch,
) -> None:
    seen = thermometers.stack.seen
    assert (seen[0::4] == 1.0).all()
    assert (seen[1::4] == 1.0).all()
    assert (seen[2::4] == 0.0).all()
    assert 0.4 <= seen[3::4].mean() <= 0.7
    assert (np.abs(seen[3::4] - 0.5) <= 0.25).all()
    viscous = thermometers.channels.y[:, thermometers.channels.laws.index("viscous friction")].reshape(24, 50)
    assert (np.isfinite(viscous).all(axis=1) == (seen == 1.0)).all()


def test_what_became_of_a_thermometer_is_told(thermometers: FleetWatch) -> None:
    said = "\n".join(watch_lines(thermometers.found))
    assert "2: the logged temperature explains nothing of its viscous friction, and is not used" in said
    assert "3: the logged temperature explains some" in said
    assert "\n0: the logged temperature" not in said
    assert thermometers.found.thermometers == 24
    alone = watch({str(number): with_thermometer("cabinet", number) for number in range(24)}, 1e-3).found
    assert watch_lines(alone)[-1].startswith("no logged temperature shows that of its drive: viscous friction is not")


def test_wear_is_found_beside_such_thermometers_and_their_season_is_none(thermometers: FleetWatch) -> None:
    assert {alarm.drive for alarm in thermometers.found.alarms} == {"0", "1", "2", "3", "4", "5"}
    assert {alarm.law for alarm in thermometers.found.alarms} == {"Coulomb friction"}


def test_wear_of_viscous_friction_is_no_fault_of_a_thermometer() -> None:
    found = watch(fleet(change={VISCOUS: 0.5}), 1e-3)
    assert found.stack.seen[0] == 1.0
    assert [(alarm.drive, alarm.law) for alarm in found.found.alarms] == [("0", "viscous friction")]


@pytest.mark.parametrize(("noise", "wanted"), [(0.0, 1.0), (1.0, 1.0)])
def test_errors_of_single_runs_are_no_unseen_temperature(noise: float, wanted: float) -> None:
    """What a thermometer does not see is what lasts."""
    rng = np.random.default_rng(16)
    steps = np.sin(SEASONS * np.arange(200.0))
    viscous = 1.0 - 0.5 * steps + noise * 0.2 * rng.standard_normal(200)
    assert seen_share(viscous, np.full(200, 0.04), steps) == wanted
    other = 0.5 * np.sin(3.3 * SEASONS * np.arange(200.0))
    assert seen_share(viscous + other, np.full(200, 0.04), steps) == 0.5
    assert seen_share(viscous, np.full(200, 0.04), rng.standard_normal(200)) == 0.0
    assert seen_share(viscous[:10], np.full(10, 0.04), rng.standard_normal(10)) == 1.0  # too few to say so
