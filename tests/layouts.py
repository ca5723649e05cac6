"""Made-up layouts of EXRs: parts in random order, names from the presets, prefixes, views, windows and types, with what
each layer was made to be.
"""

from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import OpenImageIO as oiio  # noqa: N813
from exr_files import write

FRAME = (6, 5)  # width, height of the display window
EYES = ("left", "right")
# How writers call things; a dict holds what may stand in one file together.
STYLES: dict[str, dict[str, list[str]]] = {
    "houdini": {
        "beauty": ["C", "rgba_main", "beauty", "beauty_main"],
        "albedo": ["albedo", "albedo_main"],
        "normal": ["N", "normal", "N_main"],
        "depth": ["depth", "depth_main", "__depth"],
        "light": ["combineddiffuse", "directspecular", "indirectvolume", "sss"],
        "data": ["P", "crypto_object", "uv", "motionvector", "primid"],
    },
    "arnold": {
        "beauty": ["RGBA", "beauty"],
        "albedo": ["denoise_albedo", "albedo", "diffuse_albedo_noice"],
        "normal": ["N", "N_noice", "denoise_normal"],
        "depth": ["Z", "Z_noice"],
        "variance": ["variance"],
        "light": ["diffuse_direct", "specular_indirect", "emission", "coat"],
        "data": ["P", "ID", "motionvector", "crypto_asset"],
    },
    "vray": {
        "beauty": ["rgba", "RGB_color"],
        "albedo": ["diffuse_filter", "VRayDiffuseFilter"],
        "normal": ["bumpNormals", "VRayBumpNormals", "normals"],
        "depth": ["Z_Depth", "VRayZDepth"],
        "light": ["rawLight", "VRayLighting", "Refraction", "GI"],
        "data": ["cryptomatte00", "velocity", "objectID"],
    },
    "renderman": {
        "beauty": ["Ci"],
        "albedo": ["albedo"],
        "normal": ["normal", "Nn"],
        "depth": ["z", "zfiltered"],
        "variance": ["mse"],
        "light": ["directDiffuse", "indirectSpecular", "emissive"],
        "data": ["P", "motionFore", "id"],
    },
    "plain": {
        "beauty": ["rgba", "rgb", "Color", "hdr", "image", "hero", "mypicture"],
        "albedo": ["albedo", "Albedo", "alb", "albedo_2"],
        "normal": ["normals", "nrm", "Ns", "shading_normal"],
        "depth": ["depth", "Z", "zdepth", "Depth01"],
        "variance": ["beauty_variance", "variance"],
        "light": ["diffuse", "specular", "light_key", "emission"],
        "data": ["position", "mask_hero", "uv", "id"],
    },
}
PREFIXES = ("", "", "ViewLayer.", "cam1.")
LETTERS = {
    "beauty": "RGB",
    "albedo": "RGB",
    "normal": "XYZ",
    "depth": "Z",
    "variance": "RGB",
    "light": "RGB",
    "data": "RGB",
}


@dataclass
class Layout:
    """A file to write, and what each channel was made to be: (part's name, channel) -> its role and its view."""

    parts: list[tuple[oiio.ImageSpec, np.ndarray]] = field(default_factory=list)
    roles: dict[tuple[str, str], str] = field(default_factory=dict)
    views: dict[tuple[str, str], str] = field(default_factory=dict)
    beauties: tuple[str, ...] = ()  # their names, without view and view layer

    def save(self, path: Path) -> Path:
        return write(path, self.parts)


@dataclass(frozen=True)
class _Piece:
    """A layer to write; `view` is "" where it has none."""

    role: str
    name: str
    view: str


def made(seed: int) -> Layout:
    """The layout of a seed: one part with layers, or a part per layer in random order."""
    rng = np.random.default_rng(seed)
    style = STYLES[str(rng.choice(list(STYLES)))]
    views = [[""], [""], list(EYES), ["main"]][rng.integers(4)]
    pieces = _pieces(rng, style, views)
    rng.shuffle(pieces)  # type: ignore[arg-type]
    layout = Layout(beauties=tuple(dict.fromkeys(piece.name for piece in pieces if piece.role == "beauty")))
    if rng.random() < 0.5:
        _in_one_part(layout, rng, pieces, views)
    else:
        _in_parts(layout, rng, pieces, views)
    return layout


