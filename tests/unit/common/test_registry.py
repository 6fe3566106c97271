"""Names that packages register are found when asked for; what they need and lack is one line."""

from __future__ import annotations

import sys
from collections.abc import Callable
from importlib.metadata import EntryPoint

import pytest

from cags_common import registry
from cags_common.errors import ConfigError
from cags_common.registry import Registry

GROUP = "cags.tests"


@pytest.fixture
def policies(monkeypatch: pytest.MonkeyPatch) -> Registry[Callable[..., object]]:
    registered = [
        EntryPoint("fraction", "fractions:Fraction", GROUP),
        EntryPoint("own", "fractions:Fraction", GROUP),
        EntryPoint("lacking", "no_such_package.part:Thing", GROUP),
    ]

    def entry_points(group: str, name: str | None = None) -> list[EntryPoint]:
        assert group == GROUP
        return [entry for entry in registered if name in (None, entry.name)]

    monkeypatch.setattr(registry, "entry_points", entry_points)
    return Registry("policy =", GROUP, {"own": dict})


def test_the_program_s_own_come_before_registered_ones_of_their_name(policies: Registry[Callable[..., object]]) -> None:
    assert policies.find("own") is dict
    assert policies.names() == ("own", "fraction", "lacking")
    assert list(policies) == ["own"]


def test_a_registered_one_is_imported_when_it_is_asked_for(policies: Registry[Callable[..., object]]) -> None:
    assert str(policies.find("fraction")(1, 2)) == "1/2"


@pytest.mark.parametrize("name", ["magic", "", "Own"])
def test_an_unknown_name_is_refused_with_those_there_are(policies: Registry[Callable[..., object]], name: str) -> None:
    with pytest.raises(ConfigError, match=f"policy = '{name}' is unknown; known: own, fraction, lacking$"):
        policies.find(name)


def test_what_is_lacking_is_named_with_the_extra_that_brings_it(policies: Registry[Callable[..., object]]) -> None:
    with pytest.raises(ConfigError) as told:
        policies.find("lacking")
    assert str(told.value) == (
        "policy = 'lacking' needs the package no_such_package: pip install 'cags-stream[research]'"
    )
    assert "no_such_package" not in sys.modules


def test_what_is_entered_by_hand_is_found(policies: Registry[Callable[..., object]]) -> None:
    policies["mine"] = list
    assert policies.find("mine") is list
