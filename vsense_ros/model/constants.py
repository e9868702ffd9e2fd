"""Constants of nature that the models share."""

GRAVITY = 9.80665  # [m/s²] standard acceleration of free fall
AIR_DENSITY = 1.204  # [kg/m³] at 20 °C and 1013 hPa
