"""The structures that Python hands to C++ and CUDA have the layout that the headers give them."""

from __future__ import annotations

import ctypes
import subprocess

import pytest
from emulated import EMULATOR, compiler

from cubicsplat_cli.raster import cpu
from cubicsplat_cli.raster.cuda import frame
from cubicsplat_cli.raster.cuda.compile import KERNELS

HOST = '#include <cstddef>\n#include "cpu/abi.h"\n'
DEVICE = '#include <cstddef>\n#include "cuda_shim.h"\n#include "frame.cuh"\nusing namespace cs;\n'
CASES = [
    (HOST, {"CsScene": cpu._Scene, "CsSettings": cpu._Settings, "CsImages": cpu._Images}),
    (HOST, {"CsGradients": cpu._Gradients, "CsTraining": cpu._Training}),
    (DEVICE, {"Frame": frame.StepFrame, "Step": frame.StepValues}),
]


def assertions(name: str, structure: type[ctypes.Structure]) -> str:
    """C++ that compiles only where the structure of a name has these fields at these places, and ends where it ends."""
    lines = [f'static_assert(sizeof({name}) == {ctypes.sizeof(structure)}, "size of {name}");']
    for field in structure._fields_:
        place = getattr(structure, field[0])
        member = f"{name}, {field[0]}"
        lines.append(f'static_assert(offsetof({member}) == {place.offset}, "place of {member}");')
        lines.append(f'static_assert(sizeof({name}::{field[0]}) == {place.size}, "size of {member}");')
    return "\n".join(lines) + "\n"


def complaints(text: str) -> str:
    """What the compiler says of a text; empty where it is content."""
    options = ["-std=c++17", "-fsyntax-only", "-x", "c++", f"-I{KERNELS}", f"-I{EMULATOR}"]
    options += [*(f"-I{KERNELS / folder}" for folder in ("cuda", "shared"))]
    options += ["-DCS_CLOSED=1", "-DCS_CHANNELS=3", "-DCS_PAINTED=1", "-"]
    return subprocess.run([compiler(), *options], input=text, capture_output=True, text=True, check=False).stderr


@pytest.mark.skipif(compiler() is None, reason="needs a C++ compiler")
@pytest.mark.parametrize(("header", "structures"), CASES, ids=["cpu-scene", "cpu-training", "cuda"])
def test_structures_have_the_layout_of_the_headers(header, structures):
    assert complaints(header + "".join(assertions(name, s) for name, s in structures.items())) == ""


@pytest.mark.skipif(compiler() is None, reason="needs a C++ compiler")
def test_two_fields_the_other_way_round_are_found():
    fields = [cpu._Settings._fields_[1], cpu._Settings._fields_[0], *cpu._Settings._fields_[2:]]
    swapped = type("_Swapped", (ctypes.Structure,), {"_fields_": fields})
    assert "place of CsSettings, samples" in complaints(HOST + assertions("CsSettings", swapped))
