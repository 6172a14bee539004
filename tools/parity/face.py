"""Golden values for srflow_face, from LiteRT (TensorFlow Lite) and MediaPipe.

    pip install ai-edge-litert==2.3.0
    python tools/parity/face.py fixture crates/face/tests/golden

writes small made-up networks with every operation of MediaPipe's networks for faces (`operations.tflite`), for persons
(`person_operations.tflite`) and for blend shapes (`shape_operations.tflite`), at odd sizes, and what LiteRT's interpreter computes
with them for a made-up picture (`.safetensors` of the same names).

    pip install mediapipe==0.10.21
    python tools/parity/face.py person crates/face/tests/golden

writes every fourth pixel of the mask that MediaPipe's SelfieSegmentation gives for a drawn person (`person_mask.safetensors`).

    python tools/parity/face.py compare LANDMARKS.csv PICTURE...

prints how far the 68 points that srflow found in pictures (`srflow flow PICTURE PICTURE --face detect`) are from those of MediaPipe's own
FaceMesh, in pixels.

    python tools/parity/face.py landmarker face_landmarker.task FACE.csv PICTURE...

prints how far the points and blend shapes that srflow found in pictures (`srflow face PICTURE... -o FACE.csv --points mesh
--blendshapes --face-models face_landmarker.task`) are from those of MediaPipe's own face landmarker.
"""

import struct
import sys
from pathlib import Path

import numpy as np
from golden import name_hash, noise, write_safetensors

HEIGHT, WIDTH = 13, 18


def numbers(name, shape):
    return noise(int(np.prod(shape)), name_hash(name)).reshape(shape)


class Graph:
    """A network that is being made, with one input, a picture."""

    def __init__(self):
        from ai_edge_litert import schema_py_generated as schema

        self.schema, self.kinds = schema, schema.BuiltinOperator
        self.SAME, self.VALID = schema.Padding.SAME, schema.Padding.VALID
        self.tensors, self.buffers, self.operators, self.codes = [], [schema.BufferT()], [], []
        self.picture = self.tensor("picture", [1, HEIGHT, WIDTH, 3])

    def tensor(self, name, shape, kind=0, data=None):
        made = self.schema.TensorT()
        made.name, made.shape, made.type, made.buffer = name, list(shape), kind, 0
        if data is not None:
            buffer = self.schema.BufferT()
            buffer.data = np.frombuffer(data.tobytes(), np.uint8)
            made.buffer = len(self.buffers)
            self.buffers.append(buffer)
        self.tensors.append(made)
        return len(self.tensors) - 1

    def operation(self, kind, inputs, shape, options=None, name="", custom=None):
        """`custom`: name and options of an operation that is not TensorFlow's."""
        code = (kind, custom and custom[0])
        if code not in self.codes:
            self.codes.append(code)
        made = self.schema.OperatorT()
        made.opcodeIndex, made.inputs = self.codes.index(code), list(inputs)
        made.outputs = [self.tensor(name, shape)]
        if options is not None:
            made.builtinOptions = options
            made.builtinOptionsType = getattr(self.schema.BuiltinOptions, type(options).__name__[:-1])
        if custom is not None:
            made.customOptions = np.frombuffer(custom[1], np.uint8)
        self.operators.append(made)
        return made.outputs[0]

    def options(self, kind, **fields):
        made = getattr(self.schema, kind)()
        for name, value in fields.items():
            assert hasattr(made, name), name
            setattr(made, name, value)
        return made

    def weights(self, name, shape, scale):
        values = (numbers(name, shape) * scale).astype(np.float16)
        half = self.tensor(name, shape, self.schema.TensorType.FLOAT16, values)
        return self.operation(self.kinds.DEQUANTIZE, [half], shape, self.schema.DequantizeOptionsT(), name)

    def whole(self, name, values):
        values = np.array(values, np.int32)
        return self.tensor(name, values.shape, self.schema.TensorType.INT32, values)

    def convolution(self, x, shape, name, kernel, inputs, outputs, stride, padding, gain=1, activation=0):
        scale = gain * (kernel * kernel * inputs) ** -0.5
        weight = self.weights(f"{name}.weight", [outputs, kernel, kernel, inputs], scale)
        made = self.options(
            "Conv2DOptionsT", strideW=stride, strideH=stride, padding=padding, fusedActivationFunction=activation
        )
        bias = self.weights(f"{name}.bias", [outputs], 0.1)
        return self.operation(self.kinds.CONV_2D, [x, weight, bias], shape, made, name)

    def depthwise(self, x, shape, name, channels, stride):
        weight = self.weights(f"{name}.weight", [1, 3, 3, channels], 0.5)
        made = self.options(
            "DepthwiseConv2DOptionsT", strideW=stride, strideH=stride, depthMultiplier=1, padding=self.SAME
        )
        bias = self.weights(f"{name}.bias", [channels], 0.1)
        return self.operation(self.kinds.DEPTHWISE_CONV_2D, [x, weight, bias], shape, made, name)

    def window(self, height, width, stride, padding):
        return self.options(
            "Pool2DOptionsT", strideW=stride, strideH=stride, filterWidth=width, filterHeight=height, padding=padding
        )

    def pack(self, outputs):
        """The file."""
        import flatbuffers

        graph, model = self.schema.SubGraphT(), self.schema.ModelT()
        graph.tensors, graph.operators = self.tensors, self.operators
        graph.inputs, graph.outputs = [self.picture], outputs
        model.version, model.subgraphs, model.buffers, model.operatorCodes = 3, [graph], self.buffers, []
        for kind, custom in self.codes:
            code = self.schema.OperatorCodeT()
            code.builtinCode = code.deprecatedBuiltinCode = kind
            code.version = 3 if kind in (self.kinds.DEQUANTIZE, self.kinds.TRANSPOSE_CONV) else 1
            code.customCode = custom
            model.operatorCodes.append(code)
        builder = flatbuffers.Builder(1 << 16)
        builder.Finish(model.Pack(builder), b"TFL3")
        return bytes(builder.Output())


