//! How much the regions of a face move as action units of FACS do.

use std::sync::LazyLock;

use super::regions::{REGIONS, RegionMotion};

/// The action units whose motion is measured, by their numbers in FACS. What moves, and where to: a region, or both regions of this name, with x
/// towards the middle of the face, y down. From the descriptions of FACS (Ekman, Friesen and Hager, *Facial Action Coding System*, 2002).
const UNITS: &[(u8, &str, [f64; 2])] = &[
    (1, "inner-brow", [0.0, -1.0]),
    (2, "outer-brow", [0.0, -1.0]),
    (4, "inner-brow", [DIAGONAL, DIAGONAL]),
    (5, "lids", [0.0, -1.0]),
    (6, "cheek", [0.0, -1.0]),
    (9, "nostril", [0.0, -1.0]),
    (10, "upper-lip", [0.0, -1.0]),
    (12, "mouth-corner", [-DIAGONAL, -DIAGONAL]),
    (14, "mouth-corner", [1.0, 0.0]),
    (15, "mouth-corner", [0.0, 1.0]),
    (17, "chin", [0.0, -1.0]),
    (20, "mouth-corner", [-1.0, 0.0]),
    (25, "lower-lip", [0.0, 1.0]),
    (26, "chin", [0.0, 1.0]),
];

/// The action units whose motion is measured, by their numbers in FACS.
pub const ACTION_UNITS: [u8; UNITS.len()] = {
    let mut numbers = [0; UNITS.len()];
    let mut unit = 0;
    while unit < UNITS.len() {
        numbers[unit] = UNITS[unit].0;
        unit += 1;
    }
    numbers
};

const DIAGONAL: f64 = std::f64::consts::FRAC_1_SQRT_2;

/// Units that move at least this part of the largest are candidates, too.
const CANDIDATE: f64 = 0.75;

/// Regions and their directions in the picture.
type Directions = Vec<(usize, [f64; 2])>;

/// For each unit.
static DIRECTIONS: LazyLock<Vec<Directions>> = LazyLock::new(|| {
    let of_unit = |&(_, name, [x, y]): &(u8, &str, [f64; 2])| {
        let direction = |region: &str| match region.strip_prefix(name)? {
            "" | "-left" => Some([x, y]),
            "-right" => Some([-x, y]),
            _ => None,
        };
        REGIONS.iter().enumerate().filter_map(|(number, region)| Some((number, direction(region)?))).collect()
    };
    UNITS.iter().map(of_unit).collect()
});

/// How far regions move as each of [`ACTION_UNITS`] does, in the unit of the motion: the mean over its regions of the motion in its direction. Below 0
/// is the other direction.
pub fn unit_motion(motion: &RegionMotion) -> [f64; ACTION_UNITS.len()] {
    std::array::from_fn(|unit| {
        let directions = &DIRECTIONS[unit];
        let along = |(region, direction): &(usize, [f64; 2])| {
            motion[*region].iter().zip(direction).map(|(motion, direction)| motion * direction).sum::<f64>()
        };
        directions.iter().map(along).sum::<f64>() / directions.len() as f64
    })
}

/// The units that a motion looks like: that with most motion, and those with at least three quarters of it, in the order of their numbers.
pub fn candidate_units(motion: &RegionMotion) -> Vec<u8> {
    let moved = unit_motion(motion);
    let largest = moved.iter().copied().fold(0.0, f64::max);
    let candidate = |(unit, moved): (u8, f64)| (moved > 0.0 && moved >= CANDIDATE * largest).then_some(unit);
    ACTION_UNITS.into_iter().zip(moved).filter_map(candidate).collect()
}
