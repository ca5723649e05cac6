"""What a bench leaves behind for people: table.md, plots/, index.html; made from its results.jsonl and about.json."""

from collections.abc import Sequence
from pathlib import Path

from pathfold.bench import results
from pathfold.bench.about import About
from pathfold.bench.measurement import Measurement
from pathfold.bench.results import ALL, Point, names, over_scenes, points
from pathfold.bench.run import RESULTS
from pathfold.images import replacing
from pathfold.report import page, plots, tables, versus
from pathfold.report.answers import Answer, answers

TABLE = "table.md"


def write(out: Path, pictures: Path) -> None:
    """Write all of them into `out`, which holds the data; `pictures` is where run.keep_pictures put its files."""
    measurements, about = read(out)
    scenes = names(measurements, "scene")
    at, means = points(measurements), over_scenes(measurements) if len(scenes) > 1 else []
    own = {m.scene: m.reference_rell2 for m in measurements}
    told = answers(means or at, at)
    plots.save(out / "plots", means, at, own)
    with replacing(out / TABLE) as unfinished:
        unfinished.write_text(markdown(measurements, about), encoding="utf-8")
    page.save(
        out / "index.html",
        means,
        at,
        told,
        pictures,
        own,
        title="Error against run time" if means else f"{scenes[0]}: error against run time",
        lead=headline(means or at, len(scenes)),
        notes=notes_of(measurements, about),
        facts=facts_of(measurements) | {"Made by": about.command},
    )


def read(out: Path) -> tuple[list[Measurement], About]:
    """The data of a bench: all that its folder's results.jsonl holds, and what made it."""
    return list(results.read(out / RESULTS).values()), About.read(out)


def markdown(measurements: Sequence[Measurement], about: About) -> str:
    """table.md."""
    scenes = names(measurements, "scene")
    at, means = points(measurements), over_scenes(measurements) if len(scenes) > 1 else []
    lead = headline(means or at, len(scenes))
    parts = [f"# Error against run time\n\n{lead}\n\n    {about.command}\n"]
    parts += [_section(answer) for answer in answers(means or at, at)]
    methods = tables.markdown(tables.by_method(measurements))
    parts.append(f"## Methods, {'means over scenes' if means else scenes[0]}\n\n{methods}")
    if compared := versus.versus(measurements):
        parts += [f"## Against {peer}\n\n{tables.markdown(table)}" for peer, table in compared.items()]
        parts.append(f"{versus.NOTE}\n")
    for spp in sorted({m.spp for m in measurements}):
        by_scene = tables.markdown(tables.by_scene(measurements, spp))
        parts.append(f"## RelL2 at {spp} spp\n\n{by_scene}")
    parts.append("## Notes\n\n" + "".join(f"- {note}\n" for note in notes_of(measurements, about)))
    parts.append("".join(f"- {name}: {value}\n" for name, value in facts_of(measurements).items()))
    return "\n".join(parts)


def said(measurements: Sequence[Measurement]) -> list[str]:
    """The answers' sentences, for a terminal."""
    at = points(measurements)
    means = over_scenes(measurements) if len(names(at, "scene")) > 1 else at
    return [sentence for answer in answers(means, at)[:-1] for sentence in answer.sentences]


def headline(at: Sequence[Point], scenes: int) -> str:
    """What was compared, in a sentence."""
    methods, spps = names(at, "method"), sorted({p.spp for p in at})
    levels = f"{spps[0]} to {spps[-1]}" if len(spps) > 1 else str(spps[0])
    subject = f"The {ALL} of {scenes} scenes" if scenes > 1 else "One scene"
    return f"{subject}, {len(methods)} methods, {levels} samples per pixel."


def notes_of(measurements: Sequence[Measurement], about: About) -> list[str]:
    """What must be known to judge the figures."""
    return [*tables.notes(measurements), *(f"Left out: {what}." for what in about.left_out)]


def facts_of(measurements: Sequence[Measurement]) -> dict[str, str]:
    """On what and how it was made."""
    sizes = dict.fromkeys(f"{m.width}x{m.height}" for m in measurements)
    seeds = dict.fromkeys(str(m.seed) for m in measurements)
    packages = dict.fromkeys(", ".join(f"{name} {number}" for name, number in m.versions.items()) for m in measurements)
    loads = [m.load for m in measurements if m.load is not None]
    facts = {
        "Pictures": f"{', '.join(sizes)}, seeds {', '.join(seeds)}",
        "Machine": "; ".join(dict.fromkeys(m.machine for m in measurements)),
        "Load": f"{min(loads):.1f} to {max(loads):.1f} processes wanted the processor" if loads else "",
        "Software": "; ".join(packages),
        "Commit": ", ".join(dict.fromkeys(m.commit for m in measurements if m.commit)),
        "Measured": ", ".join(sorted({m.run for m in measurements})),
    }
    return {name: value for name, value in facts.items() if value}


def _section(answer: Answer) -> str:
    table = f"\n{tables.markdown(answer.table)}" if answer.table else ""
    return f"## {answer.question}\n\n" + "".join(f"- {sentence}\n" for sentence in answer.sentences) + table
