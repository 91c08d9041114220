"""The tables of docs/lane.md are those of docs/lane.json."""

import json

import lane_table
from support.server_process import ROOT


def test_the_tables_are_those_of_the_runs_beside_them() -> None:
    runs = json.loads((ROOT / "docs" / "lane.json").read_text())
    page = (ROOT / "docs" / "lane.md").read_text()
    # BC and PALR's four alphas, with two stacks.
    grid = {(run["env_id"], run["algorithm"], run["alpha"]) for run in runs["grid"]}
    assert len(grid) == 10
    assert lane_table.with_tables(page, runs) == page


def test_a_row_has_means_over_seeds_and_the_scores_interval() -> None:
    runs = [
        {
            "env_id": "lane-w3-v0",
            "algorithm": "palr",
            "alpha": 10.0,
            "seed": seed,
            "score_mean": score,
            "length_mean": 200.0,
            "held_out_nll": -2.0,
            "held_out_change_nll": -1.0,
            "held_out_action_hscic": 0.01,
            "held_out_hscic": 0.02,
        }
        for seed, score in enumerate([10.0, 20.0, 30.0])
    ]
    # Student's t with two degrees of freedom: 4.303 · 10 / √3.
    row = "| PALR | 3 | 10 | 3 | 20.0 ± 24.8 | 200 | -2.00 | -1.00 | 0.0100 | 0.0200 |"
    assert lane_table.table(runs).splitlines()[-1] == row


def test_differences_are_taken_within_replicates() -> None:
    scores = {
        ("lane-w1-v0", "bc"): [10.0, 20.0, 60.0],
        ("lane-w3-v0", "bc"): [9.0, 18.0, 57.0],
        ("lane-w1-v0", "palr"): [11.0, 21.0, 61.0],
        ("lane-w3-v0", "palr"): [14.0, 23.0, 62.0],
    }
    runs = [
        {
            "env_id": env_id,
            "algorithm": algorithm,
            "data_sha256": str(at),
            "seed": at,
            "score_mean": score,
        }
        for (env_id, algorithm), values in scores.items()
        for at, score in enumerate(values)
    ]
    # Student's t with two degrees of freedom: 4.303 / √3 for differences one apart.
    assert lane_table.paired(runs).splitlines()[2:] == [
        "| BC | 3 | 30.0 ± 65.7 | 28.0 ± 63.4 | -2.0 ± 2.5 |",
        "| PALR | 3 | 31.0 ± 65.7 | 33.0 ± 63.4 | 2.0 ± 2.5 |",
        "| PALR less BC | 3 | 1.0 ± 0.0 | 5.0 ± 0.0 | 4.0 ± 0.0 |",
    ]
