//! The action units of a head model as a file that can be kept, looked at and edited.

use std::collections::BTreeMap;
use std::path::Path;

use glam::Vec3;
use serde::{Deserialize, Serialize};
use srflow_core::excerpt;
use srflow_files::{FileError, FileKind, FileProblem, parse_error_in_words, read_text, write_file};

use crate::unit_fit::UnitQuality;
use crate::{ActionUnit, HeadModel, Side};

/// Name of the file that is read beside a model, instead of the units that the model would have.
pub const UNITS_NAME: &str = "action_units.json";

/// Larger weights and turns are not a face's.
const LARGEST: f32 = 1e3;

#[derive(Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct Table {
    /// Name of the model, for readers.
    model: String,
    units: Vec<Row>,
}

#[derive(Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct Row {
    number: u8,
    side: Side,
    /// Weight at full intensity, by the name of the expression.
    #[serde(default)]
    expressions: BTreeMap<String, f32>,
    /// Axis times angle at full intensity, radians, by the name of the joint.
    #[serde(default)]
    joints: BTreeMap<String, [f32; 3]>,
    /// Shares of the built-in head's motion that remain, for readers.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    left_on_skin: Option<f64>,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    left_at_landmarks: Option<f64>,
}

/// Writes the action units of a model, and how well they show those of the built-in head.
///
/// # Errors
/// When two expressions or joints of the model have one name, or the file cannot be written.
pub fn write_units(path: &Path, model: &HeadModel, qualities: &[UnitQuality]) -> Result<(), FileError> {
    let [expressions, joints] = names(model);
    for (field, names) in [("expressions", &expressions), ("joints", &joints)] {
        let mut sorted = names.clone();
        sorted.sort_unstable();
        if let Some(pair) = sorted.windows(2).find(|pair| pair[0] == pair[1]) {
            let found = format!("two called {} in the model {}", excerpt(pair[0]), model.name);
            return Err(FileProblem::field(field, "different names", found).in_file(path));
        }
    }
    let row = |unit: &ActionUnit| {
        let quality = qualities.iter().find(|of| (of.number, of.side) == (unit.number, unit.side));
        let left = quality.and_then(|quality| quality.left);
        Row {
            number: unit.number,
            side: unit.side,
            expressions: unit
                .expressions
                .iter()
                .map(|(at, weight)| (expressions[*at].to_owned(), *weight))
                .collect(),
            joints: unit.joints.iter().map(|(at, turn)| (joints[*at].to_owned(), turn.to_array())).collect(),
            left_on_skin: left.map(|left| left.skin),
            left_at_landmarks: left.map(|left| left.landmarks),
        }
    };
    let table = Table { model: model.name.clone(), units: model.action_units.iter().map(row).collect() };
    let text = serde_json::to_string_pretty(&table).expect("numbers and text");
    write_file(path, text + "\n")
}

/// The action units for `model` in the file `path`; `None` if there is no such file.
///
/// # Errors
/// When the file cannot be read, is malformed, lists a unit twice, or names an expression or joint that the model does not have.
pub(crate) fn read_units(path: &Path, model: &HeadModel) -> Result<Option<Vec<ActionUnit>>, FileError> {
    let text = match read_text(path, FileKind::Json) {
        Err(error) if error.is_not_found() => return Ok(None),
        text => text?,
    };
    let units = parse(&text, model).map_err(|problem| problem.in_file(path))?;
    Ok(Some(units))
}

/// Names of the expressions and of the joints.
fn names(model: &HeadModel) -> [Vec<&str>; 2] {
    let expressions = model.expressions.iter().map(|shape| shape.name.as_str());
    [expressions.collect(), model.joints.iter().map(|joint| joint.name.as_str()).collect()]
}

