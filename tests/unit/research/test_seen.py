"""What was trained on is listed, and what is listed is found."""

from __future__ import annotations

import pytest

from cags_research.restore.networks.weights import Weights
from cags_research.seen import KINDS, listed, unlisted, uses
from cags_server.fov.lstm import LstmWeights

NETWORKS = ("srresnet", "sr-align-ref", "cr-no-ref")


def test_the_list_is_one() -> None:
    assert len(listed()) > 5
    assert {entry.kind for entry in listed()} == set(KINDS)
    assert all(entry.use for entry in listed())


@pytest.mark.parametrize(
    ("kind", "spec", "found"),
    [
        ("scene", "../shared/scenes/plant/plant.splat", True),
        ("scene", "procedural:size=30000,frames=45", True),
        ("scene", "motion:/tmp/plant.ply:kind=bend", True),
        ("scene", "/data/monkey-frames/", True),
        ("scene", "my/plantation.splat", False),
        ("walk", "poses/room_user03.csv", True),
        ("walk", "poses/room_user13.csv", False),
        ("trace", "plant.splat", False),
        ("trace", "lte.csv", False),
    ],
)
def test_what_was_seen_is_found_by_its_name(kind: str, spec: str, found: bool) -> None:
    assert bool(uses(kind, spec)) == found


@pytest.mark.parametrize("name", NETWORKS)
def test_whatever_a_network_learnt_from_is_listed(name: str) -> None:
    about = Weights.shipped(name).about
    assert about["scenes"]
    assert unlisted("scene", [*about["scenes"], *about["held_out"]]) == []
    assert unlisted("walk", about.get("poses", [])) == []


def test_whatever_the_field_of_views_network_learnt_from_is_listed() -> None:
    known = LstmWeights.load().provenance
    walks = [f"{walk}.csv" for walk in (*known["data"], *known["validation"])]
    assert walks
    assert unlisted("walk", walks) == []
