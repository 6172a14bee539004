//! A run over clips on disk: what it reports and what it keeps.

use std::io::Read as _;
use std::path::Path;
use std::sync::Mutex;
use std::sync::atomic::{AtomicBool, Ordering};

use srflow_core::{EstimateError, FlowEstimator, FlowField, Image};
use srflow_data::micro_expression::{Classes, ClipDataset, ClipSource};
use srflow_eval::MethodRecord;
use srflow_files::write_image_png;
use srflow_mer::{
    ApexRule, FeatureRecipe, Preparation, Protocol, RecognitionProtocol, Regions, RunError, RunEvent,
    RunFolders, RunMethod, RunResults, RunSettings, RunWatch, Sets, compute_features, run, write_features,
};

/// A flow from the brightness of the second picture.
struct Brightness;

impl FlowEstimator for Brightness {
    fn name(&self) -> &str {
        "brightness"
    }

    fn estimate(&self, _: &Image, second: &Image) -> Result<FlowField, EstimateError> {
        Ok(FlowField::from_fn(second.width(), second.height(), |x, y| {
            [f32::from(second.get(x, y)[0]) * x as f32 * 1e-4, 0.0]
        }))
    }
}

/// Clips of this many subjects, two each, without a known apex.
fn dataset(folder: &Path, subjects: usize) -> ClipDataset {
    let mut lines = vec!["clip,subject,onset,apex,offset,class".to_owned()];
    for (subject, class) in
        (0..subjects).flat_map(|subject| ["negative", "surprise"].map(|class| (subject, class)))
    {
        let clip = format!("{subject}-{class}");
        std::fs::create_dir_all(folder.join(&clip)).unwrap();
        for (frame, grey) in [(1, 0), (2, 200), (3, 90)] {
            let image = Image::from_fn(24, 20, |x, _| [grey + (x + subject) as u8; 3]);
            write_image_png(&folder.join(&clip).join(format!("{frame}.png")), &image).unwrap();
        }
        lines.push(format!("{clip},{subject},1,,3,{class}"));
    }
    std::fs::write(folder.join("clips.csv"), lines.join("\n")).unwrap();
    let source: ClipSource = format!("clips:{}", folder.display()).parse().unwrap();
    ClipDataset::open(&source, false).unwrap()
}

fn settings() -> RunSettings {
    RunSettings {
        recognition: RecognitionProtocol::Srflow,
        classifier: "ststnet".parse().unwrap(),
        sets: Sets::Both,
        apex: Some(ApexRule::Strain),
        preparation: Preparation::default(),
        protocol: Protocol { epochs: 2, record_every: 1, ..Protocol::default() },
        classes: Classes::default().names().clone(),
        left_out: Vec::new(),
    }
}

fn record() -> MethodRecord {
    MethodRecord {
        name: "brightness".into(),
        method: "brightness",
        parameters: String::new(),
        weights: None,
        sha256: None,
        iterations: None,
        still_px: None,
        device: None,
        identity: "brightness".into(),
    }
}

fn run_in(
    folder: &Path,
    datasets: Vec<ClipDataset>,
    on_event: &(dyn Fn(RunEvent) + Sync),
) -> Result<RunResults, RunError> {
    let folders = RunFolders { features: &folder.join("features"), folds: &folder.join("folds") };
    let watch = RunWatch { on_event, stop: &|| false };
    run(datasets, vec![RunMethod { estimator: &Brightness, record: record() }], settings(), folders, watch)
}

#[test]
fn events_reach_the_announced_counts_and_a_second_run_computes_nothing() {
    let folder = tempfile::tempdir().unwrap();
    let [first, second] = ["first", "second"].map(|name| folder.path().join(name));
    let datasets = || vec![dataset(&first, 3), dataset(&second, 2)];
    let run = || {
        // Clips announced and done; clip epochs announced, trained and resumed.
        let counts = Mutex::new([0_u64; 5]);
        let results = run_in(folder.path(), datasets(), &|event| {
            let mut counts = counts.lock().unwrap();
            match event {
                RunEvent::Apexes { clips } | RunEvent::Features { clips, .. } => counts[0] += clips as u64,
                RunEvent::Clip => counts[1] += 1,
                RunEvent::Training { clip_epochs } => counts[2] += clip_epochs,
                RunEvent::Trained { clip_epochs } => counts[3] += clip_epochs,
                RunEvent::Resumed { clip_epochs } => counts[4] += clip_epochs,
                RunEvent::Folds { .. } => {}
            }
        });
        (results.unwrap(), counts.into_inner().unwrap())
    };
    // Six and four clips: every one is learned from once in each epoch for each other subject of its set.
    let expected = (6 * 2 + 4 + 10 * 4) * 2;
    let (results, counts) = run();
    assert_eq!(counts, [20, 20, expected, expected, 0]);
    let sets: Vec<&str> = results.trials.iter().map(|trial| trial.set.as_str()).collect();
    assert_eq!(sets, ["first", "second", "composite"]);
    assert_eq!(results.features.data.iter().map(|data| data.spotted_apexes).collect::<Vec<_>>(), [6, 4]);
    assert!(results.features.clips.iter().all(|clip| clip.annotation.apex == Some(2)));

    let (again, counts) = run();
    assert_eq!(counts, [20, 20, expected, 0, expected]);
    assert_eq!(again.trials, results.trials);
}

