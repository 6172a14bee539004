use glam::{Vec2, Vec3};

use super::half::{Half, Mark, Part};
use super::identity::Plan;
use crate::{Look, Region};

/// Widths of the teeth along the arch, from the midline to the back, and how far each protrudes relative to the first.
const UPPER: [(f32, f32); 7] =
    [(8.6, 0.0), (6.6, -0.6), (7.6, 0.3), (7.0, -0.5), (6.8, -0.9), (10.0, -1.2), (9.4, -1.2)];
const LOWER: [(f32, f32); 7] =
    [(5.4, 0.0), (5.9, 0.0), (6.8, 0.4), (7.0, -0.3), (7.1, -0.6), (10.6, -0.8), (10.0, -0.8)];

/// Columns of vertices across one tooth.
const COLUMNS: usize = 6;

/// Distance from the edges of the teeth to the gum in the first look, and later.
const CROWNS: [f32; 2] = [9.0, 11.0];
/// And from the gum to its hidden end.
const GUM: f32 = 5.0;

/// Adds both rows of teeth; `lips` is the depth of the line between the lips at the midline.
pub(super) fn add(half: &mut Half, plan: &Plan, lips: f32) {
    let crown = CROWNS[usize::from(plan.look >= Look::Second)];
    let upper = Arch { front: lips - 7.2, edge: plan.mouth - 1.6, up: 1.0, curvature: 0.034, crown };
    let lower = Arch { front: lips - 9.8, edge: plan.mouth - 0.6, up: -1.0, curvature: 0.036, crown };
    row(half, &upper, &UPPER, Mark::of(Part::UpperTeeth));
    row(half, &lower, &LOWER, Mark::of(Part::LowerTeeth));
}

/// The arch of the teeth's front faces: `z = front - curvature * x^2`, steeper than a circle at the back.
struct Arch {
    front: f32,
    edge: f32,
    up: f32,
    curvature: f32,
    /// Distance from the edges of the teeth to the gum.
    crown: f32,
}

impl Arch {
    /// Point and outward normal at `arc` millimetres from the midline.
    fn at(&self, arc: f32) -> (Vec2, Vec2) {
        const STEP: f32 = 0.1;
        let (mut x, mut walked) = (0.0_f32, 0.0_f32);
        let slope = |x: f32| -2.0 * self.curvature * x;
        while walked < arc {
            let step = STEP.min(arc - walked);
            x += step / libm::sqrtf(1.0 + slope(x) * slope(x));
            walked += STEP;
        }
        let normal = Vec2::new(-slope(x), 1.0).normalize();
        (Vec2::new(x, self.front - self.curvature * x * x), normal)
    }
}

fn row(half: &mut Half, arch: &Arch, teeth: &[(f32, f32)], mark: Mark) {
    let mut rows: Vec<Vec<u32>> = vec![Vec::new(); SECTION];
    let mut arc = 0.0;
    for (number, &(width, rise)) in teeth.iter().enumerate() {
        for column in 0..=COLUMNS {
            if number > 0 && column == 0 {
                continue;
            }
            let across = column as f32 / COLUMNS as f32;
            let (at, normal) = arch.at(arc + width * across);
            let midline = number == 0 && column == 0;
            for (line, (out, up)) in rows.iter_mut().zip(section(arch.crown, width, rise, across)) {
                let flat = at + normal * out;
                let x = if midline { 0.0 } else { flat.x };
                let point = Vec3::new(x, arch.edge + arch.up * up, flat.y);
                line.push(half.vertex(point, Mark { midline, ..mark }));
            }
        }
        arc += width;
    }
    for (number, pair) in rows.windows(2).enumerate() {
        let region = if number == 0 || number == SECTION - 2 { Region::MouthInside } else { Region::Teeth };
        // From root to edge the outside faces down; for the lower teeth it faces up.
        if arch.up > 0.0 {
            half.strip(&pair[0], &pair[1], |_| region);
        } else {
            half.strip(&pair[1], &pair[0], |_| region);
        }
    }
}

/// Points of one cross-section, from the root in front over the edge to the root behind.
const SECTION: usize = 9;

/// Outward and rootward offset of each point of the cross-section at `across` (0 to 1) of a tooth.
fn section(crown: f32, width: f32, rise: f32, across: f32) -> [(f32, f32); SECTION] {
    // 0 in the middle of the tooth, 1 where it meets its neighbour.
    let side = (2.0 * across - 1.0).abs();
    let gap = side * side * side * side;
    let root = crown + GUM;
    let crown = crown - 2.2 * gap;
    let thick = if width > 9.0 { 8.0 } else { 5.0 };
    let edge = -rise + 0.9 * gap;
    let dent = -0.9 * gap;
    [
        (0.6, root),
        (0.5 - 0.2 * gap, crown),
        (0.25 + dent, crown - 0.5),
        (0.7 + dent, 0.55 * crown),
        (0.25 + dent, edge + 1.0),
        (-0.5 + dent, edge),
        (-0.35 * thick, edge + 0.1),
        (-0.9 * thick, 0.6 * crown),
        (-1.2 * thick, root),
    ]
}
