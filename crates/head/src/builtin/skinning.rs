use glam::Vec3;

use super::curves::{lerp, smoothstep};
use super::half::{Mark, Part};
use super::identity::Plan;
use super::mouth;
use crate::JointRole;

/// How far the skin of the upper and lower lid follows the rotation of the eyeball.
const LID_FOLLOWS: [f32; 2] = [0.30, 0.12];

/// Positions of the joints, millimetres.
pub(super) fn joints(plan: &Plan) -> [Vec3; 5] {
    [
        Vec3::new(0.0, plan.chin - 80.0, -30.0),
        Vec3::new(0.0, plan.chin + 18.0, -22.0),
        Vec3::new(0.0, 4.0, 12.0),
        plan.eye,
        plan.eye * Vec3::new(-1.0, 1.0, 1.0),
    ]
}

/// Weights of the joints for a vertex of the left half at `p`.
pub(super) fn weights(plan: &Plan, p: Vec3, mark: &Mark) -> [f32; 5] {
    let with = |joint: JointRole, share: f32| {
        let mut weights = [0.0; 5];
        weights[JointRole::Neck as usize] = 1.0 - share;
        weights[joint as usize] += share;
        weights
    };
    match mark.part {
        Part::Eyeball => with(JointRole::LeftEye, 1.0),
        Part::Tongue | Part::LowerTeeth => with(JointRole::Jaw, 1.0),
        Part::UpperTeeth | Part::Ear => with(JointRole::Neck, 1.0),
        Part::LidLining => with(JointRole::LeftEye, lid_share(mark)),
        Part::MouthLining { depth } => {
            let deep = (depth as f32 - 5.0) / (mouth::LINING_ROWS as f32 - 5.0);
            with(JointRole::Jaw, lerp(jaw_share(plan, p, mark), 0.5, smoothstep(0.0, 1.0, deep)))
        }
        Part::Skin => {
            let neck = smoothstep(plan.chin - 85.0, plan.chin - 8.0, p.y);
            if neck < 1.0 {
                let jaw = jaw_share(plan, p, mark) * neck;
                return [1.0 - neck, neck - jaw, jaw, 0.0, 0.0];
            }
            let lid = lid_share(mark);
            if lid > 0.0 {
                with(JointRole::LeftEye, lid)
            } else {
                with(JointRole::Jaw, jaw_share(plan, p, mark))
            }
        }
    }
}

fn lid_share(mark: &Mark) -> f32 {
    if !mark.eye.is_finite() || mark.eye.abs() > 9.0 {
        return 0.0;
    }
    let follows = LID_FOLLOWS[usize::from(mark.eye < 0.0)];
    follows
        * libm::sinf(std::f32::consts::PI * mark.along).max(0.0)
        * (1.0 - smoothstep(2.0, 9.0, mark.eye.abs()))
}

/// Weight of the jaw: 1 on the lower lip and chin, 0 on the upper lip, both at the corner of the mouth, with a boundary in the
/// cheek that rises from there to the jaw's joint.
fn jaw_share(plan: &Plan, p: Vec3, mark: &Mark) -> f32 {
    let along = p.x / plan.mouth_half_width;
    // Makes the open mouth rounded rather than a slot.
    let corner = 1.0 - libm::powf((1.0 - along * along).max(0.0), 0.7);
    let beyond = smoothstep(plan.mouth_half_width, 64.0, p.x);
    let over = if mark.mouth.is_finite() { mark.mouth } else { p.y - plan.mouth } - 26.0 * beyond;
    let width = lerp(10.0, 34.0, corner);
    let side = (1.0 - corner) + corner * smoothstep(0.0, 1.0, over.abs() / width);
    let below = 0.5 * (1.0 - side.copysign(over));
    // Throat and angle of the jaw, seen from the joint.
    let angle = libm::atan2f(4.0 - p.y, p.z - 12.0).to_degrees();
    below * (1.0 - smoothstep(56.0, 84.0, angle)) * smoothstep(-12.0, 14.0, p.z)
}
