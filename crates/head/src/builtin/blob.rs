use glam::Vec3;

use super::half::{Half, Mark};
use crate::Region;

/// Adds an ellipsoid that is entirely in the left half.
pub(super) fn add(half: &mut Half, center: Vec3, radii: Vec3, around: usize, mark: Mark, region: Region) {
    let turns = std::f32::consts::TAU;
    rings(
        half,
        center,
        radii,
        (0..=around).map(|i| turns * i as f32 / around as f32).collect(),
        mark,
        region,
    );
}

/// Adds the left half of an ellipsoid that straddles the plane of symmetry.
pub(super) fn add_straddling(
    half: &mut Half,
    center: Vec3,
    radii: Vec3,
    around: usize,
    mark: Mark,
    region: Region,
) {
    // Half a turn about +z, from straight down to straight up on the left side.
    let turn = |i: usize| std::f32::consts::PI * (i as f32 / around as f32 - 0.5);
    rings(half, center, radii, (0..=around).map(turn).collect(), mark, region);
}

fn rings(half: &mut Half, center: Vec3, radii: Vec3, turns: Vec<f32>, mark: Mark, region: Region) {
    let columns = turns.len();
    let rows = columns.max(6);
    let closes = turns[columns - 1] - turns[0] > 6.0;
    let mut previous: Vec<u32> = Vec::new();
    for row in 0..=rows {
        let angle = std::f32::consts::PI * row as f32 / rows as f32;
        let (sin, cos) = (libm::sinf(angle), libm::cosf(angle));
        let mut ring: Vec<u32> = Vec::with_capacity(columns);
        for (column, &turn) in turns.iter().enumerate() {
            let pole = row == 0 || row == rows;
            if column > 0 && (pole || (closes && column == columns - 1)) {
                ring.push(ring[0]);
                continue;
            }
            let edge = !closes && (column == 0 || column == columns - 1 || pole);
            let x = if edge { 0.0 } else { sin * libm::cosf(turn) };
            let direction = Vec3::new(x, sin * libm::sinf(turn), cos);
            ring.push(half.vertex(center + radii * direction, Mark { midline: edge, ..mark }));
        }
        if row > 0 {
            half.strip(&previous, &ring, |_| region);
        }
        previous = ring;
    }
}
