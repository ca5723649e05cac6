"""What one training run is: a preset file, validated; saved with the checkpoint and in the exported manifest."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal, Self, Union

import yaml
from pydantic import Discriminator, Field, Tag, ValidationError, model_validator

from ..networks.families import FAMILIES, family
from ..networks.kpcn.sizes import KpcnSizes
from ..networks.losses import Loss
from ..networks.sizes import Count, Share, Sizes, Strict, Weight


class Data(Strict):
    crop: int = Field(96, ge=16)  # the loss looks at blocks of 16x16 pixels
    batch: Count = 4
    spp_min: Count = 1
    spp_max: Count = 8
    drop: Share = 0.1  # probability that an optional input is absent, each on its own
    drop_all: Share = 0.05  # ... that everything beyond color (and samples) is absent
    drop_split: Share = 0.15
    drop_paths: Share = 0.0  # ... that the samples are absent, for networks that can do without
    magnified: Share = 0.0  # ... that a crop is magnified, one to three times (magnify.py)
    fireflies: Share = 0.0  # ... that a few pixels of a crop get a firefly that the reference does not show
    cleaned: bool = False  # the pathfold family learns from references cleaned by clean.py, not from them as they are
    normal_turn: Share = 0.3  # probability of a random rotation, so that world space works too

    @model_validator(mode="after")
    def _in_order(self) -> Self:
        if self.spp_min > self.spp_max:
            raise ValueError(f"spp_min {self.spp_min} is more than spp_max {self.spp_max}")
        return self


class Optimiser(Strict):
    steps: Count = 4000
    learning_rate: Weight = 5.0e-4
    warmup: Count = 100
    final_fraction: Share = 0.01  # of the learning rate, at the end of the cosine
    clip: Weight = 1.0  # gradient norm
    precision: Literal["auto", "fp32", "bf16"] = "auto"  # bf16 on a GPU; fp32 on a CPU, faster there without AMX
    # decay of the exponential moving average of the weights that is kept; 0 keeps the last ones
    average: float = Field(0.0, ge=0, lt=1)


if TYPE_CHECKING:
    AnySizes = Sizes
else:
    AnySizes = Annotated[
        Union[tuple(Annotated[row.sizes, Tag(name)] for name, row in FAMILIES.items())],  # noqa: UP007
        Discriminator(family),
    ]


class Config(Strict):
    name: str
    description: str
    network: AnySizes = KpcnSizes()
    loss: Loss = Loss()
    data: Data = Data()
    optimiser: Optimiser = Optimiser()

    @staticmethod
    def load(path: Path) -> Config:
        """Read a preset; what it does not say is as its family has it.

        Raises ValueError naming the file and each key that does not fit.
        """
        there = f"there are: {', '.join(preset_names())}"
        try:
            return Config.model_validate(with_defaults(yaml.safe_load(path.read_text())))
        except FileNotFoundError:
            raise ValueError(f"no preset {path}; {there}") from None
        except OSError as error:
            raise ValueError(f"cannot read preset {path}: {error.strerror}; {there}") from error
        except ValidationError as error:
            raise ValueError(f"preset {path}: {problems(error)}") from error
        except (UnicodeDecodeError, yaml.YAMLError) as error:
            raise ValueError(f"preset {path} is no YAML ({error}); {there}") from error

    def with_steps(self, steps: int) -> Config:
        """The same, trained for so many steps."""
        return self.model_copy(update={"optimiser": self.optimiser.model_copy(update={"steps": steps})})


def problems(error: ValidationError) -> str:
    """Each key that does not fit, with its fault, in one line."""
    found = []
    for entry in error.errors(include_url=False):
        keys = [str(key) for key in entry["loc"]]
        if keys[:1] == ["network"]:
            del keys[1:2]  # its family, which is no key
        of_key = entry["type"] in ("missing", "extra_forbidden", "value_error")  # whatever the value
        fault = entry["msg"] if of_key else f"{entry['msg']}, not {entry['input']!r}"
        found.append(f"{'.'.join(keys)}: {fault}" if keys else fault)
    return "; ".join(found)


HERE = Path(__file__).resolve().parent.parent  # the package
PRESETS = HERE / "presets" if (HERE / "presets").is_dir() else HERE.parent / "presets"  # in a wheel; in a checkout


def with_defaults(preset: Any) -> Any:
    """What a preset file holds, over what presets/families/ has for its family; what is no preset stays as it is."""
    network = preset.get("network", {}) if isinstance(preset, dict) else None
    file = PRESETS / "families" / f"{family(network)}.yaml"
    if not isinstance(network, dict) or not file.is_file():
        return preset
    merged = dict(preset)
    for part, values in yaml.safe_load(file.read_text()).items():
        own = preset.get(part, {})
        merged[part] = values | own if isinstance(own, dict) else own
    return merged


def preset_names() -> list[str]:
    return sorted(p.stem for p in PRESETS.glob("*.yaml"))


def load_preset(name_or_path: str) -> Config:
    """A preset by name (training/presets/NAME.yaml) or by path."""
    path = Path(name_or_path)
    return Config.load(path if path.suffix == ".yaml" else PRESETS / f"{name_or_path}.yaml")
