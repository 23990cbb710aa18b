"""The one criterion: folds of whole blocks, gains on unseen rows, and a test that noise does not pass."""

import numpy as np
import pytest
from scipy import stats

from fffo_drive.identification.criterion import (
    FOLDS,
    LEAST_IN_LEVEL,
    RIDGE,
    SDS,
    SMALLEST_P,
    Gain,
    clipped,
    folds_of,
    gain,
    hotelling_p,
    levels,
    sandwich_p,
    strength_variation,
    unseen_loss,
)
from fffo_drive.least_squares import HUBER, huber

ROW_S = 0.008
LONG = ((0, 9003), (9003, 9010), (9010, 20001))  # rows of three stretches: 72 s, less than a window, and 88 s


def coloured(draw, size, memory=0.9):
    """Unit noise with a memory of some rows: neighbours are not independent."""
    white = draw.normal(size=size)
    for k in range(1, size):
        white[k] = memory * white[k - 1] + np.sqrt(1.0 - memory**2) * white[k]
    return white


def test_blocks_of_two_seconds_go_into_five_folds_in_pairs():
    folds = folds_of(LONG, ROW_S)
    first = slice(*LONG[0])
    sizes = np.bincount(folds.block[first])
    assert np.all(sizes[:-1] == 4 * round(0.5 / ROW_S))
    assert ROW_S * sizes[0] == pytest.approx(2.0, abs=0.05)
    assert np.array_equal(folds.fold, folds.block // 2 % FOLDS)
    assert np.array_equal(np.unique(folds.fold), np.arange(5))
    assert np.array_equal(folds.window[first], folds.block[first] * 4 + np.arange(sizes.sum()) % sizes[0] // 62)


def test_no_window_and_no_pair_of_blocks_reaches_over_two_stretches():
    folds = folds_of(LONG, ROW_S)
    for number in (folds.window, folds.block, folds.block // 2):
        owners = [set(number[begin:end]) for begin, end in LONG]
        assert not owners[0] & owners[1]
        assert not owners[1] & owners[2]


def test_a_short_log_has_shorter_blocks_and_no_rows_no_folds():
    seconds = 20.0
    folds = folds_of([(0, round(seconds / ROW_S))], ROW_S)
    assert np.bincount(folds.block)[0] * ROW_S == pytest.approx(seconds / 50, rel=0.1)
    shortest = folds_of([(0, round(2.0 / ROW_S))], ROW_S)
    assert np.bincount(shortest.block)[0] * ROW_S == pytest.approx(0.2, rel=0.2)
    assert folds_of([], ROW_S).fold.size == 0


@pytest.mark.parametrize("ridge", [0.0, 0.02])
def test_the_loss_of_a_fold_is_that_of_a_fit_of_the_others(ridge):
    draw = np.random.default_rng(4)
    folds = folds_of([(0, 3000)], ROW_S)
    columns = draw.normal(size=(3000, 4)) * np.array([1.0, 1e-4, 1e3, 1.0])
    target = columns @ np.array([0.5, 2e3, 1e-4, 0.0]) + draw.normal(size=3000)
    target[::97] += 30.0  # outliers: pulled in for the fit, not in the loss
    found = unseen_loss(target, columns, folds, ridge)
    prior = np.diag((RIDGE + ridge) * np.sum(columns**2, axis=0))
    for k in range(FOLDS):
        inside, others = folds.fold == k, folds.fold != k
        normal = columns[others].T @ columns[others] + prior
        strengths = np.linalg.solve(normal, columns[others].T @ clipped(target[others]))
        wanted = huber(target[inside] - columns[inside] @ strengths)
        np.testing.assert_allclose(found[inside], wanted, rtol=1e-6, atol=1e-9)


def test_without_columns_the_loss_is_that_of_the_target():
    target = np.linspace(-5.0, 5.0, 3000)
    assert unseen_loss(target, np.zeros((3000, 0)), folds_of([(0, 3000)], ROW_S)) == pytest.approx(huber(target))


def test_a_column_that_is_there_gains_what_its_likelihood_says():
    draw = np.random.default_rng(5)
    size = 20_000
    folds = folds_of([(0, size)], ROW_S)
    column = coloured(draw, size)
    target = 0.3 * column + draw.normal(size=size)
    found = gain(unseen_loss(target, np.zeros((size, 0)), folds), unseen_loss(target, column[:, None], folds), folds)
    assert found.holds
    assert found.value == pytest.approx(0.5 * 0.09 * size, rel=0.2)
    assert found.blocks.sum() == pytest.approx(found.value)


def test_a_column_of_noise_holds_in_few_of_a_hundred():
    """Noise and column have a memory: a deviation from rows that were thought independent would let through more."""
    size, seeds = 4000, 200
    folds = folds_of([(0, size)], ROW_S)
    held = values = 0.0
    for seed in range(seeds):
        draw = np.random.default_rng(seed)
        target, column = coloured(draw, size), coloured(draw, size)[:, None]
        found = gain(huber(target), unseen_loss(target, column, folds), folds)
        held += found.holds
        values += found.value
    assert held <= 0.05 * seeds
    assert values < 0.0  # unseen rows make a needless number cost something


def test_the_deviation_is_that_of_whole_blocks():
    """What a block has in common does not average out over its rows."""
    folds = folds_of(LONG, ROW_S)
    count = int(folds.block.max()) + 1
    draws = np.random.default_rng(6)
    values, deviations = [], []
    for _ in range(200):
        common = draws.normal(size=count)[folds.block]
        found = gain(common, np.zeros(common.size), folds)
        values.append(found.value)
        deviations.append(found.sd)
    assert np.median(deviations) == pytest.approx(np.std(values), rel=0.15)


def test_rows_that_do_not_count_gain_nothing_and_one_block_proves_nothing():
    folds = folds_of([(0, 4000)], ROW_S)
    fall = np.where(np.arange(4000) < 2000, 1.0, 100.0)
    kept = np.arange(4000) < 2000
    assert gain(fall, np.zeros(4000), folds, kept).value == pytest.approx(2000.0)
    alone = gain(fall, np.zeros(4000), folds, folds.block == 0)
    assert alone.value > 0.0
    assert not alone.holds


def test_a_gain_holds_beyond_two_deviations_of_its_blocks():
    draw = np.random.default_rng(3).normal(size=200)
    draw = (draw - draw.mean()) / draw.std(ddof=1)
    sd_of_mean = 1.0 / np.sqrt(200.0)
    for sds, holds in ((SDS + 0.2, True), (SDS - 0.2, False)):
        blocks = draw + sds * sd_of_mean
        assert Gain(float(blocks.sum()), float(np.sqrt(200.0)), blocks).holds is holds


def test_a_gain_is_not_that_of_one_block_nor_lost_by_one():
    """A block that stands out counts for no more than one in twenty: it neither makes a gain nor hides that of all."""
    alone, even = np.zeros(50), np.full(50, 1.0)
    alone[7] = 1e4
    even[7] = 1e2
    for blocks, holds in ((alone, False), (even, True), (-even, False)):
        sd = float(np.sqrt(blocks.size * blocks.var(ddof=1)))
        assert Gain(float(blocks.sum()), sd, blocks).holds is holds


def test_the_loss_is_square_within_the_limit_and_straight_beyond():
    assert huber(np.array([0.0, -2.0, 10.0])) == pytest.approx([0.0, 2.0, HUBER * (10.0 - 0.5 * HUBER)])
    assert clipped(np.array([-9.0, 1.0, 9.0])) == pytest.approx([-HUBER, 1.0, HUBER])


def test_a_row_is_worth_one_over_the_level_of_its_class():
    draw = np.random.default_rng(7)
    classes = np.repeat([0, 1, 2], [2000, 2000, LEAST_IN_LEVEL - 1])
    residual = draw.normal(size=classes.size) * np.array([1.0, 5.0, 400.0])[classes]
    residual[:100] = 1e6  # the level is robust
    kept = np.ones(classes.size, bool)
    kept[-1] = False
    weight = levels(residual, kept, classes)
    assert 1.0 / weight[500] == pytest.approx(1.0, rel=0.15)
    assert 1.0 / weight[2500] == pytest.approx(5.0, rel=0.1)
    assert 1.0 / weight[-2] < 10.0  # too few rows for a level of their own: that of all
    assert weight[-1] == 0.0


@pytest.mark.parametrize("rank", [1, 3, 8])
def test_under_noise_the_chance_is_uniform(rank):
    chances = []
    for seed in range(300):
        draw = np.random.default_rng([rank, seed])
        scores = draw.normal(size=(40, rank)) @ draw.normal(size=(rank, rank))
        chances.append(hotelling_p(scores))
    assert stats.kstest(chances, "uniform").pvalue > 0.01


def test_under_an_effect_the_chance_is_tiny_and_times_what_was_tried():
    draw = np.random.default_rng(8)
    scores = draw.normal(size=(40, 3)) + np.array([0.0, 1.2, 0.0])
    alone = hotelling_p(scores)
    assert SMALLEST_P < alone < 1e-3
    assert hotelling_p(scores, 100) == pytest.approx(100.0 * alone)
    assert hotelling_p(scores, 10**12) == 1.0
    assert hotelling_p(scores + 10.0) == SMALLEST_P  # of a tail beyond nothing is known
    empty = np.concatenate([scores, np.zeros((500, 3))])  # windows in which nothing moves are no evidence
    assert hotelling_p(empty) == pytest.approx(alone)


@pytest.mark.parametrize("rank", [1, 3])
def test_without_an_effect_the_chance_by_the_sandwich_is_uniform(rank):
    chances = []
    for seed in range(400):
        draw = np.random.default_rng([rank, seed])
        scores = draw.normal(size=(60, rank)) @ draw.normal(size=(rank, rank))
        chances.append(sandwich_p(scores, scores, np.ones(60)))
    assert stats.kstest(chances, "uniform").pvalue > 0.01


def test_a_rare_effect_far_above_the_noise_is_no_chance_by_the_sandwich():
    """In six of a hundred windows, a hundred times the noise: the mean of the windows is hardly above their spread."""
    draw = np.random.default_rng(10)
    noise = draw.normal(size=(100, 1))
    size = np.where(np.arange(100)[:, None] % 16 == 3, 100.0, 0.0)
    assert hotelling_p(noise + size) > 1e-3
    assert sandwich_p(noise + size, noise, np.ones(100)) < 1e-9
    assert sandwich_p(noise + size, noise, np.where(size[:, 0] > 0.0, 1.0, 1e-9)) < 1e-4  # by six windows it is less


@pytest.mark.parametrize("rank", [1, 3])
def test_an_effect_of_the_size_that_is_negligible_is_no_more_found_in_a_long_log_than_in_a_short_one(rank):
    """Against nothing each is beyond chance; against the negligible size the chance is no smaller than it says."""
    nothing, chances = [], []
    for seed in range(300):
        draw = np.random.default_rng([rank, seed])
        noise = draw.normal(size=(200, rank))
        size = np.zeros(rank)
        size[0] = 1.0  # of each window: 200 in the sum of squares over the noise
        scores = noise + size
        square = float(np.sum(scores.mean(axis=0) ** 2))
        left = scores - scores.mean(axis=0)
        nothing.append(sandwich_p(scores, left, np.ones(200)))
        chances.append(sandwich_p(scores, left, np.ones(200), 1.0 / square))
    assert max(nothing) < 1e-9
    assert stats.kstest(chances, "uniform", alternative="greater").pvalue > 0.01  # never too small
    assert 0.3 < np.median(chances) < 0.7
    large = noise + 2.0 * size
    assert sandwich_p(large, large - large.mean(axis=0), np.ones(200), 0.25) < 1e-9


def test_one_window_that_has_all_of_a_column_does_not_decide_by_itself():
    """Its score counts for one in twenty of the leverage: without it the others, in which nothing is, remain."""
    draw = np.random.default_rng(11)
    noise = draw.normal(size=(100, 1))
    leverage = np.full(100, 0.1 / 99)
    leverage[0] = 0.9
    alone = np.zeros((100, 1))
    alone[0] = 30.0
    full = sandwich_p(noise + alone, noise, np.ones(100))
    assert full < 0.01 < sandwich_p(noise + alone, noise, leverage)
    assert sandwich_p(noise, noise, np.eye(100)[0]) == 1.0  # a single window proves nothing


def test_too_few_windows_prove_nothing():
    draw = np.random.default_rng(9)
    scores = 5.0 + draw.normal(size=(12, 10))
    assert hotelling_p(scores) == 1.0
    assert hotelling_p(np.zeros((40, 2))) == 1.0
    assert hotelling_p(5.0 + draw.normal(size=(16, 10))) < 1.0


@pytest.mark.parametrize("varies", [0.0, 0.3, 1.0])
def test_the_strength_of_a_law_of_the_machine_does_not_vary_over_the_blocks(varies):
    """Residual of an effect fitted with its mean strength, true strengths of the blocks 1 - varies and 1 + varies."""
    rng = np.random.default_rng(1)
    folds = folds_of([(0, 40_000)], 0.01)
    beside = rng.standard_normal((40_000, 3)) * [1.0, 1e6, 1e-6]
    own = 0.5 * rng.standard_normal(40_000)
    own -= beside @ np.linalg.lstsq(beside, own, rcond=None)[0]
    torque = own + beside @ [3.0, 2e-6, 1e6]  # the part that the others could take has no say, in any unit
    own_strength = np.where(folds.block % 2 == 0, 1.0 - varies, 1.0 + varies)
    residual = (own_strength - 1.0) * own + 0.2 * rng.standard_normal(40_000)
    assert strength_variation(torque, beside, residual, folds) == pytest.approx(varies, abs=0.03)


def test_a_weak_effect_does_not_vary_because_of_noise():
    rng = np.random.default_rng(2)
    folds = folds_of([(0, 40_000)], 0.01)
    torque = 0.05 * rng.standard_normal(40_000)  # in each block its strength is determined to 1.4
    found = [strength_variation(torque, np.ones((40_000, 1)), rng.standard_normal(40_000), folds) for _ in range(20)]
    assert np.median(found) < 0.25
