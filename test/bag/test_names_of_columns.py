"""Columns are taken for what their loggers mean by them."""

from __future__ import annotations

import pytest

from vsense_ros.bag.importers.guess_names import heading, meanings

LOGGERS = {
    # Stanford P1, headings of a structure in MATLAB
    "a yaw angle beside a yaw rate": (
        ("time", "yaw", "yaw_rate", "axG", "ayG"),
        {"angular_velocity.2": "yaw_rate", "linear_acceleration.0": "axG", "linear_acceleration.1": "ayG"},
    ),
    "a yaw rate that is called yaw": (("t", "Yaw"), {"angular_velocity.2": "Yaw"}),
    # BMW M235i, a logger of laps
    "places as X and Y, accelerations in Gs": (
        ("Latitude / Y Position", "Longitude / X Position", "Lateral Gs", "Acceleration Gs"),
        {
            "latitude": "Latitude / Y Position", "longitude": "Longitude / X Position",
            "linear_acceleration.1": "Lateral Gs", "linear_acceleration.0": "Acceleration Gs",
        },
    ),
}  # fmt: skip


@pytest.mark.parametrize("logger", LOGGERS)
def test_columns_mean_what_the_logger_means(logger: str) -> None:
    columns, expected = LOGGERS[logger]
    found = {field: name for (_, field), name in meanings({name: heading(name) for name in columns}).items()}
    assert {field: found.get(field) for field in expected} == expected
