//! Long videos are complete, independent of the number of threads, and their tables say what the frames show.

use std::fs;
use std::path::Path;

use srflow_core::Shard;
use srflow_data::micro_expression::intervals::{ExpressionKind, Interval, IntervalSource};
use srflow_files::read_image;
use srflow_render::job::Request;
use srflow_render::long::{LongReport, LongSettings, PIECE, record};

use crate::threads::on_threads;
use crate::tree::contents;

/// Two pieces of a second each at 10 frames per second: the head takes longer than the frames.
fn settings() -> LongSettings {
    LongSettings { subjects: 1, minutes: 0.1, side: 64, fps: 10.0, ..LongSettings::default() }
}

fn make(settings: &LongSettings, request: Request, threads: usize) -> LongReport {
    on_threads(threads, || record(settings, request)).unwrap()
}

fn events(dir: &Path) -> Vec<Interval> {
    let Ok(source) = dir.join("events.csv").display().to_string().parse::<IntervalSource>();
    source.read().unwrap().intervals
}

#[test]
fn a_video_is_whole_and_the_same_however_it_is_made() {
    let folder = tempfile::tempdir().unwrap();
    let (one, two) = (folder.path().join("one"), folder.path().join("two"));
    let report = make(&settings(), Request::new(&one), 1);
    assert_eq!((report.frames, report.made, report.videos), (60, 60, 1));
    let whole = contents(&one);
    make(&settings(), Request::new(&two), 2);
    assert_eq!(contents(&two), whole, "the bytes do not depend on the threads");

    fs::remove_file(one.join("s01/000060.png")).unwrap();
    fs::remove_file(one.join("events.csv")).unwrap();
    assert_eq!(make(&settings(), Request::new(&one), 2).made, u64::from(PIECE));
    assert_eq!(contents(&one), whole);

    let three = folder.path().join("three");
    let shard = |number| Request { shard: Shard { number, of: 2 }, ..Request::new(&three) };
    assert_eq!(make(&settings(), shard(2), 1).events, None, "the first half is missing");
    assert!(make(&settings(), shard(1), 1).events.is_some());
    assert_eq!(contents(&three), whole);
}

#[test]
fn the_face_moves_where_the_table_has_an_expression() {
    let folder = tempfile::tempdir().unwrap();
    let still = LongSettings {
        minutes: 0.5,
        noise: 0.0,
        drift: 0.0,
        lighting: 0.0,
        blinks: 0.0,
        glances: 0.0,
        speech: 0.0,
        ..settings()
    };
    make(&still, Request::new(folder.path()), 2);
    let frame = |number: i64| read_image(&folder.path().join(format!("s01/{number:06}.png"))).unwrap();
    let events = events(folder.path());
    assert!(events.iter().any(|event| event.kind == ExpressionKind::Micro), "{events:?}");
    let at_rest = frame(1);
    for event in &events {
        let apex = event.apex.unwrap();
        assert!(event.onset < apex && apex < event.offset);
        let short = (event.offset - event.onset) as f32 <= 0.5 * still.fps;
        assert_eq!(event.kind == ExpressionKind::Micro, short, "{event:?}");
        assert_eq!(frame(event.onset), at_rest);
        assert_ne!(frame(apex), at_rest);
        assert_eq!(frame(event.offset), at_rest);
        assert!(!event.action_units.is_empty() && !event.label.is_empty());
    }
    let disturbances = fs::read_to_string(folder.path().join("disturbances.csv")).unwrap();
    assert_eq!(disturbances, "video,what,first,last\n", "none was asked for");
}
