//! `srflow mer synth-long`, `spot` and `spot-score`, starting from an empty folder.

use std::fs;
use std::path::Path;
use std::process::Output;
use std::sync::LazyLock;

use srflow_core::Image;
use srflow_files::{read_image, write_image_png};

use crate::{fails, refuses, succeeds};

fn srflow(folder: &Path, arguments: &[&str]) -> Output {
    crate::srflow().current_dir(folder).arg("mer").args(arguments).output().unwrap()
}

/// One small, calm video with strong expressions, rendered once.
static SET: LazyLock<tempfile::TempDir> = LazyLock::new(|| {
    let folder = tempfile::tempdir().unwrap();
    let calm = ["--blinks", "0", "--glances", "0", "--speech", "0", "--drift", "0.2", "--intensity", "2"];
    let size =
        ["synth-long", "--out", "set", "--subjects", "1", "--minutes", "0.3", "--side", "128", "--look", "1"];
    let text = succeeds(&srflow(folder.path(), &[&size[..], &calm].concat()));
    assert!(text.contains("540 of 540 frames") && text.contains("1 videos with"), "{text}");
    folder
});

const SPOT: [&str; 11] = [
    "spot",
    "set/s01",
    "--fps",
    "30",
    "--landmarks",
    "set/landmarks.csv",
    "--method",
    "farneback",
    "--out",
    "spotted",
    "--json",
];

#[test]
fn expressions_of_a_rendered_video_are_spotted() {
    let set = SET.path();
    let report = crate::json(&srflow(set, &SPOT));
    let events = report["videos"][0]["events"].as_array().unwrap();
    assert!(!events.is_empty(), "{report}");
    for event in events {
        let frame = |name: &str| event[name].as_i64().unwrap();
        assert!(1 <= frame("onset") && frame("onset") <= frame("apex") && frame("apex") <= frame("offset"));
        let seconds = (frame("onset") - 1) as f64 / 30.0;
        assert!((event["onset_seconds"].as_f64().unwrap() - seconds).abs() < 1e-9, "{event}");
    }
    let scores = crate::json(&srflow(
        set,
        &["spot-score", "spotted/events.csv", "--truth", "set/events.csv", "--json"],
    ));
    assert!(scores["micro"]["recall"].as_f64().unwrap() >= 0.5, "{scores}");
    let text = succeeds(&srflow(set, &["spot-score", "spotted/megc.csv", "--truth", "set/events.csv"]));
    assert!(text.contains("1 videos, rule strict") && text.contains("overall"), "{text}");

    let signals = fs::read_to_string(set.join("spotted/s01.frames.csv")).unwrap();
    assert!(
        signals.starts_with("frame,timestamp,usable,head_x,head_y,inner-brow-left_x"),
        "{}",
        &signals[..80]
    );
    assert!(
        signals
            .lines()
            .next()
            .unwrap()
            .ends_with(",chin_x,chin_y,au1,au2,au4,au5,au6,au9,au10,au12,au14,au15,au17,au20,au25,au26")
    );
    assert_eq!(signals.lines().count(), 541);
    let page = fs::read_to_string(set.join("spotted/s01.html")).unwrap();
    let first = &events[0];
    let jump = format!("data-seconds=\"{}\"", first["onset_seconds"]);
    assert!(page.contains(&jump) && page.contains("set/s01/\" data-rate=\"30\""), "{jump}");
    assert!(fs::read_to_string(set.join("spotted/s01.eaf")).unwrap().contains("TIER_ID=\"ME\""));

    // A finished video is not spotted again; other settings need another folder.
    let before = fs::metadata(set.join("spotted/s01.events.json")).unwrap().modified().unwrap();
    assert_eq!(crate::json(&srflow(set, &SPOT)), report);
    assert_eq!(fs::metadata(set.join("spotted/s01.events.json")).unwrap().modified().unwrap(), before);
    let other = [&SPOT[..], &["--micro-score", "9"]].concat();
    fails(&srflow(set, &other), 1);
    // Nor are the events of another video taken for those of one of the same name.
    fs::create_dir_all(set.join("other/s01")).unwrap();
    for frame in ["000001.png", "000002.png"] {
        fs::copy(set.join("set/s01").join(frame), set.join("other/s01").join(frame)).unwrap();
    }
    let namesake = SPOT.map(|argument| if argument == "set/s01" { "other/s01" } else { argument });
    let refused = fails(&srflow(set, &namesake), 1);
    assert!(refused.contains("s01.events.json: expected the events of"), "{refused}");
    fs::write(set.join("spotted/s01.events.json"), "{").unwrap();
    let broken = fails(&srflow(set, &SPOT), 1);
    assert!(broken.contains("s01.events.json") && broken.contains("delete it"), "{broken}");
}

