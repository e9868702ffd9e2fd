"""From CasADi expressions to something that runs: virtual machine, compiled C, vector units, C99 sources."""

from vsense_ros.codegen.compile import (
    FLAGS,
    Entry,
    Kernel,
    compiled,
    compiler,
    expanded,
    function,
    identity_of,
    library,
    loaded,
    vector_math,
)
from vsense_ros.codegen.native import Corners
from vsense_ros.codegen.native import source as native_source
from vsense_ros.codegen.side_by_side import Alike

__all__ = [
    "FLAGS",
    "Alike",
    "Corners",
    "Entry",
    "Kernel",
    "compiled",
    "compiler",
    "expanded",
    "function",
    "identity_of",
    "library",
    "loaded",
    "native_source",
    "vector_math",
]
