"""One measurement: what a candidate made of a noisy frame, how far that is from the reference, and what it cost."""

from dataclasses import asdict, dataclass, field
from typing import Any

ERRORS = ("rell2", "rell2_paper", "smape", "ssim", "flip")


@dataclass(frozen=True)
class Measurement:
    """One line of results.jsonl. Of a sequence, errors are means over its frames, and times too."""

    scene: str
    spp: int
    seed: int
    method: str
    rell2: float  # free of the reference's own noise where it came in halves; may then be slightly negative
    smape: float
    ssim: float
    flip: float
    # Every timed run that recorded as many samples' paths as the method looks at. At later seeds a frame is rendered
    # once, for the methods that look at most. Empty: none known.
    render_ms: list[float]
    denoise_ms: list[float]  # every timed run after a warm-up; empty for the noisy picture
    rell2_paper: float | None = None
    flicker: float | None = None  # of sequences of three frames and more
    cold_ms: float | None = None  # of the first seed: see cold.py
    peak_mb: float | None = None  # likewise
    frames: int = 1
    width: int = 0
    height: int = 0
    reference_spp: int | None = None
    reference_rell2: float | None = None  # the reference's own error; None without halves
    inputs: str = ""  # fingerprint of scene and reference
    identity: str = ""  # fingerprint of the method
    run: str = ""  # when the command started
    machine: str = ""
    versions: dict[str, str] = field(default_factory=dict)
    commit: str | None = None
    load: float | None = None  # of the machine in the minute before

    @property
    def key(self) -> tuple[str, int, int, str]:
        return self.scene, self.spp, self.seed, self.method

    def record(self) -> dict[str, Any]:
        return asdict(self)
