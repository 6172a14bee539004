use glam::Vec3;

use super::half::{Half, Part};
use super::identity::Plan;
use super::skin::{self, Skin};

/// Vertices of the left half for the landmarks, each list from the midline outward.
pub(super) struct Landmarks {
    jaw: Vec<u32>,
    brow: Vec<u32>,
    bridge: Vec<u32>,
    nostril: Vec<u32>,
    upper_lid: [u32; 4],
    lower_lid: [u32; 2],
    outer_lips: [u32; 7],
    inner_lips: [u32; 5],
}

impl Landmarks {
    pub(super) fn on(half: &Half, plan: &Plan, skin: &Skin) -> Self {
        let nearest = |target: Vec3| nearest(half, target);
        let (chin, base) = (plan.chin, plan.nose_base);
        let bridge = |share: f32| nearest(Vec3::new(0.0, plan.eye.y + (base - plan.eye.y) * share, 110.0));
        let slit = |column: usize| skin.grid[skin.mouth_row][column];
        let lip = |rows: isize, column: usize| skin.grid[skin.mouth_row.saturating_add_signed(-rows)][column];
        let red = skin::LIP_ROWS;
        Self {
            jaw: vec![
                nearest(Vec3::new(0.0, chin, 87.0)),
                nearest(Vec3::new(13.0, chin + 2.0, 84.0)),
                nearest(Vec3::new(26.0, chin + 8.0, 74.0)),
                nearest(Vec3::new(37.0, chin + 16.0, 60.0)),
                nearest(Vec3::new(46.0, chin + 27.0, 44.0)),
                nearest(Vec3::new(53.0, chin + 42.0, 30.0)),
                nearest(Vec3::new(59.0, chin + 60.0, 20.0)),
                nearest(Vec3::new(65.0, chin + 80.0, 14.0)),
                nearest(Vec3::new(69.0, chin + 102.0, 10.0)),
            ],
            brow: [11.0, 20.0, 29.0, 39.0, 49.0]
                .map(|x| nearest(Vec3::new(x, skin::brow_height(plan, x), 100.0 - 0.012 * x * x)))
                .to_vec(),
            bridge: [-0.02, 0.26, 0.52, 0.80].map(bridge).to_vec(),
            nostril: [(0.0, 0.5, 104.0), (5.5, 1.0, 105.0), (12.0, 3.5, 102.0)]
                .map(|(x, up, z)| nearest(Vec3::new(x, base + up, z)))
                .to_vec(),
            upper_lid: skin.eye_columns.map(|column| skin.grid[skin.eye_row][column]),
            lower_lid: [skin.under_eye[skin.eye_columns[1]], skin.under_eye[skin.eye_columns[2]]],
            outer_lips: [
                lip(red, 0),
                lip(red, 6),
                lip(red, 15),
                slit(skin.mouth_corner),
                lip(-red, 15),
                lip(-red, 7),
                lip(-red, 0),
            ],
            inner_lips: [
                slit(0),
                slit(9),
                slit(skin.mouth_corner - 2),
                skin.under_mouth[9],
                skin.under_mouth[0],
            ],
        }
    }

    /// The 68 landmarks in dlib's order, from the subject's right to the left; `right` mirrors a left vertex.
    pub(super) fn in_order(&self, right: impl Fn(u32) -> u32) -> Vec<u32> {
        let mut all = Vec::with_capacity(68);
        let both = |all: &mut Vec<u32>, outward: &[u32], shared: usize| {
            all.extend(outward.iter().rev().map(|&v| right(v)));
            all.extend(&outward[shared..]);
        };
        both(&mut all, &self.jaw, 1);
        both(&mut all, &self.brow, 0);
        all.extend(&self.bridge);
        both(&mut all, &self.nostril, 1);
        let [inner, above_inner, above_outer, outer] = self.upper_lid;
        let [below_inner, below_outer] = self.lower_lid;
        all.extend([outer, above_outer, above_inner, inner, below_inner, below_outer].map(&right));
        all.extend([inner, above_inner, above_outer, outer, below_outer, below_inner]);
        let lips = &self.outer_lips;
        both(&mut all, &lips[..4], 1);
        all.extend([lips[4], lips[5], lips[6]]);
        all.extend([right(lips[5]), right(lips[4])]);
        let inner = &self.inner_lips;
        both(&mut all, &inner[..3], 1);
        all.extend([inner[3], inner[4], right(inner[3])]);
        all
    }
}

fn nearest(half: &Half, target: Vec3) -> u32 {
    let mut best = (f32::INFINITY, 0);
    for (vertex, (point, mark)) in half.points.iter().zip(&half.marks).enumerate() {
        // Depth counts least: a landmark is defined by its height and lateral position.
        let distance = ((*point - target) * Vec3::new(1.0, 1.0, 0.3)).length();
        let off_middle = target.x == 0.0 && !mark.midline;
        if mark.part == Part::Skin && !off_middle && point.z > -10.0 && distance < best.0 {
            best = (distance, vertex as u32);
        }
    }
    best.1
}
