//! Videos through the real `ffmpeg`; `flow_networks.rs` tests the same with programs that stand in for it.

use std::fs;
use std::path::Path;
use std::process::{Command, Output, Stdio};

use srflow_core::Image;
use srflow_files::{Npz, read_flow, write_image_png};
use srflow_splat::{Gaussians, write_ply};

use crate::{fails, succeeds};

/// Whether `ffmpeg` and `ffprobe` are on the PATH.
pub fn programs_exist() -> bool {
    let missing = ["ffmpeg", "ffprobe"].into_iter().find(|program| {
        let run = Command::new(program).arg("-version").stdout(Stdio::null()).stderr(Stdio::null()).status();
        !run.is_ok_and(|status| status.success())
    });
    if let Some(program) = missing {
        eprintln!("skipped: ffmpeg: {program} is not on the PATH");
    }
    missing.is_none()
}

/// A folder with `a.ply`, and `path.json` with 4 cameras of 90x60 pixels that move to the right.
fn scene() -> tempfile::TempDir {
    let folder = tempfile::tempdir().unwrap();
    let count = 40;
    let gaussians = Gaussians {
        positions: (0..count).map(|i| [0.05 * (i % 8) as f32, 0.05 * (i / 8) as f32, 0.0].into()).collect(),
        scales: vec![[0.02; 3].into(); count],
        rotations: vec![Default::default(); count],
        opacities: vec![0.9; count],
        sh_degree: 0,
        sh: (0..count).map(|i| [(i % 3) as f32 - 1.0, (i % 5) as f32 - 2.0, 0.5]).collect(),
        antialiased: false,
    };
    write_ply(&folder.path().join("a.ply"), &gaussians).unwrap();
    let frames: Vec<_> = (0..4)
        .map(|i| {
            let x = 0.2 + 0.02 * f64::from(i);
            let matrix = [[1.0, 0.0, 0.0, x], [0.0, 1.0, 0.0, 0.1], [0.0, 0.0, 1.0, 1.0]];
            serde_json::json!({ "file_path": format!("{i}.png"), "transform_matrix": matrix })
        })
        .collect();
    let path = serde_json::json!({
        "fl_x": 100, "fl_y": 100, "cx": 45, "cy": 30, "w": 90, "h": 60, "frames": frames
    });
    fs::write(folder.path().join("path.json"), path.to_string()).unwrap();
    folder
}

fn srflow(folder: &Path, arguments: &[&str]) -> Output {
    crate::srflow().current_dir(folder).args(arguments).output().expect("srflow runs")
}

/// Width, height and number of frames of a video.
fn video_size(file: &Path) -> (u32, u32, u32) {
    let entries = "stream=width,height,nb_read_packets";
    let output = Command::new("ffprobe")
        .args(["-v", "error", "-select_streams", "v:0", "-count_packets", "-show_entries", entries])
        .args(["-of", "csv=p=0"])
        .arg(format!("file:{}", file.display()))
        .output()
        .unwrap();
    let text = String::from_utf8(output.stdout).unwrap();
    let mut numbers = text.trim().split(',').map(|number| number.parse().unwrap());
    let mut next = || numbers.next().expect(&text);
    (next(), next(), next())
}

#[test]
fn a_moving_camera_becomes_a_video() {
    if !programs_exist() {
        return;
    }
    let folder = scene();
    let dir = folder.path();
    // A name with a colon is a file, not a protocol; odd sides are padded for the codec.
    let orbit = ["rasterize", "a.ply", "--orbit", "90x5", "--size", "91x61", "--out", "a:turn.mp4"];
    assert!(srflow(dir, &orbit).status.success());
    assert_eq!(video_size(&dir.join("a:turn.mp4")), (92, 62, 5));
    let error = fails(&srflow(dir, &orbit), 1);
    assert!(error.contains("a:turn.mp4 exists"), "{error}");
    for file in ["path.mp4", "path.mkv", "path.gif"] {
        assert!(srflow(dir, &["rasterize", "a.ply", "--path", "path.json", "--out", file]).status.success());
        assert_eq!(video_size(&dir.join(file)), (90, 60, 4), "{file}");
    }
}

