"""The table of docs/lane.md is that of docs/lane.json."""

import json

import lane_table
from support.server_process import ROOT


def test_the_table_is_that_of_the_runs_beside_it() -> None:
    runs = json.loads((ROOT / "docs" / "lane.json").read_text())
    page = (ROOT / "docs" / "lane.md").read_text()
    # BC and PALR's four alphas, with two stacks.
    assert len({(run["env_id"], run["algorithm"], run["alpha"]) for run in runs}) == 10
    assert lane_table.with_table(page, runs) == page


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
