"""Answers that are read at a Python prompt and in a notebook."""

from __future__ import annotations

from io import StringIO
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from rich.console import Console


class Printable:
    """An answer that `print` shows as the command does that gives it, and that a prompt shows in one line."""

    @property
    def title(self) -> str:
        """What the answer is about, in a few words."""
        raise NotImplementedError

    def show(self, out: Console) -> None:
        """Print the answer to a console."""
        raise NotImplementedError

    def __repr__(self) -> str:
        return f"<{type(self).__name__}: {self.title}>"

    def __str__(self) -> str:
        from vsense_ros.evaluate.terminal import PIPE_WIDTH, PlainConsole

        text = StringIO()
        self.show(PlainConsole(file=text, width=PIPE_WIDTH))
        return text.getvalue().strip("\n")
