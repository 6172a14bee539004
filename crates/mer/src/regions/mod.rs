//! Regions of interest of a face: where they are in the maps of the features, and how they move.

mod mdmo;
mod parts;

use srflow_core::{ConvexHull, named, serialize_as_text};

use crate::features::{Channel, FEATURE_SIDE, Features};

/// A way to divide a face into regions.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Regions {
    /// The parts of a face that have names: brows, eyes, cheeks, and so on.
    Parts,
    /// The 36 regions of MDMO (Liu et al., *A Main Directional Mean Optical Flow Feature for Spontaneous Micro-Expression Recognition*, IEEE
    /// Transactions on Affective Computing 2016), by dlib's points.
    Mdmo,
}

named!(Regions, "regions of a face", { Parts => "parts", Mdmo => "mdmo" });
serialize_as_text!(Regions);

/// A corner of a region, relative to dlib's points.
#[derive(Debug, Clone, Copy)]
enum Corner {
    At(usize),
    /// Midway between two points.
    Between(usize, usize),
    /// To the right of a point and below it, in distances of the outer corners of the eyes.
    Off(usize, [f64; 2]),
}

/// A region: the convex hull of its corners.
struct Region {
    name: &'static str,
    corners: &'static [Corner],
}

/// Which pixel of the features is in which region.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct RegionMap {
    regions: Regions,
    /// `[112, 112]`, row-major: numbers of regions from 1, or 0 where there is none. Where regions overlap, the later one counts.
    labels: Box<[u8]>,
}

/// How a region moves, in pixels of the features.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct RegionFlow {
    /// Mean of u and v.
    pub mean: [f32; 2],
    /// Mean of the optical strain.
    pub strain: f32,
    /// The main directional mean flow: of eight directions, the mean of the flow in that of most pixels.
    pub main: [f32; 2],
}

impl Regions {
    /// The regions' names, by their numbers in a [`RegionMap`] from 1.
    pub fn names(self) -> Vec<&'static str> {
        self.table().iter().map(|region| region.name).collect()
    }

    fn table(self) -> &'static [Region] {
        match self {
            Self::Parts => &parts::REGIONS,
            Self::Mdmo => &mdmo::REGIONS,
        }
    }

    /// Where the regions of a face are whose points are given as shares of the crop.
    pub fn map(self, face: &[[f64; 2]; 68]) -> RegionMap {
        let points = Features::pixels_of_shares(face);
        let [left, right] = [points[36], points[45]];
        let unit = libm::hypot(right[0] - left[0], right[1] - left[1]);
        let place = |corner: &Corner| match *corner {
            Corner::At(point) => points[point],
            Corner::Between(a, b) => [0, 1].map(|axis| (points[a][axis] + points[b][axis]) / 2.0),
            Corner::Off(point, off) => [0, 1].map(|axis| points[point][axis] + off[axis] * unit),
        };
        let mut labels = vec![0; FEATURE_SIDE * FEATURE_SIDE].into_boxed_slice();
        for (region, number) in self.table().iter().zip(1..) {
            let hull = ConvexHull::of(region.corners.iter().map(place).collect());
            for (y, row) in labels.chunks_exact_mut(FEATURE_SIDE).enumerate() {
                for (x, label) in row.iter_mut().enumerate() {
                    if hull.contains([x as f64, y as f64]) {
                        *label = number;
                    }
                }
            }
        }
        RegionMap { regions: self, labels }
    }
}

impl RegionMap {
    /// `[112, 112]`, row-major: numbers of regions from 1, or 0 where there is none.
    pub fn labels(&self) -> &[u8] {
        &self.labels
    }

    /// How each region moves; `None` if it has no pixel.
    pub fn flow(&self, features: &Features) -> Vec<Option<RegionFlow>> {
        let [u, v, strain] =
            [Channel::U, Channel::V, Channel::Strain].map(|channel| features.channel(channel));
        let of_region = |number: u8| {
            let pixels = || (0..self.labels.len()).filter(|pixel| self.labels[*pixel] == number);
            let count = pixels().count();
            let mean = |map: &[f32]| pixels().map(|pixel| f64::from(map[pixel])).sum::<f64>() / count as f64;
            (count > 0).then(|| RegionFlow {
                mean: [mean(u), mean(v)].map(|mean| mean as f32),
                strain: mean(strain) as f32,
                main: main_direction(pixels().map(|pixel| [u[pixel], v[pixel]])),
            })
        };
        (1..).take(self.regions.table().len()).map(of_region).collect()
    }
}

/// Mean of the vectors in the one of eight directions, from 0 degrees on, that has most of them; the first of equal ones.
fn main_direction(flow: impl Iterator<Item = [f32; 2]>) -> [f32; 2] {
    let mut directions = [([0.0; 2], 0_usize); 8];
    for [u, v] in flow {
        let turn = f64::from(v).atan2(f64::from(u)) / std::f64::consts::TAU;
        let (sum, count) = &mut directions[(turn.rem_euclid(1.0) * 8.0) as usize % 8];
        *sum = [sum[0] + f64::from(u), sum[1] + f64::from(v)];
        *count += 1;
    }
    let most = directions.iter().map(|(_, count)| *count).max().unwrap_or(0);
    let main = directions.iter().find(|(_, count)| *count == most && most > 0);
    main.map_or([0.0; 2], |(sum, count)| sum.map(|sum| (sum / *count as f64) as f32))
}
