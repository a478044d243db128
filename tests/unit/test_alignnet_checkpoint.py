"""Weights come back as they were, with where they come from; what is not whole or not ours is refused."""

import json
import pickle

import pytest
import torch
from safetensors.torch import save_file

from registration.alignnet import checkpoint
from registration.alignnet.errors import WeightsError
from registration.alignnet.recipe import Recipe
from tests import learned


@pytest.fixture
def weights(tmp_path):
    network = learned.network()
    about = checkpoint.About(
        Recipe(network=network.architecture), 1.7, {"rmse_t": 0.1}, ({"name": "set", "seed": 3},), "abc"
    )
    checkpoint.write_weights(tmp_path / "w.safetensors", network, about)
    return tmp_path / "w.safetensors", network, about


def test_weights_come_back_with_where_they_come_from(weights):
    path, network, about = weights
    read, read_about = checkpoint.read_weights(path)
    assert read_about == about
    assert not read.training
    for name, tensor in network.state_dict().items():
        assert torch.equal(read.state_dict()[name], tensor)


def test_truncated_weights_are_refused(weights):
    path, _, _ = weights
    for size in (0, 4, 100, path.stat().st_size - 1):
        content = path.read_bytes()
        cut = path.with_name(f"cut{size}.safetensors")
        cut.write_bytes(content[:size])
        with pytest.raises(WeightsError, match=f"cut{size}.safetensors: no whole safetensors file"):
            checkpoint.read_weights(cut)


def test_pickled_weights_are_refused_and_not_unpickled(tmp_path):
    class Harm:
        def __reduce__(self):
            return (pytest.fail, ("the pickle was loaded",))

    (tmp_path / "evil.pt").write_bytes(pickle.dumps(Harm()))
    with pytest.raises(WeightsError, match="evil.pt: no whole safetensors file"):
        checkpoint.read_weights(tmp_path / "evil.pt")


def test_tensors_of_others_are_refused(tmp_path):
    save_file({"weight": torch.ones(3)}, tmp_path / "other.safetensors")
    with pytest.raises(WeightsError, match="expected a file of regmot-alignnet-weights, got 'tensors of others'"):
        checkpoint.read_weights(tmp_path / "other.safetensors")


def rewrite(path, network, **changes):
    fields = {"recipe": {}, "covariance_scale": 1.0, "validation": {}, "data": [], "commit": ""} | changes.pop(
        "fields", {}
    )
    metadata = {"kind": checkpoint.WEIGHTS, "format": "1", "fields": json.dumps(fields)} | changes
    save_file(dict(network.state_dict()), path, metadata)


def test_another_format_and_another_network_are_refused(tmp_path):
    path, network = tmp_path / "w.safetensors", learned.network()
    rewrite(path, network, format="2")
    with pytest.raises(WeightsError, match="expected format 1, got 2"):
        checkpoint.read_weights(path)
    rewrite(path, network)
    with pytest.raises(WeightsError, match="do not fit the network of their recipe"):
        checkpoint.read_weights(path)
    rewrite(path, network, fields={"recipe": {"network": {"depth": 3}}})
    with pytest.raises(WeightsError, match="unknown setting 'depth'"):
        checkpoint.read_weights(path)


def test_a_missing_file_is_named(tmp_path):
    with pytest.raises(WeightsError, match="none.safetensors: no such file"):
        checkpoint.read_weights(tmp_path / "none.safetensors")


def test_nothing_half_written_stays(weights, monkeypatch):
    path, network, about = weights
    before = path.read_bytes()

    def fail(*_):
        raise OSError("disk full")

    monkeypatch.setattr(checkpoint.os, "replace", fail)
    with pytest.raises(OSError, match="disk full"):
        checkpoint.write_weights(path, network, about)
    assert path.read_bytes() == before
    assert [file.name for file in path.parent.iterdir()] == ["w.safetensors"]


def test_a_training_goes_on_with_its_optimiser(tmp_path):
    network = learned.network().train()
    optimiser = torch.optim.AdamW(network.parameters(), lr=0.1)
    sum((parameter**2).sum() for parameter in network.parameters()).backward()
    optimiser.step()
    checkpoint.write_state(tmp_path / "s.safetensors", network, optimiser, {"step": 1})
    other = learned.network(seed=5)
    other_optimiser = torch.optim.AdamW(other.parameters(), lr=0.1)
    assert checkpoint.read_state(tmp_path / "s.safetensors", other, other_optimiser) == {"step": 1}
    slots, other_slots = optimiser.state_dict()["state"], other_optimiser.state_dict()["state"]
    assert len(slots) == len(other_slots) > 0
    for index, values in slots.items():
        for slot, value in values.items():
            assert torch.equal(other_slots[index][slot], value)
    with pytest.raises(WeightsError, match="got 'regmot-alignnet-training'"):
        checkpoint.read_weights(tmp_path / "s.safetensors")
