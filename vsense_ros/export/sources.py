"""What all exported sources share: names and texts as C takes them, templates, and compilation."""

from __future__ import annotations

import re
import subprocess
from collections.abc import Iterable, Mapping, Sequence
from importlib import resources
from pathlib import Path

import jinja2

from vsense_ros import codegen
from vsense_ros.errors import InputError

PREFIX = "vsense"  # of every name that other sources see
_PLAIN = str.maketrans({"²": "^2", "³": "^3", "°": "deg", "µ": "u", "·": " ", "×": "x", "–": "-", "…": "..."})
_MATHEMATICS = (
    "sqrt|sin|cos|tan|asin|acos|atan|atan2|sinh|cosh|tanh|asinh|acosh|atanh|exp|log|pow|fabs|fmin|fmax|fmod|copysign|"
    "hypot|floor|ceil|rint|erf|log1p|expm1"
)
_LITERAL = re.compile(r"(?<![\w.%])(\d+\.\d*(?:[eE][+-]?\d+)?|\d+[eE][+-]?\d+)(?![\w.])")


def identifier(name: str) -> str:
    """A name as C allows it behind a prefix; without two underscores in a row, which CasADi refuses."""
    return re.sub(r"[\W_]+", "_", name.lower(), flags=re.ASCII).strip("_")


def plain(text: str) -> str:
    """A text as compilers take it that know nothing but ASCII."""
    return text.translate(_PLAIN).encode("ascii", "replace").decode()


def in_single_precision(text: str) -> str:
    """The sources with `float` for `double`, in types, constants and functions of libm."""
    text = text.replace("1e-300", "1e-30")  # below which a pivot is taken for zero
    text = re.sub(r"(?<!long )\bdouble\b", "float", text)
    text = re.sub(rf"\b({_MATHEMATICS})\(", r"\1f(", text)
    text = _LITERAL.sub(r"\1f", text)
    return text.replace("#define STATES", "#define SINGLE 1\n#define STATES", 1)


def templates() -> jinja2.Environment:
    """The templates of this package; a name that they do not get is an error."""
    return jinja2.Environment(
        loader=jinja2.PackageLoader("vsense_ros.export", "templates"),
        undefined=jinja2.StrictUndefined,
        keep_trailing_newline=True,
        autoescape=False,
    )


def packaged(files: Iterable[str]) -> dict[str, str]:
    """C files of the package, given by their paths in it, by name."""
    package = resources.files("vsense_ros")
    return {Path(file).name: package.joinpath(file).read_text(encoding="utf-8") for file in files}


def require_prefix(prefix: str) -> None:
    """Raise `InputError` where names in C cannot begin with this."""
    if not re.fullmatch(r"[a-z][a-z0-9]*(_[a-z0-9]+)*", prefix):
        raise InputError(
            f"--prefix {prefix}: expected small letters, digits and single underscores, beginning with a letter, as "
            "car_a; names of files, types and functions begin with it"
        )


def _renamed(text: str, prefix: str) -> str:
    """The text with names that begin with `prefix` in place of `vsense`; the command of that name stays."""
    text = re.sub(r"\bvsense(?=_|\b)(?! export)", prefix, text)
    return re.sub(r"\bVSENSE(?=_|\b)", prefix.upper(), text)


def write_all(folder: Path, texts: Mapping[str, str], prefix: str = PREFIX) -> list[Path]:
    """Write texts into a folder, which is made where it is missing; returns the files.

    A program may contain several exports with a `prefix` each: whatever a linker or another file sees begins with it.
    """
    if prefix != PREFIX:
        texts = {_renamed(name, prefix): _renamed(text, prefix) for name, text in texts.items()}
    folder.mkdir(parents=True, exist_ok=True)
    for name, text in texts.items():
        (folder / name).write_text(text if name.endswith(".md") else plain(text), encoding="utf-8")
    return [folder / name for name in texts]


def compile_library(
    sources: Sequence[Path], target: Path, flags: Sequence[str], instead: str, compiler: str | None = None
) -> None:
    """Compile sources to a shared library, with the compiler of this machine or another. Raises `InputError` where the
    compiler complains, and where there is none: `instead` says what that means to the user."""
    compiler = compiler or codegen.compiler()
    if compiler is None:
        raise InputError(f"no C compiler here (cc, gcc or clang; CC names another){instead}")
    command = [compiler, *flags, "-shared", *map(str, sources), "-o", str(target), "-lm"]
    done = subprocess.run(command, capture_output=True, text=True)
    if done.returncode or done.stderr:
        raise InputError(f"{' '.join(command)}:\n{done.stderr}")
