"""Writes what is made from the list of registers: python hw/registers.py

register_map.sv and chosen_kernel.sv in hw/control, hw/registers.h, and the table in hw/README.md between its marks.
"""

from pathlib import Path

from vsense_ros.accelerator import registers

HERE = Path(__file__).parent
BEGIN, END = "<!-- registers: made by hw/registers.py -->\n", "<!-- end of registers -->"


def written() -> dict[Path, str]:
    """Every file and what it has to hold."""
    readme = HERE / "README.md"
    before, _, rest = readme.read_text(encoding="utf-8").partition(BEGIN)
    _, _, after = rest.partition(END)
    return {
        HERE / "control" / "register_map.sv": registers.package(),
        HERE / "control" / "chosen_kernel.sv": registers.chosen_kernel(),
        HERE / "registers.h": registers.c_header(),
        readme: before + BEGIN + registers.markdown() + END + after,
    }


if __name__ == "__main__":
    for path, text in written().items():
        path.write_text(text, encoding="utf-8")
