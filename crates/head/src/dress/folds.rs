//! Folds of the skin that action units make, after the descriptions of FACS (Ekman, Friesen and Hager 2002): lines on the face, each a groove
//! with a bulge on one side. They show in the light on the skin, and do not move it.

use glam::Vec3;
use serde::Serialize;

use super::Dressing;
use super::surface::Surface;
use crate::{HeadModel, Region, Side};

const MM: f32 = 1e-3;

/// A point of the face: a landmark of the left half (dlib's number) and an offset in millimetres outward and up.
type Place = (usize, [f32; 2]);

/// Distance between the landmarks at the wings of the nose for which offsets from these are given, millimetres.
const NOSE_WIDTH: f32 = 24.0;

/// A fold of the left half of the face. The right half has its mirror image.
struct Fold {
    /// The line, with the bulge on its left as seen from outside.
    line: &'static [Place],
    /// Depth of the groove in millimetres at full strength, in a young and in an old face.
    depth: [f32; 2],
    /// Distance from the bottom of the groove at which it is 1/e as deep, in millimetres.
    width: f32,
    /// Height of the bulge relative to the depth.
    bulge: f32,
    /// Strength at rest in a young and in an old face.
    at_rest: [f32; 2],
    /// Shares of the line over which it fades in and out.
    fades: [f32; 2],
    /// Action units that make it, with its strength at their full intensity.
    units: &'static [(u8, f32)],
}

const NASOLABIAL: &[Place] =
    &[(54, [14.0, -12.0]), (54, [15.0, -2.0]), (54, [11.5, 8.0]), (35, [12.0, -1.0]), (35, [6.5, 7.5])];

