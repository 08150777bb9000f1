"""Reads the machine code of the kernel: its pair loop, and what kinds of instructions it has."""

import re
from collections import Counter
from dataclasses import dataclass
from typing import Any

from llvmlite import binding

from calcidem.dem.engine.leapfrog import State, no_recording, run_kernel
from calcidem.dem.kernels.compiling import compile_function
from calcidem.dem.kernels.steps import advance_steps

LABEL = re.compile(r"^(\.LBB\d+_\d+):")
JUMP = re.compile(r"^\tj\w+\t(\.LBB\d+_\d+)")
INSTRUCTION = re.compile(r"^\t([a-z]\w*)\s*(.*)$")
KINDS = {
    "division": re.compile(r"vdiv"),
    "square root": re.compile(r"vsqrt"),
    "estimate": re.compile(r"v(rsqrt|rcp)"),
    "multiply-add": re.compile(r"vf(n?)m(add|sub)"),
    "other arithmetic": re.compile(r"v(add|sub|mul|min|max|cmp|and|xor|or|blend)"),
    "load or store": re.compile(r"vmov"),
    "broadcast": re.compile(r"vbroadcast"),
}


@dataclass(frozen=True)
class Loop:
    """Instructions of one loop without the loops inside it, in program order."""

    lines: tuple[str, ...]

    def packed(self, register: str) -> list[str]:
        """Arithmetic, load and store lines that work on a whole register of the given kind (``zmm``, ``ymm``)."""
        return [line for line in self.lines if f"%{register}" in line]

    def kinds(self, register: str) -> Counter[str]:
        """Number of vector instructions of each kind."""
        names = [name for line in self.packed(register) if (name := kind_of(line)) is not None]
        return Counter(names)

    def scalar(self, names: tuple[str, ...]) -> list[str]:
        """Lines with one of the given scalar instructions."""
        return [line for line in self.lines if (found := INSTRUCTION.match(line)) and found.group(1) in names]


def kind_of(line: str) -> str | None:
    """Kind of a vector instruction."""
    found = INSTRUCTION.match(line)
    if found is None:
        return None
    return next((kind for kind, pattern in KINDS.items() if pattern.match(found.group(1))), None)


def fresh_kernel(state: State) -> Any:  # noqa: ANN401 - a function of numba
    """The kernel for the features of a state, compiled anew, because a cached one has no text."""
    fresh: Any = compile_function(error_model="numpy")(advance_steps.py_func)
    fresh(*captured_arguments(state))
    return fresh


def assembly_of(kernel: Any) -> str:  # noqa: ANN401 - a function of numba
    """Machine code of a fresh kernel."""
    text: str = next(iter(kernel.inspect_asm().values()))
    return text


def assembly_for(triple: str, kernel: Any) -> str:  # noqa: ANN401 - a function of numba
    """What LLVM makes of a fresh kernel for another family of processors; RuntimeError if it does not know that."""
    binding.initialize_all_targets()
    binding.initialize_all_asmprinters()
    machine = binding.Target.from_triple(triple).create_target_machine(opt=3)
    module = binding.parse_assembly(next(iter(kernel.inspect_llvm().values())))
    module.triple, module.data_layout = triple, str(machine.target_data)
    text: str = machine.emit_assembly(module)
    return text


def captured_arguments(state: State) -> tuple[Any, ...]:
    """Return the arguments `run_kernel` gives to the kernel for no steps at all."""
    import calcidem.dem.engine.leapfrog as module  # noqa: PLC0415 - its global name is replaced for one call

    caught: list[tuple[Any, ...]] = []

    def catch(*arguments: object) -> int:
        caught.append(arguments)
        return 0

    original = module.advance_steps
    module.advance_steps = catch
    try:
        run_kernel(state, 0, no_recording(state))
    finally:
        module.advance_steps = original
    return caught[0]


def innermost_loops(text: str) -> list[Loop]:
    """Loops that have no loop inside."""
    lines = text.splitlines()
    place = {found.group(1): number for number, line in enumerate(lines) if (found := LABEL.match(line))}
    spans = []
    for number, line in enumerate(lines):
        found = JUMP.match(line)
        if found and place.get(found.group(1), number) < number:
            spans.append((place[found.group(1)], number))
    inner = [
        span
        for span in spans
        if not any(span != other and span[0] <= other[0] and other[1] <= span[1] for other in spans)
    ]
    return [Loop(tuple(lines[begin : end + 1])) for begin, end in inner]


def pair_loop(text: str, register: str) -> Loop:
    """Loop over the pairs of a block of disks: the innermost loop with the most vector arithmetic."""

    def arithmetic(loop: Loop) -> int:
        kinds = loop.kinds(register)
        return sum(count for kind, count in kinds.items() if kind not in {"load or store", "broadcast"})

    return max(innermost_loops(text), key=arithmetic)