#[test]
fn flow_follows_the_frames_of_a_video() {
    if !programs_exist() {
        return;
    }
    let folder = scene();
    let dir = folder.path();
    let video = ["rasterize", "a.ply", "--path", "path.json", "--background", "white", "--out", "clip.mkv"];
    assert!(srflow(dir, &video).status.success());
    let flow =
        ["flow", "--method", "farneback", "clip.mkv", "-o", "flows", "--viz", "viz.mp4", "--viz-max", "4"];
    succeeds(&srflow(dir, &flow));
    let mut names: Vec<_> =
        fs::read_dir(dir.join("flows")).unwrap().map(|e| e.unwrap().file_name()).collect();
    names.sort();
    assert_eq!(names, ["000001.flo", "000002.flo", "000003.flo"]);
    // The camera moves by 0.02 at distance 1 with a focal length of 100 pixels: everything moves by 2 pixels to the left.
    let flow = read_flow(&dir.join("flows/000002.flo")).unwrap();
    let [u, v] = flow.get(45, 30);
    assert!((u + 2.0).abs() < 0.5 && v.abs() < 0.5, "({u}, {v})");
    assert_eq!(video_size(&dir.join("viz.mp4")), (90, 60, 3));
}

/// A playlist is recognized by its content whatever its name, and would make ffmpeg open the files that it lists.
#[test]
fn a_video_opens_no_other_file() {
    if !programs_exist() {
        return;
    }
    let folder = scene();
    let dir = folder.path();
    assert!(srflow(dir, &["rasterize", "a.ply", "--path", "path.json", "--out", "b.ts"]).status.success());
    let other = dir.join("b.ts");
    let playlists = [
        (
            "hls.mp4",
            format!("#EXTM3U\n#EXT-X-TARGETDURATION:9\n#EXTINF:1,\n{}\n#EXT-X-ENDLIST\n", other.display()),
        ),
        ("concat.mkv", "ffconcat version 1.0\nfile b.ts\n".to_owned()),
        (
            "session.mp4",
            "v=0\no=- 0 0 IN IP4 127.0.0.1\ns=x\nc=IN IP4 127.0.0.1\nt=0 0\nm=video 5004 RTP/AVP 32\n".into(),
        ),
    ];
    for (name, text) in playlists {
        fs::write(dir.join(name), text).unwrap();
        let error = fails(&srflow(dir, &["flow", "--method", "farneback", name, "-o", "flows"]), 1);
        assert!(error.contains(name) && error.contains("not on whitelist"), "{name}: {error}");
        let written = fs::read_dir(dir.join("flows")).map_or(0, |entries| {
            entries
                .filter(|entry| entry.as_ref().unwrap().path().extension().is_some_and(|e| e == "flo"))
                .count()
        });
        assert_eq!(written, 0, "{name}");
    }
    // What they list is a video that can be read by itself.
    succeeds(&srflow(dir, &["flow", "--method", "farneback", "b.ts", "-o", "flows"]));
    assert_eq!(fs::read_dir(dir.join("flows")).unwrap().count(), 3);
}

/// Clips of micro-expressions may be videos: their frames give the features that pictures give.
#[test]
fn clips_are_videos_or_folders() {
    if !programs_exist() {
        return;
    }
    let folder = tempfile::tempdir().unwrap();
    let dir = folder.path();
    fs::create_dir(dir.join("a")).unwrap();
    for number in 1..=6 {
        let frame = Image::from_fn(64, 48, |x, y| {
            let wave = ((x as f32 + 0.4 * number as f32) * 0.5).sin() + (y as f32 * 0.3).sin();
            [(127.0 + 60.0 * wave) as u8; 3]
        });
        write_image_png(&dir.join(format!("a/{number:03}.png")), &frame).unwrap();
    }
    let made = Command::new("ffmpeg")
        .current_dir(dir)
        .args(["-v", "error", "-i", "a/%03d.png", "-c:v", "ffv1", "-pix_fmt", "bgr0", "a.mkv"])
        .status();
    assert!(made.unwrap().success());
    let features = |clip: &str, rest: &str, out: &str| {
        let rows = format!("clip,subject,onset,apex,offset,class\n{clip},s1,{rest},positive\n");
        fs::write(dir.join("clips.csv"), rows).unwrap();
        srflow(dir, &["mer", "features", "--data", "clips:.", "--method", "farneback", "--out", out])
    };
    succeeds(&features("a", "2,4,6", "folder.npz"));
    succeeds(&features("a.mkv", "2,4,6", "video.npz"));
    let array = |name: &str| Npz::open(&dir.join(name)).unwrap().array("X").unwrap();
    assert_eq!(array("folder.npz"), array("video.npz"));
    let error = fails(&features("a.mkv", "2,4,9", "more.npz"), 1);
    assert!(error.contains("s1/a.mkv: 3 frames: 7-9"), "{error}");
    let listed = srflow(dir, &["mer", "data", "clips:.", "--allow-missing"]);
    assert!(succeeds(&listed).contains("1 clips: 0 negative, 1 positive"));
    fs::write(dir.join("a.mkv"), "no video").unwrap();
    let error = fails(&features("a.mkv", "2,4,6", "broken.npz"), 1);
    assert!(error.contains("a.mkv: reading a video: ffmpeg"), "{error}");
}
