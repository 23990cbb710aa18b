"""From logs of an axis to its model and its gains: excitation, fit with honest uncertainties, residuals, tuning."""
