"""Reads a dataset of `srflow pack` as users of webdataset, datasets, mlcroissant and tarfile do.

    python read_packed.py FOLDER SPLIT

FOLDER is packed with --flow npy. Every reader must give the same samples, with the content that `index.jsonl` states.
"""

import hashlib
import io
import json
import sys
import tarfile
from pathlib import Path

import datasets
import mlcroissant
import numpy as np
import webdataset


def index(folder, split):
    lines = [json.loads(line) for line in (folder / "index.jsonl").read_text().splitlines()]
    return [line for line in lines if line["split"] == split]


def check_tars(folder, records):
    """The headers as Python reads them, and the members where the index says that they are."""
    for name in sorted({record["tar"] for record in records}):
        with tarfile.open(folder / name) as tar:
            members = {member.name: member for member in tar.getmembers()}
        assert list(members) == sorted(members), name
        for member in members.values():
            assert (member.isreg(), member.mtime, member.uid, member.gid, member.mode) == (True, 0, 0, 0, 0o644)
        stated = [record for record in records if record["tar"] == name]
        assert len(members) == sum(len(record["members"]) for record in stated)
        content = (folder / name).read_bytes()
        for record in stated:
            for ending, member in record["members"].items():
                header = members[f"{record['key']}.{ending}"]
                assert (header.offset_data, header.size) == (member["offset"], member["size"])
                part = content[member["offset"] : member["offset"] + member["size"]]
                assert hashlib.sha256(part).hexdigest() == member["sha256"]


def check_webdataset(folder, records):
    tars = [str(folder / name) for name in sorted({record["tar"] for record in records})]
    samples = list(webdataset.WebDataset(tars, shardshuffle=False).decode("rgb8"))
    assert [sample["__key__"] for sample in samples] == [record["key"] for record in records]
    for sample, record in zip(samples, records):
        assert set(record["members"]) == {key for key in sample if not key.startswith("__")}
        height, width, _ = sample["frame1.png"].shape
        flow = sample["flow.npy"]
        assert (flow.shape, flow.dtype) == ((height, width, 2), np.float16)
        assert sample["frame1.png"].dtype == np.uint8
        assert sample["meta.json"]["flow"]["pixels"] == record["flow"]["pixels"]
        head = sample["mask.png"][..., 0] > 127
        lengths = np.hypot(*np.moveaxis(flow.astype(np.float64), -1, 0))[head]
        assert head.sum() == record["flow"]["pixels"]
        assert abs(lengths.max() - record["flow"]["max"]) < 0.01
        assert abs(lengths.sum() - record["flow"]["sum"]) < 0.01 * head.sum()
    return samples


def check_datasets(folder, records, samples):
    """Split names come from the dataset card, as on the Hub."""
    name = {"val": "validation"}.get(records[0]["split"], records[0]["split"])
    dataset = datasets.load_dataset(str(folder), split=name, streaming=True)
    found = list(dataset)
    assert [sample["__key__"] for sample in found] == [record["key"] for record in records]
    for own, other in zip(found, samples):
        assert np.array_equal(np.asarray(own["frame1.png"].convert("RGB")), other["frame1.png"])
        assert np.array_equal(np.asarray(own["flow.npy"]), other["flow.npy"])
        assert own["meta.json"]["frame1"]["frame"] == other["meta.json"]["frame1"]["frame"]


def check_croissant(folder, records, samples):
    dataset = mlcroissant.Dataset(jsonld=str(folder / "croissant.json"))
    assert not dataset.metadata.issues.errors, dataset.metadata.issues.report()
    listed = [{key.split("/")[-1]: value for key, value in record.items()} for record in dataset.records("index")]
    listed = [record for record in listed if record["split"] in (records[0]["split"], records[0]["split"].encode())]
    assert [text(record["key"]) for record in listed] == [record["key"] for record in records]
    assert [record["offset"] for record in listed] == [record["offset"] for record in records]
    content = {
        name: {text(record[f"{name}/key"]): record[f"{name}/content"] for record in dataset.records(name)}
        for name in ["frame1", "flow", "meta"]
    }
    for sample in samples:
        frame1, flow, meta = (content[name][sample["__key__"]] for name in ["frame1", "flow", "meta"])
        assert np.array_equal(np.asarray(frame1.convert("RGB")), sample["frame1.png"])
        assert np.array_equal(np.load(io.BytesIO(flow)), sample["flow.npy"])
        assert json.loads(meta) == sample["meta.json"]


def text(value):
    return value.decode() if isinstance(value, bytes) else value


def main():
    folder, split = Path(sys.argv[1]).resolve(), sys.argv[2]
    records = index(folder, split)
    check_tars(folder, records)
    samples = check_webdataset(folder, records)
    check_datasets(folder, records, samples)
    check_croissant(folder, records, samples)
    print(f"{len(samples)} samples read by tarfile, webdataset, datasets and mlcroissant")


if __name__ == "__main__":
    main()
