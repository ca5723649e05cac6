"""Print what developing pathfold needs, one requirement a line: all that pyproject.toml asks for."""

import tomllib
from pathlib import Path

with (Path(__file__).parent.parent / "pyproject.toml").open("rb") as file:
    settings = tomllib.load(file)
project = settings["project"]
wanted = {*settings["build-system"]["requires"], *project["dependencies"]}
wanted.update(*project["optional-dependencies"].values())
print("\n".join(sorted(wanted)))
