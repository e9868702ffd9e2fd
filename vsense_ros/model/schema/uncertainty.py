"""How far the numbers of a vehicle file may be off: keys of its section `uncertainty`."""

from __future__ import annotations

from pydantic import Field

from vsense_ros.model.parameter import Part, parameter


class Uncertainty(Part):
    """Standard deviation of a number of the vehicle file, and where that and the number come from."""

    deviation: float = parameter("of the number", "standard deviation of the file's value", gt=0)
    source: str = Field(description="source of value and standard deviation", default="")
