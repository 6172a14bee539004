//! Eyebrows, hair by hair, along the landmarks of the brows.

use glam::Vec3;
use srflow_core::random::Stream;

use super::strand::{Strand, add_strand};
use super::surface::SurfacePoint;
use super::{Dressing, catmull_rom, near_triangles, nearest_point, smoothstep};
use crate::{Look, Region};

const MM: f32 = 1e-3;
const HAIRS: usize = 460;
/// Thinner ones, of the second look.
const FINE_HAIRS: usize = 640;

/// Grows both brows.
pub(super) fn dress_brows(dressing: &mut Dressing) {
    // Landmarks from the nose outward.
    for (name, landmarks) in [("right brow", [21, 20, 19, 18, 17]), ("left brow", [22, 23, 24, 25, 26])] {
        let mut stream = dressing.stream(name);
        let spine = landmarks.map(|i| dressing.surface.landmarks[i]);
        let size = dressing.surface.size;
        // Annotated landmarks run along the upper edge of the brow.
        let eye = dressing.surface.eyes[usize::from(name == "right brow")];
        let mut spine = spine.map(|p| p - Vec3::Y * ((p.y - eye.y) * 0.17));
        // Brows are flatter at rest than the polyline of these landmarks.
        spine[0].y -= 2.4 * MM * size;
        spine[4].y += 1.5 * MM * size;
        let middle = spine[2];
        let skin = near_triangles(dressing.surface, &[Region::Brow, Region::Skin], middle, 0.042 * size);
        let shape = Shape::of(dressing);
        spine.iter_mut().zip(shape.raised).for_each(|(p, raised)| p.y += raised * MM * size);
        for _ in 0..shape.hairs {
            grow(dressing, &spine, &skin, &shape, &mut stream);
        }
    }
}

/// How a person's brows differ from the landmarks.
struct Shape {
    hairs: usize,
    /// How much higher they are along the brow, millimetres.
    raised: [f32; 5],
    thickness: f32,
    length: f32,
}

impl Shape {
    fn of(dressing: &Dressing) -> Self {
        if dressing.look == Look::First {
            return Self { hairs: HAIRS, raised: [0.0; 5], thickness: 1.0, length: 1.0 };
        }
        let mut stream = dressing.stream("brow shape");
        let mut spread = |reach: f32| stream.normal().clamp(-2.0, 2.0) * reach;
        let (height, arch, tilt) = (spread(0.9), spread(0.8), spread(0.7));
        let (thickness, length, hairs) =
            (libm::expf(spread(0.22)), libm::expf(spread(0.12)), libm::expf(spread(0.22)));
        let raised = [height - tilt, height, height + arch, height + 0.7 * arch + 0.5 * tilt, height + tilt];
        Self { hairs: (FINE_HAIRS as f32 * hairs) as usize, raised, thickness, length }
    }
}

fn grow(dressing: &mut Dressing, spine: &[Vec3; 5], skin: &[u32], shape: &Shape, stream: &mut Stream) {
    let surface = dressing.surface;
    let size = surface.size;
    // Thin at the inner end; the tail stops before the last landmark.
    let t = 0.93 * (stream.unit() * 0.85 + stream.unit() * 0.15);
    // Across the brow, denser at its centre line.
    let across = (stream.unit() + stream.unit() - 1.0) * 1.1;
    let half_height = (0.9
        + 2.9 * smoothstep((t + 0.12) / 0.35) * (1.0 - 0.95 * smoothstep((t - 0.3) / 0.7)))
        * shape.thickness
        * MM;
    let on_spine = catmull_rom(spine, t);
    let Some(root) = nearest_point(surface, skin, on_spine + Vec3::Y * (across * half_height * size)) else {
        return;
    };
    let direction = direction(spine, t, across, &root, stream);
    let length = (8.5 - 4.0 * t) * shape.length * stream.uniform(0.7, 1.15) * MM * size;
    let points: [Vec3; 4] = std::array::from_fn(|i| {
        let s = i as f32 / 3.0;
        // Up from the skin, then back along it and a little down.
        let lift = root.normal * (0.25 * s - 0.16 * s * s);
        root.position + (direction * s + lift - Vec3::Y * (0.12 * s * s)) * length + root.normal * (0.15 * MM)
    });
    let albedo = dressing.appearance.brows * stream.uniform(0.6, 1.3);
    let (width, opacity) = if dressing.look == Look::First { (0.065, 0.7) } else { (0.068, 0.82) };
    let strand = Strand {
        points: &points,
        width: width * MM * size,
        taper: 0.45,
        opacity,
        albedo: [albedo, albedo * 1.2],
        gloss: 0.15,
        outward: Vec3::ZERO,
    };
    add_strand(dressing, root.triangle, &strand, &dressing.exposure(&root));
}

/// Near the nose hairs point up, farther out they turn along the brow, from above and below towards its centre line.
fn direction(spine: &[Vec3; 5], t: f32, across: f32, root: &SurfacePoint, stream: &mut Stream) -> Vec3 {
    let along = (catmull_rom(spine, t + 0.05) - catmull_rom(spine, t - 0.05)).normalize_or(Vec3::X);
    let up = (root.normal.cross(along).cross(root.normal).cross(root.normal)).normalize_or(Vec3::Y);
    let up = if up.y < 0.0 { -up } else { up };
    let rising = 0.85 * (1.0 - smoothstep(t / 0.35)) + 0.28 * (1.0 - t);
    let angle = rising - across * 0.38 * smoothstep(t / 0.3) + stream.normal() * 0.2;
    let flat = along - root.normal * root.normal.dot(along);
    (flat.normalize_or(along) * libm::cosf(angle) + up * libm::sinf(angle)).normalize_or(along)
}
