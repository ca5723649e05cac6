"""curves.json: what `plan` needs of a bench, a line for each method at each spp of each scene."""

import json
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path

from pathfold.bench import results
from pathfold.bench.candidates import NOISY
from pathfold.bench.measurement import Measurement
from pathfold.images import ImageError, replacing

FILE = "curves.json"
SHIPPED = Path(__file__).with_name(FILE)  # of the bench in docs/results


@dataclass(frozen=True)
class Sample:
    """A measured method at one spp: what `plan` needs of a bench."""

    scene: str
    method: str
    spp: int
    rell2: float
    render_ms: float
    denoise_ms: float


def samples(measurements: Sequence[Measurement]) -> list[Sample]:
    """The means over seeds of what was measured; points without a time of rendering are left out."""
    return [
        Sample(p.scene, p.method, p.spp, max(p.rell2, results.FLOOR), p.render_ms, p.denoise_ms)
        for p in results.points(measurements)
        if p.render_ms is not None
    ]


def save(path: Path, measured: Sequence[Sample]) -> None:
    """Write curves.json, a line per sample."""
    lines = ",\n".join(json.dumps({n: _short(v) for n, v in asdict(sample).items()}) for sample in measured)
    with replacing(path) as unfinished:
        unfinished.write_text(f"[\n{lines}\n]\n", encoding="utf-8")


def read(path: Path) -> list[Sample]:
    """From the folder of a bench, its results.jsonl or its curves.json. Raises ImageError that says what is wrong."""
    if path.is_dir():
        inside = [path / name for name in ("results.jsonl", FILE) if (path / name).is_file()]
        if not inside:
            raise ImageError(f"{path}: holds neither results.jsonl nor {FILE}; name the folder of a pathfold bench")
        path = inside[0]
    if not path.is_file():
        raise ImageError(f"{path}: no such file; name the folder that pathfold bench wrote, or its results.jsonl")
    if path.suffix == ".jsonl":
        found = samples(list(results.read(path).values()))
    else:
        try:
            found = [Sample(**record) for record in json.loads(path.read_text(encoding="utf-8"))]
        except (ValueError, TypeError) as error:
            raise ImageError(f"{path}: is no {FILE} of pathfold bench; name another") from error
    if not any(sample.method == NOISY for sample in found):
        raise ImageError(f"{path}: holds no noisy picture with a time of rendering; measure with --methods noisy,...")
    return found


def _short(value: str | int | float) -> str | int | float:
    return float(f"{value:.5g}") if isinstance(value, float) else value
