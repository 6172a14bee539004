//! Accuracy of the fit on made-up captures, as a Markdown table: `cargo run --release -p srflow-avatar --example fit_accuracy
//! [FaceXModel] [--long]`. Errors are those of all vertices of the face, against parameters that are known.

#[path = "../tests/synthetic/mod.rs"]
mod synthetic;

use std::path::PathBuf;

use srflow_avatar::HeadSource;
use srflow_avatar::fit::{FitOptions, fit};
use srflow_head::HeadModel;
use synthetic::{Capture, capture, errors};

const PEOPLE: u64 = 3;

/// Timesteps with `--long`.
const LONG: usize = 1000;

fn main() {
    println!(
        "| head | cameras | noise, px | outliers, missing | error, mm | in place, mm | found noise, px | s |"
    );
    println!("|---|--:|--:|---|--:|--:|--:|--:|");
    let average = HeadModel::builtin_average();
    let mut rows: Vec<(&str, Vec<HeadModel>, HeadModel)> = vec![
        ("built-in, average and traits", vec![average.clone()], average.clone()),
        ("built-in, other persons", (1..=PEOPLE).map(HeadModel::builtin).collect(), average),
    ];
    if let Some(folder) = std::env::args_os().skip(1).find(|argument| argument != "--long").map(PathBuf::from)
    {
        let source: HeadSource = format!("ict:{}", folder.display()).parse().expect("a head");
        let ict = source.model(1).expect("ICT-FaceKit");
        rows.push(("ICT-FaceKit", vec![ict.clone()], ict));
    }
    for (name, truths, model) in &rows {
        let everything = Capture {
            seed: 0,
            cameras: 4,
            timesteps: LONG,
            noise: 1.0,
            outliers: 0.05,
            missing: 0.1,
            offsets: 0.0,
        };
        if std::env::args().any(|argument| argument == "--long") {
            measure(name, truths, model, everything);
            continue;
        }
        for cameras in [16, 4, 1] {
            for (noise, bad) in [(0.0, false), (0.5, false), (1.0, false), (2.0, false), (1.0, true)] {
                let (outliers, missing) = if bad { (0.05, 0.1) } else { (0.0, 0.0) };
                measure(
                    name,
                    truths,
                    model,
                    Capture { cameras, timesteps: 25, noise, outliers, missing, ..everything },
                );
            }
        }
    }
}

fn measure(name: &str, truths: &[HeadModel], model: &HeadModel, made: Capture) {
    let Capture { cameras, noise, outliers, .. } = made;
    let (mut sums, mut found, mut seconds) = ([0.0; 2], 0.0, 0.0);
    for seed in 0..PEOPLE {
        let truth = &truths[seed as usize % truths.len()];
        let (views, states) = capture(truth, Capture { seed: 100 + seed, ..made });
        let start = std::time::Instant::now();
        let fit = fit(model, &views, None, &FitOptions::default(), |_, _, _| ()).expect("a fit");
        seconds += start.elapsed().as_secs_f64();
        found += fit.report.noise;
        for (sum, error) in sums.iter_mut().zip(errors((truth, &states), (model, &fit.states))) {
            *sum += error;
        }
    }
    let people = PEOPLE as f64;
    let [world, place] = sums.map(|sum| sum / people);
    let wrong = if outliers > 0.0 { "5 %, 10 %" } else { "none" };
    println!(
        "| {name} | {cameras} | {noise} | {wrong} | {world:.2} | {place:.2} | {:.2} | {:.1} |",
        found / people,
        seconds / people
    );
}
