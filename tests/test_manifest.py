"""The two judges of a manifest: the C++ reader and sdk/manifest.schema.json say the same of it."""

import copy
import hashlib
import json
import re
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import jsonschema
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from pathfold import PathfoldError, _core

SCHEMA = Path(__file__).parents[1] / "sdk" / "manifest.schema.json"
VALIDATOR = jsonschema.Draft202012Validator(json.loads(SCHEMA.read_text()))
# What a schema cannot say: one part of a manifest against another. The C++ reader says it in these words.
BETWEEN_PARTS = (
    "is not among graphs",
    "neither requires nor uses",
    "branches of which exactly one",
    'the branch with "unsplit" has no "demodulate"',
    "one branch with the radiance color, or two with diffuse and specular",
    r"outputs\.logits is .*it must be \[1, ",
    r"samples_per_pixel\.max is \d+; it must be an integer from (?!1 )\d",
    "graphs.embedding is missing",
    "no graph has the input embedding",
    "names the graph embedding",
    r"inputs\.embedding is .*it must be \[1, ",
    "for a pyramid or an embedding",
    r"tile\.overlap is \d+; it must be an integer from (62|76) ",  # a pyramid's reach; and of what it is divided by
)
VALUES = st.one_of(
    st.none(),
    st.booleans(),
    st.integers(-2, 70),
    st.sampled_from([2**31, 2**63, -(2**63), 1e-7, 0.5, 2.0, 1e9]),
    st.sampled_from(["", "H", "color", "diffuse", "gather", "splat", "x\x1b", "a/b", ".a", "0" * 64, "albedo"]),
    st.just([]),
    st.just({}),
    st.just(["color"]),
    st.just(["color", "color"]),
    st.just([1, 3, "H", "W"]),
)  # fmt: skip

Json = Any


@pytest.fixture(scope="module", params=["split-5", "quantised-3", "pathfold-balanced"])
def good(request: pytest.FixtureRequest, tiny_models: Path) -> Json:
    if request.param != "pathfold-balanced":
        return json.loads((tiny_models / request.param / "manifest.json").read_text())
    manifest = json.loads((SCHEMA.parents[1] / "models" / request.param / "manifest.json").read_text())
    inputs = manifest["graphs"]["network"]["inputs"]
    manifest["graphs"]["network"]["inputs"] = {name: inputs[name] for name in ("radiance", "embedding")}
    return manifest  # the others are like those of the tiny models


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Where a manifest stands alone: the first thing that a good one lacks is its graphs."""
    return tmp_path_factory.mktemp("judged")


def complaint(folder: Path, manifest: Json) -> str:
    """What the C++ reader says of a manifest, empty where it accepts it."""
    (folder / "manifest.json").write_text(json.dumps(manifest))
    with pytest.raises(PathfoldError) as caught:
        _core.Model(str(folder))
    said = str(caught.value).removeprefix(f"the model {folder}: ")
    if said.startswith("manifest.json"):
        return said
    assert "has no readable file" in said
    return ""


def places(value: Json, path: tuple[str | int, ...] = ()) -> Iterator[tuple[str | int, ...]]:
    """The path of everything in a document but for `training`, which is free."""
    if path[:1] == ("training",):
        return
    if path:
        yield path
    children = value.items() if isinstance(value, dict) else enumerate(value) if isinstance(value, list) else ()
    for key, child in children:
        yield from places(child, (*path, key))


def judge(folder: Path, manifest: Json, what: object) -> None:
    refused = next(iter(VALIDATOR.iter_errors(manifest)), None)
    said = complaint(folder, manifest)
    if refused is not None:
        assert said, f"{what}: the schema refuses ({refused.message}), the reader does not"
    elif said:
        assert any(re.search(words, said) for words in BETWEEN_PARTS), f"{what}: the schema accepts; {said}"


def changes(parent: Json, key: str | int) -> dict[str, Callable[[], None]]:
    """Small things to do to one place of a document."""

    def replace(value: Json) -> Callable[[], None]:
        return lambda: parent.__setitem__(key, value)

    kinds: list[Json] = [None, True, False, 0, 1, -1, 2, 4, 64, 1.5, 1e9, "", "H", "color", "a\x1b", [], {}, [[]]]
    done: dict[str, Callable[[], None]] = {f"= {kind!r}": replace(kind) for kind in kinds}
    done["removed"] = lambda: parent.pop(key)
    old = parent[key]
    if isinstance(parent, dict):
        done["renamed"] = lambda: parent.__setitem__(f"{key}x", parent.pop(key))
    if isinstance(old, dict):
        done["one key more"] = replace({**old, "more": 1})
    if isinstance(old, list):
        done["twice"] = replace(old + old)
        done["one item more"] = replace([*old, "alpha"])
    if isinstance(old, str):
        done["in capitals"] = replace(old.upper())
    return done


def test_every_small_change_is_judged_alike(good: Json, folder: Path) -> None:
    assert complaint(folder, good) == "" and VALIDATOR.is_valid(good)
    tried = refused = 0
    for path in places(good):

        def at(document: Json, path: tuple[str | int, ...] = path) -> Json:
            for key in path[:-1]:
                document = document[key]
            return document

        for name in changes(at(copy.deepcopy(good)), path[-1]):
            variant = copy.deepcopy(good)
            changes(at(variant), path[-1])[name]()
            judge(folder, variant, f"{path} {name}")
            tried += 1
            refused += not VALIDATOR.is_valid(variant)
    assert 0.5 < refused / tried < 0.99  # neither judge may say the same of all


@settings(max_examples=40, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(data=st.data())
def test_several_changes_are_judged_alike(good: Json, folder: Path, data: st.DataObject) -> None:
    variant = copy.deepcopy(good)
    for _ in range(data.draw(st.integers(1, 4))):
        path = data.draw(st.sampled_from(list(places(variant))))
        parent = variant
        for key in path[:-1]:
            parent = parent[key]
        parent[path[-1]] = copy.deepcopy(data.draw(VALUES))  # later changes may go into it
    judge(folder, variant, json.dumps(variant))


@pytest.mark.parametrize("name", sorted(path.name for path in (SCHEMA.parents[1] / "models").iterdir()))
def test_shipped_manifests_fit_the_schema(name: str) -> None:
    folder = SCHEMA.parents[1] / "models" / name
    manifest = json.loads((folder / "manifest.json").read_text())
    VALIDATOR.validate(manifest)
    variants = [graph for block in manifest.get("variants", {}).values() for graph in block["graphs"].values()]
    for graph in [*manifest["graphs"].values(), *variants]:
        assert hashlib.sha256((folder / graph["file"]).read_bytes()).hexdigest() == graph["sha256"]
