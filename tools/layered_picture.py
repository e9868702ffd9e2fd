"""Boxes on horizontal lines with arrows that lead down, as SVG (method of Sugiyama, Tagawa, Toda 1981).

An arrow over several lines passes each of those between through a place of its own. The order within a line is the one
with the fewest crossings of a number of sweeps, each of which puts every place at the mean of its neighbours.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Mapping, Sequence
from html import escape
from itertools import pairwise
from textwrap import wrap

BOX, PLACE, GAP = 212, 16, 24  # widths [px]: of a box, of an arrow that passes a line, between two of them
LETTERS = 31  # of the small text that fit into a box
LINE_HEIGHT, BETWEEN = 14, 56  # of small text, and between two lines of boxes [px]
SWEEPS = 200
STIFFNESS = 8  # of an arrow that passes lines, against the pull of boxes

Item = str | tuple[str, str, int]  # a box, or the place of an arrow on a line


def draw(lines: Sequence[Sequence[str]], texts: Mapping[str, str], arrows: Sequence[tuple[str, str]]) -> str:
    """The picture: `lines` of boxes from top to bottom, the small text in each box, and arrows from and to boxes."""
    rows, links = _with_places(lines, arrows)
    rows = _ordered(rows, links)
    x = _positions(rows, links)
    wrapped = {name: wrap(texts[name].replace("`", ""), LETTERS) for line in lines for name in line}
    heights = [34 + LINE_HEIGHT * max(len(wrapped[name]) for name in line) for line in lines]
    tops = [20 + sum(heights[:i]) + BETWEEN * i for i in range(len(lines))]
    parts = [_arrow(path, x, tops, heights) for path in _paths(lines, arrows)]
    parts += [_box(name, wrapped[name], x[name], tops[i], heights[i]) for i, line in enumerate(lines) for name in line]
    width = max(x.values()) + BOX / 2 + 20
    return _document(parts, width, tops[-1] + heights[-1] + 20)


def _paths(lines: Sequence[Sequence[str]], arrows: Sequence[tuple[str, str]]) -> list[list[tuple[Item, int]]]:
    """Every arrow as what it passes, each with its line."""
    line_of = {name: i for i, line in enumerate(lines) for name in line}
    paths = []
    for begin, end in arrows:
        between = [((begin, end, i), i) for i in range(line_of[begin] + 1, line_of[end])]
        paths.append([(begin, line_of[begin]), *between, (end, line_of[end])])
    return paths


def _with_places(
    lines: Sequence[Sequence[str]], arrows: Sequence[tuple[str, str]]
) -> tuple[list[list[Item]], dict[Item, dict[int, list[Item]]]]:
    """The lines with a place for each arrow that passes, and of everything the neighbours above (-1) and below (1)."""
    rows: list[list[Item]] = [list(line) for line in lines]
    links: dict[Item, dict[int, list[Item]]] = defaultdict(lambda: {-1: [], 1: []})
    for path in _paths(lines, arrows):
        for item, i in path[1:-1]:
            rows[i].append(item)
        for (above, _), (below, _) in pairwise(path):
            links[above][1].append(below)
            links[below][-1].append(above)
    return rows, links


def _ordered(rows: list[list[Item]], links: Mapping[Item, Mapping[int, list[Item]]]) -> list[list[Item]]:
    best, fewest = rows, _crossings(rows, links)
    for sweep in range(SWEEPS):
        side = -1 if sweep % 2 == 0 else 1
        rows = [list(row) for row in rows]
        for i in range(len(rows)) if side < 0 else reversed(range(len(rows))):
            if 0 <= i + side < len(rows):
                at = {item: k / max(len(rows[i + side]) - 1, 1) for k, item in enumerate(rows[i + side])}
                here = {item: k / max(len(rows[i]) - 1, 1) for k, item in enumerate(rows[i])}
                rows[i].sort(key=lambda item: _mean([at[one] for one in links[item][side]], here[item]))
        if (count := _crossings(rows, links)) < fewest:
            best, fewest = rows, count
    return best


def _mean(values: Sequence[float], otherwise: float) -> float:
    return sum(values) / len(values) if values else otherwise


def _crossings(rows: Sequence[Sequence[Item]], links: Mapping[Item, Mapping[int, list[Item]]]) -> int:
    total = 0
    for above, below in pairwise(rows):
        at = {item: k for k, item in enumerate(below)}
        ends = [(k, at[end]) for k, item in enumerate(above) for end in links[item][1]]
        total += sum((a - c) * (b - d) < 0 for i, (a, b) in enumerate(ends) for c, d in ends[:i])
    return total


def _positions(rows: Sequence[Sequence[Item]], links: Mapping[Item, Mapping[int, list[Item]]]) -> dict[Item, float]:
    """Middles [px]: as near to the neighbours above and below as the order and the widths allow."""
    x: dict[Item, float] = {}
    for row in rows:
        x |= _side_by_side(row, dict.fromkeys(row, 0.0))
    for sweep in range(SWEEPS):
        for row in rows if sweep % 2 else reversed(rows):
            x |= _side_by_side(row, {item: _between(item, x, links) for item in row})
    left = min(x[item] - _width(item) / 2 for row in rows for item in row)
    return {item: at - left + 20 for item, at in x.items()}


def _between(item: Item, x: Mapping[Item, float], links: Mapping[Item, Mapping[int, list[Item]]]) -> float:
    """The mean of the neighbours, of which those of the same arrow count most: it shall be straight."""
    neighbours = [one for side in (-1, 1) for one in links[item][side]]
    weighed = [
        one
        for one in neighbours
        for _ in range(STIFFNESS if not isinstance(item, str) and not isinstance(one, str) else 1)
    ]
    return _mean([x[one] for one in weighed], x[item])


def _side_by_side(row: Sequence[Item], wanted: Mapping[Item, float]) -> dict[Item, float]:
    """Positions in the order of the row, near those that are wanted in the sense of least squares: pools of items that
    touch each other, each at the mean of what its items want (Ayer and others 1955)."""
    offset, pools = 0.0, []
    for before, item in zip([None, *row], row, strict=False):
        offset += 0.0 if before is None else (_width(before) + _width(item)) / 2 + GAP
        pools.append(([(item, offset)], wanted[item] - offset, 1.0 if isinstance(item, str) else float(STIFFNESS)))
        while len(pools) > 1 and pools[-1][1] < pools[-2][1]:
            (items, at, weight), (more, other, heavy) = pools[-2:]
            pools[-2:] = [(items + more, (at * weight + other * heavy) / (weight + heavy), weight + heavy)]
    return {item: at + offset for items, at, _ in pools for item, offset in items}


def _width(item: Item) -> float:
    return BOX if isinstance(item, str) else PLACE


def _arrow(path, x, tops, heights) -> str:
    points = []
    (begin, first), *between, (end, last) = path
    points.append((x[begin], tops[first] + heights[first]))
    for item, i in between:
        points += [(x[item], tops[i]), (x[item], tops[i] + heights[i])]
    points.append((x[end], tops[last] - 3))
    text = f"M {points[0][0]:.0f} {points[0][1]:.0f}"
    for (x0, y0), (x1, y1) in pairwise(points):
        middle = (y0 + y1) / 2
        text += f" C {x0:.0f} {middle:.0f} {x1:.0f} {middle:.0f} {x1:.0f} {y1:.0f}"
    return f'<path class="arrow" d="{text}"><title>{escape(str(begin))} imports {escape(str(end))}</title></path>'


def _box(name: str, text: Sequence[str], x: float, top: float, height: float) -> str:
    left = x - BOX / 2
    rows = "".join(f'<tspan x="{left + 10:.0f}" dy="{LINE_HEIGHT}">{escape(line)}</tspan>' for line in text)
    return (
        f'<rect x="{left:.0f}" y="{top:.0f}" width="{BOX}" height="{height:.0f}" rx="6"/>'
        f'<text class="name" x="{left + 10:.0f}" y="{top + 19:.0f}">{escape(name)}/</text>'
        f'<text class="text" y="{top + 22:.0f}">{rows}</text>'
    )


def _document(parts: Sequence[str], width: float, height: float) -> str:
    body = "\n".join(parts)
    return f"""<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {width:.0f} {height:.0f}" font-family="sans-serif">
<style>
rect {{ fill: #f4f7fb; stroke: #35507a; }}
.name {{ font-size: 14px; font-weight: bold; fill: #1c2f4d; }}
.text {{ font-size: 11px; fill: #333; }}
.arrow {{ fill: none; stroke: #7189ab; stroke-width: 1.4; marker-end: url(#head); }}
</style>
<defs><marker id="head" viewBox="0 0 8 8" refX="7" refY="4" markerWidth="8" markerHeight="8" orient="auto"
><path d="M 0 0 L 8 4 L 0 8 z" fill="#7189ab"/></marker></defs>
<rect x="0" y="0" width="100%" height="100%" style="fill: white; stroke: none"/>
{body}
</svg>
"""
