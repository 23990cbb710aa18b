"""Transport delay, current controller and winding of the simulated drive.

The command passes a delay line. A current controller at 11 kHz (every other sub-step) then sets the voltage that
reduces the current error by a fixed share, limited by the DC link. In between, the voltage less back-EMF is held. The
step of the winding (R, L) is exact.
"""

from __future__ import annotations

from ...jit import njit
from . import state as at
from .state import Floats, Integers


@njit
def transport_step(line: Floats, words: Integers, steps: int, fraction: float, command_a: float) -> float:
    """Put a command into the delay line; returns the demand (A) of `steps` + `fraction` sub-steps ago.

    `line`: a ring of steps + 2. Advances words[HEAD].
    """
    length = line.shape[0]
    head = int(words[at.HEAD])
    line[head] = command_a
    newer = head - steps
    if newer < 0:
        newer += length
    older = newer - 1
    if older < 0:
        older += length
    head += 1
    words[at.HEAD] = head if head < length else 0
    return float((1.0 - fraction) * line[newer] + fraction * line[older])


@njit
def current_step(c: Floats, x: Floats, words: Integers, demand_a: float) -> float:
    """One sub-step of controller and winding; the mean current over it (A).

    `c`, `x`, `words`: `numbers` of the parameters, `values` and `words` of the state. Sets words[LIMITED] at a limit.
    """
    kept = c[at.CURRENT_KEPT]
    current_a = float(x[at.CURRENT_A])
    if words[at.SUBSTEP] % 2 == 0:
        back_emf_v = c[at.BACK_EMF] * x[at.VELOCITY_RPS]
        peak_a = c[at.PEAK_CURRENT_A]
        target_a = min(peak_a, max(-peak_a, demand_a))
        wanted_a = current_a + c[at.CURRENT_APPROACH] * (target_a - current_a)
        # the voltage that achieves this in two sub-steps of the winding
        wanted_v = back_emf_v + c[at.V_PER_CURRENT] * (wanted_a - kept * kept * current_a)
        limit_v = c[at.DC_LINK_V]
        voltage_v = min(limit_v, max(-limit_v, wanted_v))
        x[at.WINDING_V] = voltage_v - back_emf_v
        if voltage_v != wanted_v or target_a != demand_a:
            words[at.LIMITED] = 1
    next_a = kept * current_a + c[at.CURRENT_PER_V] * x[at.WINDING_V]
    x[at.CURRENT_A] = next_a
    return float(0.5 * (current_a + next_a))
