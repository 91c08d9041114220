"""What the experts' model cards say is true of the files beside them, and in the README."""

import hashlib
from typing import Any

import onnx as _onnx
import pytest
import safetensors.numpy as _safetensors

import expert_cards
from palr_gym import Client
from support.server_process import ROOT

# Their annotations are partial.
onnx: Any = _onnx
safetensors: Any = _safetensors

EXPERTS = ROOT / "scenes" / "experts"
MAX_BYTES = 1 << 20


CARDS: dict[str, dict[str, Any]] = expert_cards.cards()


def test_the_readme_has_the_table_that_the_cards_make() -> None:
    readme = (EXPERTS / "README.md").read_text()
    assert expert_cards.with_table(readme) == readme, "run .venv/bin/python scripts/expert_cards.py"


@pytest.mark.parametrize("task", CARDS)
def test_a_card_is_of_the_files_that_ship(task: str, client: Client) -> None:
    card = CARDS[task]
    for kind in ("onnx", "safetensors"):
        content = (EXPERTS / f"{task}.{kind}").read_bytes()
        assert len(content) == card[kind]["bytes"] <= MAX_BYTES
        assert hashlib.sha256(content).hexdigest() == card[kind]["sha256"]
    assert card["fitness"]["onnx_sha256"] == card["onnx"]["sha256"]
    [listed] = [listed for listed in client.tasks() if listed.name == task]
    assert listed.expert is not None
    assert listed.expert.card_return == round(card["deterministic"]["return_mean"], 1)
    # The first of the episodes that the card measured.
    seed = card["deterministic"]["seed"]
    played = client.evaluate(task, "expert", episodes=3, seed=seed)
    assert (
        min(episode.episode_return for episode in played.episodes)
        >= (card["deterministic"]["return_min"])
    )


@pytest.mark.parametrize("task", CARDS)
def test_both_formats_hold_the_same_numbers(task: str) -> None:
    model = onnx.load(str(EXPERTS / f"{task}.onnx"))
    inside = {tensor.name: onnx.numpy_helper.to_array(tensor) for tensor in model.graph.initializer}
    beside = safetensors.load_file(EXPERTS / f"{task}.safetensors")
    assert beside
    for name, values in beside.items():
        assert (inside[name] == values).all(), name
