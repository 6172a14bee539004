//! Landmarks of clips.

use srflow_data::micro_expression::Annotation;
use srflow_face::FaceError;
use srflow_mer::Landmarks;

fn annotation(subject: &str, clip: &str, onset: u64) -> Annotation {
    Annotation {
        subject: subject.to_owned(),
        clip: clip.to_owned(),
        class: 1,
        label: String::new(),
        action_units: String::new(),
        onset,
        apex: None,
        offset: onset + 9,
    }
}

fn landmarks(text: &str) -> Result<Landmarks, FaceError> {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("landmarks.csv");
    std::fs::write(&path, text).unwrap();
    Landmarks::read(&path)
}

#[test]
fn the_row_of_the_onset_counts() {
    let text = "dataset,subject,clip,frame,left_eye_x,left_eye_y,right_eye_x,right_eye_y\n\
                samm,006,a,5,10,10,50,10\nsamm,006,a,7,12,10,52,10\n,007,a,,1,2,31,2\n";
    let landmarks = landmarks(text).unwrap();
    let eye = |dataset, subject, onset| {
        landmarks.of_clip(dataset, &annotation(subject, "a", onset)).map(|f| f.eyes[0])
    };
    assert_eq!(eye("samm", "006", 7).unwrap(), [12.0, 10.0]);
    assert_eq!(eye("anything", "007", 3).unwrap(), [1.0, 2.0]);
    let error = eye("samm", "006", 6).unwrap_err().to_string();
    assert!(error.contains("subject 006") && error.contains("landmarks.csv"), "{error}");
}

#[test]
fn a_missing_row_is_explained() {
    let header = "subject,clip,frame,left_eye_x,left_eye_y,right_eye_x,right_eye_y";
    let landmarks = landmarks(&format!("{header}\n6,a,5,10,10,50,10\n007,a,5,10,10,50,10\n")).unwrap();
    let error = |subject| landmarks.of_clip("samm", &annotation(subject, "a", 6)).unwrap_err().to_string();
    assert!(error("006").contains("(the file calls the subject 6: write it alike)"), "{}", error("006"));
    assert!(error("007").contains("subject 007 in its onset, frame 6"), "{}", error("007"));
    assert!(error("008").contains("no landmarks of clip a of subject 008;"), "{}", error("008"));
}

#[test]
fn wrong_frame_numbers_are_refused() {
    let text = "subject,clip,frame,left_eye_x,left_eye_y,right_eye_x,right_eye_y\n1,a,z,2,2,9,2\n";
    let error = landmarks(text).unwrap_err().to_string();
    assert!(error.contains("row 2, frame: expected a frame number, found `z`"), "{error}");
}

#[test]
fn frame_numbers_of_pandas_count_and_rows_without_a_face_do_not() {
    let text = "Subject;Clip;Frame;success;left_eye_x;left_eye_y;right_eye_x;right_eye_y\n\
                1;a;19.0;1;10,5;10;50,5;10\n1;a;20.0;0;0;0;0;0\n";
    let landmarks = landmarks(&format!("\u{feff}{text}")).unwrap();
    let eyes = |onset| landmarks.of_clip("x", &annotation("1", "a", onset)).map(|face| face.eyes);
    assert_eq!(eyes(19).unwrap(), [[10.5, 10.0], [50.5, 10.0]]);
    let error = eyes(20).unwrap_err().to_string();
    assert!(error.contains("the tracker found no face"), "{error}");
}
