"""What a preset says of a KPCN, and what follows from it alone."""

from __future__ import annotations

from typing import Literal

from pathfold.models import ALL_SAMPLES
from pydantic import Field

from .. import embedding
from ..sizes import Count, Sizes


class KpcnSizes(Sizes):
    """KPCN's widths; the topology is the same for every preset."""

    family: Literal["kpcn"] = "kpcn"
    width: int = Field(32, ge=4, description="channels of R's 5x5 convolutions")
    layers: int = Field(9, ge=2, description="convolutions of R, the last one 1x1 (compact) or 5x5 (full)")
    last_kernel: Literal[1, 5] = 1
    head: int = Field(128, ge=0, description="channels of a 1x1 layer before the last one; 0 for none (full)")
    kernel_size: int = Field(21, ge=3, description="K: the side of the predicted gather kernels, odd")
    trust: bool = Field(True, description="one more logit per pixel, added wherever the pixel is a kernel's tap")
    embedding: int = Field(0, ge=0, description="C: channels of the path embedding; 0 for kpcn-vanilla")
    embedding_width: int = Field(16, ge=4, description="channels of F's top level; 2 and 4 times that below")
    lattice: Count = Field(3, description="in training kernels are predicted on every n-th pixel in both directions")

    @property
    def path_samples(self) -> int:
        return ALL_SAMPLES if self.embedding else 0


def overlap(sizes: KpcnSizes) -> int:
    """Pixels around a tile that its result depends on: R, the gradient's one, F, and the kernel; a multiple of 4."""
    radius = 2 * (sizes.layers - 1) + sizes.last_kernel // 2 + 1 + sizes.kernel_size // 2
    radius += embedding.RADIUS if sizes.embedding else 0
    return -(-radius // embedding.ALIGNMENT) * embedding.ALIGNMENT
