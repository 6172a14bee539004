//! Eyelashes along the rims of the lids.

use glam::Vec3;
use srflow_core::random::Stream;

use super::strand::{Strand, add_strand};
use super::{Dressing, catmull_rom, near_triangles, nearest_point};
use crate::{Look, Region};

const MM: f32 = 1e-3;

/// One lid: its landmarks from the outer to the inner corner.
struct Lid {
    /// 0 for the left eye, 1 for the right.
    eye: usize,
    landmarks: [usize; 4],
    upper: bool,
}

const LIDS: [Lid; 4] = [
    Lid { eye: 1, landmarks: [36, 37, 38, 39], upper: true },
    Lid { eye: 1, landmarks: [36, 41, 40, 39], upper: false },
    Lid { eye: 0, landmarks: [45, 44, 43, 42], upper: true },
    Lid { eye: 0, landmarks: [45, 46, 47, 42], upper: false },
];

/// Grows the lashes of all four lids.
pub(super) fn dress_lashes(dressing: &mut Dressing) {
    for (number, lid) in LIDS.iter().enumerate() {
        let mut stream = dressing.stream(["lashes 0", "lashes 1", "lashes 2", "lashes 3"][number]);
        let surface = dressing.surface;
        let eye = surface.eyes[lid.eye];
        let regions = [Region::LidMargin, Region::Skin];
        let skin = near_triangles(surface, &regions, eye, 0.028 * surface.size);
        let hairs = match (dressing.look, lid.upper) {
            (Look::First, true) => 88,
            (Look::First, false) => 50,
            (_, true) => 170,
            (_, false) => 60,
        };
        for i in 0..hairs {
            let t = 0.05 + 0.84 * (i as f32 + stream.unit()) / hairs as f32;
            grow(dressing, lid, &skin, t, &mut stream);
        }
        if lid.upper {
            lash_line(dressing, lid, &skin);
        }
    }
}

fn grow(dressing: &mut Dressing, lid: &Lid, skin: &[u32], t: f32, stream: &mut Stream) {
    let surface = dressing.surface;
    let size = surface.size;
    let curve = lid.landmarks.map(|i| surface.landmarks[i]);
    let Some(root) = nearest_point(surface, skin, catmull_rom(&curve, t)) else { return };
    // Fanned outward: lashes at the outer corner point to the temple.
    let temple = (curve[0] - curve[3]).normalize_or(Vec3::X);
    let fan = temple * (0.62 * (0.62 - t) + stream.normal() * 0.07);
    let clump = libm::sinf(t * 90.0) * 0.05;
    let (length, start, curl) = if lid.upper {
        (7.6 * (1.0 - 0.55 * t), Vec3::new(0.0, -0.12, 0.98), Vec3::new(0.0, 0.66, -0.1))
    } else {
        (5.2 * (1.0 - 0.45 * t), Vec3::new(0.0, -0.42, 0.75), Vec3::new(0.0, -0.25, 0.0))
    };
    let first = dressing.look == Look::First;
    // Short and long ones side by side, thin at their tips.
    let (share, least) = if first { (1.0, 0.75) } else { (if lid.upper { 0.86 } else { 0.62 }, 0.45) };
    let length = length * share * stream.uniform(least, 1.1) * MM * size;
    let (width, taper, opacity) = match (first, lid.upper) {
        (true, true) => (0.048, 0.35, 0.74),
        (true, false) => (0.032, 0.35, 0.38),
        (false, true) => (0.046, 0.2, 0.85),
        (false, false) => (0.034, 0.2, 0.6),
    };
    let points: [Vec3; 5] = std::array::from_fn(|i| {
        let s = i as f32 / 4.0;
        root.position + ((start + fan + temple * clump) * s + curl * (s * s)) * length
    });
    let dark = dressing.appearance.brows.min(Vec3::splat(0.035)) * 0.5;
    let strand = Strand {
        points: &points,
        width: width * MM * size,
        taper,
        opacity,
        albedo: [dark, dark],
        gloss: 0.1,
        outward: Vec3::ZERO,
    };
    // The rim itself folds under when the eye closes; the lid's face next to it rotates as lashes do.
    let beside = root.position + Vec3::Y * (if lid.upper { 1.0 } else { -1.0 } * MM * size);
    let triangle = nearest_point(surface, skin, beside).map_or(root.triangle, |lid| lid.triangle);
    add_strand(dressing, triangle, &strand, &dressing.exposure(&root));
}

/// The roots close together: a dark line on the rim of the upper lid.
fn lash_line(dressing: &mut Dressing, lid: &Lid, skin: &[u32]) {
    let surface = dressing.surface;
    let size = surface.size;
    let curve = lid.landmarks.map(|i| surface.landmarks[i]);
    let (width, opacity) = if dressing.look == Look::First { (0.17, 0.42) } else { (0.23, 0.75) };
    const STEPS: usize = 70;
    for step in 0..STEPS {
        let t = step as f32 / STEPS as f32 * 0.93;
        let Some(root) = nearest_point(surface, skin, catmull_rom(&curve, t)) else { continue };
        let next = catmull_rom(&curve, t + 0.03);
        let points = [root.position, root.position + (next - catmull_rom(&curve, t))];
        let raised = points.map(|p| p + Vec3::Z * (0.25 * MM * size));
        let dark = dressing.appearance.brows.min(Vec3::splat(0.03)) * 0.5;
        let strand = Strand {
            points: &raised,
            width: width * MM * size,
            taper: 1.0,
            opacity,
            albedo: [dark, dark],
            gloss: 0.0,
            outward: Vec3::ZERO,
        };
        add_strand(dressing, root.triangle, &strand, &dressing.exposure(&root));
    }
}
