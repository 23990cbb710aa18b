"""Margins against closed forms and against the figures of the paper's loop."""

from __future__ import annotations

import math

import pytest

from fffo_drive.control.stability import LinearAxis, condition_14_nm_per_rev, loop_margins

KT = 0.148
DAMPING = KT / 26.17
PAPER = LinearAxis(0.166 * DAMPING, DAMPING, 0.003, KT)


def test_margins_of_an_integrator_with_delay():
    # Kp Kt / (J s) exp(-Td s): crossover Kp Kt / J, phase margin 90 deg - wc Td, gain margin pi / (2 wc Td)
    axis = LinearAxis(1e-3, 0.0, 0.002, 0.1)
    margins = loop_margins(axis, 1.0, 0.0, 0.0)
    crossover = 1.0 * 0.1 / 1e-3
    assert margins.crossover_hz == pytest.approx(crossover / (2 * math.pi), rel=1e-3)
    assert margins.phase_deg == pytest.approx(90.0 - math.degrees(crossover * 0.002), abs=0.1)
    assert margins.gain == pytest.approx(math.pi / 2 / (crossover * 0.002), rel=1e-3)


@pytest.mark.parametrize(
    ("gain_nm_per_rev", "phase_deg", "gain_margin"), [(0.0, 62, 3.4), (3.3, 53, 3.3), (10.0, 38, 3.0)]
)
def test_the_paper_loop_with_its_delay(gain_nm_per_rev, phase_deg, gain_margin):
    margins = loop_margins(PAPER, 0.975, 9.75, gain_nm_per_rev)
    assert margins.phase_deg == pytest.approx(phase_deg, abs=0.6)
    assert margins.gain == pytest.approx(gain_margin, abs=0.06)
    assert margins.crossover_hz == pytest.approx(24.0, rel=0.15)


def test_condition_14_fails_for_pi_alone_and_holds_from_l_of_3_2():
    assert condition_14_nm_per_rev(9.75, KT, 0.0, 2.33) == pytest.approx(1.443 - 4.66)
    assert condition_14_nm_per_rev(9.75, KT, 3.2, 2.33) < 0 < condition_14_nm_per_rev(9.75, KT, 3.22, 2.33)
