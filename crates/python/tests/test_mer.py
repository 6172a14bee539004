import numpy as np
import pytest

import srflow
from conftest import frame


def test_features_are_those_of_the_command(frames, tmp_path, command):
    onset, apex, _ = frames
    for name, image in [("a.ppm", onset), ("b.ppm", apex)]:
        (tmp_path / name).write_bytes(b"P6 96 64 255\n" + image.tobytes())
    for resize, head_motion, formula in [("before", "keep", "literature"), ("after", "subtract", "off-tanet")]:
        out = tmp_path / f"{resize}.npy"
        options = ["--method", "tvl1", "--warps", 2, "--resize", resize, "--head-motion", head_motion, "--formula", formula]
        arguments = ["-o", tmp_path / f"{resize}-strain.npy", "--features", out, *options]
        ran = command("mer", "strain", tmp_path / "a.ppm", tmp_path / "b.ppm", *arguments)
        assert ran.returncode == 0, ran.stderr
        features = srflow.mer.features(onset, apex, "tvl1", resize=resize, head_motion=head_motion, strain=formula, warps=2)
        assert features.dtype == np.float32 and features.shape == (3, 112, 112)
        assert np.array_equal(features, np.load(out))
        if head_motion == "keep":
            strain = srflow.mer.strain(features[:2].transpose(1, 2, 0), formula)
            assert np.array_equal(strain, features[2])
    paper = srflow.mer.features(onset, apex, "tvl1", protocol="paper", warps=2)
    assert np.array_equal(paper, srflow.mer.features(onset, apex, "tvl1", resize="before", head_motion="keep", warps=2))
    with pytest.raises(ValueError, match="the onset is 96x64, the apex 96x32"):
        srflow.mer.features(onset, apex[:32])
    with pytest.raises(ValueError, match="resize: `during` is not .* expected one of before, after"):
        srflow.mer.features(onset, apex, resize="during")
    with pytest.raises(ValueError, match="unknown setting `wraps`"):
        srflow.mer.features(onset, apex, "tvl1", wraps=2)


def test_strain_of_a_linear_flow_is_that_of_its_gradient():
    y, x = np.mgrid[:7, :9]
    flow = np.stack([0.3 * x + 0.1 * y, -0.2 * x + 0.4 * y], axis=-1)
    strain = srflow.mer.strain(flow)
    assert strain.shape == (7, 9) and strain.dtype == np.float32
    assert strain[3, 4] == pytest.approx((0.3**2 + 0.4**2 + 0.5 * (0.1 - 0.2) ** 2) ** 0.5)
    with pytest.raises(ValueError, match="formula: `infinitesimal` is not a strain formula"):
        srflow.mer.strain(flow, "infinitesimal")
    with pytest.raises(ValueError, match="flow: expected a flow, float32 H x W x 2 .* found float64 2 x 7 x 9"):
        srflow.mer.strain(flow.transpose(2, 0, 1))


def test_metrics_are_those_of_scikit_learn_and_imbalanced_learn():
    truth = [0, 0, 0, 1, 1, 2] + [0, 0, 0, 0]
    predicted = [0, 0, 1, 1, 2, 2] + [0, 0, 2, 0]
    subjects = ["a"] * 6 + ["b"] * 4
    scores = srflow.mer.metrics(truth, predicted, subjects)
    folds = [
        [0.6666666666666666, 0.7222222222222222, 0.6555555555555556, 0.6666666666666666, 0.6933612743506347],
        [0.5, 0.375, 0.42857142857142855, 0.75, 0.0],
    ]
    for name, first, second in zip(["p_m", "r_m", "f1_m", "f1_mu", "g_m"], *folds, strict=True):
        assert scores[name] == pytest.approx((first + second) / 2, abs=1e-15), name
    assert scores["confusion"].tolist() == [[5, 1, 1], [0, 1, 1], [0, 0, 1]]
    assert scores["uar"] == pytest.approx((5 / 7 + 1 / 2 + 1) / 3)
    assert scores["uf1"] == pytest.approx((10 / 12 + 2 / 4 + 2 / 4) / 3)
    five = srflow.mer.metrics(np.array(truth), np.array(predicted, np.uint8), subjects, classes=5)
    assert five["uar"] == pytest.approx(3 / 5 * scores["uar"]) and five["f1_m"] == scores["f1_m"]


@pytest.mark.parametrize(
    "arguments, message",
    [
        (([0, 1], [0], ["a", "b"]), "predicted: expected numbers of classes from 0, int64 2, found int64 1"),
        (([0.0, 1.0], [0, 1], ["a", "b"]), "truth: expected numbers of classes from 0, int64 N, found float64 2"),
        (([0, -1], [0, 1], ["a", "b"]), "truth: expected numbers of classes from 0"),
        (([0, 1], [0, 1], ["a"]), "subjects: expected 2 names, found 1"),
        (([0, 10**12], [0, 1], ["a", "b"]), "classes: expected a number of classes from 1000000000001 .* to 1000"),
        (([], [], []), "no predictions|truth: expected numbers"),
    ],
)
def test_predictions_that_cannot_be_scored_are_value_errors(arguments, message):
    with pytest.raises(ValueError, match=message):
        srflow.mer.metrics(*arguments)


