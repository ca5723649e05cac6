"""The tables of a bench as rows of text: methods over all scenes, and scenes by method."""

from collections.abc import Iterable, Sequence

from pathfold.bench.measurement import Measurement
from pathfold.bench.results import FLAG, Point, names, over_scenes, points

HEADER = (
    "method",
    "spp",
    "RelL2",
    "over seeds",
    "RelL2, paper's",
    "SMAPE",
    "SSIM",
    "FLIP",
    "flicker",
    "render ms",
    "denoise ms",
    "cold ms",
    "total ms",
    "peak MB",
    "wins",
    "worst",
)
Table = list[list[str]]


def by_method(measurements: Sequence[Measurement]) -> Table:
    """One row per spp and method: means over scenes, the scenes it wins, and where it is worst against the best."""
    all_points = points(measurements)
    rows = []
    for point in sorted(over_scenes(measurements), key=lambda p: p.spp):
        wins, worst = standing(point.method, [p for p in all_points if p.spp == point.spp])
        rows.append([*cells(point), str(wins), worst])
    return drop_empty([list(HEADER), *rows])


def cells(point: Point) -> list[str]:
    """A point in the order of HEADER, without its standing."""
    error = point.errors
    paper = error.get("rell2_paper")
    return [
        point.method,
        str(point.spp),
        f"{error['rell2'].mean:.4f}",
        f"{error['rell2'].low:.4f} to {error['rell2'].high:.4f}",
        f"{paper.mean:.4f}" if paper else "",
        *(f"{error[name].mean:.4f}" for name in ("smape", "ssim", "flip")),
        "" if point.flicker is None else f"{point.flicker:.4f}",
        *(whole(value) for value in (point.render_ms, point.denoise_ms or None, point.cold_ms, point.total_ms)),
        whole(point.peak_mb),
    ]


def standing(method: str, rivals: Sequence[Point]) -> tuple[int, str]:
    """How many scenes a method wins in RelL2, and its largest ratio to the best one, with the scene."""
    wins, worst = 0, (0.0, "")
    for scene in names(rivals, "scene"):
        errors = {p.method: max(p.rell2, 1e-6) for p in rivals if p.scene == scene}
        if method in errors:
            wins += errors[method] == min(errors.values())
            worst = max(worst, (errors[method] / min(errors.values()), scene))
    return wins, f"{worst[0]:.3g} ({worst[1]})"


def by_scene(measurements: Sequence[Measurement], spp: int) -> Table:
    """RelL2 at one spp, scene by scene; then the geometric mean, how often smaller than noisy, wins and worst."""
    own = [m for m in measurements if m.spp == spp]
    at, means = points(own), {p.method: p for p in over_scenes(own)}
    methods = names(own, "method")
    table = [["scene", *methods, ""]]
    for scene in names(own, "scene"):
        found = {p.method: p for p in at if p.scene == scene}
        errors = [f"{found[m].rell2:.4f}" if m in found else "" for m in methods]
        table.append([scene, *errors, flag(own, scene)])
    mean = [f"**{means[m].rell2:.4f}**" if m in means else "" for m in methods]
    table.append(["**geometric mean**", *mean, ""])
    if noisy := means.get("noisy"):
        table.append(
            ["noisy / method", *(f"{noisy.rell2 / means[m].rell2:.1f}" if m in means else "" for m in methods), ""]
        )
    places = {m: standing(m, at) for m in methods}
    table.append(["wins", *(str(places[m][0]) for m in methods), ""])
    table.append(["worst, against the best", *(places[m][1] for m in methods), ""])
    return table


def flag(measurements: Iterable[Measurement], scene: str) -> str:
    """What must be said where a scene's best method comes near the reference's own error."""
    own = [m for m in measurements if m.scene == scene]
    best = min((p.rell2 for p in points(own)), default=0.0)
    errors = [m.reference_rell2 for m in own if m.reference_rell2 is not None]
    return f"within {FLAG} times the reference's own error" if errors and best < FLAG * errors[0] else ""


def notes(measurements: Sequence[Measurement]) -> list[str]:
    """What a reader must know to judge the figures."""
    said = [
        "RelL2 is mean((x - r)^2 / (r^2 + 0.01)) on linear values; against a reference in two independent halves its "
        "own noise is left out. The paper's: epsilon 1e-4, 28 pixels cut off. SSIM and FLIP on display values.",
        "Errors: geometric means (SSIM: arithmetic) over seeds, then scenes; the range is over seeds, and every method "
        "saw the same noisy frames. Worst: the largest ratio to the best method's error on any scene.",
        "Times: medians of runs after a warm-up, the methods in turn; most runs are of the first seed. Rendering holds "
        "the cost of the path descriptors that a method looks at. Cold: a fresh process loads all it needs "
        "and denoises its first frame; peak: memory of that process above its inputs. Both are taken at the first "
        "seed, and once only for a method whose inputs have the same size at every spp.",
    ]
    flagged = {}
    for scene in names(measurements, "scene"):
        spps = sorted({m.spp for m in measurements if m.scene == scene})
        if near := [str(spp) for spp in spps if flag(at(measurements, spp), scene)]:
            flagged[scene] = ", ".join(near)
    if flagged:
        listed = "; ".join(f"{scene} at {spps} spp" for scene, spps in flagged.items())
        said.append(
            f"The best method is within {FLAG} times the reference's own error, so differences may be noise: {listed}."
        )
    units: dict[tuple[str, int, int], set[str]] = {}
    for m in measurements:
        units.setdefault((m.scene, m.spp, m.seed), set()).add(m.run)
    if mixed := [unit for unit, runs in units.items() if len(runs) > 1]:
        said.append(
            f"In {len(mixed)} of {len(units)} cases the methods were timed in different runs, not in turn; "
            "compare their times with care, or measure into an empty folder."
        )
    return said


def at(measurements: Iterable[Measurement], spp: int) -> list[Measurement]:
    return [m for m in measurements if m.spp == spp]


def drop_empty(table: Table) -> Table:
    """Without the columns that say nothing."""
    kept = [i for i in range(len(table[0])) if any(row[i] for row in table[1:])]
    return [[row[i] for i in kept] for row in table]


def markdown(table: Table) -> str:
    """A table whose first row is the header; all but the first column to the right."""
    lines = [table[0], ["---", *("---:" for _ in table[0][1:])], *table[1:]]
    return "\n".join(f"| {' | '.join(line)} |" for line in lines) + "\n"


def whole(value: float | None) -> str:
    return "" if value is None else f"{value:,.0f}"
