//! VHAP's teeth (`model/flame.py`, `add_teeth`): two strips behind the lips, made from the rings of vertices at their edges.

use std::collections::BTreeMap;
use std::path::Path;

use glam::{Vec2, Vec3};

use crate::HeadError;
use crate::{JointRole, TextureMap};

/// Vertices of FLAME, after which those of the teeth come.
pub(crate) const FLAME_VERTICES: usize = 5023;

/// Vertices along a row.
const ROW: usize = 15;
const ROWS: usize = 8;

/// The outer edges of the lips, from the subject's left to the right.
const UPPER_LIP: [usize; ROW] =
    [1713, 1715, 1716, 1735, 1696, 1694, 1657, 3543, 2774, 2811, 2813, 2850, 2833, 2832, 2830];
const LOWER_LIP: [usize; ROW] =
    [1576, 1577, 1773, 1774, 1795, 1802, 1865, 3503, 2948, 2905, 2898, 2881, 2880, 2713, 2712];

// The rows, in the order of their vertices.
const UPPER_ROOT: u32 = 0;
const LOWER_ROOT: u32 = 15;
const UPPER_EDGE: u32 = 30;
const LOWER_EDGE: u32 = 45;
const UPPER_ROOT_BACK: u32 = 60;
const UPPER_EDGE_BACK: u32 = 75;
const LOWER_ROOT_BACK: u32 = 90;
const LOWER_EDGE_BACK: u32 = 105;

/// The rows of the upper teeth, and of the lower.
const UPPER: [u32; 4] = [UPPER_ROOT, UPPER_EDGE, UPPER_ROOT_BACK, UPPER_EDGE_BACK];
const LOWER: [u32; 4] = [LOWER_ROOT, LOWER_EDGE, LOWER_ROOT_BACK, LOWER_EDGE_BACK];

/// A strip of quads between two rows. The corners of a quad are A and B on the first row, C and D on the second, C beside B. Each
/// is cut into two triangles in one way up to the middle tooth and in the other beyond it; the first corner counts, since
/// [`crate::TriangleFrame`] starts there.
struct Strip {
    rows: [u32; 2],
    halves: [[[u8; 3]; 2]; 2],
}

const STRIPS: [Strip; 6] = [
    Strip { rows: [UPPER_ROOT, UPPER_EDGE], halves: [[*b"ACD", *b"ABC"], [*b"ABD", *b"BCD"]] },
    Strip { rows: [UPPER_ROOT_BACK, UPPER_EDGE_BACK], halves: [[*b"ADC", *b"ACB"], [*b"ADB", *b"BDC"]] },
    Strip { rows: [UPPER_EDGE_BACK, UPPER_EDGE], halves: [[*b"ADB", *b"BDC"], [*b"ADC", *b"ACB"]] },
    Strip { rows: [LOWER_EDGE, LOWER_ROOT], halves: [[*b"ABD", *b"BCD"], [*b"ACD", *b"ABC"]] },
    Strip { rows: [LOWER_ROOT_BACK, LOWER_EDGE_BACK], halves: [[*b"ACD", *b"ABC"], [*b"ABD", *b"BCD"]] },
    Strip { rows: [LOWER_EDGE_BACK, LOWER_EDGE], halves: [[*b"ABD", *b"BCD"], [*b"ACD", *b"ABC"]] },
];

/// The teeth of one template.
pub(super) struct Teeth {
    /// Positions of the 120 vertices.
    pub vertices: Vec<Vec3>,
}

impl Teeth {
    /// # Errors
    /// When the template is not FLAME's.
    pub(super) fn on(path: &Path, template: &[Vec3]) -> Result<Self, HeadError> {
        if template.len() != FLAME_VERTICES {
            return Err(HeadError::Topology {
                path: path.to_owned(),
                model: "FLAME, which the teeth need,",
                expected: FLAME_VERTICES,
                found: template.len(),
            });
        }
        let rings: [(Vec3, Vec3); ROW] =
            std::array::from_fn(|i| (template[UPPER_LIP[i]], template[LOWER_LIP[i]]));
        let gap = rings.iter().map(|(upper, lower)| upper.distance(*lower)).sum::<f32>() / ROW as f32;
        let height = rings.iter().map(|(upper, lower)| (upper.y + lower.y) * 0.5).sum::<f32>() / ROW as f32;
        let middle = rings.map(|(upper, lower)| {
            let between = (upper + lower) * 0.5;
            Vec3::new(between.x, height, between.z - 1.5 * gap)
        });
        let (up, back) = (Vec3::Y * gap, Vec3::NEG_Z * gap);
        let upper_edge = up * 0.1;
        let lower_edge = up * -0.1 + back * 0.4;
        let (upper_root, lower_root) = (upper_edge + up * 2.0, lower_edge - up * 2.0);
        let rows: [Vec3; ROWS] = [
            upper_root,
            lower_root,
            upper_edge,
            lower_edge,
            upper_root + back,
            upper_edge + back,
            lower_root + back,
            lower_edge + back,
        ];
        Ok(Self { vertices: rows.iter().flat_map(|row| middle.map(|point| point + *row)).collect() })
    }

