//! A rendered micro-expression dataset is complete, independent of the number of threads, and its flow is the motion.

use std::collections::BTreeMap;
use std::fs;
use std::path::Path;
use std::sync::Mutex;

use srflow_core::{Shard, Size};
use srflow_data::micro_expression::{Classes, ClipDataset, count_classes};
use srflow_files::{read_flow, read_image, read_mask};
use srflow_render::job::{Event, Request};
use srflow_render::synth::{SynthReport, SynthSettings, synthesize};
use srflow_render::{Gestures, RenderError};

use crate::threads::on_threads;
use crate::tree::contents;

/// Small and short: the heads take longer than the frames.
fn settings() -> SynthSettings {
    SynthSettings { subjects: 1, clips: 3, side: 64, fps: 25.0, ..SynthSettings::default() }
}

fn make(settings: &SynthSettings, dir: &Path, threads: usize) -> Result<u64, RenderError> {
    let events = Mutex::new(Vec::new());
    let request = Request { on_event: &|event| events.lock().unwrap().push(event), ..Request::new(dir) };
    let report = run(settings, request, threads)?;
    let events = events.into_inner().unwrap();
    assert_eq!(events[0], Event::Started { units: report.clips, whole: report.clips - report.made });
    let made = events.iter().filter(|event| matches!(event, Event::Made { .. }));
    assert_eq!(made.count() as u64, report.made);
    Ok(report.made)
}

fn run(settings: &SynthSettings, request: Request, threads: usize) -> Result<SynthReport, RenderError> {
    on_threads(threads, || synthesize(settings, request))
}

#[test]
fn a_set_is_whole_and_the_same_however_it_is_made() {
    let folder = tempfile::tempdir().unwrap();
    let (one, two) = (folder.path().join("one"), folder.path().join("two"));
    assert_eq!(make(&settings(), &one, 1).unwrap(), 3);
    assert_eq!(make(&settings(), &two, 2).unwrap(), 3);
    let whole = contents(&one);
    assert_eq!(whole, contents(&two), "the bytes do not depend on the threads");

    // As if it had been killed during the second clip.
    fs::remove_file(one.join("s01/c02.json")).unwrap();
    fs::remove_file(one.join("s01/c02/0004.png")).unwrap();
    fs::remove_file(one.join("clips.csv")).unwrap();
    assert_eq!(make(&settings(), &one, 2).unwrap(), 1);
    assert_eq!(contents(&one), whole);
    assert_eq!(make(&settings(), &one, 2).unwrap(), 0);

    // In two shards, the second of them in two runs, with leftovers of a kill during writing.
    let three = folder.path().join("three");
    let shard = |number| Request { shard: Shard { number, of: 2 }, ..Request::new(&three) };
    let first = run(&settings(), shard(1), 2).unwrap();
    assert_eq!((first.clips, first.made, first.stopped, first.mean_flow), (1, 1, false, None));
    let second = run(&settings(), Request { stop_after: Some(1), ..shard(2) }, 2).unwrap();
    assert_eq!((second.clips, second.made, second.stopped), (2, 1, true));
    let left = three.join(if three.join("s01/c02.json").exists() { "s01/c03" } else { "s01/c02" });
    fs::write(left.join(".0001.png.7-0.partial"), "half").unwrap();
    assert!(!three.join("clips.csv").exists());
    assert_eq!(make(&settings(), &three, 2).unwrap(), 1);
    assert_eq!(contents(&three), whole);

    let dataset = ClipDataset::open(&format!("clips:{}", one.display()).parse().unwrap(), false).unwrap();
    let annotations = dataset.clips.iter().map(|clip| &clip.annotation);
    assert_eq!(count_classes(&Classes::default(), annotations), [1, 1, 1]);
    let landmarks = fs::read_to_string(one.join("landmarks.csv")).unwrap();
    assert_eq!(landmarks.lines().count(), 4);
    for clip in &dataset.clips {
        let a = &clip.annotation;
        assert!(!a.action_units.is_empty() && a.apex.is_some_and(|apex| a.onset < apex && apex < a.offset));
        assert_eq!(clip.frames.len() as u64, a.offset - a.onset + 1);
        let flow = read_flow(&one.join(format!("{}_flow.flo", a.clip))).unwrap();
        let onset = read_image(clip.frame(a.onset).unwrap()).unwrap();
        let mask = read_mask(&one.join(format!("{}_mask.png", a.clip))).unwrap();
        assert_eq!((flow.size(), onset.size(), mask.size()), (onset.size(), Size::new(64, 64), onset.size()));
        let longest = flow.pixels().iter().map(|[u, v]| u.hypot(*v)).fold(0.0, f32::max);
        assert!(longest > 0.05 && longest < 6.0, "{longest} px: a micro-expression");
    }
}

