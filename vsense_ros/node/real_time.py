"""What a process needs to answer in time, besides the priority and the processors that `ros2 launch` gives it."""

from __future__ import annotations

import ctypes
import os
import resource

from vsense_ros.errors import InputError

_CURRENT, _FUTURE, _ON_FAULT = 1, 2, 4  # MCL_* of mlockall(2)


def lock_memory() -> None:
    """Keep all memory that this process has used, or will use, from being paged out. Raises `InputError` where the
    system does not allow that.

    What it has asked for and never touched, as the most of its threads' stacks, takes no memory: that would be a GiB
    for each node.
    """
    library = ctypes.CDLL(None, use_errno=True)
    if library.mlockall(_CURRENT | _FUTURE | _ON_FAULT) == 0:
        return
    reason = os.strerror(ctypes.get_errno())
    limit = resource.getrlimit(resource.RLIMIT_MEMLOCK)[0]
    allowed = "unlimited" if limit == resource.RLIM_INFINITY else f"{limit // 1024} KiB"
    raise InputError(
        f"parameter lock_memory: mlockall failed: {reason}; the limit is {allowed}: set LimitMEMLOCK=infinity in the "
        "unit, memlock in /etc/security/limits.conf, or --ulimit memlock=-1 of docker run"
    )
