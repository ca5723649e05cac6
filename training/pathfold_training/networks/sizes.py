"""What a preset says of its network: the sizes of each family."""

from __future__ import annotations

from typing import Annotated, Literal

from pathfold.models import ALL_SAMPLES
from pydantic import BaseModel, ConfigDict, Field

Count = Annotated[int, Field(ge=1)]
Share = Annotated[float, Field(ge=0, le=1)]
Weight = Annotated[float, Field(ge=0)]


class Strict(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)


class KpcnSizes(Strict):
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

    @property
    def path_samples(self) -> int:
        """The most samples of a pixel whose paths the network looks at."""
        return ALL_SAMPLES if self.embedding else 0


class PathfoldSizes(Strict):
    """The pathfold family's sizes, from half resolution down to 1/16."""

    family: Literal["pathfold"] = "pathfold"
    widths: tuple[Count, Count, Count, Count] = Field((64, 96, 128, 160), description="channels per level")
    convolutions: tuple[int, int, int, int] = Field((3, 2, 2, 2), description="per level, the same on the way back up")
    embedding: int = Field(8, ge=1, description="C: channels of the path embedding")
    embedded: int = Field(0, ge=0, description="the most samples of a pixel that are embedded; 0 for all of them")
    demodulate: bool = Field(True, description="radiance is divided by the albedo while it is filtered")
    clean: bool = Field(False, description="an albedo that a pyramid of its own, of three levels, has cleaned")
    scaled: bool = Field(False, description="descriptors enter the embedding with mean 0 and deviation 1")

    @property
    def path_samples(self) -> int:
        """The most samples of a pixel whose paths the network looks at."""
        return self.embedded or ALL_SAMPLES


def family(network: object) -> str:
    """'kpcn' where a preset does not say."""
    return network.get("family", "kpcn") if isinstance(network, dict) else getattr(network, "family", "kpcn")