static FOLDS: [Fold; 24] = [
    // Around the wing of the nose.
    Fold {
        line: &[(35, [2.0, -3.0]), (35, [4.7, 0.0]), (35, [5.2, 4.0]), (35, [3.2, 7.5]), (35, [0.5, 10.0])],
        depth: [1.25, 1.35],
        width: 1.6,
        bulge: 0.15,
        at_rest: [0.9, 1.0],
        fades: [0.15, 0.6],
        units: &[(9, 0.4), (12, 0.3)],
    },
    // The side of the philtrum.
    Fold {
        line: &[(51, [1.6, 2.5]), (51, [1.4, 7.0]), (33, [1.2, -1.5])],
        depth: [0.22, 0.22],
        width: 1.5,
        bulge: 0.5,
        at_rest: [0.8, 0.6],
        fades: [0.25, 0.3],
        units: &[],
    },
    // From the wing of the nose to beside the corner of the mouth; the cheek bulges over it.
    Fold {
        line: NASOLABIAL,
        depth: [1.0, 1.4],
        width: 2.7,
        bulge: 0.5,
        at_rest: [0.16, 0.5],
        fades: [0.6, 0.05],
        units: &[(12, 1.0), (10, 0.75), (9, 0.5), (6, 0.2), (14, 0.3), (20, 0.3)],
    },
    // Crow's feet.
    Fold {
        line: &[(45, [4.5, 2.0]), (45, [10.0, 4.5]), (45, [16.0, 8.5])],
        depth: [0.10, 0.42],
        width: 0.9,
        bulge: 0.4,
        at_rest: [0.0, 0.25],
        fades: [0.12, 0.5],
        units: &[(6, 1.0), (12, 0.2)],
    },
    Fold {
        line: &[(45, [5.0, -1.0]), (45, [11.0, -1.0]), (45, [18.0, -0.5])],
        depth: [0.12, 0.42],
        width: 0.9,
        bulge: 0.4,
        at_rest: [0.0, 0.25],
        fades: [0.12, 0.5],
        units: &[(6, 1.0), (12, 0.2)],
    },
    Fold {
        line: &[(45, [4.0, -4.0]), (45, [9.0, -6.5]), (45, [15.0, -10.5])],
        depth: [0.10, 0.42],
        width: 0.9,
        bulge: 0.4,
        at_rest: [0.0, 0.2],
        fades: [0.12, 0.5],
        units: &[(6, 1.0), (12, 0.2)],
    },
    // Under the lower lid, which bulges.
    Fold {
        line: &[(42, [3.0, -5.5]), (47, [0.0, -7.0]), (46, [0.0, -7.5]), (45, [-1.0, -6.5])],
        depth: [0.30, 0.45],
        width: 1.2,
        bulge: 0.7,
        at_rest: [0.0, 0.3],
        fades: [0.28, 0.28],
        units: &[(6, 0.9), (7, 0.6), (12, 0.25)],
    },
    // Furrows of the cheek below it.
    Fold {
        line: &[(47, [2.0, -12.0]), (46, [3.0, -13.5]), (45, [5.0, -12.0])],
        depth: [0.10, 0.30],
        width: 1.3,
        bulge: 0.4,
        at_rest: [0.0, 0.1],
        fades: [0.28, 0.28],
        units: &[(6, 1.0)],
    },
    // Between the brows.
    Fold {
        line: &[(22, [-4.6, -6.0]), (22, [-4.2, 1.0]), (22, [-3.0, 9.0]), (22, [-2.2, 15.0])],
        depth: [0.65, 1.1],
        width: 1.5,
        bulge: 0.5,
        at_rest: [0.0, 0.18],
        fades: [0.28, 0.28],
        units: &[(4, 1.0), (9, 0.4)],
    },
    Fold {
        line: &[(22, [-9.5, -4.0]), (22, [-9.2, 4.0]), (22, [-8.8, 10.0])],
        depth: [0.15, 0.4],
        width: 1.2,
        bulge: 0.3,
        at_rest: [0.0, 0.05],
        fades: [0.28, 0.28],
        units: &[(4, 1.0)],
    },
    // Across the root of the nose.
    Fold {
        line: &[(27, [7.0, 5.0]), (27, [3.5, 3.5]), (27, [-1.0, 3.0])],
        depth: [0.35, 0.6],
        width: 1.3,
        bulge: 0.4,
        at_rest: [0.0, 0.12],
        fades: [0.28, 0.28],
        units: &[(9, 0.8), (4, 0.5)],
    },
    // Lines on the side of the nose.
    Fold {
        line: &[(28, [10.0, 9.0]), (28, [6.5, 5.5]), (28, [2.0, 4.0])],
        depth: [0.35, 0.5],
        width: 1.0,
        bulge: 0.5,
        at_rest: [0.0, 0.0],
        fades: [0.28, 0.28],
        units: &[(9, 1.0)],
    },
    Fold {
        line: &[(28, [11.0, 4.5]), (28, [7.0, 1.5]), (28, [2.5, 0.5])],
        depth: [0.35, 0.5],
        width: 1.0,
        bulge: 0.5,
        at_rest: [0.0, 0.0],
        fades: [0.28, 0.28],
        units: &[(9, 1.0)],
    },
    // Across the forehead: the middle by raising the inner brow, the sides by raising the outer.
    Fold {
        line: &[(24, [-2.0, 11.0]), (23, [0.0, 13.0]), (22, [-3.0, 12.5]), (27, [-1.0, 31.0])],
        depth: [0.25, 0.6],
        width: 1.7,
        bulge: 0.5,
        at_rest: [0.0, 0.2],
        fades: [0.28, 0.28],
        units: &[(1, 0.8), (2, 0.5)],
    },
    Fold {
        line: &[(24, [2.0, 19.0]), (23, [2.0, 21.5]), (22, [0.0, 21.5]), (27, [-1.0, 40.5])],
        depth: [0.28, 0.65],
        width: 1.7,
        bulge: 0.5,
        at_rest: [0.0, 0.25],
        fades: [0.28, 0.28],
        units: &[(1, 0.8), (2, 0.5)],
    },
    Fold {
        line: &[(24, [4.0, 27.5]), (23, [2.0, 30.5]), (22, [0.0, 30.0]), (27, [-1.0, 49.0])],
        depth: [0.22, 0.6],
        width: 1.7,
        bulge: 0.5,
        at_rest: [0.0, 0.2],
        fades: [0.28, 0.28],
        units: &[(1, 0.7), (2, 0.5)],
    },
    Fold {
        line: &[(26, [0.0, 14.0]), (25, [1.0, 13.5]), (24, [3.0, 13.5]), (23, [4.0, 16.0])],
        depth: [0.22, 0.55],
        width: 1.6,
        bulge: 0.5,
        at_rest: [0.0, 0.1],
        fades: [0.28, 0.28],
        units: &[(2, 1.0)],
    },
    Fold {
        line: &[(26, [0.0, 23.0]), (25, [1.0, 22.0]), (24, [4.0, 22.5])],
        depth: [0.20, 0.5],
        width: 1.6,
        bulge: 0.5,
        at_rest: [0.0, 0.1],
        fades: [0.28, 0.28],
        units: &[(2, 1.0)],
    },
    // The dimple.
    Fold {
        line: &[(54, [5.0, -4.5]), (54, [6.0, 0.5]), (54, [4.5, 5.0])],
        depth: [0.6, 0.8],
        width: 1.6,
        bulge: 0.45,
        at_rest: [0.0, 0.0],
        fades: [0.28, 0.28],
        units: &[(14, 1.0), (12, 0.25)],
    },
    // From the corner of the mouth down.
    Fold {
        line: &[(54, [5.0, -17.0]), (54, [3.5, -10.0]), (54, [1.0, -3.0])],
        depth: [0.35, 0.8],
        width: 1.8,
        bulge: 0.5,
        at_rest: [0.0, 0.25],
        fades: [0.28, 0.28],
        units: &[(15, 1.0), (17, 0.25)],
    },
    // Between the lower lip and the chin.
    Fold {
        line: &[(57, [18.0, -3.5]), (57, [10.0, -6.0]), (57, [-1.0, -6.5])],
        depth: [0.7, 0.9],
        width: 2.8,
        bulge: 0.3,
        at_rest: [0.5, 0.6],
        fades: [0.28, 0.28],
        units: &[(17, 0.7), (24, 0.35), (23, 0.3), (15, 0.3)],
    },
    // The tear trough, from the corner of the eye along the rim of the orbit.
    Fold {
        line: &[(42, [0.5, -5.0]), (42, [4.5, -10.5]), (47, [0.0, -14.5]), (46, [1.0, -16.5])],
        depth: [0.6, 1.2],
        width: 3.0,
        bulge: 0.3,
        at_rest: [0.6, 1.0],
        fades: [0.2, 0.5],
        units: &[],
    },
    // The hollow below the cheekbone.
    Fold {
        line: &[(54, [9.0, 1.0]), (54, [19.0, 9.0]), (54, [30.0, 17.0]), (54, [42.0, 30.0])],
        depth: [1.1, 1.7],
        width: 11.0,
        bulge: 0.7,
        at_rest: [0.4, 0.8],
        fades: [0.5, 0.5],
        units: &[],
    },
    // Lines of the upper lip, which pressed lips fold.
    Fold {
        line: &[(53, [-3.0, 8.5]), (53, [-2.6, 3.0])],
        depth: [0.10, 0.35],
        width: 0.9,
        bulge: 0.3,
        at_rest: [0.0, 0.15],
        fades: [0.28, 0.28],
        units: &[(23, 1.0), (24, 0.6)],
    },
];

