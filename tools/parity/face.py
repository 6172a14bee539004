"""Golden values for srflow_face, from LiteRT (TensorFlow Lite) and MediaPipe.

    pip install ai-edge-litert==2.3.0
    python tools/parity/face.py fixture crates/face/tests/golden

writes a small made-up network with every operation of MediaPipe's networks for faces, at odd sizes (`operations.tflite`), and what
LiteRT's interpreter computes with it for a made-up picture (`operations.safetensors`).

    pip install mediapipe==0.10.21
    python tools/parity/face.py compare LANDMARKS.csv PICTURE...

prints how far the 68 points that srflow found in pictures (`srflow flow PICTURE PICTURE --face detect`) are from those of MediaPipe's own
FaceMesh, in pixels.
"""

import sys
from pathlib import Path

import numpy as np
from golden import name_hash, noise, write_safetensors

HEIGHT, WIDTH = 13, 18


def numbers(name, shape):
    return noise(int(np.prod(shape)), name_hash(name)).reshape(shape)


def fixture(folder):
    from ai_edge_litert import schema_py_generated as schema
    from ai_edge_litert.interpreter import Interpreter, OpResolverType

    kinds = schema.BuiltinOperator
    tensors, buffers, operators, codes = [], [schema.BufferT()], [], []

    def tensor(name, shape, kind=schema.TensorType.FLOAT32, data=None):
        made = schema.TensorT()
        made.name, made.shape, made.type, made.buffer = name, list(shape), kind, 0
        if data is not None:
            buffer = schema.BufferT()
            buffer.data = np.frombuffer(data.tobytes(), np.uint8)
            made.buffer = len(buffers)
            buffers.append(buffer)
        tensors.append(made)
        return len(tensors) - 1

    def operation(kind, inputs, shape, options=None, name=""):
        if kind not in codes:
            codes.append(kind)
        made = schema.OperatorT()
        made.opcodeIndex, made.inputs = codes.index(kind), list(inputs)
        made.outputs = [tensor(name, shape)]
        if options is not None:
            made.builtinOptions = options
            made.builtinOptionsType = getattr(schema.BuiltinOptions, type(options).__name__[:-1])
        operators.append(made)
        return made.outputs[0]

    def weights(name, shape, scale):
        values = (numbers(name, shape) * scale).astype(np.float16)
        half = tensor(name, shape, schema.TensorType.FLOAT16, values)
        return operation(kinds.DEQUANTIZE, [half], shape, schema.DequantizeOptionsT(), name)

    def whole(name, values):
        values = np.array(values, np.int32)
        return tensor(name, values.shape, schema.TensorType.INT32, values)

    def options(kind, **fields):
        made = kind()
        for name, value in fields.items():
            assert hasattr(made, name), name
            setattr(made, name, value)
        return made

    def convolution(x, shape, name, kernel, inputs, outputs, stride, padding):
        taps = kernel * kernel * inputs
        weight = weights(f"{name}.weight", [outputs, kernel, kernel, inputs], taps**-0.5)
        made = options(schema.Conv2DOptionsT, strideW=stride, strideH=stride, padding=padding)
        return operation(kinds.CONV_2D, [x, weight, weights(f"{name}.bias", [outputs], 0.1)], shape, made, name)

    def depthwise(x, shape, name, channels, stride):
        weight = weights(f"{name}.weight", [1, 3, 3, channels], 0.5)
        made = options(
            schema.DepthwiseConv2DOptionsT, strideW=stride, strideH=stride, depthMultiplier=1, padding=SAME
        )
        bias = weights(f"{name}.bias", [channels], 0.1)
        return operation(kinds.DEPTHWISE_CONV_2D, [x, weight, bias], shape, made, name)

    SAME, VALID = schema.Padding.SAME, schema.Padding.VALID
    picture = tensor("picture", [1, HEIGHT, WIDTH, 3])
    x = convolution(picture, [1, 7, 9, 6], "enter", 3, 3, 6, 2, SAME)
    x = operation(kinds.PRELU, [x, weights("slopes", [1, 1, 6], 0.5)], [1, 7, 9, 6])
    half = options(schema.Pool2DOptionsT, strideW=2, strideH=2, filterWidth=2, filterHeight=2, padding=SAME)
    pooled = operation(kinds.MAX_POOL_2D, [x], [1, 4, 5, 6], half)
    wide = operation(kinds.PAD, [pooled, whole("zeros", [[0, 0], [0, 0], [0, 0], [0, 2]])], [1, 4, 5, 8])
    y = depthwise(x, [1, 4, 5, 6], "down", 6, 2)
    y = convolution(y, [1, 4, 5, 8], "mix", 1, 6, 8, 1, VALID)
    x = operation(kinds.RELU, [operation(kinds.ADD, [wide, y], [1, 4, 5, 8], schema.AddOptionsT())], [1, 4, 5, 8])
    x = depthwise(x, [1, 4, 5, 8], "same", 8, 1)
    fine = convolution(x, [1, 4, 5, 4], "fine", 1, 8, 4, 1, SAME)
    inside = options(schema.Pool2DOptionsT, strideW=2, strideH=2, filterWidth=3, filterHeight=2, padding=VALID)
    small = operation(kinds.MAX_POOL_2D, [x], [1, 2, 2, 8], inside)
    coarse = convolution(small, [1, 2, 2, 6], "coarse", 5, 8, 6, 1, SAME)
    # The shape is an input in new files, an option in old ones.
    rows = [
        operation(kinds.RESHAPE, [fine, whole("rows", [1, 40, 2])], [1, 40, 2], schema.ReshapeOptionsT()),
        operation(kinds.RESHAPE, [coarse], [1, 12, 2], options(schema.ReshapeOptionsT, newShape=[1, 12, 2])),
    ]
    joined = operation(kinds.CONCATENATION, rows, [1, 52, 2], options(schema.ConcatenationOptionsT, axis=1))
    last = convolution(x, [1, 1, 1, 10], "last", 4, 8, 10, 3, VALID)

    graph = schema.SubGraphT()
    graph.tensors, graph.operators = tensors, operators
    graph.inputs, graph.outputs = [picture], [joined, last]
    model = schema.ModelT()
    model.version, model.subgraphs, model.buffers, model.operatorCodes = 3, [graph], buffers, []
    for kind in codes:
        code = schema.OperatorCodeT()
        code.builtinCode = code.deprecatedBuiltinCode = kind
        code.version = 3 if kind == kinds.DEQUANTIZE else 1
        model.operatorCodes.append(code)
    import flatbuffers

    builder = flatbuffers.Builder(1 << 16)
    builder.Finish(model.Pack(builder), b"TFL3")
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "operations.tflite").write_bytes(bytes(builder.Output()))

    # The plain kernels: the optimized ones reorder sums.
    reference = OpResolverType.BUILTIN_REF
    interpreter = Interpreter(str(folder / "operations.tflite"), experimental_op_resolver_type=reference)
    interpreter.allocate_tensors()
    interpreter.set_tensor(interpreter.get_input_details()[0]["index"], numbers("picture", [1, HEIGHT, WIDTH, 3]))
    interpreter.invoke()
    found = [interpreter.get_tensor(output["index"]) for output in interpreter.get_output_details()]
    for output in found:
        print(output.shape, output.reshape(-1)[:3])
    golden = {"rows": found[0].reshape(-1), "last": found[1].reshape(-1)}
    write_safetensors(folder / "operations.safetensors", golden)


