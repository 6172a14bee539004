//! Action units in terms of the 52 face shapes of ARKit, which ICT-FaceKit and most rigged heads have.

use crate::{ActionUnit, Side};

/// Action units from the table in ICT-FaceKit's README, by the stems of ARKit's names. `cheekRaiser` of ICT-FaceKit is used for AU 6 in
/// addition to the table's `cheekSquint`; AU 26 is a dropped jaw, AU 27 the mouth stretched open, AU 25 lips just apart.
pub(crate) const ACTION_UNITS: &[(u8, &[(&str, f32)])] = &[
    (1, &[("browInnerUp", 1.0)]),
    (2, &[("browOuterUp", 1.0)]),
    (4, &[("browDown", 1.0)]),
    (5, &[("eyeWide", 1.0)]),
    (6, &[("cheekRaiser", 1.0), ("cheekSquint", 1.0)]),
    (7, &[("eyeSquint", 1.0)]),
    (9, &[("noseSneer", 1.0)]),
    (10, &[("mouthUpperUp", 1.0)]),
    (12, &[("mouthSmile", 1.0)]),
    (14, &[("mouthDimple", 1.0)]),
    (15, &[("mouthFrown", 1.0)]),
    (16, &[("mouthLowerDown", 1.0)]),
    (17, &[("mouthShrugLower", 1.0)]),
    (18, &[("mouthPucker", 1.0)]),
    (20, &[("mouthStretch", 1.0)]),
    (22, &[("mouthFunnel", 1.0)]),
    (24, &[("mouthPress", 1.0)]),
    (25, &[("jawOpen", 0.12)]),
    (26, &[("jawOpen", 0.45)]),
    (27, &[("jawOpen", 0.9)]),
    (28, &[("mouthRollLower", 1.0), ("mouthRollUpper", 1.0)]),
    (29, &[("jawForward", 1.0)]),
    (33, &[("cheekPuff", 1.0)]),
    (43, &[("eyeBlink", 1.0)]),
    (45, &[("eyeBlink", 1.0)]),
];

/// The action units of a model with expressions of these names: ARKit's (`mouthSmileLeft`) or ICT-FaceKit's (`mouthSmile_L`), in any case
/// and with any punctuation.
pub(crate) fn action_units<'a>(names: impl Iterator<Item = &'a str>) -> Vec<ActionUnit> {
    let names: Vec<String> = names.map(plain).collect();
    let mut units = Vec::new();
    for &(number, parts) in ACTION_UNITS {
        let sides = [(Side::Both, ["", ""]), (Side::Left, ["l", "left"]), (Side::Right, ["r", "right"])];
        for (side, suffixes) in sides {
            let expressions: Vec<(usize, f32)> = parts
                .iter()
                .filter_map(|(stem, weight)| {
                    let is_it = |name: &String| {
                        name.strip_prefix(&plain(stem)).is_some_and(|suffix| suffixes.contains(&suffix))
                    };
                    names.iter().position(is_it).map(|index| (index, *weight))
                })
                .collect();
            if !expressions.is_empty() {
                units.push(ActionUnit { number, side, expressions, joints: Vec::new() });
            }
        }
    }
    units
}

/// Letters and digits alone, in lower case.
fn plain(name: &str) -> String {
    name.chars().filter(|c| c.is_alphanumeric()).flat_map(char::to_lowercase).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn both_spellings_give_the_same_units() {
        let ict = ["browInnerUp_L", "browInnerUp_R", "jawOpen", "mouthSmile_L"];
        let arkit = ["browInnerUpLeft", "BrowInnerUpRight", "jaw_open", "mouthSmileLeft"];
        let units = action_units(ict.into_iter());
        assert_eq!(units, action_units(arkit.into_iter()));
        let listed: Vec<(u8, Side)> = units.iter().map(|unit| (unit.number, unit.side)).collect();
        let jaw = [25, 26, 27].map(|number| (number, Side::Both));
        assert_eq!(listed, [&[(1, Side::Left), (1, Side::Right), (12, Side::Left)][..], &jaw].concat());
        assert!(action_units(["mouthSmiley", "x"].into_iter()).is_empty());
    }
}
