"""Figures from measurements to results.json and the README, without measuring anything."""

import json
from collections.abc import Mapping

import pytest
from bench import run
from bench.families import groups
from bench.plan import Contender, ContenderError, Figure, Group, Settings, ratio
from bench.report import (
    END_MARKER,
    START_MARKER,
    Circumstances,
    Comparison,
    Entry,
    as_json,
    entry,
    merged,
    tables,
    with_tables,
)

HERE = Circumstances(date="2026-11-23", processor="Some Processor, 2 cores")
NO_SETTINGS = Settings(seconds=1, repeats=3, threads=2, binaries=run.ROOT, python=run.ROOT)


def figure(name: str, *comparisons: Comparison) -> Entry:
    return entry(
        name,
        kind="throughput",
        better="higher",
        unit="steps/s",
        repeats=comparisons,
        circumstances=HERE,
    )


def test_an_entry_is_the_repeat_with_the_median_ratio() -> None:
    # The machine slowed down in the last repeat; the medians of ours (100) and of the reference
    # (200) would be from two different repeats.
    repeats = (Comparison(150, 200), Comparison(100, 160), Comparison(90, 220))
    assert figure("step.hopper.64.rust_vs_limit", *repeats) == {
        "name": "step.hopper.64.rust_vs_limit",
        "kind": "throughput",
        "better": "higher",
        "ours": 100,
        "reference": 160,
        "ratio": 0.625,
        "unit": "steps/s",
        "spread": [0.40909, 0.75],
        "repeats": 3,
        "command": "make bench ONLY=step.hopper.64.rust_vs_limit",
        "date": "2026-11-23",
        "processor": "Some Processor, 2 cores",
    }


def test_of_an_even_number_of_repeats_the_lower_middle_is_published() -> None:
    middle = figure("a.b", *(Comparison(number, 10) for number in (4, 1, 3, 2)))
    assert (middle.get("ours"), middle.get("ratio")) == (2, 0.2)


def test_an_absolute_figure_has_a_value_and_no_ratio() -> None:
    start = figure("start.healthy_ms", Comparison(31), Comparison(29), Comparison(30))
    assert start.get("value") == 30
    assert start["spread"] == [29, 31]
    assert not {"ours", "reference", "ratio"} & start.keys()


def test_merging_replaces_equal_names_and_keeps_the_rest_in_order() -> None:
    old = [figure(name, Comparison(1, 1)) for name in ("step.a.512", "step.a.8", "start.x")]
    new = [figure(name, Comparison(2, 1)) for name in ("step.a.64", "step.a.8")]
    result = [(entry["name"], entry.get("ours")) for entry in merged(old, new)]
    assert result == [("start.x", 1), ("step.a.8", 2), ("step.a.64", 2), ("step.a.512", 1)]


def test_results_are_written_in_the_order_of_the_format() -> None:
    written = json.loads(as_json([figure("step.a", Comparison(1, 2))]))
    assert list(written[0]) == [
        *("name", "kind", "better", "ours", "reference", "ratio", "unit", "spread", "repeats"),
        *("command", "date", "processor"),
    ]


def test_each_family_has_a_table() -> None:
    entries = [
        figure("step.hopper.4096_vs_64", Comparison(40_321.4, 48_000)),
        figure("start.healthy_ms", Comparison(12.345)),
    ]
    assert tables(entries).splitlines() == [
        "**Starting**",
        "",
        "| figure | ours | reference | unit | ratio | all repeats |",
        "|---|---:|---:|---|---:|---|",
        "| `start.healthy_ms` | **12.3** |  | steps/s |  | 12.3 to 12.3 |",
        "",
        "**Stepping**",
        "",
        "| figure | ours | reference | unit | ratio | all repeats |",
        "|---|---:|---:|---|---:|---|",
        "| `step.hopper.4096_vs_64` | 40 321 | 48 000 | steps/s | **0.84** | 0.84 to 0.84 |",
        "",
        "Measured on: Some Processor, 2 cores, 2026-11-23. `make bench` repeats it.",
    ]


