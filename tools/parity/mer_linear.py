"""Golden values for srflow_mer's logistic regression: scikit-learn's, on made-up inputs.

    pip install scikit-learn==1.9.1
    python tools/parity/mer_linear.py crates/mer/tests/golden

Inputs and labels come from rules over positions, which crates/mer/tests/mer/linear.rs repeats: 40 clips of 8 subjects and 4 classes
with 12 inputs; the first four indicate the class. Written as safetensors:
    scores.C        scores of all clips by a model of the first 30, for each inverse strength C, [40, 4]; the mean over classes is
                    taken away, which no probability depends on
    losses          mean cross-entropy of clips whose subjects were left out, for each inverse strength, [9]
"""

import sys
from pathlib import Path

import numpy as np
from golden import noise, write_safetensors
from sklearn.linear_model import LogisticRegression

CLIPS, TRAINING, SUBJECTS, CLASSES, INPUTS = 40, 30, 8, 4, 12
STRENGTHS = [1e-4, 3e-4, 1e-3, 3e-3, 1e-2, 3e-2, 1e-1, 3e-1, 1.0]

labels = np.arange(CLIPS) * 7 % 5 % CLASSES
subjects = np.arange(CLIPS) % SUBJECTS
inputs = noise(CLIPS * INPUTS, 3).reshape(CLIPS, INPUTS)
inputs[np.arange(CLIPS), labels] += np.float32(0.75)
inputs = inputs.astype(np.float64)


def fitted(inputs, labels, strength):
    unit = np.sqrt(np.mean(inputs**2))
    model = LogisticRegression(C=strength, tol=1e-10, max_iter=10000, solver="newton-cg")
    model.fit(inputs / unit, labels)
    return lambda inputs: model.decision_function(inputs / unit)


def log_probabilities(scores):
    scores = scores - scores.max(1, keepdims=True)
    return scores - np.log(np.exp(scores).sum(1, keepdims=True))


golden, losses = {}, []
for strength in STRENGTHS:
    scores = fitted(inputs[:TRAINING], labels[:TRAINING], strength)(inputs)
    golden[f"scores.{strength:g}"] = scores - scores.mean(1, keepdims=True)
    loss = 0
    for subject in range(SUBJECTS):
        out = subjects == subject
        found = log_probabilities(fitted(inputs[~out], labels[~out], strength)(inputs[out]))
        loss -= found[np.arange(out.sum()), labels[out]].sum()
    losses.append(loss / CLIPS)
golden["losses"] = np.array(losses)
write_safetensors(Path(sys.argv[1]) / "linear.safetensors", golden)
print({name: array.shape for name, array in golden.items()}, losses)
