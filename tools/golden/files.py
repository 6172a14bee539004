#!/usr/bin/env python3
"""Golden data of srflow-files: files other programs wrote, and numbers other programs computed.

Writes crates/files/tests/data/. Needs numpy, torch, torchmetrics, h5py, opencv-python, flow_vis, and ptlflow 0.4.2
unpacked (pip download ptlflow==0.4.2 --no-deps; its file ptlflow/utils/flow_metrics.py is loaded alone):

    tools/golden/files.py PTLFLOW_DIR

Made with numpy 2.4.6, torch 2.11.0, torchmetrics 1.9.0, h5py 3.16.0, OpenCV 4.13.0, flow_vis 0.1.
"""

import importlib.util
import json
import sys
from pathlib import Path

import cv2
import flow_vis
import h5py
import numpy as np
import torch

DATA = Path(__file__).resolve().parents[2] / "crates/files/tests/data"


def flow(seed, height, width, scale=4.0):
    """Smooth motion plus noise, on a grid of 1/64 px so that every format holds it."""
    random = np.random.default_rng(seed)
    y, x = np.mgrid[0:height, 0:width].astype(np.float64)
    u = scale * np.sin(0.31 * x + 0.17 * y + seed) + random.normal(0, 0.4, (height, width))
    v = scale * np.cos(0.23 * x - 0.29 * y) + random.normal(0, 0.4, (height, width))
    return (np.round(np.stack([u, v], -1) * 64) / 64).astype(np.float32)


def interoperability():
    """One flow with two unknown pixels, as each program writes it."""
    known = flow(0, 9, 13)
    unknown = np.zeros((9, 13), bool)
    unknown[2, 5] = unknown[8, 12] = True
    with_nan = known.copy()
    with_nan[unknown] = np.nan

    np.save(DATA / "flow.npy", with_nan)
    np.save(DATA / "flow_fortran.npy", np.asfortranarray(with_nan))
    np.save(DATA / "flow_f16.npy", with_nan.astype(np.float16))
    np.save(DATA / "flow_f64_big_endian.npy", with_nan.astype(">f8"))
    np.savez(DATA / "flow.npz", flow=with_nan)
    np.savez_compressed(DATA / "flow_compressed.npz", anything=with_nan)

    cv2.writeOpticalFlow(str(DATA / "flow_opencv.flo"), np.where(unknown[..., None], np.float32(1e10), with_nan))
    kitti = np.zeros((9, 13, 3), np.uint16)  # OpenCV writes BGR: blue is the validity
    kitti[..., 2] = np.where(unknown, 0, known[..., 0] * 64 + 32768)
    kitti[..., 1] = np.where(unknown, 0, known[..., 1] * 64 + 32768)
    kitti[..., 0] = ~unknown
    cv2.imwrite(str(DATA / "flow_kitti.png"), kitti)
    pfm = np.dstack([unknown.astype(np.float32), known[..., 1], known[..., 0]])
    cv2.imwrite(str(DATA / "flow.pfm"), np.ascontiguousarray(pfm))

    # As Spring's files: gzip 5, chunks chosen by h5py (flow_IO.py of the Spring devkit).
    with h5py.File(DATA / "spring.flo5", "w") as file:
        file.create_dataset("flow", data=with_nan, compression="gzip", compression_opts=5)
    with h5py.File(DATA / "shuffled.flo5", "w") as file:
        file.create_dataset(
            "flow", data=with_nan, chunks=(4, 5, 1), compression="gzip", shuffle=True, fletcher32=True
        )
        file.create_dataset("another", data=np.arange(7))
        file.attrs["note"] = "attributes are passed over"
    with h5py.File(DATA / "contiguous_f16.flo5", "w") as file:
        file.create_dataset("flow", data=with_nan.astype(np.float16))
    many = np.round(flow(1, 30, 40) * 4) / 4
    np.save(DATA / "many_chunks.npy", many.astype(np.float16))
    with h5py.File(DATA / "many_chunks.flo5", "w") as file:
        file.create_dataset("flow", data=many, chunks=(3, 4, 2), compression="gzip")
    with h5py.File(DATA / "many_chunks_latest.flo5", "w", libver="latest") as file:
        file.create_dataset("flow", data=many, chunks=(3, 4, 2), compression="gzip")
    with h5py.File(DATA / "latest.flo5", "w", libver="latest") as file:
        file.create_dataset("flow", data=with_nan, compression="gzip", compression_opts=5)