def toy(subjects=4):
    """Points around the centre of their class; the clips are in no order."""
    rng = np.random.default_rng(5)
    y = np.arange(6 * subjects) % 3
    subject = np.array([f"s{index // 6:02}" for index in range(6 * subjects)])
    points = np.array([[0, 0], [3, 0], [0, 3]])[y] + rng.normal(0, 0.5, (len(y), 2))
    order = rng.permutation(len(y))
    return {"X": points[order], "y": y[order], "subject": subject[order], "names": ["negative", "positive", "surprise"]}


def nearest_mean(x, y, test):
    means = np.stack([x[y == label].mean(axis=0) for label in range(3)])
    return np.linalg.norm(test[:, None] - means, axis=-1).argmin(axis=1)


def test_each_subject_is_classified_by_the_others():
    data, seen, reports = toy(), [], []

    def classify(x, y, test):
        assert len(x) == len(y) == 18 and len(test) == 6 and y.dtype == np.int64
        here = {tuple(point) for point in test}
        assert not here & {tuple(point) for point in x}
        subjects = {name for point, name in zip(data["X"], data["subject"], strict=True) if tuple(point) in here}
        seen.extend(subjects)
        return nearest_mean(x, y, test)

    result = srflow.mer.loso(data, classify, callback=reports.append)
    assert seen == ["s00", "s01", "s02", "s03"], "one at a time, in order"
    assert result["classes"] == data["names"] and [fold["subject"] for fold in result["folds"]] == seen
    assert (result["predictions"] == data["y"]).mean() > 0.9
    expected = srflow.mer.metrics(data["y"], result["predictions"], data["subject"])
    for name in ["p_m", "r_m", "f1_m", "f1_mu", "g_m", "uf1", "uar"]:
        assert result["last"][name] == expected[name], name
    assert result["last"]["confusion"] == expected["confusion"].tolist()
    assert [report["done"] for report in reports] == [18, 36, 54, 72] and reports[0]["total"] == 72


def test_wrong_runs_are_errors():
    data = toy()
    with pytest.raises(ValueError, match="predictions for subject s00: expected numbers of classes from 0, int64 6, found int64 2"):
        srflow.mer.loso(data, lambda x, y, test: [0, 1])
    with pytest.raises(ValueError, match="subject s00: expected the classes of 6 clips, numbers from 0 to 2; found 6 numbers"):
        srflow.mer.loso(data, lambda x, y, test: [7] * 6)
    with pytest.raises(ZeroDivisionError):
        srflow.mer.loso(data, lambda x, y, test: 1 / 0)
    with pytest.raises(ValueError, match="there is no `subject`"):
        srflow.mer.loso({"X": data["X"], "y": data["y"]}, nearest_mean)
    with pytest.raises(ValueError, match="at least 2 subjects; found clips s"):
        srflow.mer.loso(data | {"subject": ["s"] * 24}, nearest_mean)
    with pytest.raises(ValueError, match="X: expected a row for each of 24 clips, found 3"):
        srflow.mer.loso(data | {"X": data["X"][:3]}, nearest_mean)
    with pytest.raises(ValueError, match="clips clip a|two clips called a"):
        srflow.mer.loso(data | {"clip": ["a"] * 24}, nearest_mean)
    with pytest.raises(ValueError, match="epochs is for the built-in classifiers"):
        srflow.mer.loso(data, nearest_mean, epochs=3)
    with pytest.raises(ValueError, match="classifier: expected a function or one of linear, .* found `svm`"):
        srflow.mer.loso(data, "svm")
    with pytest.raises(ValueError, match="X: expected features, float32 24 x 3 x 112 x 112, found float64 24 x 2"):
        srflow.mer.loso(data, "ststnet")
    with pytest.raises(TypeError, match="classifier: expected a function or one of"):
        srflow.mer.loso(data, 3)


def test_built_in_classifiers_learn_and_continue(tmp_path):
    rng = np.random.default_rng(2)
    y = np.arange(12) % 3
    x = rng.normal(0, 0.1, (12, 3, 112, 112)).astype(np.float32)
    x[np.arange(12), y] += 1
    data = {"X": x, "y": y, "subject": [f"{index // 4}" for index in range(12)]}
    options = {"classifier": "ststnet", "epochs": 4, "record_every": 2, "batch": 4, "learning_rate": 5e-3}
    reports = []
    result = srflow.mer.loso(data, callback=reports.append, **options)
    assert [epoch["epoch"] for epoch in result["epochs"]] == [0, 2, 3]
    assert len(result["best"]) == 5 and len(result["folds"]) == 3 and result["predictions"].shape == (12,)
    assert reports[-1] == {"done": 96, "total": 96}

    class Enough(Exception):
        pass

    def enough(report):
        if report["done"] > 72:  # with three folds beside each other, the first is finished
            raise Enough

    with pytest.raises(Enough):
        srflow.mer.loso(data, callback=enough, folder=tmp_path, **options)
    again = srflow.mer.loso(data, folder=tmp_path, **options)
    assert any(fold["resumed"] for fold in again["folds"])
    assert again["last"] == result["last"] and np.array_equal(again["predictions"], result["predictions"])
    with pytest.raises(ValueError, match="learning rate is 0; expected a number above 0"):
        srflow.mer.loso(data, "ststnet", learning_rate=0.0)
    x[3, 1, 5, 7] = np.nan
    with pytest.raises(ValueError, match=r"feature map V holds a value that is not finite at pixel \(7, 5\)"):
        srflow.mer.loso(data, "ststnet", epochs=1)


