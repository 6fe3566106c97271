"""Every subcommand that is advertised exists and explains itself."""

import importlib

import pytest

from cags_bench.cli import SUBCOMMANDS, main
from cags_bench.demo import cli as demo
from cags_bench.demo.run import check_replaceable
from cags_common.errors import CagsError


@pytest.mark.parametrize("name", SUBCOMMANDS)
def test_subcommands_explain_themselves(name, capsys):
    with pytest.raises(SystemExit) as done:
        main([name, "--help"])
    assert done.value.code == 0
    shown = capsys.readouterr().out
    assert f"cags-bench {name}" in shown
    assert "--json" in shown
    assert importlib.import_module(f"cags_bench.{name}.command").EXAMPLES.strip().splitlines()[0].strip() in shown


def test_without_a_subcommand_the_list_is_shown(capsys):
    assert main([]) == 2
    shown = capsys.readouterr().out
    assert all(name in shown for name in SUBCOMMANDS)


def test_the_demo_replaces_only_its_own_reports(tmp_path):
    check_replaceable(tmp_path / "new")
    check_replaceable(tmp_path)
    (tmp_path / "thesis.tex").write_text("years of work")
    with pytest.raises(CagsError, match="not an earlier report"):
        check_replaceable(tmp_path)
    (tmp_path / "summary.json").write_text("{}")
    check_replaceable(tmp_path)


@pytest.mark.parametrize(
    ("flag", "words"), [("--trace", "no.such.trace: cannot be read"), ("--poses", "no.such.trace")]
)
@pytest.mark.parametrize("view", [[], ["--view"]])
def test_the_demo_tells_what_cannot_be_read_before_it_encodes(tmp_path, monkeypatch, capsys, flag, words, view):
    monkeypatch.setattr("cags_bench.demo.run.cached_bundle", lambda *rest: pytest.fail("a scene was encoded"))
    given = ["procedural:size=500", flag, "no.such.trace", "--out", str(tmp_path / "out"), *view]
    assert demo.main(given) == 1
    assert words in capsys.readouterr().err
    assert not (tmp_path / "out").exists()