/// The part of a fold that one Gaussian shows.
#[derive(Debug, Clone, Copy)]
pub struct Crease {
    /// Number of the Gaussian.
    pub gaussian: u32,
    /// Number of the fold: those of the left half, then those of the right.
    pub fold: u32,
    /// Gradient of the skin's height along the surface at full strength, at rest.
    pub slope: Vec3,
    /// Part of the light that does not reach the groove at full strength.
    pub cavity: f32,
}

/// The strength of each fold in terms of a model's expressions.
#[derive(Debug, Clone, Serialize)]
pub(super) struct Strengths(Vec<Strength>);

#[derive(Debug, Clone, Serialize)]
struct Strength {
    at_rest: f32,
    /// For each unit the strength at full intensity, and the intensity.
    units: Vec<(f32, Intensity)>,
}

impl Strengths {
    fn new(model: &HeadModel, age: f32) -> Self {
        let of = |side: Side, fold: &Fold| Strength {
            at_rest: fold.at_rest[0] + (fold.at_rest[1] - fold.at_rest[0]) * age * age,
            units: fold
                .units
                .iter()
                .filter_map(|&(number, most)| Some((most, Intensity::of(model, number, side)?)))
                .collect(),
        };
        let both = [Side::Left, Side::Right];
        Self(both.into_iter().flat_map(|side| FOLDS.iter().map(move |fold| of(side, fold))).collect())
    }

