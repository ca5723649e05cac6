"""Two processes that share each batch (DDP on gloo) learn what one process learns."""

import csv
import multiprocessing
import os
import socket
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest
import torch
import torch.distributed.nn
from pathfold_training.networks.losses import Draw, manifold_loss
from training_data import write_data_set

PROGRAM = """
import sys
from pathlib import Path
from pathfold_training.fit.preset import Config, Data, Optimiser
from pathfold_training.networks.losses import Loss
from pathfold_training.fit.train import fit
from pathfold_training.networks.kpcn.sizes import KpcnSizes

config = Config(
    name="tiny",
    description="a network for tests",
    network=KpcnSizes(width=8, layers=3, kernel_size=5, embedding=3, embedding_width=4),
    loss=Loss(manifold=20.0, manifold_pairs=256),
    data=Data(crop=24, batch=4, spp_max=4),
    optimiser=Optimiser(steps=8, precision="fp32", warmup=1, learning_rate=2e-3),
)
data, out, devices = Path(sys.argv[1]), Path(sys.argv[2]), int(sys.argv[3])
fit(config, data, out, seed=3, threads=1, validate_every=4, log_every=1, devices=devices)
"""


def train(program: Path, data: Path, out: Path, devices: int) -> list[dict[str, str]]:
    """Rows of the training log."""
    environment = os.environ | {"CUDA_VISIBLE_DEVICES": "", "OMP_NUM_THREADS": "1"}
    subprocess.run([sys.executable, str(program), str(data), str(out), str(devices)], check=True, env=environment)
    with next(out.glob("log/*/metrics.csv")).open() as file:
        return list(csv.DictReader(file))


@pytest.mark.long
def test_two_processes_follow_the_loss_of_one(tmp_path: Path) -> None:
    program = tmp_path / "program.py"
    program.write_text(PROGRAM)
    data = write_data_set(tmp_path / "data", 4)
    one, two = (train(program, data, tmp_path / str(devices), devices) for devices in (1, 2))
    for name, points in (("image", 8), ("manifold", 8), ("val_ratio_log", 2)):
        first, second = ([float(row[name]) for row in rows if row[name]] for rows in (one, two))
        assert len(first) == points
        # sums come in another order, and Adam makes much of little where a gradient is next to nothing
        assert second == pytest.approx(first, rel=3e-3), name


def weigh(process: int, processes: int, port: int, answer: Any) -> None:
    """Puts the gradient of a loss of this process's share of four images, averaged over the processes as DDP does."""
    torch.set_num_threads(1)
    gather = None
    if processes > 1:
        torch.distributed.init_process_group("gloo", f"tcp://127.0.0.1:{port}", rank=process, world_size=processes)

        def gather(x: torch.Tensor) -> torch.Tensor:  # what LightningModule.all_gather calls
            return torch.stack(torch.distributed.nn.functional.all_gather(x))

    everything = torch.Generator().manual_seed(1)
    samples = [torch.rand(count, 5, 6, 7, generator=everything) for count in (1, 4, 2, 3)]
    label = torch.rand(4, 3, 6, 7, generator=everything)
    share = slice(process * 4 // processes, (process + 1) * 4 // processes)
    weight = torch.full((3, 5), 0.3, requires_grad=True)
    own = samples[share]
    embedding = torch.einsum("ij,njhw->nihw", weight, torch.cat(own))
    pairs = torch.Generator().manual_seed(2)
    loss = manifold_loss(embedding, label[share], [len(s) for s in own], 500, Draw(pairs, process, processes, gather))
    (loss + embedding.new_tensor(0.1) * weight.square().sum()).backward()
    assert weight.grad is not None
    if processes > 1:
        torch.distributed.all_reduce(weight.grad)
        weight.grad /= processes
    answer.put((process, loss.item(), weight.grad.tolist()))


def gradient(processes: int) -> list[Any]:
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]
    context = multiprocessing.get_context("spawn")
    answer = context.Queue()
    running = [context.Process(target=weigh, args=(n, processes, port, answer)) for n in range(processes)]
    for process in running:
        process.start()
    results = [answer.get(timeout=120) for _ in running]
    for process in running:
        process.join()
    return sorted(results)


def test_the_manifold_loss_is_of_the_whole_batch_and_weighs_the_same() -> None:
    ((_, loss, whole),) = gradient(1)
    shares = gradient(2)
    assert [number for number, *_ in shares] == [0, 1]
    for _, value, shared in shares:
        assert value == pytest.approx(loss, rel=1e-5)
        torch.testing.assert_close(torch.tensor(shared), torch.tensor(whole), rtol=1e-4, atol=1e-6)
