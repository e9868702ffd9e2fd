"""ROS 2 nodes: one thin file each, around a driver, the observer or a bag.

What they share: `base` (lifecycle, diagnostics, publishing), `parameters` (one schema per node), `spin` (one executor,
clean ends), `time_base` (arrival in the time of a replay). `processes` starts nodes from a program.
"""

import os
import signal
import sys
from pathlib import Path


def _is_the_process_of_a_node() -> bool:
    """Whether Python was started for one of the modules here, by its name or by its executable."""
    arguments = sys.orig_argv[1:]
    if "-m" in arguments[:-1]:
        return arguments[arguments.index("-m") + 1].startswith(f"{__name__}.")
    return bool(sys.argv) and (Path(__file__).parent / f"{Path(sys.argv[0]).name}.py").is_file()


if _is_the_process_of_a_node():
    # While the libraries are being imported, for a second or more, there is nothing yet that would have to be closed.
    # `spin.Stop` takes over when there is.
    for _number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(_number, lambda *_: os._exit(0))