    /// With these weights of the model's expressions.
    pub fn at(&self, expressions: &[f32]) -> Vec<f32> {
        let of = |strength: &Strength| {
            let units = strength.units.iter().map(|(most, intensity)| most * intensity.at(expressions));
            strength.at_rest + units.sum::<f32>()
        };
        self.0.iter().map(|strength| of(strength).min(1.3)).collect()
    }
}

/// The intensity of an action unit on one half of the face as a sum of expressions: the least-squares fit to their weights.
#[derive(Debug, Clone, Serialize)]
pub(super) struct Intensity(Vec<(usize, f32)>);

impl Intensity {
    /// `None` where the model lacks the unit, or moves joints alone in it.
    pub fn of(model: &HeadModel, number: u8, side: Side) -> Option<Self> {
        let unit = |side| model.action_units.iter().find(|unit| unit.number == number && unit.side == side);
        let unit = unit(side).or_else(|| unit(Side::Both))?;
        let squares: f32 = unit.expressions.iter().map(|(_, weight)| weight * weight).sum();
        (squares > 0.0)
            .then(|| Self(unit.expressions.iter().map(|&(at, weight)| (at, weight / squares)).collect()))
    }

    /// With these weights of the model's expressions, 0 to 1.
    pub fn at(&self, expressions: &[f32]) -> f32 {
        let terms = self.0.iter().map(|&(at, share)| share * expressions.get(at).unwrap_or(&0.0));
        terms.sum::<f32>().clamp(0.0, 1.0)
    }
}

/// Smaller slopes are left out.
const FLAT: f32 = 0.01;

/// What the first `skin` Gaussians of a head show of the folds, in their order; and the folds' strengths.
pub(super) fn creases(dressing: &Dressing, skin: usize) -> (Vec<Crease>, Strengths) {
    let surface = dressing.surface;
    let age = dressing.appearance.age;
    let lines: Vec<(Line, &Fold)> = [false, true]
        .into_iter()
        .flat_map(|mirrored| FOLDS.iter().map(move |fold| (Line::on(surface, fold, mirrored), fold)))
        .collect();
    let mut creases = Vec::new();
    for (gaussian, (triangle, splat)) in dressing.splats[..skin].iter().enumerate() {
        let region = surface.model.regions[*triangle as usize];
        if !matches!(region, Region::Skin | Region::Brow | Region::Scalp) {
            continue;
        }
        for (number, (line, fold)) in lines.iter().enumerate() {
            let Some((slope, cavity)) = line.relief(splat.position, surface.size, fold, age) else {
                continue;
            };
            creases.push(Crease { gaussian: gaussian as u32, fold: number as u32, slope, cavity });
        }
    }
    (creases, Strengths::new(surface.model, age))
}

/// The line of a fold on a head.
struct Line {
    points: Vec<Vec3>,
    /// Normal of the skin at each point.
    normals: Vec<Vec3>,
    low: Vec3,
    high: Vec3,
    /// Sign of the side of the bulge: mirror images bulge to the other.
    side: f32,
}

/// Points of a line, from which distances are measured.
const STEPS: usize = 24;

