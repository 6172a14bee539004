//! How much the regions of a face move as action units of FACS do.

use std::sync::LazyLock;

use super::regions::{REGIONS, RegionMotion};

/// The action units whose motion is measured, by their numbers in FACS.
pub const ACTION_UNITS: [u8; 14] = [1, 2, 4, 5, 6, 9, 10, 12, 14, 15, 17, 20, 25, 26];

/// What moves in each of [`ACTION_UNITS`], and where to: a region, or both regions of this name, with x towards the middle of the face, y
/// down. From the descriptions of FACS (Ekman, Friesen and Hager, *Facial Action Coding System*, 2002).
const MOVES: [(&str, [f64; 2]); 14] = [
    ("inner-brow", [0.0, -1.0]),
    ("outer-brow", [0.0, -1.0]),
    ("inner-brow", [DIAGONAL, DIAGONAL]),
    ("lids", [0.0, -1.0]),
    ("cheek", [0.0, -1.0]),
    ("nostril", [0.0, -1.0]),
    ("upper-lip", [0.0, -1.0]),
    ("mouth-corner", [-DIAGONAL, -DIAGONAL]),
    ("mouth-corner", [1.0, 0.0]),
    ("mouth-corner", [0.0, 1.0]),
    ("chin", [0.0, -1.0]),
    ("mouth-corner", [-1.0, 0.0]),
    ("lower-lip", [0.0, 1.0]),
    ("chin", [0.0, 1.0]),
];

const DIAGONAL: f64 = std::f64::consts::FRAC_1_SQRT_2;

/// Units that move at least this part of the largest are candidates, too.
const CANDIDATE: f64 = 0.75;

/// For each unit, regions and their directions in the picture.
type Directions = [Vec<(usize, [f64; 2])>; ACTION_UNITS.len()];

static DIRECTIONS: LazyLock<Directions> = LazyLock::new(|| {
    MOVES.map(|(name, [x, y])| {
        let direction = |region: &str| match region.strip_prefix(name)? {
            "" | "-left" => Some([x, y]),
            "-right" => Some([-x, y]),
            _ => None,
        };
        REGIONS.iter().enumerate().filter_map(|(number, region)| Some((number, direction(region)?))).collect()
    })
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
