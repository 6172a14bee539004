"""Small checkpoints of TensorFlow and Keras: python tools/parity/tensorflow_checkpoints.py crates/nn/tests/checkpoints

    pip install tensorflow-cpu==2.21.0 tf_keras==2.21.0

Numbers are those of `values`, which crates/nn/tests/checkpoint.rs repeats.
"""

import sys
from pathlib import Path

import numpy as np
import tensorflow as tf
import tf_keras


def values(shape):
    """0, 0.125, 0.25 and so on in the order of PyTorch: outputs, inputs, height, width."""
    ordered = {4: (3, 2, 0, 1), 2: (1, 0)}.get(len(shape), tuple(range(len(shape))))
    turned = [shape[axis] for axis in ordered]
    return (np.arange(np.prod(shape)) / 8).reshape(turned).transpose(np.argsort(ordered)).astype(np.float32)


def saver(folder):
    """Of tf.train.Saver: two scopes, what Adam remembers, a counter, and 16-bit numbers."""
    shapes = {
        "net1/conv1/kernel": (3, 1, 2, 4),
        "net1/conv1/bias": (4,),
        "net1/conv1/kernel/Adam": (3, 1, 2, 4),
        "net1/conv1/kernel/Adam_1": (3, 1, 2, 4),
        "net2/deconv/kernel": (4, 4, 1, 2),
        "net2/bn/moving_variance": (3,),
        "beta1_power": (),
    }
    graph = tf.Graph()
    with graph.as_default(), tf.compat.v1.Session() as session:
        tensors = {name: tf.compat.v1.get_variable(name, initializer=values(shape)) for name, shape in shapes.items()}
        tensors["global_step"] = tf.compat.v1.get_variable("global_step", initializer=7)
        half = values((3,)).astype(np.float16)
        tensors["net2/half/bias"] = tf.compat.v1.get_variable("net2/half/bias", initializer=half)
        session.run(tf.compat.v1.global_variables_initializer())
        tf.compat.v1.train.Saver(tensors).save(session, str(folder / "tensorflow"), write_meta_graph=False)
    (folder / "checkpoint").unlink()


def keras(folder):
    """Of save_weights, and of a whole model with its optimizer."""
    model = tf_keras.Sequential(
        [
            tf_keras.layers.Conv2D(4, (3, 1), name="conv1", input_shape=(8, 8, 2)),
            tf_keras.layers.Conv2DTranspose(1, 4, name="deconv"),
        ]
    )
    model.compile(tf_keras.optimizers.legacy.Adam(), "mse")
    model.set_weights([values(weight.shape) for weight in model.get_weights()])
    model.save_weights(folder / "keras.h5")
    model.train_on_batch(np.zeros((1, 8, 8, 2)), np.zeros((1, 9, 11, 1)))
    model.set_weights([values(weight.shape) for weight in model.get_weights()])
    model.save(folder / "keras-model.h5", save_format="h5")


folder = Path(sys.argv[1])
folder.mkdir(parents=True, exist_ok=True)
saver(folder)
keras(folder)
