use glam::{Vec2, Vec3};

use super::curves::{bell, lerp, smoothstep, twin_dome};
use super::half::{Mark, Part};
use super::identity::Plan;
use super::skin::brow_height;
use super::{eyes, face, mouth};
use crate::{Look, Side};

/// Action units that are expressions of the built-in head, and whether each half of the face has a separate one.
///
/// 26 is the jaw's joint, and 45 (blink) is 43 (eyes closed) by another name.
pub(super) const EXPRESSIONS: [(u8, bool); 18] = [
    (1, true),
    (2, true),
    (4, true),
    (5, true),
    (6, true),
    (7, true),
    (9, true),
    (10, true),
    (12, true),
    (14, true),
    (15, true),
    (16, false),
    (17, false),
    (20, true),
    (23, false),
    (24, false),
    (25, false),
    (43, true),
];

/// Rotation of the jaw at full AU 26, radians.
pub(super) const JAW_DROP: f32 = 0.20;

/// Millimetres by which the lower lid moves towards the nose for each radian by which it is raised.
const NOSEWARD: f32 = 3.0;

/// Share of a unit's movement at lateral position `x` that belongs to `side`; both sides' shares sum to 1.
pub(super) fn share(side: Side, x: f32) -> f32 {
    const BLEND: f32 = 6.0;
    match side {
        Side::Both => 1.0,
        Side::Left => smoothstep(-BLEND, BLEND, x),
        Side::Right => smoothstep(-BLEND, BLEND, -x),
    }
}

/// Displacement in millimetres of a vertex of the left half when both halves show unit `number` fully, and its deviation
/// from the straight line halfway. `fitted` is what it does to the skin, if that is known.
pub(super) fn displacement(
    plan: &Plan,
    number: u8,
    p: Vec3,
    mark: &Mark,
    fitted: Option<Vec3>,
) -> (Vec3, Vec3) {
    let place = Place::new(plan, p, mark);
    if mark.part == Part::Ear || mark.part == Part::Eyeball || !place.in_front {
        return (Vec3::ZERO, Vec3::ZERO);
    }
    if matches!(mark.part, Part::UpperTeeth | Part::LowerTeeth | Part::Tongue) {
        return (Vec3::ZERO, Vec3::ZERO);
    }
    let roll = place.lid_roll(number);
    let mut skin = match fitted {
        _ if mark.part == Part::LidLining => Vec3::ZERO,
        Some(fitted) => fitted + place.finer_than_fitted(number),
        None => place.pull(number),
    };
    // Lateral movement fades out at the midline, where both halves meet.
    skin.x *= smoothstep(0.0, 9.0, p.x);
    if roll == 0.0 {
        return (skin, Vec3::ZERO);
    }
    if plan.look >= Look::Second && mark.eye < 0.0 && matches!(number, 6 | 7) {
        // The muscle around the eye also pulls the lower lid towards the nose.
        skin.x -= NOSEWARD * roll;
    }
    let lift = place.lid_lift(number);
    let rolled = |share: f32| {
        let turned = eyes::rolled(plan, p, roll * share);
        turned + (turned - plan.eye).normalize_or_zero() * (lift * share) - p
    };
    let full = rolled(1.0);
    (full + skin, rolled(0.5) - 0.5 * full)
}

/// Position of a vertex on the face.
struct Place<'a> {
    plan: &'a Plan,
    p: Vec3,
    at: Vec2,
    mark: &'a Mark,
    in_front: bool,
}

impl<'a> Place<'a> {
    fn new(plan: &'a Plan, p: Vec3, mark: &'a Mark) -> Self {
        Self { plan, p, at: Vec2::new(p.x, p.y), mark, in_front: p.z > 0.0 && p.y > plan.chin - 25.0 }
    }

    fn spot(&self, x: f32, y: f32, rx: f32, ry: f32) -> f32 {
        twin_dome(self.at, Vec2::new(x, y), Vec2::new(rx, ry))
    }

    /// How far the lining of the mouth follows the lips.
    fn lining(&self) -> f32 {
        match self.mark.part {
            Part::MouthLining { depth } => 1.0 - smoothstep(2.0, 7.0, f32::from(depth)),
            _ => 1.0,
        }
    }

    /// 1 in the middle of the lips, 0 at their corners and beyond.
    fn middle_of_lips(&self) -> f32 {
        let along = (self.p.x / self.plan.mouth_half_width).min(1.0);
        (1.0 - along * along).max(0.0)
    }

