//! The page of classified expressions.

use std::path::Path;

use srflow_core::resize::resize_image_antialiased;
use srflow_core::{FlowField, Image, Size, flow_colors, longest_flow};
use srflow_files::write_file;
use srflow_mer::{Channel, FEATURE_SIDE, Features, ModelCard};
use srflow_report::html::{Page, Picture, PictureError, Section, Strip, facts, strips, tiles, wheel_legend};

use super::classified::{Classified, Pictures, Seen};

/// More expressions are in the table alone.
const MOST_SHOWN: usize = 60;
/// Side of a picture, in pixels.
const SIDE: usize = 160;
/// The colours of flow are scaled to this length at least, in pixels of the feature map, so that noise stays pale.
const LEAST_FLOW: f32 = 0.5;

/// Writes the page.
///
/// # Errors
/// When a picture cannot be encoded, or the file cannot be written.
pub fn write(path: &Path, card: &ModelCard, classified: &[Seen]) -> anyhow::Result<()> {
    let mut numbers = vec![(classified.len().to_string(), "expressions".to_owned())];
    for class in &card.classes {
        let count =
            classified.iter().filter(|(expression, _)| expression.class.as_ref() == Some(class)).count();
        numbers.push((count.to_string(), class.clone()));
    }
    let unknown = classified.iter().filter(|(expression, _)| expression.class.is_none()).count();
    numbers.push((unknown.to_string(), "unknown".to_owned()));

    let pictured =
        || classified.iter().filter_map(|(of, pictures)| Some((of, pictures.as_ref()?))).take(MOST_SHOWN);
    let longest = pictured().map(|(_, pictures)| longest_flow(&flow_of(&pictures.features)));
    let scale = longest.fold(LEAST_FLOW, f32::max);
    let shown = pictured().map(|(of, pictures)| strip(of, pictures, scale)).collect::<Result<Vec<_>, _>>()?;
    let more = classified.len().saturating_sub(shown.len());
    let caption = match more {
        0 => String::new(),
        more => format!("{more} more are in the table predictions.csv."),
    };
    let note = match card.note.is_empty() {
        true => "Check every result by eye. A micro-expression is not evidence of lying.".to_owned(),
        false => {
            format!("{} Check every result by eye. A micro-expression is not evidence of lying.", card.note)
        }
    };
    let expressions = vec![
        wheel_legend(
            f64::from(scale),
            "Motion from onset to apex without that of the head, in pixels of 112x112",
        )?,
        strips(&shown, 420, &caption),
    ];
    let page = Page {
        title: "Classified expressions".to_owned(),
        kicker: "Micro-expressions".to_owned(),
        lead: note,
        opening: vec![tiles(&numbers)],
        sections: vec![
            Section::new("Expressions", "Onset, apex, and the motion between them.", expressions),
            Section::new("Model", "What the classifier learned from.", vec![facts(&about(card))]),
        ],
        colophon: format!("Trained with srflow {} on {}.", card.srflow_version, card.date),
    };
    Ok(write_file(path, page.html())?)
}

fn strip(expression: &Classified, pictures: &Pictures, scale: f32) -> Result<Strip, PictureError> {
    let picture = |image: &Image, alt: &str| {
        Picture::jpeg(&resize_image_antialiased(image, Size::new(SIDE, SIDE)), alt)
    };
    let flow = flow_colors(&flow_of(&pictures.features), Some(scale));
    let percent = |probability: &f64| (100.0 * probability).round();
    let class = expression.class.clone().unwrap_or_else(|| "unknown".to_owned());
    let probability = expression.probabilities.iter().copied().fold(0.0, f64::max);
    let title = match &expression.doubt {
        None => format!("{class}, {} %", percent(&probability)),
        Some(doubt) => format!("unknown: {doubt}"),
    };
    let kind = expression.kind.map(|kind| format!(", {kind}")).unwrap_or_default();
    let truth = expression.truth.as_ref().map(|truth| format!(", annotated as {truth}")).unwrap_or_default();
    Ok(Strip {
        title,
        note: format!("{}{kind}{truth}", expression.place()),
        pictures: vec![
            (picture(&pictures.onset, "Onset")?, format!("frame {}", expression.onset)),
            (picture(&pictures.apex, "Apex")?, format!("frame {}", expression.apex)),
            (picture(&flow, "Motion")?, "motion".to_owned()),
        ],
    })
}

fn flow_of(features: &Features) -> FlowField {
    let [u, v] = [Channel::U, Channel::V].map(|channel| features.channel(channel));
    FlowField::from_fn(FEATURE_SIDE, FEATURE_SIDE, |x, y| {
        let place = y * FEATURE_SIDE + x;
        [u[place], v[place]]
    })
}

/// The model in words.
fn about(card: &ModelCard) -> Vec<(String, String)> {
    let data = card
        .data
        .iter()
        .map(|data| format!("{}: {} clips of {} subjects", data.dataset, data.clips, data.subjects));
    let held_out = card.held_out;
    let share = |part: usize, of: usize| match of {
        0 => "none".to_owned(),
        of => format!("{part} of {of} ({:.0} %)", 100.0 * part as f64 / of as f64),
    };
    let pairs = [
        ("Trained on", data.collect::<Vec<_>>().join("; ")),
        ("Classifier", card.classifier.facts.title.to_owned()),
        ("Flow", format!("{}, {}", card.flow.method, card.features)),
        ("Faces", card.faces.clone()),
        ("Right about subjects that were left out", share(held_out.right, held_out.clips)),
        ("Of those with a probability of a half and more", share(held_out.sure_and_right, held_out.sure)),
    ];
    pairs.map(|(name, value)| (name.to_owned(), value)).into()
}
