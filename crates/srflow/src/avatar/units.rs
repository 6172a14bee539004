//! Action units of head models.

use std::fmt;
use std::path::PathBuf;

use anyhow::Context as _;
use serde::{Deserialize, Serialize};
use srflow_avatar::HeadSource;
use srflow_head::{Look, Side, UnitQuality, unit_qualities, write_units};
use srflow_report::{Column, Row, Table};

use super::mesh::default_seed;
use crate::clap::Args;
use crate::output::{ensure_extension, ensure_free, write_tables};
use crate::{Job, Report, Watch};

/// Show how well a head model does each action unit, and write its table of units
///
/// Each unit is compared with that of the built-in head, whose deformation is carried onto the model by a smooth map between the
/// landmarks. The percentages measure the difference: 0 is identical motion, 100 is as far off as no motion. The cosine compares
/// the directions alone.
///
/// If action_units.json is beside a model, its units replace the model's own.
#[derive(Args, Debug, Clone, PartialEq, Serialize, Deserialize)]
#[command(after_help = "Examples:
  srflow avatar units --model flame:flame2023.pkl
  srflow avatar units --model gnm:gnm_head.npz -o action_units.json")]
pub struct UnitsJob {
    /// Head model
    #[arg(long, value_name = "KIND:PATH", help = crate::render::head_help())]
    pub model: HeadSource,
    /// Seed of a built-in head
    #[arg(long, value_name = "N", default_value_t = default_seed())]
    #[serde(default = "default_seed")]
    pub seed: u64,
    /// Table to write (.json): expression weights and joint rotations of each unit
    #[arg(short, long, value_name = "FILE")]
    #[serde(default)]
    pub output: Option<PathBuf>,
    /// Overwrite the file
    #[arg(long)]
    #[serde(default)]
    pub force: bool,
}

impl Job for UnitsJob {
    const NAME: &'static str = "avatar units";

    type Report = UnitsReport;

    fn work(&self, _watch: &Watch) -> anyhow::Result<UnitsReport> {
        if let Some(output) = &self.output {
            ensure_extension(output, "json")?;
            ensure_free([output], self.force)?;
        }
        let model = self.model.model(self.seed).with_context(|| format!("reading {}", self.model))?;
        let qualities = unit_qualities(&model, Look::default());
        if let Some(output) = &self.output {
            write_units(output, &model, &qualities)?;
        }
        let unit = |unit: &UnitQuality| UnitReport {
            cosine_at_landmarks: unit.left.map(|left| left.cosine),
            left_at_landmarks: unit.left.map(|left| left.landmarks),
            left_on_skin: unit.left.map(|left| left.skin),
            motion_mm: 1e3 * unit.motion,
            number: unit.number,
            side: unit.side,
        };
        Ok(UnitsReport {
            listed: model.action_units.len(),
            units: qualities.iter().map(unit).collect(),
            model: model.name,
        })
    }
}

/// How well a model shows the action units of the built-in head.
#[derive(Debug, Clone, Serialize)]
pub struct UnitsReport {
    /// Number of the model's own units.
    pub listed: usize,
    pub model: String,
    pub units: Vec<UnitReport>,
}

/// An action unit of the built-in head. The shares say how much of its motion remains; they are `None` where the model lacks the unit.
#[derive(Debug, Clone, Serialize)]
pub struct UnitReport {
    /// Between the displacements of the 68 landmarks: 1 where the motions differ in strength alone.
    pub cosine_at_landmarks: Option<f64>,
    pub left_at_landmarks: Option<f64>,
    pub left_on_skin: Option<f64>,
    /// Root mean square over the skin at full intensity.
    pub motion_mm: f64,
    pub number: u8,
    pub side: Side,
}

impl Report for UnitsReport {}

impl fmt::Display for UnitsReport {
    fn fmt(&self, f: &mut fmt::Formatter) -> fmt::Result {
        write_tables(f, &[table(self)])
    }
}

fn table(UnitsReport { listed, units, .. }: &UnitsReport) -> Table {
    let row = |unit: &UnitReport| {
        let side = match unit.side {
            Side::Both => "",
            Side::Left => " left",
            Side::Right => " right",
        };
        let percent = |share: Option<f64>| share.map(|share| 100.0 * share);
        let [skin, landmarks] = [unit.left_on_skin, unit.left_at_landmarks].map(percent);
        let values = vec![Some(unit.motion_mm), skin, landmarks, unit.cosine_at_landmarks];
        Row { name: format!("AU {}{side}", unit.number), values, baseline: false }
    };
    let mut rows: Vec<Row> = units.iter().map(row).collect();
    let shown = units.iter().filter(|unit| unit.left_on_skin.is_some()).count();
    if shown > 0 {
        let mean = |column: usize| {
            let sum: f64 = rows.iter().filter_map(|row| row.values[column]).sum();
            Some(sum / rows.iter().filter(|row| row.values[column].is_some()).count() as f64)
        };
        let values = (0..4).map(mean).collect();
        rows.push(Row { name: "mean".to_owned(), values, baseline: false });
    }
    let compared = match units.len() {
        0 => "The model has no landmarks, so its units cannot be compared with those of the built-in head."
            .to_owned(),
        all => format!(
            "The model shows {shown} of the {all} units of the built-in head. Motion: root mean square over the skin at full intensity. \
             Remaining: length of the difference relative to the length of the motion. Cosine: 1 where only the strength differs."
        ),
    };
    Table {
        title: format!("Action units (in the model: {listed})"),
        columns: vec![
            Column::plain("motion_mm", "motion, mm", 2),
            Column::plain("left_on_skin", "% remaining on the skin", 0),
            Column::plain("left_at_landmarks", "% remaining at the landmarks", 0),
            Column::plain("cosine_at_landmarks", "cosine at the landmarks", 2),
        ],
        rows,
        notes: vec![compared],
        ..Table::default()
    }
}
