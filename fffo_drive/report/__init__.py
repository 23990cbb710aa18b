"""Reports: one page, one set of figures and one JSON file for bench, identify, evaluate and diagnose."""
