"""ROS 2 nodes: one thin file each, around a driver, the observer or a bag.

What they share: `base` (lifecycle, diagnostics, publishing), `parameters` (one schema per node), `spin` (one executor,
clean ends), `time_base` (arrival in the time of a replay). `processes` starts nodes from a program.
"""

import ctypes
import os
import signal
import sys
from pathlib import Path

_SET_PARENT_DEATH_SIGNAL = 1  # PR_SET_PDEATHSIG of prctl(2)


def _is_the_process_of_a_node() -> bool:
    """True if Python was started for one of the modules here, by its name or by its executable."""
    arguments = sys.orig_argv[1:]
    if "-m" in arguments[:-1]:
        return arguments[arguments.index("-m") + 1].startswith(f"{__name__}.")
    return bool(sys.argv) and (Path(__file__).parent / f"{Path(sys.argv[0]).name}.py").is_file()


def _end_with(parent: int) -> None:
    """Get SIGTERM at the end of the process that has started this one: `ros2 launch` leaves its processes alone when it
    is ended by SIGTERM."""
    ctypes.CDLL(None).prctl(_SET_PARENT_DEATH_SIGNAL, signal.SIGTERM, 0, 0, 0)
    if os.getppid() != parent:
        os._exit(0)


if _is_the_process_of_a_node():
    # While the libraries are being imported, for a second or more, there is nothing yet that would have to be closed.
    # `spin.Stop` takes over when there is.
    for _number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(_number, lambda *_: os._exit(0))
    if os.environ.get("VSENSE_ENDS_WITH", "").isdigit() and sys.platform == "linux":
        _end_with(int(os.environ["VSENSE_ENDS_WITH"]))
