//! The report of an avatar from a video.

use std::path::Path;

use glam::{EulerRot, Quat};
use serde_json::Value;
use srflow_core::{Image, Plane};
use srflow_head::PoseParameters;
use srflow_report::html::{Film, Page, Section, facts, films, tiles};
use srflow_report::shrink_image;

use super::motion::MotionScores;
use super::scores::FaceScores;
use super::{FittedHead, VideoRecord, focal_text};
use crate::avatar::mesh_picture::overlay;
use crate::avatar::train::TrainedAvatar;
use crate::machine;

/// Frames of a film.
pub const FRAMES: usize = 24;

/// Most width of a frame of a film, pixels: together they may not be wider than a JPEG can be.
const WIDTH: usize = 480;

/// A turn of the head that shows a side of it, degrees.
const WIDE_TURN: f32 = 20.0;

/// An opening of the jaw that shows teeth, degrees.
const WIDE_JAW: f32 = 6.0;

/// The page.
///
/// # Errors
/// When a file of the run cannot be read, or a picture cannot be encoded.
pub fn page(
    video: &Path,
    record: &VideoRecord,
    head: &FittedHead,
    trained: &TrainedAvatar,
    (face, motion): (Option<&FaceScores>, Option<&MotionScores>),
) -> anyhow::Result<Page> {
    let FittedHead { capture, poses, report: fit, .. } = head;
    let shown: Vec<usize> = (0..poses.len()).step_by(poses.len().div_ceil(FRAMES).max(1)).collect();
    let mut overlays = Vec::new();
    let mut cut_out = Vec::new();
    for &place in &shown {
        let view = &capture.views()[place];
        let image = capture.image(view)?;
        overlays.push(shrink_image(&overlay(&image, &head.shading(place)), WIDTH));
        if let Some(mask) = capture.mask(view)? {
            cut_out.push(shrink_image(&over_white(&image, &mask), WIDTH));
        }
    }
    let mut shown_films = vec![Film::new(
        &overlays,
        "The fitted head",
        "Blue, over the frames. It should follow eyes, mouth and jaw.",
    )?];
    if !cut_out.is_empty() {
        shown_films.push(Film::new(&cut_out, "What is learned", "The frames, cut out by their masks.")?);
    }
    let number = |key: &str| fit.pointer(key).and_then(Value::as_f64).unwrap_or(f64::NAN);
    let mut known = vec![
        ("focal length".to_owned(), focal_text(record.focal, record.focal_source)),
        ("noise of the landmarks".to_owned(), format!("{:.2} px", number("/noise"))),
        (
            "distance between the outer corners of the eyes".to_owned(),
            format!(
                "{:.1} mm, known to {:.1} mm",
                1e3 * number("/reach/eye_corners/0"),
                1e3 * number("/reach/eye_corners/1")
            ),
        ),
        ("place of the head in depth".to_owned(), format!("known to {:.0} mm", 1e3 * number("/reach/depth"))),
        (
            "largest identity weight".to_owned(),
            format!("{:.1} standard deviations", number("/reach/largest_identity")),
        ),
    ];
    if let Some(agreement) = fit.pointer("/pictures") {
        let share = |key: &str| 100.0 * agreement.get(key).and_then(Value::as_f64).unwrap_or(f64::NAN);
        let text = format!("{:.1} %, {:.1} % by the landmarks alone", share("noise"), share("noise_before"));
        known.push(("difference between colours of the skin".to_owned(), text));
    }
    if let Some(MotionScores { pairs, distance, length }) = motion {
        let text = format!(
            "{distance:.2} px, where the face moves {length:.2} px; medians over {pairs} held-out frames"
        );
        known.push(("distance from the flow measured in the video".to_owned(), text));
    }
    let reach = Motion::of(poses);
    known.extend(reach.facts());
    if head.hidden() > 0 {
        let text = format!("{} frames", head.hidden());
        known.push(("left out, since something hides the face".to_owned(), text));
    }
    let mut numbers = vec![
        (record.chosen.to_string(), format!("of {} frames", record.frames)),
        (trained.gaussians.to_string(), "Gaussians".to_owned()),
    ];
    let mut sections = vec![
        Section::new(
            "The fit",
            "If the surface slides over the face, or the masks cut hair off or keep the background, the avatar has learned \
             that too. Film again, closer and more slowly, or give the focal length.",
            vec![films(&shown_films, 6.0, "")],
        ),
        Section::new("What is known", "Uncertainties are standard deviations.", vec![facts(&known)]),
    ];
    if let Some(FaceScores { psnr, shown }) = face {
        numbers.push((format!("{psnr:.2} dB"), "PSNR on the face, held-out frames".to_owned()));
        let shown: Vec<Image> = shown.iter().map(|pair| shrink_image(pair, 2 * WIDTH)).collect();
        let film =
            Film::new(&shown, "Not trained on", "Left the frames, right the avatar with the fitted pose.")?;
        let about = "One frame of eight was held out. Long hair does not follow the head, and is blurred.";
        sections.insert(0, Section::new("The avatar", about, vec![films(&[film], 3.0, "")]));
    }
    Ok(Page {
        title: "An avatar from a video".to_owned(),
        kicker: "srflow avatar from-video".to_owned(),
        lead: format!("{}. {}", video.display(), reach.advice()),
        opening: vec![tiles(&numbers)],
        sections,
        colophon: format!("Made by srflow {} on {}.", env!("CARGO_PKG_VERSION"), machine::describe()),
    })
}

