"""Runs files of ONNX by onnxruntime, and prints how far the outputs are from given ones.

Arguments, for each case: a file, a folder with a file of little-endian f32 per input and expected output, and the size of the frames,
WIDTHxHEIGHT. Prints `NETWORK SIZE-OF-THE-FILE SIZE OUTPUT DIFFERENCE` for each output that has a file.
"""

import sys
from pathlib import Path

import numpy
import onnx
import onnxruntime


def read(folder, name, size):
    width, height = map(int, size.split("x"))
    return numpy.fromfile(folder / name, "<f4").reshape(1, -1, height, width)


def network(path):
    model = onnx.load(path)
    onnx.checker.check_model(model, full_check=True)
    metadata = {entry.key: entry.value for entry in model.metadata_props}
    assert {"program", "version", "network", "iterations", "size", "licence"} <= set(metadata), metadata
    return f"{metadata['network']} {metadata['size']}"


def session(path):
    options = onnxruntime.SessionOptions()
    options.intra_op_num_threads = 2
    return onnxruntime.InferenceSession(path, options, providers=["CPUExecutionProvider"])


def main(arguments):
    sessions = {}
    for path, folder, size in zip(arguments[::3], arguments[1::3], arguments[2::3]):
        if path not in sessions:
            sessions[path] = network(path), session(path)
        name, run = sessions[path]
        folder = Path(folder)
        given = {value.name: read(folder, value.name, size) for value in run.get_inputs()}
        outputs = [value.name for value in run.get_outputs()]
        for output, found in zip(outputs, run.run(outputs, given)):
            assert found.dtype == numpy.float32 and found.shape[2:] == given["frame1"].shape[2:], found.shape
            if (folder / output).exists():
                expected = read(folder, output, size)
                assert found.shape == expected.shape, (output, found.shape, expected.shape)
                print(name, size, output, numpy.abs(found - expected).max())


main(sys.argv[1:])