#[test]
fn a_stopped_run_continues() {
    let folder = tempfile::tempdir().unwrap();
    let datasets = || vec![dataset(&folder.path().join("data"), 3)];
    let begun = AtomicBool::new(false);
    let on_event =
        |event: RunEvent| _ = begun.fetch_or(matches!(event, RunEvent::Trained { .. }), Ordering::Relaxed);
    let stop = || begun.load(Ordering::Relaxed);
    let folders =
        RunFolders { features: &folder.path().join("features"), folds: &folder.path().join("folds") };
    let method = RunMethod { estimator: &Brightness, record: record() };
    let watch = RunWatch { on_event: &on_event, stop: &stop };
    let stopped = run(datasets(), vec![method], settings(), folders, watch);
    assert!(matches!(stopped, Err(RunError::Stopped)));
    assert_eq!(run_in(folder.path(), datasets(), &|_| ()).unwrap().trials.len(), 1);
}

#[test]
fn a_set_that_nobody_can_be_left_out_of_is_named() {
    let folder = tempfile::tempdir().unwrap();
    let alone = dataset(&folder.path().join("alone"), 1);
    let error = run_in(folder.path(), vec![alone], &|_| ()).unwrap_err().to_string();
    assert_eq!(error, "alone: leaving one subject out needs clips of at least 2 subjects; found 1");
}

#[test]
fn features_are_written_for_numpy() {
    let folder = tempfile::tempdir().unwrap();
    let datasets = vec![dataset(&folder.path().join("first"), 2), dataset(&folder.path().join("second"), 1)];
    let record = record();
    let methods = [RunMethod { estimator: &Brightness, record: record.clone() }];
    let preparation = Preparation::default();
    let rule = Some(ApexRule::Strain);
    let watch = RunWatch { on_event: &|_| (), stop: &|| false };
    let set = compute_features(datasets, &methods, rule, &preparation, None, watch).unwrap();
    let path = folder.path().join("features.npz");
    let classes = Classes::default();
    let recipe = FeatureRecipe {
        classes: classes.names(),
        methods: std::slice::from_ref(&record),
        preparation: &preparation,
        apex: rule,
        regions: Some(Regions::Mdmo),
    };
    write_features(&path, &set, &recipe).unwrap();

    let mut archive = zip::ZipArchive::new(std::fs::File::open(&path).unwrap()).unwrap();
    let mut array = |name: &str| {
        let mut bytes = Vec::new();
        archive.by_name(&format!("{name}.npy")).unwrap().read_to_end(&mut bytes).unwrap();
        let header = 10 + usize::from(u16::from_le_bytes([bytes[8], bytes[9]]));
        (String::from_utf8_lossy(&bytes[10..header]).into_owned(), bytes.split_off(header))
    };
    let text = |bytes: &[u8]| -> String {
        let points = bytes.as_chunks::<4>().0.iter().map(|point| u32::from_le_bytes(*point));
        points.map(|point| char::from_u32(point).unwrap()).filter(|c| *c != '\0').collect()
    };
    let (header, values) = array("X");
    assert!(header.contains("'<f4'") && header.contains("(6, 3, 112, 112)"), "{header}");
    let first: Vec<u8> = set.samples[0].1[0].features.values().iter().flat_map(|x| x.to_le_bytes()).collect();
    assert!(values[..first.len()] == first);
    assert_eq!(array("y").1, [0_i64, 2, 0, 2, 0, 2].map(i64::to_le_bytes).concat());
    assert_eq!(text(&array("dataset").1), "firstfirstfirstfirstsecondsecond");
    assert_eq!(text(&array("subject").1), "001100");
    assert_eq!(text(&array("names").1), "negativepositivesurprise");
    assert!(array("clip").0.contains("'<U10'"), "0-negative");
    assert_eq!(text(&array("action_units").1), "");
    assert_eq!(array("apex").1, [2_i64; 6].map(i64::to_le_bytes).concat());
    assert_eq!(array("apex_spotted").1, [1_i64; 6].map(i64::to_le_bytes).concat());
    let (header, moved) = array("head_motion");
    assert!(header.contains("(6, 5)"), "{header}");
    let motion = set.samples[0].1[0].head_motion.expect("it is subtracted by default").values();
    assert!(moved.starts_with(&motion.map(|value| (value as f32).to_le_bytes()).concat()));
    let (header, regions) = array("regions");
    assert!(header.contains("(6, 36, 5)"), "{header}");
    let map = Regions::Mdmo.map(&srflow_face::AVERAGE_FACE);
    let first = map.flow(&set.samples[0].1[0].features)[0].expect("the brow is seen");
    assert!(
        regions.starts_with(&[first.mean[0], first.mean[1], first.strain].map(f32::to_le_bytes).concat())
    );
    assert!(array("region_map").0.contains("(6, 112, 112)") && array("units").0.contains("(6, 14)"));
    assert!(text(&array("region_names").1).starts_with("123"));
    let (header, json) = array("parameters");
    assert!(header.contains("'shape': ()"), "{header}");
    let json: serde_json::Value = serde_json::from_str(&text(&json)).unwrap();
    assert_eq!((&json["data"][1]["spotted_apexes"], &json["apex"]), (&2.into(), &"strain".into()));
    assert_eq!(json["methods"][0]["name"], "brightness");
}
