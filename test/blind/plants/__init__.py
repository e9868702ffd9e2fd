"""The plants: `simulate(cars, knobs, courses, formula)` → `Log`, one file each."""