def computed(network):
    """The outputs for the picture."""
    from ai_edge_litert.interpreter import Interpreter, OpResolverType

    # The plain kernels: the optimized ones reorder sums.
    reference = OpResolverType.BUILTIN_REF
    interpreter = Interpreter(model_content=network, experimental_op_resolver_type=reference)
    interpreter.allocate_tensors()
    interpreter.set_tensor(interpreter.get_input_details()[0]["index"], numbers("picture", [1, HEIGHT, WIDTH, 3]))
    interpreter.invoke()
    found = [interpreter.get_tensor(output["index"]) for output in interpreter.get_output_details()]
    for output in found:
        print(output.shape, output.reshape(-1)[:3])
    return [output.reshape(-1) for output in found]


def faces_network():
    g = Graph()
    kinds, SAME, VALID = g.kinds, g.SAME, g.VALID
    x = g.convolution(g.picture, [1, 7, 9, 6], "enter", 3, 3, 6, 2, SAME)
    x = g.operation(kinds.PRELU, [x, g.weights("slopes", [1, 1, 6], 0.5)], [1, 7, 9, 6])
    pooled = g.operation(kinds.MAX_POOL_2D, [x], [1, 4, 5, 6], g.window(2, 2, 2, SAME))
    wide = g.operation(kinds.PAD, [pooled, g.whole("zeros", [[0, 0], [0, 0], [0, 0], [0, 2]])], [1, 4, 5, 8])
    y = g.depthwise(x, [1, 4, 5, 6], "down", 6, 2)
    y = g.convolution(y, [1, 4, 5, 8], "mix", 1, 6, 8, 1, VALID)
    x = g.operation(kinds.ADD, [wide, y], [1, 4, 5, 8], g.options("AddOptionsT"))
    x = g.operation(kinds.RELU, [x], [1, 4, 5, 8])
    x = g.depthwise(x, [1, 4, 5, 8], "same", 8, 1)
    fine = g.convolution(x, [1, 4, 5, 4], "fine", 1, 8, 4, 1, SAME)
    small = g.operation(kinds.MAX_POOL_2D, [x], [1, 2, 2, 8], g.window(2, 3, 2, VALID))
    coarse = g.convolution(small, [1, 2, 2, 6], "coarse", 5, 8, 6, 1, SAME)
    # The shape is an input in new files, an option in old ones.
    rows = [
        g.operation(kinds.RESHAPE, [fine, g.whole("rows", [1, 40, 2])], [1, 40, 2], g.options("ReshapeOptionsT")),
        g.operation(kinds.RESHAPE, [coarse], [1, 12, 2], g.options("ReshapeOptionsT", newShape=[1, 12, 2])),
    ]
    joined = g.operation(kinds.CONCATENATION, rows, [1, 52, 2], g.options("ConcatenationOptionsT", axis=1))
    last = g.convolution(x, [1, 1, 1, 10], "last", 4, 8, 10, 3, VALID)
    return g.pack([joined, last])


