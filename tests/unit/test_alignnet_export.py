"""The exported graphs agree with the network, on other sizes than those they were exported with."""

import subprocess
import sys

import torch

from registration.alignnet import checkpoint, export
from registration.alignnet.recipe import Recipe
from tests import learned

# In a process of its own: the suite checks shapes as it runs, and the exporter's are symbols.
SCRIPT = """
import pathlib, sys
from registration.alignnet import checkpoint, export
export.write(checkpoint.read_weights(pathlib.Path(sys.argv[1]))[0], pathlib.Path(sys.argv[2]))
"""


def test_graphs_on_disk_give_what_the_network_gives(tmp_path):
    network = learned.network()
    checkpoint.write_weights(
        tmp_path / "w.safetensors", network, checkpoint.About(Recipe(network=network.architecture))
    )
    subprocess.run([sys.executable, "-c", SCRIPT, str(tmp_path / "w.safetensors"), str(tmp_path)], check=True)
    encode, align = (torch.export.load(tmp_path / f"{name}.pt2").module() for name in ("encode", "align"))
    clouds = learned.clouds(sizes=(9, 80, 1, 33, 2, 14, 60))
    with torch.no_grad():
        encoding = network.encode(clouds)
        for exported, field in zip(encode(*clouds), encoding, strict=True):
            torch.testing.assert_close(exported, field, rtol=1e-4, atol=1e-5)
        source, target = encoding.rows(slice(0, 3)), encoding.rows(slice(4, 7))
        motion = network.align(source, target)
        for exported, name in zip(align(tuple(source), tuple(target)), export.OUTPUTS, strict=True):
            torch.testing.assert_close(exported, getattr(motion, name), rtol=1e-4, atol=1e-5)
