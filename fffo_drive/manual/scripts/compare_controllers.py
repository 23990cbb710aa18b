"""Three controllers on one simulated axis: python compare_controllers.py AXIS.yaml"""

import sys

import fffo_drive as fd

axis = fd.read_axis(sys.argv[1])
for toggle, name in (("off", "PI"), ("fb", "PI+FBFO"), ("ff", "PI+FFFO")):
    run = fd.simulate(axis, toggle=toggle, seed=1)
    error = run.metrics.measured  # as a real axis has it; .shaft is known of a simulated one
    print(f"{name:8} ISE {error.ise:.4f} rps^2 s, MAE {error.mae:.4f} rps, MAX {error.max:.3f} rps")

tuned = fd.tune(axis.model, axis=axis)
gains, margins = tuned.design.gains, tuned.design.margins_observer
print(f"tune: Kp {gains.proportional_a_per_rps:.3f} A/rps, Ki {gains.integral_a_per_rev:.2f} A/rev")
print(f"      phase margin {margins.phase_deg:.0f} deg, gain margin {margins.gain:.1f}")
