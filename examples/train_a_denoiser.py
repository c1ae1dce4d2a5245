"""Train a small denoiser on 200 crops of simulated raws, in about a minute on two cores.

Needs PyTorch: pip install '.[train]' in the checkout. It leaves denoised.png: raw, denoised, clean.
"""

import numpy as np
import torch
from PIL import Image
from torch.utils.data import DataLoader, IterableDataset

import gpusim as gs

IterableDataset.register(gs.Dataset)  # PyTorch now takes a sweep's data set for one of its own

CROP, CROPS, EPOCHS = 64, 10, 30


def sweep_of(seeds: list[int]) -> gs.Sweep:
    """Dead leaves before a lens, in the dark: read-out noise and shot noise of an IMX477."""
    return gs.Sweep(
        camera="mtf-only",
        scenes=["dead-leaves"],
        axes={"seed": {"range": seeds}, "exposure_s": [0.002]},
        tolerance=1e-2,
        probes=16,
        crops={"rows": CROP, "cols": CROP, "count": CROPS},
    )


def four_planes(mosaic: torch.Tensor) -> torch.Tensor:
    """Return the colours of a Bayer mosaic (n, rows, cols) as planes (n, 4, rows/2, cols/2)."""
    return torch.nn.functional.pixel_unshuffle(mosaic[:, None], 2)


def network() -> torch.nn.Sequential:
    """Return five layers of 32 planes: they find the noise."""
    layers = [torch.nn.Conv2d(4, 32, 3, padding=1), torch.nn.ReLU()]
    for _ in range(3):
        layers += [torch.nn.Conv2d(32, 32, 3, padding=1), torch.nn.ReLU()]
    return torch.nn.Sequential(*layers, torch.nn.Conv2d(32, 4, 3, padding=1))


def main() -> None:
    """Train on twenty frames, judge on two others."""
    torch.manual_seed(0)
    loaded = {
        name: [
            (four_planes(batch.raw), four_planes(batch.clean))
            # A process of its own renders ahead.
            for batch in DataLoader(
                sweep_of(seeds).dataset(),
                batch_size=CROPS,
                num_workers=1,
                multiprocessing_context="spawn",
            )
        ]
        for name, seeds in (("train", [0, 20]), ("judge", [100, 102]))
    }
    # The frame's own scale: noise is trained in units of its spread over all crops.
    raw = torch.cat([noisy for noisy, _ in loaded["train"]])
    mean, spread = raw.mean(), raw.std()
    net = network()
    optimiser = torch.optim.Adam(net.parameters(), 2e-3)
    for epoch in range(EPOCHS):
        for at in torch.randperm(len(loaded["train"])).tolist():
            noisy, clean = loaded["train"][at]
            seen = (noisy - mean) / spread
            loss = torch.mean((seen - net(seen) - (clean - mean) / spread) ** 2)
            optimiser.zero_grad()
            loss.backward()
            optimiser.step()
        if epoch % 10 == 9:
            print(f"epoch {epoch + 1}: RMS {float(loss.detach() ** 0.5 * spread):.2f} DN")
    with torch.no_grad():
        noisy, clean = (torch.cat(one) for one in zip(*loaded["judge"], strict=True))
        seen = (noisy - mean) / spread
        denoised = (seen - net(seen)) * spread + mean
    for name, planes in (("raw", noisy), ("denoised", denoised)):
        print(
            f"{name}: RMS {float(torch.mean((planes - clean) ** 2) ** 0.5):.2f} DN from the truth"
        )
    strips = [torch.cat(list(one[:4, 1]), dim=1).numpy() for one in (noisy, denoised, clean)]
    low, high = np.percentile(strips[2], (1, 99))
    picture = np.clip((np.concatenate(strips) - low) / (high - low), 0, 1)
    Image.fromarray((255 * picture).astype(np.uint8)).resize((512, 384), 0).save("denoised.png")


if __name__ == "__main__":
    main()