fn over_white(image: &Image, alpha: &Plane) -> Image {
    Image::from_fn(image.width(), image.height(), |x, y| {
        let (pixel, alpha) = (image.get(x, y), alpha.get(x, y));
        pixel.map(|level| (f32::from(level) * alpha + 255.0 * (1.0 - alpha)).round() as u8)
    })
}

/// How far the head and the jaw moved in the video, degrees.
struct Motion {
    yaw: [f32; 2],
    pitch: [f32; 2],
    jaw: f32,
}

impl Motion {
    fn of(poses: &[PoseParameters]) -> Self {
        let turns = poses.iter().map(|pose| {
            let turn = Quat::from_scaled_axis(pose.rotation) * Quat::from_scaled_axis(pose.neck);
            let (yaw, pitch, _) = turn.to_euler(EulerRot::YXZ);
            [yaw.to_degrees(), pitch.to_degrees()]
        });
        let turns: Vec<[f32; 2]> = turns.collect();
        let range = |axis: usize| {
            let of_axis = || turns.iter().map(|turn| turn[axis]);
            [of_axis().fold(f32::INFINITY, f32::min), of_axis().fold(f32::NEG_INFINITY, f32::max)]
        };
        let jaw = poses.iter().map(|pose| pose.jaw.length().to_degrees()).fold(0.0, f32::max);
        Self { yaw: range(0), pitch: range(1), jaw }
    }

    fn facts(&self) -> [(String, String); 3] {
        let range = |[low, high]: [f32; 2]| format!("{low:.0} to {high:.0} degrees");
        [
            ("turns to the sides".to_owned(), range(self.yaw)),
            ("turns up and down".to_owned(), range(self.pitch)),
            ("largest opening of the jaw".to_owned(), format!("{:.0} degrees", self.jaw)),
        ]
    }

    /// What the avatar is good for, as far as the motion tells.
    fn advice(&self) -> String {
        let [left, right] = self.yaw;
        let sides = match (left < -WIDE_TURN, right > WIDE_TURN) {
            (true, true) => "The video shows both sides of the head.",
            _ => {
                "The video shows the head mostly from the front: render it from there, since its sides are guessed."
            }
        };
        let mouth = match self.jaw > WIDE_JAW {
            true => "The mouth opens in it.",
            false => "The mouth hardly opens in it: its inside is guessed.",
        };
        format!("{sides} {mouth}")
    }
}
