//! Head hair: strands grown from the scalp, combed by style, kept outside the head and shaded along their length.

use glam::Vec3;
use srflow_core::random::Stream;

use super::appearance::HairStyle;
use super::light::Exposure;
use super::noise::Noise;
use super::strand::{Strand, add_strand};
use super::surface::{Buckets, Surface, SurfacePoint};
use super::{Dressing, smoothstep};
use crate::{JointRole, Look, Region};

const MM: f32 = 1e-3;

/// Parameters of a style.
#[derive(Default)]
struct Cut {
    /// Millimetres between roots.
    spacing: f32,
    /// Millimetres of length on top and on the sides.
    length: [f32; 2],
    segments: usize,
    /// Standard deviation across a wisp, millimetres.
    width: f32,
    /// How far hair stands off the head at the root: 0 is flat, 1 upright.
    lift: f32,
    /// Height of the upper layers above the scalp, millimetres.
    volume: f32,
    /// How fast a strand turns to the combing direction, 0 to 1 per segment.
    obedience: f32,
    /// Gravity.
    gravity: f32,
    /// Amplitude of waves.
    wave: f32,
    /// Radius of curls, millimetres.
    curl: f32,
    /// Combed sideways from a parting rather than away from the crown.
    parted: f32,
}

fn cut(style: HairStyle) -> Cut {
    match style {
        HairStyle::Buzzed => Cut {
            spacing: 1.25,
            length: [5.0, 3.5],
            segments: 1,
            width: 0.10,
            lift: 0.55,
            obedience: 0.5,
            wave: 0.1,
            ..Cut::default()
        },
        HairStyle::Short => Cut {
            spacing: 2.25,
            length: [44.0, 17.0],
            segments: 6,
            width: 0.25,
            lift: 0.55,
            volume: 13.0,
            obedience: 0.42,
            gravity: 0.5,
            wave: 0.3,
            parted: 0.5,
            ..Cut::default()
        },
        HairStyle::Medium => Cut {
            spacing: 2.9,
            length: [125.0, 85.0],
            segments: 9,
            width: 0.34,
            lift: 0.5,
            volume: 16.0,
            obedience: 0.45,
            gravity: 1.0,
            wave: 0.35,
            parted: 1.0,
            ..Cut::default()
        },
        HairStyle::Curly => Cut {
            spacing: 3.15,
            length: [74.0, 46.0],
            segments: 15,
            width: 0.36,
            lift: 0.9,
            volume: 34.0,
            obedience: 0.07,
            wave: 0.8,
            curl: 5.2,
            ..Cut::default()
        },
        HairStyle::Long => Cut {
            spacing: 3.2,
            length: [255.0, 215.0],
            segments: 15,
            width: 0.46,
            lift: 0.35,
            volume: 16.0,
            obedience: 0.5,
            gravity: 1.5,
            wave: 0.22,
            parted: 1.0,
            ..Cut::default()
        },
    }
}

/// Grows the hair.
pub(super) fn dress_hair(dressing: &mut Dressing) {
    let surface = dressing.surface;
    let mut stream = dressing.stream("hair");
    let growth = Growth::new(dressing, &mut stream);
    let scalp = surface.triangles_of(&[Region::Scalp]);
    let fringe = surface.signed_distance(&[Region::Scalp], 0.02);
    let spacing = |point: &SurfacePoint| growth.spacing(point.position);
    let fade = if dressing.look == Look::First { 6.0 * MM } else { 11.0 * MM };
    for root in surface.scatter(&scalp, spacing, &mut stream) {
        let inside = surface.value(&fringe, &root) / surface.size;
        // Sparser and shorter towards the hairline.
        let density =
            smoothstep((inside + 1.0 * MM + growth.noise.at(root.position * 180.0) * 2.5 * MM) / fade);
        if stream.unit() < density {
            growth.grow(dressing, &root, 0.45 + 0.55 * smoothstep(inside / (16.0 * MM)), &mut stream);
        }
    }
}

struct Growth<'a> {
    cut: Cut,
    surface: &'a Surface<'a>,
    noise: Noise,
    /// Centre of the cranium, and the whorl from which hair is combed.
    centre: Vec3,
    whorl: Vec3,
    /// x of the parting.
    parting: f32,
    ears: Vec3,
    brow_height: f32,
    body: Body<'a>,
    /// Triangles that no expression moves.
    anchors: Vec<u32>,
    /// Whether locks part and hairs stray.
    loose: bool,
}

