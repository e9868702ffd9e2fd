"""From CasADi expressions to something that runs: virtual machine, compiled C, vector units, C99 sources."""

from vsense_ros.codegen.compile import (
    FLAGS,
    Entry,
    Kernel,
    cache_folder,
    compiled,
    compiler,
    expanded,
    function,
    library,
)

__all__ = ["FLAGS", "Entry", "Kernel", "cache_folder", "compiled", "compiler", "expanded", "function", "library"]
