"""Tyre formulas of the plants, one file each.

`FORMULAS[name](tyre, kappa, alpha, load, friction)` → longitudinal and lateral force [N].

kappa: longitudinal slip [-], positive driving; alpha: slip angle [rad], positive where the force is positive (to the
left); load [N]; friction: grip relative to the dry road [-]. `tyre` has `cornering` [N/rad] and `slip_stiffness` [N] at
`nominal_load` [N], `friction_x`, `friction_y` there, and by what share stiffness and friction fall per nominal load
(`stiffness_fall`, `friction_fall`). All arrays of the same shape.
"""

from blind.tyres import brush, burckhardt, dugoff, magic_formula_1989

FORMULAS = {
    "magic_formula_1989": magic_formula_1989.forces,
    "brush": brush.forces,
    "dugoff": dugoff.forces,
    "burckhardt": burckhardt.forces,
}
