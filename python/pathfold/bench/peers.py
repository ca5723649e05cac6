"""Open Image Denoise, called as its users call it."""

import sys
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

Image = NDArray[np.float32]


def oidn(color: Image, albedo: Image | None, normal: Image | None, scale: float | None = None) -> Image:
    """Quality high with the noisy guides as they are: what most use. `scale` replaces its own exposure."""
    return _denoise(color, albedo, normal, scale, clean=False)


def oidn_fast(color: Image, albedo: Image | None, normal: Image | None, scale: float | None = None) -> Image:
    """Quality fast with the noisy guides as they are."""
    return _denoise(color, albedo, normal, scale, clean=False, quality="fast")


def oidn_prefiltered(color: Image, albedo: Image | None, normal: Image | None, scale: float | None = None) -> Image:
    """Quality high with guides denoised first and `cleanAux`: its best."""
    return oidn_clean(color, *prefiltered(albedo, normal), scale)


def prefiltered(albedo: Image | None, normal: Image | None) -> tuple[Image | None, Image | None]:
    """The guides, denoised by themselves."""
    return _prefiltered("albedo", albedo), _prefiltered("normal", normal)


def oidn_clean(color: Image, albedo: Image | None, normal: Image | None, scale: float | None = None) -> Image:
    """Quality high with guides that are free of noise."""
    return _denoise(color, albedo, normal, scale, clean=albedo is not None)


def keep_torch_out() -> None:
    """Keep pyoidn, in a process of our own, from loading torch where it is installed: seconds for nothing."""
    sys.modules.setdefault("torch", None)  # type: ignore[arg-type]


def _denoise(
    color: Image,
    albedo: Image | None,
    normal: Image | None,
    scale: float | None,
    clean: bool,
    quality: str = "high",
) -> Image:
    if albedo is None:
        normal = None  # it takes normals only beside an albedo
    if scale is None:
        denoised: Image = _pyoidn().denoise(color, albedo, normal, hdr=True, clean_aux=clean, quality=quality)
        return denoised
    images = {"color": color, "albedo": albedo, "normal": normal}
    given = tuple(name for name, image in images.items() if image is not None)
    settings: dict[str, bool | float] = {"hdr": True, "cleanAux": clean, "inputScale": scale}
    return _execute(_filter(given), {name: images[name] for name in given}, settings, quality)


def _prefiltered(name: str, guide: Image | None) -> Image | None:
    return None if guide is None else _execute(_filter((name,)), {name: guide}, {})


def _execute(run: Any, images: dict[str, Any], settings: dict[str, bool | float], quality: str = "high") -> Image:
    pyoidn = _pyoidn()
    images = {name: np.ascontiguousarray(image, np.float32) for name, image in images.items()}
    output = np.empty_like(next(iter(images.values())))
    for name, image in (images | {"output": output}).items():
        run.set_image(name, image, pyoidn.OIDN_FORMAT_FLOAT3)
    for name, value in settings.items():
        (run.set_bool if isinstance(value, bool) else run.set_float)(name, value)
    run.set_quality({"high": pyoidn.OIDN_QUALITY_HIGH, "fast": pyoidn.OIDN_QUALITY_FAST}[quality])
    run.commit()
    run.execute()
    if error := _device().get_error():
        raise RuntimeError(f"Open Image Denoise: {error}")
    return output


@lru_cache(maxsize=8)
def _filter(images: tuple[str, ...]) -> Any:
    """One filter for each set of inputs; kept, as pyoidn.denoise keeps its own."""
    return _pyoidn().Filter(_device(), "RT")


@lru_cache(maxsize=1)
def _device() -> Any:
    device = _pyoidn().Device()
    device.commit()
    return device


def _pyoidn() -> Any:
    try:
        import pyoidn
    except ModuleNotFoundError as error:
        raise ModuleNotFoundError("comparing with OIDN needs pyoidn: pip install 'pathfold[bench]'") from error
    return pyoidn
