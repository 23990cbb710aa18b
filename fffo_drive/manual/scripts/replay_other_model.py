"""A recorded run under another model: python replay_other_model.py AXIS.yaml OUT.mcap"""

import sys
from pathlib import Path

import fffo_drive as fd

axis = fd.read_axis(sys.argv[1])
run = fd.run(axis, sys.argv[2])
print(run)
print("every command the same, bit for bit:", fd.replay(run).exact)

found = fd.identify(run, name="from this run")
print(found)
model = Path(sys.argv[2]).with_suffix(".yaml")
fd.write_model(found.model, model)
other = fd.replay(run, instead=model)
print(f"with that model the command differs by {other.rms_difference_a:.3f} A (rms), over {other.rows} rows")
