"""Fixtures of these tests."""

from __future__ import annotations

from typing import Any

import casadi as ca
import pytest

from lane_change import clean, lane_change, plant, vehicle
from vsense_ros.model.car.car import Car
from vsense_ros.observer import spi
from vsense_ros.observer.parameter_filter import ParameterFilter

__all__ = ["clean", "lane_change", "parameters_uncompiled", "plant", "vehicle"]


@pytest.fixture
def parameters_uncompiled(monkeypatch: pytest.MonkeyPatch) -> None:
    """For tests of other parameters than most, or of few steps: compiling takes five to ten times as long."""

    def functions(
        kind: type[ParameterFilter], car: Car, columns: tuple[int, ...], size: int, *heard: Any
    ) -> dict[str, ca.Function]:
        return {f.name(): f for f in spi.equations_of(kind(car, columns, size), *heard)}

    monkeypatch.setattr(spi, "_compiled", functions)
