"""Fixtures of these tests."""

from lane_change import clean, lane_change, plant, vehicle

__all__ = ["clean", "lane_change", "plant", "vehicle"]
