"""Two sets of runs: the law that changed is named, and not another whose column its change moves too."""

from __future__ import annotations

import json

import numpy as np
import pytest

from fffo_drive.fleet.difference import difference, difference_lines
from fffo_drive.fleet.history import RunHistory
from fffo_drive.fleet.regress import COULOMB, STRIBECK, VISCOUS

from .test_fleet_watch import SCALE, drawn, fleet

CORRELATION = -0.9  # of viscous and Coulomb friction in one run that hardly moved fast


def part(history: RunHistory, first: int, last: int) -> RunHistory:
    """Some runs of a history."""
    cut = {name: getattr(history, name)[first:last] for name in RunHistory._fields if name not in ("names", "orders")}
    return history._replace(**cut)


def correlated(number: int, change: dict[int, float]) -> RunHistory:
    """A drive whose runs leave viscous and Coulomb friction to each other."""
    one = drawn(number, change)
    covariance = np.diag((0.05 * SCALE) ** 2)
    covariance[VISCOUS, COULOMB] = covariance[COULOMB, VISCOUS] = (
        CORRELATION * 0.05**2 * SCALE[VISCOUS] * SCALE[COULOMB]
    )
    noise = np.random.default_rng([5, number]).multivariate_normal(np.zeros(8), covariance, one.time_s.size)
    return one._replace(
        theta=one.theta + noise, information=np.tile(np.linalg.inv(covariance), (one.time_s.size, 1, 1))
    )


def compared(change: dict[int, float], first: tuple[int, int] = (10, 18), second: tuple[int, int] = (40, 48)):  # type: ignore[no-untyped-def]
    drives = {str(number): correlated(number, change if number == 0 else {}) for number in range(16)}
    return difference(part(drives["0"], *first), part(drives["0"], *second), drives)


@pytest.mark.parametrize(
    ("change", "law", "size"),
    [
        ({COULOMB: 0.3, STRIBECK: 0.3}, "Coulomb friction", 0.3),
        ({VISCOUS: 0.3}, "viscous friction", 0.3),
        ({STRIBECK: 0.8}, "stiction", 0.8),
    ],
)
def test_only_the_law_that_changed_differs(change: dict[int, float], law: str, size: float) -> None:
    found = compared(change)
    assert [one.law for one in found.laws if one.differs] == [law]
    assert found.laws[0].change == pytest.approx(size, abs=0.12)
    assert found.joint_p < 0.01


def test_two_laws_that_changed_are_both_named_each_with_its_own_size() -> None:
    found = compared({COULOMB: 0.3, STRIBECK: 0.3, VISCOUS: 0.4})
    sizes = {one.law: one.change for one in found.laws if one.differs}
    assert sizes == {"Coulomb friction": pytest.approx(0.3, abs=0.12), "viscous friction": pytest.approx(0.4, abs=0.12)}


def test_laws_that_runs_cannot_distinguish_are_named_together() -> None:
    drives = {str(number): drawn(number, {COULOMB: 0.3, STRIBECK: 0.3} if number == 0 else {}) for number in range(16)}
    both = np.zeros((8, 8))
    both[[COULOMB, VISCOUS], [COULOMB, VISCOUS]] = 1.0  # one direction of the two alone: their sum at one speed
    both[COULOMB, VISCOUS] = both[VISCOUS, COULOMB] = 1.0 - 1e-9
    scale = np.outer(1.0 / SCALE, 1.0 / SCALE)
    for name, one in drives.items():
        drives[name] = one._replace(information=np.tile(2500.0 * both * scale, (one.time_s.size, 1, 1)))
    found = difference(part(drives["0"], 10, 18), part(drives["0"], 40, 48), drives)
    first = found.laws[0]
    assert first.differs
    assert {first.law, *first.others} >= {"viscous friction", "Coulomb friction"}
    assert "cannot distinguish" in first.text


def test_the_joint_test_is_printed_and_in_the_json() -> None:
    found = difference(part(drawn(0), 10, 18), part(drawn(0), 40, 48), fleet())
    assert any("all together: p =" in line for line in difference_lines(found))
    assert json.loads(json.dumps(found.as_plain()))["joint_p"] == pytest.approx(found.joint_p)
    assert found.joint_p > 0.01
