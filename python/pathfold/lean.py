"""What a rendered frame does not need, by the looks of the scene or of the frame itself.

All of it is exact: the denoised picture is the same, but for rounding, as with everything rendered and stored.
"""

from collections.abc import Callable, Collection, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pathfold._core import Layout, descriptor_vertices
from pathfold.channels import samples as sample_names
from pathfold.models import ALL_SAMPLES
from pathfold.rendering import Renderer

Block = dict[str, NDArray[Any]]


@dataclass(frozen=True)
class LeftOut:
    """Buffers that are not made or not kept, and why nothing is lost."""

    names: frozenset[str]
    why: str
    all_light: str = ""  # which part of the radiance is all of it, where that is what was found

    def __str__(self) -> str:
        return f"left out {', '.join(sorted(self.names))}: {self.why}"


@dataclass
class LeanFrame:
    """A frame without what it does not need, and a line for each thing that was left out."""

    buffers: Block
    samples: Block
    dropped: int  # samples that were not finite
    all_light: str  # the part of the radiance that is all of color, where the split was left out; else ""
    lines: list[str]


def trace(
    renderer: Renderer,
    spp: int,
    seed: int,
    max_depth: int,
    rr_depth: int | None,
    reads: Collection[str],
    bar: Callable[[float], None],
    recorded: int = ALL_SAMPLES,
) -> LeanFrame:
    """`Renderer.trace` of what a model reads, without what the scene and the frame do not need."""
    unneeded = of_scene(renderer.scene, spp, reads)
    wanted = set(reads).difference(*(one.names for one in unneeded))
    buffers, samples, dropped = renderer.trace(spp, seed, max_depth, rr_depth, wanted, bar, recorded)
    unneeded += of_frame(buffers)
    kept = {name: pixels for name, pixels in buffers.items() if not any(name in one.names for one in unneeded)}
    samples, trimmed = trim_vertices(samples)
    lines = [str(one) for one in unneeded] + ([trimmed] if trimmed else [])
    return LeanFrame(kept, samples, dropped, "".join(one.all_light for one in unneeded), lines)


def of_scene(scene: Any, spp: int, wanted: Collection[str]) -> list[LeftOut]:
    """What of the wanted buffers need not be rendered, by the BSDFs and emitters of a loaded mitsuba.Scene."""
    found = []
    if (part := _all_light(scene)) and (names := _of_split(part, wanted)):
        why = {
            "diffuse": "every BSDF is diffuse and no emitter can be hit: specular radiance is 0, color is diffuse",
            "specular": "no BSDF has a diffuse lobe: diffuse radiance is 0, color is specular",
        }
        found.append(LeftOut(names, why[part], part))
    variances = frozenset(name for name in wanted if name.endswith("variance")).difference(
        *(one.names for one in found)
    )
    # Only a model that sees the samples knows that there is one; for others a variance of 0 is a statement.
    if spp == 1 and variances and "samples.descriptor" in wanted:
        found.append(LeftOut(variances, "one sample per pixel tells nothing of its variance"))
    return found


def of_frame(buffers: Mapping[str, NDArray[Any]]) -> list[LeftOut]:
    """What of a rendered frame need not be kept, by its values."""
    found = []
    for part, other in (("diffuse", "specular"), ("specular", "diffuse")):
        if {"diffuse", "specular", "diffuse.albedo"} <= buffers.keys() and not buffers[other].any():
            names = _of_split(part, buffers)
            if part == "specular" and buffers["diffuse.albedo"].any():
                names -= {"diffuse.albedo"}
            found.append(LeftOut(names, f"{other} radiance is 0 in every pixel, so color is {part}", part))
            break
    if "alpha" in buffers and (buffers["alpha"] == 1).all():
        found.append(LeftOut(frozenset({"alpha"}), "every sample met a surface, so alpha is 1 everywhere"))
    return found


def trim_vertices(samples: Mapping[str, NDArray[Any]]) -> tuple[Block, str]:
    """The block of samples without the last vertices where no path has them, and what was left out ("": nothing).

    `samples`: "descriptor" S x H x W x (6 + 5 * vertices) as `pathfold.mitsuba.trace` makes it, and others.
    """
    kept = dict(samples)
    if "descriptor" not in kept:
        return kept, ""
    block = kept["descriptor"]
    vertices = used = descriptor_vertices(block.shape[-1])
    kinds = Layout(vertices).kind
    while used > 1 and not block[..., kinds + used - 1].any():  # also where a value is not finite it is some
        used -= 1
    if used == vertices:
        return kept, ""
    names = sample_names.descriptor(vertices)
    kept["descriptor"] = block[..., [names.index(name) for name in sample_names.descriptor(used)]]
    return kept, f"left out path vertices from {used + 1} on: no path of the frame has them"


def restore_split(buffers: Mapping[str, NDArray[Any]], all_light: str, reads: Collection[str]) -> Block:
    """The buffers and, of the split that color tells where `all_light` is all of it, those that the model reads."""
    color = buffers["color"]
    nothing = np.broadcast_to(np.float32(0), color.shape)
    other = {"diffuse": "specular", "specular": "diffuse"}[all_light]
    told = {all_light: color, other: nothing, **({"diffuse.albedo": nothing} if all_light == "specular" else {})}
    if "variance" in buffers:
        told |= {f"{all_light}.variance": buffers["variance"], f"{other}.variance": nothing}
    return {name: pixels for name, pixels in told.items() if name in reads} | dict(buffers)


def _of_split(part: str, names: Collection[str]) -> frozenset[str]:
    """Those of the names that color and variance tell where `part` is all of the radiance."""
    told = {"diffuse", "specular", *({"diffuse.albedo"} if part == "specular" else ())}
    told |= {"diffuse.variance", "specular.variance"} if "variance" in names else set()
    return frozenset(told & {*names})


def _all_light(scene: Any) -> str:
    """The part of the radiance that is all of it, whatever is seen; "" where it depends."""
    import mitsuba as mi

    from pathfold.mitsuba import materials

    # A shape that emits has a BSDF, too, so what is hit is always among them.
    flags = [node.flags() for node in materials.descendants(scene) if isinstance(node, mi.BSDF)]
    has = mi.has_flag
    lobes = mi.BSDFFlags
    if not any(has(flag, lobes.Diffuse) for flag in flags):
        return "specular"
    other = (lobes.Glossy, lobes.DeltaReflection, lobes.DeltaTransmission)
    only_diffuse = not any(has(flag, lobe) for flag in flags for lobe in other)
    hidden = all(has(emitter.flags(), mi.EmitterFlags.Delta) for emitter in scene.emitters())
    return "diffuse" if only_diffuse and hidden else ""
