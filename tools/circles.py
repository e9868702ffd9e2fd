"""Circular imports between the modules of a package, imports for type checkers among them.

`python tools/circles.py` prints each circle and fails if there is one.
"""

import ast
import sys
from pathlib import Path

ROOT = Path(__file__).parents[1]
PACKAGE = "vsense_ros"


def modules_of(package: Path) -> dict[str, Path]:
    """The dotted name of each module below the folder of a package, with its file."""
    names = {}
    for file in sorted(package.rglob("*.py")):
        parts = file.relative_to(package.parent).with_suffix("").parts
        names[".".join(parts[:-1] if parts[-1] == "__init__" else parts)] = file
    return names


def import_graph(package: Path) -> dict[str, set[str]]:
    """For each module of a package, the modules of this package that any statement in it imports."""
    modules = modules_of(package)
    return {name: _imported(name, file, modules) - {name} for name, file in modules.items()}


def _imported(importer: str, file: Path, modules: dict[str, Path]) -> set[str]:
    """The modules that the source of one module names in its import statements, at whatever place they stand."""
    folder = importer if file.name == "__init__.py" else importer.rpartition(".")[0]
    imported = set()
    for node in ast.walk(ast.parse(file.read_text())):
        if isinstance(node, ast.Import):
            imported.update(alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            base = node.module or ""
            if node.level:  # relative: one dot is the folder of the importer, each further dot the one above
                ancestors = folder.split(".")
                above = ancestors[: len(ancestors) - node.level + 1]
                base = ".".join([*above, node.module] if node.module else above)
            names = (f"{base}.{alias.name}" for alias in node.names)
            imported.update(name if name in modules else base for name in names)
    return imported & modules.keys()


def circles(root: Path) -> list[list[str]]:
    """Groups of modules of the package below `root` that import each other, the largest group first."""
    return groups_in_circles(import_graph(root / PACKAGE))


def groups_in_circles(graph: dict[str, set[str]]) -> list[list[str]]:
    """Groups of nodes of a graph each of which reaches every other, the largest first.

    These are the strongly connected components with more than one node (Tarjan 1972, Depth-first search and linear
    graph algorithms).
    """
    order: dict[str, int] = {}
    lowest: dict[str, int] = {}
    stack: list[str] = []
    components: list[list[str]] = []

    def visit(node: str) -> None:
        order[node] = lowest[node] = len(order)
        stack.append(node)
        for neighbour in sorted(graph.get(node, ())):
            if neighbour not in order:
                visit(neighbour)
                lowest[node] = min(lowest[node], lowest[neighbour])
            elif neighbour in stack:
                lowest[node] = min(lowest[node], order[neighbour])
        if lowest[node] == order[node]:
            start = stack.index(node)
            components.append(sorted(stack[start:]))
            del stack[start:]

    for node in sorted(graph):
        if node not in order:
            visit(node)
    return sorted((component for component in components if len(component) > 1), key=lambda names: (-len(names), names))


def main() -> int:
    graph = import_graph(ROOT / PACKAGE)
    groups = groups_in_circles(graph)
    for circle in groups:
        print(f"{len(circle)} modules import each other:")
        for name in circle:
            print(f"  {name} -> {', '.join(sorted(graph[name] & set(circle)))}")
    return 1 if groups else 0


if __name__ == "__main__":
    sys.exit(main())
