use std::path::PathBuf;

use anyhow::Context as _;
use clap::Args;
use serde_json::json;
use srflow_avatar::{HeadSource, Side, UnitQuality, unit_qualities, write_units};
use srflow_eval::{Column, Row, Table};

use crate::Context;
use crate::output::{ensure_extension, ensure_free, print_json, print_tables};
use srflow::render::head_help;

/// Show how well a head model does each action unit, and write its table of units
///
/// Each unit is compared with that of the built-in head, whose deformation is carried onto the model by a smooth map between the
/// landmarks. The shares say how much of the motion remains: 0 is the same motion, 1 as good as none.
///
/// A table called action_units.json beside a model is read with it, instead of the units that the model would have.
#[derive(Args)]
#[command(after_help = "Examples:
  srflow avatar units --model flame:flame2023.pkl
  srflow avatar units --model gnm:gnm_head.npz -o action_units.json")]
pub struct Units {
    /// Head model
    #[arg(long, value_name = "KIND:PATH", help = head_help())]
    model: HeadSource,
    /// Seed of a built-in head
    #[arg(long, value_name = "N", default_value_t = 1)]
    seed: u64,
    /// Table to write (.json): the weights of expressions and the turns of joints of each unit
    #[arg(short, long, value_name = "FILE")]
    output: Option<PathBuf>,
    /// Overwrite the file
    #[arg(long)]
    force: bool,
}

pub fn run(args: Units, context: &Context) -> anyhow::Result<()> {
    if let Some(output) = &args.output {
        ensure_extension(output, "json")?;
        ensure_free([output], args.force)?;
    }
    let model = args.model.model(args.seed).with_context(|| format!("reading {}", args.model))?;
    let qualities = unit_qualities(&model);
    if let Some(output) = &args.output {
        write_units(output, &model, &qualities)?;
    }
    if context.json {
        let unit = |unit: &UnitQuality| {
            json!({
                "number": unit.number,
                "side": unit.side,
                "motion_mm": 1e3 * unit.motion,
                "left_on_skin": unit.left.map(|left| left.skin),
                "left_at_landmarks": unit.left.map(|left| left.landmarks),
            })
        };
        let units: Vec<_> = qualities.iter().map(unit).collect();
        return print_json(
            &json!({ "model": model.name, "listed": model.action_units.len(), "units": units }),
        );
    }
    print_tables(&[table(&qualities, model.action_units.len())])
}

fn table(qualities: &[UnitQuality], listed: usize) -> Table {
    let row = |unit: &UnitQuality| {
        let side = match unit.side {
            Side::Both => "",
            Side::Left => " left",
            Side::Right => " right",
        };
        let shares = [unit.left.map(|left| left.skin), unit.left.map(|left| left.landmarks)];
        let shares = shares.map(|share| share.map(|share| 100.0 * share));
        let values = vec![Some(1e3 * unit.motion), shares[0], shares[1]];
        Row { name: format!("AU {}{side}", unit.number), values, baseline: false }
    };
    let mut rows: Vec<Row> = qualities.iter().map(row).collect();
    let shown = qualities.iter().filter(|unit| unit.left.is_some()).count();
    if shown > 0 {
        let mean = |column: usize| {
            let sum: f64 = rows.iter().filter_map(|row| row.values[column]).sum();
            Some(sum / rows.iter().filter(|row| row.values[column].is_some()).count() as f64)
        };
        let values = vec![mean(0), mean(1), mean(2)];
        rows.push(Row { name: "mean".to_owned(), values, baseline: false });
    }
    let compared = match qualities.len() {
        0 => "The model has no landmarks, so its units cannot be compared with those of the built-in head."
            .to_owned(),
        all => format!(
            "The model shows {shown} of the {all} units of the built-in head. Motion: root mean square over the skin at full intensity. \
             Remaining: length of the difference relative to the length of the motion."
        ),
    };
    Table {
        title: format!("Action units (in the model: {listed})"),
        columns: vec![
            Column::plain("motion_mm", "motion, mm", 2),
            Column::plain("left_on_skin", "% remaining on the skin", 0),
            Column::plain("left_at_landmarks", "% remaining at the landmarks", 0),
        ],
        rows,
        notes: vec![compared],
    }
}
