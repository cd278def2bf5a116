"""One frame of a drive: hands of motor and load, and the tooth in its gap."""

from __future__ import annotations

import math

import numpy as np
from PIL import Image, ImageDraw

_HEIGHT, _WIDTH, _DIAL = 240, 480, 95
_LOAD, _MOTOR, _REFERENCE, _INK = (31, 90, 160), (200, 70, 40), (60, 140, 70), (60, 60, 60)
_SMALLEST = 2e-3  # rad of half gap that the right-hand side is scaled to at least


def frame(theta_L: float, theta_B: float, half_gap: float, reference: float | None) -> np.ndarray:
    """A (240, 480, 3) picture, uint8.

    Left: hands of the load (wide), the motor, and the reference where it is an angle. Right: the
    tooth of the motor between the flanks of the load, at theta_B between +-half_gap (rad).
    """
    image = Image.new("RGB", (_WIDTH, _HEIGHT), "white")
    draw = ImageDraw.Draw(image)
    middle = _HEIGHT // 2
    box = middle - _DIAL, middle - _DIAL, middle + _DIAL, middle + _DIAL
    draw.ellipse(box, outline=_INK, width=2)
    hands = [(theta_L, _LOAD, 9), (theta_L + theta_B, _MOTOR, 3)]
    if reference is not None:
        hands.insert(0, (reference, _REFERENCE, 2))
    for angle, colour, width in hands:
        tip = middle + _DIAL * math.sin(angle), middle - _DIAL * math.cos(angle)
        draw.line([(middle, middle), tip], fill=colour, width=width)
    _gap(draw, theta_B, half_gap)
    return np.array(image)


def _gap(draw: ImageDraw.ImageDraw, theta_B: float, half_gap: float) -> None:
    """The flanks at +-half_gap and the tooth; it digs in where the joint carries torque."""
    centre, middle, tooth = 360, _HEIGHT // 2, 14
    pixels = 40.0 / max(half_gap, _SMALLEST)
    flank = pixels * half_gap + tooth
    for side in (-1.0, 1.0):
        inner, outer = centre + side * flank, centre + side * 110
        span = sorted((inner, outer))
        draw.rectangle([span[0], middle - 50, span[1], middle + 50], fill=_LOAD)
    at = centre + max(-95.0, min(95.0, pixels * theta_B))
    draw.rectangle([at - tooth, middle - 70, at + tooth, middle + 30], fill=_MOTOR)
