"""One model through every case and property: what `pathfold check` prints."""

from __future__ import annotations

import math
import os
from collections.abc import Callable
from dataclasses import asdict, dataclass, field
from typing import Any

from pathfold import models
from pathfold.check import references
from pathfold.check.cases import CASES, Case
from pathfold.check.measure import drift, tolerance
from pathfold.check.outcome import Row
from pathfold.check.prepare import Prepared, prepare, reads
from pathfold.check.properties import PROPERTIES, Property, Subject
from pathfold.check.references import References, ReferencesError
from pathfold.check.spoilt import SPOILT

WHOLE_CHAIN_LOGIT, MOST_BEYOND = 20.0, 5.0  # tolerances.toml, chain
NOT_CHECKED = ("accumulated samples (1e7 per pixel, 2^24 in all): the SDK has no accumulator",)


@dataclass
class Report:
    """All rows of one model at one precision."""

    model: str
    folder: str
    precision: str
    note: str = ""  # what errors are, where they are not those against references
    rows: list[Row] = field(default_factory=list)
    skipped: list[str] = field(default_factory=list)  # they stress what the model does not read

    @property
    def passed(self) -> bool:
        return not any(row.reason for row in self.rows)

    def record(self) -> dict[str, Any]:
        """As plain data, for JSON."""
        return {**asdict(self), "passed": self.passed}


def check_model(
    model: str | os.PathLike[str],
    provider: str = "cpu",
    precision: str = "fp32",
    progress: Callable[[float], None] = lambda done: None,
) -> Report:
    """Run every case and property that concerns a model. Raises PathfoldError where it cannot be loaded so."""
    subject = Subject(models.find(model), provider, precision)
    manifest = subject.manifest
    report = Report(manifest["name"], str(subject.folder), precision)
    known = None
    try:
        known = references.read(subject.folder, manifest) if precision == "fp32" else None
    except ReferencesError as error:
        report.rows.append(Row("references", "float64 results in the model folder", reason=str(error)))
    if precision != "fp32":
        report.note = "the error of a frame is the mean relative difference of its values to those in fp32"
    elif known is None:
        report.note = f"no usable {references.FILE}: errors are not measured; `pathfold-train export` writes one"
    entries: list[Case | Property] = [*CASES, *PROPERTIES, *SPOILT]
    for number, entry in enumerate(entries, start=1):
        if not reads(manifest, entry.needs):
            report.skipped.append(entry.name)
        elif isinstance(entry, Case):
            report.rows.append(case_row(subject, entry, known))
        else:
            report.rows.append(entry.row(subject))
        progress(number / len(entries))
    return report


def case_row(subject: Subject, case: Case, known: References | None) -> Row:
    """One frame through the SDK, in fp32 compared with its reference where there is one, else with fp32."""
    row, buffers = Row(case.name, case.stresses), case.make()
    frame = prepare(buffers, subject.manifest)
    result = subject.default.run_buffers(buffers)
    row.inspect(result, frame, subject.manifest)
    compare_statistics(row, result.report, frame)
    if subject.precision != "fp32":
        row.error = drift(result.color, subject.exact.run_buffers(buffers).color)
        row.allowed = tolerance(f"chain.{subject.precision}")
    elif known is None:
        pass
    elif known.frames.get(case.name) != references.frame_hash(buffers) or case.name not in known.images:
        row.fail("has no reference for this frame: export the model again")
    elif (image := known.images[case.name]).shape != result.color.shape:
        row.fail(f"its reference has the shape {image.shape}: export the model again")
    else:
        beyond = min(max(known.logits[case.name] / WHOLE_CHAIN_LOGIT, 1.0), MOST_BEYOND)
        row.allowed = tolerance("chain.fp32") * beyond
        brightest = max(float(branch.radiance.max()) for branch in frame.branches)
        row.compare(result.color, image, brightest, max(float(-branch.radiance.min()) for branch in frame.branches))
    return row.judged()


def compare_statistics(row: Row, report: dict[str, Any], frame: Prepared) -> None:
    """The whole-image statistics of a run against float64."""
    for name, right in (("exposure", frame.exposure), ("depth_scale", frame.depth_scale)):
        found = math.nan if report[name] is None else report[name]  # JSON has no infinity
        if not abs(found / right - 1) <= tolerance("statistics"):
            row.fail(f"{name} is {found:g}, right is {right:g}")
