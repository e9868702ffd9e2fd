"""The observer's accelerator: bit-exact kernels, frames, link, faults, and when the processor does the work itself."""
