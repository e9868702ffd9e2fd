"""Recordings in and out: MCAP bags, importers, public datasets."""

from vsense_ros.bag.metadata import TopicDescription
from vsense_ros.bag.reading import read_bag, read_whole_bag
from vsense_ros.bag.writing import BagWriter, write_bag

__all__ = ["BagWriter", "TopicDescription", "read_bag", "read_whole_bag", "write_bag"]
