"""Every dependency has an upper bound, and the locked sets lie within the bounds."""

import tomllib
from pathlib import Path

import pytest

REPOSITORY = Path(__file__).resolve().parents[1]
DATED = {"regex"}
"""Releases named by their date: no major says what breaks."""


def requirements():
    packaging = pytest.importorskip("packaging.requirements")
    project = tomllib.loads((REPOSITORY / "pyproject.toml").read_text())["project"]
    texts = [*project["dependencies"]]
    for extra in project["optional-dependencies"].values():
        texts += extra
    found = [packaging.Requirement(text) for text in texts]
    return [requirement for requirement in found if requirement.name != "gscomplete"]


def locked(name: str) -> dict[str, str]:
    lines = (REPOSITORY / name).read_text().splitlines()
    pairs = [line.split("==") for line in lines if line and not line.startswith("#")]
    return {package.lower().replace("_", "-"): version for package, version in pairs}


def test_every_dependency_has_an_upper_bound():
    unbound = {
        requirement.name
        for requirement in requirements()
        if not any(part.operator in ("<", "<=", "==") for part in requirement.specifier)
    }
    assert unbound == DATED


@pytest.mark.parametrize("name", ["constraints.txt", "constraints-lowest.txt"])
def test_locked_versions_are_within_the_bounds(name):
    versions = locked(name)
    seen = 0
    for requirement in requirements():
        version = versions.get(requirement.name.lower().replace("_", "-"))
        if version is not None:
            assert version in requirement.specifier, requirement
            seen += 1
    assert seen >= 7


def test_the_lowest_set_has_the_lowest_versions():
    versions = locked("constraints-lowest.txt")
    for requirement in requirements():
        lowest = [part.version for part in requirement.specifier if part.operator == ">="]
        if requirement.name in versions and lowest:
            assert versions[requirement.name] == lowest[0], requirement
