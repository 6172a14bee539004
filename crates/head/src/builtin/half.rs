use glam::Vec3;

use crate::Region;

/// The part of the head that a vertex belongs to.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Part {
    /// The skin from crown to shoulders, lips and lids included.
    Skin,
    /// Margin and lining of the eyelids, and the caruncle.
    LidLining,
    /// Inside of the lips and the mouth; the depth counts rows from the lips.
    MouthLining {
        depth: u8,
    },
    Tongue,
    UpperTeeth,
    LowerTeeth,
    Ear,
    Eyeball,
}

/// A vertex's anatomical position, by which it is moved later.
#[derive(Debug, Clone, Copy)]
pub(super) struct Mark {
    pub part: Part,
    /// On the plane of symmetry: shared by both halves.
    pub midline: bool,
    /// Distance above (negative: below) the slit of the eye, along the skin, millimetres; for the lining, that of its margin.
    pub eye: f32,
    /// The same for the slit of the mouth.
    pub mouth: f32,
    /// Nearest position along the slit, 0 at the midline or inner canthus, 1 at the outer end.
    pub along: f32,
}

impl Mark {
    pub(super) fn of(part: Part) -> Self {
        Self { part, midline: false, eye: f32::INFINITY, mouth: f32::INFINITY, along: 0.0 }
    }
}

/// The left half of the head during construction; millimetres.
#[derive(Debug, Default)]
pub(super) struct Half {
    pub points: Vec<Vec3>,
    pub marks: Vec<Mark>,
    pub triangles: Vec<[u32; 3]>,
    pub regions: Vec<Region>,
}

impl Half {
    pub(super) fn vertex(&mut self, point: Vec3, mark: Mark) -> u32 {
        self.points.push(point);
        self.marks.push(mark);
        self.points.len() as u32 - 1
    }

    /// The strip between two rows of vertices, `above` and `below` as seen from outside, towards the left side. Where the rows
    /// share a vertex there is only one triangle.
    pub(super) fn strip(&mut self, above: &[u32], below: &[u32], region: impl Fn(usize) -> Region) {
        for column in 0..above.len().min(below.len()) - 1 {
            let [a, b, c, d] = [above[column], above[column + 1], below[column], below[column + 1]];
            for triangle in [[a, c, d], [a, d, b]] {
                self.triangle(triangle, region(column));
            }
        }
    }

    pub(super) fn triangle(&mut self, triangle: [u32; 3], region: Region) {
        let [a, b, c] = triangle;
        if a != b && b != c && c != a {
            self.triangles.push(triangle);
            self.regions.push(region);
        }
    }
}