def metrics(ptlflow):
    source = ptlflow / "ptlflow/utils/flow_metrics.py"
    spec = importlib.util.spec_from_file_location("flow_metrics", source)
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)

    images = []
    for index, (height, width) in enumerate([(14, 20), (11, 17), (8, 24)]):
        truth = flow(10 + index, height, width, scale=[3.0, 40.0, 200.0][index])
        random = np.random.default_rng(index)
        error = random.normal(0, 1, (height, width, 2)) * random.choice([0.02, 0.3, 2.0, 9.0], (height, width, 1))
        prediction = (truth + np.round(error * 64) / 64).astype(np.float32)
        if index == 0:  # errors on the thresholds themselves
            prediction[0] = truth[0]
            prediction[0, :, 0] += np.arange(20, dtype=np.float32) * np.float32(0.25)
            prediction[1, :4, 1] = truth[1, :4, 1] + np.array([1, 3, 5, 0.05], np.float32)
            prediction[1, :4, 0] = truth[1, :4, 0]
        if index == 1:
            truth[random.random((height, width)) < 0.3] = np.nan
        if index == 2:
            truth[3, 4] = [10000, 0]  # not under max_flow, so not valid
            truth[3, 5] = [0, -12000]
        mask = random.random((height, width)) < 0.6
        images.append((prediction, truth, mask))
        np.save(DATA / f"prediction{index}.npy", prediction)
        np.save(DATA / f"truth{index}.npy", truth)
        cv2.imwrite(str(DATA / f"mask{index}.png"), mask.astype(np.uint8) * 255)

    def score(images, masked):
        handler = module.FlowMetrics()
        pixels = 0
        for prediction, truth, mask in images:
            # _get_flows_and_valids of ptlflow/data/datasets.py
            valid = np.isfinite(truth).all(-1) & (np.abs(truth) < 10000).all(-1)
            if masked:
                valid &= mask
            truth = np.where(valid[..., None], truth, 0)
            pixels += int(valid.sum())
            batch = lambda array: torch.from_numpy(array.astype(np.float32)).permute(2, 0, 1)[None]
            handler.update({"flows": batch(prediction)}, {"flows": batch(truth), "valids": batch(valid[..., None])})
        result = {key: float(value) for key, value in handler.compute().items()}
        result["f1_all"] = result.pop("flall")
        result["valid_pixels"] = pixels
        return result

    golden = {
        "whole": [score([image], False) for image in images],
        "masked": [score([image], True) for image in images],
        "mean": score(images, False),
        "mean_masked": score(images, True),
    }
    (DATA / "metrics.json").write_text(json.dumps(golden, indent=1) + "\n")


def colors():
    """Every direction and length: a disc of flow, drawn by flow_vis."""
    y, x = np.mgrid[-12:13, -12:13].astype(np.float32)
    disc = np.stack([x, y], -1) * np.float32(0.37)
    np.save(DATA / "disc.npy", disc.astype(np.float32))
    drawn = flow_vis.flow_to_color(disc, convert_to_bgr=True)
    cv2.imwrite(str(DATA / "disc_flow_vis.png"), drawn)
    beyond = flow_vis.flow_uv_to_colors(*np.moveaxis(disc / np.float32(2.5 + 1e-5), -1, 0), convert_to_bgr=True)
    cv2.imwrite(str(DATA / "disc_flow_vis_max2.5.png"), beyond)


def images():
    """One small picture in every kind of file that is read; it is [25 x, 36 y, 3 x y] (uint8)."""
    y, x = np.mgrid[0:7, 0:10]
    rgb = np.stack([25 * x, 36 * y, 3 * x * y], -1).astype(np.uint8)
    bgr = np.ascontiguousarray(rgb[..., ::-1])
    for name in ["image.ppm", "image.bmp", "image.png", "image.tif"]:
        cv2.imwrite(str(DATA / name), bgr)
    cv2.imwrite(str(DATA / "image_16bit.png"), bgr.astype(np.uint16) * 257)
    cv2.imwrite(str(DATA / "image_16bit.tif"), bgr.astype(np.uint16) * 257)
    cv2.imwrite(str(DATA / "image.webp"), bgr, [cv2.IMWRITE_WEBP_QUALITY, 101])  # over 100: lossless
    cv2.imwritemulti(str(DATA / "two_images.tif"), [bgr, bgr])
    cv2.imwrite(str(DATA / "image_alpha.png"), np.dstack([bgr, (255 - 25 * x).astype(np.uint8)]))
    cv2.imwrite(str(DATA / "image_grey.png"), rgb[..., 0])
    cv2.imwrite(str(DATA / "image.jpg"), bgr, [cv2.IMWRITE_JPEG_QUALITY, 95])
    cv2.imwrite(str(DATA / "image_progressive.jpg"), bgr, [cv2.IMWRITE_JPEG_PROGRESSIVE, 1])
    for name in ["image", "image_progressive"]:
        cv2.imwrite(str(DATA / f"{name}_jpg_decoded.png"), cv2.imread(str(DATA / f"{name}.jpg")))


if __name__ == "__main__":
    if len(sys.argv) != 2:
        sys.exit(__doc__)
    DATA.mkdir(parents=True, exist_ok=True)
    interoperability()
    metrics(Path(sys.argv[1]))
    colors()
    images()
