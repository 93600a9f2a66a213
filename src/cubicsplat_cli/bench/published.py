"""Figures of the paper (CubicSplat, ECCV 2026) that `bench paper` puts beside ours, and what differs in protocol."""

from __future__ import annotations

# Table 1: milliseconds of the forward and the backward pass; 2040 x 1344 px, 2,048 curves, RTX 4090.
SIZE, CURVES = (2040, 1344), 2048
STEP_MS = {"open": (2.70, 4.07), "closed": (10.68, 8.96)}
# Table 2: SSIM, PSNR in dB and minutes; mean of 200 pictures of DIV2K, RTX 4090.
QUALITY = {
    ("open", 256): (0.624, 23.07, 1.8),
    ("open", 512): (0.662, 24.43, 1.8),
    ("open", 1024): (0.708, 25.93, 1.8),
    ("closed", 256): (0.629, 23.00, 1.8),
    ("closed", 512): (0.664, 24.31, 1.9),
    ("closed", 1024): (0.705, 25.78, 2.1),
}
# A complex illustration.
MANY_CURVES, MANY_DB, MANY_MB = 32_768, 38.09, 2118
# Magnified so many times, to 24,480 px across, the averaged picture stays so near to the native one, dB.
MAGNIFICATION, MAGNIFIED_WITHIN_DB = 12, 0.5

NOTES = {
    "steps": (
        "Published: forward and backward pass on an RTX 4090, the optimiser not counted. Ours: this machine, in the "
        "middle of a fit to a drawn picture; a step has loss, optimiser and replacement in it."
    ),
    "growth": "Exponents are slopes of the median step's logarithm over the five points' logarithms.",
    "quality": (
        "Published: DIV2K on an RTX 4090, 10,000 steps, the paper's own renderer with soft edges. Ours: this folder "
        "and machine; SVG dB and SSIM are of the file in an independent renderer, own dB is the engine's exact picture."
    ),
    "magnify": (
        "Published: the engine's picture at 12 times the size, averaged back, within 0.5 dB of the native one. Ours: "
        "the same of the engine, and of the file in an independent renderer."
    ),
    "large": (
        "Published: one illustration that is not ours to have, memory of an RTX 4090. Ours: this folder; memory is the "
        "whole process's peak, Python and torch with it."
    ),
}