    fn on_upper_lip(&self) -> bool {
        self.mark.mouth > 0.0
    }

    /// Lips made thinner by a share, up to so many times their height away from the line between them, and moved `inward`.
    fn squeezed(&self, thinner: f32, reach: f32, inward: f32) -> Vec3 {
        let (plan, middle) = (self.plan, self.middle_of_lips());
        let over = self.p.y - mouth::slit(plan, self.p.x);
        let share = over.abs() / mouth::lip_height(plan, self.p.x, self.on_upper_lip());
        let near = bell(share / reach) * smoothstep(0.0, 0.35, middle);
        Vec3::new(0.0, -thinner * over * near, inward * bell(share / 1.8) * middle)
    }

    /// What is too narrow for the kernels of the fit: lips that a smile stretches become thin, and brows that knit come together.
    fn finer_than_fitted(&self, number: u8) -> Vec3 {
        let plan = self.plan;
        match number {
            4 => {
                let inward = smoothstep(0.0, 11.0, self.p.x);
                let knit = self.spot(15.0, brow_height(plan, 15.0) - 1.0, 22.0, 18.0)
                    * smoothstep(plan.eye.y + 4.0, plan.eye.y + 14.0, self.p.y);
                Vec3::new(-2.2 * inward, -1.4, 0.3) * knit
            }
            12 => {
                let over = self.p.y - mouth::slit(plan, self.p.x);
                let thinner = if self.on_upper_lip() { 0.34 } else { 0.26 };
                // The lips bow: without this they would form a V.
                let along = self.p.x / plan.mouth_half_width;
                let bow = 1.3 * bell((along - 0.5) / 0.28) * bell(over / 16.0);
                (self.squeezed(thinner, 2.4, -0.6) - Vec3::Y * bow) * self.lining()
            }
            _ => Vec3::ZERO,
        }
    }

    fn pull(&self, number: u8) -> Vec3 {
        let plan = self.plan;
        match number {
            1 | 2 | 4 => self.brow(number),
            6 | 9 => self.cheek_and_nose(number),
            10 | 16 | 17 | 23 | 24 | 25 => self.lips(number) * self.lining(),
            12 | 14 | 15 | 20 => {
                self.corner(number, Vec2::new(plan.mouth_half_width, plan.mouth)) * self.lining()
            }
            _ => Vec3::ZERO,
        }
    }

    /// Brows: full at the brow, fading out on the lid below and towards the hairline.
    fn brow(&self, number: u8) -> Vec3 {
        let plan = self.plan;
        let eye = plan.eye.y;
        let over_lid = smoothstep(eye + 4.0, eye + 18.0, self.p.y);
        let up = |x: f32, rx: f32| {
            let y = eye + 20.0;
            self.spot(x, y, rx, if self.p.y > y { 46.0 } else { 24.0 }) * over_lid
        };
        // Furrows across the forehead, where the skin is compressed.
        let furrows = 0.55
            * libm::cosf((self.p.y - eye - 38.0) * std::f32::consts::TAU / 11.0)
            * self.spot(18.0, eye + 42.0, 42.0, 20.0);
        match number {
            1 => Vec3::new(-0.5, 9.0, 0.4) * up(13.0, 27.0) + Vec3::Z * furrows * bell(self.p.x / 36.0),
            2 => {
                Vec3::new(0.5, 8.5, 0.0) * up(43.0, 27.0) + Vec3::Z * furrows * (1.0 - bell(self.p.x / 40.0))
            }
            _ => {
                let inward = smoothstep(0.0, 11.0, self.p.x);
                let knit = self.spot(15.0, brow_height(plan, 15.0) - 1.0, 24.0, 20.0)
                    * smoothstep(eye + 2.0, eye + 14.0, self.p.y);
                let lower = self.spot(36.0, eye + 20.0, 24.0, 17.0) * over_lid;
                let furrow = self.spot(0.0, eye + 19.0, 22.0, 15.0);
                let pleat = furrow
                    * (0.9 * bell(self.p.x / 4.5) - 1.5 * bell((self.p.x - 5.5) / 3.8)
                        + 1.2 * bell((self.p.x - 12.0) / 7.0));
                Vec3::new(-4.2 * inward, -5.0, 0.5) * knit
                    + Vec3::new(-1.0, -3.0, 0.3) * lower
                    + Vec3::Z * pleat
            }
        }
    }