fn parse(text: &str, model: &HeadModel) -> Result<Vec<ActionUnit>, FileProblem> {
    let table: Table = serde_json::from_str(text).map_err(|error| {
        FileProblem::field(
            "units",
            "a table of action units as srflow writes it",
            parse_error_in_words(&error),
        )
    })?;
    let [expression_names, joint_names] = names(model);
    let mut units: Vec<ActionUnit> = Vec::new();
    for Row { number, side, expressions, joints, .. } in table.units {
        let of_unit = |found: String| format!("{found} in action unit {number} ({side:?})");
        if units.iter().any(|unit| (unit.number, unit.side) == (number, side)) {
            return Err(FileProblem::field("units", "each unit once", of_unit("a second one".to_owned())));
        }
        let place = |field, names: &[&str], name: &str| {
            let expected = format!("names of the head model {}", model.name);
            names
                .iter()
                .position(|own| *own == name)
                .ok_or_else(|| FileProblem::field(field, expected, of_unit(format!("`{}`", excerpt(name)))))
        };
        let sane = |field, numbers: &[f32]| match numbers
            .iter()
            .find(|number| number.is_nan() || number.abs() > LARGEST)
        {
            None => Ok(()),
            Some(number) => {
                let expected = format!("numbers from -{LARGEST} to {LARGEST}");
                Err(FileProblem::field(field, expected, of_unit(number.to_string())))
            }
        };
        let mut unit = ActionUnit { number, side, expressions: Vec::new(), joints: Vec::new() };
        for (name, weight) in &expressions {
            sane("expressions", &[*weight])?;
            unit.expressions.push((place("expressions", &expression_names, name)?, *weight));
        }
        unit.expressions.sort_by_key(|(expression, _)| *expression);
        for (name, turn) in &joints {
            sane("joints", turn)?;
            unit.joints.push((place("joints", &joint_names, name)?, Vec3::from_array(*turn)));
        }
        unit.joints.sort_by_key(|(joint, _)| *joint);
        units.push(unit);
    }
    Ok(units)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::unit_qualities;

    #[test]
    fn a_table_that_is_written_is_read_again() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join(UNITS_NAME);
        let model = HeadModel::builtin(3);
        assert_eq!(read_units(&path, &model).unwrap(), None, "no file");
        write_units(&path, &model, &unit_qualities(&model, crate::Look::default())).unwrap();
        assert_eq!(read_units(&path, &model).unwrap().unwrap(), model.action_units);
        let text = std::fs::read_to_string(&path).unwrap();
        assert!(text.contains("\"left_at_landmarks\": 0.") && text.contains("\"side\": \"left\""), "{text}");
    }

    #[test]
    fn wrong_tables_are_refused() {
        let model = HeadModel::builtin(3);
        let unit = |number: u8, rest: &str| format!(r#"{{"number": {number}, "side": "left"{rest}}}"#);
        let smile = unit(12, r#", "expressions": {"AU12_L": 0.9}"#);
        let table = |units: &[String]| format!(r#"{{"model": "a", "units": [{}]}}"#, units.join(", "));
        let read =
            parse(&table(&[smile.clone(), unit(26, r#", "joints": {"jaw": [0.1, 0, 0]}"#)]), &model).unwrap();
        assert_eq!(
            read[0].expressions,
            [(
                model
                    .action_units
                    .iter()
                    .find(|unit| unit.number == 12 && unit.side == Side::Left)
                    .unwrap()
                    .expressions[0]
                    .0,
                0.9
            )]
        );
        assert_eq!(read[1].joints, [(2, Vec3::X * 0.1)]);
        for (units, expected) in [
            (vec![smile.clone(), smile.clone()], "each unit once"),
            (vec![unit(12, r#", "expressions": {"smile": 1}"#)], "`smile` in action unit 12 (Left)"),
            (vec![unit(12, r#", "expressions": {"AU12_L": 1e30}"#)], "from -1000 to 1000"),
            (vec![unit(12, r#", "expressions": {"AU12_L": 1e99}"#)], "units"),
            (vec![unit(12, r#", "joints": {"nose": [0, 0, 0]}"#)], "`nose`"),
            (vec![unit(12, r#", "expression": {}"#)], "expression"),
            (vec![r#"{"number": 12, "side": "up"}"#.to_owned()], "up"),
        ] {
            let error = parse(&table(&units), &model).unwrap_err().in_file(Path::new("a.json")).to_string();
            assert!(error.contains(expected), "{error}");
        }
        let error = parse("[", &model).unwrap_err().in_file(Path::new("a.json")).to_string();
        assert!(error.contains("a table of action units"), "{error}");
    }
}
