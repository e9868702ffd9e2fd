"""From catalogue values and an ordinary drive to a vehicle file: rules for what is unknown, checks, calibration."""
