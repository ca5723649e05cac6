"""Ways in which guides go wrong, and scenes in which they do: what benchmarks/guides.py measures."""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

Buffers = dict[str, NDArray[Any]]
ALBEDOS = ("albedo", "diffuse.albedo")
VARIANCES = ("variance", "diffuse.variance", "specular.variance")
SHAPED = (*ALBEDOS, "normal", "depth")  # what is seen, whatever the light
BLOB = 0.15  # of the height
PINHOLE = "-pinhole"  # ends the name of a scene whose camera has no lens


@dataclass(frozen=True)
class Others:
    """Further renderings, of the frame's size."""

    fewer: Buffers  # of one sample a pixel, with another seed
    foreign: Buffers  # of another scene
    pinhole: Buffers | None  # of a camera without a lens, where there is such a scene


GUIDES = {"albedo": ALBEDOS, "normal": ("normal",), "depth": ("depth",), "variance": VARIANCES}
Case = Callable[[Buffers, Others], Buffers | None]  # the spoilt buffers alone; None: nothing to spoil
CASES: dict[str, Case] = {}


def albedos(name: str) -> Callable[[Callable[[NDArray[Any], Buffers], NDArray[Any]]], None]:
    """Adds a way to spoil both albedos: of an albedo and the frame."""

    def add(spoil: Callable[[NDArray[Any], Buffers], NDArray[Any]]) -> None:
        CASES[name] = lambda frame, others: {n: spoil(frame[n], frame).astype(np.float32) for n in ALBEDOS}

    return add


def as_it_is(buffers: tuple[str, ...]) -> Case:
    return lambda frame, others: {name: frame[name] for name in buffers}


for _what, _buffers in GUIDES.items():
    CASES[f"{_what} as it is"] = as_it_is(_buffers)


def constants(name: str, buffers: tuple[str, ...], value: float) -> None:
    CASES[name] = lambda frame, others: {n: np.full_like(frame[n], value) for n in buffers}


def damage(buffers: tuple[str, ...], share: float) -> Case:
    def spoil(frame: Buffers, others: Others) -> Buffers:
        bad = np.random.default_rng(1).random(frame["color"].shape[:2]) < share
        return {n: np.where(bad[..., None], np.float32(np.nan), frame[n]) for n in buffers}

    return spoil


@albedos("albedo with a blob up to 96")
def blob(albedo: NDArray[Any], frame: Buffers) -> NDArray[Any]:
    height, width = albedo.shape[:2]
    y, x = np.mgrid[:height, :width]
    far = ((y - height / 2) ** 2 + (x - width / 2) ** 2) / (BLOB * height) ** 2
    return albedo * (1 + 95 * np.exp(-far))[..., None]


@albedos("albedo tenfold")
def tenfold(albedo: NDArray[Any], frame: Buffers) -> NDArray[Any]:
    return 10 * albedo