def _pieces(rng: np.random.Generator, style: dict[str, list[str]], views: list[str]) -> list[_Piece]:
    """A beauty per view, now and then in one alone or two, and some of everything else, of each view or of some."""
    names = list(map(str, rng.choice(style["beauty"], min(len(style["beauty"]), 2), replace=False)))
    of = views[:1] if rng.random() < 0.1 else views
    pieces = [_Piece("beauty", name, view) for name in names[: 2 if rng.random() < 0.1 else 1] for view in of]
    for role, names in style.items():
        if role == "beauty" or rng.random() < 0.3:
            continue
        count = 1 if role in ("albedo", "variance") else int(rng.integers(1, 3))
        for name in map(str, rng.choice(names, min(count, len(names)), replace=False)):
            of = [views, views, views[-1:], [""]][rng.integers(4)]
            pieces += [_Piece(role, name, view) for view in of]
    return pieces


def _in_one_part(layout: Layout, rng: np.random.Generator, pieces: list[_Piece], views: list[str]) -> None:
    """Layers of one part; a beauty may be bare. Views are named in the channels, the first one perhaps not."""
    prefix = str(rng.choice(PREFIXES))
    bare = not prefix and rng.random() < 0.6
    first_is_named = rng.random() < 0.5
    beauty = next(piece.name for piece in pieces if piece.role == "beauty")
    names, roles, of = [], [], []
    for piece in pieces:
        view = piece.view if len(views) > 1 and (piece.view != views[0] or first_is_named) else ""
        own = "" if bare and piece.name == beauty else prefix + piece.name
        layer = ".".join(section for section in (own, view) if section)
        for letter in LETTERS[piece.role]:
            names.append(f"{layer}.{letter}" if layer else letter)
            roles.append(piece.role)
            of.append(view or (piece.view if not layer and len(views) > 1 else ""))
    header = {"multiView": tuple(views)} if len(views) > 1 else {}
    _add(layout, rng, "", names, roles, of, header, window=False)


def _in_parts(layout: Layout, rng: np.random.Generator, pieces: list[_Piece], views: list[str]) -> None:
    """A part per layer, its channels bare or with the layer's name; views by attribute, by the part's name, or both."""
    how = rng.integers(3) if len({piece.view for piece in pieces if piece.role == "beauty"}) > 1 else 0
    bare = rng.random() < 0.7
    for piece in pieces:
        letters = LETTERS[piece.role]
        channels = list(letters) if bare else [f"{piece.name}.{letter}" for letter in letters]
        title = piece.name + (f"{rng.choice(['.', '-', '_'])}{piece.view}" if piece.view else "")
        if any(title == held for held, _ in layout.roles):
            continue  # "beauty" in view "main" beside "beauty_main"
        header = {"view": piece.view} if piece.view and how != 1 else {}
        count = len(letters)
        window = piece.role != "beauty" and rng.random() < 0.3
        _add(layout, rng, title, channels, [piece.role] * count, [piece.view] * count, header, window)


def _add(
    layout: Layout,
    rng: np.random.Generator,
    title: str,
    names: list[str],
    roles: list[str],
    views: list[str],
    header: dict[str, object],
    window: bool,
) -> None:
    width, height = FRAME if not window else map(int, rng.integers(2, 9, 2))
    data = all(role == "data" for role in roles)
    kinds = [str(rng.choice(["half", "float", *(["uint"] if data else [])])) for _ in names]
    spec = oiio.ImageSpec(width, height, len(names), oiio.TypeDesc(kinds[0]))
    spec.channelnames, spec.channelformats = tuple(names), tuple(map(oiio.TypeDesc, kinds))
    spec.x, spec.y = map(int, rng.integers(-3, 8, 2)) if window else (0, 0)
    spec.full_x = spec.full_y = 0
    spec.full_width, spec.full_height = FRAME
    spec.attribute("compression", "zips")
    if title:
        spec.attribute("oiio:subimagename", title)
    for key, value in header.items():
        if isinstance(value, tuple):
            spec.attribute(key, oiio.TypeDesc(f"string[{len(value)}]"), value)
        else:
            spec.attribute(key, value)
    for name, role, view in zip(names, roles, views, strict=True):
        layout.roles[title, name], layout.views[title, name] = role, view
    layout.parts.append((spec, rng.uniform(0, 2, (height, width, len(names))).astype(np.float32)))
