"""From logs of an axis to its model and its gains: excitation, fit with uncertainties, residuals, tuning."""
