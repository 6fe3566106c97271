"""The page of words: its figures are made from the data beside it, and by nobody's hand."""

import json
from pathlib import Path

import pytest

from cags_bench.jsonl import check
from cags_bench.reproduce.experiments import EXPERIMENTS
from cags_bench.reproduce.page import write_claims, write_section
from cags_bench.reproduce.section import Section
from cags_bench.reproduce.words import HEADLINES, TABLES, page_text, renew, renewed
from cags_common.errors import ConfigError

DOCS = Path(__file__).parents[4] / "docs"
WHERE = {"machine": "a machine", "commit": "abcdef1"}


def lines(path: Path, *found: dict) -> None:
    path.write_text("".join(json.dumps({**line, **WHERE}) + "\n" for line in found))


def test_the_committed_page_says_what_the_committed_figures_say() -> None:
    text = (DOCS / "evaluation.md").read_text(encoding="utf-8")
    assert [name for name in TABLES if f"<!-- made: {name} -->" not in text] == []
    assert renewed(text, DOCS / "evaluation") == text, "run cags-bench reproduce --page docs/evaluation.md"


def test_the_best_of_a_rate_is_set_off(tmp_path) -> None:
    rows = [("ours", 30.0, 41.0), ("theirs", 30.0, 40.0), ("ours", 60.0, 43.0), ("theirs", 60.0, 44.0)]
    lines(tmp_path / "fixed.jsonl", *({"method": m, "paper's Mbps": r, "PSNR [dB]": v} for m, r, v in rows))
    page = tmp_path / "page.md"
    page.write_text("before\n<!-- made: means -->\nold\n<!-- end -->\nafter\n")
    renew(page, tmp_path)
    text = page.read_text()
    assert "old" not in text
    assert text.startswith("before\n") and text.endswith("after\n")
    assert "a machine, commit abcdef1" in text
    assert "| 30 | **41.0** | 40.0 |" in text
    assert "| 60 | 43.0 | **44.0** |" in text
    renew(page, tmp_path)
    assert page.read_text() == text


def test_a_lead_stands_with_its_interval_beside_its_scene_and_link(tmp_path) -> None:
    lead = {"scene": "room", "link": "30 Mbps", "lead": 6.04, "95 % from": 5.0, "to": 7.06}
    ours, published = "CAGS (ours)", "CAGS (as published)"
    lines(
        tmp_path / "rivals.jsonl",
        {**lead, "method": ours, "baseline": "LTS-F"},
        {**lead, "method": ours, "baseline": "CR w/o ref."},
        {**lead, "method": ours, "baseline": "LTS-F", "scene": "short", "95 % from": None, "to": None},
        {**lead, "method": published, "baseline": "LTS-F", "lead": 1.0},
    )
    text = renewed("<!-- made: leads -->\n<!-- end -->", tmp_path)
    assert "| room | 30 Mbps | +6.0 (5.0 to 7.1) |" in text
    assert "| short | 30 Mbps | +6.0 (unknown to unknown) |" in text


def test_sessions_of_the_full_size_stand_beside_each_other(tmp_path) -> None:
    (tmp_path / "full").mkdir()
    figures = {"PSNR [dB]": 54.98, "95 % from": 54.7, "to": 55.2, "PSNR, 5th percentile": 54.0}
    ours = {"scene": "head", "link": "30 Mbps", "method": "ours", **figures, "goodput here [Mbps]": 2.26}
    theirs = {**ours, "method": "LTS-F", "PSNR [dB]": 20.0}
    later = {**ours, "link": "60 Mbps"}
    lines(tmp_path / "full" / "sessions.jsonl", ours, theirs, later, {**theirs, "scene": "room"})
    text = renewed("<!-- made: full -->\n<!-- end -->", tmp_path)
    assert "| scene | link | ours | LTS-F |" in text
    cells = "(54.7 to 55.2), 54.0, 2.3"
    assert f"| head | 30 Mbps | 55.0 {cells} | 20.0 {cells} |" in text
    assert f"| head | 60 Mbps | 55.0 {cells} |  |" in text, "not played by all"
    assert f"| room | 30 Mbps |  | 20.0 {cells} |" in text
    assert "room | 60" not in text