def person_network(custom):
    """With MediaPipe's transposed convolution, or with that of TensorFlow, which computes the same."""
    g = Graph()
    kinds, SAME, VALID = g.kinds, g.SAME, g.VALID

    def resized(x, shape, name, **alignment):
        options = g.options("ResizeBilinearOptionsT", **alignment)
        return g.operation(kinds.RESIZE_BILINEAR, [x, g.whole(name, shape[1:3])], shape, options, name)

    def transposed(x, shape, name, kernel, inputs, stride, padding):
        weight = g.weights(f"{name}.weight", [shape[3], *kernel, inputs], 0.5)
        bias = g.weights(f"{name}.bias", [shape[3]], 0.1)
        if custom:
            # TfLiteTransposeConvParams: TfLitePadding, which counts from 1, then strides across and down.
            fields = struct.pack("<3i", 1 if padding == SAME else 2, stride[1], stride[0])
            made = ("Convolution2DTransposeBias", fields)
            return g.operation(kinds.CUSTOM, [x, weight, bias], shape, None, name, made)
        made = g.options("TransposeConvOptionsT", strideW=stride[1], strideH=stride[0], padding=padding)
        return g.operation(kinds.TRANSPOSE_CONV, [g.whole(name, shape), weight, x, bias], shape, made, name)

    x = g.convolution(g.picture, [1, 7, 9, 6], "enter", 3, 3, 6, 2, SAME, gain=8)
    x = g.operation(kinds.HARD_SWISH, [x], [1, 7, 9, 6], g.options("HardSwishOptionsT"))
    every = g.operation(kinds.AVERAGE_POOL_2D, [x], [1, 1, 1, 6], g.window(7, 9, 9, VALID))
    gate = g.convolution(every, [1, 1, 1, 6], "gate", 1, 6, 6, 1, VALID)
    gate = g.operation(kinds.LOGISTIC, [gate], [1, 1, 1, 6])
    x = g.operation(kinds.MUL, [x, gate], [1, 7, 9, 6], g.options("MulOptionsT"))
    small = g.operation(kinds.AVERAGE_POOL_2D, [x], [1, 4, 5, 6], g.window(3, 4, 2, SAME))
    small = g.operation(kinds.ADD, [gate, small], [1, 4, 5, 6], g.options("AddOptionsT"))
    edges = resized(small, [1, 7, 9, 6], "edges", halfPixelCenters=True)
    corners = resized(small, [1, 7, 9, 6], "corners", alignCorners=True)
    first = resized(x, [1, 3, 14, 6], "first")
    x = g.operation(kinds.MUL, [edges, corners], [1, 7, 9, 6], g.options("MulOptionsT"))
    inside = g.operation(kinds.AVERAGE_POOL_2D, [first], [1, 1, 6, 6], g.window(2, 3, 2, VALID))
    x = g.convolution(x, [1, 7, 9, 4], "wide", 1, 6, 4, 1, SAME)
    double = transposed(x, [1, 13, 17, 2], "double", (2, 2), 4, (2, 2), SAME)
    mask = g.operation(kinds.LOGISTIC, [double], [1, 13, 17, 2])
    # Strides that leave pixels to the bias alone.
    spread = transposed(inside, [1, 3, 17, 3], "spread", (3, 2), 6, (2, 3), VALID)
    near = transposed(x, [1, 7, 9, 2], "near", (3, 3), 4, (1, 1), SAME)
    return g.pack([mask, spread, near])