impl<'a> Growth<'a> {
    fn new(dressing: &Dressing<'a>, stream: &mut Stream) -> Self {
        let surface = dressing.surface;
        let landmarks = &surface.landmarks;
        let ears = (landmarks[0] + landmarks[16]) * 0.5;
        let size = surface.size;
        Self {
            cut: cut(dressing.appearance.hair_style),
            surface,
            noise: Noise::new(stream.bits()),
            centre: Vec3::new(0.0, ears.y + 0.025 * size, ears.z - 0.03 * size),
            whorl: Vec3::new(stream.uniform(-0.12, 0.12), 0.86, -0.5).normalize(),
            parting: (if stream.unit() < 0.75 { 0.028 } else { 0.0 })
                * if stream.unit() < 0.5 { -size } else { size },
            ears,
            brow_height: landmarks[19].y.max(landmarks[24].y),
            body: Body::new(surface),
            anchors: anchors(surface),
            loose: dressing.look >= Look::Second,
        }
    }

    /// Spacing of roots in metres: smaller next to the parting, where little else covers the scalp.
    fn spacing(&self, p: Vec3) -> f32 {
        self.cut.spacing * MM * self.surface.size * (1.0 - 0.45 * self.flattened(p, 12.0))
    }

    /// How flat the parting makes hair from `p`, up to `reach` millimetres away from it.
    fn flattened(&self, p: Vec3, reach: f32) -> f32 {
        let beside = 1.0 - smoothstep(self.aside_of_parting(p).abs() / (reach * MM));
        (self.cut.parted * 2.0).min(1.0) * beside * (0.6 + 0.4 * self.front(p))
    }

    /// Distance to the left of the parting in metres of an average head; the parting is not straight.
    fn aside_of_parting(&self, p: Vec3) -> f32 {
        (p.x - self.parting) / self.surface.size + 1.8 * MM * self.noise.at(p * 55.0)
    }

    /// 1 above the forehead, 0 from the crown backward, where a parting has closed.
    fn front(&self, p: Vec3) -> f32 {
        smoothstep(((p - self.centre).normalize_or(Vec3::Y).z - 0.1) / 0.45)
    }

    fn grow(&self, dressing: &mut Dressing, root: &SurfacePoint, grown: f32, stream: &mut Stream) {
        let size = self.surface.size;
        let from_centre = (root.position - self.centre).normalize_or(Vec3::Y);
        let top = smoothstep((from_centre.y + 0.05) / 0.75);
        // Short hair of the top does not hang over the temples.
        let top = if self.loose { top * top } else { top };
        let length = self.cut.length[1] + (self.cut.length[0] - self.cut.length[1]) * top;
        let near_ear = smoothstep(
            (root.position.distance(self.nearest_ear(root.position)) / size - 30.0 * MM) / (40.0 * MM),
        );
        // Short hair is cut around the ears.
        let trimmed = if self.cut.length[0] < 60.0 { 0.4 + 0.6 * near_ear } else { 1.0 };
        let loose = self.loose && self.cut.segments > 1;
        // Locks of a centimetre differ in length and direction, and single hairs stray.
        let lock = if loose { self.noise.at(root.position * 85.0) } else { 0.0 };
        let strays = loose && stream.unit() < 0.05;
        let (least, most) = if loose { (0.55 + 0.25 * lock, 1.12 + 0.12 * lock) } else { (0.72, 1.1) };
        let length = length * grown * trimmed * stream.uniform(least, most) * MM * size;
        let layer = stream.unit();
        // On the sides it lies closer to the head.
        let raised = if self.loose && self.cut.length[0] < 60.0 { 0.3 + 0.7 * top } else { 1.0 };
        let points = self.path(root, length, if strays { 1.5 } else { layer }, raised, lock, stream);
        let tone = stream.uniform(0.72, 1.28) * (1.0 + 0.22 * self.noise.at(root.position * 90.0));
        let albedo = dressing.appearance.hair * tone;
        // Hair below the surface layer is dark, and so are the roots.
        let depth = 0.45 + 0.55 * layer.min(1.0);
        let seen = dressing.exposure(root);
        let exposure = Exposure {
            sky: (0.25 + 0.75 * seen.sky) * depth,
            key: (0.45 + 0.55 * seen.key) * depth,
            fill: (0.4 + 0.6 * seen.fill) * depth,
        };
        // Hair is finer at the hairline, and so are short hairs.
        let thin = if loose { (0.1 + 0.9 * grown) * smoothstep(length / (14.0 * MM * size)) } else { 1.0 };
        let root_shade = if self.cut.segments > 1 { 0.45 } else { 0.9 };
        let strand = Strand {
            points: &points,
            width: self.cut.width * MM * size * thin * if strays { 0.35 } else { stream.uniform(0.75, 1.2) },
            taper: if loose { 0.35 } else { 0.5 },
            opacity: if self.cut.segments > 1 { 0.88 } else { 0.75 },
            albedo: [albedo * root_shade, albedo * 1.12],
            gloss: 0.9,
            outward: from_centre,
        };
        let triangle = self.anchor(root);
        add_strand(dressing, triangle, &strand, &exposure);
    }