@pytest.mark.parametrize(("table", "message"), [("nothing", "is no table"), ("means", "run cags-bench")])
def test_what_cannot_be_made_is_refused(tmp_path, table, message) -> None:
    with pytest.raises(ConfigError, match=message):
        renewed(f"<!-- made: {table} -->\n<!-- end -->", tmp_path)


def test_claims_of_one_table_replace_their_own_and_leave_the_others(tmp_path) -> None:
    def section(name: str, value: str, *, ok: bool) -> Section:
        return Section(name, name, "", checks=[check(f"{name} is ahead", "> 0 dB", value, ok)])

    write_claims(tmp_path, [section("rivals", "+1", ok=True), section("ablations", "-1", ok=False)])
    write_claims(tmp_path, [section("rivals", "-2", ok=False)])
    found = [json.loads(line) for line in (tmp_path / "claims.jsonl").read_text().splitlines()]
    assert {one["experiment"]: (one["value"], one["ok"]) for one in found} == {
        "rivals": ("-2", False),
        "ablations": ("-1", False),
    }
    text = renewed("<!-- made: claims -->\n<!-- end -->", tmp_path)
    assert "| red | rivals is ahead | > 0 dB | -2 |" in text


def claims_of(tmp_path: Path, *found: tuple[str, str, bool]) -> str:
    write_claims(
        tmp_path,
        [Section(f"{kind}", "", "", checks=[check(name, "> 0", "+1", ok)]) for kind, name, ok in found],
    )
    return renewed("<!-- made: summary -->\n<!-- end -->", tmp_path)


def test_the_summary_says_in_ten_lines_what_holds_what_does_not_and_what_is_not_known(tmp_path: Path) -> None:
    text = claims_of(tmp_path, ("range", "ahead of LTS-F over", True), ("ablations", "PRPA: brings something", False))
    rows = [line for line in text.splitlines() if line.startswith("| ")][2:]
    assert len(rows) == len(HEADLINES) == 10
    assert rows[0].startswith("| green | ours is ahead of every baseline") and "1 of 1 checks hold" in rows[0]
    assert rows[3].startswith("| red | each part") and "0 of 1 checks hold; not: PRPA" in rows[3]
    assert all("| open |" in row and "not measured yet" in row for row in rows[4:])


def test_every_claim_of_the_summary_rests_on_checks_that_experiments_make() -> None:
    known = {*EXPERIMENTS, "run"}
    assert {name for _, names, _ in HEADLINES for name in names} <= known


def test_an_effect_stands_with_what_it_brings_by_scene_and_what_it_costs(tmp_path: Path) -> None:
    row = {"part": "PRPA", "of": "as published", "link": "30 Mbps", "brings [dB]": 1.234, "95 % from": 0.5, "to": None}
    costs = {"server [ms a frame]": 2.5, "client [ms a frame]": -1.0, "kB a frame": 0.25}
    other = {**row, "link": "60 Mbps", "brings [dB]": 9.0}
    lines(
        tmp_path / "ablations.jsonl",
        *({**row, **costs, "scene": s} for s in ("head", "all scenes")),
        other | {"scene": "head"},
    )
    text = renewed("<!-- made: effects -->\n<!-- end -->", tmp_path)
    cell = "+1.23 (0.50 to unknown)"
    assert f"| PRPA | as published | {cell} | {cell} | 2.5 | -1 | 0.25 |" in text
    assert "9.0" not in text


def test_a_table_stands_as_measured_or_says_how_to_measure_it(tmp_path: Path) -> None:
    mark = "<!-- made: range -->\n<!-- end -->"
    assert "Not measured yet: `cags-bench reproduce --figure range`" in renewed(mark, tmp_path)
    write_section(
        tmp_path, Section("range", "", "", ("scene", "dB", "frames"), [["../x/head.ply", 40.12345, 7], ["b", None, 8]])
    )
    text = renewed(mark, tmp_path)
    assert "| head | 40.12 | 7 |" in text
    assert "| b | - | 8 |" in text


def test_a_page_that_cannot_be_read_is_named_with_the_way_out(tmp_path) -> None:
    with pytest.raises(ConfigError, match=r"nowhere.md: cannot be read \(No such file.*give an existing"):
        page_text(tmp_path / "nowhere.md")
    (tmp_path / "latin.md").write_bytes(b"caf\xe9")
    with pytest.raises(ConfigError, match=r"latin.md: cannot be read \(it is not UTF-8\)"):
        page_text(tmp_path / "latin.md")
