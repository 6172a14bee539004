import os

import numpy as np
import pytest

import srflow


@pytest.fixture(scope="module")
def finder():
    try:
        return srflow.FaceFinder()
    except FileNotFoundError:
        pytest.skip("mediapipe: no package up to 0.10.21 is installed or named by SRFLOW_FACE_MODELS")


def head(seed, size=320):
    gaussians = srflow.Avatar.builtin(seed).pose()
    return srflow.rasterize(gaussians, srflow.Camera.facing(gaussians, size, size))["image"]


def test_a_face_is_found_and_cut_out_upright(finder):
    image = head(7)
    (face,) = finder(image)
    assert 0.5 <= face["score"] <= 1 and face["landmarks"].shape == (68, 2) and face["mesh"].shape == (468, 2)
    left, top, width, height = face["box"]
    assert 0 <= left and left + width <= 320 and 0 <= top and top + height <= 320
    inside = (face["mesh"] >= [left - 1, top - 1]) & (face["mesh"] <= [left + width, top + height])
    assert inside.all()
    crop = srflow.crop_face(image, face["landmarks"])
    eyes = face["landmarks"][36:42].mean(axis=0), face["landmarks"][42:48].mean(axis=0)
    side = round(np.linalg.norm(eyes[1] - eyes[0]) / 0.4)
    assert crop.shape == (side, side, 3)
    assert np.array_equal(crop, srflow.crop_face(image, eyes))

    # Turned by a quarter, the face is not found; its crop is that of the upright one, if its eyes are known.
    turned = np.rot90(image)
    places = [[eye[1], 319 - eye[0]] for eye in eyes]
    difference = srflow.crop_face(turned, places).astype(int) - crop
    assert np.abs(difference).mean() < 1


def test_two_faces_are_given_from_left_to_right(finder):
    both = np.concatenate([head(3), head(4)], axis=1)
    faces = finder(both)
    assert len(faces) == 2 and faces[0]["box"][0] < 320 <= faces[1]["box"][0] + faces[1]["box"][2]
    assert finder(np.full((60, 80), 128, np.uint8)) == []


def test_what_is_no_network_or_no_face_is_refused(tmp_path):
    with pytest.raises(FileNotFoundError, match="nowhere: opening"):
        srflow.FaceFinder(os.path.join(tmp_path, "nowhere"))
    with pytest.raises(ValueError, match="no face_detection_short_range.tflite"):
        srflow.FaceFinder(tmp_path)
    image = np.zeros((40, 50, 3), np.uint8)
    with pytest.raises(ValueError, match="landmarks: expected dlib's points, float64 68 x 2, or the eyes"):
        srflow.crop_face(image, np.zeros((5, 2)))
    with pytest.raises(ValueError, match="apart from each other"):
        srflow.crop_face(image, [[3, 4], [np.nan, 4]])
    with pytest.raises(ValueError, match="far outside of the frame of 50x40"):
        srflow.crop_face(image, [[3, 4], [900, 4]])