    /// The points of a strand from root to tip.
    fn path(
        &self,
        root: &SurfacePoint,
        length: f32,
        layer: f32,
        raised: f32,
        lock: f32,
        stream: &mut Stream,
    ) -> Vec<Vec3> {
        let size = self.surface.size;
        let segments = self.cut.segments;
        let step = length / segments as f32;
        let phase = stream.uniform(0.0, std::f32::consts::TAU);
        let turn = stream.uniform(0.55, 0.9) * if stream.unit() < 0.5 { -1.0 } else { 1.0 };
        let mut direction = self.start(root, layer, raised, stream);
        let volume = raised * self.cut.volume * (1.0 - 0.8 * self.flattened(root.position, 50.0));
        let mut p = root.position;
        let mut points = vec![p];
        for i in 1..=segments {
            let s = i as f32 / segments as f32;
            let wave = Vec3::new(
                self.noise.at(p * 38.0),
                self.noise.at(p * 38.0 + 31.0),
                self.noise.at(p * 38.0 + 67.0),
            );
            let weight = self.cut.gravity * smoothstep((s + 0.15) / 0.75);
            let wanted = self.combed(p) * (1.0 - 0.6 * smoothstep(weight)) - Vec3::Y * weight
                + self.off_the_face(p)
                + wave * self.cut.wave
                + direction.cross(root.normal) * (0.55 * lock);
            direction =
                direction.lerp(wanted.normalize_or(direction), self.cut.obedience).normalize_or(direction);
            p += direction * step;
            // Upper layers lie on the lower ones.
            let risen = (volume * layer * smoothstep(s * 2.5) * MM * size).min(0.45 * s * length);
            let thickness = 0.8 * MM * size + risen;
            // It follows the head, but hangs free below the ears.
            let clings = self.cut.gravity > 0.0 && p.y > self.ears.y - 0.01 * size;
            p = self.body.laid_on(p, thickness, clings, step);
            direction = (p - points[i - 1]).normalize_or(direction);
            points.push(p);
        }
        if self.cut.curl > 0.0 {
            let (side, up) = (p - root.position).normalize_or(root.normal).any_orthonormal_pair();
            for (i, point) in points.iter_mut().enumerate().skip(1) {
                let angle = phase + turn * i as f32;
                let radius = self.cut.curl * MM * size * smoothstep(i as f32 / 3.0);
                *point += (side * libm::cosf(angle) + up * libm::sinf(angle)) * radius;
            }
        }
        points
    }

    fn start(&self, root: &SurfacePoint, layer: f32, raised: f32, stream: &mut Stream) -> Vec3 {
        let jitter = Vec3::new(stream.normal(), stream.normal(), stream.normal()) * 0.13;
        let flat = 0.6 * self.flattened(root.position, 20.0);
        let lift = raised * self.cut.lift * (0.55 + 0.45 * layer) * (1.0 - flat);
        (root.normal * lift + self.combed(root.position) * (1.0 - lift) + jitter).normalize_or(root.normal)
    }