def test_ratios_of_tasks_in_sizes_stand_in_one_table_the_limit_first() -> None:
    entries = [
        figure("step.hopper.64.python_vs_envpool", Comparison(3, 2)),
        figure("step.hopper.64.rust_vs_limit", *(Comparison(n, 4) for n in (1, 2, 3))),
        figure("step.hopper.8.rust_vs_limit", Comparison(1, 4)),
    ]
    assert tables(entries).splitlines()[:6] == [
        "**Stepping**",
        "",
        "| | rust / limit | python / envpool |",
        "|---|---|---|",
        "| hopper, 8 | **0.25** (0.25 to 0.25) |  |",
        "| hopper, 64 | **0.50** (0.25 to 0.75) | **1.50** (1.50 to 1.50) |",
    ]


def test_tables_go_between_the_markers_and_nowhere_else() -> None:
    readme = f"# Title\n\n{START_MARKER}\nold\n{END_MARKER}\n\nMore.\n"
    written = with_tables(readme, [figure("step.a", Comparison(1, 2))])
    assert written.startswith(f"# Title\n\n{START_MARKER}\n**Stepping**\n")
    assert written.endswith(f"repeats it.\n{END_MARKER}\n\nMore.\n")
    assert "old" not in written
    assert with_tables(written, [figure("step.a", Comparison(1, 2))]) == written


@pytest.mark.parametrize("readme", ["", "text", f"{START_MARKER} only", f"{END_MARKER} only"])
def test_a_readme_without_both_markers_is_left_alone(readme: str) -> None:
    assert with_tables(readme, [figure("step.a", Comparison(1, 2))]) == readme


def test_names_are_unique_and_the_default_set_is_a_part_of_them() -> None:
    names = [figure.name for group in groups() for figure in group.figures]
    assert len(set(names)) == len(names)
    default = [figure.name for group in run.chosen(groups(), None) for figure in group.figures]
    assert set(default) < set(names)
    assert "step.hopper.64.rust_vs_limit" in default


def test_a_prefix_chooses_figures_and_only_their_groups() -> None:
    chosen = run.chosen(groups(), "step.ant.512.rust")
    assert [[figure.name for figure in group.figures] for group in chosen] == [
        ["step.ant.512.rust_vs_limit"]
    ]
    assert run.chosen(groups(), "nothing") == []


def figures_of(*references: str) -> list[Figure]:
    return [
        ratio(f"x.ours_vs_{reference}", "ours", reference, unit="/s", kind="throughput")
        for reference in references
    ]


def test_contenders_take_turns_and_only_those_that_are_needed_run() -> None:
    turns: list[str] = []

    def prepare(_: Settings) -> Mapping[str, Contender]:
        def contender(name: str) -> float:
            turns.append(name)
            return 2.0 if name == "ours" else 4.0

        names = ("limit", "ours", "unneeded")
        return {name: lambda name=name: contender(name) for name in names}

    group = Group(figures_of("limit"), prepare)
    entries, left_out = run.measure_group(group, NO_SETTINGS, HERE)
    assert turns == ["limit", "ours"] * 3
    assert [(entry["name"], entry.get("ratio")) for entry in entries] == [("x.ours_vs_limit", 0.5)]
    assert left_out == []


def test_a_failed_peer_is_reported_and_leaves_out_its_figure_only(
    capsys: pytest.CaptureFixture[str],
) -> None:
    def fail() -> float:
        raise ContenderError("no such module")

    def prepare(_: Settings) -> Mapping[str, Contender]:
        return {"limit": lambda: 4.0, "ours": lambda: 2.0, "peer": fail}

    group = Group(figures_of("limit", "peer"), prepare)
    entries, left_out = run.measure_group(group, NO_SETTINGS, HERE)
    assert [entry["name"] for entry in entries] == ["x.ours_vs_limit"]
    assert left_out == ["x.ours_vs_peer"]
    assert capsys.readouterr().err.count("FAILED: peer cannot be measured") == 1


def test_what_cannot_be_prepared_leaves_out_all_its_figures() -> None:
    def prepare(_: Settings) -> Mapping[str, Contender]:
        raise ContenderError("not built")

    group = Group(figures_of("limit"), prepare)
    assert run.measure_group(group, NO_SETTINGS, HERE) == ([], ["x.ours_vs_limit"])
