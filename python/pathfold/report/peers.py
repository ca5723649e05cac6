"""Open Image Denoise, called as its users call it."""

from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

Image = NDArray[np.float32]


def oidn(color: Image, albedo: Image, normal: Image) -> Image:
    """Quality high with the noisy guides as they are: what most use."""
    denoised: Image = _pyoidn().denoise(color, albedo, normal, hdr=True, quality="high")
    return denoised


def oidn_prefiltered(color: Image, albedo: Image, normal: Image) -> Image:
    """Quality high with guides denoised first and `cleanAux`: its best."""
    albedo, normal = _prefiltered("albedo", albedo), _prefiltered("normal", normal)
    denoised: Image = _pyoidn().denoise(color, albedo, normal, hdr=True, clean_aux=True, quality="high")
    return denoised


def _prefiltered(name: str, guide: Image) -> Image:
    pyoidn = _pyoidn()
    guide = np.ascontiguousarray(guide, np.float32)  # before empty_like, which keeps strides
    clean = np.empty_like(guide)
    with pyoidn.Filter(_device(), "RT") as prefilter:
        prefilter.set_image(name, guide, pyoidn.OIDN_FORMAT_FLOAT3)
        prefilter.set_image("output", clean, pyoidn.OIDN_FORMAT_FLOAT3)
        prefilter.set_quality(pyoidn.OIDN_QUALITY_HIGH)
        prefilter.commit()
        prefilter.execute()
    if error := _device().get_error():
        raise RuntimeError(f"Open Image Denoise: {error}")
    return clean


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