    /// The displacements of the teeth by a shape that displaces the head by `offsets`: each column moves with the mean of its
    /// vertices on the lips.
    pub(super) fn follow(&self, offsets: &[Vec3]) -> Vec<Vec3> {
        let column = |i: usize| (offsets[UPPER_LIP[i]] + offsets[LOWER_LIP[i]]) * 0.5;
        (0..ROWS).flat_map(|_| (0..ROW).map(column)).collect()
    }
}

/// The joint that each vertex of the teeth follows.
pub(super) fn joints() -> impl Iterator<Item = usize> {
    let joint = |row: u32| if UPPER.contains(&row) { JointRole::Neck } else { JointRole::Jaw } as usize;
    (0..ROWS as u32).flat_map(move |row| [joint(row * ROW as u32); ROW])
}

/// Triangles of the teeth, in VHAP's order.
pub(super) fn triangles() -> Vec<[u32; 3]> {
    let mut triangles = Vec::new();
    for Strip { rows: [first, second], halves } in STRIPS {
        for quad in 0..ROW as u32 - 1 {
            for corners in halves[usize::from(quad >= ROW as u32 / 2)] {
                triangles.push(corners.map(|corner| {
                    FLAME_VERTICES as u32
                        + quad
                        + match corner {
                            b'A' => first,
                            b'B' => first + 1,
                            b'C' => second + 1,
                            _ => second,
                        }
                }));
            }
        }
    }
    triangles
}

/// The vertices on the outer edges of the lips that the teeth are made from, `lip_outside_ring_upper` and `lip_outside_ring_lower`.
pub(super) fn rings_of_lips() -> [(String, Vec<u32>); 2] {
    [("upper", UPPER_LIP), ("lower", LOWER_LIP)].map(|(lip, ring)| {
        let mut vertices = ring.map(|v| v as u32).to_vec();
        vertices.sort_unstable();
        (format!("lip_outside_ring_{lip}"), vertices)
    })
}

/// Adds the texture coordinates of the teeth to those of FLAME: rows near the upper edge of the picture.
pub(super) fn add_to_texture(texture: &mut TextureMap) {
    /// Which of seven heights each row has, from the top.
    const HEIGHTS: [u8; ROWS] = [3, 2, 0, 1, 3, 4, 6, 5];
    let first = texture.points.len() as u32;
    for height in HEIGHTS {
        let v = 1.0 - 0.0083 - (0.0425 - 0.0083) * f32::from(height) / 6.0;
        let point = |column: usize| Vec2::new(0.62 - 0.24 * column as f32 / (ROW - 1) as f32, v);
        texture.points.extend((0..ROW).map(point));
    }
    // One point for each vertex of the teeth.
    let points = triangles().into_iter().map(|corners| corners.map(|v| v - FLAME_VERTICES as u32 + first));
    texture.triangles.extend(points);
}

/// Adds the teeth to groups that FLAME has: the halves, whose middle column both have. (VHAP's right half lacks vertex 5096.)
pub(super) fn add_to_halves(groups: &mut BTreeMap<String, Vec<u32>>) {
    for (name, columns) in [("left_half", 0..ROW / 2 + 1), ("right_half", ROW / 2..ROW)] {
        if let Some(half) = groups.get_mut(name) {
            half.extend(
                (0..ROWS).flat_map(|row| columns.clone().map(move |column| vertex(row * ROW + column))),
            );
        }
    }
}

fn vertex(number: usize) -> u32 {
    (FLAME_VERTICES + number) as u32
}

/// Groups of vertices: all teeth, the upper and the lower.
pub(super) fn groups() -> [(String, Vec<u32>); 3] {
    let rows = |rows: &[u32]| -> Vec<u32> {
        let mut vertices: Vec<u32> = rows
            .iter()
            .flat_map(|row| (0..ROW as u32).map(move |i| FLAME_VERTICES as u32 + row + i))
            .collect();
        vertices.sort_unstable();
        vertices
    };
    let all = [UPPER, LOWER].concat();
    [("teeth".into(), rows(&all)), ("teeth_upper".into(), rows(&UPPER)), ("teeth_lower".into(), rows(&LOWER))]
}