#[test]
fn without_disturbance_only_the_expression_moves() {
    let folder = tempfile::tempdir().unwrap();
    let still = SynthSettings { noise: 0.0, drift: 0.0, lighting: 0.0, clips: 1, ..settings() };
    make(&still, folder.path(), 2).unwrap();
    let dataset =
        ClipDataset::open(&format!("clips:{}", folder.path().display()).parse().unwrap(), false).unwrap();
    let clip = &dataset.clips[0];
    let frame = |number| read_image(clip.frame(number).unwrap()).unwrap();
    let a = &clip.annotation;
    let (onset, apex) = (frame(a.onset), frame(a.apex.unwrap()));
    assert_eq!(onset, frame(a.offset), "the face is back at rest");
    let flow = read_flow(&folder.path().join(format!("{}_flow.flo", a.clip))).unwrap();
    let (mut moved, mut changed_where_still) = (0, 0);
    for y in 0..64 {
        for x in 0..64 {
            let [u, v] = flow.get(x, y);
            moved += usize::from(u.hypot(v) > 0.1);
            let change = (0..3).map(|c| onset.get(x, y)[c].abs_diff(apex.get(x, y)[c])).max().unwrap();
            changed_where_still += usize::from(u.hypot(v) < 1e-4 && change > 8);
        }
    }
    assert!(moved > 20 && moved < 64 * 64 / 2, "{moved} pixels move");
    assert!(changed_where_still < 10, "{changed_where_still} pixels change without flow");
}

#[test]
fn what_moves_a_face_besides_its_expression_is_listed() {
    let folder = tempfile::tempdir().unwrap();
    let dir = folder.path();
    // The expression is invisible.
    let still = SynthSettings { drift: 0.0, noise: 0.0, lighting: 0.0, intensity: 1e-3, ..settings() };
    let gestures = Gestures { nods: 1.0, ..Gestures::default() };
    let besides = SynthSettings { blinks: 1.0, glances: 1.0, speech: 1.0, gestures, ..still };
    make(&SynthSettings { clips: 9, ..besides }, dir, 2).unwrap();
    let table = fs::read_to_string(dir.join("disturbances.csv")).unwrap();
    let rows: Vec<Vec<&str>> = table.lines().skip(1).map(|line| line.split(',').collect()).collect();
    for what in ["blink", "glance", "speech", "nod"] {
        assert!(rows.iter().any(|row| row[2] == what), "{table}");
    }
    for number in 1..=9 {
        let clip = format!("s01/c{number:02}");
        let listed: Vec<[usize; 2]> = rows
            .iter()
            .filter(|row| row[1] == clip)
            .map(|row| [row[3], row[4]].map(|frame| frame.parse().unwrap()))
            .collect();
        let count = fs::read_dir(dir.join(&clip)).unwrap().count();
        let frames: Vec<_> =
            (0..count).map(|n| read_image(&dir.join(format!("{clip}/{n:04}.png"))).unwrap()).collect();
        let changes = |n: usize| {
            let pixels = frames[n].pixels().iter().zip(frames[n + 1].pixels());
            pixels.flat_map(|(a, b)| (0..3).map(|c| a[c].abs_diff(b[c]))).max() > Some(6)
        };
        for n in 0..count - 1 {
            let moves = listed.iter().any(|&[first, last]| first <= n + 1 && n <= last);
            assert!(moves || !changes(n), "{clip}, frame {n}: {table}");
        }
        for &[first, last] in listed.iter().filter(|[first, last]| last - first > 2) {
            assert!((first..last).any(changes), "{clip}, from {first} to {last}");
        }
    }
}

#[test]
fn the_flow_is_that_of_the_head_and_that_of_the_expression() {
    let folder = tempfile::tempdir().unwrap();
    // As much drift as there can be: two motions that are each rendered alone would not add up.
    let all = SynthSettings { clips: 3, drift: 20.0, intensity: 2.5, ..settings() };
    make(&all, folder.path(), 2).unwrap();
    let part =
        |clip: &str, part: &str| read_flow(&folder.path().join(format!("s01/{clip}_{part}.flo"))).unwrap();
    for clip in ["c01", "c02", "c03"] {
        let (whole, head, expression) =
            (part(clip, "flow"), part(clip, "head_flow"), part(clip, "expression_flow"));
        let mut lengths = [0.0_f32; 2];
        for ((whole, head), expression) in whole.pixels().iter().zip(head.pixels()).zip(expression.pixels()) {
            for axis in 0..2 {
                let rest = whole[axis] - head[axis] - expression[axis];
                assert!(rest.abs() < 0.01, "{clip}: {rest} px are in neither part");
                lengths[0] = lengths[0].max(head[axis].abs());
                lengths[1] = lengths[1].max(expression[axis].abs());
            }
        }
        assert!(lengths.iter().all(|length| *length > 0.02), "{clip}: both move: {lengths:?}");
    }

    // A head that does not drift moves by its expression alone.
    let still = folder.path().join("still");
    fs::create_dir(&still).unwrap();
    make(&SynthSettings { drift: 0.0, clips: 1, ..settings() }, &still, 2).unwrap();
    let still = |part: &str| read_flow(&still.join(format!("s01/c01_{part}.flo"))).unwrap();
    assert_eq!(still("flow"), still("expression_flow"));
    assert!(still("head_flow").pixels().iter().flatten().all(|component| *component == 0.0));
}