    /// The combing direction at `p`: away from the whorl, or sideways from the parting.
    fn combed(&self, p: Vec3) -> Vec3 {
        let t = (p - self.centre).normalize_or(Vec3::Y);
        let away = -(self.whorl - t * t.dot(self.whorl)).normalize_or(Vec3::Z);
        // Towards the crown the two sides of the parting merge.
        let width = (30.0 - 27.5 * self.front(p)) * MM;
        let side = (self.aside_of_parting(p) / width).clamp(-1.0, 1.0);
        let aside = Vec3::new(side, 0.0, -0.42);
        let aside = (aside - t * t.dot(aside)).normalize_or(away);
        let front = smoothstep((t.z + 0.25) / 0.6);
        away.lerp(aside, self.cut.parted * (0.35 + 0.65 * front)).normalize_or(away)
    }

    /// Keeps the face free: pushes hair in front of it back and sideways.
    fn off_the_face(&self, p: Vec3) -> Vec3 {
        let size = self.surface.size;
        let before_ears = smoothstep((p.z - self.ears.z - 0.005 * size) / (0.03 * size));
        let below_hairline = smoothstep((self.brow_height + 0.05 * size - p.y) / (0.04 * size));
        Vec3::new(p.x.signum() * 0.45, 0.0, -1.6) * (before_ears * below_hairline)
    }

    fn nearest_ear(&self, p: Vec3) -> Vec3 {
        let landmark = self.surface.landmarks[if p.x < 0.0 { 0 } else { 16 }];
        landmark - Vec3::Z * (0.02 * self.surface.size)
    }

    fn anchor(&self, root: &SurfacePoint) -> u32 {
        let distance = |t: u32| self.surface.frames[t as usize].origin.distance_squared(root.position);
        let nearest = self.anchors.iter().copied().min_by(|&a, &b| distance(a).total_cmp(&distance(b)));
        nearest.unwrap_or(root.triangle)
    }
}

/// Scalp that only the neck moves: hair on it keeps its shape when the brows rise.
fn anchors(surface: &Surface) -> Vec<u32> {
    let mut still = vec![true; surface.vertices.len()];
    let far = 0.4 * MM * surface.size;
    for (v, offset) in surface.model.expressions.iter().flat_map(|shape| shape.offsets.iter()) {
        still[v as usize] &= offset.length() < far;
    }
    let neck = surface.model.joint(JointRole::Neck).unwrap_or(0);
    for (v, still) in still.iter_mut().enumerate() {
        *still &= surface.model.skinning.weight(v, neck) > 0.98;
    }
    let mut anchors = surface.triangles_of(&[Region::Scalp]);
    anchors.retain(|&t| surface.model.triangles[t as usize].iter().all(|&v| still[v as usize]));
    anchors
}

/// Skin that hair lies on.
struct Body<'a> {
    surface: &'a Surface<'a>,
    vertices: Buckets,
}

impl<'a> Body<'a> {
    fn new(surface: &'a Surface<'a>) -> Self {
        let mut vertices = Buckets::new(0.015 * surface.size);
        let mut seen = vec![false; surface.vertices.len()];
        for t in surface.triangles_of(&super::skin::SKIN) {
            for v in surface.model.triangles[t as usize] {
                if !std::mem::replace(&mut seen[v as usize], true) {
                    vertices.insert(surface.vertices[v as usize], v);
                }
            }
        }
        Self { surface, vertices }
    }

    /// `p`, or its projection to `thickness` above the skin if it is nearer or inside. Hair that `clings` and is up to some
    /// centimetres farther away is pulled half the way back; none is moved farther than `step`.
    fn laid_on(&self, p: Vec3, thickness: f32, clings: bool, step: f32) -> Vec3 {
        let distance = |v: u32| self.surface.vertices[v as usize].distance_squared(p);
        let Some(nearest) = self.vertices.near(p).min_by(|&a, &b| distance(a).total_cmp(&distance(b))) else {
            return p;
        };
        let normal = self.surface.normals[nearest as usize];
        let height = (p - self.surface.vertices[nearest as usize]).dot(normal);
        let correction = thickness - height;
        p + normal * if correction < 0.0 && clings { correction * 0.5 } else { correction.clamp(0.0, step) }
    }
}
