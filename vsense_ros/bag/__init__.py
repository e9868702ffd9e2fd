"""Recordings in and out: MCAP bags, importers, public datasets."""

from vsense_ros.bag.mcap import BagWriter, read_bag, write_bag

__all__ = ["BagWriter", "read_bag", "write_bag"]
