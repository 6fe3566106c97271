"""Tests mirror the source, module by module: a test of its package names each, or is named here."""

from __future__ import annotations

from functools import cache

import pytest

from support.imports import KERNELS, PACKAGES, ROOT, reached, sources, used

KINDS = ("unit", "property", "stability", "integration")
NOT_PYTHON = {"cags_web"}
"""The viewer in the browser: its tests are in ``tests/web`` and ``web/tests``."""
TESTED_THROUGH = {
    "cags_common.bundle.fields": "tests/unit/common/bundle/test_manifest.py",
    "cags_common.correction": "tests/unit/common/correction/test_correctors.py",
    "cags_common.runtime.terminal": "tests/unit/client/output/test_console.py",
    "cags_common.store.gof_tiles": "tests/unit/common/store/test_tile_store.py",
    "cags_common.transport.accepting": "tests/attacks/test_acceptor.py",
    "cags_encoder.bundles": "tests/unit/encoder/bundles/test_looking.py",
    "cags_encoder.clip": "tests/unit/encoder/test_encode.py",
    "cags_encoder.codecs.registry": "tests/unit/research/codecs/test_codecs.py",
    "cags_encoder.formats": "tests/unit/encoder/formats/test_round_trips.py",
    "cags_encoder.frames": "tests/unit/encoder/test_encode.py",
    "cags_encoder.motion.trails": "tests/unit/encoder/motion/test_span_chunks.py",
    "cags_encoder.quantiser": "tests/unit/encoder/test_quantiser.py",
    "cags_encoder.scenes.fourd": "tests/unit/encoder/scenes/test_fourd.py",
    "cags_encoder.scenes.procedural": "tests/unit/encoder/scenes/test_procedural.py",
    "cags_client.frame.align.fast": "tests/unit/client/frame/test_align.py",
    "cags_server.http.acceptor": "tests/attacks/test_acceptor.py",
    "cags_server.http.gallery": "tests/integration/server/test_gallery.py",
    "cags_server.predict": "tests/unit/server/predict/test_predictors.py",
    "cags_server.ratecontrol.plan": "tests/unit/server/session/test_streamer.py",
    "cags_server.session": "tests/unit/server/session/test_streamer.py",
    "cags_shaper.shaped": "tests/unit/shaper/test_control.py",
    "cags_research.align": "tests/unit/client/frame/test_align.py",
    "cags_research.codecs": "tests/unit/research/codecs/test_codecs.py",
    "cags_research.ratepolicies": "tests/sim/test_baselines.py",
    "cags_research.restore": "tests/unit/research/restore/networks/test_restorers.py",
    "cags_research.training": "tests/unit/research/training/test_restore_command.py",
    "cags_bench.align": "tests/unit/bench/test_cli.py",
    "cags_bench.codec": "tests/unit/bench/test_codec.py",
    "cags_bench.cost": "tests/unit/bench/cost/test_sweep.py",
    "cags_bench.demo": "tests/unit/bench/test_cli.py",
    "cags_bench.inputs": "tests/integration/bench/test_wrong_experiments.py",
    "cags_bench.html": "tests/unit/bench/reproduce/test_reproduce.py",
    "cags_bench.motion": "tests/unit/bench/motion/test_command.py",
    "cags_bench.network": "tests/unit/bench/network/test_network_bench.py",
    "cags_bench.predict": "tests/unit/bench/predict/test_command.py",
    "cags_bench.programs": "tests/unit/bench/demo/test_demo_bench.py",
    "cags_bench.raster": "tests/unit/bench/test_raster.py",
    "cags_bench.references": "tests/unit/bench/test_references_bench.py",
    "cags_bench.reproduce": "tests/unit/bench/reproduce/test_reproduce.py",
    "cags_bench.sim": "tests/unit/bench/stream/test_stream.py",
    "cags_bench.stream": "tests/unit/bench/stream/test_stream.py",
    "cags_bench.web": "tests/unit/bench/test_web.py",
}
"""Modules, or packages of them, that no test of their package imports, and the test that runs them."""


@cache
def named_by_tests(package: str) -> frozenset[str]:
    """Modules that the tests of ``package`` (``cags_client``) import."""
    folders = [ROOT / "tests" / kind / package.removeprefix("cags_") for kind in KINDS]
    return frozenset().union(*(used(test) for folder in folders for test in folder.rglob("*.py")))


def has_file(module: str) -> bool:
    """Whether ``test_NAME.py`` or ``test_NAME_*.py`` lies where the module does."""
    package, *folders, name = module.split(".")
    places = [ROOT.joinpath("tests", kind, package.removeprefix("cags_"), *folders) for kind in KINDS]
    return any((place / f"test_{name}.py").exists() or any(place.glob(f"test_{name}_*.py")) for place in places)


@cache
def unmirrored() -> frozenset[str]:
    """Modules without a test file of their name that no test of their package imports."""
    modules = {name for name, path in sources().items() if path.stem not in {"__init__", "__main__"}}
    core = {name for name in modules if name.partition(".")[0] not in NOT_PYTHON}
    return frozenset(name for name in core if name not in named_by_tests(name.partition(".")[0]) and not has_file(name))


def test_every_module_is_named_by_a_test_of_its_package_or_in_the_list() -> None:
    def covers(entry: str, name: str) -> bool:
        return name == entry or name.startswith(f"{entry}.")

    left = unmirrored()
    assert {name for name in left if not any(covers(entry, name) for entry in TESTED_THROUGH)} == set()
    needless = {entry for entry in TESTED_THROUGH if not any(covers(entry, name) for name in left)}
    assert needless == set(), "one that has a mirror leaves the list"


@pytest.mark.parametrize("entry", TESTED_THROUGH)
def test_the_test_in_the_list_runs_what_it_stands_for(entry: str) -> None:
    within = {name for name in unmirrored() if name == entry or name.startswith(f"{entry}.")}
    assert within - reached(ROOT / TESTED_THROUGH[entry]) == set()


def test_no_folder_of_unit_tests_is_of_nothing() -> None:
    packages = {package.name.removeprefix("cags_"): package for package in (*PACKAGES, KERNELS)}
    unit = ROOT / "tests/unit"
    folders = {path.parent.relative_to(unit) for path in unit.rglob("test_*.py")}
    assert {str(f) for f in folders if not packages[f.parts[0]].joinpath(*f.parts[1:]).is_dir()} == set()
