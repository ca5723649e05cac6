"""The colours of one scene: most things share a few hues and a range of brightness, some stand out."""

from __future__ import annotations

from colorsys import hsv_to_rgb
from typing import NamedTuple

from numpy.random import Generator


class Tones(NamedTuple):
    """Hues in turns, how far a colour strays from them, ranges of HSV saturation and value, and a share of accents."""

    hues: tuple[float, ...]
    stray: float
    saturation: tuple[float, float]
    value: tuple[float, float]
    accents: float = 0

    def colour(self, rng: Generator, low: float = 0, high: float = 1) -> list[float]:
        """A linear reflectance RGB in [0.005, 0.9] from the part [low, high] of the range of brightness."""
        if rng.uniform() < self.accents:
            return linear(rng.uniform(), rng.uniform(0.7, 1), rng.uniform(0.6, 0.95))
        hue = self.hues[rng.integers(len(self.hues))] + self.stray * rng.normal()
        dark, bright = self.value
        return linear(hue, rng.uniform(*self.saturation), dark + (bright - dark) * rng.uniform(low, high))


def linear(hue: float, saturation: float, value: float) -> list[float]:
    """HSV as a display shows it, in linear RGB."""
    return [min(0.9, max(0.005, c**2.2)) for c in hsv_to_rgb(hue % 1, saturation, value)]


def white(hue: float) -> Tones:
    """White paint and linen, some with a touch of the hue, and a few things that stand out."""
    return Tones((0.09, hue), 0.03, (0, 0.12), (0.75, 0.97), 0.12)


def draw(rng: Generator) -> Tones:
    """White, grey, dark, earthen, pastel, vivid, of one hue, of two opposite ones, or anything."""
    hue = float(rng.uniform())
    schemes = (
        white(hue),
        Tones((hue,), 0.1, (0, 0.1), (0.25, 0.9), 0.15),
        Tones((hue, hue + 0.1), 0.05, (0, 0.6), (0.1, 0.5), 0.1),
        Tones((0.05, 0.09, 0.13), 0.02, (0.2, 0.65), (0.3, 0.9), 0.05),
        Tones((0, 0.25, 0.5, 0.75), 0.15, (0.1, 0.4), (0.75, 0.97)),
        Tones((hue, hue + 0.33, hue + 0.67), 0.04, (0.65, 1), (0.4, 0.95)),
        Tones((hue,), 0.03, (0.2, 0.85), (0.25, 0.95)),
        Tones((hue, hue + 0.5), 0.03, (0.3, 0.8), (0.3, 0.95), 0.05),
        Tones((0, 0.2, 0.4, 0.6, 0.8), 0.1, (0, 0.9), (0.2, 0.95)),
    )
    return schemes[rng.integers(len(schemes))]
