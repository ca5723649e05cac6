"""What a preset says of a network of the pathfold family, and what follows from it alone."""

from __future__ import annotations

from typing import Literal

from pathfold.models import ALL_SAMPLES
from pydantic import Field

from ..sizes import Count, Sizes

LEVELS = 5
ALIGNMENT = 1 << (LEVELS - 1)


class PathfoldSizes(Sizes):
    """From half resolution down to 1/16."""

    family: Literal["pathfold"] = "pathfold"
    widths: tuple[Count, Count, Count, Count] = Field((64, 96, 128, 160), description="channels per level")
    convolutions: tuple[int, int, int, int] = Field((3, 2, 2, 2), description="per level, the same on the way back up")
    embedding: int = Field(8, ge=1, description="C: channels of the path embedding")
    embedded: int = Field(0, ge=0, description="the most samples of a pixel that are embedded; 0 for all of them")

    @property
    def path_samples(self) -> int:
        return self.embedded or ALL_SAMPLES


def overlap(sizes: PathfoldSizes) -> int:
    """Pixels around a tile that its result depends on, a multiple of 16: follows radii through the layers.

    A map at level l of radius r depends on the pixels of its cell and r more on every side: a 3x3 convolution adds
    2^l, pooling nothing, upsampling to level l (the parent may start one cell earlier) 2^l.
    """
    radius = [0]
    for level, count in enumerate(sizes.convolutions):  # the U-Net's level 0 is the pyramid's level 1
        radius.append(radius[-1] + count * 2 ** (level + 1))
    near = radius[1] + 1  # trust's: it is used for both pixels of a cell
    logits = {LEVELS - 1: radius[-1]}
    here = radius[-1]
    for level in reversed(range(1, LEVELS - 1)):
        here += (1 + sizes.convolutions[level - 1]) * 2**level
        logits[level] = here
    logits[0] = here + 1
    # the gather reads level l's logits at the cells that upsampling reaches from the pixel
    reach = [2 ** (level + 1) - 2 for level in range(LEVELS)]
    taps = [2 * 2**level + reach[level] for level in range(LEVELS)]  # two cells further, of a pyramid of so many levels
    # a tap's radiance is divided by what another pyramid makes of its albedo
    near = max(near, taps[2], *(radius[level] + reach[level] for level in (1, 2)))
    most = max(taps[-1] + near, *(logits[level] + reach[level] for level in range(LEVELS)))
    return -(-most // ALIGNMENT) * ALIGNMENT
