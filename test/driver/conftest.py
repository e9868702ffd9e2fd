from __future__ import annotations

import os
from pathlib import Path

import numpy as np
import pytest

ROOT = Path(__file__).parents[2]


@pytest.fixture(scope="session")
def rav4() -> Path:
    """Folder of the RAV4 recording."""
    folder = Path(os.environ.get("VSENSE_DATA", ROOT / "../shared/recordings")) / "comma2k19_rav4"
    if not folder.is_dir():
        pytest.skip(f"needs the real recordings: {folder} is missing; set VSENSE_DATA")
    return folder


@pytest.fixture(scope="session")
def rav4_frames(rav4: Path) -> dict[str, np.ndarray]:
    """All raw frames of the powertrain bus: t [s], address, data (n, 8)."""
    raw = rav4 / "segment/processed_log/CAN/raw_can"
    arrays = {name: np.load(raw / name) for name in ("t", "address", "data", "src")}
    arrays["data"] = np.frombuffer(arrays["data"].tobytes(), np.uint8).reshape(-1, 8)
    chosen = arrays["src"] == 0
    return {name: array[chosen] for name, array in arrays.items()}
