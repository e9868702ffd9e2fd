"""Extension of the observer node: an accelerator computes kernels of its filter."""

from __future__ import annotations

from typing import Any, Literal

from pydantic import BaseModel, Field

from vsense_ros.accelerator.client import Client, Direct
from vsense_ros.accelerator.device import Device
from vsense_ros.accelerator.uio import Places, Several
from vsense_ros.errors import InputError
from vsense_ros.messages.diagnostic import Diagnostic, Level
from vsense_ros.model.vehicle import Vehicle
from vsense_ros.node.accelerator_link import TopicLink
from vsense_ros.node.base import SensingNode
from vsense_ros.node.extensions import Extension
from vsense_ros.node.parameters import parameter
from vsense_ros.observer.implicit import ACCELERATED, accelerated
from vsense_ros.runner.adapter import MakeFilter

_REPLAY_DEADLINE = 1.0  # [s]: in a replay nothing may depend on how busy the machine is, so that the observer waits


class AcceleratorParameters(BaseModel):
    """Which accelerator, and for what."""

    accelerator: Literal["", "topics", "mock", "rtl", "uio"] = Field(
        "",
        description="what computes kernels of errorEKF or SPI, whose step is implicit then: the accelerator node over "
        "its topics, within this process NumPy or simulated hardware, in modelled time, or the hardware of a Zynq "
        "(/dev/uio0, uio1, udmabuf0, of a second kernel uio2, uio3, udmabuf1 …: hw/README.md); empty: none",
    )
    accelerator_kernels: tuple[str, ...] = Field(
        ("solve14",), description="which: solve14, suspension_motion, body_mass; of the full car solve56, body_mass"
    )
    accelerator_deadline: float = parameter(
        0.0,
        "s",
        "longest wait for the accelerator; 0: twice the longest of 20 requests at the start, from 0.5 to 4 ms; over "
        "topics with use_sim_time: 1 s",
        ge=0,
        le=1,
    )


class Accelerator(Extension):
    """The client of the accelerator, and the filter that uses it."""

    Parameters = AcceleratorParameters

    def __init__(self, node: SensingNode, parameters: Any, vehicle: Vehicle) -> None:
        super().__init__(node, parameters, vehicle)
        p = parameters
        self._name = p.filter or ("spi" if vehicle.observer.parameters else "error_ekf")
        if self._name not in ACCELERATED:
            raise InputError(
                f"parameter accelerator is {p.accelerator!r} with the filter {p.filter!r}; an accelerator computes "
                f"kernels of {', '.join(ACCELERATED)} alone: leave filter empty, or accelerator"
            )
        self._link: TopicLink | Several | None = None
        self._at = None
        deadline = p.accelerator_deadline or None
        if p.accelerator == "topics":
            is_replay = bool(node.get_parameter("use_sim_time").value)
            self._link = TopicLink(node)
            self._client = Client(self._link, deadline=_REPLAY_DEADLINE if is_replay else deadline)
        elif p.accelerator == "uio":
            self._link = link = Several([Places.numbered(k) for k in range(len(p.accelerator_kernels))])
            if set(p.accelerator_kernels) != set(link.names):
                names = ", ".join(link.names)
                link.close()
                raise InputError(
                    f"parameter accelerator_kernels is {', '.join(p.accelerator_kernels)}, and the hardware has {names}"
                )
            self._client = Client(link, deadline=deadline)
        else:
            direct = Direct(Device(p.accelerator, p.accelerator_kernels))
            self._client, self._at = Client(direct, deadline=deadline), direct.at

    @classmethod
    def is_wanted(cls, parameters: Any) -> bool:
        """True if an accelerator is named."""
        return bool(parameters.accelerator)

    def make_filter(self) -> MakeFilter:
        """The filter with some of its kernels computed by the accelerator."""
        return accelerated(self._name, self._client, self.parameters.accelerator_kernels, self._at)

    def diagnostics(self) -> list[Diagnostic]:
        """How much the accelerator did, and whether it is still asked."""
        client = self._client
        values = {name: str(number) for name, number in client.counts.items()}
        values |= {"clocks of a result": str(client.compute_cycles), "of the link": str(client.link_cycles)}
        values |= {"fallback": str(client.fallbacks), "longest wait [ms]": f"{1e3 * client.longest:.2f}"}
        values["deadline [ms]"] = f"{1e3 * client.deadline:.2f}"
        if client.is_off:
            return [
                Diagnostic("use of accelerator", Level.WARN, "not asked any more: the processor does the work", values)
            ]
        level = Level.WARN if client.fallbacks else Level.OK
        text = f"{client.fallbacks} of {client.counts['requests']} requests were computed by the processor"
        return [Diagnostic("use of accelerator", level, text, values)]

    def summary(self) -> dict[str, Any]:
        """Counts of requests and of their outcomes."""
        return {"accelerator": dict(self._client.counts)}

    def release(self) -> None:
        """Close the link over topics, or to hardware."""
        if self._link is not None:
            self._link.close()
            self._link = None
