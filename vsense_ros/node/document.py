"""The nodes and their parameters as a page: python -m vsense_ros.node.document > docs/nodes.md."""

from __future__ import annotations

from collections.abc import Iterator
from importlib import import_module
from pathlib import Path
from pkgutil import iter_modules
from types import ModuleType

from vsense_ros import node
from vsense_ros.node import parameters
from vsense_ros.node.parameters import NodeParameters


def nodes() -> Iterator[tuple[ModuleType, type[NodeParameters]]]:
    """The modules that a process begins with, which have a function `main`, and the parameters that they define."""
    for module_info in iter_modules(node.__path__):
        source = Path(module_info.module_finder.path) / f"{module_info.name}.py"  # type: ignore[union-attr]
        if "\ndef main(" not in source.read_text(encoding="utf-8"):
            continue
        module = import_module(f"{node.__name__}.{module_info.name}")
        (model,) = (
            value
            for name, value in vars(module).items()
            if isinstance(value, type) and issubclass(value, NodeParameters) and value.__module__ == module.__name__
            if not name.startswith("_")
        )
        yield module, model


def parameter_models() -> dict[str, type[NodeParameters]]:
    """The parameters of each node, by its name."""
    return {module.__name__.rpartition(".")[2]: model for module, model in nodes()}


_INTRODUCTION = """\
# Nodes

All nodes are lifecycle nodes. By default a node configures and activates itself (`autostart`); the lifecycle services
work in either case. Each node publishes `diagnostics` once a second. Topic names are relative, so a node can run in a
namespace. Parameters take effect when a node is configured; those marked *live* may change while it is active.
[Topics](topics.md) lists the messages.

    ros2 run vsense_ros observer --ros-args -p vehicle:=genesis
    ros2 run vsense_ros observer --help

Several nodes may share a process and its executor, in a program of a few lines (`test/node/test_one_process.py` runs
this one). Parameters are given with the name of their node, as `-p observer:vehicle:=genesis`.

    spin.init(sys.argv)
    stop = spin.Stop()  # by SIGINT or SIGTERM
    nodes = [ObserverNode("observer", ObserverParameters), Recorder("recorder", RecorderParameters)]
    for node in nodes:
        node.trigger_configure()
        node.trigger_activate()
    spin.spin(nodes, stop)
    for node in nodes:
        node.trigger_shutdown()

They then share one processor, since Python runs one callback at a time. What rclcpp has beside that, rclpy has not:
component containers (`ros2 component load`), and intra-process communication, by which messages are handed over without
the middleware.

This page is made from the parameter models of the nodes by `python -m vsense_ros.node.document`.
"""


def page() -> str:
    """The page in Markdown."""
    parts = [_INTRODUCTION]
    for module, model in nodes():
        name = module.__name__.rpartition(".")[2]
        parts.append(f"\n## {name}\n\n{(module.__doc__ or '').strip()}\n\n{parameters.markdown_table(model)}")
    return "".join(parts)


if __name__ == "__main__":
    print(page(), end="")
