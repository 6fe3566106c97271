"""Settings become flags, TOML keys, checks and help."""

import argparse
from dataclasses import dataclass
from typing import ClassVar

import pytest

from cags_common.errors import ConfigError
from cags_common.settings import add_settings, check_settings, load_settings, names_in, setting


@dataclass(frozen=True)
class Example:
    port: int = setting(8765, "TCP port", low=0, high=65535)
    rate: float = setting(1.5, "rate in Mbps, 100 % of the link", low=0)
    mode: str = setting("fast", "how", choices=("fast", "exact"))
    token: str | None = setting(None, "secret")
    loop: bool = setting(False, "play again")

    SECTION: ClassVar[str] = "client"

    def __post_init__(self) -> None:
        check_settings(self)


def parse(*argv: str) -> Example:
    parser = argparse.ArgumentParser()
    add_settings(parser, Example)
    return load_settings(Example, parser.parse_args(argv))


def test_defaults_without_flags_or_file():
    assert parse() == Example()


def test_flags_win_over_the_file_and_the_file_over_defaults(tmp_path):
    config = tmp_path / "c.toml"
    config.write_text('port = 1\nmode = "exact"\n')
    assert parse("--config", str(config), "--port", "2") == Example(port=2, mode="exact")


def test_a_boolean_flag_can_be_negated(tmp_path):
    config = tmp_path / "c.toml"
    config.write_text("loop = true\n")
    assert parse("--config", str(config)).loop
    assert not parse("--config", str(config), "--no-loop").loop


def test_unknown_keys_are_refused_by_name(tmp_path):
    config = tmp_path / "c.toml"
    config.write_text("prot = 1\n")
    with pytest.raises(ConfigError, match=r"unknown key 'prot'.*port"):
        parse("--config", str(config))


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("port = 70000", "port = 70000 must lie in"),
        ("port = true", "port = True must be of type int"),
        ('rate = "1"', "rate = '1' must be of type float"),
        ("rate = inf", "rate = inf must be finite"),
        ('mode = "slow"', "mode = 'slow' must be one of fast, exact"),
        ("port = = 1", "is not TOML"),
        ("port = " + 5000 * "[", "is not TOML"),
    ],
)
def test_bad_values_name_the_field_and_the_value(tmp_path, text, message):
    config = tmp_path / "c.toml"
    config.write_text(text + "\n")
    with pytest.raises(ConfigError, match=message):
        parse("--config", str(config))


def test_a_file_may_begin_with_the_mark_that_windows_writes(tmp_path):
    (tmp_path / "c.toml").write_text("port = 1\n", encoding="utf-8-sig")
    assert parse("--config", str(tmp_path / "c.toml")).port == 1


def test_a_missing_file_is_named(tmp_path):
    with pytest.raises(ConfigError, match=r"absent\.toml: cannot be read"):
        parse("--config", str(tmp_path / "absent.toml"))


def test_help_shows_defaults_and_survives_percent_signs(capsys):
    parser = argparse.ArgumentParser()
    add_settings(parser, Example)
    parser.print_help()
    assert "100 % of the link (default: 1.5)" in " ".join(capsys.readouterr().out.split())


def test_one_file_may_serve_several_commands(tmp_path):
    config = tmp_path / "c.toml"
    config.write_text('port = 1\nmode = "exact"\n[server]\nanything = 3\n[client]\nport = 2\n')
    assert parse("--config", str(config)) == Example(port=2, mode="exact")
    config.write_text("[client]\nprot = 2\n")
    with pytest.raises(ConfigError, match="unknown key 'prot'"):
        parse("--config", str(config))
    config.write_text("[clients]\nport = 2\n")
    with pytest.raises(ConfigError, match="unknown key 'clients'"):
        parse("--config", str(config))


@dataclass(frozen=True)
class WithResearch:
    mode: str = setting("fast", "how")
    odd: bool = setting(True, "only experiments change it", research=True)


@pytest.mark.parametrize(("flag", "shown"), [("--help", False), ("--help-all", True)])
def test_what_only_research_changes_is_shown_when_asked_for(capsys, flag, shown):
    parser = argparse.ArgumentParser()
    add_settings(parser, WithResearch)
    with pytest.raises(SystemExit):
        parser.parse_args([flag])
    said = capsys.readouterr().out
    assert "--mode" in said
    assert ("--no-odd" in said, "only experiments change it" in said) == (shown, shown)
    assert load_settings(WithResearch, parser.parse_args(["--no-odd"])) == WithResearch(odd=False)


def test_help_all_is_there_only_where_it_shows_more():
    with pytest.raises(SystemExit):
        parse("--help-all")


def test_names_of_a_list_are_taken_in_order_and_an_unknown_one_is_told():
    assert names_in("b, a,b", "letters", ("a", "b")) == ["b", "a", "b"]
    with pytest.raises(ConfigError, match="letters: 'c' is unknown; known: a, b"):
        names_in("a,c", "letters", ("a", "b"))
    with pytest.raises(ConfigError, match="letters: '' is unknown"):
        names_in("", "letters", ("a", "b"))