def shapes_network():
    g = Graph()
    kinds, SAME, VALID = g.kinds, g.SAME, g.VALID
    relu = g.schema.ActivationFunctionType.RELU
    keep = lambda: g.options("ReducerOptionsT", keepDims=True)

    def reduced(kind, x, axes, shape):
        return g.operation(kind, [x, g.whole("axes", axes)], shape, keep())

    def sliced(x, name, begin, end, shape, **masks):
        bounds = [g.whole(f"{name}.{bound}", values) for bound, values in (("begin", begin), ("end", end))]
        strides = g.whole(f"{name}.strides", [1] * len(begin))
        return g.operation(kinds.STRIDED_SLICE, [x, *bounds, strides], shape, g.options("StridedSliceOptionsT", **masks))

    x = g.convolution(g.picture, [1, 7, 9, 6], "enter", 3, 3, 6, 2, SAME, gain=8, activation=relu)
    # Layer normalization.
    mean = reduced(kinds.MEAN, x, [3], [1, 7, 9, 1])
    negative = g.operation(kinds.NEG, [mean], [1, 7, 9, 1], g.options("NegOptionsT"))
    squares = g.operation(kinds.SQUARED_DIFFERENCE, [x, mean], [1, 7, 9, 6], g.options("SquaredDifferenceOptionsT"))
    variance = reduced(kinds.MEAN, squares, [-1], [1, 7, 9, 1])
    variance = g.operation(kinds.ADD, [variance, g.weights("little", [], 0.1)], [1, 7, 9, 1], g.options("AddOptionsT"))
    root = g.operation(kinds.RSQRT, [variance], [1, 7, 9, 1])
    gain = g.operation(kinds.MUL, [root, g.weights("gain", [6], 1)], [1, 7, 9, 6], g.options("MulOptionsT"))
    y = g.operation(kinds.MUL, [x, gain], [1, 7, 9, 6], g.options("MulOptionsT"))
    shift = g.operation(kinds.MUL, [negative, gain], [1, 7, 9, 6], g.options("MulOptionsT"))
    y = g.operation(kinds.ADD, [y, shift], [1, 7, 9, 6], g.options("AddOptionsT"))

    across = g.operation(kinds.TRANSPOSE, [y, g.whole("order", [0, 1, 3, 2])], [1, 7, 6, 9], g.options("TransposeOptionsT"))
    mixed = g.convolution(across, [1, 7, 6, 4], "mix", 1, 9, 4, 1, VALID, activation=relu)

    square = g.operation(kinds.MUL, [y, y], [1, 7, 9, 6], g.options("MulOptionsT"))
    length = g.operation(kinds.SQRT, [reduced(kinds.SUM, square, [1, 2], [1, 1, 1, 6])], [1, 1, 1, 6])
    z = g.operation(kinds.DIV, [y, length], [1, 7, 9, 6], g.options("DivOptionsT"))
    token = g.weights("token", [1, 7, 1, 6], 1)
    z = g.operation(kinds.CONCATENATION, [token, z], [1, 7, 10, 6], g.options("ConcatenationOptionsT", axis=2))
    part = sliced(z, "part", [0, 1, 3, 0], [1, 6, -1, 0], [1, 5, 9, 6], beginMask=0b0101, endMask=0b1000)

    points = g.operation(kinds.RESHAPE, [part, g.whole("points", [1, -1, 6])], [1, 45, 6], g.options("ReshapeOptionsT"))
    middle = reduced(kinds.MEAN, points, [1], [1, 1, 6])
    centred = g.operation(kinds.SUB, [points, middle], [1, 45, 6], g.options("SubOptionsT"))
    row = sliced(centred, "row", [0, 7, 0], [1, 8, 6], [6], shrinkAxisMask=0b011)
    return g.pack([mixed, centred, row])


