"""ROS 2 nodes: one thin file each, around a driver, the observer or a bag.

What they share: `base` (lifecycle, diagnostics, publishing), `parameters` (one schema per node), `spin` (one executor,
clean ends), `time_base` (arrival in the time of a replay). `processes` starts nodes from a program.
"""
