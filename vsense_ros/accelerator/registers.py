"""The registers that a processor starts and reads a kernel by, over AXI4-Lite: one list, from which the hardware's
package, a header for C and the table of the documents are made (`hw/registers.py`).

The first four are laid out and behave as those of AMD's high-level synthesis (UG1399, "S_AXILITE control register
map"), so that drivers for such kernels start ours; what belongs to the kernel begins at 0x10.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

from vsense_ros.accelerator.frame import Status
from vsense_ros.accelerator.kernels import KERNELS, Kernel
from vsense_ros.accelerator.kernels.row_combiner import RowCombiner


@dataclass(frozen=True)
class Bits:
    """A field: lowest bit, width, and what it says."""

    name: str
    lowest: int
    width: int
    meaning: str


@dataclass(frozen=True)
class Register:
    """One word. `access` is rw, ro (read), rc (read, whose marked bits are cleared by it), or rt (written ones
    toggle)."""

    name: str
    offset: int
    access: str
    meaning: str
    fields: tuple[Bits, ...] = ()


DONE, READY = Bits("done", 0, 1, "result has left"), Bits("ready", 1, 1, "request was taken in")
REGISTERS = (
    Register(
        "CONTROL",
        0x00,
        "rc",
        "start and state",
        (
            Bits("start", 0, 1, "write 1: take one request; reads 1 until it has been taken in"),
            Bits("done", 1, 1, "the result has left; reading clears it"),
            Bits("idle", 2, 1, "no request is worked on"),
            Bits("ready", 3, 1, "the request was taken in; reading clears it"),
            Bits("auto_restart", 7, 1, "start again as soon as a request was taken in"),
            Bits("abort", 16, 1, "write 1: give up the request that is taken in or computed"),
            Bits("soft_reset", 17, 1, "write 1: as the reset of the hardware, but for this bus"),
        ),
    ),
    Register("GLOBAL_INTERRUPT", 0x04, "rw", "interrupts at all", (Bits("enable", 0, 1, "interrupts leave"),)),
    Register("INTERRUPT_ENABLE", 0x08, "rw", "which events interrupt", (DONE, READY)),
    Register("INTERRUPT_STATUS", 0x0C, "rt", "events since they were cleared by writing 1", (DONE, READY)),
    Register("KERNEL", 0x10, "ro", "number of the kernel, as in a frame"),
    Register("MAP_VERSION", 0x14, "ro", "version of this list"),
    Register("SIZE", 0x18, "ro", "rows of a matrix, or 0"),
    Register("WORDS_IN", 0x1C, "ro", "of a request; 0: a program, as long as it says"),
    Register("WORDS_OUT", 0x20, "ro", "of a result; 0: as many as the program asks for"),
    Register("TABLE_WORDS", 0x24, "ro", "of coefficients, or 0"),
    Register("MODE", 0x28, "rw", "what the next start takes in", (Bits("table", 0, 1, "coefficients"),)),
    Register(
        "STATUS",
        0x2C,
        "ro",
        "of the last packet: 0, 1 pivot or number refused, 6 given up or no coefficients, 7 wrong length",
    ),
    Register("COMPUTE_CYCLES", 0x30, "ro", "clocks of the last computation"),
    Register("LINK_CYCLES", 0x34, "ro", "clocks of the last request but those: words that came, left or were awaited"),
    Register("REQUESTS", 0x38, "ro", "results that have left since the reset"),
    Register("ABORTED", 0x3C, "ro", "requests that were given up since the reset"),
    Register("MALFORMED", 0x40, "ro", "packets of a wrong length since the reset"),
)
ADDRESS_BITS = 7
_MADE = "// Made by hw/registers.py from vsense_ros/accelerator/registers.py."
MAP_VERSION = 2  # 1 had no end of a packet, no abort and no soft reset


Registered = Kernel | type[RowCombiner]


def registered() -> dict[int, Registered]:
    """Every kernel that may stand behind the registers, by its number."""
    every: tuple[Registered, ...] = (*KERNELS.values(), RowCombiner)
    return {kernel.number: kernel for kernel in sorted(every, key=lambda kernel: kernel.number)}


def values(kernel: Registered) -> dict[str, int]:
    """What the registers of a kernel read that never change."""
    return {
        "KERNEL": kernel.number, "MAP_VERSION": MAP_VERSION, "SIZE": kernel.size, "WORDS_IN": kernel.words_in,
        "WORDS_OUT": kernel.words_out, "TABLE_WORDS": kernel.table_words,
    }  # fmt: skip


def package() -> str:
    """The package `register_map` in SystemVerilog."""
    return "\n".join(_package()) + "\n"


def chosen_kernel() -> str:
    """The module that holds the kernel of a number, in SystemVerilog."""
    return "\n".join(_chosen()) + "\n"


def _package() -> Iterator[str]:
    yield _MADE
    yield "package register_map;"
    yield f"  localparam int ADDRESS_BITS = {ADDRESS_BITS};"
    for register in REGISTERS:
        yield f"  localparam logic [{ADDRESS_BITS - 1}:0] {register.name} = {ADDRESS_BITS}'h{register.offset:02x};"
        for field in register.fields:
            yield f"  localparam int {register.name}_{field.name.upper()} = {field.lowest};"
    for name in values(RowCombiner):
        yield f"  function automatic int {name.lower()}_of(input int number);"
        yield "    case (number)"
        for kernel in registered().values():
            yield f"      {kernel.number}: {name.lower()}_of = {values(kernel)[name]};"
        yield f"      default: {name.lower()}_of = 0;"
        yield "    endcase"
        yield "  endfunction"
    for status in (Status.OK, Status.PIVOT, Status.FAULT, Status.WRONG_SIZE):
        yield f"  localparam logic [2:0] STATUS_{status.name} = 3'd{status};"
    yield "  // What `err` of a kernel means: a refused pivot, or no coefficients."
    yield "  function automatic logic [2:0] refusal_of(input int number);"
    yield "    refusal_of = (table_words_of(number) != 0) ? STATUS_FAULT : STATUS_PIVOT;"
    yield "  endfunction"
    yield "endpackage"


def _chosen() -> Iterator[str]:
    yield _MADE
    yield "// The kernel of a number, with the parameters that it is built with."
    yield "module chosen_kernel #(parameter int NUMBER = 1) ("
    ports = "input logic clk, rst_n, s_tvalid, s_tuser, m_tready, input logic [31:0] s_tdata,"
    yield f"    {ports}"
    yield "    output logic s_tready, s_ends, m_tvalid, m_tlast, err, output logic [31:0] m_tdata, cycles"
    yield ");"
    programmed = " & ".join(f"(NUMBER != {number})" for number, k in registered().items() if not k.words_in)
    yield f"  generate if ({programmed}) assign s_ends = 1'b0; endgenerate"
    yield "  generate"
    for i, kernel in enumerate(registered().values()):
        chosen = ", ".join(f".{name}({value})" for name, value in kernel.parameters.items())
        user = ".s_tuser, " if kernel.table_words else "" if kernel.words_in else ".s_ends, "
        names = ("clk", "rst_n", "s_tvalid", "s_tready", "s_tdata", "m_tvalid", "m_tready", "m_tdata", "m_tlast", "err")
        yield f"    {'end else ' if i else ''}if (NUMBER == {kernel.number}) begin : {kernel.name}"
        yield f"      {kernel.top} #({chosen}) kernel ({user}{', '.join(f'.{name}' for name in names)}, .cycles);"
    yield "    end"
    yield "  endgenerate"
    yield "endmodule"


def c_header() -> str:
    """Offsets and bits for a driver."""
    lines = ["/* Made by hw/registers.py from vsense_ros/accelerator/registers.py. */", "#ifndef VSENSE_REGISTERS_H"]
    lines.append("#define VSENSE_REGISTERS_H")
    for register in REGISTERS:
        lines.append(f"#define VSENSE_{register.name} 0x{register.offset:02x}u /* {register.meaning} */")
        for field in register.fields:
            mask = ((1 << field.width) - 1) << field.lowest
            lines.append(f"#define VSENSE_{register.name}_{field.name.upper()} 0x{mask:x}u /* {field.meaning} */")
    for kernel in registered().values():
        lines.append(f"#define VSENSE_KERNEL_{kernel.name.upper()} {kernel.number}u")
    return "\n".join([*lines, "#endif"]) + "\n"


def markdown() -> str:
    """The table of the documents."""
    lines = ["| offset | register | access | meaning |", "|---|---|---|---|"]
    for register in REGISTERS:
        bits = "; ".join(f"bit {f.lowest} `{f.name}`: {f.meaning}" for f in register.fields)
        text = f"{register.meaning}{': ' if bits else ''}{bits}"
        lines.append(f"| 0x{register.offset:02X} | `{register.name}` | {register.access} | {text} |")
    return "\n".join(lines) + "\n"
