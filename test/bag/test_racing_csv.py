"""CSV files of racing loggers whose lines above the header are not where they usually are."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from vsense_ros.bag.importers import import_recording

TABLE = (
    '"Format","AiM CSV File"\n"Session","x"\n"Time","to be","ignored","here"\n\n'
    '"Time","GPS Speed","GPS Heading"\n"s","km/h","deg"\n\n"0.000","36.0","90.0"\n"0.050","36.0","90.0"\n'
)


def test_skip_lines_of_a_mapping_go_before_the_header_that_is_found(tmp_path: Path) -> None:
    (tmp_path / "lap.csv").write_text(TABLE)
    speed, course = ({"column": f"GPS {name}"} for name in ("Speed", "Heading"))
    mapping = {
        "time": {"column": "Time"},
        "skip_lines": 4,
        "topics": {"gps/velocity": {"speed": speed, "course": course}},
    }
    found = import_recording(tmp_path / "lap.csv", mapping=mapping)["gps/velocity"]
    np.testing.assert_allclose(found.columns["linear"][:, 0], 10.0)
