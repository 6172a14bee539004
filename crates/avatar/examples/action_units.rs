//! How well a head model shows the action units of the built-in head, as a Markdown table: `cargo run --release -p srflow-avatar
//! --example action_units -- flame:flame2023.pkl`, or any other `KIND:PATH` of `--head`.
//!
//! Compares the displacements of the 68 landmarks by each unit at full strength, which are scaled by the distance between the eyes. The
//! units of FLAME and GNM are fitted to these landmarks when their files are read.

use std::error::Error;

use glam::Vec3;
use srflow_avatar::{HeadModel, HeadPose, HeadSource};

fn main() -> Result<(), Box<dyn Error>> {
    let name = std::env::args().nth(1).ok_or("give a head model, such as flame:flame2023.pkl")?;
    let source: HeadSource = name.parse()?;
    let (reference, model) = (HeadModel::builtin_average(), source.model(1)?);
    let scale = eye_distance(&model)? / eye_distance(&reference)?;
    println!("| action unit | side | mean motion, mm | share that remains |\n|--:|---|--:|--:|");
    let (mut sum, mut count) = (0.0, 0);
    for unit in &reference.action_units {
        let units = [(unit.number, unit.side, 1.0)];
        let wanted: Vec<Vec3> =
            displacements(&reference, &reference.pose_of_action_units(&units)?).map(|d| d * scale).collect();
        let length = |moved: &[Vec3]| moved.iter().map(|d| d.length_squared()).sum::<f32>().sqrt();
        let mean = wanted.iter().map(|d| d.length()).sum::<f32>() / wanted.len() as f32;
        let left = match model.pose_of_action_units(&units) {
            Ok(pose) => {
                let found = displacements(&model, &pose);
                let left: Vec<Vec3> = found.zip(&wanted).map(|(found, wanted)| found - *wanted).collect();
                let share = length(&left) / length(&wanted);
                sum += share;
                count += 1;
                format!("{:.0} %", 100.0 * share)
            }
            Err(_) => "not shown".to_owned(),
        };
        println!("| {} | {:?} | {:.2} | {left} |", unit.number, unit.side, 1000.0 * mean);
    }
    println!(
        "\n{count} of {} units, {:.0} % remains on average",
        reference.action_units.len(),
        100.0 * sum / count as f32
    );
    Ok(())
}

/// From the head at rest, metres.
fn displacements(model: &HeadModel, pose: &HeadPose) -> impl Iterator<Item = Vec3> {
    let shaped = model.shaped(&[]);
    let points = |pose: &HeadPose| {
        let mut vertices = Vec::new();
        model.vertices(&shaped, pose, &mut vertices);
        model.landmarks_on(&vertices).take(68).collect::<Vec<Vec3>>()
    };
    points(pose).into_iter().zip(points(&HeadPose::default())).map(|(moved, rest)| moved - rest)
}

fn eye_distance(model: &HeadModel) -> Result<f32, &'static str> {
    let [left, right] = model.eye_centres(&model.shaped(&[])).ok_or("the head model has no eyes")?;
    Ok(left.distance(right))
}