def compare(landmarks, pictures):
    import csv

    import cv2
    import mediapipe

    # dlib's points, of crates/core/src/landmarks.rs
    text = (Path(__file__).parents[2] / "crates/core/src/landmarks.rs").read_text()
    table = text.split("MEDIAPIPE_OF_DLIB: [usize; 68] = [")[1].split("];")[0]
    nearest = [int(number) for line in table.splitlines() for number in line.split("//")[0].split(",") if number.strip()]
    for row, picture in zip(csv.DictReader(open(landmarks)), pictures, strict=True):
        frame = cv2.cvtColor(cv2.imread(str(picture)), cv2.COLOR_BGR2RGB)
        with mediapipe.solutions.face_mesh.FaceMesh(static_image_mode=True, max_num_faces=1) as mesh:
            face = mesh.process(frame).multi_face_landmarks[0].landmark
        size = np.array(frame.shape[1::-1])
        theirs = np.array([[face[point].x, face[point].y] for point in nearest]) * size - 0.5
        ours = np.array([[float(row[f"x_{n}"]), float(row[f"y_{n}"])] for n in range(68)])
        distance = np.linalg.norm(ours - theirs, axis=1)
        print(f"{picture}: mean {distance.mean():.3f} px, largest {distance.max():.3f} px")


if __name__ == "__main__":
    match sys.argv[1:]:
        case ["fixture", folder]:
            fixture(Path(folder))
        case ["compare", landmarks, *pictures]:
            compare(landmarks, pictures)
        case _:
            sys.exit(__doc__)