impl Line {
    fn on(surface: &Surface, fold: &Fold, mirrored: bool) -> Self {
        let outward = if mirrored { -1.0 } else { 1.0 };
        let skin = surface.triangles_of(&[Region::Skin, Region::Brow, Region::Scalp, Region::Lips]);
        let nose = surface.landmarks[31].distance(surface.landmarks[35]) / (NOSE_WIDTH * MM * surface.size);
        let knots: Vec<Vec3> = fold
            .line
            .iter()
            .map(|&(landmark, [x, y])| {
                let x = if landmark == 35 { x * nose } else { x };
                let landmark = if mirrored { mirror(landmark) } else { landmark };
                surface.landmarks[landmark] + Vec3::new(outward * x, y, 0.0) * (MM * surface.size)
            })
            .collect();
        let reach = 0.03 * surface.size;
        let near: Vec<u32> = skin
            .into_iter()
            .filter(|&t| {
                let origin = surface.frames[t as usize].origin;
                knots.iter().any(|knot| (origin - *knot).truncate().length() < reach) && origin.z > 0.0
            })
            .collect();
        // Offsets leave the surface: the point is the one in front of the same place.
        let mut points = Vec::new();
        let mut normals = Vec::new();
        for step in 0..=STEPS {
            let knot = super::catmull_rom(&knots, step as f32 / STEPS as f32);
            if let Some(point) = super::nearest_point(surface, &near, knot) {
                points.push(point.position);
                normals.push(point.normal);
            }
        }
        let far = Vec3::splat(4.0 * fold.width * MM * surface.size);
        let low = points.iter().copied().fold(Vec3::MAX, Vec3::min) - far;
        let high = points.iter().copied().fold(Vec3::MIN, Vec3::max) + far;
        Self { points, normals, low, high, side: outward }
    }

    /// Slope and cavity of the fold at a point of the skin.
    fn relief(&self, p: Vec3, size: f32, fold: &Fold, age: f32) -> Option<(Vec3, f32)> {
        if p.cmplt(self.low).any() || p.cmpgt(self.high).any() {
            return None;
        }
        let segments = self.points.windows(2).enumerate();
        let (at, nearest, along) = segments
            .map(|(number, ends)| {
                let way = ends[1] - ends[0];
                let share =
                    ((p - ends[0]).dot(way) / way.length_squared().max(f32::MIN_POSITIVE)).clamp(0.0, 1.0);
                (number as f32 + share, ends[0] + way * share, way)
            })
            .min_by(|a, b| a.1.distance_squared(p).total_cmp(&b.1.distance_squared(p)))?;
        let share = at / (self.points.len() - 1) as f32;
        let [first, last] = fold.fades;
        let fade = super::smoothstep(share / first) * super::smoothstep((1.0 - share) / last);
        let normal = self.normals[at as usize];
        let across = normal.cross(along).normalize_or_zero() * self.side;
        let mm = MM * size;
        let off = (p - nearest) / mm;
        let distance = off.dot(across);
        // Beyond the ends of the line there is no fold, nor on skin behind.
        if (off - across * distance).length() > 2.0 {
            return None;
        }
        let depth = (fold.depth[0] + (fold.depth[1] - fold.depth[0]) * age) * fade;
        let bell = |centre: f32, width: f32| {
            let q = (distance - centre) / width;
            (libm::expf(-q * q), -2.0 * q / width)
        };
        let (groove, groove_slope) = bell(0.0, fold.width);
        let (bulge, bulge_slope) = bell(2.4 * fold.width, 1.7 * fold.width);
        let slope = depth * (fold.bulge * bulge * bulge_slope - groove * groove_slope);
        let cavity = 0.32 * (depth / fold.width).min(1.0) * groove;
        (slope.abs() > FLAT || cavity > FLAT).then_some((across * slope, cavity))
    }
}

/// The landmark in the other half of the face, of dlib's 68.
fn mirror(landmark: usize) -> usize {
    match landmark {
        17..=26 => 43 - landmark,
        27..=30 => landmark,
        31..=35 => 66 - landmark,
        42..=45 => 81 - landmark,
        46..=47 => 87 - landmark,
        48..=54 => 102 - landmark,
        55..=59 => 114 - landmark,
        _ => landmark,
    }
}
