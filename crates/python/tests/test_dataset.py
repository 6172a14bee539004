import multiprocessing
import pickle
import sys

import numpy as np
import pytest

import srflow


def test_pairs_are_arrays(shapes):
    dataset = srflow.Dataset(f"chairs:{shapes}", split="all")
    assert len(dataset) == 4 == len(set(dataset.ids))
    for pair, name in zip(dataset, dataset.ids, strict=True):
        assert pair["id"] == name
        assert pair["frame1"].dtype == np.uint8 and pair["frame1"].shape == pair["frame2"].shape == (64, 96, 3)
        assert pair["flow"].dtype == np.float32 and pair["flow"].shape == (64, 96, 2)
        assert pair["valid"].dtype == bool and np.array_equal(pair["valid"], ~np.isnan(pair["flow"]).any(-1))
    assert np.array_equal(dataset[-1]["frame1"], dataset[3]["frame1"])
    with pytest.raises(IndexError, match="pair 4 of 4"):
        dataset[4]
    with pytest.raises(IndexError):
        dataset[-5]


def test_what_cannot_be_opened_is_an_error_of_its_kind(tmp_path, shapes):
    with pytest.raises(ValueError, match="expected KIND:DIR"):
        srflow.Dataset(str(shapes))
    with pytest.raises(ValueError, match="split: "):
        srflow.Dataset(f"chairs:{shapes}", split="half")
    with pytest.raises(FileNotFoundError):
        srflow.Dataset(f"sintel-clean:{tmp_path / 'nowhere'}")


def first_number(dataset, index):
    # Uses threads too, of which a forked process has none of its parent's.
    flow = srflow.flow(dataset[index]["frame1"], dataset[index]["frame2"], "farneback")
    return float(flow.sum())


@pytest.mark.parametrize("start", [x for x in ("fork", "spawn") if x in multiprocessing.get_all_start_methods()])
def test_other_processes_read_the_same_pairs(shapes, start):
    dataset = srflow.Dataset(f"chairs:{shapes}", split="all")
    here = [first_number(dataset, i) for i in range(4)]
    with multiprocessing.get_context(start).Pool(2) as pool:
        there = pool.starmap_async(first_number, [(dataset, i) for i in range(4)]).get(timeout=120)
    assert there == here
    assert pickle.loads(pickle.dumps(dataset)).ids == dataset.ids


@pytest.mark.parametrize("start", ["fork", "spawn"])
def test_a_data_loader_of_pytorch_takes_it(shapes, start):
    torch = pytest.importorskip("torch", reason="pytorch: not installed")
    if sys.platform == "win32" and start == "fork":
        pytest.skip("fork: Windows has none")
    dataset = srflow.Dataset(f"chairs:{shapes}", split="all")
    loader = torch.utils.data.DataLoader(dataset, batch_size=2, num_workers=2, multiprocessing_context=start, timeout=120)
    batches = list(loader)
    assert [list(batch["frame1"].shape) for batch in batches] == [[2, 64, 96, 3]] * 2
    assert torch.equal(batches[0]["flow"][0], torch.from_numpy(dataset[0]["flow"]))