    fn cheek_and_nose(&self, number: u8) -> Vec3 {
        let plan = self.plan;
        let under_eye = smoothstep(2.0, 12.0, eyes::margin(plan, self.p.x, false) - self.p.y);
        if number == 6 {
            let cheek = self.spot(40.0, 2.0, 27.0, 22.0) * under_eye;
            let corner = self.spot(plan.outer_canthus.x + 11.0, plan.eye.y - 4.0, 13.0, 14.0);
            return Vec3::new(-0.5, 5.0, 2.6) * cheek + Vec3::new(-1.2, 0.6, 0.6) * corner;
        }
        let wing = self.spot(14.0, plan.nose_base + 9.0, 15.0, 20.0);
        let root = self.spot(9.0, plan.eye.y - 6.0, 14.0, 20.0);
        let brow = self.spot(12.0, plan.eye.y + 17.0, 18.0, 16.0);
        let wrinkle = 0.8
            * libm::sinf((self.p.y - plan.eye.y) * std::f32::consts::TAU / 6.5)
            * self.spot(8.0, plan.eye.y - 6.0, 9.0, 13.0);
        let lip = if self.on_upper_lip() {
            self.spot(12.0, plan.mouth + 8.0, 18.0, 18.0) * self.middle_of_lips()
        } else {
            0.0
        };
        Vec3::new(0.6, 4.6, 0.4) * wing
            + Vec3::new(0.0, 2.2, 1.0) * root
            + Vec3::new(-1.2, -3.0, 0.6) * brow
            + Vec3::Z * wrinkle
            + Vec3::new(0.0, 2.6, 0.6) * lip * self.lining()
    }

    fn lips(&self, number: u8) -> Vec3 {
        let plan = self.plan;
        let middle = self.middle_of_lips();
        let over = self.p.y - mouth::slit(plan, self.p.x);
        match number {
            10 if self.on_upper_lip() => {
                let lip = self.spot(11.0, plan.mouth + 5.0, 20.0, 24.0)
                    * lerp(middle, 1.0, smoothstep(6.0, 20.0, over));
                let fold = self.spot(22.0, plan.nose_base + 2.0, 14.0, 18.0);
                Vec3::new(0.0, 5.6, 1.0) * lip + Vec3::new(0.5, 2.2, 1.4) * fold
            }
            16 if !self.on_upper_lip() => {
                Vec3::new(0.0, -5.0, 0.8) * middle * self.spot(8.0, plan.mouth - 6.0, 26.0, 22.0)
            }
            17 => {
                let chin = self.spot(0.0, plan.chin + 16.0, 26.0, 22.0);
                let lip = self.spot(0.0, plan.mouth - 4.0, 30.0, 22.0);
                Vec3::new(0.0, 4.2, 1.2) * chin + Vec3::new(0.0, 3.2, 2.0) * lip
            }
            23 | 24 => {
                let (squeeze, inward, narrow) =
                    if number == 23 { (0.28, -0.6, -2.0) } else { (0.42, -1.6, -0.6) };
                let drawn = self.spot(plan.mouth_half_width, plan.mouth, 20.0, 13.0);
                self.squeezed(squeeze, 2.6, inward) + Vec3::new(narrow, 0.0, 0.2) * drawn
            }
            25 => {
                let along = (self.p.x / plan.mouth_half_width).min(1.0);
                let (middle, upper) = match plan.look {
                    Look::First => (middle, 1.4),
                    Look::Second => (1.0 - along * along * along, 2.6),
                };
                let open = middle * bell(over / 24.0);
                if self.on_upper_lip() {
                    Vec3::new(0.0, upper, 0.2) * open
                } else {
                    Vec3::new(0.0, -4.2, -0.2) * open
                }
            }
            _ => Vec3::ZERO,
        }
    }

