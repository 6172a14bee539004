//! Regions of the skin that a mesh does not mark itself, by the landmarks of the face.

use glam::Vec3;

use crate::{HeadModel, Region};

/// The hairline in profile, metres from back to front: [z, y].
const HAIRLINE: [[f32; 2]; 15] = [
    [-0.090, -0.035],
    [-0.042, -0.028],
    [-0.030, 0.002],
    [-0.022, 0.020],
    [-0.017, 0.050],
    [0.010, 0.052],
    [0.015, 0.036],
    [0.019, 0.012],
    [0.031, 0.014],
    [0.037, 0.040],
    [0.045, 0.064],
    [0.055, 0.083],
    [0.063, 0.098],
    [0.073, 0.107],
    [0.095, 0.114],
];

/// Where the outer corners of ICT-FaceKit's eyes are, metres: their middle, and their distance. [`HAIRLINE`] and the distances
/// below refer to this head.
const ICT_EYES: (Vec3, f32) = (Vec3::new(0.0, 0.0343, 0.0860), 0.0892);

/// Sets the region of each triangle all of whose vertices are in a part, a list of vertices: that of the first such part.
pub(crate) fn mark_parts(model: &mut HeadModel, parts: &[(Vec<u32>, Region)]) {
    let masks = parts.iter().map(|(part, region)| {
        let mut inside = vec![false; model.template.len()];
        part.iter().for_each(|v| inside[*v as usize] = true);
        (inside, *region)
    });
    let masks: Vec<(Vec<bool>, Region)> = masks.collect();
    for (own, triangle) in model.regions.iter_mut().zip(&model.triangles) {
        let holds = |inside: &[bool]| triangle.iter().all(|v| inside[*v as usize]);
        if let Some((_, region)) = masks.iter().find(|(inside, _)| holds(inside)) {
            *own = *region;
        }
    }
}

/// Divides the skin into its regions by the landmarks, if there are the 68. Regions that the model marks itself are left to it.
pub(crate) fn divide_skin(model: &mut HeadModel, marked: &[Region]) {
    let landmarks: Vec<Vec3> = model.landmarks_on(&model.template).collect();
    if landmarks.len() < 68 {
        return;
    }
    let map = RegionMap::of_any_head(&landmarks);
    for (region, triangle) in model.regions.iter_mut().zip(&model.triangles) {
        if *region == Region::Skin {
            let [a, b, c] = triangle.map(|v| model.template[v as usize]);
            *region = map.skin_region((a + b + c) / 3.0);
            if marked.contains(region) {
                *region = Region::Skin;
            }
        }
    }
}

/// Boundaries of the regions that the topology does not separate.
pub(crate) struct RegionMap {
    /// ICT-FaceKit's coordinates from the head's own: its eyes, those of ICT-FaceKit, and the scale between.
    eyes_here: Vec3,
    eyes_there: Vec3,
    scale: f32,
    lips: Vec<Vec3>,
    brows: [Vec<Vec3>; 2],
    eyes: [Vec<Vec3>; 2],
    chin: Vec3,
    ear: Vec3,
}

impl RegionMap {
    /// For any head with 68 landmarks: it is moved and scaled so that the corners of its eyes are where ICT-FaceKit's are.
    fn of_any_head(landmarks: &[Vec3]) -> Self {
        let (eyes_there, apart) = ICT_EYES;
        let eyes_here = (landmarks[36] + landmarks[45]) * 0.5;
        let scale = apart / landmarks[36].distance(landmarks[45]).max(1e-6);
        let moved: Vec<Vec3> = landmarks.iter().map(|&p| (p - eyes_here) * scale + eyes_there).collect();
        Self { eyes_here, eyes_there, scale, ..Self::new(&moved) }
    }

    /// For ICT-FaceKit.
    pub(crate) fn new(landmarks: &[Vec3]) -> Self {
        Self {
            eyes_here: Vec3::ZERO,
            eyes_there: Vec3::ZERO,
            scale: 1.0,
            lips: landmarks[48..60].to_vec(),
            brows: [landmarks[17..22].to_vec(), landmarks[22..27].to_vec()],
            eyes: [landmarks[36..42].to_vec(), landmarks[42..48].to_vec()],
            chin: landmarks[8],
            ear: (landmarks[0] + landmarks[16]) * 0.5,
        }
    }

    /// The region of skin at `p`.
    pub(crate) fn skin_region(&self, p: Vec3) -> Region {
        let p = (p - self.eyes_here) * self.scale + self.eyes_there;
        let front = p.z > self.ear.z;
        if front && inside_polygon(p, &self.lips) && p.z > self.lips[0].z - 0.004 {
            Region::Lips
        } else if front && self.eyes.iter().any(|eye| inside_polygon(p, eye)) {
            Region::LidMargin
        } else if front && self.brows.iter().any(|brow| near_polyline(p + Vec3::Y * 0.003, brow, 0.008)) {
            Region::Brow
        } else if self.is_neck(p) {
            Region::Neck
        } else if self.is_scalp(p) {
            Region::Scalp
        } else {
            Region::Skin
        }
    }

    /// Below a plane from under the chin to the nape.
    fn is_neck(&self, p: Vec3) -> bool {
        let behind = (self.chin.z - 0.03 - p.z).max(0.0);
        p.y < self.chin.y - 0.012 + (behind * 0.45).min(0.035)
    }

    /// Above the hairline: over the forehead, down the temples to the sideburns, around the ears, down to the nape.
    fn is_scalp(&self, p: Vec3) -> bool {
        let i = HAIRLINE.partition_point(|[z, _]| *z < p.z).clamp(1, HAIRLINE.len() - 1);
        let ([z0, y0], [z1, y1]) = (HAIRLINE[i - 1], HAIRLINE[i]);
        let t = ((p.z - z0) / (z1 - z0)).clamp(0.0, 1.0);
        p.y > y0 + (y1 - y0) * t
    }
}

/// Whether a point is inside a polygon, both seen from the front.
fn inside_polygon(p: Vec3, polygon: &[Vec3]) -> bool {
    let mut inside = false;
    for (i, a) in polygon.iter().enumerate() {
        let b = polygon[(i + 1) % polygon.len()];
        if (a.y > p.y) != (b.y > p.y) && p.x < (b.x - a.x) * (p.y - a.y) / (b.y - a.y) + a.x {
            inside = !inside;
        }
    }
    inside
}

fn near_polyline(p: Vec3, line: &[Vec3], distance: f32) -> bool {
    line.windows(2).any(|ends| {
        let along = ends[1] - ends[0];
        let t = ((p - ends[0]).dot(along) / along.length_squared().max(1e-12)).clamp(0.0, 1.0);
        (p - ends[0] - along * t).length() < distance
    })
}