def test_the_archive_of_the_command_is_taken(tmp_path, command):
    lines = ["clip,subject,onset,apex,offset,class"]
    for subject in "ab":
        for number, label in enumerate(["negative", "positive", "surprise"]):
            folder = tmp_path / subject / str(number)
            folder.mkdir(parents=True)
            for index, motion in [(1, (0, 0)), (2, (number - 1, 0.5 * number)), (3, (0, 0))]:
                image = frame(*motion)
                (folder / f"{index}.ppm").write_bytes(b"P6 96 64 255\n" + image.tobytes())
            lines.append(f"{subject}/{number},{subject},1,2,3,{label}")
    (tmp_path / "clips.csv").write_text("\n".join(lines))
    archive = tmp_path / "features.npz"
    ran = command("mer", "features", "--data", f"clips:{tmp_path}", "--method", "farneback", "--out", archive)
    assert ran.returncode == 0, ran.stderr
    features = np.load(archive)
    expected = srflow.mer.features(frame(0, 0), frame(1, 1), "farneback")
    assert np.array_equal(features["X"][2], expected)
    result = srflow.mer.loso(features, lambda x, y, test: [y[np.abs(x - clip).sum(axis=(1, 2, 3)).argmin()] for clip in test])
    assert result["classes"] == ["negative", "positive", "surprise"]
    assert np.array_equal(result["predictions"], features["y"]), "both subjects move alike"


def test_expressions_of_frames_are_spotted_with_their_curves(tmp_path):
    still = np.random.default_rng(1).integers(0, 255, (64, 64, 3), np.uint8)
    for number in range(1, 13):
        (tmp_path / f"{number:03}.ppm").write_bytes(b"P6 64 64 255\n" + still.tobytes())
    found = srflow.mer.spot(tmp_path, fps=30)
    assert found["events"] == []
    curves = found["curves"]
    assert curves["regions"].shape == (12, len(found["regions"]), 2) and len(found["regions"]) == 16
    assert curves["frame"].tolist() == list(range(1, 13)) and curves["usable"].all()
    assert np.abs(curves["regions"]).max() < 0.05, "nothing moves"
    assert list(curves["units"])[:3] == [1, 2, 4] and curves["units"][12].shape == (12,)


def test_regions_lie_on_the_face():
    names, where = srflow.mer.regions()
    assert where.shape == (112, 112) and where.max() == len(names) == 16
    assert names[where[67, 56] - 1] == "nose" and where[111, 0] == 0
    names, where = srflow.mer.regions("mdmo", np.full((68, 2), 0.5))
    assert len(names) == 36 and where.max() == 0, "a point has no area"
    with pytest.raises(ValueError, match="68 x 2"):
        srflow.mer.regions(landmarks=np.zeros((5, 2)))
    with pytest.raises(ValueError, match="which: .*regions of a face"):
        srflow.mer.regions("ears")


def test_seeds_are_means_of_runs():
    rng = np.random.default_rng(2)
    features = {
        "X": rng.normal(size=(8, 3, 112, 112)).astype(np.float32),
        "y": np.arange(8) % 2,
        "subject": [str(clip // 4) for clip in range(8)],
    }
    of = lambda **options: srflow.mer.loso(features, "ststnet", epochs=2, **options)
    both = of(seeds=2)
    alone = [of(seed=seed)["last"]["f1_mu"] for seed in (0, 1)]
    assert both["last"]["f1_mu"] == pytest.approx(np.mean(alone))
    assert [run["seed"] for run in both["seeds"]] == [0, 1]
    assert len(both["predictions"]) == 8
    with pytest.raises(ValueError, match="seeds"):
        srflow.mer.loso(features, "linear", seeds=2)


def test_a_model_says_what_it_knows():
    model = srflow.mer.load_model()
    assert model.classes == ["negative", "positive", "surprise"]
    assert model.card()["flow"]["method"] == "srflow"
    still = model(np.zeros((3, 112, 112), np.float32))
    assert still["class"] is None and "moves less" in still["doubt"]
    assert sum(still["probabilities"].values()) == pytest.approx(1)
    with pytest.raises(ValueError, match="3 x 112 x 112"):
        model(np.zeros((112, 112), np.float32))
    with pytest.raises(ValueError, match="nowhere: expected the folder of a model"):
        srflow.mer.load_model("nowhere")
