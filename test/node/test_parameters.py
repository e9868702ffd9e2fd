"""One model is the only description of a node's parameters."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import pytest

rclpy = pytest.importorskip("rclpy", reason="ROS 2 (rclpy) is not installed here")
from rclpy.parameter import Parameter

from vsense_ros.errors import InputError
from vsense_ros.node import gps_driver, observer, parameters
from vsense_ros.node.document import nodes

MODELS = [model for _, model in list(nodes())]


@pytest.fixture(scope="module")
def context() -> Iterator[Any]:
    context = rclpy.Context()
    rclpy.init(context=context, domain_id=99)
    yield context
    rclpy.shutdown(context=context)


@pytest.fixture
def node_with(context: Any, request: pytest.FixtureRequest) -> Any:
    def make(**overrides: Any) -> Any:
        values = [Parameter(name, value=value) for name, value in overrides.items()]
        node = rclpy.create_node("some_node", context=context, parameter_overrides=values)
        request.addfinalizer(node.destroy_node)
        return node

    return make


@pytest.mark.parametrize("model", MODELS)
def test_every_parameter_is_described(model: type[parameters.NodeParameters]) -> None:
    for name, info in model.model_fields.items():
        assert info.description, name
        assert info.get_default() is not None, name


@pytest.mark.parametrize("model", MODELS)
def test_defaults_are_declared_and_read_back(model: type[parameters.NodeParameters], node_with: Any) -> None:
    node = node_with()
    parameters.declare(node, model)
    assert parameters.read(node, model) == model()


def test_ranges_and_units_of_the_model_are_those_of_the_ros_parameter(node_with: Any) -> None:
    node = node_with()
    parameters.declare(node, observer.ObserverParameters)
    descriptor = node.describe_parameter("rate")
    assert "[Hz]" in descriptor.description
    (allowed,) = descriptor.floating_point_range
    assert (allowed.from_value, allowed.to_value) == (0.0, 1000.0)


def test_a_whole_number_is_taken_for_a_real_parameter(node_with: Any) -> None:
    node = node_with(rate=50)
    parameters.declare(node, observer.ObserverParameters)
    assert parameters.read(node, observer.ObserverParameters).rate == 50.0


@pytest.mark.parametrize(
    ("name", "value", "allowed"),
    [("rate", 0.0, "greater than 0"), ("rate", "fast", "number"), ("map_origin", "here", "tuple")],
)
def test_a_value_that_cannot_be_names_parameter_value_and_what_is_allowed(
    node_with: Any, name: str, value: Any, allowed: str
) -> None:
    with pytest.raises(InputError, match=f"parameter {name} is {value!r}: .*{allowed}"):
        parameters.declare(node_with(**{name: value}), observer.ObserverParameters)


def test_a_misspelt_parameter_is_refused_with_the_known_ones(node_with: Any) -> None:
    with pytest.raises(InputError, match=r"no parameter 'vehikle'; expected .*vehicle"):
        parameters.declare(node_with(vehikle="genesis"), observer.ObserverParameters)


def test_an_allowed_choice_is_listed_in_the_table() -> None:
    assert "nmea, ubx" in parameters.markdown_table(gps_driver.GpsDriverParameters)
