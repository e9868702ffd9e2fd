"""What the accelerator computes: one file for each kernel, with its mock, which gives the bits of `hw/rtl`."""

from vsense_ros.accelerator.kernels.base import Kernel
from vsense_ros.accelerator.kernels.body_mass import BODY_MASS
from vsense_ros.accelerator.kernels.gauss_jordan import SOLVE_14, SOLVE_42, SOLVE_56
from vsense_ros.accelerator.kernels.suspension_motion import SUSPENSION_MOTION

KERNELS: dict[str, Kernel] = {k.name: k for k in (SOLVE_14, SOLVE_42, BODY_MASS, SUSPENSION_MOTION, SOLVE_56)}
BY_NUMBER: dict[int, Kernel] = {kernel.number: kernel for kernel in KERNELS.values()}

__all__ = ["BODY_MASS", "BY_NUMBER", "KERNELS", "SOLVE_14", "SOLVE_42", "SOLVE_56", "SUSPENSION_MOTION", "Kernel"]
