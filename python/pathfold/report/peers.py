"""The peer that figures are compared with: Intel Open Image Denoise, through the `pyoidn` wheel (`bench` extra)."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

Image = NDArray[np.float32]
QUALITIES = {"high": "OIDN_QUALITY_HIGH", "balanced": "OIDN_QUALITY_BALANCED", "fast": "OIDN_QUALITY_FAST"}


class Oidn:
    """OIDN's ray-tracing filter on HDR color with albedo and normal, H x W x 3 float32.

    `prefilter` first denoises albedo and normal with OIDN's own networks and then sets cleanAux: its best quality, at
    several times the cost. Raises ModuleNotFoundError naming the `bench` extra, RuntimeError with OIDN's message.
    """

    def __init__(self, quality: str = "high", prefilter: bool = False) -> None:
        try:
            import pyoidn
        except ModuleNotFoundError as error:
            raise ModuleNotFoundError("OIDN needs pyoidn: pip install 'pathfold[bench]'", name="pyoidn") from error
        self.oidn, self.prefilter = pyoidn, prefilter
        self.quality = getattr(pyoidn, QUALITIES[quality])
        self.device = pyoidn.Device()
        self.device.commit()

    def __call__(self, color: Image, albedo: Image, normal: Image) -> Image:
        """The denoised colour; inputs are not changed."""
        albedo = np.clip(albedo, 0.0, 1.0)
        if self.prefilter:
            albedo = self.run({"albedo": albedo})
            normal = self.run({"normal": normal})
        return self.run({"color": color, "albedo": albedo, "normal": normal}, hdr=True, cleanAux=self.prefilter)

    def run(self, images: dict[str, Image], **flags: Any) -> Image:
        arrays = {name: np.ascontiguousarray(image, np.float32) for name, image in images.items()}
        output = np.zeros_like(next(iter(arrays.values())))
        with self.oidn.Filter(self.device, "RT") as rt:
            for name, image in arrays.items():
                rt.set_image(name, image, self.oidn.OIDN_FORMAT_FLOAT3)
            rt.set_image("output", output, self.oidn.OIDN_FORMAT_FLOAT3)
            for name, value in flags.items():
                rt.set_bool(name, value)
            rt.set_quality(self.quality)
            rt.commit()
            rt.execute()
        if (message := self.device.get_error()) is not None:
            raise RuntimeError(f"OIDN: {message}")
        return output
