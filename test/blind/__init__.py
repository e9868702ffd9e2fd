"""The public examination of `vsense explain`: plants, hidden physics, concealment, scores. Nothing here is ours to fit.

The plants import nothing of `vsense_ros`; only `sensors`, `vehicle_file` and `run` meet its files and its command line.
"""
