"""Exported C on an emulated Cortex-M4F: instructions a step, flash and RAM.

With -icount shift=0 qemu's virtual clock goes on by 1 ns an instruction. The SysTick of the emulated board
(mps2-an386) counts it in steps of 40 ns, which ten thousand steps of the model make small; an empty loop of
the same length is taken off. qemu counts instructions, not cycles: a division takes 14 cycles.
"""

from __future__ import annotations

import re
import shutil
import subprocess
import tempfile
from collections.abc import Mapping
from pathlib import Path

CORE = ("-mcpu=cortex-m4", "-mthumb", "-mfloat-abi=hard", "-mfpu=fpv4-sp-d16")
TOOLS = ("arm-none-eabi-gcc", "arm-none-eabi-size", "qemu-system-arm")
MAIN = """
#include <stdint.h>
#include "plant.h"
#define SYST_CSR (*(volatile uint32_t *)0xE000E010u)
#define SYST_RVR (*(volatile uint32_t *)0xE000E014u)
#define SYST_CVR (*(volatile uint32_t *)0xE000E018u)
extern uint32_t _estack;
int main(void);
void Reset(void);
void Reset(void)
{
    *(volatile uint32_t *)0xE000ED88u |= 0xF00000u;
    __asm__ volatile("dsb\\nisb");
    (void)main();
}
__attribute__((section(".vectors"), used))
static const void *const vectors[2] = {&_estack, (const void *)Reset};
static void host(int op, const void *what)
{
    register int r0 __asm__("r0") = op;
    register const void *r1 __asm__("r1") = what;
    __asm__ volatile("bkpt 0xab" : : "r"(r0), "r"(r1) : "memory");
}
static plant_state s;
static volatile float seen;
static uint32_t ticks(int with_model)
{
    float u[PLANT_INPUTS] = {0}, y[PLANT_OUTPUTS] = {0};
    uint32_t begin, k;
    SYST_RVR = 0xFFFFFFu;
    SYST_CVR = 0u;
    SYST_CSR = 5u;
    begin = SYST_CVR;
    for (k = 0u; k < 10000u; k++) {
        u[0] = (k & 16u) ? 0.5f : -0.5f;
        if (with_model) {
            plant_step(&s, u, y);
        }
        seen = y[0] + u[0];
    }
    return (begin - SYST_CVR) & 0xFFFFFFu;
}
int main(void)
{
    char text[12];
    int i = 11;
    uint32_t n;
    plant_reset(&s);
    n = ticks(1) - ticks(0);
    text[i] = 0;
    do {
        text[--i] = (char)('0' + n % 10u);
        n /= 10u;
    } while (n);
    host(0x04, &text[i]);
    host(0x18, (const void *)0x20026);
    for (;;) {
    }
}
"""
SCRIPT = """
MEMORY { FLASH (rx) : ORIGIN = 0x00000000, LENGTH = 4M  RAM (rwx) : ORIGIN = 0x20000000, LENGTH = 4M }
ENTRY(Reset)
SECTIONS {
  .text : { KEEP(*(.vectors)) *(.text*) *(.rodata*) } > FLASH
  .ARM.exidx : { *(.ARM.exidx*) } > FLASH
  .data : { *(.data*) } > RAM
  .bss : { *(.bss*) *(COMMON) } > RAM
  _estack = ORIGIN(RAM) + LENGTH(RAM);
}
"""
NS_A_TICK = 40
STEPS = 10_000


def cortex(files: Mapping[str, str]) -> str:
    """What the files of an export named "plant" need there, in words."""
    missing = [tool for tool in TOOLS if shutil.which(tool) is None]
    if missing:
        return f"{', '.join(missing)} not installed"
    with tempfile.TemporaryDirectory() as folder:
        place = Path(folder)
        for name, text in files.items():
            (place / name).write_text(text)
        (place / "main.c").write_text(MAIN)
        (place / "link.ld").write_text(SCRIPT)
        options = ("-nostartfiles", "--specs=nano.specs", "-T", "link.ld", "main.c", "plant.c", "-lm")
        _built(place, *options, "-o", "plant.elf")
        _built(place, "-c", "plant.c", "-o", "plant.o")
        own = _sections(place, "plant.o")
        whole = _sections(place, "plant.elf")
        count = NS_A_TICK * _ticks(place) / STEPS
        flash = f"{own['text'] + own['rodata']} B of code and tables"
        linked = f"{whole['text'] + whole['rodata']} B with expf and start-up"
        static = f"{own['data'] + own['bss']} B static"
        return f"{count:.0f} instructions a step, {flash} ({linked}), {static}, {whole['bss'] - 4} B a state"


def _built(place: Path, *arguments: str) -> None:
    command = ["arm-none-eabi-gcc", *CORE, "-std=c99", "-O2", *arguments]
    subprocess.run(command, cwd=place, check=True, capture_output=True, text=True)


def _sections(place: Path, file: str) -> dict[str, int]:
    listed = subprocess.run(
        ["arm-none-eabi-size", "-A", file], cwd=place, check=True, capture_output=True, text=True
    ).stdout
    sizes = {"text": 0, "rodata": 0, "data": 0, "bss": 0}
    for name, size in re.findall(r"^\.(\w+)\S*\s+(\d+)", listed, re.MULTILINE):
        if name in sizes:
            sizes[name] += int(size)
    return sizes


def _ticks(place: Path) -> int:
    """Of the SysTick in all steps."""
    machine = (
        "-machine",
        "mps2-an386",
        "-cpu",
        "cortex-m4",
        "-nographic",
        "-monitor",
        "none",
        "-serial",
        "none",
    )
    count = ("-icount", "shift=0", "-semihosting", "-kernel", "plant.elf")
    done = subprocess.run(
        ["qemu-system-arm", *machine, *count],
        cwd=place,
        check=True,
        capture_output=True,
        text=True,
        timeout=120,
    )
    return int(re.findall(r"\d+", done.stdout + done.stderr)[-1])
