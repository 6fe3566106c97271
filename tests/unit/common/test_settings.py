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
    loss: float = setting(0.0, "share lost", high=1)
    viewers: int = setting(2, "most viewers", low=0, words={"auto": 0})
    token: str | None = setting(None, "secret")
    loop: bool = setting(False, "play again")

    SECTION: ClassVar[str] = "client"

    def __post_init__(self) -> None:
        check_settings(self)


def parse(*argv: str) -> Example:
    parser = argparse.ArgumentParser()
    add_settings(parser, Example)
    parser.add_argument("--url")
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
        ("port = true", "port = True must be a whole number$"),
        ('rate = "1"', "rate = '1' must be a number$"),
        ("rate = -1", "rate = -1 must be at least 0$"),
        ("loss = 2", "loss = 2 must be at most 1$"),
        ("token = 1", "token = 1 must be text in quotes$"),
        ("loop = 1", "loop = 1 must be true or false$"),
        ("viewers = 'many'", "viewers = 'many' must be a whole number or 'auto'$"),
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


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("port = 1\nrate = -1\n", "c.toml, line 2: rate = -1 must"),
        ("rate = 2\n[server]\nrate = 3\n[client]\n'rate' = -1\n", "c.toml, line 5: rate = -1 must"),
        ("# a word\n\nprto = 1\n", "c.toml, line 3: unknown key 'prto'; did you mean 'port'? known: loop, "),
        ("[clients]\nport = 2\n", "c.toml, line 1: unknown key 'clients'"),
        ("port = 1\nurl = 'x'\n", "c.toml, line 2: 'url' can be given on the command line only"),
        ("port = 1\nport = 2\n", "c.toml: is not TOML (Cannot overwrite a value (at line 2, column 9))"),
        ("port = 70_000\nrate = -1\n", "c.toml, line 1: port = 70000 must"),
    ],
)
def test_what_is_wrong_in_a_file_is_told_with_its_line(tmp_path, text, message):
    (tmp_path / "c.toml").write_text(text)
    with pytest.raises(ConfigError) as caught:
        parse("--config", str(tmp_path / "c.toml"))
    assert message in str(caught.value)


def test_a_file_that_is_not_utf_8_is_told(tmp_path):
    (tmp_path / "c.toml").write_bytes(b'mode = "\xfcber"\n')
    with pytest.raises(ConfigError, match=r"c\.toml: is not TOML \(byte 8 is not UTF-8\)"):
        parse("--config", str(tmp_path / "c.toml"))


def test_what_is_wrong_on_the_command_line_is_not_blamed_on_the_file(tmp_path):
    (tmp_path / "c.toml").write_text("rate = 2\nport = 1\n")
    with pytest.raises(ConfigError, match=r"^port = 70000 must lie in"):
        parse("--config", str(tmp_path / "c.toml"), "--port", "70000")


def test_a_number_may_have_a_name(tmp_path, capsys):
    (tmp_path / "c.toml").write_text('viewers = "auto"\n')
    assert parse("--config", str(tmp_path / "c.toml")).viewers == 0
    assert parse("--viewers", "auto").viewers == 0
    assert parse("--viewers=3").viewers == 3
    with pytest.raises(SystemExit):
        parse("--viewers", "many")
    assert "invalid int or auto value: 'many'" in capsys.readouterr().err


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


def test_help_shows_a_default_by_its_word(capsys):
    @dataclass(frozen=True)
    class Room:
        memory: float = setting(0.0, "memory, MB; auto (or 0): half of it", low=0, words={"auto": 0.0})

    parser = argparse.ArgumentParser()
    add_settings(parser, Room)
    parser.print_help()
    assert "half of it (default: auto)" in capsys.readouterr().out


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
