"""Laser-tracker readings as a channel of the diagnosis: nuisance, columns of effects, folds, sealed readings.

Here: how readings answer effects. Not here: the readings' file (robots.tracker_readings), the geometry's fit
(robots.calibration).
"""
