//! Action units: those of each class of emotion, and their names in records.

use srflow_data::micro_expression::EmotionClass;
use srflow_head::Side;

/// Typical action units of each class (those coded in CASME II and SAMM).
pub(crate) fn action_unit_sets(class: EmotionClass) -> &'static [&'static [u8]] {
    match class {
        EmotionClass::Negative => {
            &[&[4], &[4, 7], &[9], &[4, 9], &[10], &[14], &[15], &[15, 17], &[17], &[20], &[1, 4], &[4, 5]]
        }
        EmotionClass::Positive => &[&[12], &[6, 12], &[12, 25]],
        EmotionClass::Surprise => &[&[1, 2], &[1, 2, 5], &[5], &[1, 2, 26], &[2, 5]],
    }
}

/// `AU12_L` where a unit has halves, else `AU9`.
pub(crate) fn unit_name(number: u8, side: Side) -> String {
    match side {
        Side::Both => format!("AU{number}"),
        Side::Left => format!("AU{number}_L"),
        Side::Right => format!("AU{number}_R"),
    }
}

/// Numbers of action units in the notation of datasets: `1+2`.
pub(crate) fn coded_units(units: &[(u8, Side, f32)]) -> String {
    let mut numbers: Vec<u8> = units.iter().map(|unit| unit.0).collect();
    numbers.dedup();
    let numbers: Vec<String> = numbers.iter().map(u8::to_string).collect();
    numbers.join("+")
}

#[cfg(test)]
mod tests {
    use srflow_core::random::Key;
    use srflow_head::{HeadModel, MicroExpression};

    use super::*;

    #[test]
    fn the_built_in_head_shows_units_of_the_class() {
        let model = HeadModel::builtin(1);
        for class in EmotionClass::ALL {
            for scene in 0..40 {
                let key = Key::new(3).scene(scene);
                let sets = action_unit_sets(class);
                let shown =
                    MicroExpression::random(&model, sets, key, 20, 200.0).expect("units of the class");
                let mut numbers: Vec<u8> = shown.action_units.iter().map(|unit| unit.0).collect();
                numbers.dedup();
                assert!(sets.contains(&numbers.as_slice()), "{class:?} shows {numbers:?}");
            }
        }
    }
}
