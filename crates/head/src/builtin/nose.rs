use glam::{Vec2, Vec3};

use super::curves::{Spline, bell, curve, smoothstep, twin_dome};
use super::identity::Plan;

/// The nose: a ridge raised from the face, a rounded tip, wings and nostrils.
#[derive(Debug)]
pub(super) struct Nose {
    ridge: Spline<1>,
    width: Spline<1>,
    base: f32,
    wing: Vec2,
    wing_size: f32,
    turn: f32,
}

impl Nose {
    pub(super) fn new(plan: &Plan) -> Self {
        let t = &plan.traits;
        let base = plan.nose_base;
        let eye = plan.eye.y;
        // From the root (at the eyes) to the base; heights are fractions of that length.
        let y = |share: f32| eye + (base - eye) * share;
        let bridge = 1.3 * t.nose_bridge;
        let hump = 1.6 * t.nose_hump;
        let tip = 2.0 * t.nose_tip;
        let turn = t.nose_turn;
        // z of the profile.
        let ridge = curve(&[
            (y(1.16), 96.5),
            (y(1.06), 97.8),
            (y(0.99), 100.5 + 0.2 * tip),
            (y(0.93) + 0.3 * turn, 108.5 + 0.7 * tip),
            (y(0.87) + 0.8 * turn, 116.0 + tip),
            (y(0.80) + 1.2 * turn, 119.5 + tip),
            (y(0.71) + 1.2 * turn, 118.6 + tip),
            (y(0.58), 113.5 + 0.6 * tip + 0.5 * bridge + 0.3 * hump),
            (y(0.38), 107.0 + bridge + hump),
            (y(0.18), 100.3 + bridge + 0.6 * hump),
            (y(-0.02), 95.2 + bridge),
            (y(-0.17), 94.3 + 0.7 * bridge),
            (y(-0.34), 97.0),
            (y(-0.50), 98.0),
        ]);
        let wide = 1.0 * t.nose_width;
        let width = curve(&[
            (y(1.2), 12.0),
            (y(1.0), 11.0 + 0.4 * wide),
            (y(0.92), 14.0 + 0.8 * wide),
            (y(0.8), 18.5 + wide),
            (y(0.65), 18.5 + wide),
            (y(0.4), 17.5 + 0.7 * wide),
            (y(0.1), 14.0 + 0.3 * wide),
            (y(-0.15), 15.0),
            (y(-0.5), 20.0),
        ]);
        let wing = Vec2::new(12.2 + 1.3 * t.nose_width, y(0.87));
        Self { ridge, width, base, wing, wing_size: 1.0 + 0.05 * t.nose_width, turn }
    }

    /// Position of skin at `p`, when the face without a nose has midline depth `face_z` at that height.
    pub(super) fn raise(&self, p: Vec3, face_z: f32) -> Vec3 {
        let at = Vec2::new(p.x, p.y);
        let top = self.base + 75.0;
        if p.y > top || p.y < self.base - 9.0 {
            return Vec3::ZERO;
        }
        let fade =
            (1.0 - smoothstep(top - 20.0, top, p.y)) * smoothstep(self.base - 9.0, self.base - 3.0, p.y);
        // The underside rises from the middle towards the wings.
        let aside = (p.x / 16.0).min(1.0);
        let rise = 3.2 * aside * aside * bell((p.y - self.base) / 22.0);
        let height = (self.ridge.at(p.y - rise)[0] - face_z) * fade;
        let mut push = Vec3::new(0.0, 0.0, height * bell(p.x / self.width.at(p.y)[0]));

        // Wings, rounded, with the crease that separates them from cheek and tip.
        let size = self.wing_size;
        let wing = twin_dome(at, self.wing, Vec2::new(8.6, 9.0) * size);
        push += Vec3::new(1.2, -0.5, 6.0) * wing;
        let around = (at - self.wing - Vec2::new(-1.5, -0.5)) / Vec2::new(1.0, 1.0) / size;
        let outside = smoothstep(-2.0, 7.0, around.x + 0.5 * around.y);
        push.z -= 1.6 * bell((around.length() - 8.8) / 4.2) * outside;
        // Tip: two cartilages under the skin.
        push.z += 1.6 * twin_dome(at, Vec2::new(3.0, self.base + 9.5 + self.turn), Vec2::new(7.5, 7.5));
        // Underside: pulled down over the lip to face down, then the nostrils pushed up and in.
        let under = twin_dome(at, Vec2::new(7.0, self.base + 3.2), Vec2::new(11.0, 6.5));
        push.y -= (2.2 - 0.8 * self.turn) * under;
        let nostril = twin_dome(at, Vec2::new(6.8, self.base + 2.9), Vec2::new(4.4, 3.3));
        push += Vec3::new(0.3, 8.0, -6.0) * nostril;
        push
    }
}
