"""Golden values for srflow_mer's metrics of one fold: scikit-learn and imbalanced-learn on a few small folds.

    pip install scikit-learn==1.9.1 imbalanced-learn==0.14.2
    python tools/parity/mer_metrics.py

Prints the table in crates/mer/src/metrics.rs: precision, recall, F1 (macro), F1 (micro), geometric mean.
"""

from imblearn.metrics import geometric_mean_score
from sklearn.metrics import f1_score, precision_score, recall_score

FOLDS = [
    ([0, 0, 0, 1, 1, 2], [0, 0, 1, 1, 2, 2]),
    ([0, 0, 0, 0], [0, 0, 2, 0]),
    ([0, 0, 1], [0, 0, 0]),
    ([0, 1], [2, 2]),
    ([1, 1], [1, 1]),
]

for truth, predicted in FOLDS:
    scores = [f(truth, predicted, average="macro", zero_division=0) for f in (precision_score, recall_score, f1_score)]
    scores += [f1_score(truth, predicted, average="micro"), float(geometric_mean_score(truth, predicted))]
    print(f"(&{truth}, &{predicted}, {[float(score) for score in scores]}),")