#[test]
fn key_frames_alone_are_those_of_whole_clips() {
    let folder = tempfile::tempdir().unwrap();
    let (whole, key) = (folder.path().join("whole"), folder.path().join("key"));
    let settings = SynthSettings { clips: 1, ..settings() };
    make(&settings, &whole, 2).unwrap();
    make(&SynthSettings { only_key_frames: true, ..settings }, &key, 2).unwrap();
    let source = format!("clips:{}", key.display()).parse().unwrap();
    let dataset = ClipDataset::open(&source, true).unwrap();
    let annotation = &dataset.clips[0].annotation;
    let numbers: Vec<u64> = dataset.clips[0].frames.keys().copied().collect();
    assert_eq!(numbers, [annotation.onset, annotation.apex.unwrap()]);
    let whole = contents(&whole);
    for file in contents(&key) {
        // Records count the frames.
        if file.0.extension().is_some_and(|extension| extension != "json") {
            assert!(whole.contains(&file), "{}", file.0.display());
        }
    }
}

#[test]
fn another_folder_is_left_alone() {
    let folder = tempfile::tempdir().unwrap();
    fs::write(folder.path().join("thesis.tex"), "x").unwrap();
    let error = make(&settings(), folder.path(), 1).unwrap_err();
    assert!(matches!(error, RenderError::NotADataset { .. }), "{error}");

    let set = folder.path().join("set");
    fs::create_dir(&set).unwrap();
    fs::write(
        set.join("synth.json"),
        serde_json::to_string(&SynthSettings { seed: 9, ..settings() }).unwrap(),
    )
    .unwrap();
    let error = make(&settings(), &set, 1).unwrap_err().to_string();
    assert!(error.contains("seed 9, requested is 1") && error.contains("`force`"), "{error}");
}

#[test]
fn subjects_show_the_heads_in_turn_wherever_the_files_are() {
    let none = SynthSettings { head: Vec::new(), ..settings() };
    let error = run(&none, Request::new(Path::new("none")), 1).unwrap_err().to_string();
    assert_eq!(error, "head none: expected at least one");

    let avatar = Path::new("../../../shared/data/lam/p2-1");
    if !avatar.is_dir() {
        eprintln!("skipped: shared-data: no avatar of LAM at {}", avatar.display());
        return;
    }
    let folder = tempfile::tempdir().unwrap();
    let copy = folder.path().join("copy");
    fs::create_dir(&copy).unwrap();
    for entry in fs::read_dir(avatar).unwrap() {
        let entry = entry.unwrap();
        fs::copy(entry.path(), copy.join(entry.file_name())).unwrap();
    }
    let of = |head: &Path| SynthSettings {
        head: vec!["builtin".parse().unwrap(), format!("lam:{}", head.display()).parse().unwrap()],
        subjects: 3,
        clips: 1,
        only_key_frames: true,
        ..settings()
    };
    let dir = folder.path().join("set");
    assert_eq!(make(&of(avatar), &dir, 2).unwrap(), 3);
    assert_eq!(make(&of(&copy), &dir, 2).unwrap(), 0, "the same files at another place are the same head");
    let builtin = folder.path().join("builtin");
    make(&SynthSettings { subjects: 3, clips: 1, only_key_frames: true, ..settings() }, &builtin, 2).unwrap();
    let [ours, theirs] = [dir, builtin].map(|dir| BTreeMap::from_iter(contents(&dir)));
    let same = |subject: &str| {
        let frames = ours.iter().filter(|(file, _)| file.to_string_lossy().contains(subject));
        frames.clone().count() > 2 && frames.clone().all(|(file, bytes)| theirs.get(file) == Some(bytes))
    };
    assert_eq!(["s01", "s02", "s03"].map(same), [true, false, true]);
}
