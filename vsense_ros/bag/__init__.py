"""Recordings in and out: MCAP bags, importers, public datasets."""

from vsense_ros.bag.mcap import BagWriter, TopicDescription, read_bag, read_whole_bag, write_bag

__all__ = ["BagWriter", "TopicDescription", "read_bag", "read_whole_bag", "write_bag"]
