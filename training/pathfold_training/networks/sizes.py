"""What a preset says of its network; each family has its own."""

from __future__ import annotations

from typing import Annotated

from pydantic import BaseModel, ConfigDict, Field

Count = Annotated[int, Field(ge=1)]
Share = Annotated[float, Field(ge=0, le=1)]
Weight = Annotated[float, Field(ge=0)]


class Strict(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)


class Sizes(Strict):
    """A family narrows `family` to its name and adds its fields."""

    family: str

    @property
    def path_samples(self) -> int:
        """The most samples of a pixel whose paths the network looks at; pathfold.models.ALL_SAMPLES for no limit."""
        raise NotImplementedError