@albedos("albedo black in the middle")
def black_middle(albedo: NDArray[Any], frame: Buffers) -> NDArray[Any]:
    height, width = albedo.shape[:2]
    albedo = albedo.copy()
    albedo[height // 4 : 3 * height // 4, width // 4 : 3 * width // 4] = 0
    return albedo


@albedos("albedo with the light in its upper quarter")
def bright_sky(albedo: NDArray[Any], frame: Buffers) -> NDArray[Any]:
    rows = albedo.shape[0] // 4
    albedo = albedo.copy()
    albedo[:rows] += 50 * frame["color"][:rows] / max(float(frame["color"].mean()), 1e-6)
    return albedo


@albedos("albedo plus the light")
def with_light(albedo: NDArray[Any], frame: Buffers) -> NDArray[Any]:
    return albedo + frame["color"]


def black_misses(frame: Buffers, others: Others) -> Buffers:
    """As most renderers write it; the diffuse albedo is 0 there anyway."""
    return {"albedo": np.clip(frame["albedo"] - (1 - frame["alpha"]), 0, 1)}


CASES["albedo 0 on misses"] = black_misses
constants("albedo 0", ALBEDOS, 0)
constants("albedo 1", ALBEDOS, 1)
constants("normal 0", ("normal",), 0)
constants("normal 1", ("normal",), 1)
constants("normal -1", ("normal",), -1)
constants("depth 0", ("depth",), 0)
constants("variance 0", VARIANCES, 0)
constants("variance 1", VARIANCES, 1)
constants("all of them 0", (*SHAPED, *VARIANCES), 0)
constants("all of them 1", (*SHAPED, *VARIANCES), 1)
CASES["normals as 0.5 n + 0.5"] = lambda frame, others: {"normal": 0.5 * frame["normal"] + np.float32(0.5)}
CASES["shifted by 2 pixels"] = lambda frame, others: {n: np.roll(frame[n], (2, 2), (0, 1)) for n in SHAPED}
CASES["of one sample a pixel"] = lambda frame, others: {n: others.fewer[n] for n in SHAPED}
CASES["of another scene"] = lambda frame, others: {n: others.foreign[n] for n in SHAPED}
CASES["of a pinhole camera"] = lambda frame, others: others.pinhole and {n: others.pinhole[n] for n in SHAPED}
for _what, _buffers in GUIDES.items():
    for _share in (0.01, 0.1):
        CASES[f"{_what} NaN in {_share:.0%}"] = damage(_buffers, _share)


def write_scenes(folder: Path) -> list[Path]:
    """Scenes in folders of their own: a fence and leaves before a lit sky; after each NAME-pinhole, without a lens."""
    paths = []
    for name, things in {"fence": fence(), "leaves": leaves()}.items():
        for sensor, suffix in (("thinlens", ""), ("perspective", PINHOLE)):
            path = folder / f"{name}{suffix}" / "scene.xml"
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_text(SCENE.format(sensor=sensor, lens=LENS if sensor == "thinlens" else "", things=things))
            paths.append(path)
    return paths


LENS = '<float name="aperture_radius" value="0.15"/><float name="focus_distance" value="4.5"/>'
SCENE = """<scene version="3.0.0">
<integrator type="path"><integer name="max_depth" value="5"/></integrator>
<sensor type="{sensor}"><float name="fov" value="40"/>{lens}
<transform name="to_world"><lookat origin="0, 1.2, 6" target="0, 1.2, 0" up="0, 1, 0"/></transform>
<film type="hdrfilm"><integer name="width" value="192"/><integer name="height" value="128"/><rfilter type="box"/></film>
</sensor>
<emitter type="constant"><float name="radiance" value="1"/></emitter>
<emitter type="directional">
<vector name="direction" value="-0.4, -1, -0.5"/><float name="irradiance" value="3"/></emitter>
<shape type="rectangle"><transform name="to_world"><scale value="30"/><rotate x="1" angle="-90"/></transform>
<bsdf type="diffuse"><rgb name="reflectance" value="0.3, 0.25, 0.2"/></bsdf></shape>
{things}
</scene>
"""
WIRE = """<shape type="cylinder"><point name="p0" x="{x:.4f}" y="0" z="0"/>
<point name="p1" x="{end:.4f}" y="2.6" z="0"/><float name="radius" value="0.008"/>{bsdf}</shape>"""
LEAF = """<shape type="disk"><transform name="to_world"><scale x="0.09" y="0.05" z="1"/>
<rotate x="{turn[0]:.4f}" y="{turn[1]:.4f}" z="{turn[2]:.4f}" angle="{turn[3]:.2f}"/>
<translate x="{at[0]:.4f}" y="{at[1]:.4f}" z="{at[2]:.4f}"/></transform>{bsdf}</shape>"""
BSDF = '<bsdf type="twosided"><bsdf type="diffuse"><rgb name="reflectance" value="{}"/></bsdf></bsdf>'


def fence() -> str:
    starts = [-2.2 + 0.075 * number for number in range(60)]
    return "\n".join(WIRE.format(x=x, end=x + 0.12, bsdf=BSDF.format("0.5, 0.5, 0.5")) for x in starts)


def leaves() -> str:
    rng, found = np.random.default_rng(7), []
    for _ in range(260):
        at, turn = rng.normal([0, 1.7, 0], 0.55), [*rng.normal(size=3), rng.uniform(0, 360)]
        found.append(LEAF.format(at=at, turn=turn, bsdf=BSDF.format(f"0.1, {rng.uniform(0.3, 0.5):.3f}, 0.06")))
    return "\n".join(found)