    /// Units that pull at the corner of the mouth, and the displaced cheek.
    fn corner(&self, number: u8, corner: Vec2) -> Vec3 {
        let plan = self.plan;
        let spot = |dx: f32, dy: f32, rx: f32, ry: f32| self.spot(corner.x + dx, corner.y + dy, rx, ry);
        let aside = smoothstep(0.0, 9.0, self.p.x);
        let fold = face::fold_distance(plan, self.at);
        let crease = smoothstep(plan.mouth - 14.0, plan.mouth + 2.0, self.p.y)
            * (1.0 - smoothstep(plan.nose_base, plan.nose_base + 14.0, self.p.y));
        match number {
            12 => {
                // Narrow towards the centre of the lips, so that they bow, and wide in the cheek.
                let pull = spot(1.0, 1.0, if self.p.x < corner.x { 27.0 } else { 31.0 }, 25.0);
                let cheek = self.spot(40.0, -7.0, 26.0, 22.0)
                    * smoothstep(2.0, 14.0, eyes::margin(plan, self.p.x, false) - self.p.y);
                Vec3::new(6.4 * aside, 7.6, -3.2) * pull
                    + Vec3::new(0.8, 3.4, 3.2) * cheek
                    + Vec3::Z * crease * (1.2 * bell((fold - 8.0) / 9.0) - 1.0 * bell((fold - 0.5) / 6.0))
            }
            14 => {
                Vec3::new(3.2 * aside, 1.2, -3.6) * spot(2.0, 0.0, 17.0, 14.0)
                    + Vec3::new(0.5, 0.0, 1.6) * spot(13.0, 1.0, 11.0, 15.0)
            }
            15 => {
                Vec3::new(1.2 * aside, -6.5, -0.8) * spot(0.0, -1.0, 20.0, 20.0)
                    + Vec3::new(0.0, -1.5, 0.8) * spot(2.0, -14.0, 14.0, 14.0)
            }
            _ => {
                Vec3::new(8.0 * aside, -1.2, -4.2) * spot(3.0, -2.0, 31.0, 20.0)
                    + Vec3::new(0.6, 0.0, 1.0) * spot(18.0, 0.0, 14.0, 20.0)
            }
        }
    }

    /// Angle about the eyeball by which the unit raises this part of the lids, radians.
    fn lid_roll(&self, number: u8) -> f32 {
        let plan = self.plan;
        let first = plan.look == Look::First;
        let (upper, lower) = match number {
            5 => (0.20, -0.03),
            6 if first => (-0.02, 0.10),
            6 => (-0.03, 0.20),
            7 if first => (-0.10, 0.175),
            7 => (-0.03, 0.19),
            9 => (0.0, 0.04),
            12 => (0.0, 0.035),
            43 => (0.0, 0.03),
            _ => return 0.0,
        };
        if !self.mark.eye.is_finite()
            || self.mark.eye.abs() > 24.0
            || self.p.x > plan.outer_canthus.x + 1.0
            || self.p.x < plan.inner_canthus.x - 1.0
        {
            return 0.0;
        }
        let q = eyes::along_lid(plan, self.p.x);
        let shape = libm::sinf(std::f32::consts::PI * q).max(0.0);
        let above = self.mark.eye > 0.0;
        let distance = (self.p.y - eyes::margin(plan, self.p.x, above)).abs();
        let lining = self.mark.part == Part::LidLining;
        // The lid's plate rotates with its margin; the fold above it, which does not touch the eyeball, stays.
        let off = self.p.distance(plan.eye) - plan.eye_radius;
        let fade = if lining {
            1.0
        } else {
            (1.0 - smoothstep(1.0, if above { 15.0 } else { 11.0 }, distance))
                * (1.0 - smoothstep(2.5, 13.0, off))
        };
        let roll = if above { upper } else { lower };
        let close = if number == 43 && above { self.closing() } else { 0.0 };
        (roll * shape + close) * fade
    }

    /// Angle from the upper margin to its contact with the lower one.
    fn closing(&self) -> f32 {
        let plan = self.plan;
        let x = self.p.x;
        let height = |y: f32| libm::asinf(((y - plan.eye.y) / self.margin_reach(y)).clamp(-1.0, 1.0));
        height(eyes::margin(plan, x, false) + 0.1) - height(eyes::margin(plan, x, true))
    }

    /// Distance of the margin at height `y` in this column from the eyeball's horizontal axis.
    fn margin_reach(&self, y: f32) -> f32 {
        let d = eyes::margin_point(self.plan, self.p.x, y) - self.plan.eye;
        libm::sqrtf(d.y * d.y + d.z * d.z)
    }

    /// Distance by which the lid lifts off the eyeball, so that the upper lid closes over the lower.
    fn lid_lift(&self, number: u8) -> f32 {
        if number != 43 || self.mark.eye < 0.0 {
            return 0.0;
        }
        // The fold above the lid's plate flattens as it is pulled down.
        let off = self.p.distance(self.plan.eye) - self.plan.eye_radius;
        0.35 - 0.55 * (off - 2.5).max(0.0) * (1.0 - smoothstep(2.5, 13.0, off))
    }
}