#[test]
fn a_face_that_is_carried_through_the_picture_is_followed() {
    let set = SET.path();
    fs::create_dir(set.join("carried")).unwrap();
    let landmarks = fs::read_to_string(set.join("set/landmarks.csv")).unwrap();
    let mut rows = landmarks.lines().map(|line| line.split(',').collect::<Vec<_>>());
    let (header, row) = (rows.next().unwrap(), rows.next().unwrap());
    assert_eq!(header[..2], ["video", "frame"]);
    let mut followed = header.join(",") + "\n";
    for frame in 1..=540_usize {
        let name = format!("{frame:06}.png");
        let face = read_image(&set.join("set/s01").join(&name)).unwrap();
        let left = (60.0 + 60.0 * (frame as f64 / 180.0).sin()).round() as usize;
        let place = |x: usize| x.wrapping_sub(left).min(face.width() - 1);
        let wide = Image::from_fn(face.width() + 120, face.height(), |x, y| face.get(place(x), y));
        write_image_png(&set.join("carried").join(&name), &wide).unwrap();
        let cell = |(column, value): (&&str, &&str)| match *column {
            "video" => "carried".to_owned(),
            "frame" => frame.to_string(),
            x if x.starts_with("x_") => (value.parse::<f64>().unwrap() + left as f64).to_string(),
            _ => (*value).to_owned(),
        };
        let cells: Vec<String> = header.iter().zip(&row).map(cell).collect();
        followed += &(cells.join(",") + "\n");
    }
    fs::write(set.join("carried.csv"), followed).unwrap();
    let spot = ["spot", "carried", "--fps", "30", "--out", "followed"];
    succeeds(&srflow(set, &[&spot[..], &["--landmarks", "carried.csv"]].concat()));
    let events = fs::read_to_string(set.join("followed/events.csv")).unwrap().replace("carried", "s01");
    fs::write(set.join("carried-events.csv"), events).unwrap();
    let score = ["spot-score", "carried-events.csv", "--truth", "set/events.csv", "--json"];
    let scores = crate::json(&srflow(set, &score));
    assert!(scores["micro"]["recall"].as_f64().unwrap() >= 0.5, "{scores}");
    let signals = fs::read_to_string(set.join("followed/carried.frames.csv")).unwrap();
    assert!(signals.lines().skip(1).all(|line| line.split(',').nth(2) == Some("yes")), "it moves slowly");
    // In a crop that stays where it is, the face moves too far.
    fs::write(set.join("still.csv"), landmarks.replace("s01", "carried")).unwrap();
    let still = ["spot", "carried", "--fps", "30", "--out", "unfollowed", "--landmarks", "still.csv"];
    let output = srflow(set, &still);
    assert!(output.status.success(), "{output:?}");
    let said = String::from_utf8_lossy(&output.stderr);
    assert!(said.contains("which stays where it is: follow the face"), "{said}");
}

#[test]
fn a_video_may_be_called_as_the_settings_and_every_nth_frame_is_read() {
    let set = SET.path();
    let video = set.join("spot");
    fs::create_dir(&video).unwrap();
    for frame in 1..=12 {
        fs::copy(set.join(format!("set/s01/{frame:06}.png")), video.join(format!("{frame:06}.png"))).unwrap();
    }
    let arguments = ["spot", "spot", "--fps", "120", "--out", "called", "--json"];
    for _ in 0..2 {
        let report = crate::json(&srflow(set, &arguments));
        assert_eq!(report["videos"][0]["seconds"], 0.1, "three frames at 30 per second: {report}");
    }
    let signals = fs::read_to_string(set.join("called/spot.frames.csv")).unwrap();
    let frames: Vec<&str> = signals.lines().skip(1).map(|line| line.split(',').next().unwrap()).collect();
    assert_eq!(frames, ["1", "5", "9"]);
}

#[test]
fn parts_of_the_videos_are_spotted_by_several_processes() {
    let set = SET.path();
    let videos = ["part-a", "part-b", "part-c"];
    for video in videos {
        fs::create_dir(set.join(video)).unwrap();
        for frame in 1..=12 {
            let name = format!("{frame:06}.png");
            fs::copy(set.join("set/s01").join(&name), set.join(video).join(&name)).unwrap();
        }
    }
    let spot = |more: &[&str]| {
        srflow(set, &[&["spot"], &videos[..], &["--fps", "30", "--out", "parts"], more].concat())
    };
    let text = succeeds(&spot(&["--shard", "1/2"]));
    assert!(text.contains("Part 1/2 is complete: 1 videos"), "{text}");
    assert!(!set.join("parts/events.csv").exists());
    let text = succeeds(&spot(&["--shard", "2/2"]));
    assert!(text.contains("part-b:") && text.contains("part-c:") && !text.contains("part-a:"), "{text}");
    let record = set.join("parts/part-a.events.json");
    let before = fs::metadata(&record).unwrap().modified().unwrap();
    succeeds(&spot(&[]));
    assert!(fs::read_to_string(set.join("parts/events.csv")).unwrap().starts_with("video,type,onset"));
    assert_eq!(
        fs::metadata(&record).unwrap().modified().unwrap(),
        before,
        "what parts did is not done again"
    );
    refuses(&spot(&["--shard", "1/2", "--force"]), 2, &["--force starts over", "--shard does a part"]);
}

#[test]
fn wrong_usage_is_refused() {
    let set = SET.path();
    let spot = |arguments: &[&str]| srflow(set, &[&["spot", "--out", "other"], arguments].concat());
    refuses(&spot(&["set/s01"]), 2, &["set/s01", "--fps"]);
    refuses(&spot(&["set/s01", "--fps", "3"]), 2, &["10 to 2000, found 3"]);
    refuses(&spot(&["nowhere"]), 2, &["nowhere", "no such file"]);
    refuses(&spot(&["set/s01", "set/s01", "--fps", "30"]), 2, &["another video is called `s01`"]);
    let score = |arguments: &[&str]| srflow(set, &[&["spot-score"], arguments].concat());
    refuses(&score(&["set/events.csv", "--truth", "set/landmarks.csv"]), 1, &["landmarks.csv", "onset"]);
    let other = ["set/events.csv", "--truth", "set/events.csv", "set/events.csv"];
    refuses(&score(&other), 2, &["a video s01, too"]);
    let types = ["set/events.csv", "--truth", "set/events.csv", "--types", "duration"];
    refuses(&score(&types), 2, &["--types duration needs --fps"]);
    fs::write(set.join("stranger.csv"), "video,onset,offset,type\nx,1,2,me\n").unwrap();
    let stranger = ["stranger.csv", "--truth", "set/events.csv"];
    refuses(&score(&stranger), 1, &["call them alike", "`s01`"]);
}