def fixture(folder):
    folder.mkdir(parents=True, exist_ok=True)
    network = faces_network()
    (folder / "operations.tflite").write_bytes(network)
    write_safetensors(folder / "operations.safetensors", dict(zip(["rows", "last"], computed(network), strict=True)))

    network = shapes_network()
    (folder / "shape_operations.tflite").write_bytes(network)
    names = ["mixed", "centred", "row"]
    write_safetensors(folder / "shape_operations.safetensors", dict(zip(names, computed(network), strict=True)))

    (folder / "person_operations.tflite").write_bytes(person_network(custom=True))
    found = computed(person_network(custom=False))
    names = ["mask", "spread", "near"]
    write_safetensors(folder / "person_operations.safetensors", dict(zip(names, found, strict=True)))


def drawn_person():
    """The picture of crates/face/tests/person.rs: an ellipse for each part, in this order."""
    height, width = 150, 200
    y, x = np.mgrid[0:height, 0:width]
    picture = np.stack([60 + y // 3, 90 + x // 4, 110 + y // 5], -1)
    # Colour; centre and half axes, across and down.
    parts = [
        ((70, 45, 30), (108, 55, 34, 42)),
        ((40, 60, 120), (105, 160, 75, 52)),
        ((205, 160, 135), (108, 100, 13, 25)),
        ((215, 170, 145), (108, 62, 26, 34)),
        ((250, 250, 250), (98, 56, 5, 3)),
        ((250, 250, 250), (118, 56, 5, 3)),
        ((40, 30, 25), (98, 56, 2, 2)),
        ((40, 30, 25), (118, 56, 2, 2)),
        ((180, 120, 105), (108, 68, 3, 6)),
        ((160, 70, 70), (108, 82, 9, 3)),
    ]
    for colour, (cx, cy, across, down) in parts:
        picture[(x - cx) ** 2 * down**2 + (y - cy) ** 2 * across**2 <= (across * down) ** 2] = colour
    return picture.astype(np.uint8)


def person(folder):
    import mediapipe

    with mediapipe.solutions.selfie_segmentation.SelfieSegmentation(model_selection=0) as segmentation:
        mask = segmentation.process(drawn_person()).segmentation_mask
    print(mask.shape, mask.mean())
    write_safetensors(folder / "person_mask.safetensors", {"mask": mask[::4, ::4]})


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


def landmarker(task, faces, pictures):
    import csv

    import mediapipe

    vision = mediapipe.tasks.vision
    options = vision.FaceLandmarkerOptions(
        base_options=mediapipe.tasks.BaseOptions(model_asset_path=task), output_face_blendshapes=True
    )
    with vision.FaceLandmarker.create_from_options(options) as network:
        for row, picture in zip(csv.DictReader(open(faces)), pictures, strict=True):
            frame = mediapipe.Image.create_from_file(picture)
            found = network.detect(frame)
            size = np.array([frame.width, frame.height])
            theirs = np.array([[point.x, point.y] for point in found.face_landmarks[0]]) * size - 0.5
            ours = np.array([[float(row[f"x_{n}"]), float(row[f"y_{n}"])] for n in range(478)])
            distance = np.linalg.norm(ours - theirs, axis=1)
            shapes = max(abs(float(row[shape.category_name]) - shape.score) for shape in found.face_blendshapes[0])
            print(f"{picture}: mean {distance.mean():.3f} px, largest {distance.max():.3f} px; blend shapes {shapes:.4f}")


if __name__ == "__main__":
    match sys.argv[1:]:
        case ["landmarker", task, faces, *pictures]:
            landmarker(task, faces, pictures)
        case ["fixture", folder]:
            fixture(Path(folder))
        case ["person", folder]:
            person(Path(folder))
        case ["compare", landmarks, *pictures]:
            compare(landmarks, pictures)
        case _:
            sys.exit(__doc__)
